/* material: parameters of energies that are not one number of the config. An input of the network: drawn for every frame of
 * a step, log-uniform in its range, and told to the network as its decimal logarithm; a drape says which value it has.
 * Learnt: value exp(theta), which stays positive, with theta a parameter like the network's own. The energy that a training
 * minimises is smallest without any stiffness: a parameter is learnt where something holds against it.
 *
 * Rising (`ramp`): the stiffness of an energy starts at a part of its value and rises by the same factor in every step. Contact is
 * ten thousand times as stiff as the weight of a hair: learnt at once, it lifts all hair off the body, and from there hair sinks
 * slowly. */
#include "tasks/hair.h"

#include <math.h>
#include <string.h>

enum { STREAM_MATERIAL = 7210 }; /* and one more for each */

/* ---- what the config says ------------------------------------------------------------------------------------ */

static hg_status refuse(const hg_config *config, const char *key, const char *what)
{
    return hg_fail(HG_INVALID, "%s:%d: %s: %s", hg_config_name(config), hg_config_line(config, key), key, what);
}

static hg_status add_conditioned(hg_hair_task *task, const char *key, int term, int param)
{
    const hg_config *config = task->config;
    const hg_energy *energy = task->terms.term[term].energy;
    if (hg_config_count(config, key) != 2)
        return refuse(config, key, "two numbers are needed: the lowest and the highest");
    if (task->n_materials == HG_HAIR_MATERIALS) return refuse(config, key, "too many materials at once");
    hg_hair_material *m = &task->materials[task->n_materials++];
    *m = (hg_hair_material){ .name = hg_format("%s.%s", energy->name, energy->params[param].name),
                             .unit = energy->params[param].unit,
                             .low = hg_config_number_at(config, key, 0),
                             .high = hg_config_number_at(config, key, 1),
                             .value = task->terms.params[term][param] };
    if (!m->name) return HG_MEMORY;
    if (!(m->low > 0 && m->high > m->low && isfinite(m->high)))
        return refuse(config, key, "the lowest has to be positive, and the highest above it");
    if (!(m->value >= m->low && m->value <= m->high))
        return hg_fail(HG_INVALID,
                       "%s:%d: %s: losses.%s is %g %s, which is not between %g and %g: it is what a drape has when "
                       "nothing else is said",
                       hg_config_name(config), hg_config_line(config, key), key, m->name, m->value,
                       m->unit ? m->unit : "", m->low, m->high);
    return HG_OK;
}

static hg_status add_learnt(hg_hair_task *task, const char *key, int term, int param)
{
    const hg_config *config = task->config;
    const hg_energy *energy = task->terms.term[term].energy;
    if (task->n_learnt == HG_HAIR_MATERIALS) return refuse(config, key, "too many parameters are learnt at once");
    hg_hair_learnt *l = &task->learnt[task->n_learnt++];
    l->name = hg_format("%s.%s", energy->name, energy->params[param].name);
    l->report = hg_format("material.%s", l->name ? l->name : "");
    l->start = task->terms.params[term][param];
    if (!l->name || !l->report) return HG_MEMORY;
    if (!(l->start > 0)) return refuse(config, key, "what is learnt starts from its value, which has to be positive");
    for (int i = 0; i < task->n_materials; i++)
        if (!strcmp(task->materials[i].name, l->name))
            return refuse(config, key, "it is an input of the network already");
    l->theta = hg_tensor_create(task->ctx, HG_F32, 0, NULL);
    if (!l->theta) return HG_MEMORY;
    l->theta->name = l->report;
    return hg_require_grad(l->theta);
}

static hg_status add_ramps(hg_hair_task *task)
{
    const hg_config *config = task->config;
    char key[192];
    task->ramp_steps = hg_config_number(config, "training.ramp") * (double)hg_config_integer(config, "training.steps");
    for (int t = 0; t < task->terms.n; t++) {
        const hg_energy *energy = task->terms.term[t].energy;
        snprintf(key, sizeof key, "losses.%s.ramp", energy->name);
        int k = 0;
        while (k < HG_ENERGY_PARAMS && energy->params[k].name && strcmp(energy->params[k].name, "stiffness")) k++;
        if (k == HG_ENERGY_PARAMS || !energy->params[k].name || hg_config_number(config, key) == 1) continue;
        if (!(hg_config_number(config, key) > 0)) return refuse(config, key, "a part of the stiffness, above 0");
        if (task->n_ramps == HG_HAIR_MATERIALS) return refuse(config, key, "too many stiffnesses rise at once");
        hg_hair_ramp *r = &task->ramps[task->n_ramps++];
        *r = (hg_hair_ramp){ .name = hg_format("%s.stiffness", energy->name),
                             .value = task->terms.params[t][k],
                             .start = hg_config_number(config, key) };
        if (!r->name) return HG_MEMORY;
        for (int i = 0; i < task->n_materials; i++)
            if (!strcmp(task->materials[i].name, r->name))
                return refuse(config, key, "its stiffness is an input of the network already");
        for (int i = 0; i < task->n_learnt; i++)
            if (!strcmp(task->learnt[i].name, r->name)) return refuse(config, key, "its stiffness is learnt already");
    }
    return HG_OK;
}

hg_status hg_hair_materials_create(hg_hair_task *task)
{
    const hg_config *config = task->config;
    char key[192];
    for (int t = 0; t < task->terms.n; t++) {
        const hg_energy *energy = task->terms.term[t].energy;
        for (int k = 0; k < HG_ENERGY_PARAMS && energy->params[k].name; k++) {
            snprintf(key, sizeof key, "features.materials.%s.%s", energy->name, energy->params[k].name);
            if (hg_config_count(config, key)) HG_TRY(add_conditioned(task, key, t, k));
        }
    }
    const hg_energy *energies[256]; /* an input that no energy has is a mistake */
    const int n = hg_hair_energies(energies);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < HG_ENERGY_PARAMS && energies[i]->params[k].name; k++) {
            bool active = false;
            for (int t = 0; t < task->terms.n; t++) active |= task->terms.term[t].energy == energies[i];
            snprintf(key, sizeof key, "features.materials.%s.%s", energies[i]->name, energies[i]->params[k].name);
            if (!active && hg_config_count(config, key))
                return refuse(config, key, "this energy is not among `losses:`");
        }
    for (int t = 0; t < task->terms.n; t++) {
        const hg_energy *energy = task->terms.term[t].energy;
        snprintf(key, sizeof key, "losses.%s.learn", energy->name);
        if (!energy->params[0].name) continue;
        for (int i = 0; i < hg_config_count(config, key); i++) {
            const char *name = hg_config_text_at(config, key, i);
            int k = 0;
            while (k < HG_ENERGY_PARAMS && energy->params[k].name && strcmp(energy->params[k].name, name)) k++;
            if (k == HG_ENERGY_PARAMS || !energy->params[k].name)
                return hg_fail(HG_INVALID, "%s:%d: %s: %s has no parameter \"%s\"", hg_config_name(config),
                               hg_config_line(config, key), key, energy->name, name);
            HG_TRY(add_learnt(task, key, t, k));
        }
    }
    task->layout.materials = task->n_materials;
    return add_ramps(task);
}

void hg_hair_materials_destroy(hg_hair_task *task)
{
    for (int i = 0; i < task->n_materials; i++) hg_free(task->materials[i].name);
    for (int i = 0; i < task->n_ramps; i++) hg_free(task->ramps[i].name);
    for (int i = 0; i < task->n_learnt; i++) {
        hg_tensor_destroy(task->learnt[i].theta);
        hg_free(task->learnt[i].name);
        hg_free(task->learnt[i].report);
    }
    hg_free(task->whole_params);
}

/* The network with what is learnt beside it, as the trainer and the checkpoints see it. */
hg_status hg_hair_whole_model(hg_hair_task *task)
{
    const int n = task->model->n_params;
    task->whole = *task->model;
    if (!task->n_learnt) return HG_OK;
    task->whole_params = hg_alloc((size_t)(n + task->n_learnt), sizeof(hg_tensor *));
    if (!task->whole_params) return HG_MEMORY;
    memcpy(task->whole_params, task->model->params, (size_t)n * sizeof(hg_tensor *));
    for (int i = 0; i < task->n_learnt; i++) task->whole_params[n + i] = task->learnt[i].theta;
    task->whole.params = task->whole_params;
    task->whole.n_params = n + task->n_learnt;
    return HG_OK;
}

/* ---- values -------------------------------------------------------------------------------------------------- */

void hg_hair_draw_materials(const hg_hair_task *task, uint64_t seed, uint64_t counter, int64_t step, double *values)
{
    for (int i = 0; i < task->n_ramps; i++) {
        const hg_hair_ramp *r = &task->ramps[i];
        const double risen = step < 0 || !((double)step < task->ramp_steps) ? 1 : (double)step / task->ramp_steps;
        values[task->n_materials + i] = r->value * pow(r->start, 1 - risen);
    }
    for (int i = 0; i < task->n_materials; i++) {
        const hg_hair_material *m = &task->materials[i];
        const double along = hg_random_uniform(seed, STREAM_MATERIAL + (uint64_t)i, counter);
        values[i] = m->low * pow(m->high / m->low, along);
    }
}

void hg_hair_material_features(const hg_hair_task *task, const double *values, float *frame)
{
    float *out = frame + task->layout.frame_inputs - task->n_materials;
    for (int i = 0; i < task->n_materials; i++) out[i] = (float)log10(values ? values[i] : task->materials[i].value);
}

hg_status hg_hair_set_material(hg_hair_task *task, const char *name, double value)
{
    hg_text known = { 0 };
    for (int i = 0; i < task->n_materials; i++) {
        hg_hair_material *m = &task->materials[i];
        hg_text_add(&known, "%s%s", i ? ", " : "", m->name);
        if (strcmp(m->name, name)) continue;
        hg_text_free(&known);
        if (!(value >= m->low && value <= m->high))
            return hg_fail(HG_INVALID, "%s: %g %s; the network was trained from %g to %g", name, value,
                           m->unit ? m->unit : "", m->low, m->high);
        m->value = value;
        return HG_OK;
    }
    const hg_status status = hg_fail(HG_INVALID, "%s is no input of this network; its materials are: %s", name,
                                     known.data ? known.data : "none (features.materials)");
    hg_text_free(&known);
    return status;
}

int hg_hair_materials(const hg_hair_task *task) { return task->n_materials; }

hg_status hg_hair_material_at(const hg_hair_task *task, int i, const char **name, const char **unit, double range[2],
                              double *value)
{
    if (i < 0 || i >= task->n_materials) return hg_fail(HG_INVALID, "there is no material %d", i);
    const hg_hair_material *m = &task->materials[i];
    *name = m->name;
    *unit = m->unit;
    range[0] = m->low;
    range[1] = m->high;
    *value = m->value;
    return HG_OK;
}

void hg_hair_report_learnt(const hg_hair_task *task, hg_ctx *ctx, hg_report *report)
{
    hg_no_grad_begin(ctx);
    for (int i = 0; i < task->n_learnt; i++)
        hg_report_later(report, task->learnt[i].report, hg_exp(ctx, task->learnt[i].theta), 0, task->learnt[i].start);
    hg_no_grad_end(ctx);
}
