/* hairgrad info: what a groom, body, motion, posed scene, drape, checkpoint or run holds, as text or JSON; and files of
 * other programs that a reader knows (info_foreign.c). */
#include "cli/facts.h"
#include "geometry/vector.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- kinds of files ----------------------------------------------------------------------------------------- */

enum { TEXTURE = 64 }; /* the usual size for networks of textures */

/* How many strands stay when the groom becomes a texture. Of roots that no body has given a UV there is nothing to say. */
static void add_texture(facts *f, const hg_groom *g, int64_t bound)
{
    hg_texture *texture;
    if (bound < g->strands || hg_texture_create(&texture, g, TEXTURE) != HG_OK) return;
    facts_count(f, "strands_in_64x64_texture", texture->kept);
    hg_texture_destroy(texture);
}

static hg_status about_groom(facts *f, const char *path)
{
    hg_groom *g;
    HG_TRY(hg_groom_load(&g, path));
    double shortest = INFINITY, longest = 0, sum = 0;
    int64_t bound = 0, n = g->vertices;
    for (int64_t s = 0; s < g->strands; s++) {
        double length = 0;
        for (int64_t v = 1; v < n; v++) {
            hg_vec3f a = hg_vec3f_load(g->points + 3 * (s * n + v)), b = hg_vec3f_load(g->points + 3 * (s * n + v - 1));
            length += hg_vec3d_distance(hg_vec3d_from_f(a), hg_vec3d_from_f(b));
        }
        shortest = fmin(shortest, length), longest = fmax(longest, length), sum += length;
        bound += g->root_face[s] >= 0;
    }
    facts_text(f, "name", g->name);
    facts_count(f, "strands", g->strands);
    facts_count(f, "vertices_per_strand", n);
    facts_number(f, "shortest", shortest, "m");
    facts_number(f, "mean_length", sum / (double)g->strands, "m");
    facts_number(f, "longest", longest, "m");
    facts_count(f, "bound_roots", bound);
    add_texture(f, g, bound);
    facts_extent(f, g->points, g->strands * n);
    facts_hash(f, "body_hash", g->body_hash);
    facts_hash(f, "hash", hg_groom_hash(g));
    hg_groom_destroy(g);
    return HG_OK;
}

static hg_status about_body(facts *f, const char *path)
{
    hg_body *b;
    HG_TRY(hg_body_load(&b, path));
    double area = 0;
    for (int64_t i = 0; i < b->scalp_faces; i++) {
        hg_vec3f p[3];
        for (int c = 0; c < 3; c++)
            p[c] = hg_vec3f_load(b->points + 3 * (int64_t)b->triangles[3 * (int64_t)b->scalp[i] + c]);
        area += 0.5 * (double)hg_vec3f_norm(hg_vec3f_cross(hg_vec3f_sub(p[1], p[0]), hg_vec3f_sub(p[2], p[0])));
    }
    facts_count(f, "vertices", b->vertices);
    facts_count(f, "faces", b->faces);
    facts_count(f, "joints", b->joints);
    facts_texts(f, "joint_names", b->joint_name, b->joints);
    facts_texts(f, "shapes", b->shape_name, HG_SHAPES);
    facts_numbers(f, "shape_spread", HG_SHAPES, b->shape_spread, "");
    facts_count(f, "scalp_faces", b->scalp_faces);
    facts_number(f, "scalp_area", area, "m2");
    facts_count(f, "collider_faces", b->collider_faces);
    facts_extent(f, b->points, b->vertices);
    facts_hash(f, "hash", hg_body_hash(b));
    hg_body_destroy(b);
    return HG_OK;
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* How fast the joint of this name turns against its parents' parents: the sum of local turns from Neck to Head. */
static hg_status add_head_speed(facts *f, const hg_motion *m)
{
    static const char *const chain[5] = { "Neck", "Neck1", "Head", "neck", "head" };
    if (m->frames < 2) return HG_OK;
    double *speed = hg_alloc((size_t)m->frames, sizeof *speed);
    if (!speed) return HG_MEMORY;
    hg_quatd before = hg_quatd_identity();
    bool found = false;
    for (int64_t t = 0; t < m->frames; t++) {
        hg_quatd turn = hg_quatd_identity();
        for (int i = 0; i < 5; i++)
            for (int64_t j = 0; j < m->joints; j++) {
                if (strcmp(m->joint_name[j], chain[i]) != 0) continue;
                hg_quatd local = hg_quatd_from_f(hg_quatf_load(m->rotation + 4 * (t * m->joints + j)));
                turn = hg_quatd_mul(turn, hg_quatd_normalize(local)), found = true;
            }
        hg_vec3d step = hg_quatd_to_rotation_vector(hg_quatd_mul(turn, hg_quatd_conj(before)));
        if (t > 0) speed[t - 1] = hg_vec3d_norm(step) * m->rate * 180 / 3.14159265358979323846;
        before = turn;
    }
    if (found) {
        qsort(speed, (size_t)m->frames - 1, sizeof *speed, compare);
        facts_number(f, "head_speed_median", speed[(m->frames - 1) / 2], "degrees/s");
        facts_number(f, "head_speed_highest", speed[m->frames - 2], "degrees/s");
    }
    hg_free(speed);
    return HG_OK;
}

static hg_status about_motion(facts *f, const char *path)
{
    hg_motion *m;
    HG_TRY(hg_motion_load(&m, path, NULL));
    facts_text(f, "name", m->name);
    facts_count(f, "frames", m->frames);
    facts_number(f, "rate", m->rate, "1/s");
    facts_number(f, "seconds", (double)(m->frames - 1) / m->rate, "s");
    facts_count(f, "joints", m->joints);
    facts_texts(f, "joint_names", m->joint_name, m->joints);
    hg_status status = add_head_speed(f, m);
    facts_extent(f, m->translation, m->frames);
    hg_motion_destroy(m);
    return status;
}

static void add_attribute(facts *f, hg_h5 *file, const char *object, const char *name)
{
    char *text;
    double number;
    if (hg_h5_get_text(file, object, name, &text) == HG_OK) {
        facts_text(f, name, text);
        hg_free(text);
    } else if (hg_h5_get_number(file, object, name, &number) == HG_OK) {
        facts_number(f, name, number, "");
    }
}

static void add_shape(facts *f, hg_h5 *file, const char *name)
{
    int64_t shape[6];
    int rank;
    double sizes[6];
    if (!hg_h5_has(file, name) || hg_h5_shape(file, name, &rank, shape) != HG_OK) return;
    for (int i = 0; i < rank; i++) sizes[i] = (double)shape[i];
    facts_numbers(f, name + (name[0] == '/'), rank, sizes, "");
}

static void about_posed(facts *f, hg_h5 *file)
{
    static const char *const attributes[] = { "motion", "groom",   "rate",      "first_frame",
                                              "unit",   "up_axis", "body_hash", "groom_hash" };
    static const char *const datasets[] = { "/body_vertices", "/triangles",     "/joints", "/joint_rotation",
                                            "/root_rotation", "/root_position", "/strands" };
    for (size_t i = 0; i < sizeof attributes / sizeof *attributes; i++) add_attribute(f, file, "/", attributes[i]);
    for (size_t i = 0; i < sizeof datasets / sizeof *datasets; i++) add_shape(f, file, datasets[i]);
}

static void about_drape(facts *f, hg_h5 *file)
{
    static const char *const attributes[] = { "T", "S", "V", "rate", "unit", "up", "generator" };
    for (size_t i = 0; i < sizeof attributes / sizeof *attributes; i++) add_attribute(f, file, "/", attributes[i]);
    add_attribute(f, file, "hairgrad", "body");
    add_shape(f, file, "/VTKHDF/Points");
}

static void add_scalar(facts *f, hg_h5 *file, const char *name)
{
    double *value;
    if (!hg_h5_has(file, name) || hg_h5_read(file, name, HG_F64, 1, (int64_t[]){ 1 }, NULL, (void **)&value) != HG_OK)
        return;
    facts_number(f, name + 1, value[0], "");
    hg_free(value);
}

static void about_checkpoint(facts *f, hg_h5 *file)
{
    add_attribute(f, file, "/model", "kind");
    add_attribute(f, file, "/", "backend");
    add_attribute(f, file, "/", "config_hash");
    add_scalar(f, file, "/step");
    add_scalar(f, file, "/seconds");
    add_scalar(f, file, "/best_validation");
}

static hg_status about_other(facts *f, hg_h5 *file, const char *path)
{
    if (hg_h5_has(file, "/VTKHDF")) {
        facts_text(f, "kind", "drape");
        about_drape(f, file);
    } else if (hg_h5_has(file, "/model")) {
        facts_text(f, "kind", "checkpoint");
        about_checkpoint(f, file);
    } else {
        return hg_fail(HG_FORMAT,
                       "%s: no groom, body, motion, posed scene, drape or checkpoint; docs/formats.md has them", path);
    }
    return HG_OK;
}

static hg_status about_file(facts *f, const char *path)
{
    hg_h5 *file;
    char *format;
    HG_TRY(hg_h5_open(&file, path));
    if (hg_h5_get_text(file, "/", "format", &format) != HG_OK) {
        hg_status status = about_other(f, file, path);
        hg_h5_close(file);
        return status;
    }
    static const struct {
        const char *format;
        hg_status (*about)(facts *, const char *);
    } kinds[] = { { "hairgrad groom", about_groom },
                  { "hairgrad body", about_body },
                  { "hairgrad motion", about_motion } };
    hg_status status = HG_OK;
    bool posed = strcmp(format, "hairgrad posed scene") == 0;
    facts_text(f, "kind", strncmp(format, "hairgrad ", 9) ? format : format + 9);
    if (posed) about_posed(f, file);
    hg_h5_close(file);
    for (int i = 0; i < 3; i++)
        if (strcmp(format, kinds[i].format) == 0) status = kinds[i].about(f, path);
    hg_free(format);
    return status;
}

/* ---- the command -------------------------------------------------------------------------------------------- */

/* A run folder is known by the checkpoint in it. */
static hg_status about(facts *f, const char *path)
{
    char *checkpoint = hg_path_join(path, "checkpoint.h5");
    if (!checkpoint) return HG_MEMORY;
    if (info_is_foreign(path)) {
        hg_free(checkpoint);
        return info_foreign(f, path);
    }
    if (!hg_file_exists(checkpoint)) {
        hg_free(checkpoint);
        return about_file(f, path);
    }
    facts_text(f, "checkpoint", checkpoint);
    hg_status status = about_file(f, checkpoint);
    hg_free(checkpoint);
    return status;
}

static int info(const hg_arguments *arguments)
{
    facts all = { .json = cli_flag(arguments, "json") };
    if (all.json) hg_text_add(&all.out, "[");
    for (int i = 0; i < arguments->n_free; i++) {
        const char *path = arguments->free[i];
        all.count = 0;
        if (all.json)
            hg_text_add(&all.out, "%s\n  {", i ? "," : "");
        else
            hg_text_add(&all.out, "%s%s\n", i ? "\n" : "", path);
        if (all.json) facts_text(&all, "file", path);
        if (about(&all, path) != HG_OK) {
            hg_text_free(&all.out);
            return cli_fail();
        }
        if (all.json) hg_text_add(&all.out, "\n  }");
    }
    if (all.json) hg_text_add(&all.out, "\n]\n");
    if (all.out.failed) {
        hg_fail(HG_MEMORY, "out of memory");
        return cli_fail();
    }
    fputs(all.out.data, stdout);
    hg_text_free(&all.out);
    return 0;
}

static const hg_argument info_options[] = { { "json", NULL, "as JSON, a list with one object per file", false } };

HG_COMMAND(info, .what = "what a groom, body, motion, posed scene, drape, checkpoint, run or a file to import holds",
           .usage = "FILE...", .options = info_options, .n_options = 1, .min_free = 1, .max_free = 1000, .run = info);
