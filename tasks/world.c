/* world: the body, the groom and the clips that a config names, from files or made. */
#include "tasks/hair.h"

#include <math.h>
#include <string.h>

static char *scene_path(const hg_config *config, const char *name)
{
    const char *folder = hg_config_text(config, "scene.folder");
    return name[0] == '/' || !folder[0] ? hg_strdup(name) : hg_path_join(folder, name);
}

/* The sentence of a reader, with the config's file and line before it. */
static hg_status in_config(const hg_config *config, const char *key, hg_status status)
{
    if (status == HG_OK) return HG_OK;
    const int line = hg_config_line(config, key);
    char *message = hg_strdup(hg_message());
    if (!message) return HG_MEMORY;
    status = line > 0 ? hg_fail(status, "%s:%d: %s: %s", hg_config_name(config), line, key, message)
                      : hg_fail(status, "%s: %s: %s", hg_config_name(config), key, message);
    hg_free(message);
    return status;
}

static hg_status load_body(hg_hair_task *task)
{
    const char *name = hg_config_text(task->config, "scene.body");
    if (!name[0]) return hg_bust_create(&task->body);
    char *path = scene_path(task->config, name);
    if (!path) return HG_MEMORY;
    const hg_status status = hg_body_load(&task->body, path);
    hg_free(path);
    return in_config(task->config, "scene.body", status);
}

static hg_status check_groom(const hg_hair_task *task, const hg_groom *groom)
{
    if (groom->strands < 1 || groom->vertices < 2)
        return hg_fail(HG_INVALID, "%s: %lld strands of %lld vertices; at least one strand of two vertices is needed",
                       groom->name ? groom->name : "groom", (long long)groom->strands, (long long)groom->vertices);
    for (int64_t s = 0; s < groom->strands; s++)
        if (groom->root_face[s] < 0 || groom->root_face[s] >= task->body->faces)
            return hg_fail(HG_INVALID,
                           "%s: strand %lld is not bound to a face of the body; fit the groom to the body first "
                           "(hairgrad import groom --body)",
                           groom->name ? groom->name : "groom", (long long)s);
    for (int64_t i = 0; i < groom->strands * groom->vertices * 3; i++)
        if (!isfinite(groom->points[i]))
            return hg_fail(HG_INVALID, "%s: strand %lld has a vertex that is not finite",
                           groom->name ? groom->name : "groom", (long long)(i / 3 / groom->vertices));
    const hg_groom *first = task->styles[0].groom;
    if (first && first != groom && first->vertices != groom->vertices)
        return hg_fail(
            HG_INVALID,
            "%s: strands of %lld vertices, those of %s have %lld; a network has one number of vertices: import "
            "the groom with --vertices %lld",
            groom->name ? groom->name : "groom", (long long)groom->vertices,
            first->name ? first->name : "the first groom", (long long)first->vertices, (long long)first->vertices);
    return HG_OK;
}

/* A groom from its file (`what` ends in .h5), or grown in the style `what`. */
static hg_status make_groom(const hg_hair_task *task, hg_groom **groom, const char *what, bool in_scene)
{
    const hg_config *config = task->config;
    if (strcmp(hg_path_extension(what), "h5"))
        return hg_groom_grow(task->ctx, groom, task->body, what, hg_config_integer(config, "scene.strands"),
                             hg_config_integer(config, "scene.vertices"),
                             (uint64_t)hg_config_integer(config, "scene.seed"));
    char *path = in_scene ? scene_path(config, what) : hg_strdup(what);
    if (!path) return HG_MEMORY;
    hg_status status = hg_groom_load(groom, path);
    if (status == HG_OK && (*groom)->body_hash && (*groom)->body_hash != hg_body_hash(task->body))
        status = hg_fail(HG_INVALID, "%s: the groom is bound to another body; fit it to this one", path);
    hg_free(path);
    return status;
}

static hg_status add_style(hg_hair_task *task, int i, const char *what, bool in_scene)
{
    hg_hair_style *style = &task->styles[i];
    style->name = hg_strdup(what);
    if (!style->name) return HG_MEMORY;
    HG_TRY(make_groom(task, &style->groom, what, in_scene));
    HG_TRY(check_groom(task, style->groom));
    return task->network->choose ? task->network->choose(task, style) : HG_OK;
}

static hg_status load_grooms(hg_hair_task *task)
{
    const hg_config *config = task->config;
    const char *file = hg_config_text(config, "scene.groom"), *list = "scene.grooms";
    const int listed = hg_config_count(config, list);
    if (listed && file[0])
        return hg_fail(HG_INVALID, "%s:%d: %s: either one groom or several", hg_config_name(config),
                       hg_config_line(config, list), list);
    task->styles = hg_alloc((size_t)(listed ? listed : 1), sizeof *task->styles);
    if (!task->styles) return HG_MEMORY;
    if (listed) {
        for (int i = 0; i < listed; i++) {
            task->n_grooms = task->n_styles = i + 1;
            HG_TRY(in_config(config, list, add_style(task, i, hg_config_text_at(config, list, i), true)));
        }
    } else {
        task->n_grooms = task->n_styles = 1;
        HG_TRY(file[0] ? in_config(config, "scene.groom", add_style(task, 0, file, true))
                       : add_style(task, 0, hg_config_text(config, "scene.style"), true));
    }
    task->groom = task->styles[0].groom;
    return HG_OK;
}

void hg_hair_style_destroy(hg_hair_style *style)
{
    hg_groom_destroy(style->groom);
    hg_free(style->name);
    hg_free(style->body_distance);
    hg_free(style->scalp_distance);
    hg_free(style->lock);
    hg_free(style->raw);
    hg_free(style->texel);
    hg_free(style->number);
    *style = (hg_hair_style){ 0 };
}

uint64_t hg_hair_grooms_hash(const hg_hair_task *task)
{
    uint64_t hash = hg_groom_hash(task->styles[0].groom);
    for (int i = 1; i < task->n_grooms; i++) {
        const uint64_t next = hg_groom_hash(task->styles[i].groom);
        hash = hg_hash(&next, sizeof next, hash);
    }
    return hash;
}

static hg_status add_clip(hg_hair_task *task, bool held_out, hg_motion *motion)
{
    hg_hair_clip_data *clip = &task->clips[held_out][task->n_clips[held_out]++];
    clip->motion = motion;
    if (motion->frames < 1)
        return hg_fail(HG_INVALID, "%s: a motion without frames", motion->name ? motion->name : "motion");
    if (fabs(motion->rate - task->rate) > 1e-6 * task->rate) {
        hg_motion *resampled = NULL;
        HG_TRY(hg_motion_resample(&resampled, motion, task->rate));
        hg_motion_destroy(motion);
        clip->motion = resampled;
    }
    return hg_hair_track_create(&clip->track, &task->layout, task->body, clip->motion);
}

/* A training clip again: mirrored, and with made movements of the head on top. The body may touch the hair in ways that
 * a few recordings do not show. */
static hg_status vary_clip(hg_hair_task *task, int file)
{
    const hg_config *config = task->config;
    const hg_motion *motion = task->clips[0][task->n_clips[0] - 1].motion, *mirrored = NULL;
    hg_motion *more = NULL;
    if (hg_config_flag(config, "scene.mirror")) {
        HG_TRY(hg_motion_mirror(&more, motion));
        HG_TRY(add_clip(task, false, more));
        mirrored = task->clips[0][task->n_clips[0] - 1].motion;
    }
    for (int64_t k = 0; k < hg_config_integer(config, "scene.varied"); k++) {
        static const char *const kinds[] = { "mixed", "turn", "nod", "shake" };
        const uint64_t seed =
            (uint64_t)hg_config_integer(config, "scene.seed") * 1000003 + (uint64_t)file * 1009 + (uint64_t)k;
        hg_motion *above = NULL;
        HG_TRY(hg_motion_make(&above, task->body, kinds[k % 4], (double)(motion->frames - 1) / motion->rate,
                              motion->rate, seed));
        const hg_status status = hg_motion_combine(&more, k % 2 && mirrored ? mirrored : motion, above);
        hg_motion_destroy(above);
        HG_TRY(status);
        HG_TRY(add_clip(task, false, more));
    }
    return HG_OK;
}

static hg_status load_clips(hg_hair_task *task, bool held_out)
{
    const hg_config *config = task->config;
    const char *files = held_out ? "scene.held_out" : "scene.motions";
    const char *kinds = held_out ? "scene.held_out_kinds" : "scene.motion_kinds";
    const int n_files = hg_config_count(config, files);
    /* Files of one list and made motions of the other would be compared with each other: files rule both. */
    const bool made = hg_config_count(config, "scene.motions") == 0 && hg_config_count(config, "scene.held_out") == 0;
    const int n = made ? hg_config_count(config, kinds) : n_files;
    const int64_t copies = 2 + hg_config_integer(config, "scene.varied");
    task->clips[held_out] = hg_alloc((size_t)((n ? n : 1) * copies), sizeof(hg_hair_clip_data));
    if (!task->clips[held_out]) return HG_MEMORY;
    for (int i = 0; i < n; i++) {
        hg_motion *motion = NULL;
        if (made) {
            const uint64_t seed =
                (uint64_t)hg_config_integer(config, "scene.seed") * 1000 + (held_out ? 500u : 0u) + (unsigned)i;
            HG_TRY(in_config(config, kinds,
                             hg_motion_make(&motion, task->body, hg_config_text_at(config, kinds, i),
                                            hg_config_number(config, "scene.seconds"), task->rate, seed)));
        } else {
            char *path = scene_path(config, hg_config_text_at(config, files, i));
            if (!path) return HG_MEMORY;
            const hg_status status = hg_motion_load(&motion, path, task->body);
            hg_free(path);
            HG_TRY(in_config(config, files, status));
        }
        HG_TRY(in_config(config, made ? kinds : files, add_clip(task, held_out, motion)));
        if (!made && !held_out) HG_TRY(in_config(config, files, vary_clip(task, i)));
    }
    return HG_OK;
}

/* Distance of every rest vertex to a set of faces of the rest body. */
static hg_status rest_distance(hg_hair_task *task, const hg_groom *groom, const hg_body_tree *tree, bool is_signed,
                               float *out)
{
    const hg_body *body = task->body;
    const int64_t n = groom->strands * groom->vertices;
    hg_body_refit *refit = NULL;
    int32_t *triangle = hg_alloc((size_t)n, sizeof *triangle);
    float *point = hg_alloc((size_t)n * 3, sizeof *point), *normal = hg_alloc((size_t)n * 3, sizeof *normal);
    hg_ctx *ctx = hg_ctx_on_host(task->ctx);
    hg_status status = ctx && triangle && point && normal ? hg_body_refit_create(&refit, tree, HG_F32) : HG_MEMORY;
    if (status == HG_OK) status = hg_body_refit_update(ctx, refit, body->points);
    for (int64_t i = 0; status == HG_OK && i < n; i++) triangle[i] = -1;
    if (status == HG_OK)
        status =
            hg_body_closest(ctx, refit, HG_CONTACT_EXACT, (double)INFINITY, n, groom->points, triangle, point, normal);
    for (int64_t i = 0; status == HG_OK && i < n; i++) {
        const float *x = groom->points + 3 * i, *a = point + 3 * i, *m = normal + 3 * i;
        float distance = 0;
        for (int k = 0; k < 3; k++) distance += m[k] * (x[k] - a[k]);
        out[i] = is_signed ? distance : fabsf(distance);
    }
    hg_body_refit_destroy(refit);
    hg_free(triangle);
    hg_free(point);
    hg_free(normal);
    return status;
}

static hg_status faces_tree(hg_body_tree **tree, const hg_body *body, int64_t n, const int32_t *face)
{
    double *points = hg_alloc((size_t)body->vertices * 3, sizeof *points);
    int32_t *triangles = hg_alloc((size_t)(n ? n : 1) * 3, sizeof *triangles);
    if (!points || !triangles) {
        hg_free(points);
        hg_free(triangles);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < body->vertices * 3; i++) points[i] = (double)body->points[i];
    for (int64_t i = 0; i < n; i++) memcpy(triangles + 3 * i, body->triangles + 3 * face[i], 3 * sizeof *triangles);
    const hg_status status = hg_body_tree_create(tree, body->vertices, points, n, triangles);
    hg_free(points);
    hg_free(triangles);
    return status;
}

static hg_status measure_rest(hg_hair_task *task, hg_hair_style *style)
{
    const hg_body *body = task->body;
    const hg_groom *groom = style->groom;
    const size_t n = (size_t)(groom->strands * groom->vertices);
    style->body_distance = hg_alloc(n, sizeof(float));
    style->scalp_distance = hg_alloc(n, sizeof(float));
    if (!style->body_distance || !style->scalp_distance) return HG_MEMORY;
    hg_body_tree *tree = NULL;
    hg_status status = faces_tree(&tree, body, body->collider_faces, body->collider);
    if (status == HG_OK) status = rest_distance(task, groom, tree, true, style->body_distance);
    hg_body_tree_destroy(tree);
    tree = NULL;
    if (status == HG_OK) status = faces_tree(&tree, body, body->scalp_faces, body->scalp);
    if (status == HG_OK) status = rest_distance(task, groom, tree, false, style->scalp_distance);
    hg_body_tree_destroy(tree);
    return status;
}

/* The tree of what hair can touch, in the numbering of the vertices that the poser keeps. */
static hg_status make_poser(hg_hair_task *task)
{
    HG_TRY(hg_poser_create(&task->poser, task->body, true));
    task->body_vertices = hg_poser_vertices(task->poser);
    task->posed_body = hg_alloc((size_t)task->body_vertices * 3, sizeof(float));
    double *points = hg_alloc((size_t)task->body_vertices * 3, sizeof *points);
    if (!task->posed_body || !points) {
        hg_free(points);
        return HG_MEMORY;
    }
    const int32_t *vertex = hg_poser_vertex(task->poser);
    for (int64_t i = 0; i < task->body_vertices; i++)
        for (int k = 0; k < 3; k++) points[3 * i + k] = (double)task->body->points[3 * vertex[i] + k];
    int64_t faces = 0;
    const int32_t *triangles = hg_poser_collider(task->poser, &faces);
    const hg_status status = hg_body_tree_create(&task->tree, task->body_vertices, points, faces, triangles);
    hg_free(points);
    return status;
}

hg_status hg_hair_world_create(hg_hair_task *task, const hg_progress *progress)
{
    const hg_config *config = task->config;
    task->rate = hg_config_number(config, "scene.rate");
    hg_progress_report(progress, 0, "body and groom");
    HG_TRY(load_body(task));
    if (task->body->scalp_faces < 1)
        return hg_fail(HG_INVALID,
                       "%s: the body has no scalp, so no hair can grow on it; name its scalp faces when it "
                       "is imported",
                       hg_config_text(config, "scene.body"));
    HG_TRY(load_grooms(task));
    HG_TRY(hg_hair_layout_create(&task->layout, config, task->body));
    HG_TRY(load_clips(task, false));
    HG_TRY(load_clips(task, true));
    for (int i = 0; i < task->n_clips[0]; i++) task->training_frames += task->clips[0][i].motion->frames;
    if (task->training_frames < 1)
        return hg_fail(HG_INVALID, "%s: scene.motions: there is no motion to train on", hg_config_name(config));
    for (int k = 0; k < HG_SHAPES; k++)
        task->spread[k] = task->body->shape_spread[k] * hg_config_number(config, "shapes.spread");
    HG_TRY(make_poser(task));
    for (int i = 0; i < task->n_grooms; i++) HG_TRY(measure_rest(task, &task->styles[i]));
    return HG_OK;
}

/* ---- another groom ------------------------------------------------------------------------------------------ */

static bool is_called(const hg_hair_style *style, const char *name)
{
    const char *slash = strrchr(style->name, '/'), *last = slash ? slash + 1 : style->name, *dot = strrchr(last, '.');
    return !strcmp(style->name, name) || !strcmp(last, name) ||
           (dot && strlen(name) == (size_t)(dot - last) && !strncmp(last, name, strlen(name)));
}

/* One more, behind those there are. */
static hg_status load_style(hg_hair_task *task, const char *name)
{
    hg_hair_style *styles = hg_alloc((size_t)task->n_styles + 1, sizeof *styles), *style = styles + task->n_styles;
    if (!styles) return HG_MEMORY;
    memcpy(styles, task->styles, (size_t)task->n_styles * sizeof *styles);
    hg_free(task->styles);
    task->styles = styles;
    hg_status status = add_style(task, task->n_styles, name, false);
    if (status == HG_OK) status = measure_rest(task, style);
    if (status == HG_OK) status = hg_hair_style_strands(task, style);
    if (status == HG_OK)
        task->n_styles++;
    else
        hg_hair_style_destroy(style);
    return status;
}

hg_status hg_hair_find_groom(hg_hair_task *task, const char *name, int *groom)
{
    for (*groom = 0; *groom < task->n_styles; ++*groom)
        if (is_called(&task->styles[*groom], name)) return HG_OK;
    return load_style(task, name); /* one that was not trained on */
}

hg_status hg_hair_choose_groom(hg_hair_task *task, const char *name)
{
    int found;
    HG_TRY(hg_hair_find_groom(task, name, &found));
    if (found != task->current) hg_hair_subset_destroy(&task->evaluation);
    task->current = found;
    task->groom = task->styles[found].groom;
    return HG_OK;
}
