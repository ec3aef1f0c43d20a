/* xpbd: extended position-based dynamics of Cosserat rods.
 *
 * Kugelstadt and Schoemer 2016 (positions and orientations), Macklin et al. 2016 (compliance), Macklin et al. 2019 (substeps),
 * Deul et al. 2018 (a direct solution for rods). A hair has positions x_v with masses m_v and orientations q_i of its edges. These
 * have a moment of inertia I = m l^2/12, which sweeps need and a hair of points does not have; direct it is a hundredth of that. A
 * constraint C with stiffness K stands for the energy K/2 |C|^2; from the config's energies:
 *
 *   stretch-shear   C = (x_{i+1} - x_i)/l0 - rotate(q_i, e3)          K = k l0^2 of `stretch`, k of `cosserat_stretch_shear`
 *   bend-twist      C = Im(s conj(q_i) q_{i+1} - r0)                  K = 4 k/l' of `bend_twist` and `bend_twist_chain`,
 *                                                                         4 k/l'^2 of `cosserat_bend_twist`
 *                   C = s conj(q_i) q_{i+1} - r0, all four            strain: smooth, the same K: K/2 |C|^2 = 4k/l' (1 - |r.r0|)
 *                   the same of (R q0_0, q_0), r0 = 1, l' = l0        root: clamped
 *   body            C = D_v - n.x + n.a where it is positive          K = 3 k C of `body_collision`, so that the force is that of k C^3
 *   style           C = x - x_posed                                   K = 2 k (1 - min(1, s/s_max)) of `hair_style`
 *
 * s = +-1 is the sign with s r.r0 >= 0 (q and -q are one orientation). r0 is made of the rest frames q0, carried along the strand. `gravity` and `drag` are in the prediction,
 * `inertia` is what the method is, and unit_quaternion holds exactly. With weights; each weight multiplies its stiffness.
 *
 * Twist, the z of C in the frame of the edge: points cannot show it, and the frames of `bend_twist_chain` are carried without any. So
 * with the energies of points K is a thousand times larger about the edge than across it: then q_i is the carried frame, and
 * what is at rest is the minimum of `stretch` + `bend_twist_chain` (Sintel groom: the energy to 5 digits). The rods of the Cosserat
 * energies twist as they bend. What differs:
 *
 *   - an edge may shear, by F/(k l0) for a force F: 0.1 degrees for 4 mm edges under the weight of a hair;
 *   - `bend_twist` carries its frames straight from the first edge. Where a strand leaves the plane they have a twist that depends on
 *     the whole way, and no constraint of neighbours knows of it: rods of `bend_twist` are those of `bend_twist_chain`;
 *   - planes of contact stay as they were found for a substep, of hair that comes to rest for a step;
 *   - pairs and neighbour sums are left out (hg_xpbd_left_out); strands may keep a distance instead.
 *
 * A substep of h seconds: prediction, iterations, velocities. Two ways of iterating:
 *
 *   sweeps   Gauss-Seidel over the constraints, by turns from the root and from the tip, multipliers from zero in each substep, as
 *            published. Ten sweeps do not carry the weight of a strand to its root: hair is softer than its material, the more so the
 *            more sweeps are missing, and at rest it hangs by what 20 times 10 sweeps can hold.
 *   direct   (Deul et al. 2018) one block tridiagonal system a strand, blocks of 6 (turn of an edge, way of the vertex at its end), at
 *            the price of about five sweeps. It is solved for the energy of the substep, |x - prediction|^2 m / 2h^2 and all
 *            constraints: Newton's steps without the second derivatives of the constraints, but with the stiffness that tension gives to
 *            the direction of an edge, and shortened where the energy would not sink.
 *
 * At rest there are no velocities, mass and h say only how fast it gets there. Each strand (direct) has its own h then, which
 * grows as long as the energy sinks, so that the last steps are Newton's; contact is found anew in every step.
 *
 * f64: positions in the world of a hair that a step moves by 1e-8 m. Eight strands at a time, one in each lane. */
#include "solvers/xpbd.h"

#include "geometry/vector.h"
#include "hairloss/physics.h"

#include <math.h>
#include <string.h>

/* ---- memory ------------------------------------------------------------------------------------------------------ */

/* Every row array of a tile, and how many rows it has. */
static int64_t lay_out(int64_t V, hg_lanes *memory, hg_xpbd_tile *t)
{
    const int64_t E = V - 1;
    const struct {
        hg_lanes **rows;
        int64_t count;
    } parts[] = {
        { &t->x, 3 * V },           { &t->before, 3 * V },     { &t->velocity, 3 * V },    { &t->pin, 3 * V },
        { &t->pin_to, 3 * V },      { &t->weight, V },         { &t->q, 4 * E },           { &t->q_before, 4 * E },
        { &t->q_velocity, 4 * E },  { &t->q_pin, 4 * E },      { &t->q_pin_to, 4 * E },    { &t->root, 4 },
        { &t->root_pin, 4 },        { &t->root_pin_to, 4 },    { &t->q_weight, E },        { &t->shear, E },
        { &t->over_length, E },     { &t->bend, E },           { &t->rest, 4 * E },        { &t->style, V },
        { &t->posed, 3 * V },       { &t->normal, 3 * V },     { &t->offset, V },          { &t->clearance, V },
        { &t->shear_force, 3 * E }, { &t->bend_force, 4 * E }, { &t->style_force, 3 * V }, { &t->contact_force, V },
        { &t->aim, 3 * V },         { &t->q_aim, 4 * E },      { &t->start, 3 * V },       { &t->from, 3 * V },
        { &t->q_from, 4 * E },      { &t->good_x, 3 * V },     { &t->good_q, 4 * E },      { &t->good_normal, 3 * V },
        { &t->good_offset, V },     { &t->pace, 1 },           { &t->energy, 1 },          { &t->moved, 1 }
    };
    int64_t rows = 0;
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
        *parts[i].rows = memory ? memory + rows : NULL;
        rows += parts[i].count;
    }
    return rows;
}

void hg_xpbd_tile_at(const hg_xpbd *s, int64_t tile, hg_xpbd_tile *rows)
{
    lay_out(s->V, s->memory + tile * s->rows, rows);
}

void hg_xpbd_destroy(hg_xpbd *s)
{
    if (!s) return;
    double *const numbers[] = { s->rest,      s->rest_frame, s->points,        s->orientation,    s->moved, s->body,
                                s->body_from, s->body_to,    s->contact_point, s->contact_normal, s->push,  s->room,
                                s->searched,  s->ask_point,  s->ask_contact,   s->ask_normal };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) hg_free(numbers[i]);
    hg_free(s->memory);
    hg_free(s->scratch);
    hg_free(s->triangle);
    hg_free(s->ask);
    hg_free(s->ask_triangle);
    hg_body_refit_destroy(s->refit);
    hg_neighbours_destroy(s->neighbours);
    hg_free(s);
}

static hg_status take_memory(hg_xpbd *s)
{
    hg_xpbd_tile none;
    const size_t points = (size_t)(s->S * s->V * 3) + 1, edges = (size_t)(s->S * s->E * 4) + 1;
    s->rows = lay_out(s->V, NULL, &none);
    s->memory = hg_alloc((size_t)(s->tiles * s->rows) + 1, sizeof *s->memory);
    s->scratch = hg_alloc((size_t)(hg_ctx_threads(s->ctx) * s->E) + 1,
                          (2 * HG_XPBD_BLOCK + 1) * HG_XPBD_BLOCK * sizeof(hg_lanes));
    s->rest = hg_alloc(points, sizeof(double));
    s->points = hg_alloc(points, sizeof(double));
    s->rest_frame = hg_alloc(edges, sizeof(double));
    s->orientation = hg_alloc(edges, sizeof(double));
    s->moved = hg_alloc((size_t)s->S + 1, sizeof(double));
    if (!s->memory || !s->scratch || !s->rest || !s->points || !s->rest_frame || !s->orientation || !s->moved)
        return HG_MEMORY;
    if (s->contact) {
        const size_t body = (size_t)(3 * hg_body_tree_vertices(s->tree)) + 1;
        double **const bodies[] = { &s->body, &s->body_from, &s->body_to };
        double **const vertices[] = { &s->contact_point, &s->contact_normal, &s->room,      &s->searched,
                                      &s->ask_point,     &s->ask_contact,    &s->ask_normal };
        int32_t **const indices[] = { &s->triangle, &s->ask, &s->ask_triangle };
        for (int i = 0; i < 3; i++)
            if (!(*bodies[i] = hg_alloc(body, sizeof(double))) || !(*indices[i] = hg_alloc(points, sizeof(int32_t))))
                return HG_MEMORY;
        for (int i = 0; i < 7; i++)
            if (!(*vertices[i] = hg_alloc(points, sizeof(double)))) return HG_MEMORY;
        HG_TRY(hg_body_refit_create(&s->refit, s->tree, HG_F64));
    }
    if (s->options.strand_distance > 0) {
        s->push = hg_alloc(points, sizeof(double));
        if (!s->push) return HG_MEMORY;
        HG_TRY(hg_neighbours_create(&s->neighbours, 0));
    }
    return HG_OK;
}

/* ---- energies into constraints ----------------------------------------------------------------------------------- */

/* What the terms of a config come to, for one strand after another. */
typedef struct {
    double stretch, shear;    /* N/m, J */
    double bend, cosserat;    /* N m^2, N m^3 */
    double clamp;             /* N m^2 of the root */
    double style, s_max;      /* N/m, m */
    const double *near, *far; /* [S,V] distances of hair_style and of body_collision at rest */
} material;

static bool is(const hg_term *term, const char *name) { return !strcmp(term->energy->name, name); }

static hg_status take_bend(hg_xpbd *s, const hg_term *term, material *m)
{
    const double k = term->weight * hg_term_param(term, "stiffness");
    if (is(term, "cosserat_bend_twist")) return m->cosserat += k, HG_OK;
    m->bend += k;
    s->smooth = !strcmp(hg_term_option(term, "strain"), "smooth");
    if (!strcmp(hg_term_option(term, "root"), "clamped")) m->clamp += k;
    return HG_OK;
}

static hg_status take_style(const hg_term *term, const hg_groom_data *data, material *m)
{
    const char *name = strcmp(hg_term_option(term, "surface"), "scalp") ? "body_distance" : "scalp_distance";
    m->near = hg_groom_attribute_find(data, name);
    if (!m->near) return hg_fail(HG_INVALID, "xpbd: hair_style needs the groom attribute %s", name);
    m->style += term->weight * hg_term_param(term, "stiffness");
    m->s_max = hg_term_param(term, "s_max");
    return HG_OK;
}

static hg_status take_contact(hg_xpbd *s, const hg_term *term, const hg_groom_data *data, material *m)
{
    if (!data->body) return hg_fail(HG_INVALID, "xpbd: body_collision needs a body, which the groom data do not have");
    s->contact = true;
    s->tree = data->body;
    s->contact_stiffness = term->weight * hg_term_param(term, "stiffness");
    s->contact_distance = hg_term_param(term, "distance");
    s->mode = strcmp(hg_term_option(term, "mode"), "plane") ? HG_CONTACT_EXACT : HG_CONTACT_PLANE;
    if (strcmp(hg_term_option(term, "rest_clearance"), "true")) return HG_OK;
    m->far = hg_groom_attribute_find(data, "body_distance");
    return m->far ? HG_OK : hg_fail(HG_INVALID, "xpbd: rest_clearance needs the groom attribute body_distance");
}

static hg_status take_term(hg_xpbd *s, const hg_term *given, const hg_groom_data *data, material *m)
{
    double params[HG_ENERGY_PARAMS];
    const char *options[HG_ENERGY_OPTIONS];
    HG_TRY(hg_term_complete(given, params, options));
    const hg_term completed = { given->energy, given->weight, params, options }, *term = &completed;
    if (is(term, "stretch")) return m->stretch += term->weight * hg_term_param(term, "stiffness"), HG_OK;
    if (is(term, "cosserat_stretch_shear")) return m->shear += term->weight * hg_term_param(term, "stiffness"), HG_OK;
    if (is(term, "bend_twist") || is(term, "bend_twist_chain") || is(term, "cosserat_bend_twist"))
        return take_bend(s, term, m);
    if (is(term, "drag")) return s->drag += term->weight * hg_term_param(term, "c"), HG_OK;
    if (is(term, "hair_style")) return take_style(term, data, m);
    if (is(term, "body_collision")) return take_contact(s, term, data, m);
    if (is(term, "gravity")) {
        static const char *const axes[3] = { "g.x", "g.y", "g.z" };
        for (int c = 0; c < 3; c++) s->gravity[c] += term->weight * hg_term_param(term, axes[c]);
        return HG_OK;
    }
    if (is(term, "inertia") || is(term, "unit_quaternion")) return HG_OK;
    const size_t used = strlen(s->left_out), length = strlen(term->energy->name);
    if (used + length + 3 < sizeof s->left_out) {
        memcpy(s->left_out + used, ", ", used ? 2 : 0);
        memcpy(s->left_out + used + (used ? 2 : 0), term->energy->name, length + 1);
    }
    return HG_OK;
}

/* ---- strands into lanes ------------------------------------------------------------------------------------------- */

static hg_vec3d tangent(const double *a, double *length)
{
    const hg_vec3d e = hg_vec3d_sub(hg_vec3d_load(a + 3), hg_vec3d_load(a));
    *length = fmax(hg_vec3d_norm(e), 1e-6);
    return hg_vec3d_scale(e, 1 / fmax(hg_vec3d_norm(e), 1e-3 * *length));
}

static void put(hg_lanes *rows, int lane, hg_quatd q)
{
    rows[0][lane] = q.w, rows[1][lane] = q.x, rows[2][lane] = q.y, rows[3][lane] = q.z;
}

static hg_quatd take(const hg_lanes *rows, int lane)
{
    return hg_quatd_make(rows[0][lane], rows[1][lane], rows[2][lane], rows[3][lane]);
}

static void frames_at_rest(const hg_xpbd *s, int64_t strand)
{
    const double *rest = s->rest + strand * s->V * 3;
    hg_vec3d before = hg_vec3d_make(0, 0, 1);
    hg_quatd q = hg_quatd_identity();
    for (int64_t i = 0; i < s->E; i++) {
        double length;
        const hg_vec3d t = tangent(rest + 3 * i, &length);
        q = hg_quatd_normalize(hg_quatd_mul(hg_quatd_transport(before, t), q));
        hg_quatd_store(s->rest_frame + (strand * s->E + i) * 4, q);
        before = t;
    }
}

/* A vertex without mass, or nearly so, would make steps of any length: it has at least a thousandth of its strand's mean. */
static double mass_of(const hg_groom_data *data, int64_t strand, int64_t v)
{
    const int64_t V = data->vertices;
    if (!data->mass) return 1;
    double sum = 0;
    for (int64_t k = 0; k < V; k++) sum += data->mass[strand * V + k];
    return sum > 0 ? fmax(data->mass[strand * V + v], 1e-3 * sum / (double)V) : 1;
}

static void fill_lane(const hg_xpbd *s, const hg_xpbd_tile *t, int lane, int64_t strand, const hg_groom_data *data,
                      const material *m)
{
    const int64_t V = s->V, E = s->E;
    const double *rest = s->rest + strand * V * 3, *frame = s->rest_frame + strand * E * 4;
    double whole = 0, length, last = 0;
    for (int64_t i = 0; i < E; i++) tangent(rest + 3 * i, &length), whole += length;
    for (int64_t v = 0; v < V; v++) {
        t->weight[v][lane] = v < s->pinned ? 0 : 1 / mass_of(data, strand, v);
        const double near = m->near ? fmax(m->near[strand * V + v], 0) : 0;
        t->style[v][lane] = m->near ? 2 * m->style * (1 - fmin(1, near / m->s_max)) : 0;
        t->clearance[v][lane] =
            m->far ? fmin(s->contact_distance, fmax(m->far[strand * V + v], 0.5e-3)) : s->contact_distance;
    }
    for (int64_t i = 0; i < E; i++, last = length) {
        tangent(rest + 3 * i, &length);
        const double thick = fmax(length, 0.1 * whole / (double)E), mean = i ? (length + last) / 2 : length;
        const double mass = 0.5 * (mass_of(data, strand, i) + mass_of(data, strand, i + 1));
        t->q_weight[i][lane] = i + 1 < s->pinned ? 0 : (s->options.sweeps ? 3 : 300) / (mass * thick * thick);
        t->over_length[i][lane] = 1 / length;
        t->shear[i][lane] = m->stretch * length * length + m->shear;
        t->bend[i][lane] = i ? 4 * (m->bend + m->cosserat / mean) / mean : 4 * m->clamp / mean;
        put(t->rest + 4 * i, lane,
            i ? hg_quatd_mul(hg_quatd_conj(hg_quatd_load(frame + 4 * i - 4)), hg_quatd_load(frame + 4 * i))
              : hg_quatd_identity());
    }
}

static void defaults(hg_xpbd_options *o)
{
    if (o->pinned <= 0) o->pinned = 1;
    if (o->iterations <= 0) o->iterations = o->sweeps ? 10 : 1;
    if (o->steps <= 0) o->steps = 200;
    if (!(o->movement > 0)) o->movement = 1e-6;
}

static hg_status fill(hg_xpbd *s, const hg_term *terms, int n, const hg_groom_data *data)
{
    material m = { 0 };
    for (int i = 0; i < n; i++) HG_TRY(take_term(s, &terms[i], data, &m));
    if (!(m.stretch + m.shear > 0))
        return hg_fail(HG_INVALID, "xpbd: no energy holds edges together: it needs stretch or cosserat_stretch_shear");
    s->styled = m.style > 0;
    s->twist = m.bend > 0 ? 1000 : 1;
    HG_TRY(take_memory(s));
    memcpy(s->rest, data->rest, (size_t)(s->S * s->V * 3) * sizeof *s->rest);
    for (int64_t i = 0; i < s->S; i++) frames_at_rest(s, i);
    for (int64_t tile = 0; tile < s->tiles; tile++) {
        hg_xpbd_tile t;
        hg_xpbd_tile_at(s, tile, &t);
        for (int l = 0; l < HG_XPBD_LANES; l++) fill_lane(s, &t, l, hg_xpbd_strand(s, tile, l), data, &m);
    }
    return HG_OK;
}

hg_status hg_xpbd_create(hg_xpbd **out, hg_ctx *ctx, const hg_term *terms, int n, const hg_groom_data *data,
                         const hg_xpbd_options *options)
{
    *out = NULL;
    if (!hg_ctx_host(ctx))
        return hg_fail(HG_UNSUPPORTED, "xpbd: it runs on the processor; give it the context of hg_ctx_on_host");
    if (data->strands < 0 || data->vertices < 1)
        return hg_fail(HG_INVALID, "xpbd: %lld strands of %lld vertices", (long long)data->strands,
                       (long long)data->vertices);
    hg_xpbd *s = hg_alloc(1, sizeof *s);
    if (!s) return HG_MEMORY;
    s->ctx = ctx;
    if (options) s->options = *options;
    defaults(&s->options);
    s->S = data->strands, s->V = data->vertices, s->E = s->V - 1;
    s->tiles = (s->S + HG_XPBD_LANES - 1) / HG_XPBD_LANES;
    s->pinned = s->options.pinned < s->V ? s->options.pinned : (int)s->V;
    const hg_status status = fill(s, terms, n, data);
    if (status != HG_OK) {
        hg_xpbd_destroy(s);
        return status;
    }
    *out = s;
    return HG_OK;
}

const char *hg_xpbd_left_out(const hg_xpbd *s) { return s->left_out; }

/* ---- a frame ------------------------------------------------------------------------------------------------------ */

static hg_status check(const hg_xpbd *s, const hg_tensor *tensor, const char *name, bool needed, int64_t rows,
                       int64_t width)
{
    char text[96];
    if (!tensor && !needed) return HG_OK;
    if (!tensor) return hg_fail(HG_INVALID, "xpbd: %s is missing", name);
    if (tensor->dtype == HG_F64 && hg_tensor_count(tensor) == rows * width && tensor->shape[tensor->rank - 1] == width)
        return HG_OK;
    return hg_fail(HG_INVALID, "xpbd: %s is %s; expected f64, %lld times %lld for one frame of %lld strands", name,
                   hg_shape_text(tensor, text), (long long)rows, (long long)width, (long long)s->S);
}

static hg_status check_frame(const hg_xpbd *s, const hg_frame *frame, const hg_tensor *x)
{
    HG_TRY(check(s, x, "x", true, s->S * s->V, 3));
    HG_TRY(check(s, frame->root_rotation, "root_rotation", false, s->S, 4));
    HG_TRY(check(s, frame->root_position, "root_position", false, s->S, 3));
    HG_TRY(check(s, frame->posed, "posed", false, s->S * s->V, 3));
    if (!s->contact) return HG_OK;
    return check(s, frame->body_vertices, "body_vertices", true, hg_body_tree_vertices(s->tree), 3);
}

static hg_quatd root_turn(const hg_frame *frame, int64_t strand)
{
    return frame->root_rotation ? hg_quatd_normalize(hg_quatd_load((double *)frame->root_rotation->data + 4 * strand))
                                : hg_quatd_identity();
}

static hg_vec3d posed_at(const hg_xpbd *s, const hg_frame *frame, int64_t strand, int64_t v, hg_quatd turn)
{
    if (frame->posed) return hg_vec3d_load((double *)frame->posed->data + (strand * s->V + v) * 3);
    const double *rest = s->rest + strand * s->V * 3;
    const hg_vec3d root = hg_vec3d_load(rest);
    const hg_vec3d at = frame->root_position ? hg_vec3d_load((double *)frame->root_position->data + 3 * strand) : root;
    return hg_vec3d_add(at, hg_quatd_rotate(turn, hg_vec3d_sub(hg_vec3d_load(rest + 3 * v), root)));
}

/* The frame of an edge at rest, turned with its root, and on by the shortest way to where the edge is now. */
static hg_quatd frame_of(const hg_xpbd *s, int64_t strand, int64_t i, hg_quatd turn, const double *edge)
{
    double length;
    const hg_quatd posed = hg_quatd_mul(turn, hg_quatd_load(s->rest_frame + (strand * s->E + i) * 4));
    const hg_vec3d now = tangent(edge, &length), was = hg_quatd_rotate(posed, hg_vec3d_make(0, 0, 1));
    return hg_quatd_normalize(hg_quatd_mul(hg_quatd_transport(was, now), posed));
}

typedef struct {
    hg_xpbd *solver;
    const hg_frame *frame;
    const double *x; /* NULL: a step; else all is placed there */
} placing;

static void place_lane(const placing *p, const hg_xpbd_tile *t, int lane, int64_t strand)
{
    const hg_xpbd *s = p->solver;
    const hg_quatd turn = root_turn(p->frame, strand);
    hg_vec3d before = { 0, 0, 0 };
    for (int64_t v = 0; v < s->V; v++) {
        double posed[3];
        hg_vec3d_store(posed, posed_at(s, p->frame, strand, v, turn));
        const double *x = p->x ? p->x + (strand * s->V + v) * 3 : posed;
        for (int c = 0; c < 3; c++) {
            t->posed[3 * v + c][lane] = posed[c];
            t->pin[3 * v + c][lane] = p->x ? x[c] : t->pin_to[3 * v + c][lane];
            t->pin_to[3 * v + c][lane] = x[c];
            if (p->x) t->x[3 * v + c][lane] = x[c], t->velocity[3 * v + c][lane] = 0;
        }
        const int64_t i = v - 1;
        const double edge[6] = { before.x, before.y, before.z, x[0], x[1], x[2] };
        before = hg_vec3d_load(x);
        if (i < 0 || (!p->x && v >= s->pinned)) continue;
        const hg_quatd q = frame_of(s, strand, i, turn, edge);
        put(t->q_pin + 4 * i, lane, p->x ? q : take(t->q_pin_to + 4 * i, lane));
        put(t->q_pin_to + 4 * i, lane, q);
        if (p->x) put(t->q + 4 * i, lane, q), put(t->q_velocity + 4 * i, lane, hg_quatd_make(0, 0, 0, 0));
    }
    if (p->x) t->pace[0][lane] = 1.0 / 16, t->energy[0][lane] = t->moved[0][lane] = (double)INFINITY;
    if (!s->E) return;
    const hg_quatd root = hg_quatd_mul(turn, hg_quatd_load(s->rest_frame + strand * s->E * 4));
    put(t->root_pin, lane, p->x ? root : take(t->root_pin_to, lane));
    put(t->root_pin_to, lane, root);
    if (!p->x) return;
    for (int64_t k = 0; k < s->E; k++) {
        t->shear_force[3 * k][lane] = t->shear_force[3 * k + 1][lane] = t->shear_force[3 * k + 2][lane] = 0;
        put(t->bend_force + 4 * k, lane, hg_quatd_make(0, 0, 0, 0));
    }
    for (int64_t v = 0; v < s->V; v++) {
        for (int c = 0; c < 3; c++) t->style_force[3 * v + c][lane] = t->normal[3 * v + c][lane] = 0;
        t->contact_force[v][lane] = t->offset[v][lane] = 0;
    }
}

static void place_range(const void *args, int64_t first, int64_t last)
{
    const placing *p = args;
    for (int64_t tile = first; tile < last; tile++) {
        hg_xpbd_tile t;
        hg_xpbd_tile_at(p->solver, tile, &t);
        for (int l = 0; l < HG_XPBD_LANES; l++) place_lane(p, &t, l, hg_xpbd_strand(p->solver, tile, l));
    }
}

static hg_status place(hg_xpbd *s, const hg_frame *frame, const double *x)
{
    static const hg_kernel kernel = {
        .name = "xpbd_place", .args_size = sizeof(placing), .cpu = place_range, .block = 4
    };
    if (s->contact) {
        const size_t bytes = (size_t)(3 * hg_body_tree_vertices(s->tree)) * sizeof(double);
        memcpy(s->body_from, x ? frame->body_vertices->data : s->body_to, bytes);
        memcpy(s->body_to, frame->body_vertices->data, bytes);
        double way = 0;
        for (int64_t i = 0; i < 3 * hg_body_tree_vertices(s->tree); i += 3)
            way = fmax(way, hg_vec3d_distance(hg_vec3d_load(s->body_from + i), hg_vec3d_load(s->body_to + i)));
        s->body_way = way;
        s->fitted = false;
        if (x) s->known = false;
        for (int64_t i = 0; x && i < s->S * s->V; i++) s->triangle[i] = -1, s->room[i] = -1;
    }
    if (x) memcpy(s->points, x, (size_t)(s->S * s->V * 3) * sizeof *x);
    return hg_launch(s->ctx, &kernel, s->tiles, &(placing){ s, frame, x });
}

hg_status hg_xpbd_place(hg_xpbd *s, const hg_frame *frame, const hg_tensor *x)
{
    HG_TRY(check_frame(s, frame, x));
    const double *from = x->data;
    for (int64_t i = 0; i < hg_tensor_count(x); i++)
        if (!isfinite(from[i]))
            return hg_fail(HG_NUMERIC, "xpbd: strand %lld, vertex %lld of the start is not finite",
                           (long long)(i / 3 / s->V), (long long)(i / 3 % s->V));
    s->placed = true;
    return place(s, frame, from);
}

/* ---- steps -------------------------------------------------------------------------------------------------------- */

static double seconds_of(const hg_xpbd *s, const hg_frame *frame)
{
    return s->options.dt > 0 ? s->options.dt : frame->dt > 0 ? frame->dt : 1.0 / 30;
}

static hg_status search(hg_xpbd *s, double part, double way)
{
    if (s->neighbours) HG_TRY(hg_xpbd_part_strands(s));
    return s->contact ? hg_xpbd_find_contact(s, part, way) : HG_OK;
}

/* Contact is searched for between launches, before every substep: planes that are older throw the hair about. */
static hg_status one_step(hg_xpbd *s, double dt, bool dynamic)
{
    const int substeps = s->options.substeps > 0 ? s->options.substeps : dynamic || s->options.sweeps ? 20 : 1;
    const bool searches = s->contact || s->neighbours;
    const int at_once = searches ? 1 : substeps;
    for (int sub = 0; sub < substeps; sub += at_once) {
        HG_TRY(search(s, (sub + 1) / (double)substeps, s->body_way / substeps));
        const hg_xpbd_run run = { s, sub, sub + at_once, substeps, dt / substeps, dynamic };
        HG_TRY(hg_xpbd_run_tiles(&run));
    }
    return HG_OK;
}

static hg_status measure(const hg_xpbd *s, hg_xpbd_solution *solution)
{
    double square = 0;
    solution->at_rest = 0;
    for (int64_t i = 0; i < s->S; i++) {
        if (!isfinite(s->moved[i]))
            return hg_fail(HG_NUMERIC, "xpbd: strand %lld became not finite; a shorter step or more substeps may help",
                           (long long)i);
        square = fmax(square, s->moved[i]);
        solution->at_rest += s->moved[i] < s->options.movement * s->options.movement;
    }
    solution->movement = sqrt(square);
    solution->steps++;
    return HG_OK;
}

static hg_status finish(hg_xpbd *s, hg_tensor *x, hg_xpbd_solution *solution)
{
    solution->strands = s->S;
    solution->orientation = s->orientation;
    return hg_tensor_write(x, s->points);
}

hg_status hg_xpbd_rest(hg_xpbd *s, const hg_frame *frame, hg_tensor *x, hg_xpbd_solution *solution)
{
    hg_xpbd_solution unused;
    if (!solution) solution = &unused;
    *solution = (hg_xpbd_solution){ 0 };
    HG_TRY(hg_xpbd_place(s, frame, x));
    do {
        if ((solution->interrupted = s->options.stop && s->options.stop(s->options.stop_self))) break;
        HG_TRY(one_step(s, seconds_of(s, frame), false));
        HG_TRY(measure(s, solution));
    } while (solution->at_rest < s->S && solution->steps < s->options.steps);
    HG_TRY(search(s, 1, 0));
    HG_TRY(hg_xpbd_run_tiles(&(hg_xpbd_run){ s, 1, 1, 1, seconds_of(s, frame), false }));
    return finish(s, x, solution);
}

hg_status hg_xpbd_step(hg_xpbd *s, const hg_frame *frame, hg_tensor *x, hg_xpbd_solution *solution)
{
    hg_xpbd_solution unused;
    if (!solution) solution = &unused;
    *solution = (hg_xpbd_solution){ 0 };
    if (!s->placed) return hg_fail(HG_INVALID, "xpbd: a step before hg_xpbd_place or hg_xpbd_rest");
    HG_TRY(check_frame(s, frame, x));
    HG_TRY(place(s, frame, NULL));
    HG_TRY(one_step(s, seconds_of(s, frame), true));
    HG_TRY(measure(s, solution));
    return finish(s, x, solution);
}
