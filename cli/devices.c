/* hairgrad devices: what can compute here, and why something cannot. */
#include "cli/facts.h"

#include <string.h>

enum { MOST = 64 };

static void print_table(const hg_device_info *infos, int n)
{
    for (int i = 0; i < n; i++) {
        const hg_device_info *d = &infos[i];
        if (d->why[0]) {
            printf("%-8s not usable: %s\n", d->name, d->why);
            continue;
        }
        printf("%-8s %s, %.1f GB", d->name, d->what, 1e-9 * (double)d->memory);
        if (d->free) printf(" (%.1f GB free)", 1e-9 * (double)d->free);
        printf("%s%s\n", d->versions[0] ? "\n         " : "", d->versions);
    }
}

static void print_json(const hg_device_info *infos, int n)
{
    facts all = { .json = true };
    hg_text_add(&all.out, "[");
    for (int i = 0; i < n; i++) {
        const hg_device_info *d = &infos[i];
        hg_text_add(&all.out, "%s\n  {", i ? "," : "");
        all.count = 0;
        facts_text(&all, "name", d->name);
        facts_text(&all, "what", d->what);
        facts_text(&all, "versions", d->versions);
        facts_count(&all, "memory", (int64_t)d->memory);
        facts_count(&all, "free", (int64_t)d->free);
        facts_text(&all, "why_not", d->why);
        hg_text_add(&all.out, "\n  }");
    }
    hg_text_add(&all.out, "\n]\n");
    if (all.out.data) fputs(all.out.data, stdout);
    hg_text_free(&all.out);
}

static int devices(const hg_arguments *arguments)
{
    hg_device_info infos[MOST];
    int n = hg_devices(infos, MOST);
    if (n > MOST) n = MOST;
    if (cli_flag(arguments, "json"))
        print_json(infos, n);
    else
        print_table(infos, n);
    return 0;
}

static const hg_argument devices_options[] = {
    { "json", NULL, "as JSON: name, what, versions, memory and free [bytes, 0: not known], why_not (empty: it works)",
      false },
};
HG_COMMAND(devices, .what = "what --device can choose here, and why not", .options = devices_options, .n_options = 1,
           .run = devices,
           .more =
               "CUDA is found when the program runs: the driver (libcuda.so.1), NVRTC and cuBLAS of the CUDA toolkit, "
               "and\nfor convolutional networks cuDNN; nothing of it is needed to build or to use the cpu.\n");
