/* Prints the strand kernels of the usual sums of built-in energies, for one number type:
 *
 *     generate_kernels f32|f64 FILE.c
 *
 * Run while the library is built; the file is compiled once per level of the processor's vector instructions. At run
 * time a kernel is found by the hash of the program it was printed from, so one that does not match is never used. */
#include "autograd/trace/strand.h"
#include "hairloss/physics.h"
#include "hairloss/usual_sums.h"

#include <stdio.h>
#include <string.h>

static hg_status print_sum(hg_dtype dtype, int number, hg_text *text, uint64_t *hash)
{
    const usual_term *sum = usual_sums[number];
    hg_strand_term terms[USUAL_TERMS];
    hg_term completed[USUAL_TERMS];
    double params[USUAL_TERMS][HG_ENERGY_PARAMS];
    const char *options[USUAL_TERMS][HG_ENERGY_OPTIONS];
    int n = 0, order[USUAL_TERMS];
    for (; n < USUAL_TERMS && sum[n].energy; n++) { /* by name, as physics orders them */
        int at = n;
        for (; at > 0 && strcmp(sum[order[at - 1]].energy, sum[n].energy) > 0; at--) order[at] = order[at - 1];
        order[at] = n;
    }
    hg_text_add(text, "\n/*");
    for (int t = 0; t < n; t++) {
        const usual_term *usual = &sum[order[t]];
        const hg_energy *energy = hg_energy_find(usual->energy);
        if (!energy) return HG_INVALID;
        HG_TRY(hg_term_complete(&(hg_term){ energy, 1, NULL, usual->options }, params[t], options[t]));
        completed[t] = (hg_term){ energy, 1, params[t], options[t] };
        hg_term_scope(&terms[t].scope, &completed[t], t, HG_ALLOW_WINDOW);
        terms[t].trace = energy->trace;
        terms[t].root = energy->root;
        hg_text_add(text, "%s %s", t ? " +" : "", energy->name);
        for (int k = 0; k < HG_ENERGY_OPTIONS && energy->options[k].name; k++) hg_text_add(text, " %s", options[t][k]);
    }
    hg_text_add(text, " */\n");
    hg_strand_program *program;
    HG_TRY(hg_strand_program_create(&program, dtype, n, terms, 0, NULL, true));
    char name[32];
    snprintf(name, sizeof name, "sum_%d", number);
    hg_strand_print_c(program, name, text);
    *hash = program->hash;
    hg_strand_program_destroy(program);
    return HG_OK;
}

static hg_status print_file(hg_dtype dtype, const char *path)
{
    hg_text text = { 0 };
    uint64_t hash[USUAL_SUMS];
    hg_status status = HG_OK;
    hg_text_add(&text,
                "/* Printed by hairloss/generate_kernels.c. */\n#define HG_BYTES %zu\n"
                "#include \"autograd/trace/strand_vector.h\"\n#include \"base/base.h\"\n",
                hg_dtype_size(dtype));
    for (int i = 0; status == HG_OK && i < USUAL_SUMS; i++) status = print_sum(dtype, i, &text, &hash[i]);
    hg_text_add(&text, "\nstatic const hg_strand_kernel_entry kernels[] = {\n");
    for (int i = 0; status == HG_OK && i < USUAL_SUMS; i++)
        hg_text_add(&text, "    { 0x%016llxu, HG_LANES, HG_BYTES, HG_LEVEL, sum_%d },\n", (unsigned long long)hash[i],
                    i);
    hg_text_add(&text, "};\n\n__attribute__((constructor)) static void hg_register_kernels(void)\n{\n"
                       "    static hg_entry entries[] = {\n");
    for (int i = 0; status == HG_OK && i < USUAL_SUMS; i++)
        hg_text_add(&text,
                    "        { .abi = HG_ABI_VERSION, .kind = \"strand_kernel\", .name = \"%s \" HG_LEVEL \" "
                    "%016llx\", .item = &kernels[%d] },\n",
                    hg_dtype_name(dtype), (unsigned long long)hash[i], i);
    hg_text_add(&text, "    };\n    for (int i = 0; i < %d; i++) hg_register(&entries[i]);\n}\n", USUAL_SUMS);
    if (status == HG_OK && text.failed) status = HG_MEMORY;
    if (status == HG_OK) status = hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}

int main(int argc, char **argv)
{
    if (argc == 3 && print_file(strcmp(argv[1], "f64") == 0 ? HG_F64 : HG_F32, argv[2]) == HG_OK) return 0;
    fprintf(stderr, "generate_kernels: %s\n", argc == 3 ? hg_message() : "usage: generate_kernels f32|f64 FILE.c");
    return 1;
}
