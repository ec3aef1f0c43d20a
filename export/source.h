/* Strands and body of a file, frame by frame, whatever the file is. Private to export/. */
#ifndef HG_EXPORT_SOURCE_H
#define HG_EXPORT_SOURCE_H

#include "export/export.h"

typedef enum { SOURCE_FILE, SOURCE_POSED, SOURCE_REST } source_version; /* as the file has it; from its rest groom */

typedef struct {
    hg_ctx *ctx;
    char *path;
    const char *points; /* the dataset of the strands; NULL: rest is all there is */
    bool flat;          /* rows of it are points, not frames */
    int64_t frames, strands, vertices;
    double rate;
    hg_h5 *h5, *body_h5;               /* body_h5 may be h5 */
    float *x;                          /* [S,V,3] of the frame last read */
    float *rest;                       /* [S,V,3] or NULL: posed and rest versions cannot be had */
    const char *rotations, *positions; /* datasets [T,S,4] and [T,S,3], NULL: none */
    float *rotation, *position; /* [S,4], [S,3]: identity and the strands' first vertices when the file has none */
    int64_t body_vertices, body_faces, body_frames;
    float *body, *body_rest; /* [N,3]; body_rest may be NULL */
    int32_t *triangles;
    const char *body_points;    /* dataset of the body's vertices by frame, NULL: body_rest is all there is */
    bool body_flat, body_shown; /* body_shown: the version last read has a body */
} hg_source;

hg_status hg_source_open(hg_source **source, hg_ctx *ctx, const char *path, const char *body);
hg_status hg_source_read(hg_source *source, int64_t frame,
                         source_version version); /* fills x, body, rotation, position */
void hg_source_close(hg_source *source);

#endif
