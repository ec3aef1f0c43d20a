/* physics_pairs: energies over the pairs of a list, such as adhesion.
 *
 * Every pair is evaluated once, in lanes; its force is kept, and every vertex then gathers the forces of the pairs that
 * it takes part in, from either side: no two threads write to one place, and the order of sums is fixed. */
#include "geometry/vector.h"
#include "hairloss/pass_inputs.h"

#include <math.h>

enum { BLOCK = 512, GATHER = 1024 };

typedef struct {
    hg_function *function;
    hg_pass_inputs inputs;
    int distance, rest_distance, mass[2],
        attribute[HG_PASS_ATTRIBUTES][2]; /* numbers of inputs; mass -1: not asked for */
    int n_attributes;
    hg_dtype dtype;
    double weight;
    int64_t grooms, strands, vertices; /* of one groom: n = strands * vertices */
    hg_pairs **pairs;                  /* [G] */
    bool own_pairs;
    int64_t most_pairs;
    void **rest_distances;                      /* [G] [M] */
    void *mass_values;                          /* [G,n] */
    void *attribute_values[HG_PASS_ATTRIBUTES]; /* [G,n] */
    void *forces;                               /* [M,3] on the first of a pair, of the frame at work */
    double *energies;                           /* [M] */
    double *sums;                               /* of blocks of pairs */
} pairs_pass;

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

static void pairs_destroy(void *self)
{
    pairs_pass *pass = self;
    if (!pass) return;
    hg_function_destroy(pass->function);
    for (int64_t g = 0; g < pass->grooms; g++) {
        if (pass->own_pairs && pass->pairs) hg_pairs_destroy(pass->pairs[g]);
        if (pass->rest_distances) hg_free(pass->rest_distances[g]);
    }
    hg_free(pass->pairs);
    hg_free(pass->rest_distances);
    hg_free(pass->mass_values);
    for (int a = 0; a < HG_PASS_ATTRIBUTES; a++) hg_free(pass->attribute_values[a]);
    hg_free(pass->forces);
    hg_free(pass->energies);
    hg_free(pass->sums);
    hg_free(pass);
}

static hg_status make_pairs(pairs_pass *pass, const hg_pass_setup *setup)
{
    const hg_groom_data *data = setup->data;
    int64_t n = data->strands * data->vertices;
    pass->pairs = hg_alloc((size_t)data->grooms, sizeof *pass->pairs);
    pass->rest_distances = hg_alloc((size_t)data->grooms, sizeof *pass->rest_distances);
    if (!pass->pairs || !pass->rest_distances) return HG_MEMORY;
    pass->own_pairs = !data->adhesion;
    for (int64_t g = 0; g < data->grooms; g++) {
        if (data->adhesion) {
            pass->pairs[g] = data->adhesion[g];
            if (!pass->pairs[g] || pass->pairs[g]->n_vertices != n)
                return hg_fail(HG_INVALID, "%s: the pairs given for groom %lld are of %lld vertices; it has %lld",
                               setup->term.energy->name, (long long)g,
                               (long long)(pass->pairs[g] ? pass->pairs[g]->n_vertices : 0), (long long)n);
        } else {
            double radius = hg_term_param(&setup->term, "radius"), count = hg_term_param(&setup->term, "count");
            if (!(radius > 0.0) || !(count >= 0.0) || !(count <= 32.0))
                return hg_fail(HG_INVALID,
                               "%s: pairs are made with a radius above 0 m and a count from 0 to 32, not %g "
                               "and %g",
                               setup->term.energy->name, radius, count);
            HG_TRY(hg_pairs_nearest(setup->ctx, &pass->pairs[g], data->strands, data->vertices, data->rest + 3 * n * g,
                                    radius, (int)count));
        }
        const hg_pairs *pairs = pass->pairs[g];
        if (pairs->n_pairs > pass->most_pairs) pass->most_pairs = pairs->n_pairs;
        pass->rest_distances[g] = hg_alloc((size_t)pairs->n_pairs + 1, hg_dtype_size(setup->dtype));
        if (!pass->rest_distances[g]) return HG_MEMORY;
        for (int64_t p = 0; p < pairs->n_pairs; p++) {
            const double *a = data->rest + 3 * (n * g + pairs->pairs[2 * p]);
            const double *b = data->rest + 3 * (n * g + pairs->pairs[2 * p + 1]);
            double d = hg_vec3d_distance(hg_vec3d_load(a), hg_vec3d_load(b));
            if (setup->dtype == HG_F32)
                ((float *)pass->rest_distances[g])[p] = (float)d;
            else
                ((double *)pass->rest_distances[g])[p] = d;
        }
    }
    return HG_OK;
}

static hg_status make_function(pairs_pass *pass, const hg_pass_setup *setup)
{
    const hg_groom_data *data = setup->data;
    int64_t values = data->grooms * data->strands * data->vertices;
    hg_trace_scope scope;
    hg_term_scope(&scope, &setup->term, 0, HG_ALLOW_PAIRS);
    uint32_t kinds = 0;
    char *attributes[HG_PASS_ATTRIBUTES] = { NULL };
    HG_TRY(hg_formula_inputs(setup->term.energy->trace, &scope, &kinds, &pass->n_attributes, attributes));

    hg_pass_inputs *inputs = &pass->inputs;
    hg_status status = HG_OK;
    pass->distance = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_DISTANCE }, 0.0);
    pass->rest_distance = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_REST_DISTANCE }, 0.0);
    pass->mass[0] = pass->mass[1] = -1;
    if (kinds & HG_ALLOW(HG_INPUT_MASS)) {
        pass->mass_values = hg_pass_values(setup->dtype, values, data->mass);
        if (!pass->mass_values) status = HG_MEMORY;
    }
    for (int side = 0; side < 2; side++) { /* the last vertex of a site is offset 0 */
        int16_t offset = (int16_t)(side - 1);
        if (pass->mass_values)
            pass->mass[side] = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_MASS, .offset = offset }, 0.0);
        for (int a = 0; a < pass->n_attributes; a++)
            pass->attribute[a][side] = hg_pass_inputs_add(
                inputs, (hg_input){ .kind = HG_INPUT_ATTRIBUTE, .offset = offset, .name = (int16_t)a }, 0.0);
    }
    hg_pass_inputs_add_uniform(inputs, &setup->term);
    if (status == HG_OK)
        status = hg_pass_attributes(setup, values, pass->n_attributes, attributes, pass->attribute_values);
    if (status == HG_OK)
        status =
            hg_function_create_named(&pass->function, setup->term.energy->trace, &scope, 1, &pass->distance, inputs->n,
                                     inputs->inputs, pass->n_attributes, (const char *const *)attributes);
    for (int a = 0; a < pass->n_attributes; a++) hg_free(attributes[a]);
    return status;
}

static hg_status pairs_create(void **self, const hg_pass_setup *setup)
{
    *self = NULL;
    pairs_pass *pass = hg_alloc(1, sizeof *pass);
    if (!pass) return HG_MEMORY;
    pass->dtype = setup->dtype;
    pass->weight = setup->term.weight;
    pass->grooms = setup->data->grooms;
    pass->strands = setup->data->strands;
    pass->vertices = setup->data->vertices;
    hg_status status = make_pairs(pass, setup);
    if (status == HG_OK) status = make_function(pass, setup);
    if (status == HG_OK) {
        pass->forces = hg_alloc(3 * (size_t)pass->most_pairs + 1, hg_dtype_size(setup->dtype));
        pass->energies = hg_alloc((size_t)pass->most_pairs + 1, sizeof *pass->energies);
        pass->sums = hg_alloc((size_t)pass->most_pairs / BLOCK + 1, sizeof *pass->sums);
        if (!pass->forces || !pass->energies || !pass->sums) status = HG_MEMORY;
    }
    if (status != HG_OK) {
        pairs_destroy(pass);
        return status;
    }
    *self = pass;
    return HG_OK;
}

static hg_status pairs_run(void *self, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, int n_values,
                           const hg_pass_value *values, void *gradient, double *unweighted, double *per_strand,
                           int64_t stride)
{
    pairs_pass *pass = self;
    pass->inputs.uniform[pass->inputs.dt] = frame->dt;
    (void)n_values;
    (void)values;
    *unweighted = 0.0;
    for (int64_t b = 0; b < x->shape[0]; b++) {
        double *strand_energies = per_strand ? per_strand + b * pass->strands * stride : NULL;
        HG_TRY(pass->dtype == HG_F32
                   ? run_frame_f(pass, ctx, frame, x, b, gradient, unweighted, strand_energies, stride)
                   : run_frame_d(pass, ctx, frame, x, b, gradient, unweighted, strand_energies, stride));
    }
    return HG_OK;
}

static const hg_physics_pass pairs_physics_pass = { pairs_create, pairs_destroy, pairs_run };
HG_REGISTER("physics_pass", pairs, &pairs_physics_pass);
