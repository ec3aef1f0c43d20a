/* report (private to autograd/trace and hairloss): what becomes of formulas, as text. */
#ifndef HG_TRACE_REPORT_H
#define HG_TRACE_REPORT_H

#include "autograd/trace/strand.h"

/* A formula and the scope that it is traced in. */
typedef struct {
    hg_trace_scope scope;
    hg_scalar (*formula)(void);
} hg_report_formula;

/* Operations asked for, folded, shared, dead, added by the derivative, and how often each is computed. wrt: HG_ALLOW(kind) of
 * what the derivative is taken in, beside the given inputs. */
hg_status hg_report_counts(int n, const hg_report_formula *formulas, uint32_t wrt, int n_given, const hg_given *given,
                           hg_text *text);

/* What a strand program computes once per call, groom, strand, and how many instructions are left at each site. */
void hg_report_program(const hg_strand_program *program, int n_terms, const hg_strand_term *terms, hg_text *text);

#endif
