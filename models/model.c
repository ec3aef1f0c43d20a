/* model: the registry of architectures, and what every model can do: be made, weighed, copied and destroyed. */
#include "models/models.h"

#include <string.h>

hg_status hg_architecture_find(const hg_architecture **architecture, const char *name)
{
    *architecture = hg_find("model", name);
    if (*architecture) return HG_OK;
    const char *near = hg_nearest("model", name);
    return hg_fail(HG_INVALID, "model: there is no architecture \"%s\"%s%s%s", name,
                   near ? "; did you mean \"" : "; one of a plug-in is known once --plugin has loaded it",
                   near ? near : "", near ? "\"?" : "");
}

hg_status hg_model_create(hg_model **model, hg_ctx *ctx, const char *architecture, const hg_model_spec *spec)
{
    *model = NULL;
    const hg_architecture *found;
    HG_TRY(hg_architecture_find(&found, architecture));
    if (spec->inputs < 1 || spec->outputs < 1 || spec->width < 1 || spec->depth < 1 || spec->strand_inputs < 0 ||
        spec->strand_inputs > spec->inputs)
        return hg_fail(HG_INVALID,
                       "model: %d inputs (%d of a strand), %d outputs, %d layers of %d: all of them must be positive",
                       spec->inputs, spec->strand_inputs, spec->outputs, spec->depth, spec->width);
    return found->create(model, ctx, spec);
}

void hg_model_destroy(hg_model *model)
{
    if (model) model->destroy(model->self);
}

int64_t hg_model_weights(const hg_model *model)
{
    int64_t count = 0;
    for (int i = 0; i < model->n_params; i++) count += hg_tensor_count(model->params[i]);
    return count;
}

hg_status hg_model_copy(hg_model *to, const hg_model *from)
{
    if (strcmp(to->kind, from->kind) || to->n_params != from->n_params)
        return hg_fail(HG_INVALID, "model: a %s of %d parameters cannot take those of a %s of %d", to->kind,
                       to->n_params, from->kind, from->n_params);
    for (int i = 0; i < to->n_params; i++) {
        char a[96], b[96];
        bool same = to->params[i]->rank == from->params[i]->rank;
        for (int k = 0; same && k < to->params[i]->rank; k++)
            same = to->params[i]->shape[k] == from->params[i]->shape[k];
        if (!same)
            return hg_fail(HG_INVALID, "model: %s is %s in one network and %s in the other", to->params[i]->name,
                           hg_shape_text(to->params[i], a), hg_shape_text(from->params[i], b));
    }
    for (int i = 0; i < to->n_params; i++) HG_TRY(hg_tensor_copy(to->params[i], from->params[i]));
    return HG_OK;
}

hg_tensor *hg_encode(const hg_model *model, hg_ctx *ctx, hg_tensor *x)
{
    if (model->encode) return model->encode(model->self, ctx, x);
    hg_ctx_fail(ctx, HG_INVALID, "hg_encode: a %s is no autoencoder: it has no code", model->kind);
    return NULL;
}

static hg_status check(const char *name, const void *item)
{
    const hg_architecture *architecture = item;
    if (!architecture || !architecture->name || strcmp(architecture->name, name) != 0)
        return hg_fail(HG_INVALID, "model '%s' is registered without its architecture, or under another name", name);
    if (!architecture->create || !architecture->what)
        return hg_fail(HG_INVALID, "model '%s' has no create, or does not say what it is", name);
    return HG_OK;
}

static const hg_declaration declaration = { check };
HG_REGISTER("declaration", model, &declaration);
