/* physics_field: energies of a sum over neighbours, such as the density of self collision.
 *
 *     field_i = sum over j within reach, i itself included, of m_j W(|x_i - x_j|),     E = sum_i f(field_i)
 *     dE/dx_i = sum_j (f'_i m_j + f'_j m_i) W'(r) (x_i - x_j) / r
 *
 * and, where they are asked for, with W_ij = W(|x_i - x_j|; theta),
 *
 *     dE/dtheta = sum_i f'_i sum_j m_j dW_ij/dtheta,     dE/dm_j = sum_i f'_i W_ij,
 *
 * both also through the field at rest, where that is made of the rest groom and not given.
 *
 * Vertices are sorted into cells once per evaluation. The sums and the gradient in the positions go over every pair once
 * (physics_field_pairs.h); the derivatives that few ask for walk over the neighbours of every vertex. Distances are
 * gathered over many vertices until there are lanes enough for a run of the traced kernel. No two threads write to one
 * place, and the order of sums is fixed. */
#include "hairloss/physics_field.h"
#include "geometry/scan.h"
#include "geometry/vector.h"

#include <math.h>
#include <string.h>

enum {
    LANES = 2048,       /* gathered at most before the kernel is run */
    OWNERS = 256,       /* and of at most so many vertices */
    PLACES = 256,       /* vertices of a block */
    CHUNK = 128,        /* vertices of a strand at a time */
    MOST_KEPT = 1 << 20 /* vertices whose pairs are kept from the sums to the gradient */
};

/* Is the rest field made of what this call brings? */
bool hg_field_rest_follows(const field_pass *pass)
{
    const hg_pass *base = &pass->pass;
    if (base->source[HG_PASS_FIELD_REST].given || hg_groom_attribute_find(base->data, "density_rest")) return false;
    bool follows = base->source[HG_PASS_REST].given || (pass->weighs && base->source[HG_PASS_MASS].given);
    for (int p = 0; p < HG_ENERGY_PARAMS; p++) follows |= (pass->kernel_params >> p & 1) && base->source[p].given;
    return follows;
}

/* Room for a batch in the last piece of a slab, or in the next one. */
static field_piece *piece_for(field_slab *slab, int n_owners, int n, size_t size)
{
    field_piece *piece = slab->last;
    if (piece && piece->n_owners + n_owners <= PIECE_OWNERS && piece->n + n <= PIECE_PAIRS) return piece;
    field_piece **link = piece ? &piece->next : &slab->first;
    if (!*link) *link = hg_alloc(1, sizeof **link + PIECE_PAIRS * size);
    if (!*link) return NULL;
    slab->last = *link;
    slab->last->n_owners = slab->last->n = 0;
    return slab->last;
}

/* Adds the pairs of some vertices, at most LANES and OWNERS, to a slab. */
static hg_status keep_pairs(field_slab *slab, int n_owners, const int32_t *owner, const int32_t *first,
                            const int32_t *place, size_t size, const void *value)
{
    const int n = n_owners ? first[n_owners] : 0;
    if (n == 0) return HG_OK;
    field_piece *piece = piece_for(slab, n_owners, n, size);
    if (!piece) return HG_MEMORY;
    for (int o = 0; o < n_owners; o++) {
        piece->owner[piece->n_owners + o] = owner[o];
        piece->count[piece->n_owners + o] = first[o + 1] - first[o];
    }
    memcpy(piece->place + piece->n, place, (size_t)n * sizeof *place);
    memcpy((char *)piece->value + (size_t)piece->n * size, value, (size_t)n * size);
    piece->n_owners += n_owners;
    piece->n += n;
    return HG_OK;
}

/* One slab for each layer of the cells; emptied unless they hold the pairs of these cells. */
static hg_status begin_slabs(field_pass *pass)
{
    const int64_t layers = pass->cells.size[2];
    if (layers > pass->slabs_room) {
        field_slab *slabs = hg_resize(pass->slabs, (size_t)pass->slabs_room, (size_t)layers + 16, sizeof *slabs);
        if (!slabs) return HG_MEMORY;
        pass->slabs = slabs;
        pass->slabs_room = layers + 16;
    }
    for (int64_t s = 0; s < layers && !pass->kept; s++) {
        pass->slabs[s].last = NULL;
        pass->slabs[s].failed = false;
    }
    return HG_OK;
}

#define HG_P(name)    HG_JOIN(name, _, HG_SUFFIX)
#define hg_real       double
#define HG_SUFFIX     d
#define HG_TYPE       HG_F64
#define HG_MATH(name) name
#include "hairloss/physics_field_pairs.h"
#include "hairloss/physics_field_functions.h"
#undef hg_real
#undef HG_SUFFIX
#undef HG_TYPE
#undef HG_MATH

#define hg_real       float
#define HG_SUFFIX     f
#define HG_TYPE       HG_F32
#define HG_MATH(name) name##f
#include "hairloss/physics_field_pairs.h"
#include "hairloss/physics_field_functions.h"

static void field_destroy(void *self)
{
    field_pass *pass = self;
    if (!pass) return;
    hg_function *functions[] = { pass->kernel, pass->kernel_slope, pass->kernel_full, pass->function, pass->full };
    for (size_t i = 0; i < sizeof functions / sizeof *functions; i++) hg_function_destroy(functions[i]);
    hg_cells_free(&pass->cells);
    void *arrays[] = { pass->rest_now,   pass->rest_made,   pass->sums,       pass->slope,
                       pass->rest_slope, pass->slope_place, pass->mass_place, pass->theta_place };
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) hg_free(arrays[i]);
    for (int64_t s = 0; s < pass->slabs_room; s++)
        for (field_piece *piece = pass->slabs[s].first, *next; piece; piece = next) {
            next = piece->next;
            hg_free(piece);
        }
    hg_free(pass->slabs);
    hg_pass_free(&pass->pass);
    hg_free(pass);
}

static hg_status make_kernel(field_pass *pass)
{
    const hg_energy *energy = pass->pass.term.energy;
    hg_pass_inputs *inputs = &pass->kernel_inputs;
    hg_trace_scope scope;
    int wrt[HG_PASS_INPUTS];
    hg_term_scope(&scope, &pass->pass.term, 0, HG_ALLOW_FIELD_KERNEL);
    pass->kernel_distance = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_DISTANCE }, -1, 0);
    hg_pass_inputs_add_uniform(inputs, &pass->pass, false);
    for (int i = 0; i < inputs->n; i++) wrt[i] = i; /* output 1 + i is the slope in input i */
    HG_TRY(hg_function_create(&pass->kernel, energy->kernel, &scope, 0, NULL, inputs->n, inputs->inputs));
    HG_TRY(hg_function_create(&pass->kernel_slope, energy->kernel, &scope, 1, &pass->kernel_distance, inputs->n,
                              inputs->inputs));
    HG_TRY(hg_function_create(&pass->kernel_full, energy->kernel, &scope, inputs->n, wrt, inputs->n, inputs->inputs));
    return hg_formula_params(energy->kernel, &scope, &pass->kernel_params);
}

static hg_status make_function(field_pass *pass)
{
    const hg_energy *energy = pass->pass.term.energy;
    hg_pass_inputs *inputs = &pass->inputs;
    hg_trace_scope scope;
    int wrt[HG_PASS_INPUTS];
    hg_term_scope(&scope, &pass->pass.term, 0, HG_ALLOW_FIELD);
    pass->field = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_FIELD }, -1, 0);
    pass->field_rest = hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_FIELD_REST }, -1, 0);
    hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_MASS }, HG_PASS_MASS, 0);
    for (int a = 0; a < pass->pass.n_attributes; a++)
        hg_pass_inputs_add(inputs, (hg_input){ .kind = HG_INPUT_ATTRIBUTE, .name = (int16_t)a }, HG_PASS_ATTRIBUTE + a,
                           0);
    hg_pass_inputs_add_uniform(inputs, &pass->pass, true);
    for (int i = 0; i < inputs->n; i++) wrt[i] = i;
    const char *const *attributes = (const char *const *)pass->pass.attributes;
    HG_TRY(hg_function_create_named(&pass->function, energy->trace, &scope, 1, &pass->field, inputs->n, inputs->inputs,
                                    pass->pass.n_attributes, attributes));
    return hg_function_create_named(&pass->full, energy->trace, &scope, inputs->n, wrt, inputs->n, inputs->inputs,
                                    pass->pass.n_attributes, attributes);
}

/* The rest field of the groom itself: given, or the same sums over the rest groom, in double whatever the pass. */
static hg_status make_rest(field_pass *pass)
{
    const hg_groom_data *data = pass->pass.data;
    const int64_t n = data->strands * data->vertices;
    const double *given = hg_groom_attribute_find(data, "density_rest");
    double *rest = NULL;
    hg_status status = HG_OK;
    if (!given) {
        rest = hg_alloc((size_t)(data->grooms * n) + 1, sizeof *rest);
        if (!rest) return HG_MEMORY;
        for (int64_t g = 0; g < data->grooms && status == HG_OK; g++)
            status =
                make_field_d(pass, pass->pass.host, data->rest + 3 * g * n, data->mass + g * n, false, rest + g * n);
        hg_cells_free(&pass->cells);
    }
    if (status == HG_OK) status = hg_pass_own(&pass->pass, HG_PASS_FIELD_REST, data->grooms * n, given ? given : rest);
    hg_free(rest);
    return status;
}

static hg_status set_reach(field_pass *pass)
{
    const double reach = pass->pass.source[pass->reach].uniform;
    if (!(reach > 0.0) || !isfinite(reach))
        return hg_fail(HG_INVALID, "%s: %s is %g m; it has to be positive", pass->pass.term.energy->name,
                       pass->pass.term.energy->reach, reach);
    pass->radius = 2.0 * reach;
    hg_pass_inputs_fill(&pass->kernel_inputs, &pass->pass);
    hg_pass_inputs_fill(&pass->inputs, &pass->pass);
    return HG_OK;
}

static hg_status field_make(field_pass *pass, const hg_pass_setup *setup)
{
    const hg_energy *energy = setup->term.energy;
    uint32_t kinds;
    HG_TRY(hg_pass_create(&pass->pass, setup, HG_ALLOW_FIELD, &kinds));
    pass->pass.run_frame = setup->dtype == HG_F32 ? run_frame_f : run_frame_d;
    pass->reach = hg_pass_param(&pass->pass, energy->reach);
    if (!energy->kernel || pass->reach < 0)
        return hg_fail(HG_INVALID, "%s: a field energy needs a kernel and a reach", energy->name);
    pass->weighs = hg_term_weighs(&setup->term);
    const size_t n = (size_t)(pass->pass.strands * pass->pass.vertices) + 1, real = sizeof(double);
    void **arrays[] = { &pass->sums, &pass->slope, &pass->rest_slope, &pass->slope_place, &pass->mass_place };
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
        if (!(*arrays[i] = hg_alloc(n, real))) return HG_MEMORY;
    pass->rest_made = hg_alloc((size_t)pass->pass.grooms, sizeof *pass->rest_made);
    if (!pass->rest_made) return HG_MEMORY;
    HG_TRY(make_kernel(pass));
    HG_TRY(make_function(pass));
    pass->pass.uniform_only = pass->kernel_params | 1u << pass->reach;
    HG_TRY(hg_pass_begin(&pass->pass, &(hg_frame){ 0 }, 0, NULL));
    HG_TRY(set_reach(pass));
    HG_TRY(make_rest(pass));
    return hg_ctx_host(setup->ctx) ? HG_OK : hg_field_device_make(pass);
}

static hg_status field_create(void **self, const hg_pass_setup *setup)
{
    *self = NULL;
    field_pass *pass = hg_alloc(1, sizeof *pass);
    if (!pass) return HG_MEMORY;
    hg_status status = field_make(pass, setup);
    if (status != HG_OK) {
        field_destroy(pass);
        return status;
    }
    *self = pass;
    return HG_OK;
}

static hg_status field_run(void *self, hg_ctx *ctx, const hg_pass_call *call)
{
    field_pass *pass = self;
    hg_pass *base = &pass->pass;
    const size_t n = (size_t)(base->strands * base->vertices);
    HG_TRY(hg_pass_begin(base, call->frame, call->n_values, call->values));
    HG_TRY(set_reach(pass));
    const bool follows = hg_field_rest_follows(pass);
    if (follows && !base->source[HG_PASS_REST].given) { /* the groom's own rest, in the precision of the pass */
        void **own = &base->own[HG_PASS_REST];
        if (!*own) HG_TRY(hg_pass_own(base, HG_PASS_REST, 3 * base->grooms * (int64_t)n, base->data->rest));
        base->source[HG_PASS_REST].values = *own;
    }
    if (!hg_ctx_host(ctx)) return hg_field_device_run(pass, ctx, call);
    if (follows && !pass->rest_now) {
        pass->rest_now = hg_alloc((size_t)base->grooms * n + 1, hg_dtype_size(base->dtype));
        if (!pass->rest_now) return hg_fail(HG_MEMORY, "out of memory for the field at rest");
    }
    if (base->wants && !pass->theta_place) {
        pass->theta_place = hg_alloc(n + 1, sizeof *pass->theta_place);
        if (!pass->theta_place) return hg_fail(HG_MEMORY, "out of memory for the derivatives of a field");
    }
    for (int64_t g = 0; g < base->grooms; g++) pass->rest_made[g] = false;
    return hg_pass_frames(pass, ctx, call);
}

static const hg_physics_pass field_physics_pass = { field_create, field_destroy, field_run };
HG_REGISTER("physics_pass", field, &field_physics_pass);
