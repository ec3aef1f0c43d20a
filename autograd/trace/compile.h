/* compile (private to autograd/trace and hairloss): a strand program that was not printed when the library was built is
 * printed now, compiled by the system's C compiler, kept in the user's cache and loaded.
 *
 *   HAIRGRAD_COMPILE=0   never
 *   HAIRGRAD_CC          the compiler, with its first arguments ("ccache gcc"); else cc, gcc, clang, whichever is there
 *   HAIRGRAD_CACHE       the folder of the cache (see base/cache.h)
 *
 * What is loaded stays for the life of the process. Any thread may call, also after a fork; two processes that make the
 * same kernel at once both succeed. */
#ifndef HG_TRACE_COMPILE_H
#define HG_TRACE_COMPILE_H

#include "autograd/trace/strand.h"

typedef struct {
    const hg_strand_kernel_entry *kernel; /* lives as long as the process */
    char by[48];                          /* "gcc 12.2.0" */
    double seconds;                       /* that the compiler took; 0: it was there already */
} hg_compiled_kernel;

/* HG_UNSUPPORTED, and hg_message says why, where it cannot be done: no compiler, no cache, or it is turned off. */
hg_status hg_strand_compile(const hg_strand_program *program, hg_compiled_kernel *compiled);

/* The whole file that is compiled: the headers, the printed function, what the library looks for when it is loaded. */
void hg_strand_print_file(const hg_strand_program *program, hg_text *text);

#endif
