/* Procedural grooms. As in AMS (Herrera et al. 2025, appendix C) a strand is a helix of a radius and a step about a centre
 * line that gravity bends. Here the centre line is first combed: it leaves the scalp away from a parting, slides along the
 * body, is drawn into its lock and hangs. */
#include "scene/roots.h"

#include <string.h>

#define STEP 0.003 /* m, of centre lines */
enum { STRANDS_PER_LOCK = 28, CLOSER = 4 /* points of the helix per point of the centre line */ };

typedef struct {
    const char *name;
    double length, variation; /* of the centre line [m]; its relative deviation */
    double lift;              /* 0: along the scalp, 1: straight out */
    double bend;              /* m, over which gravity turns a strand downwards */
    double radius, step;      /* of the helix [m] */
    double volume;            /* m, how far strands lie above the body, in the mean */
    double lock;              /* 0..1, how far tips are drawn together */
    double parting;           /* 0: none, 1: a sharp one */
} growth;

static const growth styles[] = {
    { "straight", 0.23, 0.06, 0.30, 0.040, 0.0000, 0.100, 0.010, 0.45, 1.0 },
    { "wavy", 0.25, 0.07, 0.35, 0.040, 0.0055, 0.058, 0.014, 0.60, 0.9 },
    { "curly", 0.17, 0.08, 0.50, 0.060, 0.0085, 0.036, 0.022, 0.55, 0.6 },
    { "short", 0.055, 0.10, 0.45, 0.090, 0.0000, 0.100, 0.007, 0.30, 0.7 },
    { "long", 0.36, 0.06, 0.28, 0.035, 0.0035, 0.110, 0.012, 0.55, 1.0 },
};

enum { STYLES = sizeof styles / sizeof *styles };

typedef struct {
    const growth *style;
    const hg_body *body;
    uint64_t seed;
    int64_t strands, points;    /* of a centre line */
    hg_vec3d *line;             /* [strands,points] */
    hg_vec3d *normal, *comb;    /* [strands] of the scalp at the root; the way hair is combed there */
    double *length, *clearance; /* [strands] */
    int32_t *lock;              /* [strands] the strand that leads the lock */
    hg_body_tree *tree;
    hg_body_refit *refit;
    float *at, *contact, *contact_normal; /* [strands,3] */
    int32_t *triangle;
} garden;

static double chance(const garden *g, uint64_t stream, int64_t i)
{
    return hg_random_uniform(g->seed, 100 + stream, (uint64_t)i);
}

/* ---- combing ------------------------------------------------------------------------------------------------ */

/* The way hair is combed at a root: away from a parting that runs from the hairline back to the crown, a little to the
 * left; behind it, away from the crown. At right angles to the scalp's normal. */
static hg_vec3d combed(const garden *g, hg_vec3d root, hg_vec3d normal, int64_t strand)
{
    hg_vec3d centre = hg_vec3d_load(g->body->scalp_centre), from = hg_vec3d_sub(root, centre);
    const double part = 0.022, crown = -0.035;
    double z = fmax(from.z, crown), wobble = chance(g, 1, strand) - 0.5;
    double side = from.x - part > 0.004 * (chance(g, 2, strand) - 0.5) ? 1 : -1; /* on the parting, chance says which */
    hg_vec3d way = hg_vec3d_make(from.x - part, 0, from.z - z);
    way.x = g->style->parting * (way.x + 0.035 * side * scene_ramp(crown - 0.02, crown + 0.03, from.z));
    double aside = fabs(from.x - part) / 0.05, front = scene_ramp(0.02, 0.08, from.z);
    way.y -= (1 - front * (1 - fmin(aside, 1))) * 0.35 * hg_vec3d_norm(from) * fmin(1, fmax(0, 1.2 - from.y / 0.08));
    way.z -= 0.035 * scene_ramp(crown, 0.09, from.z); /* the front goes back, out of the face */
    way = hg_vec3d_add_scaled(way, -hg_vec3d_dot(way, normal), normal);
    way = hg_vec3d_normalize(way);
    return hg_vec3d_normalize(hg_vec3d_add_scaled(way, 0.25 * wobble, hg_vec3d_cross(normal, way)));
}

/* Keeps locks out of the face: in front of it they are led to their side. */
static hg_vec3d face_way(const garden *g, hg_vec3d p)
{
    hg_vec3d d = hg_vec3d_sub(p, hg_vec3d_load(g->body->scalp_centre));
    double front =
        scene_ramp(0.02, 0.07, d.z) * (1 - scene_ramp(-0.01, 0.03, d.y)) * (1 - scene_ramp(0.065, 0.11, fabs(d.x)));
    return hg_vec3d_make(d.x > 0 ? front : -front, 0, -0.7 * front);
}

/* ---- centre lines ------------------------------------------------------------------------------------------- */

static hg_status closest(garden *g, hg_ctx *ctx)
{
    return hg_body_closest(ctx, g->refit, HG_CONTACT_EXACT, 0.08, g->strands, g->at, g->triangle, g->contact,
                           g->contact_normal);
}

/* Signed distance of the strand's point to the body, and the way out. */
static double distance_at(const garden *g, int64_t s, hg_vec3d p, hg_vec3d *out)
{
    *out = scene_point(g->contact_normal + 3 * s);
    return hg_vec3d_dot(*out, hg_vec3d_sub(p, scene_point(g->contact + 3 * s)));
}

/* One step of every strand at a time, so that the body is asked for all of them at once. */
static hg_status grow_lines(garden *g, hg_ctx *ctx)
{
    const growth *style = g->style;
    for (int64_t i = 1; i < g->points; i++) {
        for (int64_t s = 0; s < g->strands; s++) {
            hg_vec3d *line = g->line + s * g->points, way;
            double step = g->length[s] / (double)(g->points - 1), passed = step * (double)i;
            if (i == 1) {
                way = hg_vec3d_mix(g->comb[s], g->normal[s], style->lift);
            } else {
                way = hg_vec3d_normalize(hg_vec3d_sub(line[i - 1], line[i - 2]));
                way.y -= step / style->bend;
                way = hg_vec3d_add_scaled(way, 6 * step / style->bend * 0.2, face_way(g, line[i - 1]));
                /* what lies on the body does not turn into it */
                hg_vec3d out;
                double distance = distance_at(g, s, line[i - 1], &out), into = hg_vec3d_dot(way, out);
                double cover = g->clearance[s] * scene_ramp(0, 0.06, passed);
                if (into < 0 && distance < cover + 0.004) way = hg_vec3d_add_scaled(way, -0.8 * into, out);
            }
            line[i] = hg_vec3d_add_scaled(line[i - 1], step, hg_vec3d_normalize(way));
            scene_put(g->at + 3 * s, line[i]);
        }
        HG_TRY(closest(g, ctx));
        for (int64_t s = 0; s < g->strands; s++) {
            hg_vec3d *line = g->line + s * g->points, out;
            double step = g->length[s] / (double)(g->points - 1), passed = step * (double)i;
            double distance = distance_at(g, s, line[i], &out), cover = g->clearance[s] * scene_ramp(0, 0.06, passed);
            if (distance >= cover) continue;
            hg_vec3d moved = hg_vec3d_add_scaled(line[i], fmin(cover - distance, 0.7 * step), out);
            moved = hg_vec3d_normalize(hg_vec3d_sub(moved, line[i - 1]));
            line[i] = hg_vec3d_add_scaled(line[i - 1], step, moved);
        }
    }
    return HG_OK;
}

/* The first roots are spread over the scalp and lead locks; a strand follows the nearest that is combed the same way, so
 * that no lock reaches across a parting. */
static void choose_locks(garden *g)
{
    int64_t locks = g->strands / STRANDS_PER_LOCK > 0 ? g->strands / STRANDS_PER_LOCK : 1;
    for (int64_t s = 0; s < g->strands; s++) {
        double best = INFINITY;
        for (int64_t k = 0; k < locks; k++) {
            double apart = hg_vec3d_distance(g->line[s * g->points], g->line[k * g->points]);
            if (apart >= best) continue;
            apart += 0.1 * fmax(0.5 - hg_vec3d_dot(g->comb[s], g->comb[k]), 0);
            if (apart < best) best = apart, g->lock[s] = (int32_t)k;
        }
    }
}

/* Draws every strand towards the one that leads its lock, more and more towards the tip. */
static void draw_together(garden *g)
{
    for (int64_t s = g->strands - 1; s >= 0; s--) { /* leaders come first and are not moved */
        int64_t leader = g->lock[s];
        if (leader == s) continue;
        hg_vec3d *line = g->line + s * g->points;
        const hg_vec3d *lead = g->line + leader * g->points;
        hg_vec3d apart = hg_vec3d_sub(line[0], lead[0]);
        double hold = 1; /* a strand that has fallen to the other side of a shoulder is not drawn through it */
        for (int64_t i = 1; i < g->points; i++) {
            double t = (double)i / (double)(g->points - 1), draw = g->style->lock * scene_ramp(0, 1, t);
            hg_vec3d target = hg_vec3d_add_scaled(lead[i], 0.45, apart);
            hold = fmin(hold, 1 - scene_ramp(0.02, 0.045, hg_vec3d_distance(line[i], target)));
            line[i] = hg_vec3d_mix(line[i], target, hold * draw);
        }
    }
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

/* The helix about a centre line, its frame carried along without twist. out [(points - 1) * CLOSER + 1,3]. */
static void wind(const garden *g, int64_t s, double *out)
{
    const hg_vec3d *line = g->line + s * g->points;
    hg_vec3d tangent = hg_vec3d_normalize(hg_vec3d_sub(line[1], line[0])), side = hg_vec3d_perpendicular(tangent);
    double phase = 2 * SCENE_PI * (chance(g, 5, g->lock[s]) + 0.12 * (chance(g, 6, s) - 0.5));
    double radius = g->style->radius * (0.8 + 0.4 * chance(g, 7, g->lock[s])) * (0.9 + 0.2 * chance(g, 8, s));
    double turns = 2 * SCENE_PI / (g->style->step * (0.85 + 0.3 * chance(g, 9, g->lock[s])));
    double step = g->length[s] / (double)(g->points - 1), hand = chance(g, 10, g->lock[s]) < 0.5 ? -1 : 1;
    int64_t last = (g->points - 1) * CLOSER;
    for (int64_t i = 0; i <= last; i++) {
        int64_t k = i / CLOSER < g->points - 1 ? i / CLOSER : g->points - 2;
        double t = (double)(i - k * CLOSER) / CLOSER, passed = step * ((double)k + t);
        if (i % CLOSER == 0 && i < last) {
            hg_vec3d next = hg_vec3d_normalize(hg_vec3d_sub(line[k + 1], line[k]));
            side = hg_quatd_rotate(hg_quatd_between(tangent, next), side);
            tangent = next;
        }
        double r = radius * scene_ramp(0, 0.06, passed), a = phase + hand * turns * passed;
        hg_vec3d across = hg_vec3d_cross(tangent, side);
        hg_vec3d p = hg_vec3d_mix(line[k], line[k + 1], t);
        p = hg_vec3d_add_scaled(p, r * cos(a), side);
        hg_vec3d_store(out + 3 * i, hg_vec3d_add_scaled(p, r * sin(a), across));
    }
}

static hg_status wind_strands(garden *g, hg_groom *groom)
{
    int64_t n = (g->points - 1) * CLOSER + 1;
    double *winding = hg_alloc((size_t)n, 3 * sizeof *winding);
    if (!winding) return HG_MEMORY;
    for (int64_t s = 0; s < g->strands; s++) {
        wind(g, s, winding);
        scene_resample(winding, n, groom->vertices, groom->points + 3 * groom->vertices * s);
    }
    hg_free(winding);
    return HG_OK;
}

static hg_status garden_plant(garden *g, hg_groom *groom)
{
    const hg_body *body = g->body;
    size_t n = (size_t)g->strands;
    g->line = hg_alloc(n, (size_t)g->points * sizeof *g->line);
    g->normal = hg_alloc(n, sizeof *g->normal);
    g->comb = hg_alloc(n, sizeof *g->comb);
    g->length = hg_alloc(n, sizeof *g->length);
    g->clearance = hg_alloc(n, sizeof *g->clearance);
    g->lock = hg_alloc(n, sizeof *g->lock);
    g->at = hg_alloc(n, 3 * sizeof *g->at);
    g->contact = hg_alloc(n, 3 * sizeof *g->contact);
    g->contact_normal = hg_alloc(n, 3 * sizeof *g->contact_normal);
    g->triangle = hg_alloc(n, sizeof *g->triangle);
    if (!g->line || !g->normal || !g->comb || !g->length || !g->clearance || !g->lock || !g->at || !g->contact ||
        !g->contact_normal || !g->triangle)
        return HG_MEMORY;
    HG_TRY(scene_scatter_roots(body, g->strands, g->seed, groom->root_face, groom->root_bary, g->at));
    for (int64_t s = 0; s < g->strands; s++) {
        const int32_t *t = body->triangles + 3 * (int64_t)groom->root_face[s];
        hg_vec3d a = scene_point(body->points + 3 * (int64_t)t[0]), b = scene_point(body->points + 3 * (int64_t)t[1]);
        hg_vec3d c = scene_point(body->points + 3 * (int64_t)t[2]);
        g->normal[s] = hg_vec3d_normalize(hg_vec3d_cross(hg_vec3d_sub(b, a), hg_vec3d_sub(c, a)));
        g->line[s * g->points] = scene_point(g->at + 3 * s);
        g->comb[s] = combed(g, g->line[s * g->points], g->normal[s], s);
        g->triangle[s] = -1;
    }
    choose_locks(g);
    for (int64_t s = 0; s < g->strands; s++) {
        double spread =
            hg_random_normal(g->seed, 90, (uint64_t)g->lock[s]) + 0.5 * hg_random_normal(g->seed, 91, (uint64_t)s);
        g->length[s] = g->style->length * fmin(fmax(1 + g->style->variation * spread, 0.6), 1.4);
        g->clearance[s] = g->style->volume * (0.25 + 1.5 * chance(g, 3, s));
    }
    return HG_OK;
}

static hg_status garden_grow(garden *g, hg_ctx *ctx, hg_groom *groom)
{
    const hg_body *body = g->body;
    double *rest = hg_alloc((size_t)body->vertices, 3 * sizeof *rest);
    ctx = hg_ctx_on_host(ctx);
    if (!rest || !ctx) {
        hg_free(rest);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < 3 * body->vertices; i++) rest[i] = (double)body->points[i];
    hg_status status = hg_body_tree_create(&g->tree, body->vertices, rest, body->faces, body->triangles);
    hg_free(rest);
    HG_TRY(status);
    HG_TRY(hg_body_refit_create(&g->refit, g->tree, HG_F32));
    HG_TRY(hg_body_refit_update(ctx, g->refit, body->points));
    HG_TRY(garden_plant(g, groom));
    HG_TRY(grow_lines(g, ctx));
    draw_together(g);
    HG_TRY(wind_strands(g, groom));
    HG_TRY(hg_fit_groom(ctx, groom, body, NULL, NULL)); /* binds; what helix or lock brought into the body comes out */
    groom->name = hg_format("%s %llu", g->style->name, (unsigned long long)g->seed);
    return groom->name ? HG_OK : HG_MEMORY;
}

static void garden_clear(garden *g)
{
    hg_free(g->line);
    hg_free(g->normal);
    hg_free(g->comb);
    hg_free(g->length);
    hg_free(g->clearance);
    hg_free(g->lock);
    hg_free(g->at);
    hg_free(g->contact);
    hg_free(g->contact_normal);
    hg_free(g->triangle);
    hg_body_refit_destroy(g->refit);
    hg_body_tree_destroy(g->tree);
}

hg_status hg_groom_grow(hg_ctx *ctx, hg_groom **groom, const hg_body *body, const char *style, int64_t strands,
                        int64_t vertices, uint64_t seed)
{
    const char *names[STYLES];
    garden g = { .body = body, .seed = seed, .strands = strands };
    *groom = NULL;
    for (int i = 0; i < STYLES; i++) {
        names[i] = styles[i].name;
        if (strcmp(style, names[i]) == 0) g.style = styles + i;
    }
    if (!g.style) {
        const char *near = hg_nearest_of(style, names, STYLES);
        return hg_fail(HG_INVALID,
                       "no procedural groom is called \"%s\"%s%s%s: there are straight, wavy, curly, short, long",
                       style, near ? " (did you mean " : "", near ? near : "", near ? "?)" : "");
    }
    if (strands < 1 || strands > 10000000)
        return hg_fail(HG_INVALID, "%lld strands: a groom is grown with 1 to 10000000", (long long)strands);
    if (body->scalp_faces < 1) return hg_fail(HG_INVALID, "the body has no scalp for hair to grow on");
    HG_TRY(hg_groom_create(groom, strands, vertices));
    g.points = (int64_t)ceil(g.style->length / STEP) + 1;
    hg_status status = garden_grow(&g, ctx, *groom);
    garden_clear(&g);
    if (status != HG_OK) {
        hg_groom_destroy(*groom);
        *groom = NULL;
    }
    return status;
}
