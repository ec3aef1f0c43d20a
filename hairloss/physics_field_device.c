/* The field on another device than the host: a grid that is made there, a walk around every vertex for the sums and the
 * function of them, and another for the derivatives. All frames of the batch are one launch; of what each vertex leaves, sums
 * are made in a fixed order (physics_pass_device.c). Nobody writes where another does, and the host waits for nothing. */
#include "geometry/grid.h"
#include "hairloss/physics_field.h"

#include "hairloss/physics_field.inc"

_Static_assert(sizeof(field_args) < 4088, "the arguments of a kernel are at most 4 KB");

hg_status hg_field_device_make(field_pass *pass)
{
    hg_pass *base = &pass->pass;
    hg_text *text = &base->text;
    hg_text_add(text, "#define REAL %s\n#include \"autograd/trace/scalar_cuda.h\"\n",
                base->dtype == HG_F64 ? "double" : "float");
    hg_function_print_cuda(pass->kernel, "kernel_value", text);
    hg_function_print_cuda(pass->kernel_slope, "kernel_slope", text);
    hg_function_print_cuda(pass->kernel_full, "kernel_full", text);
    hg_function_print_cuda(pass->function, "function_value", text);
    hg_function_print_cuda(pass->full, "function_full", text);
    hg_text_add(text,
                "#define KERNEL_INPUTS %d\n#define KERNEL_DISTANCE %d\n#define INPUTS %d\n#define INPUT_FIELD %d\n"
                "#define INPUT_FIELD_REST %d\n#include \"hairloss/physics_field.inc\"\n",
                pass->kernel_inputs.n, pass->kernel_distance, pass->inputs.n, pass->field, pass->field_rest);
    if (text->failed) return HG_MEMORY;
    pass->on_device.place = hg_pass_kernel(base, "field_place", sizeof(field_args));
    pass->on_device.sum = hg_pass_kernel(base, "field_sum", sizeof(field_args));
    pass->on_device.energy = hg_pass_kernel(base, "field_energy", sizeof(field_args));
    pass->on_device.energy_full = hg_pass_kernel(base, "field_energy_full", sizeof(field_args));
    pass->on_device.gradient = hg_pass_kernel(base, "field_gradient", sizeof(field_args));
    pass->on_device.params = hg_pass_kernel(base, "field_params", sizeof(field_args));
    pass->on_device.masses = hg_pass_kernel(base, "field_masses", sizeof(field_args));
    return HG_OK;
}

static hg_status launch(const field_pass *pass, hg_ctx *ctx, int kernel, const field_args *args)
{
    return hg_launch(ctx, &pass->pass.kernels[kernel], args->grid.frames * args->grid.n, args);
}

/* Numbers of every vertex of so many frames, or grooms. */
static void *make(const field_pass *pass, hg_ctx *ctx, int64_t frames, int width, size_t size)
{
    return hg_step_device(ctx, (size_t)(frames * pass->pass.strands * pass->pass.vertices * width) * size + 1);
}

/* The grid of positions [frames,S,V,3], and what is in its order. */
static hg_status begin(const field_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, const void *x, field_args *args)
{
    const hg_pass *base = &pass->pass;
    const hg_pass_source *reach = &base->source[pass->reach];
    const size_t real = hg_dtype_size(base->dtype);
    *args = (field_args){ .strands = base->strands,
                          .vertices = base->vertices,
                          .groom = batch->groom,
                          .own_groom = batch->grooms,
                          .reach = reach->values,
                          .factor = reach->values ? 2 : pass->radius,
                          .weight = base->term.weight,
                          .mass = pass->weighs ? base->source[HG_PASS_MASS].values : NULL,
                          .slope_place = make(pass, ctx, batch->frames, 1, real),
                          .mass_place = pass->weighs ? make(pass, ctx, batch->frames, 1, real) : NULL };
    if (!args->slope_place || (pass->weighs && !args->mass_place)) return HG_MEMORY;
    hg_pass_lanes_fill(&args->kernel, base, &pass->kernel_inputs);
    hg_pass_lanes_fill(&args->lanes, base, &pass->inputs);
    HG_TRY(hg_grid_build(ctx, &args->grid, base->dtype, batch->frames, base->strands * base->vertices, x, args->reach,
                         args->factor));
    return HG_OK;
}

/* What follows from the slopes of E in a field: derivatives in the positions, in the masses of the kernel and in its params. */
static hg_status chain(const field_pass *pass, hg_ctx *ctx, const hg_pass_batch *batch, field_args *args)
{
    const hg_pass *base = &pass->pass;
    if (args->gradient) HG_TRY(launch(pass, ctx, pass->on_device.gradient, args));
    if (pass->weighs && base->source[HG_PASS_MASS].gradient) {
        args->mass_slopes = make(pass, ctx, batch->frames, 1, sizeof(double));
        if (!args->mass_slopes) return HG_MEMORY;
        HG_TRY(launch(pass, ctx, pass->on_device.masses, args));
        HG_TRY(hg_pass_add(base, ctx, batch, HG_PASS_MASS, 1, args->mass_slopes, 1));
    }
    bool wanted = false;
    for (int i = 0; i < pass->kernel_inputs.n; i++) {
        const int param = pass->kernel_inputs.source[i];
        if (param < 0 || !base->source[param].gradient || !(pass->kernel_params >> param & 1)) continue;
        wanted = true;
        args->kernel.slopes[i] = make(pass, ctx, batch->frames, 1, sizeof(double));
        if (!args->kernel.slopes[i]) return HG_MEMORY;
    }
    if (wanted) HG_TRY(launch(pass, ctx, pass->on_device.params, args));
    for (int i = 0; i < pass->kernel_inputs.n; i++)
        if (args->kernel.slopes[i])
            HG_TRY(hg_pass_add(base, ctx, batch, pass->kernel_inputs.source[i], 1, args->kernel.slopes[i], 1));
    return HG_OK;
}

/* The function of the field and its derivatives in all that is asked for; in the rest field it is left in rest_slopes. */
static hg_status evaluate(const field_pass *pass, hg_ctx *ctx, const hg_pass_call *call, const hg_pass_batch *batch,
                          bool follows, field_args *args, void *rest_slopes)
{
    const hg_pass *base = &pass->pass;
    const hg_pass_inputs *inputs = &pass->inputs;
    const void *rest_gradient = base->source[HG_PASS_FIELD_REST].gradient;
    args->energy = make(pass, ctx, batch->frames, 1, sizeof(double));
    if (!args->energy) return HG_MEMORY;
    for (int i = 0; i < inputs->n && base->wants; i++) {
        const bool wanted = inputs->source[i] >= 0  ? base->source[inputs->source[i]].gradient != NULL
                            : i == pass->field_rest ? follows || rest_gradient
                                                    : false;
        if (!wanted) continue;
        args->lanes.slopes[i] = make(pass, ctx, batch->frames, 1, sizeof(double));
        if (!args->lanes.slopes[i]) return HG_MEMORY;
    }
    HG_TRY(launch(pass, ctx, base->wants ? pass->on_device.energy_full : pass->on_device.energy, args));
    HG_TRY(hg_pass_energies(base, ctx, call, args->energy));
    for (int i = 0; i < inputs->n; i++) {
        const double *slopes = args->lanes.slopes[i];
        if (!slopes) continue;
        if (i != pass->field_rest)
            HG_TRY(hg_pass_add(base, ctx, batch, inputs->source[i], args->weight, slopes, 1));
        else if (follows)
            HG_TRY(hg_pass_add_grooms(base, ctx, batch, rest_slopes, args->weight, slopes, 1));
        else
            HG_TRY(hg_pass_add(base, ctx, batch, HG_PASS_FIELD_REST, args->weight, slopes, 1));
    }
    return HG_OK;
}

static hg_status run(const field_pass *pass, hg_ctx *ctx, const hg_pass_call *call)
{
    const hg_pass *base = &pass->pass;
    const hg_pass_source *rest_x = &base->source[HG_PASS_REST];
    const hg_pass_batch batch = { .frames = call->x->shape[0], .groom = call->groom },
                        grooms = { .frames = base->grooms, .grooms = true };
    const bool follows = hg_field_rest_follows(pass), rest_too = follows && base->wants;
    const size_t real = hg_dtype_size(base->dtype);
    field_args args, rest;
    void *rest_slopes = NULL;
    HG_TRY(begin(pass, ctx, &batch, call->x->data, &args));
    args.gradient = call->gradient;
    args.field_rest = base->source[HG_PASS_FIELD_REST].values;
    if (pass->weighs) HG_TRY(launch(pass, ctx, pass->on_device.place, &args));
    if (follows) {
        HG_TRY(begin(pass, ctx, &grooms, rest_x->values, &rest));
        args.field_rest = rest.field = make(pass, ctx, base->grooms, 1, real);
        if (!rest.field) return HG_MEMORY;
        if (pass->weighs) HG_TRY(launch(pass, ctx, pass->on_device.place, &rest));
        HG_TRY(launch(pass, ctx, pass->on_device.sum, &rest));
    }
    if (rest_too) {
        const int64_t n = base->grooms * base->strands * base->vertices;
        hg_tensor *slopes = hg_tensor_make(ctx, base->dtype, 1, &n);
        if (!slopes) return HG_MEMORY;
        HG_TRY(hg_tensor_fill(slopes, 0));
        rest_slopes = slopes->data;
    }
    HG_TRY(evaluate(pass, ctx, call, &batch, follows, &args, rest_slopes));
    if (call->gradient || base->wants) HG_TRY(chain(pass, ctx, &batch, &args));
    if (!rest_too) return HG_OK;
    rest.slope = rest_slopes;
    rest.gradient = rest_x->gradient;
    HG_TRY(launch(pass, ctx, pass->on_device.place, &rest));
    return chain(pass, ctx, &grooms, &rest);
}

hg_status hg_field_device_run(field_pass *pass, hg_ctx *ctx, const hg_pass_call *call)
{
    const hg_step_mark mark = hg_step_set_mark(ctx);
    const hg_status status = run(pass, ctx, call);
    hg_step_rewind(ctx, mark);
    return status;
}
