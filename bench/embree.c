/* Closest triangles by Embree 3's point query, as its user would write it: a dynamic scene whose tree is refitted to the
 * vertices of a frame, and a callback with the closest point on a triangle (Ericson 2005, section 5.1.5). */
#include "bench/bench.h"

#include <embree3/rtcore.h>
#include <float.h>
#include <math.h>
#include <string.h>

struct bench_embree {
    RTCDevice device;
    RTCScene scene;
    RTCGeometry geometry;
    float *vertices;
    const int32_t *faces;
    int64_t n_vertices, n_faces;
    bool attached;
};

bench_embree *bench_embree_create(int64_t n_vertices, int64_t n_faces, const int32_t *faces)
{
    bench_embree *e = hg_alloc(1, sizeof *e);
    if (!e) bench_need(HG_MEMORY);
    e->n_vertices = n_vertices;
    e->n_faces = n_faces;
    e->faces = faces;
    e->device = rtcNewDevice("threads=2");
    e->scene = rtcNewScene(e->device);
    rtcSetSceneFlags(e->scene, RTC_SCENE_FLAG_DYNAMIC);
    e->geometry = rtcNewGeometry(e->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    e->vertices = rtcSetNewGeometryBuffer(e->geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                          (size_t)n_vertices);
    unsigned *index = rtcSetNewGeometryBuffer(e->geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                              3 * sizeof(unsigned), (size_t)n_faces);
    for (int64_t i = 0; i < 3 * n_faces; i++) index[i] = (unsigned)faces[i];
    rtcSetGeometryBuildQuality(e->geometry, RTC_BUILD_QUALITY_REFIT);
    return e;
}

void bench_embree_destroy(bench_embree *e)
{
    rtcReleaseGeometry(e->geometry);
    rtcReleaseScene(e->scene);
    rtcReleaseDevice(e->device);
    hg_free(e);
}

typedef struct {
    const bench_embree *embree;
    float point[3], distance2;
    int32_t triangle;
} query;

typedef struct {
    float x, y, z;
} vec;

static vec sub(vec a, vec b) { return (vec){ a.x - b.x, a.y - b.y, a.z - b.z }; }
static float dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static vec along(vec a, float t, vec d) { return (vec){ a.x + t * d.x, a.y + t * d.y, a.z + t * d.z }; }

static vec closest(vec p, vec a, vec b, vec c)
{
    const vec ab = sub(b, a), ac = sub(c, a), ap = sub(p, a), bp = sub(p, b), cp = sub(p, c);
    const float d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp), d5 = dot(ab, cp),
                d6 = dot(ac, cp);
    if (d1 <= 0 && d2 <= 0) return a;
    if (d3 >= 0 && d4 <= d3) return b;
    if (d6 >= 0 && d5 <= d6) return c;
    const float vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return along(a, d1 / (d1 - d3), ab);
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return along(a, d2 / (d2 - d6), ac);
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return along(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), sub(c, b));
    const float scale = 1 / (va + vb + vc);
    return along(along(a, vb * scale, ab), vc * scale, ac);
}

static bool meet(struct RTCPointQueryFunctionArguments *arguments)
{
    query *q = arguments->userPtr;
    const float *v = q->embree->vertices;
    const int32_t *f = q->embree->faces + 3 * (int64_t)arguments->primID;
    vec corner[3];
    for (int k = 0; k < 3; k++) corner[k] = (vec){ v[3 * f[k]], v[3 * f[k] + 1], v[3 * f[k] + 2] };
    const vec p = { q->point[0], q->point[1], q->point[2] }, d = sub(closest(p, corner[0], corner[1], corner[2]), p);
    const float distance2 = dot(d, d);
    if (distance2 >= q->distance2) return false;
    q->distance2 = distance2;
    q->triangle = (int32_t)arguments->primID;
    arguments->query->radius = sqrtf(distance2);
    return true;
}

void bench_embree_query(bench_embree *e, const float *vertices, float reach, int64_t n, const float *points,
                        int32_t *triangle, float *distance)
{
    memcpy(e->vertices, vertices, (size_t)e->n_vertices * 3 * sizeof *vertices);
    rtcUpdateGeometryBuffer(e->geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(e->geometry);
    if (!e->attached) rtcAttachGeometry(e->scene, e->geometry); /* once it has vertices */
    e->attached = true;
    rtcCommitScene(e->scene);
#pragma omp parallel for schedule(static) num_threads(BENCH_THREADS)
    for (int64_t i = 0; i < n; i++) {
        struct RTCPointQueryContext context;
        rtcInitPointQueryContext(&context);
        query q = { .embree = e,
                    .point = { points[3 * i], points[3 * i + 1], points[3 * i + 2] },
                    .distance2 = isfinite(reach) ? reach * reach : FLT_MAX,
                    .triangle = -1 };
        struct RTCPointQuery ask = {
            .x = q.point[0], .y = q.point[1], .z = q.point[2], .radius = isfinite(reach) ? reach : INFINITY, .time = 0
        };
        rtcPointQuery(e->scene, &ask, &context, meet, &q);
        triangle[i] = q.triangle;
        distance[i] = sqrtf(q.distance2);
    }
}
