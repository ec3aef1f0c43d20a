/* Printed CUDA: the same instruction lists as the printed C, for a strand a warp. The lists are straight lines over one
 * number, so that what is said here is only who computes which site and in which order the shares are summed.
 *
 * A block has as many strands as warps. Its warps bring the rows of their strands to shared memory; one thread per strand runs
 * the preamble; a lane has a site, and each site's share of a gradient has a place of its own; one thread per strand runs the
 * postamble on the sums over the sites; then every vertex gathers the shares of its sites in their order. No atomics: the same
 * bits in any schedule. */
#include "autograd/trace/strand.h"

#include <stdio.h>
#include <string.h>

/* Left to itself ptxas aims at an occupancy, and in f64, whose numbers take two registers, it spills to get there: that one block
 * at a time is enough is said. */
static void begin(const hg_strand_program *program, const char *name, hg_text *text)
{
    hg_text_add(text,
                "extern \"C\" __global__ void __launch_bounds__(%d%s)\n%s_cuda(const __grid_constant__ hg_strand_args "
                "given, const int64_t n)\n{\n",
                HG_STRAND_CUDA_THREADS, program->dtype == HG_F64 ? ", 1" : "", name);
}

static void end(const char *name, hg_text *text) { hg_text_add(text, "}\nHG_KERNEL_EXPORT(%s_cuda)\n", name); }

/* ---- a thread per strand ------------------------------------------------------------------------------------ */

size_t hg_strand_cuda_scratch(const hg_strand_program *program, int64_t vertices)
{
    if (!program->n_carry) return 0;
    return (size_t)(program->tiles.rows * vertices + program->tiles.extra) * hg_dtype_size(program->dtype);
}

/* Where a value is carried, the next site waits for it: the walk of the printed C, a lane per strand. The tiles of a warp lie
 * side by side, so that its lanes read neighbours. */
static void by_thread(const hg_strand_program *program, const char *name, hg_text *text)
{
    char walk[96];
    snprintf(walk, sizeof walk, "%s_strand", name);
    hg_text_add(text, "__device__ ");
    hg_strand_print_c(program, walk, text);
    hg_text_add(text, "\n");
    begin(program, name, text);
    hg_text_add(
        text,
        "    const int64_t thread = (int64_t)blockIdx.x * blockDim.x + threadIdx.x, size = %d * given.vertices + "
        "%d;\n"
        "    hg_v *scratch = (hg_v *)given.scratch + thread / 32 * 32 * size + thread %% 32;\n    (void)n;\n"
        "    for (int64_t t = thread; t < given.count; t += (int64_t)gridDim.x * blockDim.x)\n"
        "        %s(&given, t, t + 1, scratch);\n",
        program->tiles.rows, program->tiles.extra, walk);
    end(name, text);
}

/* ---- a warp per strand -------------------------------------------------------------------------------------- */

/* Where a warp's shared memory has what, in numbers: sums of the lanes, their totals, what the preamble leaves, then the rows of
 * every array that is wider than one, and the shares of its gradient. fixed + by_vertex * V, made odd for the banks. */
typedef struct {
    int total, strand, fixed, by_vertex;
    int rows[HG_STRAND_ARRAYS], shares[HG_STRAND_ARRAYS]; /* times V; -1: read where it lies; not wanted */
} places;

static places find_places(const hg_strand_program *program)
{
    const int sums = program->n_terms + program->n_adjoint;
    places at = { .total = 33 * sums, .strand = 34 * sums, .fixed = 34 * sums + program->n_strand };
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        at.rows[k] = at.shares[k] = -1;
        if (array->width > 1) {
            at.rows[k] = at.by_vertex;
            at.by_vertex += array->width;
        }
        if (array->gradient) {
            at.shares[k] = at.by_vertex;
            at.by_vertex += array->width * program->bodies;
        }
    }
    return at;
}

size_t hg_strand_cuda_shared(const hg_strand_program *program, int64_t vertices)
{
    if (program->n_carry) return 0;
    const places at = find_places(program);
    return (size_t)((at.fixed + at.by_vertex * vertices) | 1) * hg_dtype_size(program->dtype);
}

static const char *row_of(const hg_strand_input *array) { return array->rest ? "in_groom" : "t"; }

static bool reads_groom(const hg_strand_program *program)
{
    bool reads = program->n_site || program->n_groom_strand;
    for (int k = 0; k < program->n_arrays; k++) reads |= program->arrays[k].rest;
    return reads;
}

/* A part of the kernel that a warp, or a thread, runs for its strand. */
static void phase(const char *who, bool groom, hg_text *text)
{
    hg_text_add(text,
                "    if (%s < warps && first + %s < n) {\n        const int64_t t = first + %s;\n"
                "        hg_v *own = memory + %s * size;\n        (void)t, (void)own;\n",
                who, who, who, who);
    if (groom)
        hg_text_add(text, "        int64_t in_frame;\n        const int64_t frame = hg_divide(t, S, &in_frame);\n"
                          "        const int64_t in_groom = (args->groom ? args->groom[frame] : 0) * S + in_frame;\n");
}
#define BY_WARP   "warp"
#define BY_THREAD "thread"

static void load(const hg_strand_program *program, const places *at, hg_text *text)
{
    bool groom = false;
    for (int k = 0; k < program->n_arrays; k++) groom |= program->arrays[k].rest && at->rows[k] >= 0;
    phase(BY_WARP, groom, text);
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const int width = array->width;
        if (at->rows[k] >= 0)
            hg_text_add(text,
                        "        for (int64_t k = lane, end = (V - %d) * %d; k < end; k += 32)\n"
                        "            own[%d + %d * V + k] = ((const hg_v *)args->array[%d])[%s * end + k];\n",
                        array->missing, width, at->fixed, at->rows[k], k, row_of(array));
        if (at->shares[k] >= 0)
            hg_text_add(text, "        for (int64_t k = lane; k < V * %d; k += 32) own[%d + %d * V + k] = 0;\n",
                        width * program->bodies, at->fixed, at->shares[k]);
    }
    hg_text_add(text, "    }\n    __syncthreads();\n");
}

/* The rows of array k under the name that a list reads. */
static void rows(const hg_strand_program *program, const places *at, int k, const char *indent, hg_text *text)
{
    const hg_strand_input *array = &program->arrays[k];
    char name[40];
    hg_strand_array_name(program, k, false, name);
    hg_text_add(text, "%sconst hg_v *restrict tile_%s = ", indent, name);
    if (at->rows[k] >= 0)
        hg_text_add(text, "own + %d + %d * V;\n", at->fixed, at->rows[k]);
    else
        hg_text_add(text, "(const hg_v *)args->array[%d] + %s * (V - %d) * %d;\n", k, row_of(array), array->missing,
                    array->width);
}

static bool reads_root(const hg_code *code, hg_input_kind kind)
{
    if (kind == HG_INPUT_X)
        return hg_strand_list_touches(code, HG_PLACE_ROOT_X0) || hg_strand_list_touches(code, HG_PLACE_ROOT_X1);
    return kind == HG_INPUT_REST &&
           (hg_strand_list_touches(code, HG_PLACE_ROOT_REST0) || hg_strand_list_touches(code, HG_PLACE_ROOT_REST1));
}

static void root_rows(const hg_strand_program *program, const places *at, const hg_code *code, const char *indent,
                      hg_text *text)
{
    if (hg_strand_list_touches(code, HG_PLACE_ROOT_X1) || hg_strand_list_touches(code, HG_PLACE_ROOT_REST1))
        hg_text_add(text, "%sconst int64_t second = V > 1 ? 3 : 0;\n", indent);
    for (int k = 0; k < program->n_arrays; k++)
        if (reads_root(code, program->arrays[k].kind)) rows(program, at, k, indent, text);
}

static void groom_strand(const hg_strand_program *program, hg_text *text)
{
    hg_text_add(text, "        const hg_v *restrict groom_strand = (const hg_v *)args->groom_strand + in_groom * %d;\n",
                program->n_groom_strand);
}

static void preamble(const hg_strand_program *program, const places *at, hg_text *text)
{
    const hg_code *code = &program->preamble;
    if (!code->n) return;
    const bool stored = hg_strand_list_touches(code, HG_PLACE_GROOM_STRAND);
    phase(BY_THREAD, stored, text);
    hg_text_add(text, "        hg_v *restrict strand = own + %d;\n", at->strand);
    if (stored) groom_strand(program, text);
    if (hg_strand_list_touches(code, HG_PLACE_STRAND_INPUT)) {
        hg_text_add(text, "        hg_v input[%d];\n", program->input_width);
        for (int j = 0; j < program->n_inputs; j++) {
            const hg_strand_input *input = &program->inputs[j];
            hg_text_add(text,
                        "        for (int c = 0; c < %d; c++) input[%d + c] = args->strand_input[%d] ? ((const hg_v "
                        "*)args->strand_input[%d])[%d * t + c] : 0;\n",
                        input->width, input->first, j, j, input->width);
        }
    }
    root_rows(program, at, code, "        ", text);
    hg_strand_print_list(program, code, true, "        ", text);
    hg_text_add(text, "    }\n    __syncthreads();\n");
}

static void site(const hg_strand_program *program, const places *at, const hg_code *code, hg_text *text)
{
    char name[40];
    for (int k = 0; k < program->n_arrays; k++) {
        const int width = program->arrays[k].width, share = width * program->bodies;
        hg_strand_array_name(program, k, false, name);
        if (hg_strand_list_touches(code, HG_PLACE_ARRAY + k))
            hg_text_add(text, "                const hg_v *restrict %s = tile_%s + %d * i;\n", name, name, width);
        hg_strand_array_name(program, k, true, name);
        if (hg_strand_list_touches(code, HG_PLACE_ARRAY_GRADIENT + k)) /* offset 0 is the last of the site's shares */
            hg_text_add(text, "                hg_v *restrict %s = own + %d + %d * V + %d * i + %d;\n", name, at->fixed,
                        at->shares[k], share, share - width);
    }
    if (hg_strand_list_touches(code, HG_PLACE_SITE))
        hg_text_add(text, "                const hg_v *restrict site = sites + i;\n");
    hg_strand_print_list(program, code, true, "                ", text);
}

static bool any_body(const hg_strand_program *program, int place)
{
    for (int b = 0; b < program->bodies; b++)
        if (hg_strand_list_touches(&program->body[b], place)) return true;
    return false;
}

static void sites(const hg_strand_program *program, const places *at, hg_text *text)
{
    const int last = program->bodies - 1, sums = program->n_terms + program->n_adjoint;
    bool groom = any_body(program, HG_PLACE_SITE) || any_body(program, HG_PLACE_GROOM_STRAND);
    for (int k = 0; k < program->n_arrays; k++)
        groom |= program->arrays[k].rest && at->rows[k] < 0 && any_body(program, HG_PLACE_ARRAY + k);
    phase(BY_WARP, groom, text);
    if (any_body(program, HG_PLACE_SITE))
        hg_text_add(text,
                    "        const hg_v *restrict sites = (const hg_v *)args->site + in_groom * V * %d; /* [n,V] */\n",
                    program->n_site);
    if (any_body(program, HG_PLACE_GROOM_STRAND)) groom_strand(program, text);
    if (any_body(program, HG_PLACE_STRAND))
        hg_text_add(text, "        const hg_v *restrict strand = own + %d;\n", at->strand);
    if (any_body(program, HG_PLACE_ROOT_X1) || any_body(program, HG_PLACE_ROOT_REST1))
        hg_text_add(text, "        const int64_t second = V > 1 ? 3 : 0;\n");
    for (int k = 0; k < program->n_arrays; k++) {
        bool read = any_body(program, HG_PLACE_ARRAY + k);
        for (int b = 0; b <= last; b++) read |= reads_root(&program->body[b], program->arrays[k].kind);
        if (read) rows(program, at, k, "        ", text);
    }
    hg_text_add(text, "        hg_v energy[%d] = { 0 };\n", program->n_terms);
    if (program->n_adjoint) hg_text_add(text, "        hg_v adjoint[%d] = { 0 };\n", program->n_adjoint);
    hg_text_add(text, "        for (int64_t i = lane; i < V; i += 32) {\n");
    for (int n = 0; n <= last; n++) {
        const int b = last - n; /* the body that most sites have first */
        if (n == 0)
            hg_text_add(text, "            if (i >= %d) {\n", b);
        else
            hg_text_add(text, "            } else if (i == %d) {\n", b);
        site(program, at, &program->body[b], text);
    }
    hg_text_add(text,
                "            }\n        }\n"
                "        for (int k = 0; k < %d; k++) own[33 * k + lane] = energy[k];\n",
                program->n_terms);
    if (program->n_adjoint)
        hg_text_add(text, "        for (int k = 0; k < %d; k++) own[33 * (%d + k) + lane] = adjoint[k];\n",
                    program->n_adjoint, program->n_terms);
    hg_text_add(text,
                "        __syncwarp(0xffffffffu);\n"
                "        for (int k = lane; k < %d; k += 32) {\n"
                "            hg_v sum = 0;\n"
                "            for (int l = 0; l < 32; l++) sum += own[33 * k + l];\n"
                "            own[%d + k] = sum;\n        }\n"
                "    }\n    __syncthreads();\n",
                sums, at->total);
}

static void postamble(const hg_strand_program *program, const places *at, hg_text *text)
{
    const hg_code *code = &program->postamble;
    char name[40];
    bool input_gradient = false;
    for (int j = 0; j < program->n_inputs; j++) input_gradient |= program->inputs[j].gradient;
    if (!code->n && !input_gradient) return;
    const bool stored = hg_strand_list_touches(code, HG_PLACE_GROOM_STRAND);
    phase(BY_THREAD, stored, text);
    if (stored) groom_strand(program, text);
    if (hg_strand_list_touches(code, HG_PLACE_ADJOINT))
        hg_text_add(text, "        const hg_v *restrict adjoint = own + %d;\n", at->total + program->n_terms);
    if (hg_strand_list_touches(code, HG_PLACE_STRAND))
        hg_text_add(text, "        const hg_v *restrict strand = own + %d;\n", at->strand);
    root_rows(program, at, code, "        ", text);
    if (hg_strand_list_touches(code, HG_PLACE_GRADIENT_X1) || hg_strand_list_touches(code, HG_PLACE_GRADIENT_REST1))
        hg_text_add(text, "        const int64_t second_share = V > 1 ? %d : 0;\n", 3 * program->bodies);
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const bool x = array->kind == HG_INPUT_X && (hg_strand_list_touches(code, HG_PLACE_GRADIENT_X0) ||
                                                     hg_strand_list_touches(code, HG_PLACE_GRADIENT_X1));
        const bool rest = array->kind == HG_INPUT_REST && (hg_strand_list_touches(code, HG_PLACE_GRADIENT_REST0) ||
                                                           hg_strand_list_touches(code, HG_PLACE_GRADIENT_REST1));
        hg_strand_array_name(program, k, true, name);
        if (x || rest) /* to the shares of the sites that end at the first two vertices */
            hg_text_add(text, "        hg_v *restrict tile_%s = own + %d + %d * V + %d;\n", name, at->fixed,
                        at->shares[k], array->width * (program->bodies - 1));
    }
    if (input_gradient) hg_text_add(text, "        hg_v input_gradient[%d] = { 0 };\n", program->input_width);
    hg_strand_print_list(program, code, true, "        ", text);
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        if (input->gradient)
            hg_text_add(text,
                        "        if (args->strand_input_gradient[%d])\n            for (int c = 0; c < %d; c++) ((hg_v "
                        "*)args->strand_input_gradient[%d])[%d * t + c] = input_gradient[%d + c];\n",
                        j, input->width, j, input->width, input->first);
    }
    hg_text_add(text, "    }\n    __syncthreads();\n");
}

/* Gradients of the vertices, each the sum of its shares in order, and the energies of the block's strands. */
static void gather(const hg_strand_program *program, const places *at, hg_text *text)
{
    phase(BY_WARP, false, text);
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        const int width = array->width, share = width * program->bodies;
        if (!array->gradient) continue;
        hg_text_add(
            text,
            "        if (args->array_gradient[%d]) {\n"
            "            const hg_v *restrict shares = own + %d + %d * V;\n"
            "            const int end = (int)(V - %d) * %d;\n"
            "            hg_v *restrict to = (hg_v *)args->array_gradient[%d] + t * end;\n"
            "            for (int k = lane; k < end; k += 32) {\n"
            "                const int v = k / %d, c = k %% %d;\n"
            "                hg_v sum = 0; /* of the sites whose last vertex is v, v + 1, ... */\n"
            "                for (int j = 0; j < %d && v + j < (int)V; j++) sum += shares[%d * (v + j) + %d * (%d - "
            "j) + c];\n"
            "                to[k] = sum;\n            }\n        }\n",
            k, at->fixed, at->shares[k], array->missing, width, k, width, width, program->bodies, share, width,
            program->bodies - 1);
    }
    hg_text_add(
        text,
        "        if (args->per_strand)\n"
        "            for (int k = lane; k < %d; k += 32) args->per_strand[t * args->stride + args->column[k]] = "
        "(double)own[%d + k];\n    }\n"
        "    for (int k = (int)threadIdx.x; k < %d; k += (int)blockDim.x) {\n"
        "        double sum = 0;\n"
        "        for (int w = 0; w < warps && first + w < n; w++) sum += (double)memory[w * size + %d + k];\n"
        "        args->energy[(int64_t)blockIdx.x * %d + k] = sum;\n    }\n",
        program->n_terms, at->total, program->n_terms, at->total, program->n_terms);
}

static void by_warp(const hg_strand_program *program, const char *name, hg_text *text)
{
    const places at = find_places(program);
    begin(program, name, text);
    hg_text_add(text,
                "    HG_DYNAMIC_SHARED(hg_v, memory);\n"
                "    const hg_strand_args *args = &given;\n"
                "    const int thread = (int)threadIdx.x, lane = thread %% 32, warp = thread / 32, warps = "
                "(int)blockDim.x / 32;\n"
                "    const int64_t V = args->vertices, first = (int64_t)blockIdx.x * warps;\n"
                "    const int size = (%d + %d * (int)V) | 1; /* of a warp's share of the memory */\n",
                at.fixed, at.by_vertex);
    if (reads_groom(program)) hg_text_add(text, "    const int64_t S = args->strands;\n");
    if (program->n_uniform) hg_text_add(text, "    const hg_real *restrict u = (const hg_real *)args->uniform;\n");
    load(program, &at, text);
    preamble(program, &at, text);
    sites(program, &at, text);
    postamble(program, &at, text);
    gather(program, &at, text);
    end(name, text);
}

void hg_strand_print_cuda(const hg_strand_program *program, const char *name, hg_text *text)
{
    hg_text_add(text, "#define HG_BYTES %d\n#include \"autograd/trace/strand_cuda.h\"\n",
                (int)hg_dtype_size(program->dtype));
    if (program->n_carry)
        by_thread(program, name, text);
    else
        by_warp(program, name, text);
}
