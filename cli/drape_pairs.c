/* drape --pairs: many pairs of a groom and a pose, listed in a file or drawn. Each groom has a file whose steps are its pairs. */
#include "cli/shape.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { STREAM_PAIRS = 9100, MOST_PAIRS = 10000000 };

typedef struct {
    char *name;
    hg_motion *motion;
} loaded_motion;

typedef struct {
    char *path, *body_path;
    int64_t pairs, next;
    hg_drape_file *file;
} groom_file; /* of a groom of the task */

typedef struct {
    hg_hair_task *task;
    int64_t n, room;
    hg_drape_pair *pairs;
    double (*shapes)[HG_SHAPES];
    loaded_motion *motions;
    int n_motions;
    groom_file *files;
    int n_files;
} pairs;

static void pairs_free(pairs *p)
{
    for (int i = 0; i < p->n_motions; i++) {
        hg_free(p->motions[i].name);
        hg_motion_destroy(p->motions[i].motion);
    }
    for (int g = 0; g < p->n_files; g++) {
        hg_drape_file_discard(p->files[g].file);
        hg_free(p->files[g].path);
        hg_free(p->files[g].body_path);
    }
    hg_free(p->pairs);
    hg_free(p->shapes);
    hg_free(p->motions);
    hg_free(p->files);
}

static hg_status make_room(pairs *p, int64_t n)
{
    p->pairs = hg_alloc((size_t)n, sizeof *p->pairs);
    p->shapes = hg_alloc((size_t)n, sizeof *p->shapes);
    p->motions = hg_alloc((size_t)n, sizeof *p->motions);
    p->room = n;
    return p->pairs && p->shapes && p->motions ? HG_OK : HG_MEMORY;
}

/* ---- from a file --------------------------------------------------------------------------------------------- */

/* A clip of the run, or a motion file, which is read once. */
static hg_status find_motion(pairs *p, const char *name, const hg_motion **motion)
{
    if (strcmp(hg_path_extension(name), "h5") != 0) {
        *motion = cli_clip(p->task, name);
        return *motion ? HG_OK : HG_INVALID;
    }
    for (int i = 0; i < p->n_motions; i++)
        if (!strcmp(p->motions[i].name, name)) return *motion = p->motions[i].motion, HG_OK;
    loaded_motion *m = &p->motions[p->n_motions++];
    m->name = hg_strdup(name);
    if (!m->name) return HG_MEMORY;
    HG_TRY(hg_motion_load(&m->motion, name, hg_hair_body(p->task)));
    *motion = m->motion;
    return HG_OK;
}

/* Fields of a line between tabs where it has any, else between blanks; the line is cut up. */
static int split(char *line, char *field[5])
{
    const char *between = strchr(line, '\t') ? "\t" : " ";
    int n = 0;
    line[strcspn(line, "#\r")] = '\0';
    for (char *at = line; n < 5; n++) {
        at += strspn(at, between);
        if (!*at) break;
        field[n] = at;
        at += strcspn(at, between);
        if (*at) *at++ = '\0';
        for (char *last = field[n] + strlen(field[n]); last > field[n] && last[-1] == ' ';) *--last = '\0';
    }
    return n;
}

static hg_status read_pair(pairs *p, const char *path, int64_t number, char *line)
{
    char *field[5], *end;
    const int n = split(line, field);
    if (n == 0) return HG_OK;
    const long long frame = n > 2 ? strtoll(field[2], &end, 10) : -1;
    if (n < 3 || n > 4 || *end || frame < 0)
        return hg_fail(HG_INVALID,
                       "%s:%lld: expected GROOM CLIP FRAME and perhaps a SHAPE, like: wavy turn 12 0.5,0,-1", path,
                       (long long)number);
    hg_drape_pair *pair = &p->pairs[p->n];
    double *shape = p->shapes[p->n];
    hg_status status = hg_hair_find_groom(p->task, field[0], &pair->groom);
    if (status == HG_OK) status = find_motion(p, field[1], &pair->motion);
    const double rate = hg_hair_rate(p->task); /* frames of another rate are counted when they are made */
    if (status == HG_OK && fabs(pair->motion->rate - rate) <= 1e-6 * rate && frame >= pair->motion->frames)
        status = hg_fail(HG_INVALID, "frame %lld of a motion of %lld", frame, (long long)pair->motion->frames);
    if (status == HG_OK && n == 4) status = cli_shape_text(field[3], hg_hair_body(p->task), shape);
    if (status != HG_OK) {
        char *why = hg_strdup(hg_message());
        hg_fail(status, "%s:%lld: %s", path, (long long)number, why ? why : "out of memory");
        hg_free(why);
        return status;
    }
    pair->frame = frame;
    pair->shape = shape;
    p->n++;
    return HG_OK;
}

static hg_status read_pairs(pairs *p, const char *path)
{
    void *bytes = NULL;
    size_t size;
    HG_TRY(hg_file_read(path, &bytes, &size));
    int64_t lines = 1;
    for (size_t i = 0; i < size; i++) lines += ((char *)bytes)[i] == '\n';
    hg_status status = make_room(p, lines);
    char *at = bytes;
    for (int64_t number = 1; status == HG_OK && number <= lines; number++) {
        char *line = at;
        at += strcspn(at, "\n");
        if (*at) *at++ = '\0';
        status = read_pair(p, path, number, line);
    }
    hg_free(bytes);
    if (status == HG_OK && p->n == 0) status = hg_fail(HG_INVALID, "%s: there is no pair in it", path);
    return status;
}

/* ---- drawn --------------------------------------------------------------------------------------------------- */

/* Grooms trained on, or the one that was chosen; clips that are held out, where there are any; shapes that training does not draw. */
static hg_status draw_pairs(pairs *p, int64_t n, uint64_t seed, int chosen)
{
    HG_TRY(make_room(p, n));
    hg_hair_task *task = p->task;
    const bool held_out = hg_hair_clips(task, true) > 0;
    for (int64_t i = 0; i < n; i++) {
        const uint64_t number = 3 * (uint64_t)i;
        const hg_motion *clip = hg_hair_clip(
            task, held_out, (int)hg_random_below(seed, STREAM_PAIRS, number, (uint64_t)hg_hair_clips(task, held_out)));
        hg_hair_held_out_shape(task, i, p->shapes[i]);
        p->pairs[i] =
            (hg_drape_pair){ .groom = chosen >= 0 ? chosen
                                                  : (int)hg_random_below(seed, STREAM_PAIRS, number + 1,
                                                                         (uint64_t)hg_hair_grooms(task)),
                             .motion = clip,
                             .frame = (int64_t)hg_random_below(seed, STREAM_PAIRS, number + 2, (uint64_t)clip->frames),
                             .shape = p->shapes[i] };
    }
    p->n = n;
    return HG_OK;
}

/* ---- files --------------------------------------------------------------------------------------------------- */

/* "drape.vtkhdf" of one groom; of several "drape.wavy.vtkhdf": the last part of the groom's name without its extension. */
static char *path_of(const char *path, const char *groom)
{
    if (!path) return NULL;
    if (!groom) return hg_strdup(path);
    const char *slash = strrchr(groom, '/'), *last = slash ? slash + 1 : groom, *extension = hg_path_extension(path);
    const size_t stem = strlen(path) - (extension[0] ? strlen(extension) + 1 : 0);
    const size_t of_groom = strlen(last) - (hg_path_extension(last)[0] ? strlen(hg_path_extension(last)) + 1 : 0);
    return hg_format("%.*s.%.*s%s%s", (int)stem, path, (int)of_groom, last, extension[0] ? "." : "", extension);
}

static hg_status make_files(pairs *p, const char *path, const char *body_path)
{
    int grooms = 0;
    for (int64_t i = 0; i < p->n; i++)
        if (p->pairs[i].groom >= p->n_files) p->n_files = p->pairs[i].groom + 1;
    const int n = p->n_files;
    p->files = hg_alloc((size_t)n, sizeof *p->files);
    if (!p->files) return p->n_files = 0, HG_MEMORY;
    for (int64_t i = 0; i < p->n; i++) grooms += p->files[p->pairs[i].groom].pairs++ == 0;
    for (int g = 0; g < n; g++) {
        groom_file *f = &p->files[g];
        if (!f->pairs) continue;
        const char *name = grooms > 1 ? hg_hair_groom_name(p->task, g) : NULL;
        f->path = path_of(path, name);
        f->body_path = path_of(body_path, name);
        if (!f->path || (body_path && !f->body_path)) return HG_MEMORY;
        for (int k = 0; k < g; k++)
            if (p->files[k].path && !strcmp(p->files[k].path, f->path))
                return hg_fail(HG_INVALID, "%s: both %s and %s would be written to it; give one of them another name",
                               f->path, hg_hair_groom_name(p->task, k), name);
        HG_TRY(hg_drape_file_create(&f->file, f->path, f->body_path, hg_hair_groom_at(p->task, g),
                                    hg_hair_body(p->task), f->pairs, hg_hair_rate(p->task)));
    }
    return HG_OK;
}

static hg_status add(void *self, int64_t pair, const hg_drape_frame *frame)
{
    pairs *p = self;
    return hg_drape_file_add(p->files[p->pairs[pair].groom].file, frame);
}

/* The pairs as --pairs reads them, and behind each where it is. */
static hg_status write_list(pairs *p, const char *path)
{
    hg_text text = { 0 };
    hg_text_add(&text, "# groom\tclip\tframe\tshape\t# file\tstep\n");
    for (int64_t i = 0; i < p->n; i++) {
        const hg_drape_pair *pair = &p->pairs[i];
        groom_file *f = &p->files[pair->groom];
        const char *clip = pair->motion->name ? pair->motion->name : "";
        for (int k = 0; k < p->n_motions; k++)
            if (p->motions[k].motion == pair->motion) clip = p->motions[k].name;
        hg_text_add(&text, "%s\t%s\t%lld\t", hg_hair_groom_name(p->task, pair->groom), clip, (long long)pair->frame);
        for (int k = 0; k < HG_SHAPES; k++) hg_text_add(&text, "%s%.17g", k ? "," : "", pair->shape[k]);
        hg_text_add(&text, "\t# %s\t%lld\n", f->path, (long long)f->next++);
    }
    const hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}

static hg_status commit(pairs *p, const char *list)
{
    for (int g = 0; g < p->n_files; g++) {
        groom_file *f = &p->files[g];
        if (!f->file) continue;
        hg_drape_file *file = f->file;
        f->file = NULL;
        HG_TRY(hg_drape_file_commit(file));
    }
    HG_TRY(write_list(p, list));
    cli_progress_end();
    for (int g = 0; g < p->n_files; g++) {
        const groom_file *f = &p->files[g];
        if (!f->pairs) continue;
        const int64_t left_out = hg_hair_left_out(p->task, g);
        printf("%s: %lld pairs of %s", f->path, (long long)f->pairs, hg_hair_groom_name(p->task, g));
        if (left_out) printf("; %lld strands are left out, they share a texel with another", (long long)left_out);
        printf("\n");
    }
    printf("%s: which is which\n", list);
    return HG_OK;
}

hg_status cli_drape_pairs(hg_ctx *ctx, const hg_arguments *arguments, hg_hair_task *task, int64_t stride,
                          const char *path)
{
    static const char *const others[] = { "motion", "clip", "shape", "first", "frames" };
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (cli_value(arguments, others[i], NULL))
            return hg_fail(HG_INVALID, "drape: either --pairs or --%s", others[i]);
    const char *from = cli_value(arguments, "pairs", NULL), *groom = cli_value(arguments, "groom", NULL);
    const char *body_path = cli_value(arguments, "body-out", NULL);
    char *end;
    const long long n = strtoll(from, &end, 10);
    const bool drawn = from[0] && !*end;
    if (drawn && (n < 1 || n > MOST_PAIRS))
        return hg_fail(HG_INVALID, "drape: --pairs %s: 1 to %d pairs, or a file that lists them", from, MOST_PAIRS);
    if (!drawn && groom) return hg_fail(HG_INVALID, "drape: --groom: %s names the groom of each pair", from);
    if (stride < 1) return hg_fail(HG_INVALID, "drape: a stride of %lld strands; at least 1", (long long)stride);
    pairs p = { .task = task };
    int chosen = -1;
    hg_status status = groom ? hg_hair_find_groom(task, groom, &chosen) : HG_OK;
    if (status == HG_OK) status = drawn ? draw_pairs(&p, n, hg_ctx_seed(ctx), chosen) : read_pairs(&p, from);
    if (status == HG_OK) status = make_files(&p, path, body_path);
    const char *extension = hg_path_extension(path);
    char *list = hg_format("%.*s.pairs", (int)(strlen(path) - (extension[0] ? strlen(extension) + 1 : 0)), path);
    if (status == HG_OK && !list) status = HG_MEMORY;
    const hg_drape_pairs_options options = { .stride = stride, .bodies = body_path != NULL };
    const hg_progress progress = cli_progress();
    if (status == HG_OK) status = hg_hair_drape_pairs(task, ctx, p.n, p.pairs, &options, add, &p, &progress);
    if (status == HG_OK) status = commit(&p, list);
    pairs_free(&p);
    hg_free(list);
    return status;
}
