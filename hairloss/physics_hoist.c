/* Rest values of sites and strands, and rest data that is carried from site to site. */
#include "hairloss/physics_hoist.h"

#include "hairloss/physics.h"

enum { CHUNK = HG_LANES_F64, VALUES = 64 };

typedef struct {
    const hg_strand_program *program;
    const hg_groom_data *data;
    hg_hoist_layout layout;
    int lanes;
    int64_t tiles;
    double *rest_carry; /* [G,S,V,n_rest_carry] */
} hoist;

static double groom_value(const hoist *h, hg_input in, int64_t groom, int64_t strand, int64_t vertex)
{
    const hg_groom_data *data = h->data;
    const int64_t V = data->vertices;
    int64_t v = in.kind == HG_INPUT_ROOT_REST ? in.offset : vertex + in.offset;
    if (v < 0) v = 0; /* windows that begin before the root are stored but never used */
    if (v > V - 1) v = V - 1;
    const int64_t at = (groom * data->strands + strand) * V + v;
    switch (in.kind) {
    case HG_INPUT_REST:
    case HG_INPUT_ROOT_REST:
        return data->rest[3 * at + in.component];
    case HG_INPUT_REST_CARRY:
        return h->rest_carry[at * h->program->n_rest_carry + h->program->rest_carries[in.name].at + in.component];
    case HG_INPUT_MASS:
        return data->mass[at];
    default:
        return hg_groom_attribute_find(data, h->program->attributes[in.name])[at];
    }
}

/* Runs a function of a vertex for some strands of a groom, the last one again where there are no more. */
static void at_vertex(const hoist *h, const hg_function *function, int64_t groom, int64_t strand, int64_t count,
                      int64_t vertex, double out[][CHUNK], int n_out)
{
    int n_in;
    const hg_input *inputs = hg_function_inputs(function, &n_in);
    double in[VALUES][CHUNK];
    const void *ins[VALUES];
    void *outs[VALUES];
    for (int i = 0; i < n_in; i++) {
        ins[i] = in[i];
        for (int64_t l = 0; l < count; l++) {
            const int64_t s = strand + l < h->data->strands ? strand + l : h->data->strands - 1;
            in[i][l] = groom_value(h, inputs[i], groom, s, vertex);
        }
    }
    for (int j = 0; j < n_out; j++) outs[j] = out[j];
    hg_function_run(function, HG_F64, count, ins, NULL, outs);
}

typedef struct {
    const hoist *hoist;
    const hg_function *function;
    int n;
    int64_t rows; /* V for sites, 1 for strands */
    void *to;
} rows_work;

static int64_t chunks_of(const hoist *h)
{
    const int64_t strands = h->layout == HG_HOIST_TILES ? h->tiles * h->lanes : h->data->strands;
    return (strands + CHUNK - 1) / CHUNK;
}

static int64_t place(const rows_work *work, int64_t groom, int64_t strand, int64_t vertex, int j)
{
    const hoist *h = work->hoist;
    const int64_t number = groom * h->data->strands + strand, rows = work->rows, n = work->n, L = h->lanes;
    switch (h->layout) {
    case HG_HOIST_TILES:
        return (((groom * h->tiles + strand / L) * rows + vertex) * n + j) * L + strand % L;
    case HG_HOIST_LANES:
        return ((number / 32 * rows + vertex) * n + j) * 32 + number % 32;
    default:
        return (number * n + j) * rows + vertex;
    }
}

/* Index: a vertex of some strands of a groom. */
static void make_rows(const void *args, int64_t first, int64_t last)
{
    const rows_work *work = args;
    const hoist *h = work->hoist;
    const int64_t chunks = chunks_of(h), strands = h->layout == HG_HOIST_TILES ? h->tiles * h->lanes : h->data->strands;
    double out[VALUES][CHUNK];
    for (int64_t i = first; i < last; i++) {
        const int64_t vertex = i % work->rows, chunk = i / work->rows % chunks, groom = i / work->rows / chunks;
        const int64_t strand = chunk * CHUNK, count = strands - strand < CHUNK ? strands - strand : CHUNK;
        at_vertex(h, work->function, groom, strand, count, vertex, out, work->n);
        for (int j = 0; j < work->n; j++)
            for (int64_t l = 0; l < count; l++) {
                const int64_t at = place(work, groom, strand + l, vertex, j);
                if (h->program->dtype == HG_F64)
                    ((double *)work->to)[at] = out[j][l];
                else
                    ((float *)work->to)[at] = (float)out[j][l];
            }
    }
}

/* On the processor, whatever the context's device. */
static hg_status run_here(hg_ctx *ctx, const hg_kernel *kernel, int64_t n, const void *args)
{
    if (hg_ctx_host(ctx)) return hg_launch(ctx, kernel, n, args);
    kernel->cpu(args, 0, n);
    return HG_OK;
}

static hg_status make(const hoist *h, hg_ctx *ctx, const hg_function *function, int n, int64_t rows, void **to,
                      size_t *count)
{
    static const hg_kernel kernel = {
        .name = "groom_hoist", .args_size = sizeof(rows_work), .cpu = make_rows, .block = 16
    };
    if (!function) return HG_OK;
    int n_in;
    hg_function_inputs(function, &n_in);
    if (n_in > VALUES || n > VALUES)
        return hg_fail(HG_UNSUPPORTED,
                       "the energies ask for %d rest values and keep %d per site: at most %d are possible", n_in, n,
                       VALUES);
    const int64_t G = h->data->grooms, S = h->data->strands;
    const int64_t strands = h->layout == HG_HOIST_TILES   ? G * h->tiles * h->lanes
                            : h->layout == HG_HOIST_LANES ? (G * S + 31) / 32 * 32
                                                          : G * S;
    *count = (size_t)(strands * rows * n);
    *to = hg_alloc(*count + 1, hg_dtype_size(h->program->dtype));
    if (!*to) return HG_MEMORY;
    const rows_work work = { h, function, n, rows, *to };
    return run_here(ctx, &kernel, G * chunks_of(h) * rows, &work);
}

/* Carried rest data of some strands, from root to tip. */
static void carry_rows(const void *args, int64_t first, int64_t last)
{
    const hoist *h = *(hoist *const *)args;
    const hg_strand_program *program = h->program;
    const int64_t S = h->data->strands, V = h->data->vertices, chunks = (S + CHUNK - 1) / CHUNK;
    const int n = program->n_rest_carry;
    double out[4 * HG_GRAPH_CARRIES][CHUNK];
    for (int64_t row = first; row < last; row++) {
        const int64_t groom = row / chunks, strand = row % chunks * CHUNK;
        const int64_t count = S - strand < CHUNK ? S - strand : CHUNK;
        for (int64_t v = 0; v < V; v++)
            for (int kept = 0; kept < 2; kept++) {
                if (kept && v + 1 == V) break;
                /* one carried value's beginning may be made of another's */
                for (int round = 0; round < (kept ? 1 : program->n_rest_carries); round++) {
                    at_vertex(h, kept ? program->rest_kept : program->rest_first, groom, strand, count, v, out, n);
                    for (int i = 0; i < program->n_rest_carries; i++) {
                        if (kept ? v < program->rest_carries[i].start : v != program->rest_carries[i].start) continue;
                        for (int c = 0; c < program->rest_carries[i].width; c++) {
                            const int j = program->rest_carries[i].at + c;
                            for (int64_t l = 0; l < count; l++)
                                h->rest_carry[((groom * S + strand + l) * V + v + kept) * n + j] = out[j][l];
                        }
                    }
                }
            }
    }
}

static hg_status make_carry(hoist *h, hg_ctx *ctx)
{
    static const hg_kernel kernel = {
        .name = "groom_carry", .args_size = sizeof(hoist *), .cpu = carry_rows, .block = 1
    };
    const hg_strand_program *program = h->program;
    const int64_t S = h->data->strands, G = h->data->grooms;
    if (!program->n_rest_carry) return HG_OK;
    int first, kept;
    hg_function_inputs(program->rest_first, &first);
    hg_function_inputs(program->rest_kept, &kept);
    if (first > VALUES || kept > VALUES)
        return hg_fail(HG_UNSUPPORTED, "carried rest data is made of %d values: at most %d are possible",
                       first > kept ? first : kept, VALUES);
    h->rest_carry = hg_alloc((size_t)(G * S * h->data->vertices * program->n_rest_carry) + 1, sizeof(double));
    if (!h->rest_carry) return HG_MEMORY;
    return run_here(ctx, &kernel, G * ((S + CHUNK - 1) / CHUNK), &h);
}

hg_status hg_hoist(hg_hoisted *hoisted, hg_ctx *ctx, const hg_strand_program *program, const hg_groom_data *data,
                   hg_hoist_layout layout, int lanes)
{
    hoist h = {
        .program = program, .data = data, .layout = layout, .lanes = lanes, .tiles = (data->strands + lanes - 1) / lanes
    };
    *hoisted = (hg_hoisted){ 0 };
    hg_status status = make_carry(&h, ctx);
    if (status == HG_OK)
        status = make(&h, ctx, program->site, program->n_site, data->vertices, &hoisted->site, &hoisted->site_count);
    if (status == HG_OK)
        status = make(&h, ctx, program->groom_strand, program->n_groom_strand, 1, &hoisted->groom_strand,
                      &hoisted->groom_strand_count);
    hg_free(h.rest_carry);
    if (status == HG_OK) return HG_OK;
    hg_free(hoisted->site);
    hg_free(hoisted->groom_strand);
    *hoisted = (hg_hoisted){ 0 };
    return status;
}
