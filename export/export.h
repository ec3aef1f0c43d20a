/* export: networks and results for the world outside: ONNX, HDF5 weights, VTKHDF drapes, pictures.
 *
 *     hg_onnx_export(ctx, "model.onnx", forward, self, &(hg_onnx_options){ .input = "features", .columns = 748 });
 *     hg_vtkhdf_create_strands(&file, "drape.vtkhdf", frames, strands, vertices, 30.0);
 *     hg_image_write_png(image, "drape.png");
 */
#ifndef HG_EXPORT_H
#define HG_EXPORT_H

#include "tasks/tasks.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- ONNX: opset 15, IR 7 ----------------------------------------------------------------------------------- */

/* Runs `forward` once on a [rows,columns] probe with the tape recording everything, and emits one node (or a few) per
 * recorded call by the op's own emitter. The row axis is dynamic ("strands"). Tensors that are neither the input nor
 * made on the tape become initialisers. */
typedef struct { const char *key, *value; } hg_onnx_metadata;
typedef struct { const char *name; int64_t columns; const char *rows; /* name of its row axis */ } hg_onnx_input;
typedef struct {
    const char *input, *output, *graph, *doc;
    int64_t columns;
    int n_metadata; const hg_onnx_metadata *metadata;
    int n_inputs; const hg_onnx_input *inputs;     /* several: of hg_onnx_export_several, instead of input and columns */
    int n_output_rows; const char *const *output_rows; /* names of the output's leading axes that are open; none: "strands" */
} hg_onnx_options;
#define HG_ONNX_INPUTS 4
/* The same with a formula of several inputs, each [rows,columns]; row axes of one name have the same length. */
hg_status hg_onnx_export_several(hg_ctx *ctx, const char *path, hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor **inputs), void *self, const hg_onnx_options *options);
hg_status hg_onnx_export(hg_ctx *ctx, const char *path, hg_tensor *(*forward)(void *self, hg_ctx *ctx, hg_tensor *input), void *self, const hg_onnx_options *options);
/* A hair network, with units, input order, normalisation and the groom's hash. The first of its forms, or one of them by name:
 *   concatenated   of strands: features [strands,..] -> displacement [strands,(V-1)*3]
 *   factored       the same in two files, as it is fastest: PATH.strand.onnx, once per groom: strand_features -> part; and PATH.frame.onnx,
 *                  once per frame: part, frame_features [frames,..] -> displacement [frames,strands,..]; with `model.output: directions` also
 *                  rest [strands,(V-1)*3]. PATH's extension is left out.
 *   image          of grooms: features [frames,..] -> displacement [frames,(V-1)*3,T,T], of any groom; not with `directions`
 *   strands        of grooms: features [frames,..] -> displacement [frames,strands,(V-1)*3] of the groom that is chosen
 * Behind displacements stand turns, where there are any (hg_hair_turns). */
typedef struct { char *path; const char *what; } hg_exported;
hg_status hg_export_hair_onnx(hg_hair_task *task, hg_ctx *ctx, const char *path);
hg_status hg_export_hair_onnx_as(hg_hair_task *task, hg_ctx *ctx, const char *form, const char *path, hg_exported files[HG_HAIR_FORMULAS], int *n_files);
void      hg_exported_free(hg_exported *files, int n);
/* /model/<layer>/{weight,bias}, the feature table, /texture/{texel,strand} of a network that makes images, and
 * /sample/{features,displacement}: rows of real input of the first form with the network's answers, to test a runtime of one's own with. */
hg_status hg_export_hair_h5(hg_hair_task *task, hg_ctx *ctx, const char *path);

/* ---- VTKHDF: PolyData with steps ---------------------------------------------------------------------------- */

typedef struct hg_vtkhdf hg_vtkhdf;
/* Polylines of `vertices` points; attributes T, S, V and our own data outside /VTKHDF. */
hg_status hg_vtkhdf_create_strands(hg_vtkhdf **file, const char *path, int64_t frames, int64_t strands, int64_t vertices, double rate);
hg_status hg_vtkhdf_create_polylines(hg_vtkhdf **file, const char *path, int64_t frames, int64_t strands, const int64_t *start /* [S+1] */, double rate); /* of different lengths: no attribute V */
hg_status hg_vtkhdf_create_mesh(hg_vtkhdf **file, const char *path, int64_t frames, int64_t vertices, int64_t faces, const int32_t *triangles, double rate);
hg_status hg_vtkhdf_add(hg_vtkhdf *file, const float *points);                     /* the next frame */
hg_status hg_vtkhdf_commit(hg_vtkhdf *file);                                       /* frees; the file appears */
void      hg_vtkhdf_discard(hg_vtkhdf *file);
/* Our own data, in the group /hairgrad, which other programs pass over: a dataset written whole; the next row of a
 * dataset [frames,...] (the shape is that of one row; the first call makes it); a text attribute of the group. */
hg_status hg_vtkhdf_write_extra(hg_vtkhdf *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *data);
hg_status hg_vtkhdf_add_extra(hg_vtkhdf *file, const char *name, hg_dtype dtype, int rank, const int64_t *shape, const void *row);
hg_status hg_vtkhdf_set_text(hg_vtkhdf *file, const char *name, const char *text);

/* A drape as `hairgrad render` likes it: the strands in `path`, and the body in `body_path` (NULL: none), both VTKHDF.
 * Beside the strands stand /hairgrad/rest [S,V,3], strand [S], root_rotation [T,S,4] and root_position [T,S,3], from
 * which the rest and the rigidly posed groom can be drawn, and /hairgrad's attribute "body", the body file's name.
 *
 *     hg_drape_file_create(&file, "drape.vtkhdf", "body.vtkhdf", groom, body, frames, motion->rate);
 *     hg_hair_drape(task, ctx, motion, shape, 0, frames, 1, hg_drape_file_add, file, &progress);
 *     hg_drape_file_commit(file);
 */
typedef struct hg_drape_file hg_drape_file;
hg_status hg_drape_file_create(hg_drape_file **file, const char *path, const char *body_path, const hg_groom *groom, const hg_body *body, int64_t frames, double rate);
hg_status hg_drape_file_add(void *file, const hg_drape_frame *frame);              /* an hg_drape_sink */
hg_status hg_drape_file_commit(hg_drape_file *file);                               /* frees; both files appear */
void      hg_drape_file_discard(hg_drape_file *file);                              /* frees; NULL is fine */

/* A drape read back: what its hair is made of. The task's energies, and frames spread over the file (n_frames 0: eight). The
 * drape's strands are those of the task's groom; a body that it names is where it says (body NULL), or `body`. */
typedef struct { hg_material_options material; int n_frames; const char *body; } hg_drape_fit_options;
hg_status hg_drape_fit_material(hg_hair_task *task, hg_ctx *ctx, const char *path, const hg_drape_fit_options *options, hg_material_fit *fit);

/* ---- pictures ----------------------------------------------------------------------------------------------- */

typedef struct { int width, height; uint8_t *rgb; } hg_image;                      /* 8 bit, sRGB */
hg_status hg_image_create(hg_image **image, int width, int height, const uint8_t rgb[3]);
void      hg_image_destroy(hg_image *image);
hg_status hg_image_write_png(const hg_image *image, const char *path);
void      hg_image_paste(hg_image *to, const hg_image *from, int x, int y);
void      hg_image_text(hg_image *image, int x, int y, int scale, const uint8_t rgb[3], const char *text); /* a small built-in font */

typedef struct { double eye[3], target[3], up[3], height; } hg_camera;             /* orthographic; height in metres */
typedef struct {
    hg_camera camera;
    int64_t body_vertices, body_faces; const float *body; const int32_t *triangles;
    int64_t strands, vertices; const float *x; const float *colour /* [S,3] linear, NULL: brown with variation by strand */;
    double hair_width;                   /* m; 0: 0.3 mm */
    int hairs; double lock_radius;       /* hairs drawn for a strand, itself and others around it within this radius [m]; 0: itself */
    const char *caption;
} hg_view;
/* Anti-aliased, with depth: shaded body, strands with Kajiya-Kay shading and depth-based occlusion. */
hg_status hg_render(hg_ctx *ctx, hg_image *image, int x, int y, int width, int height, const hg_view *view);
/* Line plot: curves of n points each; for tip paths and learning curves. One point is a dot; a curve without a name has
 * the colour of the named one before it. */
typedef struct { const char *name; int64_t n; const double *x, *y; } hg_curve;
hg_status hg_plot(hg_image *image, int x, int y, int width, int height, const char *title, const char *x_label, const char *y_label, int n, const hg_curve *curves, bool equal_axes);

/* Horizontal bars from zero: values [n_groups,n_bars], a group beneath the other, with the names of both. Bars longer than `limit` (0:
 * none) are cut and say their value. */
hg_status hg_plot_bars(hg_image *image, int x, int y, int width, int height, const char *title, const char *label, int n_groups, const char *const *groups, int n_bars, const char *const *bars, const double *values, double limit);
/* A row for each clip, at most six: energies at rest side by side and, of what moves, two tips over time. width, height: of a panel; 0: 620 x 420. */
hg_status hg_against_draw(hg_image **picture, int n, const char *const *clips, const hg_against *against, int width, int height);

/* ---- pictures of files -------------------------------------------------------------------------------------- */

/* A contact sheet of a drape (.vtkhdf), of a posed scene (`hairgrad pose`, .h5) or of a groom (.h5). The camera goes
 * with the head and its heading, at one scale. With `compare`, a row is a frame and its columns are the rest groom, the
 * rigidly posed one and the drape. */
typedef struct {
    const char *body;                    /* body.vtkhdf or body.h5; NULL: the one that a drape names, else none */
    int n_frames; const int64_t *frames; /* none: six spread over the clip (three with compare) */
    const char *view;                    /* "front", "side", "back", "three_quarter" (NULL) */
    int width, height;                   /* of one picture; 0: 480 x 560 */
    bool compare;
    double hair_width;                   /* m; 0: by the number of strands */
    int hairs;                           /* drawn for a strand; 0: by the number of strands, so that few cover a head; 1: the strands alone */
} hg_sheet_options;
hg_status hg_sheet_draw(hg_ctx *ctx, hg_image **sheet, const char *path, const hg_sheet_options *options, const hg_progress *progress);
/* What hg_check_groom found: strands in the colour of their problem, from three sides, each width x height; body may be NULL. */
hg_status hg_problems_draw(hg_ctx *ctx, hg_image **image, const hg_curves *curves, const uint8_t *problem /* [S] */, const hg_body *body, int width, int height);
/* Do tips lag and swing? Paths of a few tips in the head's frame, from above, beside the same over time under the head's
 * turning; rigidly posed tips stand still there. */
hg_status hg_tips_draw(hg_image **picture, const char *path, int width, int height);

#ifdef __cplusplus
}
#endif
#endif
