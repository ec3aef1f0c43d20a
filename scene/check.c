/* What is wrong, or odd, with strands: everything that a training would stumble over, told beforehand. */
#include "scene/internal.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- findings ----------------------------------------------------------------------------------------------- */

void hg_findings_add(hg_findings *findings, hg_severity severity, const char *about, const char *format, ...)
{
    char text[600];
    va_list values;
    va_start(values, format);
    vsnprintf(text, sizeof text, format, values);
    va_end(values);
    if (findings->n == findings->capacity) {
        int larger = findings->capacity ? 2 * findings->capacity : 16;
        hg_finding *list = hg_resize(findings->list, (size_t)findings->capacity, (size_t)larger, sizeof *list);
        if (!list) {
            findings->failed = true;
            return;
        }
        findings->list = list;
        findings->capacity = larger;
    }
    hg_finding *finding = &findings->list[findings->n];
    *finding = (hg_finding){ severity, about, hg_strdup(text) };
    if (finding->text)
        findings->n++;
    else
        findings->failed = true;
}

int hg_findings_count(const hg_findings *findings, hg_severity severity)
{
    int count = 0;
    for (int i = 0; i < findings->n; i++) count += findings->list[i].severity == severity;
    return count;
}

void hg_findings_free(hg_findings *findings)
{
    for (int i = 0; i < findings->n; i++) hg_free(findings->list[i].text);
    hg_free(findings->list);
    *findings = (hg_findings){ 0 };
}

/* ---- units -------------------------------------------------------------------------------------------------- */

static int compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double sort_for(double *values, int64_t n, double fraction)
{
    qsort(values, (size_t)n, sizeof *values, compare_numbers);
    return values[(int64_t)(fraction * (double)(n - 1))];
}

typedef struct {
    int64_t kept, vertices, least, most; /* sound strands, and vertices of one */
    double *length;                      /* [kept], ascending after measure() */
    double root_low[3], root_high[3], reach[3] /* mean way from root to tip */, path /* mean length */;
} measures;

static hg_status measure(const hg_curves *curves, measures *m)
{
    *m = (measures){ .least = INT64_MAX };
    for (int k = 0; k < 3; k++) m->root_low[k] = INFINITY, m->root_high[k] = -INFINITY;
    m->length = hg_alloc((size_t)curves->strands + 1, sizeof *m->length);
    if (!m->length) return HG_MEMORY;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t n = curves->start[s + 1] - curves->start[s];
        const float *p = curves->points + 3 * curves->start[s];
        if (scene_strand_classify(p, n) != STRAND_KEPT) continue;
        m->least = n < m->least ? n : m->least;
        m->most = n > m->most ? n : m->most;
        m->vertices += n;
        m->path += m->length[m->kept++] = scene_length(p, n);
        for (int k = 0; k < 3; k++) {
            m->root_low[k] = fmin(m->root_low[k], (double)p[k]);
            m->root_high[k] = fmax(m->root_high[k], (double)p[k]);
            m->reach[k] += (double)p[3 * (n - 1) + k] - (double)p[k];
        }
    }
    for (int k = 0; k < 3 && m->kept; k++) m->reach[k] /= (double)m->kept;
    if (m->kept) m->path /= (double)m->kept;
    if (m->kept) sort_for(m->length, m->kept, 0);
    return HG_OK;
}

/* Roots cover a scalp of about 0.2 m (few roots may cover less), and a strand is 5 mm to 1.5 m long. */
static bool look_at_unit(const measures *m, char text[160])
{
    static const struct {
        const char *name;
        double metres;
    } units[] = { { "m", 1 }, { "inch", 0.0254 }, { "cm", 0.01 }, { "dm", 0.1 }, { "mm", 0.001 } };
    double extent = 0, length = m->kept ? m->length[m->kept / 2] : 0;
    int best = -1, possible = -1;
    text[0] = '\0';
    if (m->kept == 0) return true;
    for (int k = 0; k < 3; k++) extent = fmax(extent, m->root_high[k] - m->root_low[k]);
    for (int i = 0; i < 5; i++) {
        double head = extent * units[i].metres, hair = length * units[i].metres;
        if (hair < 0.005 || hair > 1.5) continue;
        if (head > 0.12 && head < 0.4) {
            if (best < 0 || fabs(log(head / 0.2)) < fabs(log(extent * units[best].metres / 0.2))) best = i;
        } else if (possible < 0 && head < 0.4) {
            possible = i;
        }
    }
    double metre_hair = length, metre_head = extent;
    if (metre_hair >= 0.005 && metre_hair <= 1.5 && metre_head < 0.4) return true; /* plausible as it is */
    int guess = best >= 0 ? best : possible;
    if (guess >= 0 && units[guess].metres < 1)
        snprintf(text, 160,
                 "the median strand would be %.3g m long, the roots %.3g m wide: it looks like %s (--unit %s)", length,
                 extent, units[guess].name, units[guess].name);
    else
        snprintf(text, 160,
                 "the median strand would be %.3g m long, the roots %.3g m wide: not hair on a head in any unit",
                 length, extent);
    return false;
}

bool hg_curves_in_metres(const hg_curves *curves, char text[160])
{
    measures m;
    text[0] = '\0';
    bool plausible = measure(curves, &m) != HG_OK || look_at_unit(&m, text);
    hg_free(m.length);
    return plausible;
}

static void say_unit(hg_findings *findings, const measures *m)
{
    char text[160];
    double median = m->length[m->kept / 2];
    if (look_at_unit(m, text))
        hg_findings_add(findings, HG_FINE, "unit", "lengths %.4g / %.4g / %.4g m (shortest, median, longest)",
                        m->length[0], median, m->length[m->kept - 1]);
    else
        hg_findings_add(findings, HG_WARNING, "unit", "%s", text);
}

/* Hair hangs: on the whole, tips lie below roots. */
static void say_up(hg_findings *findings, const measures *m)
{
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(m->reach[k]) > fabs(m->reach[axis])) axis = k;
    if (fabs(m->reach[axis]) < 0.2 * m->path)
        hg_findings_add(findings, HG_FINE, "up", "it cannot be told from the strands, which point to all sides");
    else if (axis == 1 && m->reach[1] < 0)
        hg_findings_add(findings, HG_FINE, "up", "+Y: strands hang along -Y");
    else
        hg_findings_add(findings, HG_WARNING, "up", "strands point along %c%c; with +Y up they would hang along -Y%s",
                        m->reach[axis] < 0 ? '-' : '+', "XYZ"[axis],
                        axis == 2 && m->reach[2] < 0 ? ": it looks like +Z up (--up z)" : "");
}

/* ---- strands and edges -------------------------------------------------------------------------------------- */

static void mark(uint8_t *problem, int64_t strand, hg_strand_problem what)
{
    if (problem && problem[strand] == HG_STRAND_FINE) problem[strand] = (uint8_t)what;
}

static void say_strands(hg_findings *findings, const hg_curves *curves, const measures *m, uint8_t *problem)
{
    hg_groom_report report = { .strands = curves->strands };
    int64_t first[3] = { -1, -1, -1 };
    for (int64_t s = 0; s < curves->strands; s++) {
        scene_strand_kind kind =
            scene_strand_classify(curves->points + 3 * curves->start[s], curves->start[s + 1] - curves->start[s]);
        if (kind == STRAND_KEPT) continue;
        int64_t *count = kind == STRAND_BALD          ? &report.bald
                         : kind == STRAND_ZERO_LENGTH ? &report.zero_length
                                                      : &report.non_finite;
        if ((*count)++ == 0) first[kind - STRAND_BALD] = s;
        mark(problem, s, HG_STRAND_DROPPED);
    }
    if (m->kept == 0)
        hg_findings_add(findings, HG_ERROR, "strands", "none of %lld can be used", (long long)curves->strands);
    else
        hg_findings_add(findings, HG_FINE, "strands",
                        m->least == m->most ? "%lld of %lld vertices" : "%lld of %lld to %lld vertices",
                        (long long)m->kept, (long long)m->least, (long long)m->most);
    static const char *const what[3] = { "bald (one vertex or none)", "of zero length", "not finite" };
    int64_t counts[3] = { report.bald, report.zero_length, report.non_finite };
    for (int i = 0; i < 3; i++)
        if (counts[i])
            hg_findings_add(findings, HG_WARNING, "dropped", "%lld %s, the first is strand %lld; they are left out",
                            (long long)counts[i], what[i], (long long)first[i]);
    if (m->kept && m->most < 4)
        hg_findings_add(findings, HG_WARNING, "vertices",
                        "no strand has more than %lld vertices: a curve through them has no curl", (long long)m->most);
}

static hg_status say_edges(hg_findings *findings, const hg_curves *curves, const measures *m, uint8_t *problem)
{
    int64_t n = 0, zero = 0, in_strands = 0, first = -1, uneven_strand = 0;
    double uneven = 1, *edge = hg_alloc((size_t)m->vertices + 1, sizeof *edge);
    if (!edge) return HG_MEMORY;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t count = curves->start[s + 1] - curves->start[s], before = zero;
        const float *p = curves->points + 3 * curves->start[s];
        if (scene_strand_classify(p, count) != STRAND_KEPT) continue;
        double least = INFINITY, most = 0;
        for (int64_t v = 0; v + 1 < count; v++) {
            double length = hg_vec3d_distance(scene_point(p + 3 * v), scene_point(p + 3 * v + 3));
            edge[n++] = length;
            zero += length < 1e-9;
            if (length >= 1e-9) least = fmin(least, length), most = fmax(most, length);
        }
        if (most / least > uneven) uneven = most / least, uneven_strand = s;
        if (zero > before) {
            if (in_strands++ == 0) first = s;
            mark(problem, s, HG_STRAND_EDGES);
        }
    }
    double median = sort_for(edge, n, 0.5);
    hg_findings_add(findings, uneven > 1000 ? HG_WARNING : HG_FINE, "edges",
                    "%.3g / %.3g / %.3g m (shortest, median, longest); within a strand they differ by up to %.3g times "
                    "(strand %lld)",
                    edge[0], median, edge[n - 1], uneven, (long long)uneven_strand);
    if (zero)
        hg_findings_add(findings, HG_WARNING, "edges",
                        "%lld of zero length in %lld strands, the first is strand %lld; importing leaves out repeated "
                        "vertices",
                        (long long)zero, (long long)in_strands, (long long)first);
    hg_free(edge);
    return HG_OK;
}

/* ---- duplicates --------------------------------------------------------------------------------------------- */

typedef struct {
    uint64_t hash;
    int64_t strand;
} hashed;

static int compare_hashes(const void *a, const void *b)
{
    const hashed *p = a, *q = b;
    if (p->hash != q->hash) return p->hash < q->hash ? -1 : 1;
    return (p->strand > q->strand) - (p->strand < q->strand);
}

/* How many strands are the same as one before them, in their first `points` vertices (0: all of them). */
static int64_t count_same(const hg_curves *curves, int64_t points, hashed *all, uint8_t *problem, int64_t *first)
{
    int64_t n = 0, same = 0;
    *first = -1;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t count = curves->start[s + 1] - curves->start[s];
        const float *p = curves->points + 3 * curves->start[s];
        if (scene_strand_classify(p, count) != STRAND_KEPT) continue;
        size_t size = (size_t)(points ? points : count) * 3 * sizeof *p;
        all[n++] = (hashed){ hg_hash(p, size, (uint64_t)size), s };
    }
    qsort(all, (size_t)n, sizeof *all, compare_hashes);
    for (int64_t i = 1; i < n; i++) {
        if (all[i].hash != all[i - 1].hash) continue;
        if (*first < 0 || all[i].strand < *first) *first = all[i].strand;
        if (problem) mark(problem, all[i].strand, HG_STRAND_DUPLICATE);
        same++;
    }
    return same;
}

static hg_status say_duplicates(hg_findings *findings, const hg_curves *curves, uint8_t *problem)
{
    hashed *all = hg_alloc((size_t)curves->strands, sizeof *all);
    int64_t first, first_root;
    if (!all) return HG_MEMORY;
    int64_t strands = count_same(curves, 0, all, problem, &first);
    int64_t roots = count_same(curves, 1, all, NULL, &first_root);
    hg_free(all);
    if (strands)
        hg_findings_add(findings, HG_WARNING, "duplicates", "%lld strands repeat another one, the first is strand %lld",
                        (long long)strands, (long long)first);
    if (roots > strands)
        hg_findings_add(findings, HG_WARNING, "duplicates",
                        "%lld more roots lie where another one lies, the first is that of strand %lld",
                        (long long)(roots - strands), (long long)first_root);
    if (!roots) hg_findings_add(findings, HG_FINE, "duplicates", "none");
    return HG_OK;
}

/* ---- root UV and binding ------------------------------------------------------------------------------------ */

static void say_root_uv(hg_findings *findings, const hg_curves *curves)
{
    double low[2] = { INFINITY, INFINITY }, high[2] = { -INFINITY, -INFINITY };
    int64_t wrong = 0;
    for (int64_t i = 0; i < 2 * curves->strands; i++) {
        double x = (double)curves->root_uv[i];
        wrong += !isfinite(x);
        low[i % 2] = fmin(low[i % 2], x), high[i % 2] = fmax(high[i % 2], x);
    }
    bool inside = low[0] >= 0 && low[1] >= 0 && high[0] <= 1 && high[1] <= 1 && !wrong;
    bool flat = high[0] - low[0] < 1e-6 && high[1] - low[1] < 1e-6 && curves->strands > 1;
    hg_findings_add(findings, inside && !flat ? HG_FINE : HG_WARNING, "root_uv", "%.3f to %.3f, %.3f to %.3f%s", low[0],
                    high[0], low[1], high[1],
                    wrong     ? "; some are not finite"
                    : !inside ? "; 0 to 1 is expected"
                    : flat    ? "; all roots have the same"
                              : "");
}

/* ---- against a body ----------------------------------------------------------------------------------------- */

static hg_status distances(hg_ctx *ctx, const hg_body *body, bool scalp, int64_t n, const double *points,
                           double *distance)
{
    int64_t faces = scalp ? body->scalp_faces : body->faces;
    hg_body_tree *tree = NULL;
    hg_body_refit *refit = NULL;
    int32_t *corners = hg_alloc((size_t)faces, 3 * sizeof *corners), *nearest = hg_alloc((size_t)n, sizeof *nearest);
    double *vertices = hg_alloc((size_t)body->vertices, 3 * sizeof *vertices);
    double *at = hg_alloc((size_t)n, 3 * sizeof *at), *normal = hg_alloc((size_t)n, 3 * sizeof *normal);
    ctx = hg_ctx_on_host(ctx);
    hg_status status = ctx && corners && nearest && vertices && at && normal ? HG_OK : HG_MEMORY;
    if (status == HG_OK) {
        for (int64_t f = 0; f < faces; f++)
            memcpy(corners + 3 * f, body->triangles + 3 * (scalp ? (int64_t)body->scalp[f] : f), 3 * sizeof *corners);
        for (int64_t i = 0; i < 3 * body->vertices; i++) vertices[i] = (double)body->points[i];
        for (int64_t i = 0; i < n; i++) nearest[i] = -1;
        status = hg_body_tree_create(&tree, body->vertices, vertices, faces, corners);
    }
    if (status == HG_OK) status = hg_body_refit_create(&refit, tree, HG_F64);
    if (status == HG_OK) status = hg_body_refit_update(ctx, refit, vertices);
    if (status == HG_OK)
        status = hg_body_closest(ctx, refit, HG_CONTACT_EXACT, (double)INFINITY, n, points, nearest, at, normal);
    for (int64_t i = 0; status == HG_OK && i < n; i++)
        distance[i] = hg_vec3d_dot(hg_vec3d_load(normal + 3 * i),
                                   hg_vec3d_sub(hg_vec3d_load(points + 3 * i), hg_vec3d_load(at + 3 * i)));
    hg_body_refit_destroy(refit);
    hg_body_tree_destroy(tree);
    hg_free(corners);
    hg_free(nearest);
    hg_free(vertices);
    hg_free(at);
    hg_free(normal);
    return status;
}

typedef struct {
    int64_t roots, others; /* sound strands, and their vertices but the roots */
    double *points;        /* roots first, then the others */
    double *distance;
    int64_t *strand; /* of each */
} probes;

static hg_status gather(const hg_curves *curves, const measures *m, probes *p)
{
    *p = (probes){ .roots = m->kept, .others = m->vertices - m->kept };
    p->points = hg_alloc((size_t)m->vertices, 3 * sizeof *p->points);
    p->distance = hg_alloc((size_t)m->vertices, sizeof *p->distance);
    p->strand = hg_alloc((size_t)m->vertices, sizeof *p->strand);
    if (!p->points || !p->distance || !p->strand) return HG_MEMORY;
    int64_t root = 0, other = p->roots;
    for (int64_t s = 0; s < curves->strands; s++) {
        int64_t n = curves->start[s + 1] - curves->start[s];
        const float *at = curves->points + 3 * curves->start[s];
        if (scene_strand_classify(at, n) != STRAND_KEPT) continue;
        for (int64_t v = 0; v < n; v++) {
            int64_t i = v ? other++ : root++;
            hg_vec3d_store(p->points + 3 * i, scene_point(at + 3 * v));
            p->strand[i] = s;
        }
    }
    return HG_OK;
}

static void say_bound(hg_findings *findings, const hg_curves *curves, const hg_body *body)
{
    int64_t bound = 0, outside = 0;
    for (int64_t s = 0; curves->root_face && s < curves->strands; s++) {
        bound += curves->root_face[s] >= 0;
        outside += curves->root_face[s] >= body->faces;
    }
    if (!curves->root_face) return;
    if (outside)
        hg_findings_add(findings, HG_ERROR, "binding", "%lld roots are bound to faces that the body does not have",
                        (long long)outside);
    else if (bound && curves->body_hash && curves->body_hash != hg_body_hash(body))
        hg_findings_add(findings, HG_ERROR, "binding",
                        "the groom was bound to another body: import it again for this one");
    else
        hg_findings_add(findings, bound == curves->strands ? HG_FINE : HG_WARNING, "binding",
                        "%lld of %lld roots are bound to a face of the body", (long long)bound,
                        (long long)curves->strands);
}

static void say_near(hg_findings *findings, const probes *p, uint8_t *problem)
{
    int64_t far = 0, inside = 0;
    double deepest = 0;
    for (int64_t i = 0; i < p->roots; i++) {
        p->distance[i] = fabs(p->distance[i]);
        if (p->distance[i] <= 0.01) continue;
        far++;
        mark(problem, p->strand[i], HG_STRAND_ROOT);
    }
    for (int64_t i = p->roots; i < p->roots + p->others; i++) {
        deepest = fmin(deepest, p->distance[i]);
        if (p->distance[i] >= -1e-3) continue;
        inside++;
        mark(problem, p->strand[i], HG_STRAND_INSIDE);
    }
    double median = sort_for(p->distance, p->roots, 0.5), near_most = sort_for(p->distance, p->roots, 0.95);
    double most = p->distance[p->roots - 1], share = 100 * (double)inside / fmax(1, (double)p->others);
    hg_findings_add(findings, far * 100 > p->roots ? HG_WARNING : HG_FINE, "roots",
                    "%.3g / %.3g / %.3g mm from the scalp (median, 95 %% under, most); %lld by more than 1 cm%s",
                    1e3 * median, 1e3 * near_most, 1e3 * most, (long long)far,
                    median > 0.01 ? ": is it in the body's place? hairgrad import groom --find looks for it" : "");
    hg_findings_add(findings, share > 1 ? HG_WARNING : HG_FINE, "inside",
                    "%lld vertices (%.2f %%) are more than 1 mm inside the body, the deepest %.3g mm",
                    (long long)inside, share, 1e3 * fabs(deepest));
}

static hg_status say_against(hg_ctx *ctx, hg_findings *findings, const hg_curves *curves, const hg_body *body,
                             const measures *m, uint8_t *problem)
{
    probes p;
    say_bound(findings, curves, body);
    if (body->scalp_faces < 1) {
        hg_findings_add(findings, HG_ERROR, "roots", "the body has no scalp");
        return HG_OK;
    }
    hg_status status = gather(curves, m, &p);
    if (status == HG_OK) status = distances(ctx, body, true, p.roots, p.points, p.distance);
    if (status == HG_OK) status = distances(ctx, body, false, p.others, p.points + 3 * p.roots, p.distance + p.roots);
    if (status == HG_OK) say_near(findings, &p, problem);
    hg_free(p.points);
    hg_free(p.distance);
    hg_free(p.strand);
    return status;
}

hg_status hg_check_groom(hg_ctx *ctx, hg_findings *findings, const hg_curves *curves, const hg_body *body,
                         uint8_t *problem)
{
    measures m;
    hg_status status = measure(curves, &m);
    if (status == HG_OK) {
        if (problem) memset(problem, 0, (size_t)curves->strands);
        say_strands(findings, curves, &m, problem);
    }
    if (status == HG_OK && m.kept) {
        say_unit(findings, &m);
        say_up(findings, &m);
        status = say_edges(findings, curves, &m, problem);
        if (status == HG_OK) status = say_duplicates(findings, curves, problem);
        if (status == HG_OK && curves->root_uv) say_root_uv(findings, curves);
        if (status == HG_OK && body) status = say_against(ctx, findings, curves, body, &m, problem);
    }
    hg_free(m.length);
    return status == HG_OK && findings->failed ? HG_MEMORY : status;
}
