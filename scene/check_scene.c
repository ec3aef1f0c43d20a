/* What is wrong, or odd, with a body or a motion that could be read: what the readers cannot know to be a mistake. */
#include "scene/internal.h"

#include <stdlib.h>
#include <string.h>

/* ---- body --------------------------------------------------------------------------------------------------- */

typedef struct {
    int32_t low, high, way; /* way: +1 from low to high, -1 the other way */
} edge;

static int compare_edges(const void *a, const void *b)
{
    const edge *p = a, *q = b;
    if (p->low != q->low) return p->low < q->low ? -1 : 1;
    return (p->high > q->high) - (p->high < q->high);
}

static hg_vec3d corner(const hg_body *body, int64_t face, int c)
{
    return scene_point(body->points + 3 * (int64_t)body->triangles[3 * face + c]);
}

static hg_status say_surface(hg_findings *findings, const hg_body *body)
{
    int64_t n = 3 * body->faces, open = 0, crowded = 0, turned = 0, flat = 0;
    double volume = 0;
    edge *edges = hg_alloc((size_t)n, sizeof *edges);
    if (!edges) return HG_MEMORY;
    for (int64_t f = 0; f < body->faces; f++) {
        hg_vec3d a = corner(body, f, 0), b = corner(body, f, 1), c = corner(body, f, 2);
        hg_vec3d normal = hg_vec3d_cross(hg_vec3d_sub(b, a), hg_vec3d_sub(c, a));
        flat += hg_vec3d_norm(normal) < 1e-14;
        volume += hg_vec3d_dot(a, normal) / 6;
        for (int k = 0; k < 3; k++) {
            int32_t from = body->triangles[3 * f + k], to = body->triangles[3 * f + (k + 1) % 3];
            edges[3 * f + k] = from < to ? (edge){ from, to, 1 } : (edge){ to, from, -1 };
        }
    }
    qsort(edges, (size_t)n, sizeof *edges, compare_edges);
    for (int64_t i = 0, next; i < n; i = next) {
        int ways = 0;
        for (next = i; next < n && compare_edges(&edges[i], &edges[next]) == 0; next++) ways += edges[next].way;
        open += next - i == 1;
        crowded += next - i > 2;
        turned += next - i == 2 && ways != 0;
    }
    hg_free(edges);
    hg_findings_add(findings, HG_FINE, "mesh", "%lld vertices, %lld triangles, volume %.4g m3",
                    (long long)body->vertices, (long long)body->faces, volume);
    if (open || crowded || turned)
        hg_findings_add(findings, HG_WARNING, "mesh",
                        "%lld edges have one triangle, %lld more than two, %lld two that face opposite ways: near them "
                        "inside and outside cannot be told apart",
                        (long long)open, (long long)crowded, (long long)turned);
    if (volume < 0)
        hg_findings_add(findings, HG_ERROR, "mesh",
                        "it is inside out: corners have to be counter-clockwise from outside");
    if (flat) hg_findings_add(findings, HG_WARNING, "mesh", "%lld triangles have no area", (long long)flat);
    return HG_OK;
}

static void say_size(hg_findings *findings, const hg_body *body)
{
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY }, area = 0;
    int tallest = 0;
    for (int64_t i = 0; i < 3 * body->vertices; i++) {
        low[i % 3] = fmin(low[i % 3], (double)body->points[i]);
        high[i % 3] = fmax(high[i % 3], (double)body->points[i]);
    }
    for (int k = 1; k < 3; k++)
        if (high[k] - low[k] > high[tallest] - low[tallest]) tallest = k;
    double most = high[tallest] - low[tallest];
    bool human = most > 0.15 && most < 3;
    hg_findings_add(findings, human ? HG_FINE : HG_WARNING, "unit", "%.4g x %.4g x %.4g m%s", high[0] - low[0],
                    high[1] - low[1], high[2] - low[2], human ? "" : ": not the size of a person or a bust in metres");
    for (int64_t i = 0; i < body->scalp_faces; i++) {
        hg_vec3d a = corner(body, body->scalp[i], 0), b = corner(body, body->scalp[i], 1),
                 c = corner(body, body->scalp[i], 2);
        area += 0.5 * hg_vec3d_norm(hg_vec3d_cross(hg_vec3d_sub(b, a), hg_vec3d_sub(c, a)));
    }
    bool scalp = area > 0.01 && area < 0.2;
    hg_findings_add(findings, scalp ? HG_FINE : HG_WARNING, "scalp", "%lld triangles, %.4g m2%s",
                    (long long)body->scalp_faces, area, scalp ? "" : "; a head has about 0.06 m2");
    int64_t uncovered = 0;
    for (int64_t i = 0, k = 0; i < body->scalp_faces; i++) {
        while (k < body->collider_faces && body->collider[k] < body->scalp[i]) k++;
        uncovered += k == body->collider_faces || body->collider[k] != body->scalp[i];
    }
    hg_findings_add(findings, uncovered ? HG_WARNING : HG_FINE, "collider",
                    uncovered ? "%lld triangles, without %lld of the scalp"
                              : "%lld triangles, all of the scalp among them",
                    (long long)body->collider_faces, (long long)uncovered);
}

static void say_joints(hg_findings *findings, const hg_body *body)
{
    static const char *const usual[] = { "Hips",  "LowerBack", "Spine1",       "Neck",
                                         "Neck1", "Head",      "LeftShoulder", "RightShoulder" };
    hg_text missing = { 0 };
    for (int i = 0; i < 8; i++)
        if (hg_body_joint(body, usual[i]) < 0) hg_text_add(&missing, "%s%s", missing.size ? ", " : "", usual[i]);
    if (missing.size)
        hg_findings_add(findings, HG_WARNING, "joints",
                        "%lld joints without %s: recipes have to name others (features.pose_joints, "
                        "features.velocity_joints)",
                        (long long)body->joints, missing.data);
    else
        hg_findings_add(findings, HG_FINE, "joints", "%lld, with all that recipes look at", (long long)body->joints);
    hg_text_free(&missing);
    int moving = 0;
    for (int k = 0; k < HG_SHAPES; k++) {
        float most = 0;
        for (int64_t i = 0; i < 3 * body->vertices; i++)
            most = fmaxf(most, fabsf(body->shapes[3 * body->vertices * k + i]));
        moving += most > 1e-6f && body->shape_spread[k] > 0;
    }
    hg_findings_add(findings, HG_FINE, "shapes", "%d of %d directions change something", moving, HG_SHAPES);
}

hg_status hg_check_body(hg_findings *findings, const hg_body *body)
{
    HG_TRY(say_surface(findings, body));
    say_size(findings, body);
    say_joints(findings, body);
    return findings->failed ? HG_MEMORY : HG_OK;
}

/* ---- motion ------------------------------------------------------------------------------------------------- */

static void say_turns(hg_findings *findings, const hg_motion *m)
{
    double most = 0, moved = 0;
    int64_t at = 0, joint = 0;
    for (int64_t t = 1; t < m->frames; t++)
        for (int64_t j = 0; j < m->joints; j++) {
            const float *q = m->rotation + 4 * (t * m->joints + j);
            hg_quatd now = hg_quatd_normalize(hg_quatd_from_f(hg_quatf_load(q)));
            hg_quatd before = hg_quatd_normalize(hg_quatd_from_f(hg_quatf_load(q - 4 * m->joints)));
            double turn = hg_vec3d_norm(hg_quatd_to_rotation_vector(hg_quatd_mul(now, hg_quatd_conj(before))));
            moved += turn;
            if (turn > most) most = turn, at = t, joint = j;
        }
    double speed = most * m->rate * 180 / SCENE_PI;
    if (m->frames > 1 && moved < 1e-4)
        hg_findings_add(findings, HG_WARNING, "turns", "no joint turns: the clip stands still");
    else
        hg_findings_add(findings, speed > 2500 ? HG_WARNING : HG_FINE, "turns",
                        "at most %.0f degrees/s, %s in frame %lld%s", speed, m->joint_name[joint], (long long)at,
                        speed > 2500 ? ": a jump in the recording?" : "");
}

static void say_way(hg_findings *findings, const hg_motion *m)
{
    double most = 0, far = 0;
    int64_t at = 0;
    for (int64_t t = 0; t < m->frames; t++) {
        hg_vec3d now = scene_point(m->translation + 3 * t);
        far = fmax(far, hg_vec3d_norm(now));
        if (t == 0) continue;
        double step = hg_vec3d_distance(now, scene_point(m->translation + 3 * t - 3));
        if (step > most) most = step, at = t;
    }
    double speed = most * m->rate;
    bool odd = speed > 12 || far > 100;
    hg_findings_add(findings, odd ? HG_WARNING : HG_FINE, "way",
                    "the root moves at most %.3g m/s (frame %lld), up to %.3g m from its rest place%s", speed,
                    (long long)at, far, odd ? ": are these metres?" : "");
}

static void list_others(hg_text *text, char *const *names, int64_t n, char *const *in, int64_t n_in)
{
    for (int64_t i = 0; i < n; i++) {
        bool found = false;
        for (int64_t k = 0; k < n_in && !found; k++) found = strcmp(names[i], in[k]) == 0;
        if (!found && text->size < 300) hg_text_add(text, "%s%.40s", text->size ? ", " : "", names[i]);
    }
}

hg_status hg_check_motion(hg_findings *findings, const hg_motion *m, const hg_body *body)
{
    double seconds = (double)(m->frames - 1) / m->rate;
    bool odd = m->frames < 2 || seconds < 0.5 || m->rate < 10 || m->rate > 500;
    hg_findings_add(findings, odd ? HG_WARNING : HG_FINE, "clip", "%lld frames at %g per second, %.3g s%s",
                    (long long)m->frames, m->rate, seconds, odd ? ": a very short clip, or an odd rate" : "");
    say_turns(findings, m);
    say_way(findings, m);
    if (body) {
        hg_text missing = { 0 }, extra = { 0 };
        list_others(&missing, body->joint_name, body->joints, m->joint_name, m->joints);
        list_others(&extra, m->joint_name, m->joints, body->joint_name, body->joints);
        if (missing.size || extra.size)
            hg_findings_add(findings, HG_ERROR, "joints",
                            "not those of the body: missing %s; more %s; import the motion for this body",
                            missing.size ? missing.data : "none", extra.size ? extra.data : "none");
        else
            hg_findings_add(findings, HG_FINE, "joints", "%lld, those of the body", (long long)m->joints);
        hg_text_free(&missing);
        hg_text_free(&extra);
    }
    return findings->failed ? HG_MEMORY : HG_OK;
}
