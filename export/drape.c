/* A drape's two files: strands and body, with what it takes to draw the rest and the posed groom beside the drape. */
#include "export/export.h"

#include <string.h>

struct hg_drape_file {
    char *path, *body_path;
    const hg_groom *groom;
    const hg_body *body;
    int64_t frames;
    double rate;
    hg_vtkhdf *strands, *mesh; /* made with the first frame, which knows how many strands there are */
};

hg_status hg_drape_file_create(hg_drape_file **file, const char *path, const char *body_path, const hg_groom *groom,
                               const hg_body *body, int64_t frames, double rate)
{
    *file = NULL;
    hg_drape_file *made = hg_alloc(1, sizeof *made);
    if (!made) return HG_MEMORY;
    made->path = hg_strdup(path);
    made->body_path = body_path ? hg_strdup(body_path) : NULL;
    if (!made->path || (body_path && !made->body_path)) {
        hg_drape_file_discard(made);
        return HG_MEMORY;
    }
    made->groom = groom;
    made->body = body;
    made->frames = frames;
    made->rate = rate;
    *file = made;
    return HG_OK;
}

static hg_status begin(hg_drape_file *file, const hg_drape_frame *frame)
{
    int64_t strands = frame->strands, vertices = frame->vertices;
    if (vertices != file->groom->vertices)
        return hg_fail(HG_INVALID, "%s: frames have %lld vertices a strand, the groom %lld", file->path,
                       (long long)vertices, (long long)file->groom->vertices);
    HG_TRY(hg_vtkhdf_create_strands(&file->strands, file->path, file->frames, strands, vertices, file->rate));
    float *rest = hg_alloc((size_t)(strands * vertices), 3 * sizeof *rest);
    int32_t *number = hg_alloc((size_t)strands, sizeof *number);
    hg_status status = rest && number ? HG_OK : HG_MEMORY;
    for (int64_t s = 0; status == HG_OK && s < strands; s++) {
        int32_t from = number[s] = frame->strand ? frame->strand[s] : (int32_t)s;
        if (from < 0 || from >= file->groom->strands)
            status = hg_fail(HG_INVALID, "%s: strand %d of a groom of %lld", file->path, (int)from,
                             (long long)file->groom->strands);
        else
            memcpy(rest + 3 * s * vertices, file->groom->points + 3 * from * vertices,
                   (size_t)(3 * vertices) * sizeof *rest);
    }
    if (status == HG_OK)
        status = hg_vtkhdf_write_extra(file->strands, "rest", HG_F32, 3, (int64_t[]){ strands, vertices, 3 }, rest);
    if (status == HG_OK) status = hg_vtkhdf_write_extra(file->strands, "strand", HG_I32, 1, &strands, number);
    hg_free(rest);
    hg_free(number);
    HG_TRY(status);
    if (!file->body_path || !file->body) return HG_OK;
    const char *slash = strrchr(file->body_path, '/');
    HG_TRY(hg_vtkhdf_set_text(file->strands, "body", slash ? slash + 1 : file->body_path));
    HG_TRY(hg_vtkhdf_create_mesh(&file->mesh, file->body_path, file->frames, file->body->vertices, file->body->faces,
                                 file->body->triangles, file->rate));
    return hg_vtkhdf_write_extra(file->mesh, "rest", HG_F32, 2, (int64_t[]){ file->body->vertices, 3 },
                                 file->body->points);
}

hg_status hg_drape_file_add(void *self, const hg_drape_frame *frame)
{
    hg_drape_file *file = self;
    if (!file->strands) HG_TRY(begin(file, frame));
    int64_t strands = frame->strands;
    HG_TRY(hg_vtkhdf_add(file->strands, frame->x));
    HG_TRY(hg_vtkhdf_add_extra(file->strands, "root_rotation", HG_F32, 2, (int64_t[]){ strands, 4 },
                               frame->root_rotation));
    HG_TRY(hg_vtkhdf_add_extra(file->strands, "root_position", HG_F32, 2, (int64_t[]){ strands, 3 },
                               frame->root_position));
    return file->mesh ? hg_vtkhdf_add(file->mesh, frame->body_vertices) : HG_OK;
}

hg_status hg_drape_file_commit(hg_drape_file *file)
{
    hg_status status = file->strands ? HG_OK : hg_fail(HG_INVALID, "%s: no frame was added", file->path);
    if (status == HG_OK && file->mesh) {
        status = hg_vtkhdf_commit(file->mesh);
        file->mesh = NULL;
    }
    if (status == HG_OK) {
        status = hg_vtkhdf_commit(file->strands);
        file->strands = NULL;
    }
    hg_drape_file_discard(file);
    return status;
}

void hg_drape_file_discard(hg_drape_file *file)
{
    if (!file) return;
    hg_vtkhdf_discard(file->strands);
    hg_vtkhdf_discard(file->mesh);
    hg_free(file->path);
    hg_free(file->body_path);
    hg_free(file);
}
