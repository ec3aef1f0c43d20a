/* physics_field: energies of a sum over neighbours, such as the density of self collision.
 *
 *     field_i = sum over j within reach, i itself included, of m_j W(|x_i - x_j|),     E = sum_i f(field_i)
 *     dE/dx_i = sum_j (f'_i m_j + f'_j m_i) W'(r) (x_i - x_j) / r
 *
 * Vertices are sorted into cells once per evaluation. Two walks over the neighbours follow, for the sums and for the
 * gradient; neighbours are found again in the second, which is cheaper than writing millions of them to memory and
 * reading them back, and vertices whose density is at rest have nothing to do in it. Distances are gathered over many
 * vertices until there are lanes enough for a run of the traced kernel. Every vertex gathers its own gradient: no two
 * threads write to one place, and the order of sums is fixed. */
#include "geometry/scan.h"
#include "geometry/vector.h"
#include "hairloss/pass_inputs.h"

#include <math.h>
#include <string.h>

enum {
    LANES = 2048, /* gathered at most before the kernel is run */
    OWNERS = 256, /* and of at most so many vertices */
    PLACES = 256, /* vertices of a block */
    CHUNK = 128   /* vertices of a strand at a time */
};

typedef struct {
    hg_function *kernel, *kernel_slope, *function; /* W; W with W'; f with f' */
    hg_pass_inputs kernel_inputs, inputs;
    int kernel_distance, field_input, field_rest_input, mass_input, attribute_input[HG_PASS_ATTRIBUTES];
    int n_attributes;
    hg_dtype dtype;
    double weight, radius;
    bool weighs; /* kernel_mass: kg */
    int64_t grooms, strands, vertices;
    hg_cells cells;
    void *mass_values, *attribute_values[HG_PASS_ATTRIBUTES], *field_rest; /* [G,n] */
    void *field, *slope, *slope_place, *mass_place;                        /* [n] of the frame at work */
    double *strand_energies;                                               /* [S] */
} field_pass;

#define HG_P(name)    HG_JOIN(name, _, HG_SUFFIX)
#define hg_real       double
#define HG_SUFFIX     d
#define HG_TYPE       HG_F64
#define HG_MATH(name) name
#include "hairloss/physics_field_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_TYPE
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_TYPE       HG_F32
#define HG_MATH(name) name##f
#include "hairloss/physics_field_functions.h"

static void field_destroy(void *self)
{
    field_pass *pass = self;
    if (!pass) return;
    hg_function_destroy(pass->kernel);
    hg_function_destroy(pass->kernel_slope);
    hg_function_destroy(pass->function);
    hg_cells_free(&pass->cells);
    hg_free(pass->mass_values);
    for (int a = 0; a < HG_PASS_ATTRIBUTES; a++) hg_free(pass->attribute_values[a]);
    hg_free(pass->field_rest);
    hg_free(pass->field);
    hg_free(pass->slope);
    hg_free(pass->slope_place);
    hg_free(pass->mass_place);
    hg_free(pass->strand_energies);
    hg_free(pass);
}

static hg_status make_functions(field_pass *pass, const hg_pass_setup *setup)
{
    const hg_energy *energy = setup->term.energy;
    hg_trace_scope scope;
    hg_term_scope(&scope, &setup->term, 0, HG_ALLOW_FIELD_KERNEL);
    pass->kernel_distance = hg_pass_inputs_add(&pass->kernel_inputs, (hg_input){ .kind = HG_INPUT_DISTANCE }, 0.0);
    hg_pass_inputs_add_uniform(&pass->kernel_inputs, &setup->term);
    HG_TRY(hg_function_create(&pass->kernel, energy->kernel, &scope, 0, NULL, pass->kernel_inputs.n,
                              pass->kernel_inputs.inputs));
    HG_TRY(hg_function_create(&pass->kernel_slope, energy->kernel, &scope, 1, &pass->kernel_distance,
                              pass->kernel_inputs.n, pass->kernel_inputs.inputs));

    hg_term_scope(&scope, &setup->term, 0, HG_ALLOW_FIELD);
    uint32_t kinds = 0;
    char *attributes[HG_PASS_ATTRIBUTES] = { NULL };
    HG_TRY(hg_formula_inputs(energy->trace, &scope, &kinds, &pass->n_attributes, attributes));
    hg_pass_inputs *inputs = &pass->inputs;
    pass->field_input = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_FIELD }, 0.0);
    pass->field_rest_input = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_FIELD_REST }, 0.0);
    pass->mass_input = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_MASS }, 0.0);
    for (int a = 0; a < pass->n_attributes; a++)
        pass->attribute_input[a] =
            hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_ATTRIBUTE, .name = (int16_t)a }, 0.0);
    hg_pass_inputs_add_uniform(inputs, &setup->term);
    hg_status status = hg_pass_attributes(setup, pass->grooms * pass->strands * pass->vertices, pass->n_attributes,
                                          attributes, pass->attribute_values);
    if (status == HG_OK)
        status = hg_function_create_named(&pass->function, energy->trace, &scope, 1, &pass->field_input, inputs->n,
                                          inputs->inputs, pass->n_attributes, (const char *const *)attributes);
    for (int a = 0; a < pass->n_attributes; a++) hg_free(attributes[a]);
    return status;
}

/* The rest field: given, or the same sums over the rest groom, in double whatever the pass. */
static hg_status make_rest(field_pass *pass, const hg_pass_setup *setup)
{
    const hg_groom_data *data = setup->data;
    int64_t n = pass->strands * pass->vertices;
    const double *given = hg_groom_attribute_find(data, "density_rest");
    if (given) {
        pass->field_rest = hg_pass_values(pass->dtype, pass->grooms * n, given);
        return pass->field_rest ? HG_OK : HG_MEMORY;
    }
    hg_status status = HG_MEMORY;
    void *masses = pass->mass_values; /* of the pass' own precision; lent out while the sums are made in double */
    void *mass_place = pass->mass_place;
    double *rest = hg_alloc((size_t)(pass->grooms * n) + 1, sizeof *rest);
    pass->mass_values = hg_pass_values(HG_F64, pass->grooms * n, data->mass);
    pass->mass_place = hg_alloc((size_t)n + 1, sizeof(double));
    if (rest && pass->mass_values && pass->mass_place) {
        status = HG_OK;
        for (int64_t g = 0; g < pass->grooms && status == HG_OK; g++) {
            field_args_d args = { .pass = pass,
                                  .groom = g,
                                  .cells = &pass->cells,
                                  .mass = pass->weighs ? pass->mass_place : NULL,
                                  .field = rest + g * n };
            status = make_field_d(pass, setup->ctx, &args, data->rest + 3 * g * n);
        }
    }
    hg_free(pass->mass_values);
    hg_free(pass->mass_place);
    hg_cells_free(&pass->cells);
    pass->mass_values = masses;
    pass->mass_place = mass_place;
    if (status == HG_OK) {
        pass->field_rest = hg_pass_values(pass->dtype, pass->grooms * n, rest);
        if (!pass->field_rest) status = HG_MEMORY;
    }
    hg_free(rest);
    return status;
}

static hg_status field_make(field_pass *pass, const hg_pass_setup *setup)
{
    const hg_energy *energy = setup->term.energy;
    size_t n = (size_t)(pass->strands * pass->vertices) + 1, real = hg_dtype_size(pass->dtype);
    double reach = energy->reach ? hg_term_param(&setup->term, energy->reach) : 0.0;
    if (!energy->kernel || !energy->reach)
        return hg_fail(HG_INVALID, "%s: a field energy needs a kernel and a reach", energy->name);
    if (!(reach > 0.0) || !isfinite(reach))
        return hg_fail(HG_INVALID, "%s: %s is %g m; it has to be positive", energy->name, energy->reach, reach);
    pass->radius = 2.0 * reach;
    const char *kernel_mass = hg_term_option(&setup->term, "kernel_mass");
    pass->weighs = kernel_mass && strcmp(kernel_mass, "kg") == 0;
    pass->mass_values = hg_pass_values(pass->dtype, pass->grooms * pass->strands * pass->vertices, setup->data->mass);
    pass->field = hg_alloc(n, real);
    pass->slope = hg_alloc(n, real);
    pass->slope_place = hg_alloc(n, real);
    pass->mass_place = hg_alloc(n, real);
    pass->strand_energies = hg_alloc((size_t)pass->strands + 1, sizeof *pass->strand_energies);
    if (!pass->mass_values || !pass->field || !pass->slope || !pass->slope_place || !pass->mass_place ||
        !pass->strand_energies)
        return HG_MEMORY;
    HG_TRY(make_functions(pass, setup));
    return make_rest(pass, setup);
}

static hg_status field_create(void **self, const hg_pass_setup *setup)
{
    *self = NULL;
    field_pass *pass = hg_alloc(1, sizeof *pass);
    if (!pass) return HG_MEMORY;
    pass->dtype = setup->dtype;
    pass->weight = setup->term.weight;
    pass->grooms = setup->data->grooms;
    pass->strands = setup->data->strands;
    pass->vertices = setup->data->vertices;
    hg_status status = field_make(pass, setup);
    if (status != HG_OK) {
        field_destroy(pass);
        return status;
    }
    *self = pass;
    return HG_OK;
}

static hg_status field_run(void *self, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, int n_values,
                           const hg_pass_value *values, void *gradient, double *unweighted, double *per_strand,
                           int64_t stride)
{
    field_pass *pass = self;
    pass->inputs.uniform[pass->inputs.dt] = frame->dt;
    (void)n_values;
    (void)values;
    pass->kernel_inputs.uniform[pass->kernel_inputs.dt] = frame->dt;
    *unweighted = 0.0;
    for (int64_t b = 0; b < x->shape[0]; b++) {
        double *strand_energies = per_strand ? per_strand + b * pass->strands * stride : NULL;
        HG_TRY(pass->dtype == HG_F32
                   ? run_frame_f(pass, ctx, frame, x, b, gradient, unweighted, strand_energies, stride)
                   : run_frame_d(pass, ctx, frame, x, b, gradient, unweighted, strand_energies, stride));
    }
    return HG_OK;
}

static const hg_physics_pass field_physics_pass = { field_create, field_destroy, field_run };
HG_REGISTER("physics_pass", field, &field_physics_pass);
