/* Puts text files into the library:
 *
 *     generate_texts OUT.c NAME FILE... [-- NAME FILE...]...
 *
 * gives `const char NAME[]`, the files one after the other without the lines that include each other (#include "..."). A
 * NAME that ends in "=" is kept as it is, includes and all. With `NAME[] ROOT FILE...` the files are kept apart, under their paths
 * from ROOT: `hg_kernel_file NAME[]` of tensor/cuda/device.h, and with them the three headers of C that NVRTC has not: empty but for
 * the types, since its functions are there without. Run while the library is built. */
#include <stdio.h>
#include <string.h>

static int put_file(FILE *to, const char *path, int whole)
{
    FILE *from = fopen(path, "r");
    if (!from) return 0;
    char line[4096];
    while (fgets(line, sizeof line, from)) {
        if (!whole && strncmp(line, "#include \"", 10) == 0) continue;
        for (const char *at = line; *at; at++) fprintf(to, "%d,", *at);
        fputc('\n', to);
    }
    return fclose(from) == 0;
}

/* The files below words[i] that follow it, up to "--": where the words go on. */
static int put_table(FILE *to, const char *name, int count, char **words, int i)
{
    const char *root = words[i++];
    const int first = i, length = (int)strlen(name) - 2;
    for (; i < count && strcmp(words[i], "--") != 0; i++) {
        char path[4096];
        fprintf(to, "static const char file_%d[] = {\n", i);
        if (snprintf(path, sizeof path, "%s/%s", root, words[i]) >= (int)sizeof path || !put_file(to, path, 1))
            return fprintf(stderr, "generate_texts: %s/%s cannot be read\n", root, words[i]), -1;
        fprintf(to, "0 };\n");
    }
    fprintf(to,
            "typedef struct { const char *name, *text; } hg_kernel_file;\nextern const hg_kernel_file %.*s[];\n"
            "const hg_kernel_file %.*s[] = {\n",
            length, name, length, name);
    for (int k = first; k < i; k++) fprintf(to, "{ \"%s\", file_%d },\n", words[k], k);
    fprintf(to,
            "{ \"math.h\", \"\" }, { \"stdint.h\", \"typedef signed char int8_t; typedef unsigned char uint8_t; "
            "typedef short int16_t; typedef unsigned short uint16_t; typedef int int32_t; typedef unsigned uint32_t; "
            "typedef long long int64_t; typedef unsigned long long uint64_t;\\n\" }, { \"string.h\", \"\" }, { 0, 0 } "
            "};\n");
    return i;
}

int main(int count, char **words)
{
    FILE *to = count > 1 ? fopen(words[1], "w") : NULL;
    if (!to) {
        fprintf(stderr, "usage: generate_texts OUT.c NAME FILE... [-- NAME FILE...]...\n");
        return 1;
    }
    fprintf(to, "/* Made by base/generate_texts.c. */\n");
    for (int i = 2; i < count; i++) {
        const size_t length = strlen(words[i]);
        if (length > 2 && i + 1 < count && strcmp(words[i] + length - 2, "[]") == 0) {
            i = put_table(to, words[i], count, words, i + 1);
            if (i < 0) return 1;
            continue;
        }
        const int whole = length > 0 && words[i][length - 1] == '=';
        fprintf(to, "extern const char %.*s[];\nconst char %.*s[] = {\n", (int)length - whole, words[i],
                (int)length - whole, words[i]);
        for (i++; i < count && strcmp(words[i], "--") != 0; i++)
            if (!put_file(to, words[i], whole)) {
                fprintf(stderr, "generate_texts: %s cannot be read\n", words[i]);
                return 1;
            }
        fprintf(to, "0 };\n");
    }
    return fclose(to) == 0 ? 0 : 1;
}
