/* What the passes over pairs and over fields share: the sources of an energy's numbers, and the walk over frames. */
#include "hairloss/physics_pass.h"

#include <string.h>

int hg_pass_inputs_add(hg_pass_inputs *list, hg_input input, int source, int side)
{
    list->inputs[list->n] = input;
    list->source[list->n] = source;
    list->side[list->n] = side;
    return list->n++;
}

static int count_params(const hg_energy *energy)
{
    int n = 0;
    while (n < HG_ENERGY_PARAMS && energy->params[n].name) n++;
    return n;
}

void hg_pass_inputs_add_uniform(hg_pass_inputs *list, const hg_pass *pass, bool dt)
{
    for (int p = 0; p < count_params(pass->term.energy); p++)
        hg_pass_inputs_add(list, (hg_input){ .kind = HG_INPUT_PARAM, .name = (int16_t)p }, p, 0);
    if (dt) hg_pass_inputs_add(list, (hg_input){ .kind = HG_INPUT_DT }, HG_PASS_DT, 0);
}

void hg_pass_inputs_fill(hg_pass_inputs *list, const hg_pass *pass)
{
    for (int i = 0; i < list->n; i++)
        list->uniform[i] = list->source[i] < 0 ? 0 : pass->source[list->source[i]].uniform;
}

int hg_pass_param(const hg_pass *pass, const char *name)
{
    for (int p = 0; name && p < count_params(pass->term.energy); p++)
        if (strcmp(pass->term.energy->params[p].name, name) == 0) return p;
    return -1;
}

void *hg_pass_values(hg_dtype dtype, int64_t n, const double *from)
{
    void *to = hg_alloc((size_t)n + 1, hg_dtype_size(dtype));
    if (!to) return NULL;
    for (int64_t i = 0; i < n; i++) {
        if (dtype == HG_F32)
            ((float *)to)[i] = (float)from[i];
        else
            ((double *)to)[i] = from[i];
    }
    return to;
}

hg_status hg_pass_own(hg_pass *pass, int s, int64_t n, const double *from)
{
    void *values = hg_pass_values(pass->dtype, n, from);
    if (!values) return hg_fail(HG_MEMORY, "out of memory for %lld numbers of a groom", (long long)n);
    if (hg_ctx_host(pass->ctx)) {
        pass->own[s] = values;
        return HG_OK;
    }
    hg_tensor *tensor = pass->own_tensor[s] = hg_tensor_create(pass->ctx, pass->dtype, 1, &n);
    const hg_status status = tensor ? hg_tensor_write(tensor, values) : HG_MEMORY;
    if (tensor) pass->own[s] = tensor->data;
    hg_free(values);
    return status;
}

void hg_pass_free(hg_pass *pass)
{
    for (int a = 0; a < pass->n_attributes; a++) hg_free(pass->attributes[a]);
    for (int s = 0; s < HG_PASS_SOURCES; s++) {
        if (pass->own_tensor[s])
            hg_tensor_destroy(pass->own_tensor[s]);
        else
            hg_free(pass->own[s]);
    }
    for (int i = 0; i < pass->n_kernels; i++) hg_kernel_release(pass->ctx, &pass->kernels[i]);
    hg_text_free(&pass->text);
    if (pass->host != pass->ctx) hg_ctx_destroy(pass->host);
    hg_free(pass->strand_slopes);
    hg_free(pass->strand_energies);
}

hg_status hg_pass_create(hg_pass *pass, const hg_pass_setup *setup, uint32_t allowed, uint32_t *kinds)
{
    const hg_groom_data *data = setup->data;
    const int64_t n = data->grooms * data->strands * data->vertices;
    hg_trace_scope scope;
    pass->ctx = setup->ctx;
    if (hg_ctx_host(setup->ctx))
        pass->host = setup->ctx;
    else
        HG_TRY(hg_ctx_create(&pass->host, &(hg_ctx_options){ .threads = hg_ctx_threads(setup->ctx) }));
    pass->dtype = setup->dtype;
    pass->term = setup->term;
    pass->number = setup->number;
    pass->data = data;
    pass->grooms = data->grooms;
    pass->strands = data->strands;
    pass->vertices = data->vertices;
    hg_term_scope(&scope, &setup->term, 0, allowed);
    HG_TRY(hg_formula_inputs(setup->term.energy->trace, &scope, kinds, &pass->n_attributes, pass->attributes));
    HG_TRY(hg_pass_own(pass, HG_PASS_MASS, n, data->mass));
    pass->strand_slopes = hg_alloc((size_t)(HG_PASS_SOURCES * pass->strands) + 1, sizeof *pass->strand_slopes);
    pass->strand_energies = hg_alloc((size_t)pass->strands + 1, sizeof *pass->strand_energies);
    if (!pass->strand_slopes || !pass->strand_energies) return HG_MEMORY;
    for (int a = 0; a < pass->n_attributes; a++) {
        const double *from = hg_groom_attribute_find(data, pass->attributes[a]);
        if (!from)
            return hg_fail(HG_INVALID, "energy '%s' asks for the groom attribute '%s', which the groom does not have",
                           setup->term.energy->name, pass->attributes[a]);
        HG_TRY(hg_pass_own(pass, HG_PASS_ATTRIBUTE + a, n, from));
    }
    for (int s = 0; s < HG_PASS_SOURCES; s++)
        pass->source[s].strands = pass->strand_slopes + (int64_t)s * pass->strands;
    return HG_OK;
}

/* ---- a call ------------------------------------------------------------------------------------------------- */

/* Which source a value of the call is; -1: none of this energy. */
static int source_of(const hg_pass *pass, const hg_pass_value *value)
{
    switch (value->kind) {
    case HG_INPUT_PARAM:
        return value->term == pass->number ? value->param : -1;
    case HG_INPUT_DT:
        return HG_PASS_DT;
    case HG_INPUT_REST:
        return HG_PASS_REST;
    case HG_INPUT_MASS:
        return HG_PASS_MASS;
    case HG_INPUT_ATTRIBUTE:
        if (pass->term.energy->site.kind == HG_SITE_FIELD && strcmp(value->name, "density_rest") == 0)
            return HG_PASS_FIELD_REST;
        for (int a = 0; a < pass->n_attributes; a++)
            if (strcmp(pass->attributes[a], value->name) == 0) return HG_PASS_ATTRIBUTE + a;
        return -1;
    default:
        return -1;
    }
}

static hg_status take(hg_pass *pass, int s, const hg_pass_value *value)
{
    hg_pass_source *source = &pass->source[s];
    const char *energy = pass->term.energy->name;
    if (s < HG_ENERGY_PARAMS) {
        const char *param = pass->term.energy->params[s].name;
        if (value->gradient && pass->makes_list >> s & 1)
            return hg_fail(HG_UNSUPPORTED, "%s.%s makes the list of pairs and has no derivative: detach it", energy,
                           param);
        if (!value->uniform && pass->uniform_only >> s & 1)
            return hg_fail(HG_INVALID, "%s.%s is the same for all strands: give it as a tensor of one value", energy,
                           param);
    }
    source->given = true;
    source->gradient = value->gradient;
    pass->wants |= value->gradient != NULL;
    if (s >= HG_PASS_MASS) {
        source->values = value->values;
    } else if (value->uniform && !hg_ctx_host(pass->ctx)) {
        source->values = value->values;
    } else if (value->uniform) {
        source->uniform =
            pass->dtype == HG_F32 ? (double)*(const float *)value->values : *(const double *)value->values;
    } else {
        source->shape = HG_PASS_STRAND;
        source->values = value->values;
    }
    return HG_OK;
}

hg_status hg_pass_begin(hg_pass *pass, const hg_frame *frame, int n_values, const hg_pass_value *values)
{
    pass->wants = false;
    for (int s = 0; s < HG_PASS_SOURCES; s++) {
        hg_pass_source *source = &pass->source[s];
        *source = (hg_pass_source){ .shape = s < HG_PASS_MASS ? HG_PASS_UNIFORM : HG_PASS_GROOM,
                                    .values = pass->own[s],
                                    .strands = source->strands };
        if (s < count_params(pass->term.energy)) source->uniform = pass->term.params[s];
    }
    pass->source[HG_PASS_DT].uniform = frame->dt;
    for (int i = 0; i < n_values; i++) {
        const int s = source_of(pass, &values[i]);
        if (s >= 0) HG_TRY(take(pass, s, &values[i]));
    }
    return HG_OK;
}

hg_status hg_pass_number(const hg_pass *pass, int param, double *number)
{
    const hg_pass_source *source = &pass->source[param];
    *number = source->uniform;
    if (!source->values) return HG_OK;
    hg_tensor *given = hg_tensor_wrap(pass->ctx, pass->dtype, 0, NULL, (void *)(uintptr_t)source->values);
    if (!given) return HG_MEMORY;
    *number = hg_tensor_item(given, 0);
    return HG_OK;
}

/* What a frame has left for every strand goes where it belongs. */
static void add_strands(hg_pass *pass, int64_t frame)
{
    for (int s = 0; s < HG_PASS_MASS; s++) {
        hg_pass_source *source = &pass->source[s];
        if (!source->gradient) continue;
        for (int64_t i = 0; i < pass->strands; i++) {
            const int64_t at = frame * pass->strands + i;
            if (source->shape == HG_PASS_UNIFORM)
                source->sum += source->strands[i];
            else if (pass->dtype == HG_F32)
                ((float *)source->gradient)[at] += (float)source->strands[i];
            else
                ((double *)source->gradient)[at] += source->strands[i];
        }
    }
}

static void add_sums(hg_pass *pass)
{
    for (int s = 0; s < HG_PASS_MASS; s++) {
        hg_pass_source *source = &pass->source[s];
        if (!source->gradient || source->shape != HG_PASS_UNIFORM) continue;
        if (pass->dtype == HG_F32)
            *(float *)source->gradient += (float)source->sum;
        else
            *(double *)source->gradient += source->sum;
    }
}

hg_status hg_pass_frames(void *self, hg_ctx *ctx, const hg_pass_call *call)
{
    hg_pass *pass = self; /* a pass begins with it */
    const size_t bytes = 3 * (size_t)(pass->strands * pass->vertices) * hg_dtype_size(pass->dtype);
    *call->unweighted = 0.0;
    for (int64_t b = 0; b < call->x->shape[0]; b++) {
        const hg_pass_frame at = { b, call->groom ? call->groom[b] : 0, (const char *)call->x->data + (size_t)b * bytes,
                                   call->gradient ? (char *)call->gradient + (size_t)b * bytes : NULL };
        if (pass->wants) memset(pass->strand_slopes, 0, sizeof(double) * (size_t)(HG_PASS_SOURCES * pass->strands));
        HG_TRY(pass->run_frame(self, ctx, &at));
        for (int64_t s = 0; s < pass->strands; s++) {
            *call->unweighted += pass->strand_energies[s];
            if (call->per_strand) call->per_strand[(b * pass->strands + s) * call->stride] = pass->strand_energies[s];
        }
        if (pass->wants) add_strands(pass, b);
    }
    if (pass->wants) add_sums(pass);
    return HG_OK;
}
