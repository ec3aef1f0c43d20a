/* Printed CUDA: the same instruction lists as the printed C, for one strand a warp. The lists are straight lines over one
 * number, so that what is said here is only who computes which site and in which order the shares are summed. */
#include "autograd/trace/strand.h"

#include <stdio.h>
#include <string.h>

/* ---- a thread per strand ------------------------------------------------------------------------------------ */

size_t hg_strand_cuda_scratch(const hg_strand_program *program, int64_t vertices)
{
    return program->n_carry ? (hg_strand_scratch(program, 1, vertices) + 15) & ~(size_t)15 : 0;
}

/* Where a value is carried, the next site waits for it: the walk of the printed C, for one strand. */
static void by_thread(const hg_strand_program *program, const char *name, hg_text *text)
{
    hg_text_add(text, "__device__ ");
    char walk[96];
    snprintf(walk, sizeof walk, "%s_strand", name);
    hg_strand_print_c(program, walk, text);
    hg_text_add(
        text,
        "\nextern \"C\" __global__ void %s(hg_strand_args given, int64_t first, int64_t count, char *scratch, int64_t "
        "size)\n{\n"
        "    const int64_t t = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;\n"
        "    if (t < count) %s(&given, first + t, first + t + 1, scratch + t * size);\n}\n",
        name, walk);
}

/* ---- a warp per strand -------------------------------------------------------------------------------------- */

/* In numbers: partial sums of the lanes, their totals, and for every gradient the shares of the sites and their sum. */
size_t hg_strand_cuda_shared(const hg_strand_program *program, int64_t vertices)
{
    if (program->n_carry) return 0;
    size_t numbers = (size_t)(program->n_terms + program->n_adjoint) * 33;
    for (int k = 0; k < program->n_arrays; k++)
        if (program->arrays[k].gradient)
            numbers += (size_t)(vertices * program->arrays[k].width * (program->bodies + 1));
    return numbers * hg_dtype_size(program->dtype);
}

static bool touched(const hg_strand_program *program, int place)
{
    for (int b = 0; b < program->bodies; b++)
        if (hg_strand_list_touches(&program->body[b], place)) return true;
    return hg_strand_list_touches(&program->preamble, place) || hg_strand_list_touches(&program->postamble, place);
}

static void arrays(const hg_strand_program *program, hg_text *text)
{
    char name[40], gradient[40];
    bool rest = program->n_site || program->n_groom_strand;
    for (int k = 0; k < program->n_arrays; k++) rest |= program->arrays[k].rest;
    if (rest) hg_text_add(text, "    const int64_t in_groom = (args->groom ? args->groom[t / S] : 0) * S + t %% S;\n");
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        hg_strand_array_name(program, k, false, name);
        hg_strand_array_name(program, k, true, gradient);
        hg_text_add(text, "    const hg_v *restrict tile_%s = (const hg_v *)args->array[%d] + %s * (V - %d) * %d;\n",
                    name, k, array->rest ? "in_groom" : "t", array->missing, array->width);
        if (!array->gradient) continue;
        hg_text_add(text,
                    "    hg_v *share_%s = shared, *tile_%s = share_%s + V * %d;\n    shared = tile_%s + V * %d;\n",
                    gradient, gradient, gradient, array->width * program->bodies, gradient, array->width);
        hg_text_add(text, "    for (int64_t k = lane; k < V * %d; k += 32) share_%s[k] = 0;\n",
                    array->width * program->bodies, gradient);
    }
    if (program->n_site)
        hg_text_add(text, "    const hg_v *restrict sites = (const hg_v *)args->site + in_groom * V * %d;\n",
                    program->n_site);
    if (program->n_groom_strand)
        hg_text_add(text, "    const hg_v *restrict groom_strand = (const hg_v *)args->groom_strand + in_groom * %d;\n",
                    program->n_groom_strand);
}

static void preamble(const hg_strand_program *program, hg_text *text)
{
    if (program->n_strand) hg_text_add(text, "    hg_v strand[%d];\n", program->n_strand);
    if (!program->preamble.n) return;
    hg_text_add(text, "    { /* every lane for itself: what the strand's sites share */\n");
    if (hg_strand_list_touches(&program->preamble, HG_PLACE_STRAND_INPUT)) {
        hg_text_add(text, "        hg_v input[%d];\n", program->input_width);
        for (int j = 0; j < program->n_inputs; j++) {
            const hg_strand_input *input = &program->inputs[j];
            hg_text_add(text,
                        "        if (args->strand_input[%d])\n            hg_v_load_tile(input + %d, (const hg_real "
                        "*)args->strand_input[%d] + %d * t, %d, 1);\n",
                        j, input->first, j, input->width, input->width);
        }
    }
    hg_strand_print_list(program, &program->preamble, "        ", text);
    hg_text_add(text, "    }\n");
}

static void site(const hg_strand_program *program, const hg_code *code, hg_text *text)
{
    char name[40];
    for (int k = 0; k < program->n_arrays; k++) {
        const int width = program->arrays[k].width, share = width * program->bodies;
        hg_strand_array_name(program, k, false, name);
        if (hg_strand_list_touches(code, HG_PLACE_ARRAY + k))
            hg_text_add(text, "            const hg_v *restrict %s = tile_%s + %d * i;\n", name, name, width);
        hg_strand_array_name(program, k, true, name);
        if (hg_strand_list_touches(code, HG_PLACE_ARRAY_GRADIENT + k)) /* offset 0 is the last of the site's shares */
            hg_text_add(text, "            hg_v *restrict %s = share_%s + %d * i + %d;\n", name, name, share,
                        share - width);
    }
    if (hg_strand_list_touches(code, HG_PLACE_SITE))
        hg_text_add(text, "            const hg_v *restrict site = sites + i * %d;\n", program->n_site);
    hg_strand_print_list(program, code, "            ", text);
}

static void sites(const hg_strand_program *program, hg_text *text)
{
    const int last = program->bodies - 1;
    hg_text_add(text, "    hg_v energy[%d] = { 0 };\n", program->n_terms);
    if (program->n_adjoint) hg_text_add(text, "    hg_v adjoint[%d] = { 0 };\n", program->n_adjoint);
    hg_text_add(text, "    for (int64_t i = lane; i < V; i += 32) {\n");
    for (int n = 0; n <= last; n++) {
        const int b = last - n; /* the body that most sites have first */
        if (n == 0)
            hg_text_add(text, "        if (i >= %d) {\n", b);
        else
            hg_text_add(text, "        } else if (i == %d) {\n", b);
        site(program, &program->body[b], text);
    }
    hg_text_add(text, "        }\n    }\n");
}

/* Sums over the lanes and gradients of the vertices, each in a fixed order. */
static void gather(const hg_strand_program *program, hg_text *text)
{
    const int sums = program->n_terms + program->n_adjoint;
    char name[40];
    hg_text_add(text, "    for (int k = 0; k < %d; k++) partial[32 * k + lane] = energy[k];\n", program->n_terms);
    if (program->n_adjoint)
        hg_text_add(text, "    for (int k = 0; k < %d; k++) partial[32 * (%d + k) + lane] = adjoint[k];\n",
                    program->n_adjoint, program->n_terms);
    hg_text_add(text,
                "    __syncwarp(0xffffffffu);\n"
                "    for (int k = lane; k < %d; k += 32) {\n"
                "        double sum = 0;\n"
                "        for (int l = 0; l < 32; l++) sum += (double)partial[32 * k + l];\n"
                "        total[k] = (hg_v)sum;\n    }\n",
                sums);
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        if (!array->gradient) continue;
        hg_strand_array_name(program, k, true, name);
        hg_text_add(
            text,
            "    for (int64_t v = lane; v < V; v += 32)\n"
            "        for (int c = 0; c < %d; c++) {\n"
            "            hg_v sum = 0; /* of the sites whose last vertex is v, v + 1, ... */\n"
            "            for (int k = 0; k < %d && v + k < V; k++) sum += share_%s[(v + k) * %d + %d * (%d - k) + c];\n"
            "            tile_%s[%d * v + c] = sum;\n        }\n",
            array->width, program->bodies, name, array->width * program->bodies, array->width, program->bodies - 1,
            name, array->width);
    }
    hg_text_add(text, "    __syncwarp(0xffffffffu);\n");
}

static void postamble(const hg_strand_program *program, hg_text *text)
{
    bool input_gradient = false;
    for (int j = 0; j < program->n_inputs; j++) input_gradient |= program->inputs[j].gradient;
    hg_text_add(text, "    if (lane == 0) { /* the chain back to the root, and what there is one of */\n");
    if (program->n_adjoint)
        hg_text_add(text, "        for (int k = 0; k < %d; k++) adjoint[k] = total[%d + k];\n", program->n_adjoint,
                    program->n_terms);
    if (input_gradient) hg_text_add(text, "        hg_v input_gradient[%d] = { 0 };\n", program->input_width);
    hg_strand_print_list(program, &program->postamble, "        ", text);
    for (int j = 0; j < program->n_inputs; j++) {
        const hg_strand_input *input = &program->inputs[j];
        if (input->gradient)
            hg_text_add(text,
                        "        if (args->strand_input_gradient[%d])\n            hg_v_store_tile((hg_real "
                        "*)args->strand_input_gradient[%d] + %d * t, input_gradient + %d, %d, 1);\n",
                        j, j, input->width, input->first, input->width);
    }
    hg_text_add(text, "        hg_v_store_energy(args, t, t, 1, total, %d);\n    }\n    __syncwarp(0xffffffffu);\n",
                program->n_terms);
}

static void store(const hg_strand_program *program, hg_text *text)
{
    char name[40];
    for (int k = 0; k < program->n_arrays; k++) {
        const hg_strand_input *array = &program->arrays[k];
        if (!array->gradient) continue;
        hg_strand_array_name(program, k, true, name);
        hg_text_add(text,
                    "    if (args->array_gradient[%d]) {\n"
                    "        hg_v *restrict to = (hg_v *)args->array_gradient[%d] + t * (V - %d) * %d;\n"
                    "        for (int64_t k = lane; k < (V - %d) * %d; k += 32) to[k] = tile_%s[k];\n    }\n",
                    k, k, array->missing, array->width, array->missing, array->width, name);
    }
}

static void by_warp(const hg_strand_program *program, const char *name, hg_text *text)
{
    const int sums = program->n_terms + program->n_adjoint;
    hg_text_add(
        text,
        "extern \"C\" __global__ void %s(hg_strand_args given, int64_t first, int64_t count, char *scratch, int64_t "
        "size)\n{\n"
        "    HG_DYNAMIC_SHARED(hg_v, memory);\n"
        "    const hg_strand_args *args = &given;\n"
        "    const int lane = (int)(threadIdx.x %% 32);\n"
        "    const int64_t number = (int64_t)blockIdx.x * (blockDim.x / 32) + threadIdx.x / 32, t = first + number;\n"
        "    const int64_t V = args->vertices, S = args->strands;\n"
        "    if (number >= count) return; /* a whole warp */\n"
        "    hg_v *shared = memory + threadIdx.x / 32 * (size / (int64_t)sizeof(hg_v)), *partial = shared, *total = "
        "partial + %d;\n"
        "    shared = total + %d;\n    (void)scratch, (void)S;\n",
        name, 32 * sums, sums);
    if (program->n_uniform) hg_text_add(text, "    const hg_real *restrict u = (const hg_real *)args->uniform;\n");
    if (touched(program, HG_PLACE_ROOT_X1) || touched(program, HG_PLACE_ROOT_REST1) ||
        touched(program, HG_PLACE_GRADIENT_X1) || touched(program, HG_PLACE_GRADIENT_REST1))
        hg_text_add(text, "    const int64_t second = V > 1 ? 3 : 0;\n");
    arrays(program, text);
    preamble(program, text);
    hg_text_add(text, "    __syncwarp(0xffffffffu); /* the shares are zero */\n");
    sites(program, text);
    gather(program, text);
    postamble(program, text);
    store(program, text);
    hg_text_add(text, "}\n");
}

void hg_strand_print_cuda(const hg_strand_program *program, const char *name, hg_text *text)
{
    if (program->n_carry)
        by_thread(program, name, text);
    else
        by_warp(program, name, text);
}
