/* xpbd_contact: what strands meet between substeps. The body as planes of contact; each other, pushed apart by half each
 * (Jacobi: every vertex is moved by the mean of what its neighbours ask for, all from the places before). Vertices meet vertices: strands
 * may still slip between each other. */
#include "solvers/xpbd.h"

#include <math.h>

static double distance(const double *a, const double *b)
{
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

/* A vertex that was farther out than it went since, and the body with it, is still outside: it is not searched for. */
hg_status hg_xpbd_find_contact(hg_xpbd *s, double part, double way)
{
    const int64_t n = 3 * hg_body_tree_vertices(s->tree);
    const double reach = 4 * s->contact_distance;
    if (!s->fitted) {
        for (int64_t i = 0; i < n; i++)
            s->body[i] = part < 1 ? s->body_from[i] + part * (s->body_to[i] - s->body_from[i]) : s->body_to[i];
        HG_TRY(hg_body_refit_update(s->ctx, s->refit, s->body));
        s->fitted = s->body_way == 0;
    }
    s->asked = 0;
    for (int64_t i = 0; i < s->S * s->V; i++) {
        double *was = s->searched + 3 * i;
        const double *x = s->points + 3 * i;
        const double gone = way + distance(x, was);
        if (gone == 0 && s->known) continue;
        s->room[i] -= gone;
        for (int c = 0; c < 3; c++) was[c] = x[c];
        if (s->room[i] > 0) continue;
        const int64_t k = s->asked++;
        s->ask[k] = (int32_t)i;
        s->ask_triangle[k] = s->triangle[i];
        for (int c = 0; c < 3; c++) s->ask_point[3 * k + c] = x[c];
    }
    s->known = true;
    HG_TRY(hg_body_closest(s->ctx, s->refit, s->mode, reach, s->asked, s->ask_point, s->ask_triangle, s->ask_contact,
                           s->ask_normal));
    for (int64_t k = 0; k < s->asked; k++) {
        const int64_t i = s->ask[k];
        double out = 0;
        s->triangle[i] = s->ask_triangle[k];
        for (int c = 0; c < 3; c++) {
            s->contact_point[3 * i + c] = s->ask_contact[3 * k + c];
            s->contact_normal[3 * i + c] = s->ask_normal[3 * k + c];
            out += s->ask_normal[3 * k + c] * (s->ask_point[3 * k + c] - s->ask_contact[3 * k + c]);
        }
        s->room[i] = s->ask_triangle[k] < 0 || s->mode == HG_CONTACT_EXACT ? out - s->contact_distance : 0;
        if (s->ask_triangle[k] < 0) /* a plane that is never reached, whatever the way */
            for (int c = 0; c < 3; c++) s->contact_normal[3 * i + c] = 0, s->contact_point[3 * i + c] = 0;
    }
    return HG_OK;
}

static void push_range(const void *args, int64_t first, int64_t last)
{
    const hg_xpbd *s = *(hg_xpbd *const *)args;
    const int64_t *start = hg_neighbours_start(s->neighbours);
    const int32_t *list = hg_neighbours_list(s->neighbours);
    for (int64_t i = first; i < last; i++) {
        double *push = s->push + 3 * i, count = 0;
        push[0] = push[1] = push[2] = 0;
        if (i % s->V < s->pinned) continue;
        for (int64_t k = start[i]; k < start[i + 1]; k++) {
            const int64_t j = list[k];
            if (j / s->V == i / s->V) continue;
            const double now = distance(s->points + 3 * i, s->points + 3 * j);
            const double wanted = fmin(s->options.strand_distance, distance(s->rest + 3 * i, s->rest + 3 * j));
            if (!(now < wanted) || !(now > 0)) continue;
            const double share = (j % s->V < s->pinned ? 1 : 0.5) * (wanted - now) / now;
            for (int c = 0; c < 3; c++) push[c] += share * (s->points[3 * i + c] - s->points[3 * j + c]);
            count++;
        }
        for (int c = 0; count && c < 3; c++) push[c] /= count;
    }
}

static void move_range(const void *args, int64_t first, int64_t last)
{
    const hg_xpbd *s = *(hg_xpbd *const *)args;
    for (int64_t k = 3 * first; k < 3 * last; k++) s->points[k] += s->push[k];
}

hg_status hg_xpbd_part_strands(hg_xpbd *s)
{
    static const hg_kernel push = { .name = "xpbd_push", .args_size = sizeof s, .cpu = push_range, .block = 256 };
    static const hg_kernel move = { .name = "xpbd_move", .args_size = sizeof s, .cpu = move_range, .block = 4096 };
    HG_TRY(
        hg_neighbours_build(s->ctx, s->neighbours, HG_F64, s->S * s->V, s->points, s->options.strand_distance, NULL));
    HG_TRY(hg_launch(s->ctx, &push, s->S * s->V, &s));
    return hg_launch(s->ctx, &move, s->S * s->V, &s);
}
