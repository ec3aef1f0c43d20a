/* What a call of a physics brings: names become values of params, of the groom and of the frame, checked, in the shape in
 * which the passes take them; and the gradients of those values go back to the tensors that they came from. */
#include "hairloss/physics_inputs.h"
#include "hairloss/physics_kernels.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- what the energies ask for ------------------------------------------------------------------------------ */

static hg_status add_name(hg_physics_name *names, int *n, const char *name, int width, int term)
{
    for (int i = 0; i < *n; i++)
        if (strcmp(names[i].name, name) == 0) {
            if (names[i].width == width) return HG_OK;
            return hg_fail(HG_INVALID, "the energies read '%s' as scalars and as vectors; one name is one array", name);
        }
    if (*n == HG_PHYSICS_NAMES)
        return hg_fail(HG_UNSUPPORTED, "the energies ask for more than %d named arrays", HG_PHYSICS_NAMES);
    names[*n] = (hg_physics_name){ hg_strdup(name), width, term };
    return names[(*n)++].name ? HG_OK : HG_MEMORY;
}

hg_status hg_physics_asked(hg_physics_asks *asks, const hg_term *terms, int n)
{
    for (int t = 0; t < n; t++) {
        const hg_energy *energy = terms[t].energy;
        if (hg_term_weighs(&terms[t])) asks->kinds |= HG_ALLOW(HG_INPUT_MASS);
        const hg_site_kind site = energy->site.kind;
        hg_scalar (*const formulas[3])(void) = { energy->trace, energy->root, energy->kernel };
        for (int f = 0; f < 3; f++) {
            if (!formulas[f]) continue;
            hg_trace_scope scope;
            hg_formula_names names;
            hg_term_scope(&scope, &terms[t], t,
                          site == HG_SITE_WINDOW  ? HG_ALLOW_WINDOW
                          : site == HG_SITE_PAIRS ? HG_ALLOW_PAIRS
                          : f == 2                ? HG_ALLOW_FIELD_KERNEL
                                                  : HG_ALLOW_FIELD);
            if (f == 1) {
                scope.window = 2;
                scope.allowed &= ~HG_ALLOW(HG_INPUT_CARRY);
            }
            hg_status status = hg_formula_reads(formulas[f], &scope, &names);
            asks->kinds |= names.kinds;
            if (site == HG_SITE_WINDOW) asks->window_kinds |= names.kinds;
            if (site != HG_SITE_WINDOW) asks->kinds |= HG_ALLOW(HG_INPUT_REST); /* distances at rest, neighbours */
            if (site == HG_SITE_FIELD) asks->kinds |= HG_ALLOW(HG_INPUT_MASS);  /* what a neighbour counts */
            for (int i = 0; status == HG_OK && i < names.n_attributes; i++)
                status = add_name(asks->attributes, &asks->n_attributes, names.attributes[i], 1, t);
            for (int i = 0; status == HG_OK && i < names.n_frames; i++)
                status = add_name(asks->frames, &asks->n_frames, names.frames[i], names.frame_width[i], t);
            if (status == HG_OK && names.kinds & HG_ALLOW(HG_INPUT_FIELD_REST))
                status = add_name(asks->attributes, &asks->n_attributes, "density_rest", 1, t);
            hg_formula_names_free(&names);
            HG_TRY(status);
        }
    }
    return HG_OK;
}

void hg_physics_asks_free(hg_physics_asks *asks)
{
    for (int i = 0; i < asks->n_attributes; i++) hg_free(asks->attributes[i].name);
    for (int i = 0; i < asks->n_frames; i++) hg_free(asks->frames[i].name);
    *asks = (hg_physics_asks){ 0 };
}

static const hg_physics_name *find_name(const hg_physics_name *names, int n, const char *name)
{
    for (int i = 0; i < n; i++)
        if (strcmp(names[i].name, name) == 0) return &names[i];
    return NULL;
}

/* ---- names to values ---------------------------------------------------------------------------------------- */

/* "the energies take a.b, c, d": all names that an input may have here. */
static hg_status unknown(const hg_physics_resolver *r, const char *name)
{
    hg_text list = { 0 };
    for (int t = 0; t < r->n_terms; t++) {
        const hg_energy *energy = r->terms[t].energy;
        for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++)
            hg_text_add(&list, "%s.%s, ", energy->name, energy->params[p].name);
    }
    static const char *const others[] = { "dt", "rest", "mass", "q" };
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (hg_physics_takes(r->asks, r->terms, r->n_terms, others[i])) hg_text_add(&list, "%s, ", others[i]);
    for (int i = 0; i < r->asks->n_attributes; i++) hg_text_add(&list, "%s, ", r->asks->attributes[i].name);
    for (int i = 0; i < r->asks->n_frames; i++) hg_text_add(&list, "%s, ", r->asks->frames[i].name);
    if (list.size > 2) list.data[list.size - 2] = 0;
    hg_status status = hg_fail(HG_INVALID, "physics: no energy asks for the input '%s'; there %s %s", name,
                               list.size > 2 ? "are" : "is", list.size > 2 ? list.data : "none");
    hg_text_free(&list);
    return status;
}

static hg_status wrong_shape(const hg_physics_resolver *r, const char *name, const hg_tensor *tensor,
                             const char *expected)
{
    char text[96];
    return hg_fail(HG_INVALID, "physics: input '%s' is %s, expected %s %s (B %lld, S %lld, V %lld, %lld grooms)", name,
                   hg_shape_text(tensor, text), hg_dtype_name(r->dtype), expected, (long long)r->frames,
                   (long long)r->data->strands, (long long)r->data->vertices, (long long)r->data->grooms);
}

static bool has_shape(const hg_physics_resolver *r, const hg_tensor *tensor, int rank, const int64_t *shape)
{
    bool fits = tensor->dtype == r->dtype && tensor->rank == rank;
    for (int i = 0; fits && i < rank; i++) fits = tensor->shape[i] == shape[i];
    return fits;
}

/* A buffer of zeros for the gradient of n values, where the tensor wants one. */
static hg_status add_value(hg_physics_resolver *r, hg_pass_value value, hg_tensor *tensor, int64_t n)
{
    hg_physics_values *to = r->values;
    if (to->n == HG_PHYSICS_VALUES)
        return hg_fail(HG_UNSUPPORTED, "physics: more than %d values are given in one call", HG_PHYSICS_VALUES);
    if (tensor && r->gradients && hg_needs_grad(tensor)) {
        value.gradient = hg_physics_zeros(r->ctx, r->dtype, n);
        if (!value.gradient) return HG_MEMORY;
        to->tensor[to->n] = tensor;
    } else {
        to->tensor[to->n] = NULL;
    }
    to->count[to->n] = n;
    to->value[to->n++] = value;
    return HG_OK;
}

/* A number: [], per strand [S], or per strand and frame [B,S]. */
static hg_status number(hg_physics_resolver *r, const char *name, hg_tensor *tensor, hg_pass_value value)
{
    const int64_t S = r->data->strands, strands[1] = { S }, both[2] = { r->frames, S };
    value.uniform = has_shape(r, tensor, 0, NULL);
    value.values = tensor->data;
    if (value.uniform) return add_value(r, value, tensor, 1);
    if (has_shape(r, tensor, 1, strands)) {
        value.values = hg_physics_repeat(r->ctx, r->dtype, S, r->frames * S, tensor->data);
        if (!value.values) return HG_MEMORY;
    } else if (!has_shape(r, tensor, 2, both)) {
        return wrong_shape(r, name, tensor, "[], [S] or [B,S]");
    }
    return add_value(r, value, tensor, r->frames * S);
}

static hg_status groom_array(hg_physics_resolver *r, const char *name, hg_tensor *tensor, hg_pass_value value,
                             int width)
{
    const int64_t shape[4] = { r->data->grooms, r->data->strands, r->data->vertices, 3 };
    if (!has_shape(r, tensor, width == 3 ? 4 : 3, shape))
        return wrong_shape(r, name, tensor, width == 3 ? "[G,S,V,3]" : "[G,S,V]");
    value.values = tensor->data;
    return add_value(r, value, tensor, hg_tensor_count(tensor));
}

static hg_status frame_array(hg_physics_resolver *r, const char *name, hg_tensor *tensor, hg_pass_value value,
                             int width)
{
    const int64_t shape[4] = { r->frames, r->data->strands, r->data->vertices - (width == 4), width };
    if (!has_shape(r, tensor, width == 1 ? 3 : 4, shape))
        return wrong_shape(r, name, tensor, width == 4 ? "[B,S,V-1,4]" : width == 3 ? "[B,S,V,3]" : "[B,S,V]");
    value.values = tensor->data;
    return add_value(r, value, tensor, hg_tensor_count(tensor));
}

/* "bend_twist.stiffness": of every term of that energy. */
static hg_status param(hg_physics_resolver *r, const char *name, hg_tensor *tensor, bool *found)
{
    const char *dot = strchr(name, '.');
    for (int t = 0; dot && t < r->n_terms; t++) {
        const hg_energy *energy = r->terms[t].energy;
        if (strlen(energy->name) != (size_t)(dot - name) || strncmp(energy->name, name, (size_t)(dot - name)) != 0)
            continue;
        for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
            if (strcmp(energy->params[p].name, dot + 1) != 0) continue;
            *found = true;
            HG_TRY(number(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_PARAM, .term = t, .param = p }));
        }
    }
    return HG_OK;
}

bool hg_physics_takes(const hg_physics_asks *asks, const hg_term *terms, int n, const char *name)
{
    const struct {
        const char *name;
        uint32_t kinds;
    } others[] = { { "dt", HG_ALLOW(HG_INPUT_DT) },
                   { "rest", HG_ALLOW(HG_INPUT_REST) | HG_ALLOW(HG_INPUT_ROOT_REST) },
                   { "mass", HG_ALLOW(HG_INPUT_MASS) },
                   { "q", HG_ALLOW(HG_INPUT_Q) } };
    for (int t = 0; t < n; t++) {
        const size_t length = strlen(terms[t].energy->name);
        if (strncmp(name, terms[t].energy->name, length) == 0 && name[length] == '.') return true;
    }
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (strcmp(name, others[i].name) == 0 && asks->kinds & others[i].kinds) return true;
    if (strcmp(name, "rest") == 0) name = "strand_length"; /* is made of it */
    return find_name(asks->attributes, asks->n_attributes, name) || find_name(asks->frames, asks->n_frames, name);
}

static hg_status named(hg_physics_resolver *r, const char *name, hg_tensor *tensor)
{
    const hg_physics_asks *asks = r->asks;
    const hg_physics_name *found;
    bool is_param = false;
    HG_TRY(param(r, name, tensor, &is_param));
    if (is_param) return HG_OK;
    if (strcmp(name, "dt") == 0 && asks->kinds & HG_ALLOW(HG_INPUT_DT)) {
        HG_TRY(number(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_DT }));
        for (int64_t i = 0; hg_ctx_host(r->ctx) && i < hg_tensor_count(tensor); i++) /* a device is not waited for */
            if (!(hg_tensor_item(tensor, i) > 0))
                return hg_fail(HG_INVALID, "physics: input 'dt' is %g s at number %lld; a time step is positive",
                               hg_tensor_item(tensor, i), (long long)i);
        return HG_OK;
    }
    if (strcmp(name, "rest") == 0 && hg_physics_takes(asks, r->terms, r->n_terms, name))
        return groom_array(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_REST }, 3);
    if (strcmp(name, "mass") == 0 && asks->kinds & HG_ALLOW(HG_INPUT_MASS))
        return groom_array(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_MASS }, 1);
    if (strcmp(name, "q") == 0 && asks->kinds & HG_ALLOW(HG_INPUT_Q))
        return frame_array(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_Q }, 4);
    if ((found = find_name(asks->attributes, asks->n_attributes, name)))
        return groom_array(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_ATTRIBUTE, .name = found->name }, 1);
    if ((found = find_name(asks->frames, asks->n_frames, name)))
        return frame_array(r, name, tensor, (hg_pass_value){ .kind = HG_INPUT_FRAME, .name = found->name },
                           found->width);
    return unknown(r, name);
}

/* ---- the mean deformation ----------------------------------------------------------------------------------- */

static const hg_pass_value *find_frame(const hg_physics_values *values, const char *name)
{
    for (int i = 0; i < values->n; i++)
        if (values->value[i].kind == HG_INPUT_FRAME && strcmp(values->value[i].name, name) == 0)
            return &values->value[i];
    return NULL;
}

/* "deformation_mean" where a formula reads it and the frame does not bring it: the mean of "deformation" over each run of
 * frame->consecutive frames. No gradient goes through it: the gradient of sum_i |dbar - d_i|^2 by dbar is
 * 2 sum_i (dbar - d_i), which is exactly zero. */
static hg_status make_mean(hg_physics_resolver *r)
{
    const hg_physics_name *mean = find_name(r->asks->frames, r->asks->n_frames, "deformation_mean");
    const hg_pass_value *from = find_frame(r->values, "deformation");
    if (!mean || !from || find_frame(r->values, "deformation_mean")) return HG_OK;
    const int64_t B = r->frames, group = r->frame->consecutive > 0 ? r->frame->consecutive : B,
                  row = r->data->strands * r->data->vertices * mean->width;
    if (group > 0 && B % group)
        return hg_fail(HG_INVALID, "physics: %lld frames are not sequences of %lld consecutive ones", (long long)B,
                       (long long)group);
    void *to = hg_physics_mean(r->ctx, r->dtype, B, group, row, from->values);
    if (!to) return HG_MEMORY;
    return add_value(r, (hg_pass_value){ .kind = HG_INPUT_FRAME, .name = mean->name, .values = to }, NULL, B * row);
}

/* ---- the length of the strands ------------------------------------------------------------------------------ */

/* "strand_length" follows a rest groom that is given, where it is not given itself. */
static hg_status make_strand_length(hg_physics_resolver *r)
{
    const hg_physics_name *name = find_name(r->asks->attributes, r->asks->n_attributes, "strand_length");
    const hg_pass_value *rest = NULL;
    for (int i = 0; name && i < r->values->n; i++) {
        const hg_pass_value *value = &r->values->value[i];
        if (value->kind == HG_INPUT_REST) rest = value;
        if (value->kind == HG_INPUT_ATTRIBUTE && strcmp(value->name, "strand_length") == 0) return HG_OK;
    }
    if (!rest) return HG_OK;
    const int64_t V = r->data->vertices, strands = r->data->grooms * r->data->strands;
    void *to = hg_physics_lengths(r->ctx, r->dtype, strands, V, rest->values), *gradient = NULL;
    if (rest->gradient) gradient = hg_physics_zeros(r->ctx, r->dtype, strands * V);
    if (!to || (rest->gradient && !gradient)) return HG_MEMORY;
    return add_value(
        r, (hg_pass_value){ .kind = HG_INPUT_ATTRIBUTE, .name = name->name, .values = to, .gradient = gradient }, NULL,
        strands * V);
}

/* What came to "strand_length" goes on to the rest groom that it was made of. */
hg_status hg_physics_chain(const hg_physics_resolver *r)
{
    const hg_pass_value *rest = NULL, *length = NULL;
    for (int i = 0; i < r->values->n; i++) {
        const hg_pass_value *value = &r->values->value[i];
        if (value->kind == HG_INPUT_REST) rest = value;
        if (value->kind == HG_INPUT_ATTRIBUTE && !r->values->tensor[i] && strcmp(value->name, "strand_length") == 0)
            length = value;
    }
    if (!rest || !rest->gradient || !length || !length->gradient) return HG_OK;
    return hg_physics_lengths_gradient(r->ctx, r->dtype, r->data->grooms * r->data->strands, r->data->vertices,
                                       rest->values, length->gradient, rest->gradient);
}

/* ---- all of a frame ----------------------------------------------------------------------------------------- */

hg_status hg_physics_resolve(hg_physics_resolver *r)
{
    const hg_frame *frame = r->frame;
    const struct {
        hg_tensor *tensor;
        hg_input_kind kind;
    } members[] = { { frame->root_rotation, HG_INPUT_ROOT_ROTATION },
                    { frame->root_position, HG_INPUT_ROOT_POSITION },
                    { frame->posed, HG_INPUT_POSED },
                    { frame->predicted, HG_INPUT_PREDICTED },
                    { frame->previous, HG_INPUT_PREVIOUS } };
    r->values->n = 0;
    for (size_t i = 0; i < sizeof members / sizeof *members; i++)
        if (r->gradients && hg_needs_grad(members[i].tensor))
            HG_TRY(add_value(r, (hg_pass_value){ .kind = members[i].kind, .values = members[i].tensor->data },
                             members[i].tensor, hg_tensor_count(members[i].tensor)));
    if (r->gradients && hg_needs_grad(frame->body_vertices))
        return hg_fail(HG_UNSUPPORTED, "physics: body_vertices needs a gradient, but contact is detached; detach it "
                                       "with hg_detach");
    for (int i = 0; i < frame->n_inputs; i++) {
        if (!frame->inputs[i].name || !frame->inputs[i].value)
            return hg_fail(HG_INVALID, "physics: input %d has no %s", i, frame->inputs[i].name ? "value" : "name");
        for (int j = 0; j < i; j++)
            if (strcmp(frame->inputs[j].name, frame->inputs[i].name) == 0)
                return hg_fail(HG_INVALID, "physics: input '%s' is given twice", frame->inputs[i].name);
        HG_TRY(named(r, frame->inputs[i].name, frame->inputs[i].value));
    }
    HG_TRY(make_strand_length(r));
    return make_mean(r);
}

/* The gradient of a tensor: the sum of those of the values made from it, in its own shape. */
void *hg_physics_gradient(hg_ctx *ctx, const hg_physics_values *values, const hg_tensor *tensor)
{
    const int64_t n = hg_tensor_count(tensor);
    const void *parts[HG_PHYSICS_VALUES];
    int64_t count[HG_PHYSICS_VALUES];
    int made = 0, only = -1;
    for (int i = 0; i < values->n; i++)
        if (values->tensor[i] == tensor) {
            parts[made] = values->value[i].gradient;
            count[made++] = values->count[i];
            only = i;
        }
    if (made == 1 && values->count[only] == n) return values->value[only].gradient;
    return hg_physics_add_parts(ctx, tensor->dtype, n, made, parts, count);
}

/* What of it changes the strand program. Values that are the same for all strands and need no gradient do not. */
void hg_physics_variant(const hg_physics_resolver *r, const int32_t *column, int n_window, hg_strand_variant *variant)
{
    const hg_physics_asks *asks = r->asks;
    *variant = (hg_strand_variant){ 0 };
    variant->posed_given = r->frame->posed && asks->window_kinds & HG_ALLOW(HG_INPUT_POSED);
    for (int i = 0; i < r->values->n; i++) {
        const hg_pass_value *value = &r->values->value[i];
        hg_given given = { value->kind, 0, value->param, value->name, value->gradient != NULL };
        if (value->kind == HG_INPUT_PARAM) {
            while (given.term < n_window && column[given.term] != value->term) given.term++;
            if (given.term == n_window) continue;
        }
        const bool reads_rest = value->kind == HG_INPUT_REST && asks->window_kinds & HG_ALLOW(HG_INPUT_ROOT_REST);
        if (!(asks->window_kinds & HG_ALLOW(value->kind)) && !reads_rest) continue;
        if (value->uniform && !value->gradient) continue;
        if (value->kind == HG_INPUT_REST) variant->root_at_rest = !r->frame->root_position;
        if (variant->n_given < HG_GIVEN) variant->given[variant->n_given++] = given;
    }
}

bool hg_physics_same_variant(const hg_strand_variant *a, const hg_strand_variant *b)
{
    bool same = a->posed_given == b->posed_given && a->root_at_rest == b->root_at_rest && a->n_given == b->n_given;
    for (int i = 0; same && i < a->n_given; i++) {
        const hg_given *p = &a->given[i], *q = &b->given[i];
        same = p->kind == q->kind && p->term == q->term && p->param == q->param && p->name == q->name &&
               p->gradient == q->gradient;
    }
    return same;
}
