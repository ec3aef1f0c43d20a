/* Is a gradient right? f64, fourth-order central differences over a sweep of steps, signed relative error. Every
 * element of small inputs, random directions of large ones. */
#include "autograd/tape.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { STEPS = HG_GRADCHECK_STEPS, MAX_ELEMENTS = 2000, DIRECTIONS = 16 };

typedef hg_tensor *formula(void *self, hg_ctx *ctx, hg_tensor **in);

typedef struct {
    hg_ctx *ctx;
    formula *f;
    void *self;
    int n_in;
    hg_tensor *in[HG_OP_INPUTS];
    double *value[HG_OP_INPUTS], *gradient[HG_OP_INPUTS], *direction[HG_OP_INPUTS]; /* of the checked inputs */
    double *moved[HG_OP_INPUTS];                                                    /* what they are changed to */
    const hg_call *call; /* of an op: for its kinks; may be NULL */
    const bool *empty;   /* of an op: its output is, so that gradients are zero; may be NULL */
    double tolerance, step, center, norm, largest[HG_OP_INPUTS];
    const double *units;      /* of the inputs, may be NULL */
    const char *const *names; /* may be NULL */
    hg_gradcheck_result *result;
} check;

/* ---- values ---- */

static hg_status evaluate(const check *c, double *value)
{
    hg_step_mark mark = hg_step_set_mark(c->ctx);
    hg_no_grad_begin(c->ctx);
    hg_tensor *y = c->f(c->self, c->ctx, (hg_tensor **)c->in);
    hg_no_grad_end(c->ctx);
    *value = y ? hg_tensor_item(y, 0) : (double)NAN;
    hg_step_rewind(c->ctx, mark);
    return hg_ctx_status(c->ctx);
}

/* f at x + t (direction), or along one element when element >= 0. */
static hg_status evaluate_at(const check *c, int input, int64_t element, double t, double *value)
{
    for (int i = 0; i < c->n_in; i++) {
        if (!c->value[i] || (element >= 0 && i != input)) continue;
        double *x = c->moved[i];
        int64_t n = hg_tensor_count(c->in[i]);
        if (element >= 0) {
            memcpy(x, c->value[i], (size_t)n * sizeof *x);
            x[element] += t;
        } else {
            for (int64_t e = 0; e < n; e++) x[e] = c->value[i][e] + t * c->direction[i][e];
        }
        HG_TRY(hg_tensor_write(c->in[i], x));
    }
    hg_status status = evaluate(c, value);
    for (int i = 0; i < c->n_in; i++)
        if (c->value[i] && (element < 0 || i == input)) {
            const hg_status restored = hg_tensor_write(c->in[i], c->value[i]);
            if (status == HG_OK) status = restored;
        }
    return status;
}

/* Four values on one side of the point: the derivative there, without looking across a kink. */
static hg_status one_sided(const check *c, int input, int64_t element, double h, double *numeric)
{
    double y[5] = { c->center };
    for (int j = 1; j < 5; j++) HG_TRY(evaluate_at(c, input, element, j * h, &y[j]));
    *numeric = (-25 * y[0] + 48 * y[1] - 36 * y[2] + 16 * y[3] - 3 * y[4]) / (12 * h);
    return HG_OK;
}

/* Is there a kink within the steps? The gradient is then the derivative to one side, and clearly not to the other. A wrong
 * gradient of a smooth function is neither. */
static hg_status find_kink(const check *c, int input, int64_t element, double analytic, double scale, double small,
                           bool *kink)
{
    const double close = fmax(1e2 * c->tolerance, 1e-5);
    *kink = false;
    double h = c->step * scale;
    for (int k = 0; k < STEPS && !*kink; k++, h /= 10) {
        double side[2];
        HG_TRY(one_sided(c, input, element, h, &side[0]));
        HG_TRY(one_sided(c, input, element, -h, &side[1]));
        const double noise = 64 * 2.3e-16 * fabs(c->center) / h,
                     floor = fmax(fmax(fmax(small, fabs(analytic)), noise / c->tolerance), 1e-300);
        const double off[2] = { fabs(side[0] - analytic) / floor, fabs(side[1] - analytic) / floor };
        *kink = fmin(off[0], off[1]) < close && fmax(off[0], off[1]) > 100 * close;
    }
    return HG_OK;
}

/* "name[1,2,0]" */
static void name_element(const check *c, int input, int64_t element, char *text, size_t room)
{
    int length = c->names ? snprintf(text, room, "%s", c->names[input]) : snprintf(text, room, "input %d", input);
    const hg_tensor *tensor = c->in[input];
    int64_t below = hg_tensor_count(tensor);
    for (int axis = 0; axis < tensor->rank && length < (int)room; axis++) {
        below /= tensor->shape[axis];
        length += snprintf(text + length, room - (size_t)length, "%s%lld%s", axis ? "," : "[",
                           (long long)(element / below % tensor->shape[axis]), axis == tensor->rank - 1 ? "]" : "");
    }
}

static void keep_worst(const check *c, const hg_gradcheck_result *found)
{
    hg_gradcheck_result *r = c->result;
    const int64_t checked = r->checked, kinks = r->kinks;
    if (!(found->worst > r->worst || (r->text[0] == 0 && found->worst >= r->worst))) return;
    char name[128] = "random direction";
    *r = *found;
    r->checked = checked;
    r->kinks = kinks;
    if (r->element >= 0) name_element(c, r->input, r->element, name, sizeof name);
    snprintf(r->text, sizeof r->text, "%s: analytic %.12g, numeric %.12g (step %g), relative error %.3g", name,
             r->analytic, r->numeric, r->step, r->worst);
}

/* One derivative against the sweep; keeps the worst in the result. `small` is what counts as small. */
static hg_status compare(const check *c, int input, int64_t element, double analytic, double scale, double small)
{
    hg_gradcheck_result found = {
        .worst = (double)INFINITY, .input = input, .element = element, .analytic = analytic, .numeric = (double)NAN
    };
    double h = c->step * scale;
    for (int k = 0; k < STEPS; k++, h /= 10) {
        double y[4];
        const double at[4] = { -2, -1, 1, 2 };
        for (int j = 0; j < 4; j++) HG_TRY(evaluate_at(c, input, element, at[j] * h, &y[j]));
        double numeric = (8 * (y[2] - y[1]) - (y[3] - y[0])) / (12 * h);
        /* Rounding of f alone gives this much; a derivative cannot be told from zero below it. */
        double noise = 4 * 2.3e-16 * fabs(c->center) / h / c->tolerance;
        double floor = fmax(fmax(small, noise), 1e-300);
        double error = fabs(analytic - numeric) / fmax(fmax(fabs(analytic), fabs(numeric)), floor);
        if (isnan(error)) error = (double)INFINITY;
        if (error < found.worst || isnan(found.numeric)) {
            found.worst = error;
            found.numeric = numeric;
            found.step = h;
        }
        found.sweep[k].step = h;
        found.sweep[k].numeric = numeric;
        found.sweep[k].error = error;
        found.steps = k + 1;
        if (found.worst < 1e-2 * c->tolerance) break;
    }
    if (found.worst > c->tolerance && isfinite(analytic)) {
        bool kink;
        HG_TRY(find_kink(c, input, element, analytic, scale, small, &kink));
        if (kink) {
            c->result->kinks++;
            return HG_OK;
        }
    }
    c->result->checked++;
    keep_worst(c, &found);
    return HG_OK;
}

static bool at_kink(const check *c, int input, int64_t element)
{
    return c->call && c->call->op->kink && c->call->op->kink(c->call, input, element, 2 * c->step);
}

static hg_status check_elements(const check *c)
{
    for (int i = 0; i < c->n_in; i++)
        for (int64_t e = 0; c->value[i] && e < hg_tensor_count(c->in[i]); e++) {
            if (at_kink(c, i, e)) {
                c->result->kinks++;
                continue;
            }
            HG_TRY(compare(c, i, e, c->gradient[i][e], fmax(c->units ? c->units[i] : 1, fabs(c->value[i][e])),
                           1e-4 * c->largest[i]));
        }
    return HG_OK;
}

/* A direction moves every input by its own unit. */
static hg_status check_directions(check *c, int directions)
{
    for (int d = 0; d < directions; d++) {
        double length = 0, analytic = 0;
        for (int i = 0; i < c->n_in; i++)
            for (int64_t e = 0; c->value[i] && e < hg_tensor_count(c->in[i]); e++) {
                double x = at_kink(c, i, e) ? 0 : hg_random_normal(17, (uint64_t)(d * HG_OP_INPUTS + i), (uint64_t)e);
                c->direction[i][e] = x;
                length += x * x;
            }
        if (length == 0) continue;
        for (int i = 0; i < c->n_in; i++)
            for (int64_t e = 0; c->value[i] && e < hg_tensor_count(c->in[i]); e++) {
                c->direction[i][e] *= (c->units ? c->units[i] : 1) / sqrt(length);
                analytic += c->direction[i][e] * c->gradient[i][e];
            }
        HG_TRY(compare(c, 0, -1, analytic, 1, 1e-4 * c->norm));
    }
    return HG_OK;
}

/* ---- the check ---- */

/* Runs f and its backward once, and keeps the inputs' values and gradients. */
static hg_status take_gradients(check *c)
{
    bool any = false;
    char text[96];
    for (int i = 0; i < c->n_in; i++) any |= hg_needs_grad(c->in[i]);
    for (int i = 0; i < c->n_in; i++)
        if (!any && c->in[i] && c->in[i]->dtype == HG_F64) HG_TRY(hg_require_grad(c->in[i]));
    hg_tensor *y = c->f(c->self, c->ctx, c->in);
    HG_TRY(hg_ctx_status(c->ctx));
    if (!y || y->dtype != HG_F64 || hg_tensor_count(y) != 1)
        return hg_ctx_fail(c->ctx, HG_INVALID, "gradcheck: the formula gave %s, one f64 element is needed",
                           hg_shape_text(y, text));
    c->center = hg_tensor_item(y, 0);
    HG_TRY((hg_backward)(c->ctx, y));
    for (int i = 0; i < c->n_in; i++) {
        if (!hg_needs_grad(c->in[i])) continue;
        if (c->in[i]->dtype != HG_F64)
            return hg_ctx_fail(c->ctx, HG_INVALID, "gradcheck: input %d is %s, f64 is needed", i,
                               hg_shape_text(c->in[i], text));
        int64_t n = hg_tensor_count(c->in[i]);
        double **parts[] = { &c->value[i], &c->gradient[i], &c->direction[i], &c->moved[i] };
        for (int j = 0; j < 4; j++) {
            *parts[j] = hg_alloc((size_t)(n ? n : 1), sizeof(double));
            if (!*parts[j]) return hg_ctx_fail(c->ctx, HG_MEMORY, "out of memory: gradcheck");
        }
        HG_TRY(hg_tensor_read(c->in[i], c->value[i]));
        HG_TRY(hg_tensor_read(hg_grad(c->in[i]), c->gradient[i]));
    }
    return HG_OK;
}

/* element -1: the gradient of the whole input is zero. */
static hg_status zero_or_not_finite(const check *c, int input, int64_t element)
{
    char name[128];
    if (element < 0) {
        if (c->names)
            return hg_fail(HG_NUMERIC, "gradcheck: the gradient of %s is zero everywhere; say so if that is meant",
                           c->names[input]);
        return hg_fail(HG_NUMERIC, "gradcheck: the gradient of input %d is zero everywhere; say so if that is meant",
                       input);
    }
    name_element(c, input, element, name, sizeof name);
    c->result->input = input;
    c->result->element = element;
    return hg_fail(HG_NUMERIC, "gradcheck: the gradient of %s is not finite", name);
}

/* A gradient that is zero everywhere is nearly always a forgotten one. */
static hg_status refuse_zeros(check *c, bool declared)
{
    for (int i = 0; i < c->n_in; i++) {
        if (!c->value[i]) continue;
        int64_t n = hg_tensor_count(c->in[i]);
        double largest = 0;
        for (int64_t e = 0; e < n; e++) {
            double g = fabs(c->gradient[i][e]);
            if (!(g <= 1e300)) return zero_or_not_finite(c, i, e);
            largest = fmax(largest, g);
            c->norm += g * g * (c->units ? c->units[i] * c->units[i] : 1);
        }
        c->largest[i] = largest;
        if (n > 0 && largest == 0 && !declared) return zero_or_not_finite(c, i, -1);
    }
    c->norm = sqrt(c->norm);
    return HG_OK;
}

static hg_status run_check(check *c, const hg_gradcheck_options *options)
{
    hg_gradcheck_options given = options ? *options : (hg_gradcheck_options){ 0 };
    c->tolerance = given.tolerance > 0 ? given.tolerance : 1e-6;
    c->step = given.step > 0 ? given.step : 1e-3;
    c->units = given.units;
    c->names = given.names;
    *c->result = (hg_gradcheck_result){ 0 };
    hg_status status = take_gradients(c);
    if (status == HG_OK) status = refuse_zeros(c, given.zero_gradient || (c->empty && *c->empty));
    int64_t elements = 0;
    for (int i = 0; i < c->n_in; i++)
        if (c->value[i]) elements += hg_tensor_count(c->in[i]);
    int directions = given.directions > 0 ? given.directions : elements > MAX_ELEMENTS ? DIRECTIONS : 0;
    if (status == HG_OK) status = directions ? check_directions(c, directions) : check_elements(c);
    for (int i = 0; i < c->n_in; i++) {
        hg_free(c->value[i]);
        hg_free(c->gradient[i]);
        hg_free(c->direction[i]);
        hg_free(c->moved[i]);
    }
    if (status == HG_OK && c->result->checked == 0 && c->result->kinks > 0 && !c->call)
        status = hg_fail(HG_NUMERIC, "gradcheck: every one of the %lld derivatives is at a kink: nothing was checked",
                         (long long)c->result->kinks);
    if (status == HG_OK && c->result->worst > c->tolerance)
        status = hg_fail(HG_NUMERIC, "gradcheck: %s, more than %g", c->result->text, c->tolerance);
    return status;
}

hg_status hg_gradcheck(hg_ctx *ctx, formula *f, void *self, int n_in, hg_tensor *const *in,
                       const hg_gradcheck_options *options, hg_gradcheck_result *result)
{
    hg_gradcheck_result unused;
    check c = { .ctx = ctx, .f = f, .self = self, .n_in = n_in, .result = result ? result : &unused };
    if (n_in < 0 || n_in > HG_OP_INPUTS)
        return hg_fail(HG_INVALID, "gradcheck: %d inputs, up to %d are possible", n_in, HG_OP_INPUTS);
    for (int i = 0; i < n_in; i++) c.in[i] = in[i];
    return run_check(&c, options);
}

/* ---- ops ---- */

hg_tensor *hg_sample_input(hg_ctx *ctx, const hg_sample *sample, int i, hg_dtype dtype)
{
    bool index = sample->in[i].dtype == HG_I32;
    hg_tensor *tensor = hg_tensor_make(ctx, index ? HG_I32 : dtype, sample->in[i].rank, sample->in[i].shape);
    if (!tensor) return NULL;
    double low = sample->in[i].low, high = sample->in[i].high;
    if (low == 0 && high == 0) low = -1, high = 1;
    int64_t n = hg_tensor_count(tensor);
    void *values = hg_step_alloc(ctx, hg_tensor_bytes(tensor));
    if (!values) return NULL;
    for (int64_t e = 0; e < n; e++) {
        double x = low + (high - low) * hg_random_uniform(5, (uint64_t)i, (uint64_t)e);
        if (sample->in[i].values) x = sample->in[i].values[e];
        if (tensor->dtype == HG_I32)
            ((int32_t *)values)[e] = (int32_t)x;
        else if (tensor->dtype == HG_F32)
            ((float *)values)[e] = (float)x;
        else
            ((double *)values)[e] = (double)(float)x; /* the same number in both float types */
    }
    return hg_tensor_write(tensor, values) == HG_OK ? tensor : NULL;
}

typedef struct {
    const hg_op *op;
    const hg_sample *sample;
    bool empty; /* its output */
} op_under_test;

/* A weighted sum of the output with fixed weights, so that no two elements look alike. */
static hg_tensor *weighted_output(void *self, hg_ctx *ctx, hg_tensor **in)
{
    op_under_test *test = self;
    hg_tensor *y = hg_apply(ctx, test->op, test->sample->n_in, in, test->sample->attributes);
    if (!y) return NULL;
    test->empty = hg_tensor_count(y) == 0;
    double *weights = hg_step_alloc(ctx, (size_t)hg_tensor_count(y) * sizeof *weights);
    if (!weights) return NULL;
    for (int64_t e = 0; e < hg_tensor_count(y); e++) weights[e] = 0.5 + hg_random_uniform(5, 100, (uint64_t)e);
    return hg_sum(ctx, hg_mul(ctx, y, hg_tensor_from(ctx, HG_F64, y->rank, y->shape, weights)));
}

/* A kink is asked for element by element: of inputs that the processor can read. */
static hg_status inputs_on_the_host(const hg_sample *sample, hg_call *call, hg_ctx **host)
{
    HG_TRY(hg_ctx_create(host, &(hg_ctx_options){ .device = "cpu", .threads = 1 }));
    for (int i = 0; i < sample->n_in; i++) {
        call->in[i] = hg_sample_input(*host, sample, i, HG_F64);
        if (!call->in[i]) return HG_MEMORY;
    }
    return HG_OK;
}

hg_status hg_gradcheck_op(hg_ctx *ctx, const hg_op *op, const hg_sample *sample, const hg_gradcheck_options *options,
                          hg_gradcheck_result *result)
{
    hg_gradcheck_result unused;
    op_under_test test = { op, sample, false };
    hg_gradcheck_options given = options ? *options : (hg_gradcheck_options){ 0 };
    given.zero_gradient |= sample->zero_gradient;
    hg_call call = { .ctx = ctx, .op = op, .n_in = sample->n_in };
    check c = { .ctx = ctx,
                .f = weighted_output,
                .self = &test,
                .n_in = sample->n_in,
                .call = &call,
                .empty = &test.empty,
                .result = result ? result : &unused };
    if (op->not_differentiable) return hg_fail(HG_UNSUPPORTED, "gradcheck: %s has no gradient", op->name);
    for (int i = 0; i < sample->n_in; i++) {
        c.in[i] = call.in[i] = hg_sample_input(ctx, sample, i, HG_F64);
        if (!c.in[i]) return hg_ctx_status(ctx);
        if (c.in[i]->dtype == HG_F64 && !sample->in[i].no_grad) HG_TRY(hg_require_grad(c.in[i]));
    }
    if (op->attributes_size) { /* a copy: a shape check may put them into normal form */
        call.attributes = hg_step_alloc(ctx, op->attributes_size);
        if (!call.attributes) return HG_MEMORY;
        memcpy(call.attributes, sample->attributes, op->attributes_size);
    }
    hg_ctx *host = NULL;
    hg_status status = hg_ctx_host(ctx) ? HG_OK : inputs_on_the_host(sample, &call, &host);
    if (status == HG_OK) status = run_check(&c, &given);
    hg_ctx_destroy(host);
    return status == HG_NUMERIC && hg_ctx_status(ctx) == HG_OK
               ? hg_fail(status, "%s (%s): %s", op->name, sample->label,
                         c.result->text[0] ? c.result->text : hg_message())
               : status;
}
