/* check: everything that can be known of a config without training: its keys and units, its files and what is odd in
 * them, the joints of its inputs, its energies, and what it will need of memory. Nothing is written. */
#include "tasks/hair.h"

#include <string.h>

static void add_message(hg_findings *findings, const char *about)
{
    hg_findings_add(findings, HG_ERROR, about, "%s", hg_message());
}

/* Puts the file's name before what was found from `first` on. */
static hg_status name_findings(hg_findings *findings, int first, const char *name)
{
    for (int i = first; i < findings->n; i++) {
        char *text = hg_format("%s: %s", name, findings->list[i].text);
        if (!text) return HG_MEMORY;
        hg_free(findings->list[i].text);
        findings->list[i].text = text;
    }
    return HG_OK;
}

static char *path_of(const hg_config *config, const char *name)
{
    const char *folder = hg_config_text(config, "scene.folder");
    return name[0] == '/' || !folder[0] ? hg_strdup(name) : hg_path_join(folder, name);
}

typedef hg_status (*file_check)(hg_ctx *ctx, hg_findings *findings, const char *path, const hg_body *body);

static hg_status groom_file(hg_ctx *ctx, hg_findings *findings, const char *path, const hg_body *body)
{
    hg_groom *groom;
    hg_curves *curves;
    HG_TRY(hg_groom_load(&groom, path));
    hg_status status = hg_groom_to_curves(&curves, groom);
    hg_groom_destroy(groom);
    HG_TRY(status);
    status = hg_check_groom(ctx, findings, curves, body, NULL);
    hg_curves_destroy(curves);
    return status;
}

static hg_status motion_file(hg_ctx *ctx, hg_findings *findings, const char *path, const hg_body *body)
{
    hg_motion *motion;
    (void)ctx;
    HG_TRY(hg_motion_load(&motion, path, NULL));
    hg_status status = hg_check_motion(findings, motion, body);
    hg_motion_destroy(motion);
    return status;
}

/* One file that the config names; what cannot be read is an error of the config, and the next one is looked at. */
static hg_status check_file(hg_ctx *ctx, hg_findings *findings, const hg_config *config, const char *key,
                            const char *name, const hg_body *body, file_check check)
{
    char *path = path_of(config, name);
    if (!path) return HG_MEMORY;
    int first = findings->n;
    hg_status status = check(ctx, findings, path, body);
    if (status == HG_OK)
        status = name_findings(findings, first, name);
    else if (status != HG_MEMORY) {
        hg_findings_add(findings, HG_ERROR, "file", "line %d, %s: %s", hg_config_line(config, key), key, hg_message());
        status = HG_OK;
    }
    hg_free(path);
    return status;
}

static hg_status check_files(hg_ctx *ctx, hg_findings *findings, const hg_config *config, const hg_body *body)
{
    static const char *const motions[] = { "scene.motions", "scene.held_out" };
    const char *groom = hg_config_text(config, "scene.groom");
    if (groom[0]) HG_TRY(check_file(ctx, findings, config, "scene.groom", groom, body, groom_file));
    for (int i = 0; i < hg_config_count(config, "scene.grooms"); i++) {
        const char *name = hg_config_text_at(config, "scene.grooms", i);
        if (strcmp(hg_path_extension(name), "h5")) continue; /* a style that is grown */
        HG_TRY(check_file(ctx, findings, config, "scene.grooms", name, body, groom_file));
    }
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < hg_config_count(config, motions[k]); i++)
            HG_TRY(check_file(ctx, findings, config, motions[k], hg_config_text_at(config, motions[k], i), body,
                              motion_file));
    return HG_OK;
}

static void check_joints(hg_findings *findings, const hg_config *config, const hg_body *body)
{
    static const char *const keys[] = { "features.pose_joints", "features.velocity_joints" };
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < hg_config_count(config, keys[k]); i++) {
            const char *name = hg_config_text_at(config, keys[k], i);
            if (hg_body_joint(body, name) >= 0 || hg_hair_is_usual_list(config, keys[k]) ||
                hg_hair_is_all_joints(config, keys[k]))
                continue;
            const char *nearest = hg_nearest_of(name, (const char *const *)body->joint_name, (int)body->joints);
            hg_findings_add(findings, HG_ERROR, "joints", "line %d, %s: the body has no joint \"%s\"%s%s",
                            hg_config_line(config, keys[k]), keys[k], name, nearest ? "; did you mean " : "",
                            nearest ? nearest : "");
        }
}

/* All the rest is found out by making what training makes, but for the strand encoder's own training. */
static void check_whole(hg_ctx *ctx, hg_findings *findings, hg_config *config)
{
    hg_hair_task *task = NULL;
    hg_status status = hg_config_set(config, "features.encoder_steps", "1");
    if (status == HG_OK) status = hg_hair_task_create(&task, ctx, config, NULL, NULL);
    if (status != HG_OK) {
        add_message(findings, "training");
        return;
    }
    const hg_feature *feature;
    int n = hg_hair_features(task, &feature), columns = 0;
    for (int i = 0; i < n; i++) columns += strcmp(feature[i].name, "rest") ? feature[i].count : 0;
    int64_t weights = hg_model_weights(hg_hair_model(task));
    double state = 16 * (double)weights / 1e6; /* weights, gradients and Adam's two moments in f32 */
    hg_findings_add(findings, HG_FINE, "network", "%s, %d inputs, %lld weights", hg_hair_model(task)->kind, columns,
                    (long long)weights);
    hg_findings_add(findings, HG_FINE, "memory",
                    "%.1f MB of weights and their state, %.1f MB of a batch; hairgrad train --dry-run measures a step",
                    state, (double)task->batch_bytes / 1e6);
    hg_hair_task_destroy(task);
}

static hg_status check_config(hg_ctx *ctx, hg_findings *findings, hg_config *config)
{
    const char *name = hg_config_text(config, "scene.body");
    const hg_energy *energies[256];
    int n_energies = hg_hair_energies(energies), given = 0;
    hg_body *body = NULL;
    for (int i = 0; i < n_energies; i++) {
        char *key = hg_format("losses.%s", energies[i]->name);
        if (!key) return HG_MEMORY;
        given += hg_config_given(config, key);
        hg_free(key);
    }
    if (given)
        hg_findings_add(findings, HG_FINE, "losses", "%d energies", given);
    else
        hg_findings_add(findings, HG_ERROR, "losses", "no energy is given");
    char *path = path_of(config, name);
    if (!path) return HG_MEMORY;
    hg_status status = name[0] ? hg_body_load(&body, path) : hg_bust_create(&body);
    hg_free(path);
    if (status == HG_MEMORY) return status;
    int first = findings->n;
    if (status != HG_OK) { /* the other files are looked at all the same */
        hg_findings_add(findings, HG_ERROR, "file", "line %d, scene.body: %s", hg_config_line(config, "scene.body"),
                        hg_message());
        status = HG_OK;
    } else if (name[0]) {
        status = hg_check_body(findings, body);
        if (status == HG_OK) status = name_findings(findings, first, name);
    }
    if (status == HG_OK) status = check_files(ctx, findings, config, body);
    if (status == HG_OK && body) check_joints(findings, config, body);
    hg_body_destroy(body);
    if (status == HG_OK && hg_findings_count(findings, HG_ERROR) == 0) check_whole(ctx, findings, config);
    return status;
}

hg_status hg_hair_config_check(hg_ctx *ctx, hg_findings *findings, const char *path)
{
    hg_config *config;
    hg_status status = hg_hair_config_load(&config, path);
    if (status == HG_OK) {
        hg_findings_add(findings, HG_FINE, "config", "every key, type and unit is right");
        status = check_config(ctx, findings, config);
        hg_config_destroy(config);
    } else {
        add_message(findings, "config");
        status = HG_OK;
    }
    return status == HG_OK && findings->failed ? HG_MEMORY : status;
}
