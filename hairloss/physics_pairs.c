/* physics_pairs: energies over the pairs of a list, such as adhesion.
 *
 * Every pair is evaluated once, in lanes; its force and the derivatives that are asked for are kept, and every vertex then
 * gathers those of the pairs that it takes part in, from either side: no two threads write to one place, and the order of
 * sums is fixed. A pair counts for the strand of its first vertex.
 *
 * The list is made of the groom's own rest, whatever rest the frame gives: which vertices are near has no derivative. */
#include "hairloss/physics_pairs.h"
#include "geometry/vector.h"

#include <math.h>

enum { BLOCK = 512, STRANDS = 32 };

/* Is the derivative of input i asked for? */
bool hg_pairs_wanted(const pairs_pass *pass, int i)
{
    if (pass->slope_of[i] < 0 || i == pass->distance) return false;
    const int source = i == pass->rest_distance ? HG_PASS_REST : pass->inputs.source[i];
    return pass->pass.source[source].gradient != NULL;
}

#define HG_P(name)    HG_JOIN(name, _, HG_SUFFIX)
#define hg_real       double
#define HG_SUFFIX     d
#define HG_MATH(name) name
#include "hairloss/physics_pairs_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_MATH(name) name##f
#include "hairloss/physics_pairs_functions.h"

static void free_pairs(pairs_pass *pass)
{
    hg_pairs_device_free(pass);
    for (int64_t g = 0; g < pass->pass.grooms; g++) {
        if (pass->own_pairs && pass->pairs) hg_pairs_destroy(pass->pairs[g]);
        if (pass->own_pairs && pass->pairs) pass->pairs[g] = NULL;
        if (!pass->rest_distances) continue;
        hg_free(pass->rest_distances[g]);
        pass->rest_distances[g] = NULL;
    }
    void **arrays[] = { &pass->energies, &pass->forces, &pass->rest_forces };
    for (int i = 0; i < 3; i++) {
        hg_free(*arrays[i]);
        *arrays[i] = NULL;
    }
    for (int i = 0; i < HG_PASS_INPUTS; i++) {
        hg_free(pass->slopes[i]);
        pass->slopes[i] = NULL;
    }
}

static void pairs_destroy(void *self)
{
    pairs_pass *pass = self;
    if (!pass) return;
    hg_function_destroy(pass->function);
    hg_function_destroy(pass->full);
    free_pairs(pass);
    hg_free(pass->pairs);
    hg_free(pass->rest_distances);
    hg_pass_free(&pass->pass);
    hg_free(pass);
}

/* The lists and what is as long as they are. */
static hg_status make_pairs(pairs_pass *pass, double radius, double count)
{
    const hg_groom_data *data = pass->pass.data;
    const char *name = pass->pass.term.energy->name;
    const int64_t n = data->strands * data->vertices;
    const size_t real = hg_dtype_size(pass->pass.dtype);
    free_pairs(pass);
    pass->most_pairs = 0;
    for (int64_t g = 0; g < data->grooms; g++) {
        if (!pass->own_pairs) {
            pass->pairs[g] = data->adhesion[g];
            if (!pass->pairs[g] || pass->pairs[g]->n_vertices != n)
                return hg_fail(HG_INVALID, "%s: the pairs given for groom %lld are of %lld vertices; it has %lld", name,
                               (long long)g, (long long)(pass->pairs[g] ? pass->pairs[g]->n_vertices : 0),
                               (long long)n);
        } else {
            if (!(radius > 0.0) || !(count >= 0.0) || !(count <= 32.0))
                return hg_fail(HG_INVALID,
                               "%s: pairs are made with a radius above 0 m and a count from 0 to 32, not %g "
                               "and %g",
                               name, radius, count);
            HG_TRY(hg_pairs_nearest(pass->pass.host, &pass->pairs[g], data->strands, data->vertices,
                                    data->rest + 3 * n * g, radius, (int)count));
        }
        const hg_pairs *pairs = pass->pairs[g];
        if (pairs->n_pairs > pass->most_pairs) pass->most_pairs = pairs->n_pairs;
        pass->rest_distances[g] = hg_alloc((size_t)pairs->n_pairs + 1, real);
        if (!pass->rest_distances[g]) return HG_MEMORY;
        for (int64_t p = 0; p < pairs->n_pairs; p++) {
            const double *a = data->rest + 3 * (n * g + pairs->pairs[2 * p]);
            const double *b = data->rest + 3 * (n * g + pairs->pairs[2 * p + 1]);
            double d = hg_vec3d_distance(hg_vec3d_load(a), hg_vec3d_load(b));
            if (pass->pass.dtype == HG_F32)
                ((float *)pass->rest_distances[g])[p] = (float)d;
            else
                ((double *)pass->rest_distances[g])[p] = d;
        }
    }
    pass->radius_now = radius;
    pass->count_now = count;
    if (!hg_ctx_host(pass->pass.ctx)) return hg_pairs_device_lists(pass);
    pass->energies = hg_alloc((size_t)pass->most_pairs + 1, real);
    pass->forces = hg_alloc(3 * (size_t)pass->most_pairs + 1, real);
    return pass->energies && pass->forces ? HG_OK : HG_MEMORY;
}

static hg_status make_functions(pairs_pass *pass, uint32_t kinds)
{
    const hg_energy *energy = pass->pass.term.energy;
    hg_pass_inputs *inputs = &pass->inputs;
    hg_trace_scope scope;
    hg_term_scope(&scope, &pass->pass.term, 0, HG_ALLOW_PAIRS);
    pass->distance = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_DISTANCE }, -1, 0);
    pass->rest_distance = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_REST_DISTANCE }, -1, 0);
    for (int side = 0; side < 2; side++) { /* the last vertex of a site is offset 0 */
        const int16_t offset = (int16_t)(side - 1);
        if (kinds & HG_ALLOW(HG_INPUT_MASS))
            hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_MASS, .offset = offset }, HG_PASS_MASS, side);
        for (int a = 0; a < pass->pass.n_attributes; a++)
            hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_ATTRIBUTE, .offset = offset, .name = (int16_t)a },
                               HG_PASS_ATTRIBUTE + a, side);
    }
    hg_pass_inputs_add_uniform(inputs, &pass->pass, true);
    int wrt[HG_PASS_INPUTS], n_wrt = 0;
    for (int i = 0; i < inputs->n; i++) {
        const int source = inputs->source[i];
        pass->slope_of[i] = -1;
        if (source >= 0 && source < HG_ENERGY_PARAMS && pass->pass.makes_list >> source & 1) continue;
        wrt[n_wrt] = i;
        pass->slope_of[i] = ++n_wrt;
    }
    const char *const *attributes = (const char *const *)pass->pass.attributes;
    HG_TRY(hg_function_create_named(&pass->function, energy->trace, &scope, 1, wrt, inputs->n, inputs->inputs,
                                    pass->pass.n_attributes, attributes));
    return hg_function_create_named(&pass->full, energy->trace, &scope, n_wrt, wrt, inputs->n, inputs->inputs,
                                    pass->pass.n_attributes, attributes);
}

static hg_status pairs_make(pairs_pass *pass, const hg_pass_setup *setup)
{
    uint32_t kinds;
    HG_TRY(hg_pass_create(&pass->pass, setup, HG_ALLOW_PAIRS, &kinds));
    pass->pass.run_frame = setup->dtype == HG_F32 ? run_frame_f : run_frame_d;
    pass->pairs = hg_alloc((size_t)pass->pass.grooms, sizeof *pass->pairs);
    pass->rest_distances = hg_alloc((size_t)pass->pass.grooms, sizeof *pass->rest_distances);
    if (!pass->pairs || !pass->rest_distances) return HG_MEMORY;
    pass->own_pairs = !setup->data->adhesion;
    pass->radius = hg_pass_param(&pass->pass, "radius");
    pass->count = hg_pass_param(&pass->pass, "count");
    if (pass->own_pairs && (pass->radius < 0 || pass->count < 0))
        return hg_fail(HG_INVALID, "energy '%s' is over pairs: declare the params radius and count, or give a list",
                       setup->term.energy->name);
    for (int i = 0; i < 2; i++) {
        const int param = i ? pass->count : pass->radius;
        if (param >= 0) pass->pass.makes_list |= 1u << param;
    }
    pass->pass.uniform_only = pass->pass.makes_list;
    HG_TRY(make_functions(pass, kinds));
    if (!hg_ctx_host(setup->ctx)) HG_TRY(hg_pairs_device_make(pass));
    return make_pairs(pass, pass->radius < 0 ? 0 : setup->term.params[pass->radius],
                      pass->count < 0 ? 0 : setup->term.params[pass->count]);
}

static hg_status pairs_create(void **self, const hg_pass_setup *setup)
{
    *self = NULL;
    pairs_pass *pass = hg_alloc(1, sizeof *pass);
    if (!pass) return HG_MEMORY;
    hg_status status = pairs_make(pass, setup);
    if (status != HG_OK) {
        pairs_destroy(pass);
        return status;
    }
    *self = pass;
    return HG_OK;
}

static hg_status pairs_run(void *self, hg_ctx *ctx, const hg_pass_call *call)
{
    pairs_pass *pass = self;
    HG_TRY(hg_pass_begin(&pass->pass, call->frame, call->n_values, call->values));
    if (pass->own_pairs) { /* a list of another radius or count */
        double radius, count;
        HG_TRY(hg_pass_number(&pass->pass, pass->radius, &radius));
        HG_TRY(hg_pass_number(&pass->pass, pass->count, &count));
        if (radius != pass->radius_now || count != pass->count_now) HG_TRY(make_pairs(pass, radius, count));
    }
    if (!hg_ctx_host(ctx)) return hg_pairs_device_run(pass, ctx, call);
    const size_t real = hg_dtype_size(pass->pass.dtype), pairs = (size_t)pass->most_pairs;
    hg_pass_inputs_fill(&pass->inputs, &pass->pass);
    for (int i = 0; i < pass->inputs.n; i++) {
        if (!hg_pairs_wanted(pass, i)) continue;
        void **array = i == pass->rest_distance ? &pass->rest_forces : &pass->slopes[i];
        if (!*array) *array = hg_alloc((i == pass->rest_distance ? 3 : 1) * pairs + 1, real);
        if (!*array) return hg_fail(HG_MEMORY, "out of memory for the derivatives of %zu pairs", pairs);
    }
    return hg_pass_frames(pass, ctx, call);
}

static const hg_physics_pass pairs_physics_pass = { pairs_create, pairs_destroy, pairs_run };
HG_REGISTER("physics_pass", pairs, &pairs_physics_pass);
