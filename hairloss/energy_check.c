/* The gradients of an energy, a user's own too, against finite differences: on a few bent strands above a box, turned and
 * moved, with a last and a predicted frame, so that every known energy has something to act on. Every input that the
 * formulas ask for is checked, one after another: it alone is a tensor on the tape. */
#include "hairloss/physics.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { frames = 2, strands = 6, vertices = 7, strand_count = frames * strands, vertex_count = strand_count * vertices };
enum { most_values = vertex_count * 4 };

typedef struct {
    double rest[strands * vertices * 3], mass[strands * vertices], distance[strands * vertices];
    double x[vertex_count * 3], predicted[vertex_count * 3], previous[vertex_count * 3], posed[vertex_count * 3];
    double rotation[strand_count * 4], position[strand_count * 3], body[frames * 8 * 3];
} scene;

static double noise(uint64_t stream, int i) { return 2.0 * hg_random_uniform(11, stream, (uint64_t)i) - 1.0; }

static void rotate(const double q[4], const double v[3], double out[3])
{
    const double t[3] = { 2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]),
                          2 * (q[1] * v[1] - q[2] * v[0]) };
    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

static void make_rest(scene *s)
{
    const double edge = 4e-3;
    for (int i = 0; i < strands; i++) {
        double at[3] = { 2e-3 * noise(1, 3 * i), 2e-3 + 1e-3 * noise(1, 3 * i + 1), 2e-3 * noise(1, 3 * i + 2) };
        for (int v = 0; v < vertices; v++) {
            int k = i * vertices + v;
            double angle = 0.6 * v + 3.0 * noise(2, i);
            for (int c = 0; c < 3; c++) s->rest[3 * k + c] = at[c];
            s->mass[k] = 2.6e-8 * (1.0 + 0.3 * noise(3, k));
            s->distance[k] = at[1];
            at[0] += edge * (0.5 * cos(angle) + 0.1 * noise(4, k));
            at[1] += edge * (0.7 + 0.1 * noise(5, k));
            at[2] += edge * (0.5 * sin(angle) + 0.1 * noise(6, k));
        }
    }
}

static void make_frames(scene *s)
{
    const double edge = 4e-3;
    for (int i = 0; i < strand_count; i++) {
        const double *rest = s->rest + i % strands * vertices * 3;
        double *q = s->rotation + 4 * i, *p = s->position + 3 * i, length = 1.0;
        q[0] = 1.0;
        for (int c = 0; c < 3; c++) {
            q[c + 1] = 0.2 * noise(7, 3 * i + c);
            length += q[c + 1] * q[c + 1];
            p[c] = rest[c] + (c == 1 ? 0.0 : 1e-3) * noise(8, 3 * i + c);
        }
        for (int c = 0; c < 4; c++) q[c] /= sqrt(length);
        for (int v = 0; v < vertices; v++) {
            const double arm[3] = { rest[3 * v] - rest[0], rest[3 * v + 1] - rest[1], rest[3 * v + 2] - rest[2] };
            double turned[3];
            rotate(q, arm, turned);
            for (int c = 0; c < 3; c++) {
                int k = (i * vertices + v) * 3 + c;
                s->posed[k] = p[c] + turned[c];
                s->x[k] = p[c] + turned[c] + 0.1 * edge * noise(9, k);
                s->previous[k] = p[c] + turned[c] + 0.3 * edge * noise(10, k);
                s->predicted[k] = p[c] + turned[c] + 0.3 * edge * noise(11, k);
            }
        }
    }
    for (int i = 0; i < frames * 8; i++) /* a box whose upper face is y = 0 */
        for (int c = 0; c < 3; c++)
            s->body[3 * i + c] = c == 1 ? (i & 2 ? 0.0 : -0.1) : i & (c == 0 ? 1 : 4) ? 0.1 : -0.1;
}

/* ---- inputs by name --------------------------------------------------------------------------------------------- */

/* Sizes of the axes of "[B,S,V-1,4]". */
static int axes_of(const char *shape, int64_t sizes[HG_MAX_RANK], char letters[HG_MAX_RANK])
{
    int rank = 0;
    for (const char *at = shape + 1; *at && *at != ']'; at++) {
        if (*at == ',') continue;
        if (strncmp(at, "V-1", 3) == 0) {
            letters[rank] = 'E';
            sizes[rank++] = vertices - 1;
            at += 2;
            continue;
        }
        letters[rank] = *at;
        sizes[rank++] = *at == 'B' ? frames : *at == 'G' ? 1 : *at == 'S' ? strands : *at == 'V' ? vertices : *at - '0';
    }
    return rank;
}

enum { most_tensors = HG_ENERGY_INPUTS + 2 };

typedef struct {
    hg_ctx *ctx;
    const scene *scene;
    const hg_body_tree *body;
    const hg_energy *energy;
    const char *const *options;
    const hg_gradcheck_options *how;
    hg_physics *physics;
    hg_frame frame;
    hg_frame_input inputs[most_tensors];
    hg_tensor *tensors[most_tensors];
    int n_tensors;
    double *values; /* room for one input */
    double density; /* what a neighbour counts in a density: 1, or its mass */
} subject;

/* What the scene has under a name, and how large a change of it is. Names of a user's own energy get positions near the
 * strands, or distances. */
static double fill(const subject *of, const hg_energy_input *input, int64_t n, double *to)
{
    const scene *s = of->scene;
    const hg_energy *energy = of->energy;
    const struct {
        const char *name;
        const double *values;
        double unit;
    } known[] = {
        { "x", s->x, 1e-2 },
        { "rest", s->rest, 1e-2 },
        { "posed", s->posed, 1e-2 },
        { "predicted", s->predicted, 1e-2 },
        { "previous", s->previous, 1e-2 },
        { "root_rotation", s->rotation, 1 },
        { "root_position", s->position, 1e-2 },
        { "mass", s->mass, 2.6e-8 },
    };
    for (size_t k = 0; k < sizeof known / sizeof *known; k++)
        if (strcmp(input->name, known[k].name) == 0) {
            memcpy(to, known[k].values, (size_t)n * sizeof *to);
            return known[k].unit;
        }
    if (strcmp(input->name, "dt") == 0) {
        *to = 1.0 / 30.0;
        return *to;
    }
    if (strcmp(input->name, "q") == 0) { /* unlike each other, and not of length 1 */
        for (int64_t i = 0; i < n; i++) to[i] = (i % 4 == 0) + 0.5 * noise(20, (int)i);
        return 1;
    }
    const char *dot = strchr(input->name, '.'); /* "stretch.stiffness" */
    for (int p = 0; dot && p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
        const double value = energy->params[p].value;
        if (strcmp(energy->params[p].name, dot + 1) != 0) continue;
        for (int64_t i = 0; i < n; i++) to[i] = value * (n > 1 ? 1 + 0.3 * noise(25, (int)i) : 1);
        return value != 0 ? fabs(value) : 1;
    }
    /* of a user's own energy, or a ghost: some of them farther than half a strand */
    const bool groom = input->shape[1] == 'G', vectors = strcmp(input->shape, "[B,S,V,3]") == 0;
    for (int64_t i = 0; i < n; i++) {
        if (strcmp(input->name, "strand_length") == 0)
            to[i] = 0.024 + 0.002 * noise(21, (int)(i / vertices)); /* six edges of 4 mm */
        else if (strcmp(input->name, "density_rest") == 0)
            to[i] = (2 + noise(22, (int)i)) * of->density;
        else if (vectors)
            to[i] = s->x[i] + 0.015 * noise(23, (int)i);
        else
            to[i] = groom ? s->distance[i] : 1 + 0.3 * noise(24, (int)i);
    }
    return strcmp(input->name, "density_rest") == 0 ? of->density : 1e-2;
}

/* "x: frame 1, strand 4, vertex 2, y" */
static void name_element(const hg_energy_input *input, int64_t element, char *text, size_t room)
{
    int64_t sizes[HG_MAX_RANK], below = 1;
    char letters[HG_MAX_RANK];
    const int rank = axes_of(input->shape, sizes, letters);
    int length = snprintf(text, room, "%s", input->name);
    for (int i = 0; i < rank; i++) below *= sizes[i];
    for (int i = 0; i < rank && length < (int)room; i++) {
        below /= sizes[i];
        const int at = (int)(element / below % sizes[i]);
        const char *word = letters[i] == 'B'   ? "frame"
                           : letters[i] == 'G' ? "groom"
                           : letters[i] == 'S' ? "strand"
                           : letters[i] == 'V' ? "vertex"
                                               : "edge";
        const char *separator = i ? "," : ":";
        if (letters[i] == '3' || letters[i] == '4')
            length += snprintf(text + length, room - (size_t)length, "%s %c", separator,
                               letters[i] == '3' ? "xyz"[at] : "wxyz"[at]);
        else
            length += snprintf(text + length, room - (size_t)length, "%s %s %d", separator, word, at);
    }
}

/* Tensors that live as long as the check: the step is rewound between evaluations. */
static hg_tensor *keep(hg_ctx *ctx, const char *shape, const double *values)
{
    int64_t sizes[HG_MAX_RANK];
    char letters[HG_MAX_RANK];
    const int rank = axes_of(shape, sizes, letters);
    hg_tensor *tensor = hg_tensor_create(ctx, HG_F64, rank, sizes);
    if (tensor != NULL && hg_tensor_write(tensor, values) == HG_OK) return tensor;
    hg_tensor_destroy(tensor);
    return NULL;
}

/* ---- one input -------------------------------------------------------------------------------------------------- */

/* in: x, then the input that is checked where that is another one. */
static hg_tensor *energy_of(void *self, hg_ctx *ctx, hg_tensor **in)
{
    subject *of = self;
    return hg_physics_energy(of->physics, ctx, &of->frame, in[0], NULL);
}

static hg_status bring(subject *of, const hg_energy_input *input, hg_tensor **made, double *unit)
{
    int64_t sizes[HG_MAX_RANK], n = 1;
    char letters[HG_MAX_RANK];
    const int rank = axes_of(input->shape, sizes, letters);
    for (int i = 0; i < rank; i++) n *= sizes[i];
    *unit = fill(of, input, n, of->values);
    *made = of->tensors[of->n_tensors] = keep(of->ctx, input->shape, of->values);
    if (*made == NULL) return hg_fail(HG_MEMORY, "out of memory: gradcheck of %s", of->energy->name);
    of->n_tensors++;
    const struct {
        const char *name;
        hg_tensor **to;
    } members[] = {
        { "posed", &of->frame.posed },
        { "predicted", &of->frame.predicted },
        { "previous", &of->frame.previous },
        { "root_rotation", &of->frame.root_rotation },
        { "root_position", &of->frame.root_position },
    };
    for (size_t i = 0; i < sizeof members / sizeof *members; i++)
        if (strcmp(input->name, members[i].name) == 0) {
            *members[i].to = *made;
            return HG_OK;
        }
    of->inputs[of->frame.n_inputs++] = (hg_frame_input){ input->name, *made };
    return HG_OK;
}

/* Is it a tensor of its own in the frame, or something that the groom and the term have unless it is checked? */
static bool always_brought(const hg_energy_input *input)
{
    return input->shape[1] == 'B' && strcmp(input->name, "x") != 0 && strcmp(input->name, "body_vertices") != 0;
}

static hg_status create_physics(subject *of, const hg_energy_inputs *asks)
{
    const scene *s = of->scene;
    hg_groom_attribute attributes[HG_ENERGY_INPUTS];
    hg_groom_data data = { .grooms = 1,
                           .strands = strands,
                           .vertices = vertices,
                           .rest = s->rest,
                           .mass = s->mass,
                           .attributes = attributes,
                           .body = of->body };
    for (int i = 0; i < asks->n; i++) {
        const hg_energy_input *input = &asks->input[i];
        if (strcmp(input->shape, "[G,S,V]") == 0 && strcmp(input->name, "mass") != 0 && !input->optional)
            attributes[data.n_attributes++] = (hg_groom_attribute){ input->name, s->distance };
    }
    const hg_term term = { .energy = of->energy, .weight = 1.5, .options = of->options };
    return hg_physics_create(&of->physics, of->ctx, HG_F64, &term, 1, &data);
}

/* The check of one input with the frame and the physics at hand; x is checked where `wanted` is NULL. */
static hg_status check_input(subject *of, const hg_energy_input *wanted, bool unknown, hg_tensor *x,
                             hg_gradcheck_result *result, bool *no_effect)
{
    hg_tensor *in[2] = { x, NULL };
    const hg_energy_input positions = { .name = "x", .shape = "[B,S,V,3]" };
    const char *names[2] = { "x", wanted ? wanted->name : NULL };
    double units[2] = { 1e-2, 1e-2 };
    hg_gradcheck_options options = of->how ? *of->how : (hg_gradcheck_options){ 0 };
    if (!(options.step > 0)) options.step = 1e-2;
    options.names = names;
    options.units = units;
    options.zero_gradient |= !unknown;
    if (wanted) {
        bool there = false; /* brought to every check of this energy */
        for (int i = 0; i < of->frame.n_inputs; i++)
            if (strcmp(of->inputs[i].name, wanted->name) == 0) in[1] = of->inputs[i].value, there = true;
        if (!there) HG_TRY(bring(of, wanted, &in[1], &units[1]));
        units[1] = fill(of, wanted, hg_tensor_count(in[1]), of->values);
    }
    hg_tensor *leaf = wanted ? in[1] : x;
    HG_TRY(hg_require_grad(leaf));
    const hg_status status = hg_gradcheck(of->ctx, energy_of, of, wanted ? 2 : 1, in, &options, result);
    const hg_tensor *gradient = hg_grad(leaf);
    *no_effect = gradient != NULL;
    if (*no_effect) HG_TRY(hg_tensor_numbers(gradient, of->values));
    for (int64_t i = 0; *no_effect && i < hg_tensor_count(leaf); i++) *no_effect = of->values[i] == 0;
    if (*no_effect && status == HG_NUMERIC && !result->text[0])
        snprintf(result->text, sizeof result->text,
                 "the gradient in %s is zero everywhere, on hair that is bent, turned, moving and near a body: is it "
                 "detached?",
                 names[wanted != NULL]);
    char where[128];
    name_element(wanted ? wanted : &positions, result->element > 0 ? result->element : 0, where, sizeof where);
    if (result->steps > 0 && result->element >= 0)
        snprintf(result->text, sizeof result->text, "%s: analytic %.12g, numeric %.12g (step %g), relative error %.3g",
                 where, result->analytic, result->numeric, result->step, result->worst);
    else if (status == HG_NUMERIC && gradient != NULL && !result->text[0] && result->element >= 0 &&
             !isfinite(hg_tensor_item(gradient, result->element)))
        snprintf(result->text, sizeof result->text, "%s: the gradient is not finite", where);
    return status;
}

/* wanted: NULL for x. */
static hg_status check_one(subject *of, const hg_energy_inputs *asks, const hg_energy_input *wanted, bool unknown,
                           hg_gradcheck_result *result, bool *no_effect)
{
    *result = (hg_gradcheck_result){ 0 };
    of->frame = (hg_frame){ .dt = 1.0 / 30.0, .inputs = of->inputs };
    of->n_tensors = 0;
    of->physics = NULL;
    hg_tensor *x = keep(of->ctx, "[B,S,V,3]", of->scene->x), *body = NULL, *other = NULL;
    hg_status status = x != NULL ? create_physics(of, asks) : HG_MEMORY;
    if (status == HG_OK) {
        body = hg_tensor_create(of->ctx, HG_F64, 3, (int64_t[]){ frames, 8, 3 });
        status = body != NULL ? hg_tensor_write(body, of->scene->body) : HG_MEMORY;
        of->frame.body_vertices = body;
    }
    double unit;
    const hg_energy_input roots[] = { { .name = "root_rotation", .shape = "[B,S,4]" },
                                      { .name = "root_position", .shape = "[B,S,3]" } };
    for (int i = 0; i < 2 && status == HG_OK; i++)
        if (!wanted || strcmp(wanted->name, roots[i].name) != 0) status = bring(of, &roots[i], &other, &unit);
    for (int i = 0; i < asks->n && status == HG_OK; i++) {
        const hg_energy_input *input = &asks->input[i];
        if (!always_brought(input) || strcmp(input->name, roots[0].name) == 0 ||
            strcmp(input->name, roots[1].name) == 0)
            continue;
        if (!wanted || strcmp(wanted->name, input->name) != 0) status = bring(of, input, &other, &unit);
    }
    if (status == HG_OK) status = check_input(of, wanted, unknown, x, result, no_effect);
    hg_physics_destroy(of->physics);
    hg_step_reset(of->ctx);
    for (int i = 0; i < of->n_tensors; i++) hg_tensor_destroy(of->tensors[i]);
    hg_tensor_destroy(body);
    hg_tensor_destroy(x);
    return status;
}

/* ---- all of them ------------------------------------------------------------------------------------------------ */

typedef struct {
    subject of;
    const char *wrt;
    hg_energy_check *checks;
    int n;
    hg_status status; /* of the first that failed */
    char message[512];
    bool known; /* there is an input of the name asked for */
} checking;

/* shown: the name without the energy's. */
static hg_status check_named(checking *c, const hg_energy_inputs *asks, const hg_energy_input *wanted,
                             const char *shown, bool unknown)
{
    if (c->wrt && strcmp(c->wrt, shown) != 0) return HG_OK;
    hg_energy_check check = { .name = "" };
    c->known = true;
    snprintf(check.name, sizeof check.name, "%s", shown);
    check.status = check_one(&c->of, asks, wanted, unknown, &check.result, &check.no_effect);
    if (check.status != HG_OK) {
        if (!check.result.text[0]) snprintf(check.result.text, sizeof check.result.text, "%.250s", hg_message());
        if (c->status == HG_OK) {
            c->status = check.status;
            snprintf(c->message, sizeof c->message, "%s: %s", c->of.energy->name, check.result.text);
        }
        hg_ctx_clear(c->of.ctx);
    }
    if (c->checks && c->n < HG_ENERGY_CHECKS) c->checks[c->n] = check;
    c->n++;
    return check.status == HG_MEMORY ? check.status : HG_OK;
}

static hg_status check_params(checking *c, const hg_energy_inputs *asks)
{
    const hg_energy *energy = c->of.energy;
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name != NULL; p++) {
        const char *name = energy->params[p].name;
        const bool kernel = (asks->kernel_params >> p & 1) || (energy->reach && strcmp(energy->reach, name) == 0);
        if (!kernel && !(asks->params >> p & 1)) continue; /* it makes a list, or another option reads it */
        hg_energy_input input = { .shape = kernel ? "[]" : "[B,S]", .differentiable = true };
        snprintf(input.name, sizeof input.name, "%.31s.%.31s", energy->name, name);
        HG_TRY(check_named(c, asks, &input, name, false));
    }
    return HG_OK;
}

/* What the energy is minimised over, and has to have an effect: the positions, or else the orientations or an array. */
static const char *unknown_of(const hg_energy_inputs *asks)
{
    const char *first = NULL;
    for (int i = 0; i < asks->n; i++) {
        const hg_energy_input *input = &asks->input[i];
        if (strcmp(input->name, "x") == 0) return input->name;
        if (strcmp(input->name, "q") == 0 || (!first && input->differentiable)) first = input->name;
        if (first && strcmp(first, "rest") == 0 && input->shape[1] == 'B') first = input->name;
    }
    return first;
}

static hg_status check_all(checking *c)
{
    hg_energy_inputs asks, given;
    HG_TRY(hg_energy_asks(c->of.energy, c->of.options, false, &asks));
    HG_TRY(hg_energy_asks(c->of.energy, c->of.options, true, &given));
    const char *unknown = unknown_of(&asks);
    for (int i = 0; i < asks.n; i++)
        if (asks.input[i].differentiable)
            HG_TRY(check_named(c, &asks, strcmp(asks.input[i].name, "x") == 0 ? NULL : &asks.input[i],
                               asks.input[i].name, strcmp(asks.input[i].name, unknown) == 0));
    for (int i = 0; i < given.n; i++)
        if (strcmp(given.input[i].name, "posed") == 0) HG_TRY(check_named(c, &given, &given.input[i], "posed", false));
    HG_TRY(check_params(c, &asks));
    if (c->wrt && !c->known)
        return hg_fail(HG_INVALID, "energy '%s' does not ask for '%s', or it has no derivative", c->of.energy->name,
                       c->wrt);
    return HG_OK;
}

hg_status hg_energy_gradcheck(hg_ctx *ctx, const hg_energy *energy, const char *const *options, const char *wrt,
                              const hg_gradcheck_options *how, hg_energy_check checks[HG_ENERGY_CHECKS], int *n)
{
    static const int32_t faces[36] = { 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                       2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5 };
    if (n) *n = 0;
    scene *s = hg_alloc(1, sizeof *s);
    double *values = hg_alloc(most_values, sizeof *values);
    hg_body_tree *body = NULL;
    hg_status status = s && values ? HG_OK : HG_MEMORY;
    checking c = { .wrt = wrt, .checks = checks };
    if (status == HG_OK) {
        make_rest(s);
        make_frames(s);
        status = hg_body_tree_create(&body, 8, s->body, 12, faces);
    }
    c.of = (subject){
        .ctx = ctx, .scene = s, .body = body, .energy = energy, .options = options, .how = how, .values = values
    };
    double params[HG_ENERGY_PARAMS];
    const char *choices[HG_ENERGY_OPTIONS];
    if (status == HG_OK) status = hg_term_complete(&(hg_term){ energy, 1, NULL, options }, params, choices);
    if (status == HG_OK) c.of.density = hg_term_weighs(&(hg_term){ energy, 1, params, choices }) ? 2.6e-8 : 1;
    if (status == HG_OK) status = check_all(&c);
    if (n) *n = c.n < HG_ENERGY_CHECKS ? c.n : HG_ENERGY_CHECKS;
    hg_body_tree_destroy(body);
    hg_free(values);
    hg_free(s);
    if (status == HG_OK && c.status != HG_OK) return hg_fail(c.status, "%s", c.message);
    return status;
}
