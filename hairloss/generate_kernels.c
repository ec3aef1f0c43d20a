/* Prints the strand kernels of the usual sums of built-in energies, for one number type:
 *
 *     generate_kernels f32|f64 FILE.c
 *
 * Run while the library is built; the file is compiled once per level of the processor's vector instructions. At run
 * time a kernel is found by the hash of the program it was printed from, so one that does not match is never used. */
#include "autograd/trace/strand.h"
#include "hairloss/physics.h"

#include <stdio.h>
#include <string.h>

enum { MAX_TERMS = 12 };

typedef struct {
    const char *energy, *options[HG_ENERGY_OPTIONS];
} row;

/* Energies of a sum, ordered by name as physics orders them. */
static const row sums[][MAX_TERMS] = {
    { { "bend_twist", { 0 } }, { "gravity", { 0 } }, { "inertia", { 0 } }, { "stretch", { 0 } } },
    /* dynamic: what the recipes train with */
    { { "bend_twist", { "smooth", "clamped" } },
      { "body_collision", { "exact", "true" } },
      { "drag", { 0 } },
      { "gravity", { 0 } },
      { "hair_style", { "scalp" } },
      { "inertia", { 0 } },
      { "stretch", { 0 } } },
    { { "bend_twist", { "published", "clamped" } },
      { "body_collision", { "exact", "true" } },
      { "drag", { 0 } },
      { "gravity", { 0 } },
      { "hair_style", { "scalp" } },
      { "inertia", { 0 } },
      { "stretch", { 0 } } },
    /* quasi-static */
    { { "bend_twist", { "smooth", "clamped" } },
      { "body_collision", { "exact", "true" } },
      { "gravity", { 0 } },
      { "hair_style", { "scalp" } },
      { "stretch", { 0 } } },
    { { "bend_twist", { "published", "clamped" } },
      { "body_collision", { "exact", "true" } },
      { "gravity", { 0 } },
      { "hair_style", { "scalp" } },
      { "stretch", { 0 } } },
};
enum { SUMS = sizeof sums / sizeof *sums };

static hg_status print_sum(hg_dtype dtype, int number, hg_text *text, uint64_t *hash)
{
    hg_strand_term terms[MAX_TERMS];
    hg_term completed[MAX_TERMS];
    double params[MAX_TERMS][HG_ENERGY_PARAMS];
    const char *options[MAX_TERMS][HG_ENERGY_OPTIONS];
    int n = 0;
    for (; n < MAX_TERMS && sums[number][n].energy; n++) {
        const hg_energy *energy = hg_energy_find(sums[number][n].energy);
        if (!energy) return HG_INVALID;
        const hg_term term = { energy, 1, NULL, sums[number][n].options };
        HG_TRY(hg_term_complete(&term, params[n], options[n]));
        completed[n] = (hg_term){ energy, 1, params[n], options[n] };
        hg_term_scope(&terms[n].scope, &completed[n], n, HG_ALLOW_WINDOW);
        terms[n].trace = energy->trace;
        terms[n].root = energy->root;
    }
    hg_strand_program *program;
    HG_TRY(hg_strand_program_create(&program, dtype, n, terms, true));
    char name[32];
    snprintf(name, sizeof name, "sum_%d", number);
    hg_text_add(text, "\n/*");
    for (int t = 0; t < n; t++) {
        hg_text_add(text, "%s %s", t ? " +" : "", sums[number][t].energy);
        for (int k = 0; k < HG_ENERGY_OPTIONS && sums[number][t].options[k]; k++)
            hg_text_add(text, " %s", sums[number][t].options[k]);
    }
    hg_text_add(text, " */\n");
    hg_strand_print_c(program, name, text);
    *hash = program->hash;
    hg_strand_program_destroy(program);
    return HG_OK;
}

static hg_status print_file(hg_dtype dtype, const char *path)
{
    hg_text text = { 0 };
    uint64_t hash[SUMS];
    hg_status status = HG_OK;
    hg_text_add(&text,
                "/* Printed by hairloss/generate_kernels.c. */\n#define HG_BYTES %zu\n"
                "#include \"autograd/trace/strand_vector.h\"\n#include \"base/base.h\"\n",
                hg_dtype_size(dtype));
    for (int i = 0; status == HG_OK && i < SUMS; i++) status = print_sum(dtype, i, &text, &hash[i]);
    hg_text_add(&text, "\nstatic const hg_strand_kernel_entry kernels[] = {\n");
    for (int i = 0; status == HG_OK && i < SUMS; i++)
        hg_text_add(&text, "    { 0x%016llxu, HG_LANES, HG_BYTES, HG_LEVEL, sum_%d },\n", (unsigned long long)hash[i],
                    i);
    hg_text_add(&text, "};\n\n__attribute__((constructor)) static void hg_register_kernels(void)\n{\n"
                       "    static hg_entry entries[] = {\n");
    for (int i = 0; status == HG_OK && i < SUMS; i++)
        hg_text_add(
            &text,
            "        { .kind = \"strand_kernel\", .name = \"%s \" HG_LEVEL \" %016llx\", .item = &kernels[%d] },\n",
            hg_dtype_name(dtype), (unsigned long long)hash[i], i);
    hg_text_add(&text, "    };\n    for (int i = 0; i < %d; i++) hg_register(&entries[i]);\n}\n", SUMS);
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
