/* What is not finite: which energy, at which frame, strand and vertex; and its inputs as a file that `hairgrad loss` reads.
 * Every term is evaluated by itself, so that one does not hide behind another. */
#include "geometry/body.h"
#include "hairloss/physics_inputs.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* One term of a physics, with the part of the frame that it takes. */
typedef struct {
    hg_ctx *ctx;
    hg_dtype dtype;
    const hg_term *term;
    const hg_groom_data *data;
    hg_physics_asks asks;
    hg_frame frame;
    hg_frame_input input[HG_PHYSICS_VALUES];
    hg_tensor *x;
    int64_t b, s, v; /* what is not finite: frame, strand, vertex */
    bool in_force;   /* the force on that vertex; else the value, and the vertex has the largest force */
    bool heals;      /* without that vertex the value is finite */
    double arrived;  /* the gradient that came to the energy: forces are multiplied by it */
    bool whole;      /* all strands of the frame, and all frames: they belong together */
} suspect;

static hg_status make_suspect(suspect *of, const hg_term *term, const hg_frame *frame)
{
    of->term = term;
    of->frame = *frame;
    of->frame.n_inputs = 0;
    of->frame.inputs = of->input;
    of->asks = (hg_physics_asks){ 0 };
    HG_TRY(hg_physics_asked(&of->asks, term, 1));
    for (int i = 0; i < frame->n_inputs && of->frame.n_inputs < HG_PHYSICS_VALUES; i++)
        if (hg_physics_takes(&of->asks, term, 1, frame->inputs[i].name))
            of->input[of->frame.n_inputs++] = frame->inputs[i];
    return HG_OK;
}

/* A force as the gradient of x gets it. */
static bool overflows(const suspect *of, double force)
{
    const double arrives = force * of->term->weight * of->arrived;
    return of->dtype == HG_F32 ? !isfinite((float)arrives) : !isfinite(arrives);
}

/* Three numbers of a tensor from number `at` on. */
static hg_status set_vertex(hg_tensor *tensor, int64_t at, const double value[3])
{
    const bool wide = tensor->dtype == HG_F64;
    const float narrow[3] = { (float)value[0], (float)value[1], (float)value[2] };
    hg_tensor *vertex = hg_tensor_wrap(tensor->ctx, tensor->dtype, 1, (int64_t[]){ 3 },
                                       (char *)tensor->data + (size_t)at * hg_dtype_size(tensor->dtype));
    return vertex ? hg_tensor_write(vertex, wide ? (const void *)value : narrow) : HG_MEMORY;
}

/* The value of the strand is not finite, its forces are: the first vertex with which, moved to its place at rest or beside its
 * neighbour, the value is finite. */
static hg_status find_vertex(suspect *of, hg_physics *physics, double *energies)
{
    const int64_t S = of->x->shape[1], V = of->x->shape[2], i = of->b * S + of->s;
    const int64_t groom = of->frame.groom ? of->frame.groom[of->b] : 0;
    hg_tensor *moved = hg_tensor_make(of->ctx, of->dtype, 4, of->x->shape);
    if (!moved) return HG_MEMORY;
    for (int64_t v = 0; v < V; v++)
        for (int place = 0; place < 2; place++) {
            HG_TRY(hg_tensor_copy(moved, of->x));
            const int64_t at = (i * V + v) * 3, beside = v > 0 ? at - 3 : V > 1 ? at + 3 : at;
            double to[3];
            for (int c = 0; c < 3; c++)
                to[c] = place == 0 ? of->data->rest[((groom * S + of->s) * V + v) * 3 + c]
                                   : hg_tensor_item(of->x, beside + c) + 1e-3 * (1 - 0.4 * c);
            HG_TRY(set_vertex(moved, at, to));
            HG_TRY(hg_physics_evaluate(physics, of->ctx, &of->frame, moved, NULL, energies, NULL));
            if (!isfinite(energies[i])) continue;
            of->v = v;
            of->heals = true;
            return HG_OK;
        }
    return HG_OK;
}

/* Evaluates the term alone; *found says whether a value or a force is not finite, of->b .. of->v where. */
static hg_status look(suspect *of, bool *found)
{
    const int64_t B = of->x->shape[0], S = of->x->shape[1], V = of->x->shape[2];
    hg_physics *physics = NULL;
    double *energies = hg_alloc((size_t)(B * S) + 1, sizeof *energies),
           *forces = hg_alloc((size_t)(B * S * V * 3) + 1, sizeof *forces);
    hg_tensor *force = hg_tensor_make(of->ctx, of->dtype, 4, of->x->shape);
    hg_status status = energies && forces && force ? HG_OK : HG_MEMORY;
    *found = false;
    if (status == HG_OK) status = hg_physics_create(&physics, of->ctx, of->dtype, of->term, 1, of->data);
    if (status == HG_OK && hg_ctx_host(of->ctx)) status = hg_physics_backend(physics, HG_BACKEND_INTERPRETER);
    if (status == HG_OK) status = hg_physics_evaluate(physics, of->ctx, &of->frame, of->x, NULL, energies, force);
    if (status == HG_OK) status = hg_tensor_numbers(force, forces);
    for (int64_t i = 0; status == HG_OK && i < B * S && !*found; i++) {
        double largest = -1;
        of->in_force = false;
        for (int64_t k = 0; k < V * 3 && !of->in_force; k++) {
            const double f = fabs(forces[i * V * 3 + k]);
            of->in_force = overflows(of, f);
            if (!of->in_force && f <= largest) continue;
            of->v = k / 3;
            largest = f;
        }
        if (isfinite(energies[i]) && !of->in_force) continue;
        of->b = i / S;
        of->s = i % S;
        *found = true;
    }
    if (*found && !of->in_force) status = find_vertex(of, physics, energies);
    hg_physics_destroy(physics);
    hg_free(energies);
    hg_free(forces);
    return status;
}

/* ---- the file ------------------------------------------------------------------------------------------------- */

static bool asks(const suspect *of, hg_input_kind kind) { return (of->asks.kinds & HG_ALLOW(kind)) != 0; }

static int64_t groom_of(const suspect *of) { return of->frame.groom && !of->whole ? of->frame.groom[of->b] : 0; }

/* Groom values [G,S,V,w] as [S,V,w]: of the frame's groom, of the strand alone. */
static hg_status write_groom(const suspect *of, hg_h5 *file, const char *name, const double *values, int64_t width)
{
    const int64_t S = of->data->strands, V = of->data->vertices, strands = of->whole ? S : 1;
    const int64_t shape[4] = { strands, V, width }, grooms[4] = { of->data->grooms, S, V, width };
    const double *from = values + ((groom_of(of) * S + (of->whole ? 0 : of->s)) * V) * width;
    if (of->whole && of->data->grooms > 1) return hg_h5_write(file, name, HG_F64, width > 1 ? 4 : 3, grooms, values);
    return hg_h5_write(file, name, HG_F64, width > 1 ? 3 : 2, shape, from);
}

/* The numbers of a tensor from `first` on, in a shape. */
static hg_status write_part(hg_h5 *file, const char *name, const hg_tensor *tensor, int rank, const int64_t *shape,
                            int64_t first)
{
    char *all = hg_alloc(hg_tensor_bytes(tensor) + 1, 1);
    hg_status status = all ? HG_OK : HG_MEMORY;
    if (status == HG_OK && hg_tensor_count(tensor)) status = hg_tensor_read(tensor, all);
    if (status == HG_OK)
        status =
            hg_h5_write(file, name, tensor->dtype, rank, shape, all + (size_t)first * hg_dtype_size(tensor->dtype));
    hg_free(all);
    return status;
}

/* A tensor [B,S,...] or [B,N,3] as it is, or of one frame, or of one strand of it. */
static hg_status write_rows(const suspect *of, hg_h5 *file, const char *name, const hg_tensor *tensor, bool strands)
{
    if (!tensor) return HG_OK;
    int64_t shape[HG_MAX_RANK], row = 1;
    memcpy(shape, tensor->shape, sizeof shape);
    for (int i = 1; i < tensor->rank; i++) row *= shape[i];
    int64_t first = 0, count = hg_tensor_count(tensor);
    if (!of->whole) {
        const bool one = strands && shape[1] > 0;
        shape[0] = 1;
        count = one ? row / shape[1] : row;
        first = of->b * row + (one ? of->s * count : 0);
        if (one) shape[1] = 1;
    }
    return write_part(file, name, tensor, tensor->rank, shape, first);
}

/* A number of a parameter or the time step, scalar, [S] or [B,S]: what the strand has, or all. */
static hg_status write_number(const suspect *of, hg_h5 *file, const char *name, const hg_tensor *tensor)
{
    if (of->whole && tensor->rank > 0) return write_part(file, name, tensor, tensor->rank, tensor->shape, 0);
    const int64_t at = tensor->rank == 0 ? 0 : tensor->rank == 1 ? of->s : of->b * tensor->shape[1] + of->s;
    const double value = hg_tensor_item(tensor, at);
    return hg_h5_write(file, name, HG_F64, 0, NULL, &value);
}

static hg_tensor *input_named(const suspect *of, const char *name)
{
    for (int i = 0; i < of->frame.n_inputs; i++)
        if (strcmp(of->input[i].name, name) == 0) return of->input[i].value;
    return NULL;
}

/* "stiffness" [], "g" [3]; given per strand where the frame brings it so. */
static hg_status write_params(const suspect *of, hg_h5 *file)
{
    const hg_energy *energy = of->term->energy;
    for (int p = 0; p < HG_ENERGY_PARAMS && energy->params[p].name; p++) {
        char full[160], name[96];
        const char *dot = strrchr(energy->params[p].name, '.');
        snprintf(full, sizeof full, "%s.%s", energy->name, energy->params[p].name);
        snprintf(name, sizeof name, "%.*s", dot ? (int)(dot - energy->params[p].name) : 90, energy->params[p].name);
        hg_tensor *given = input_named(of, full);
        if (dot && p + 2 < HG_ENERGY_PARAMS) {
            const int64_t three = 3;
            HG_TRY(hg_h5_write(file, name, HG_F64, 1, &three, &of->term->params[p]));
            p += 2;
        } else if (given) {
            HG_TRY(write_number(of, file, name, given));
        } else {
            HG_TRY(hg_h5_write(file, name, HG_F64, 0, NULL, &of->term->params[p]));
        }
    }
    return HG_OK;
}

/* rest, mass or an attribute: that of the call where it brings one, else that of the groom. */
static hg_status write_groom_value(const suspect *of, hg_h5 *file, const char *name, const double *own, int64_t width)
{
    const hg_tensor *given = input_named(of, name);
    if (!given && !own) return HG_OK;
    if (!given) return write_groom(of, file, name, own, width);
    const int64_t n = hg_tensor_count(given);
    double *values = hg_alloc((size_t)n + 1, sizeof *values);
    if (!values) return HG_MEMORY;
    hg_status status = hg_tensor_numbers(given, values);
    if (status == HG_OK) status = write_groom(of, file, name, values, width);
    hg_free(values);
    return status;
}

static hg_status write_body(const suspect *of, hg_h5 *file)
{
    if (!of->term->energy->contact || !of->data->body) return HG_OK;
    const int64_t shape[2] = { of->data->body->n_faces, 3 };
    HG_TRY(write_rows(of, file, "body_vertices", of->frame.body_vertices, false));
    return hg_h5_write(file, "body_faces", HG_I32, 2, shape, of->data->body->faces);
}

static hg_status write_roots(const suspect *of, hg_h5 *file)
{
    const bool makes_posed = asks(of, HG_INPUT_POSED) && !of->frame.posed;
    if (asks(of, HG_INPUT_POSED)) HG_TRY(write_rows(of, file, "posed", of->frame.posed, true));
    if (asks(of, HG_INPUT_ROOT_ROTATION) || makes_posed)
        HG_TRY(write_rows(of, file, "root_rotation", of->frame.root_rotation, true));
    if (!asks(of, HG_INPUT_ROOT_POSITION) && !makes_posed) return HG_OK;
    if (of->frame.root_position) return write_rows(of, file, "root_position", of->frame.root_position, true);
    if (of->whole) return HG_OK;
    const int64_t shape[3] = { 1, 1, 3 };
    return hg_h5_write(file, "root_position", HG_F64, 3, shape,
                       of->data->rest + ((groom_of(of) * of->data->strands + of->s) * of->data->vertices) * 3);
}

static hg_status write_arrays(const suspect *of, hg_h5 *file)
{
    const hg_groom_data *data = of->data;
    const hg_site_kind site = of->term->energy->site.kind;
    HG_TRY(write_rows(of, file, "x", of->x, true));
    const bool makes_posed = asks(of, HG_INPUT_POSED) && !of->frame.posed;
    if (asks(of, HG_INPUT_REST) || asks(of, HG_INPUT_ROOT_REST) || makes_posed)
        HG_TRY(write_groom_value(of, file, "rest", data->rest, 3));
    if (asks(of, HG_INPUT_MASS)) HG_TRY(write_groom_value(of, file, "mass", data->mass, 1));
    for (int i = 0; i < of->asks.n_attributes; i++) {
        const char *name = of->asks.attributes[i].name;
        HG_TRY(write_groom_value(of, file, name, hg_groom_attribute_find(data, name), 1));
    }
    if (of->whole && of->frame.groom && data->grooms > 1)
        HG_TRY(hg_h5_write(file, "groom", HG_I32, 1, of->x->shape, of->frame.groom));
    HG_TRY(write_roots(of, file));
    if (asks(of, HG_INPUT_PREDICTED)) HG_TRY(write_rows(of, file, "predicted", of->frame.predicted, true));
    if (asks(of, HG_INPUT_PREVIOUS)) HG_TRY(write_rows(of, file, "previous", of->frame.previous, true));
    if (asks(of, HG_INPUT_Q)) HG_TRY(write_rows(of, file, "q", input_named(of, "q"), true));
    for (int i = 0; i < of->asks.n_frames; i++)
        HG_TRY(write_rows(of, file, of->asks.frames[i].name, input_named(of, of->asks.frames[i].name), true));
    if (asks(of, HG_INPUT_DT)) {
        const hg_tensor *dt = input_named(of, "dt");
        HG_TRY(dt && dt->rank == 0 ? write_number(of, file, "dt", dt)
                                   : hg_h5_write(file, "dt", HG_F64, 0, NULL, &of->frame.dt));
    }
    if (site == HG_SITE_PAIRS && data->adhesion && data->grooms == 1) {
        const int64_t shape[2] = { data->adhesion[0]->n_pairs, 2 };
        HG_TRY(hg_h5_write(file, "neighbours", HG_I32, 2, shape, data->adhesion[0]->pairs));
    }
    HG_TRY(write_body(of, file));
    return write_params(of, file);
}

/* The command that evaluates the file. */
static void add_command(const suspect *of, const char *path, hg_text *text)
{
    const hg_energy *energy = of->term->energy;
    hg_text_add(text, "hairgrad loss %s %s -o out.h5 --dtype %s", energy->name, path, hg_dtype_name(of->dtype));
    for (int o = 0; o < HG_ENERGY_OPTIONS && energy->options[o].name; o++)
        hg_text_add(text, " --set %s=%s", energy->options[o].name, of->term->options[o]);
}

static hg_status write_suspect(const suspect *of, const char *path)
{
    hg_h5 *file;
    hg_text command = { 0 };
    HG_TRY(hg_h5_create(&file, path));
    hg_status status = write_arrays(of, file);
    add_command(of, path, &command);
    if (status == HG_OK) status = command.failed ? HG_MEMORY : hg_h5_set_text(file, "/", "command", command.data);
    hg_text_free(&command);
    if (status == HG_OK) return hg_h5_commit(file);
    hg_h5_close(file);
    return status;
}

/* ---- the message ---------------------------------------------------------------------------------------------- */

static void describe(const suspect *of, const char *path, hg_text *text)
{
    hg_text_add(text, "; energy '%s' of frame %lld, strand %lld", of->term->energy->name, (long long)of->b,
                (long long)of->s);
    const double factor = of->term->weight * of->arrived;
    if (of->in_force)
        hg_text_add(text, ": the force on vertex %lld", (long long)of->v);
    else
        hg_text_add(text,
                    of->heals ? ": its value, by vertex %lld" : ": its value; the largest force is on vertex %lld",
                    (long long)of->v);
    if (of->in_force && factor != 1)
        hg_text_add(text, ", times %.3g, the energy's weight and the gradient that came to it", factor);
    if (!path) return;
    if (write_suspect(of, path) != HG_OK) {
        hg_text_add(text, "; its inputs could not be written: %s", hg_message());
        return;
    }
    hg_text_add(text, "; its inputs are in %s: ", path);
    add_command(of, path, text);
    hg_text_add(text, " evaluates them");
}

hg_status hg_physics_explain(hg_ctx *ctx, hg_dtype dtype, const hg_term *terms, int n, const hg_groom_data *data,
                             const hg_frame *frame, hg_tensor *x, double arrived, const char *path, hg_text *text)
{
    const char *trap_path;
    const bool trap = hg_trap_is_on(ctx, &trap_path); /* what is not finite is what is looked for */
    hg_trap_nan(ctx, false, NULL);
    hg_status status = HG_OK;
    bool found = false;
    for (int t = 0; t < n && status == HG_OK && !found; t++) {
        suspect of = { .ctx = ctx, .dtype = dtype, .data = data, .x = x, .arrived = arrived };
        status = make_suspect(&of, &terms[t], frame);
        if (status == HG_OK) status = look(&of, &found);
        of.whole = terms[t].energy->site.kind != HG_SITE_WINDOW;
        for (int i = 0; i < of.asks.n_frames; i++) /* a sequence of frames belongs together */
            of.whole |= strcmp(of.asks.frames[i].name, "deformation_mean") == 0;
        if (found) describe(&of, path, text);
        hg_physics_asks_free(&of.asks);
    }
    if (status == HG_OK && !found) hg_text_add(text, "; every energy is finite there, and so is its force");
    hg_trap_nan(ctx, trap, trap_path);
    return status;
}
