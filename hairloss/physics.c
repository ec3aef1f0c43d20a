/* Physics: a weighted set of energies over one or more grooms. Window energies are one strand pass, contact is found
 * before it, pairs and fields have passes of their own after it. On the tape it is one op: value and gradient are made
 * together, and backward only scales what was made. */
#include "hairloss/physics_contact.h"
#include "hairloss/physics_inputs.h"
#include "hairloss/physics_kernels.h"

#include "autograd/tape.h"
#include "geometry/vector.h"

#include <math.h>
#include <string.h>

typedef struct {
    const hg_physics_pass *kind;
    void *self;
    int term;
} other_pass;

/* Strand passes for what calls have brought and wanted: [0] nothing; the others are made when first met, and the one that
 * was not used for longest makes room. */
enum { VARIANTS = 8 };
typedef struct {
    hg_strand_variant variant;
    hg_strand_pass *pass;
    int64_t used;
} strand_variant;

struct hg_physics {
    hg_ctx *ctx;
    hg_dtype dtype;
    int n;
    hg_term *terms; /* completed: their params and options are the arrays below */
    double (*params)[HG_ENERGY_PARAMS];
    const char *(*options)[HG_ENERGY_OPTIONS];
    hg_groom_data data; /* own copies */
    hg_groom_attribute *attributes;

    hg_physics_asks asks;
    strand_variant strands[VARIANTS];
    int64_t calls;
    int last;              /* strand pass of the last call */
    hg_term *window_terms; /* by name, so that the order in a config does not matter */
    int32_t *window_column;
    char *window_names; /* "stretch + bend_twist", for a profile */
    int n_window;
    hg_backend backend;

    other_pass *others;
    int n_others;
    bool strands_alone; /* the others are left out */

    int contact; /* term that asks for it, -1: none */
    hg_physics_contact body;
    hg_tensor *weights;    /* [n] f64 */
    hg_tensor *unweighted; /* [n] f64 of the last call, of its step */
    double *sums;          /* [n] the same, read back where the host asks for it */
    hg_physics *twin;      /* on the processor, for HAIRGRAD_VALIDATE; made when it is first asked for */
};

int hg_physics_terms(const hg_physics *physics) { return physics->n; }

const hg_term *hg_physics_term(const hg_physics *physics, int i)
{
    return i >= 0 && i < physics->n ? &physics->terms[i] : NULL;
}

/* ---- creation ----------------------------------------------------------------------------------------------- */

static double *copy_checked(const double *from, size_t n, const char *what, bool not_negative, hg_status *status)
{
    double *to = *status == HG_OK ? hg_alloc(n + 1, sizeof *to) : NULL;
    if (*status == HG_OK && !to) *status = HG_MEMORY;
    for (size_t i = 0; to && i < n; i++) {
        to[i] = from[i];
        if (!isfinite(from[i]) || (not_negative && from[i] < 0)) {
            *status = hg_fail(HG_NUMERIC, "the %s of the groom is %g at number %zu: it has to be finite%s", what,
                              from[i], i, not_negative ? " and not negative" : "");
            break;
        }
    }
    return to;
}

static hg_status copy_data(hg_physics *p, const hg_groom_data *data)
{
    const size_t vertices = (size_t)(data->grooms * data->strands * data->vertices);
    hg_status status = HG_OK;
    p->data = *data;
    p->data.attributes = NULL;
    p->data.mass = NULL;
    p->data.rest = copy_checked(data->rest, 3 * vertices, "rest position", false, &status);
    if (data->mass) {
        p->data.mass = copy_checked(data->mass, vertices, "mass", true, &status);
    } else {
        double *ones = hg_alloc(vertices + 1, sizeof *ones);
        if (!ones) status = HG_MEMORY;
        for (size_t i = 0; ones && i < vertices; i++) ones[i] = 1;
        p->data.mass = ones;
    }
    p->attributes = hg_alloc((size_t)data->n_attributes + 1, sizeof *p->attributes);
    if (!p->attributes) status = HG_MEMORY;
    p->data.attributes = p->attributes;
    p->data.n_attributes = 0;
    for (int i = 0; status == HG_OK && i < data->n_attributes; i++) {
        const hg_groom_attribute *from = &data->attributes[i];
        p->attributes[i].name = hg_strdup(from->name);
        p->attributes[i].values = copy_checked(from->values, vertices, from->name, false, &status);
        p->data.n_attributes++;
        if (!p->attributes[i].name) status = HG_MEMORY;
    }
    return status;
}

/* The attribute "strand_length" where an energy asks for it and the groom does not have it: the sum of the rest edges. */
static hg_status make_strand_length(hg_physics *p)
{
    const int64_t V = p->data.vertices, strands = p->data.grooms * p->data.strands;
    bool asked = false;
    for (int i = 0; i < p->asks.n_attributes; i++) asked |= strcmp(p->asks.attributes[i].name, "strand_length") == 0;
    if (!asked || hg_groom_attribute_find(&p->data, "strand_length")) return HG_OK;
    double *values = hg_alloc((size_t)(strands * V) + 1, sizeof *values);
    hg_groom_attribute *made = &p->attributes[p->data.n_attributes]; /* copy_data left room for one */
    made->values = values;
    made->name = hg_strdup("strand_length");
    p->data.n_attributes++;
    if (!values || !made->name) return HG_MEMORY;
    for (int64_t i = 0; i < strands; i++) {
        const double *rest = p->data.rest + 3 * i * V;
        double length = 0;
        for (int64_t v = 1; v < V; v++)
            length += hg_vec3d_distance(hg_vec3d_load(rest + 3 * v), hg_vec3d_load(rest + 3 * v - 3));
        for (int64_t v = 0; v < V; v++) values[i * V + v] = length;
    }
    return HG_OK;
}

static hg_status copy_terms(hg_physics *p, const hg_term *terms)
{
    p->terms = hg_alloc((size_t)p->n + 1, sizeof *p->terms);
    p->params = hg_alloc((size_t)p->n + 1, sizeof *p->params);
    p->options = hg_alloc((size_t)p->n + 1, sizeof *p->options);
    p->window_terms = hg_alloc((size_t)p->n + 1, sizeof *p->window_terms);
    p->window_column = hg_alloc((size_t)p->n + 1, sizeof *p->window_column);
    p->others = hg_alloc((size_t)p->n + 1, sizeof *p->others);
    p->sums = hg_alloc((size_t)p->n + 1, sizeof *p->sums);
    if (!p->terms || !p->params || !p->options || !p->window_terms || !p->window_column || !p->others || !p->sums)
        return HG_MEMORY;
    for (int t = 0; t < p->n; t++) {
        HG_TRY(hg_term_complete(&terms[t], p->params[t], p->options[t]));
        p->terms[t] = (hg_term){ terms[t].energy, terms[t].weight, p->params[t], p->options[t] };
    }
    for (int t = 0; t < p->n; t++) {
        const hg_term *term = &p->terms[t];
        if (term->energy->contact) {
            const char *mode = hg_term_option(term, "mode");
            const hg_contact_mode wanted = mode && strcmp(mode, "exact") == 0 ? HG_CONTACT_EXACT : HG_CONTACT_PLANE;
            if (p->contact >= 0 && p->body.mode != wanted)
                return hg_fail(HG_UNSUPPORTED,
                               "energies '%s' and '%s' ask for different contact modes; one query serves both",
                               p->terms[p->contact].energy->name, term->energy->name);
            if (p->contact < 0) p->contact = t;
            p->body.mode = wanted;
        }
        if (term->energy->site.kind != HG_SITE_WINDOW) continue;
        if (term->energy->site.count < 1 || !term->energy->trace)
            return hg_fail(HG_INVALID, "energy '%s' declares no formula or an empty window", term->energy->name);
        int at = p->n_window++;
        for (; at > 0 && strcmp(p->window_terms[at - 1].energy->name, term->energy->name) > 0; at--) {
            p->window_terms[at] = p->window_terms[at - 1];
            p->window_column[at] = p->window_column[at - 1];
        }
        p->window_terms[at] = *term;
        p->window_column[at] = t;
    }
    hg_text names = { 0 };
    for (int i = 0; i < p->n_window; i++) hg_text_add(&names, i ? " + %s" : "%s", p->window_terms[i].energy->name);
    p->window_names = names.data;
    return names.failed ? HG_MEMORY : HG_OK;
}

static hg_status make_others(hg_physics *p)
{
    for (int t = 0; t < p->n; t++) {
        const hg_site_kind site = p->terms[t].energy->site.kind;
        if (site == HG_SITE_WINDOW) continue;
        other_pass *other = &p->others[p->n_others];
        other->kind = hg_find("physics_pass", site == HG_SITE_PAIRS ? "pairs" : "field");
        other->term = t;
        if (!other->kind)
            return hg_fail(HG_UNSUPPORTED, "energy '%s' needs the %s pass, which this build does not have",
                           p->terms[t].energy->name, site == HG_SITE_PAIRS ? "pairs" : "field");
        const hg_pass_setup setup = { p->ctx, p->dtype, p->terms[t], &p->data, t };
        HG_TRY(other->kind->create(&other->self, &setup));
        p->n_others++;
    }
    return HG_OK;
}

static hg_status make_weights(hg_physics *p)
{
    p->weights = hg_tensor_create(p->ctx, HG_F64, 1, (int64_t[]){ p->n });
    if (!p->weights) return HG_MEMORY;
    for (int t = 0; t < p->n; t++) p->sums[t] = p->terms[t].weight;
    return hg_tensor_write(p->weights, p->sums);
}

hg_status hg_physics_create(hg_physics **physics, hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n,
                            const hg_groom_data *data)
{
    *physics = NULL;
    if (dtype != HG_F32 && dtype != HG_F64)
        return hg_fail(HG_INVALID, "physics is f32 or f64, not %s", hg_dtype_name(dtype));
    if (n < 1) return hg_fail(HG_INVALID, "physics needs at least one energy");
    if (data->grooms < 1 || data->strands < 0 || data->vertices < 1)
        return hg_fail(HG_INVALID, "a groom [%lld,%lld,%lld]: at least one groom and one vertex per strand are needed",
                       (long long)data->grooms, (long long)data->strands, (long long)data->vertices);
    if (data->strands * data->grooms > 0 && !data->rest) return hg_fail(HG_INVALID, "the groom has no rest positions");
    hg_physics *p = hg_alloc(1, sizeof *p);
    if (!p) return HG_MEMORY;
    p->ctx = ctx;
    p->dtype = dtype;
    p->n = n;
    p->contact = -1;
    p->backend = HG_BACKEND_AUTO;
    hg_status status = copy_terms(p, terms);
    if (status == HG_OK) status = hg_physics_asked(&p->asks, p->terms, n);
    if (status == HG_OK) status = copy_data(p, data);
    if (status == HG_OK) status = make_strand_length(p);
    if (status == HG_OK && p->contact >= 0 && !data->body)
        status = hg_fail(HG_INVALID, "energy '%s' needs a body, and the groom data has none",
                         p->terms[p->contact].energy->name);
    if (status == HG_OK && p->n_window)
        status = hg_strand_pass_create(&p->strands[0].pass, ctx, dtype, p->n_window, p->window_terms, p->window_column,
                                       &p->data, NULL, true);
    if (status == HG_OK) status = make_others(p);
    if (status == HG_OK) status = make_weights(p);
    if (status != HG_OK) {
        hg_physics_destroy(p);
        return status;
    }
    *physics = p;
    return HG_OK;
}

void hg_physics_destroy(hg_physics *physics)
{
    if (!physics) return;
    hg_physics_destroy(physics->twin);
    for (int i = 0; i < VARIANTS; i++) hg_strand_pass_destroy(physics->strands[i].pass);
    hg_physics_asks_free(&physics->asks);
    for (int i = 0; i < physics->n_others; i++) physics->others[i].kind->destroy(physics->others[i].self);
    hg_physics_contact_free(&physics->body);
    for (int i = 0; i < physics->data.n_attributes; i++) {
        hg_free((void *)physics->attributes[i].name);
        hg_free((void *)physics->attributes[i].values);
    }
    hg_free(physics->attributes);
    hg_free((void *)physics->data.rest);
    hg_free((void *)physics->data.mass);
    hg_tensor_destroy(physics->weights);
    hg_free(physics->terms);
    hg_free(physics->params);
    hg_free(physics->options);
    hg_free(physics->window_terms);
    hg_free(physics->window_column);
    hg_free(physics->window_names);
    hg_free(physics->others);
    hg_free(physics->sums);
    hg_free(physics);
}

hg_status hg_physics_backend(hg_physics *physics, hg_backend backend)
{
    for (int i = 0; i < VARIANTS; i++)
        if (physics->strands[i].pass)
            HG_TRY(hg_strand_pass_backend(physics->strands[i].pass, physics->ctx, backend, NULL));
    physics->backend = backend;
    return HG_OK;
}

const char *hg_physics_backend_name(const hg_physics *physics)
{
    const hg_strand_pass *pass = physics->strands[physics->last].pass;
    return pass ? hg_strand_pass_backend_name(pass) : "interpreter";
}

const char *hg_physics_backend_note(const hg_physics *physics)
{
    const hg_strand_pass *pass = physics->strands[physics->last].pass;
    return pass ? hg_strand_pass_backend_note(pass) : "";
}

/* ---- a frame ------------------------------------------------------------------------------------------------ */

static hg_status check(const hg_physics *p, const hg_tensor *tensor, const char *name, int rank, const int64_t *shape)
{
    char text[96];
    if (!tensor) return HG_OK;
    bool fits = tensor->rank == rank && tensor->dtype == p->dtype;
    for (int i = 0; i < rank && fits; i++) fits = shape[i] < 0 || tensor->shape[i] == shape[i];
    if (fits) return HG_OK;
    hg_text expected = { 0 };
    for (int i = 0; i < rank; i++) {
        if (shape[i] < 0)
            hg_text_add(&expected, i ? ",N" : "N");
        else
            hg_text_add(&expected, i ? ",%lld" : "%lld", (long long)shape[i]);
    }
    hg_status status = hg_fail(HG_INVALID, "physics: %s is %s, expected %s [%s]", name, hg_shape_text(tensor, text),
                               hg_dtype_name(p->dtype), expected.data ? expected.data : "");
    hg_text_free(&expected);
    return status;
}

static hg_status check_frame(const hg_physics *p, const hg_frame *frame, const hg_tensor *x)
{
    const int64_t B = x->rank == 4 ? x->shape[0] : 1, S = p->data.strands, V = p->data.vertices;
    const int64_t vertices[4] = { B, S, V, 3 }, rotation[3] = { B, S, 4 }, position[3] = { B, S, 3 },
                  body[3] = { B, p->data.body ? hg_body_tree_vertices(p->data.body) : -1, 3 };
    HG_TRY(check(p, x, "x", 4, vertices));
    HG_TRY(check(p, frame->root_rotation, "root_rotation", 3, rotation));
    HG_TRY(check(p, frame->root_position, "root_position", 3, position));
    HG_TRY(check(p, frame->posed, "posed", 4, vertices));
    HG_TRY(check(p, frame->predicted, "predicted", 4, vertices));
    HG_TRY(check(p, frame->previous, "previous", 4, vertices));
    HG_TRY(check(p, frame->body_vertices, "body_vertices", 3, body));
    for (int64_t b = 0; frame->groom && b < B; b++)
        if (frame->groom[b] < 0 || frame->groom[b] >= p->data.grooms)
            return hg_fail(HG_INVALID, "physics: frame %lld uses groom %d, but there are %lld", (long long)b,
                           (int)frame->groom[b], (long long)p->data.grooms);
    return HG_OK;
}

/* Contact matters up to 2 D: of the terms, or of what this call gives in their place (the largest of it). What is given in the
 * memory of a device is not waited for: then the search has no bound. */
static double contact_reach(const hg_physics *p, const hg_physics_values *values)
{
    double reach = 0;
    for (int t = 0; t < p->n; t++) {
        if (!p->terms[t].energy->contact) continue;
        double distance = hg_term_param(&p->terms[t], "distance");
        if (!isfinite(distance)) return (double)INFINITY;
        for (int i = 0; i < values->n; i++) {
            const hg_pass_value *value = &values->value[i];
            if (value->kind != HG_INPUT_PARAM || value->term != t ||
                strcmp(p->terms[t].energy->params[value->param].name, "distance") != 0)
                continue;
            if (!hg_ctx_host(p->ctx)) return (double)INFINITY;
            distance = 0;
            for (int64_t k = 0; k < values->count[i]; k++)
                distance = fmax(distance, p->dtype == HG_F64 ? ((const double *)value->values)[k]
                                                             : (double)((const float *)value->values)[k]);
        }
        reach = fmax(reach, 2 * distance);
    }
    return reach;
}

static hg_status find_contact(hg_physics *p, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, double reach,
                              void **point, void **normal)
{
    *point = *normal = NULL;
    if (p->contact < 0) return HG_OK;
    if (!frame->body_vertices)
        return hg_fail(HG_INVALID, "energy '%s' needs frame.body_vertices, which was not given",
                       p->terms[p->contact].energy->name);
    return hg_physics_contact_find(&p->body, ctx, p->dtype, p->data.body, frame->body_vertices, x, reach, point,
                                   normal);
}

void hg_physics_hold_body(hg_physics *physics, bool held)
{
    physics->body.held = held;
    physics->body.known = false;
}

/* The strand pass for what a call brings and wants. */
static hg_status find_strands(hg_physics *p, const hg_physics_resolver *resolver, hg_strand_pass **pass)
{
    hg_strand_variant wanted;
    hg_physics_variant(resolver, p->window_column, p->n_window, &wanted);
    int oldest = 1;
    p->calls++;
    for (int i = 0; i < VARIANTS; i++) {
        strand_variant *made = &p->strands[i];
        if (made->pass && hg_physics_same_variant(&made->variant, &wanted)) {
            made->used = p->calls;
            p->last = i;
            *pass = made->pass;
            return HG_OK;
        }
        if (i > 0 && made->used < p->strands[oldest].used) oldest = i;
    }
    strand_variant *room = &p->strands[oldest];
    hg_strand_pass_destroy(room->pass);
    *room = (strand_variant){ .variant = wanted, .used = p->calls };
    HG_TRY(hg_strand_pass_create(&room->pass, p->ctx, p->dtype, p->n_window, p->window_terms, p->window_column,
                                 &p->data, &room->variant, true));
    p->last = oldest;
    *pass = room->pass;
    if (p->backend == HG_BACKEND_AUTO) return HG_OK;
    return hg_strand_pass_backend(room->pass, p->ctx, p->backend, NULL);
}

/* The groom of each frame in the device's memory; NULL where all are 0. */
static hg_status put_grooms(const hg_physics *p, hg_ctx *ctx, const hg_frame *frame, int64_t frames,
                            const int32_t **groom)
{
    *groom = frame->groom;
    if (hg_ctx_host(ctx) || !frame->groom || frames == 0) return HG_OK;
    *groom = NULL;
    if (p->data.grooms == 1) return HG_OK;
    const hg_tensor *there = hg_tensor_from(ctx, HG_I32, 1, &frames, frame->groom);
    if (!there) return HG_MEMORY;
    *groom = there->data;
    return HG_OK;
}

/* p->unweighted is made and set; per_strand [B,S,n] of the device and gradient are set where not NULL; values gets what the
 * frame brings, with the gradients of tensors that need one where they are wanted. */
static hg_status run(hg_physics *p, hg_ctx *ctx, const hg_frame *frame, const hg_tensor *x, bool gradients,
                     hg_physics_values *values, double *per_strand, void *gradient)
{
    HG_TRY(check_frame(p, frame, x));
    hg_physics_resolver resolver = { ctx,      p->dtype, &p->data,    p->terms,  p->n,
                                     &p->asks, frame,    x->shape[0], gradients, values };
    HG_TRY(hg_physics_resolve(&resolver));
    p->unweighted = hg_tensor_make(ctx, HG_F64, 1, (int64_t[]){ p->n });
    if (!p->unweighted) return HG_MEMORY;
    double *sums = p->unweighted->data;
    hg_pass_call call = { .frame = frame,
                          .x = x,
                          .n_values = values->n,
                          .values = values->value,
                          .gradient = gradient,
                          .unweighted = sums,
                          .per_strand = per_strand,
                          .stride = p->n };
    HG_TRY(put_grooms(p, ctx, frame, x->shape[0], &call.groom));
    void *point, *normal;
    HG_TRY(find_contact(p, ctx, frame, x, contact_reach(p, values), &point, &normal));
    if (p->n_window) {
        hg_strand_pass *strands;
        HG_TRY(find_strands(p, &resolver, &strands));
        hg_profile_begin(ctx, "energies", p->window_names);
        HG_TRY(hg_strand_pass_run(strands, &call, point, normal));
        hg_profile_end(ctx, (int64_t)hg_tensor_bytes(x) *
                                (1 + (frame->predicted != NULL) + 2 * (point != NULL) + (gradient != NULL)));
    } else if (gradient) {
        HG_TRY(hg_physics_zero(ctx, p->dtype, hg_tensor_count(x), gradient));
    }
    for (int i = 0; i < p->n_others && !p->strands_alone; i++) {
        const int t = p->others[i].term;
        hg_profile_begin(ctx, "energies", p->terms[t].energy->name);
        call.unweighted = sums + t;
        call.per_strand = per_strand ? per_strand + t : NULL;
        HG_TRY(p->others[i].kind->run(p->others[i].self, ctx, &call));
        hg_profile_end(ctx, (int64_t)hg_tensor_bytes(x) * (1 + 2 * (gradient != NULL)));
    }
    return hg_physics_chain(&resolver);
}

/* Outside of the tape, too, a trap that is set stops at what is not finite. */
static hg_status check_trap(const hg_physics *p, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x)
{
    const char *path;
    bool finite = true;
    if (!hg_trap_is_on(ctx, &path)) return HG_OK;
    HG_TRY(hg_tensor_read(p->unweighted, p->sums));
    for (int t = 0; t < p->n; t++) finite = finite && isfinite(p->sums[t]);
    if (finite) return HG_OK;
    hg_text text = { 0 };
    hg_text_add(&text, "physics: an energy is not finite");
    hg_status status = hg_physics_explain(ctx, p->dtype, p->terms, p->n, &p->data, frame, x, 1, path, &text);
    if (status == HG_OK) status = hg_ctx_fail(ctx, HG_NUMERIC, "%s", text.failed ? "out of memory" : text.data);
    hg_text_free(&text);
    return status;
}

hg_status hg_physics_evaluate(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, double *unweighted,
                              double *per_strand, hg_tensor *gradient)
{
    if (!x) return hg_fail(HG_INVALID, "physics: x is NULL");
    hg_physics_values values;
    HG_TRY(check(physics, gradient, "gradient", x->rank, x->shape));
    hg_tensor *strands = NULL; /* per_strand is of the host */
    if (per_strand && !hg_ctx_host(ctx)) {
        strands = hg_tensor_make(ctx, HG_F64, 3, (int64_t[]){ x->shape[0], x->shape[1], physics->n });
        if (!strands) return HG_MEMORY;
    }
    HG_TRY(run(physics, ctx, frame, x, false, &values, strands ? strands->data : per_strand,
               gradient ? gradient->data : NULL));
    if (gradient) hg_tensor_touch(gradient);
    if (unweighted) HG_TRY(hg_tensor_read(physics->unweighted, unweighted));
    if (strands && hg_tensor_count(strands)) HG_TRY(hg_tensor_read(strands, per_strand));
    return check_trap(physics, ctx, frame, x);
}

hg_status hg_physics_evaluate_alone(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x,
                                    hg_tensor *gradient)
{
    physics->strands_alone = true;
    const hg_status status = hg_physics_evaluate(physics, ctx, frame, x, NULL, NULL, gradient);
    physics->strands_alone = false;
    return status;
}

hg_status hg_physics_evaluate_with(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x, bool alone,
                                   double *per_strand, hg_tensor *gradient, const hg_tensor *input,
                                   hg_tensor *input_gradient)
{
    if (!x) return hg_fail(HG_INVALID, "physics: x is NULL");
    if (!hg_ctx_host(ctx) || !hg_needs_grad(input))
        return hg_fail(HG_INVALID, "physics: an input's gradient is asked for %s",
                       hg_ctx_host(ctx) ? "that needs none" : "on a device: this is the processor's");
    hg_physics_values values;
    HG_TRY(check(physics, gradient, "gradient", x->rank, x->shape));
    HG_TRY(check(physics, input_gradient, "the input's gradient", input->rank, input->shape));
    physics->strands_alone = alone;
    hg_status status = run(physics, ctx, frame, x, true, &values, per_strand, gradient->data);
    physics->strands_alone = false;
    HG_TRY(status);
    hg_tensor_touch(gradient);
    const void *made = hg_physics_gradient(ctx, &values, input);
    if (!made) return HG_MEMORY;
    HG_TRY(hg_tensor_write(input_gradient, made));
    return check_trap(physics, ctx, frame, x);
}

hg_tensor *hg_physics_unweighted(const hg_physics *physics) { return physics->unweighted; }

/* ---- on the tape -------------------------------------------------------------------------------------------- */

typedef struct {
    hg_physics *physics;
    hg_frame frame;
    double *unweighted;
    void *gradient[HG_OP_INPUTS]; /* of the inputs, made by forward */
} physics_call;

static hg_tensor *physics_shape(hg_call *call)
{
    const physics_call *attributes = call->attributes;
    return hg_tensor_make(call->ctx, attributes->physics->dtype, 0, NULL);
}

/* The inputs are the caller's, as long as its call; a trap or a validation may want them later. */
static hg_status keep_inputs(hg_ctx *ctx, hg_frame *frame)
{
    const int n = hg_trap_is_on(ctx, NULL) || hg_validate_wanted(ctx) ? frame->n_inputs : 0;
    hg_frame_input *kept = n ? hg_step_alloc(ctx, (size_t)n * sizeof *kept) : NULL;
    for (int i = 0; i < n; i++) {
        const size_t size = strlen(frame->inputs[i].name) + 1;
        char *name = kept ? hg_step_alloc(ctx, size) : NULL;
        if (!name) return HG_MEMORY;
        memcpy(name, frame->inputs[i].name, size);
        kept[i] = (hg_frame_input){ name, frame->inputs[i].value };
    }
    frame->inputs = kept;
    frame->n_inputs = n;
    return HG_OK;
}

static hg_status physics_explain(const hg_call *call, bool backward, const char *path, hg_text *text)
{
    const physics_call *attributes = call->attributes;
    const hg_physics *p = attributes->physics;
    const double arrived = backward ? hg_tensor_item(hg_grad(call->out), 0) : 1;
    if (!isfinite(arrived)) {
        hg_text_add(text, "; the gradient that came to it is %g", arrived);
        return HG_OK;
    }
    return hg_physics_explain(call->ctx, p->dtype, p->terms, p->n, &p->data, &attributes->frame, call->in[0], arrived,
                              path, text);
}

static hg_status physics_forward(hg_call *call)
{
    physics_call *attributes = call->attributes;
    hg_physics *p = attributes->physics;
    hg_tensor *x = call->in[0];
    const bool recorded = hg_call_recorded(call);
    hg_physics_values values;
    if (recorded && hg_needs_grad(x) && !(attributes->gradient[0] = hg_step_device(call->ctx, hg_tensor_bytes(x) + 1)))
        return HG_MEMORY;
    HG_TRY(run(p, call->ctx, &attributes->frame, x, recorded, &values, NULL, attributes->gradient[0]));
    for (int i = 1; i < call->n_in && recorded; i++)
        if (!(attributes->gradient[i] = hg_physics_gradient(call->ctx, &values, call->in[i]))) return HG_MEMORY;
    HG_TRY(keep_inputs(call->ctx, &attributes->frame));
    HG_TRY(hg_physics_weigh(call->ctx, p->n, p->unweighted->data, p->weights->data, call->out));
    return attributes->unweighted ? hg_tensor_read(p->unweighted, attributes->unweighted) : HG_OK;
}

static hg_status physics_backward(hg_call *call)
{
    const physics_call *attributes = call->attributes;
    for (int i = 0; i < call->n_in; i++)
        if (hg_needs_grad(call->in[i])) {
            bool fresh;
            void *to = hg_grad_data(call->in[i], &fresh);
            HG_TRY(hg_physics_add_scaled(call->ctx, call->in[i]->dtype, hg_tensor_count(call->in[i]),
                                         attributes->gradient[i], hg_grad(call->out)->data, to, fresh));
        }
    return HG_OK;
}

static hg_tensor *physics_twin(const hg_call *call, hg_ctx *host, hg_tensor *const *in)
{
    const physics_call *attributes = call->attributes;
    hg_physics *p = attributes->physics;
    if (!p->twin && hg_physics_create(&p->twin, host, p->dtype, p->terms, p->n, &p->data) != HG_OK) {
        hg_ctx_fail(host, HG_INVALID, "%s", hg_message());
        return NULL;
    }
    return hg_physics_twin(p->twin, &attributes->frame, call, host, in);
}

static const hg_op physics_op = { .name = "physics",
                                  .formula = "sum of weight * energy",
                                  .min_in = 1,
                                  .max_in = HG_OP_INPUTS,
                                  .attributes_size = sizeof(physics_call),
                                  .shape = physics_shape,
                                  .forward = physics_forward,
                                  .backward = physics_backward,
                                  .explain = physics_explain,
                                  .twin = physics_twin };

/* The inputs of the op are x and every other tensor that needs a gradient, each once. */
hg_tensor *(hg_physics_energy)(hg_physics *physics, hg_ctx *ctx, const hg_frame *frame, hg_tensor *x,
                               double *unweighted)
{
    const physics_call attributes = { .physics = physics, .frame = *frame, .unweighted = unweighted };
    hg_tensor *const members[] = { frame->root_rotation, frame->root_position, frame->posed,
                                   frame->predicted,     frame->previous,      frame->body_vertices /* refused */ };
    const int n_members = (int)(sizeof members / sizeof *members);
    hg_tensor *in[HG_OP_INPUTS] = { x };
    int n = 1;
    for (int i = 0; i < n_members + frame->n_inputs; i++) {
        hg_tensor *tensor = i < n_members ? members[i] : frame->inputs[i - n_members].value;
        bool there = !hg_needs_grad(tensor);
        for (int k = 1; k < n && !there; k++) there = in[k] == tensor;
        if (there) continue;
        if (n == HG_OP_INPUTS) {
            hg_ctx_fail(ctx, HG_UNSUPPORTED, "physics: more than %d tensors need a gradient in one call", n);
            return NULL;
        }
        in[n++] = tensor;
    }
    return (hg_apply)(ctx, &physics_op, n, in, &attributes);
}
