/* What an op may declare, checked when a plug-in is loaded. */
#include "autograd/autograd.h"

#include <string.h>

static hg_status check(const char *name, const void *item)
{
    const hg_op *op = item;
    if (!op || !op->name || strcmp(op->name, name) != 0)
        return hg_fail(HG_INVALID, "op '%s' is registered without its row, or under another name", name);
    if (!op->shape || !op->forward) return hg_fail(HG_INVALID, "op '%s' has no shape check or no forward", name);
    if (op->min_in < 0 || op->max_in < op->min_in || op->max_in > HG_OP_INPUTS)
        return hg_fail(HG_INVALID, "op '%s': %d to %d inputs; 0 to %d are possible", name, op->min_in, op->max_in,
                       HG_OP_INPUTS);
    if (!op->backward && !op->not_differentiable)
        return hg_fail(HG_INVALID, "op '%s' has no backward and does not say .not_differentiable = true", name);
    if (op->backward && (op->n_samples < 1 || !op->samples))
        return hg_fail(HG_INVALID, "op '%s' has no sample inputs, so that its backward cannot be checked", name);
    for (int i = 0; i < op->n_samples; i++)
        if (op->samples[i].n_in < op->min_in || op->samples[i].n_in > op->max_in)
            return hg_fail(HG_INVALID, "op '%s': sample %d has %d inputs, the op takes %d to %d", name, i,
                           op->samples[i].n_in, op->min_in, op->max_in);
    return HG_OK;
}

static const hg_declaration declaration = { check };
HG_REGISTER("declaration", op, &declaration);
