/* The surface of the procedural bust: ellipsoids and tapered capsules joined by smooth minima, meshed by surface nets
 * (Gibson 1998): one vertex per grid cell that the surface passes, drawn onto the surface and evened out along it. */
#include "scene/bust.h"

#include <stdlib.h>
#include <string.h>

/* ---- the implicit surface ----------------------------------------------------------------------------------- */

/* Distance to an ellipsoid, exact to first order near its surface. */
static double ellipsoid(hg_vec3d p, hg_vec3d centre, hg_vec3d radius)
{
    hg_vec3d d = hg_vec3d_sub(p, centre);
    hg_vec3d a = hg_vec3d_make(d.x / radius.x, d.y / radius.y, d.z / radius.z);
    hg_vec3d b = hg_vec3d_make(a.x / radius.x, a.y / radius.y, a.z / radius.z);
    double length = hg_vec3d_norm(a), slope = hg_vec3d_norm(b);
    return slope > 1e-9 ? length * (length - 1) / slope : -fmin(radius.x, fmin(radius.y, radius.z));
}

static double capsule(hg_vec3d p, hg_vec3d a, double radius_a, hg_vec3d b, double radius_b)
{
    hg_vec3d axis = hg_vec3d_sub(b, a);
    double t = hg_vec3d_dot(hg_vec3d_sub(p, a), axis) / hg_vec3d_norm2(axis);
    t = fmin(fmax(t, 0), 1);
    return hg_vec3d_distance(p, hg_vec3d_add_scaled(a, t, axis)) - (radius_a + t * (radius_b - radius_a));
}

/* Minimum with the crease filled over the width k; maximum with the edge rounded. */
static double join(double a, double b, double k)
{
    double h = fmax(k - fabs(a - b), 0) / k;
    return fmin(a, b) - 0.25 * h * h * k;
}

static double cut(double a, double b, double k) { return -join(-a, -b, k); }

#define AT hg_vec3d_make

/* x is |x|: both sides are the same. */
static double head_distance(hg_vec3d p)
{
    double d = ellipsoid(p, AT(0, 0.758, 0.026), AT(0.0765, 0.084, 0.0955));                /* cranium */
    d = join(d, ellipsoid(p, AT(0, 0.742, 0.078), AT(0.0655, 0.062, 0.056)), 0.03);         /* forehead and temples */
    d = join(d, ellipsoid(p, AT(0, 0.686, 0.070), AT(0.0575, 0.072, 0.058)), 0.04);         /* face */
    d = join(d, ellipsoid(p, AT(0.028, 0.660, 0.055), AT(0.028, 0.032, 0.045)), 0.03);      /* jaw */
    d = join(d, ellipsoid(p, AT(0, 0.632, 0.112), AT(0.022, 0.017, 0.017)), 0.03);          /* chin */
    d = join(d, ellipsoid(p, AT(0.037, 0.706, 0.104), AT(0.022, 0.018, 0.020)), 0.025);     /* cheekbone */
    d = join(d, ellipsoid(p, AT(0.026, 0.7545, 0.124), AT(0.026, 0.008, 0.010)), 0.018);    /* brow */
    d = cut(d, -ellipsoid(p, AT(0.0315, 0.736, 0.143), AT(0.019, 0.0125, 0.019)), 0.010);   /* eye socket */
    d = join(d, ellipsoid(p, AT(0.0315, 0.736, 0.114), AT(0.0125, 0.0115, 0.0125)), 0.003); /* eye */
    d = cut(d, 0.0012 - capsule(p, AT(0.020, 0.7345, 0.130), 0, AT(0.043, 0.7345, 0.120), 0), 0.003); /* lids */
    d = join(d, capsule(p, AT(0, 0.744, 0.128), 0.006, AT(0, 0.706, 0.147), 0.0100), 0.012);          /* nose */
    d = join(d, ellipsoid(p, AT(0.0105, 0.702, 0.139), AT(0.0075, 0.0075, 0.010)), 0.006);            /* its wings */
    d = join(d, ellipsoid(p, AT(0, 0.679, 0.106), AT(0.033, 0.028, 0.024)), 0.016);        /* round the mouth */
    d = join(d, ellipsoid(p, AT(0.005, 0.6740, 0.1285), AT(0.017, 0.0055, 0.008)), 0.005); /* lips */
    d = join(d, ellipsoid(p, AT(0, 0.6630, 0.1270), AT(0.016, 0.0065, 0.008)), 0.005);
    d = cut(d, 0.0022 - capsule(p, AT(0, 0.6685, 0.1350), 0, AT(0.025, 0.6680, 0.123), 0), 0.003); /* mouth */
    return join(d, ellipsoid(p, AT(0.078, 0.722, 0.022), AT(0.0085, 0.031, 0.018)), 0.010);        /* ear */
}

static double neck_distance(hg_vec3d p)
{
    double d = capsule(p, AT(0, 0.545, -0.018), 0.060, AT(0, 0.70, 0.012), 0.054);
    return join(d, capsule(p, AT(0.012, 0.540, 0.045), 0.010, AT(0.050, 0.690, 0.010), 0.014),
                0.03); /* the muscle to the ear */
}

static double torso_distance(hg_vec3d p)
{
    double d = ellipsoid(p, AT(0, 0.420, -0.006), AT(0.152, 0.155, 0.092));             /* chest */
    d = join(d, ellipsoid(p, AT(0.070, 0.425, 0.040), AT(0.070, 0.070, 0.046)), 0.06);  /* breast */
    d = join(d, ellipsoid(p, AT(0.070, 0.440, -0.070), AT(0.070, 0.085, 0.035)), 0.05); /* shoulder blade */
    d = join(d, capsule(p, AT(0.020, 0.585, -0.028), 0.040, AT(0.160, 0.520, -0.018), 0.034), 0.05); /* trapezius */
    d = join(d, capsule(p, AT(0.010, 0.528, 0.040), 0.018, AT(0.150, 0.535, 0.000), 0.020), 0.045);  /* collar bone */
    d = join(d, ellipsoid(p, AT(0.170, 0.500, -0.012), AT(0.048, 0.058, 0.052)), 0.05);              /* shoulder */
    d = join(d, capsule(p, AT(0.174, 0.500, -0.014), 0.044, AT(0.194, 0.340, -0.018), 0.040), 0.05); /* arm */
    double below = 0.345 + 0.075 * scene_ramp(0.06, 0.22, p.x); /* sculptors cut higher under the arms */
    return cut(d, below - p.y, 0.035);
}

bust_distance bust_measure(hg_vec3d p)
{
    bust_distance d;
    p.x = fabs(p.x);
    d.head = head_distance(p), d.neck = neck_distance(p), d.torso = torso_distance(p);
    d.all = join(join(d.head, d.neck, 0.025), d.torso, 0.045);
    return d;
}

static hg_vec3d gradient(hg_vec3d p)
{
    const double e = 1e-5;
    return hg_vec3d_scale(AT(bust_measure(AT(p.x + e, p.y, p.z)).all - bust_measure(AT(p.x - e, p.y, p.z)).all,
                             bust_measure(AT(p.x, p.y + e, p.z)).all - bust_measure(AT(p.x, p.y - e, p.z)).all,
                             bust_measure(AT(p.x, p.y, p.z + e)).all - bust_measure(AT(p.x, p.y, p.z - e)).all),
                          0.5 / e);
}

hg_vec3d bust_normal(hg_vec3d p) { return hg_vec3d_normalize(gradient(p)); }

/* ---- the mesh ----------------------------------------------------------------------------------------------- */

static const double low[3] = { -0.27, 0.30, -0.15 }, high[3] = { 0.27, 0.87, 0.19 };

typedef struct {
    int n[3]; /* grid points along each axis; even number of cells along x, so that the mesh is symmetric */
    double cell;
    double *value;   /* at grid points */
    int32_t *vertex; /* of cells (by their low corner), -1: the surface does not pass */
} net;

static int64_t net_index(const net *g, int x, int y, int z) { return ((int64_t)z * g->n[1] + y) * g->n[0] + x; }

static hg_vec3d net_point(const net *g, int x, int y, int z)
{
    return AT((x - (g->n[0] - 1) / 2) * g->cell, low[1] + y * g->cell, low[2] + z * g->cell);
}

/* The mean of the points where the surface cuts the edges of a cell; false when it cuts none. */
static bool cell_vertex(const net *g, int x, int y, int z, hg_vec3d *vertex)
{
    hg_vec3d sum = { 0 };
    int cuts = 0;
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 4; k++) {
            int a[3] = { x, y, z }, b[3];
            a[(axis + 1) % 3] += k & 1, a[(axis + 2) % 3] += k >> 1;
            for (int c = 0; c < 3; c++) b[c] = a[c] + (c == axis);
            double fa = g->value[net_index(g, a[0], a[1], a[2])], fb = g->value[net_index(g, b[0], b[1], b[2])];
            if ((fa < 0) == (fb < 0)) continue;
            hg_vec3d pa = net_point(g, a[0], a[1], a[2]), pb = net_point(g, b[0], b[1], b[2]);
            sum = hg_vec3d_add(sum, hg_vec3d_mix(pa, pb, fa / (fa - fb)));
            cuts++;
        }
    if (cuts) *vertex = hg_vec3d_scale(sum, 1.0 / cuts);
    return cuts > 0;
}

/* Onto the surface, a few steps of Newton. */
static hg_vec3d onto_surface(hg_vec3d p)
{
    for (int i = 0; i < 4; i++) {
        double distance = bust_measure(p).all;
        if (fabs(distance) < 1e-7) break;
        hg_vec3d slope = gradient(p);
        p = hg_vec3d_add_scaled(p, -distance / fmax(hg_vec3d_norm2(slope), 0.1), slope);
    }
    return p;
}

/* Every edge of the grid that the surface cuts makes a quad of the four cells around it, cut at its shorter diagonal. */
static int64_t net_faces(const net *g, const hg_vec3d *at, int32_t *triangles)
{
    int64_t faces = 0;
    for (int z = 1; z + 1 < g->n[2]; z++)
        for (int y = 1; y + 1 < g->n[1]; y++)
            for (int x = 1; x + 1 < g->n[0]; x++)
                for (int axis = 0; axis < 3; axis++) {
                    int next[3] = { x + (axis == 0), y + (axis == 1), z + (axis == 2) };
                    bool inside = g->value[net_index(g, x, y, z)] < 0;
                    if (inside == (g->value[net_index(g, next[0], next[1], next[2])] < 0)) continue;
                    int32_t quad[4];
                    for (int k = 0; k < 4; k++) {
                        int c[3] = { x, y, z };
                        c[(axis + 1) % 3] -= k == 1 || k == 2, c[(axis + 2) % 3] -= k >= 2;
                        quad[inside ? k : 3 - k] = g->vertex[net_index(g, c[0], c[1], c[2])];
                    }
                    bool other =
                        hg_vec3d_distance(at[quad[1]], at[quad[3]]) < hg_vec3d_distance(at[quad[0]], at[quad[2]]);
                    for (int k = 0; k < 6 && triangles; k++) {
                        static const int corner[2][6] = { { 0, 1, 2, 0, 2, 3 }, { 0, 1, 3, 1, 2, 3 } };
                        triangles[3 * faces + k] = quad[corner[other][k]];
                    }
                    faces += 2;
                }
    return faces;
}

typedef struct {
    int64_t vertices, faces;
    hg_vec3d *at;
    int32_t *triangles;
} mesh;

/* Moves vertices towards the mean of their neighbours and back onto the surface: triangles of even size. */
static hg_status relax(mesh *m, int rounds)
{
    hg_vec3d *sum = hg_alloc((size_t)m->vertices, sizeof *sum);
    double *count = hg_alloc((size_t)m->vertices, sizeof *count);
    for (int round = 0; round < rounds && sum && count; round++) {
        for (int64_t v = 0; v < m->vertices; v++) sum[v] = (hg_vec3d){ 0 }, count[v] = 0;
        for (int64_t i = 0; i < 3 * m->faces; i++) { /* each edge is met once in each direction */
            int32_t a = m->triangles[i], b = m->triangles[i % 3 == 2 ? i - 2 : i + 1];
            sum[a] = hg_vec3d_add(sum[a], m->at[b]), count[a]++;
        }
        for (int64_t v = 0; v < m->vertices; v++)
            m->at[v] = onto_surface(hg_vec3d_mix(m->at[v], hg_vec3d_scale(sum[v], 1 / count[v]), 0.5));
    }
    hg_status status = sum && count ? HG_OK : HG_MEMORY;
    hg_free(sum);
    hg_free(count);
    return status;
}

static hg_status net_create(net *g, mesh *m)
{
    for (int z = 0; z < g->n[2]; z++)
        for (int y = 0; y < g->n[1]; y++)
            for (int x = 0; x < g->n[0]; x++) {
                g->value[net_index(g, x, y, z)] = bust_measure(net_point(g, x, y, z)).all;
                g->vertex[net_index(g, x, y, z)] = -1;
            }
    for (int pass = 0; pass < 2; pass++) { /* count, then place */
        m->vertices = 0;
        for (int z = 0; z + 1 < g->n[2]; z++)
            for (int y = 0; y + 1 < g->n[1]; y++)
                for (int x = 0; x + 1 < g->n[0]; x++) {
                    hg_vec3d p;
                    if (!cell_vertex(g, x, y, z, &p)) continue;
                    if (pass) m->at[m->vertices] = onto_surface(p);
                    g->vertex[net_index(g, x, y, z)] = (int32_t)m->vertices++;
                }
        if (pass == 0 && !(m->at = hg_alloc((size_t)m->vertices, sizeof *m->at))) return HG_MEMORY;
    }
    m->faces = net_faces(g, m->at, NULL);
    m->triangles = hg_alloc((size_t)m->faces, 3 * sizeof *m->triangles);
    if (!m->triangles) return HG_MEMORY;
    net_faces(g, m->at, m->triangles);
    HG_TRY(relax(m, 6));
    net_faces(g, m->at, m->triangles); /* the diagonals that are shorter now */
    return HG_OK;
}

/* ---- finer in the face -------------------------------------------------------------------------------------- */

static bool in_face(hg_vec3d p) { return p.z > 0.075 && p.y > 0.605 && p.y < 0.775 && fabs(p.x) < 0.065; }

typedef struct {
    int32_t a, b; /* a < b */
} edge;

static int compare_edges(const void *left, const void *right)
{
    const edge *x = left, *y = right;
    return x->a != y->a ? (x->a > y->a) - (x->a < y->a) : (x->b > y->b) - (x->b < y->b);
}

/* Number among the edges that are cut, -1: not cut. */
static int64_t find_edge(const edge *edges, int64_t n, int32_t a, int32_t b)
{
    edge key = { a < b ? a : b, a < b ? b : a };
    const edge *found = bsearch(&key, edges, (size_t)n, sizeof key, compare_edges);
    return found ? found - edges : -1;
}

/* The triangles that take the place of one whose edges (0-1, 1-2, 2-0) have the middles `m`, -1: none. Returns how many. */
static int cut_triangle(const int32_t corner[3], const int32_t m[3], int32_t out[12])
{
    int cuts = (m[0] >= 0) + (m[1] >= 0) + (m[2] >= 0), k = 0;
    if (cuts == 3) {
        const int32_t four[12] = {
            corner[0], m[0], m[2], corner[1], m[1], m[0], corner[2], m[2], m[1], m[0], m[1], m[2]
        };
        memcpy(out, four, sizeof four);
        return 4;
    }
    if (cuts == 0) {
        memcpy(out, corner, 3 * sizeof *out);
        return 1;
    }
    while (cuts == 1 ? m[k] < 0 : m[k] >= 0) k++; /* the edge that is cut; of two, the one that is not */
    int32_t a = corner[k], b = corner[(k + 1) % 3], c = corner[(k + 2) % 3];
    if (cuts == 1) {
        const int32_t two[6] = { a, m[k], c, m[k], b, c };
        memcpy(out, two, sizeof two);
        return 2;
    }
    int32_t bc = m[(k + 1) % 3], ca = m[(k + 2) % 3];
    const int32_t three[9] = { a, b, bc, a, bc, ca, ca, bc, c };
    memcpy(out, three, sizeof three);
    return 3;
}

/* Cuts every edge of the face in two, and the triangles with them. */
static hg_status refine_face(mesh *m)
{
    int64_t n = 0, faces = 0;
    edge *edges = hg_alloc((size_t)m->faces, 3 * sizeof *edges);
    int32_t *triangles = hg_alloc((size_t)m->faces, 12 * sizeof *triangles);
    hg_vec3d *at = NULL;
    if (edges && triangles) {
        for (int64_t i = 0; i < 3 * m->faces; i++) {
            int32_t a = m->triangles[i], b = m->triangles[i % 3 == 2 ? i - 2 : i + 1];
            if (a < b && in_face(hg_vec3d_mix(m->at[a], m->at[b], 0.5))) edges[n++] = (edge){ a, b };
        }
        qsort(edges, (size_t)n, sizeof *edges, compare_edges);
        at = hg_resize(m->at, (size_t)m->vertices, (size_t)(m->vertices + n), sizeof *at);
    }
    if (!at) {
        hg_free(edges);
        hg_free(triangles);
        return HG_MEMORY;
    }
    m->at = at;
    for (int64_t i = 0; i < n; i++)
        at[m->vertices + i] = onto_surface(hg_vec3d_mix(at[edges[i].a], at[edges[i].b], 0.5));
    for (int64_t f = 0; f < m->faces; f++) {
        const int32_t *t = m->triangles + 3 * f;
        int32_t middle[3];
        for (int k = 0; k < 3; k++) {
            int64_t cut = find_edge(edges, n, t[k], t[(k + 1) % 3]);
            middle[k] = cut < 0 ? -1 : (int32_t)(m->vertices + cut);
        }
        faces += cut_triangle(t, middle, triangles + 3 * faces);
    }
    hg_free(edges);
    hg_free(m->triangles);
    m->triangles = triangles, m->vertices += n, m->faces = faces;
    return relax(m, 2);
}

hg_status bust_mesh(double cell, int64_t *vertices, float **points, int64_t *faces, int32_t **triangles)
{
    net g = { .cell = cell };
    mesh m = { 0 };
    *points = NULL, *triangles = NULL;
    g.n[0] = 2 * (int)ceil(high[0] / cell) + 1;
    for (int i = 1; i < 3; i++) g.n[i] = (int)ceil((high[i] - low[i]) / cell) + 1;
    size_t count = (size_t)g.n[0] * (size_t)g.n[1] * (size_t)g.n[2];
    g.value = hg_alloc(count, sizeof *g.value);
    g.vertex = hg_alloc(count, sizeof *g.vertex);
    hg_status status = g.value && g.vertex ? net_create(&g, &m) : HG_MEMORY;
    hg_free(g.value);
    hg_free(g.vertex);
    if (status == HG_OK) status = refine_face(&m);
    if (status == HG_OK && !(*points = hg_alloc((size_t)m.vertices, 3 * sizeof **points))) status = HG_MEMORY;
    for (int64_t v = 0; status == HG_OK && v < m.vertices; v++) scene_put(*points + 3 * v, m.at[v]);
    hg_free(m.at);
    if (status != HG_OK) {
        hg_free(m.triangles);
        return status;
    }
    *vertices = m.vertices, *faces = m.faces, *triangles = m.triangles;
    return HG_OK;
}
