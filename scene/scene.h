/* scene: grooms, bodies and motions: files, posing, and procedural ones for a machine with no data.
 *
 * World: metres, +Y up, face +Z, +X the character's left. A groom lives in the rest space of its body: the neutral body
 * at rest. Posing gives every root the rigid frame of its scalp triangle.
 *
 *     hg_body *body; hg_groom *groom; hg_motion *motion; hg_poser *poser;
 *     hg_bust_create(&body);                                                  or hg_body_load(&body, "body.h5")
 *     hg_groom_grow(ctx, &groom, body, "wavy", 3000, 25, seed);               or hg_groom_load(&groom, "groom.h5")
 *     hg_motion_make(&motion, body, "shake", 5.0, 30.0, seed);                or hg_motion_load(&motion, "clip.h5", body)
 *     hg_poser_create(&poser, body, false);
 *     hg_pose(ctx, poser, shape, motion, 12, vertices, joints, NULL);         the body at frame 12
 *     hg_pose_roots(ctx, poser, groom, NULL, 0, vertices, rotation, position);                 its strands' root frames
 *     hg_pose_strands(ctx, groom->strands, groom->vertices, groom->points, rotation, position, x);  the groom, rigidly
 *
 * HDF5 layouts stand in docs/formats.md. Rotations are quaternions (w,x,y,z); local ones are relative to the parent,
 * about world-parallel axes at rest.
 */
#ifndef HG_SCENE_H
#define HG_SCENE_H

#include "geometry/geometry.h"

#ifdef __cplusplus
extern "C" {
#endif

#define HG_SHAPES 10

/* ---- groom -------------------------------------------------------------------------------------------------- */

typedef struct {
    int64_t strands, vertices;
    float   *points;          /* [S,V,3] root first, rest space of the body [m] */
    int32_t *root_face;       /* [S] face of the body; -1 when not bound yet */
    float   *root_bary;       /* [S,3] */
    float   *root_uv;         /* [S,2] scalp projection, [0,1]^2 */
    char    *name;            /* where it came from */
    uint64_t body_hash;       /* of the body it is bound to, 0: none */
} hg_groom;

typedef struct { int64_t strands, kept, bald /* one vertex or none */, zero_length, non_finite; } hg_groom_report; /* what was found, and dropped */

hg_status hg_groom_create(hg_groom **groom, int64_t strands, int64_t vertices);
void      hg_groom_destroy(hg_groom *groom);
hg_status hg_groom_load(hg_groom **groom, const char *path);                      /* .h5 */
hg_status hg_groom_save(const hg_groom *groom, const char *path);
uint64_t  hg_groom_hash(const hg_groom *groom);
/* Ragged strands as a reader finds them, root first, in the file's own unit and axes. What follows the points is NULL (0)
 * where the file does not have it. */
typedef struct {
    int64_t  strands;
    int64_t *start;           /* [S+1] */
    float   *points;          /* [start[S],3] */
    float   *root_uv;         /* [S,2] */
    int32_t *root_face;       /* [S] of a groom of ours that is bound to a body */
    float   *root_bary;       /* [S,3] */
    uint64_t body_hash;
} hg_curves;
hg_status hg_curves_create(hg_curves **curves, int64_t strands, int64_t points); /* zeroed; start is to be filled */
void      hg_curves_destroy(hg_curves *curves);
hg_status hg_curves_select(hg_curves *curves, int64_t n, const int64_t *strand);  /* these strands, ascending, stay */
hg_status hg_curves_clean(hg_curves *curves, hg_groom_report *report);            /* drops bald, zero-length (metres are meant) and non-finite ones */
hg_status hg_curves_resample(hg_curves *curves, int64_t vertices);                /* of clean curves; as hg_groom_from_curves does it */
void      hg_curves_to_world(hg_curves *curves, double unit, bool z_up);          /* times unit; +Z up, facing -Y, becomes +Y up, facing +Z */
void      hg_curves_from_world(hg_curves *curves, double unit, bool z_up);        /* the other way */
hg_status hg_groom_to_curves(hg_curves **curves, const hg_groom *groom);
/* By arc length on a centripetal Catmull-Rom curve; drops and counts one-vertex, zero-length and non-finite strands. */
hg_status hg_groom_from_curves(hg_groom **groom, const hg_curves *curves, int64_t vertices, hg_groom_report *report);

/* ---- groom as a texture ------------------------------------------------------------------------------------- */

/* T x T texels over the scalp UV, row by v and column by u, with one strand each: of the roots that lie in a texel the one nearest
 * to its centre, the lowest number where two are equally near. The others are left out, and counted. */
typedef struct {
    int64_t  size, strands;   /* T; S of the groom */
    int64_t  kept, left_out;  /* strands that have a texel; that have none */
    int32_t *strand;          /* [T,T] of each texel; -1: empty */
    int32_t *texel;           /* [S] of each strand, row T + column; -1: left out */
    int32_t *kept_strand, *kept_texel; /* [kept] those two where there is one, by ascending strand */
    float   *mask;            /* [T,T] 1 where there is a strand, 0 where not */
} hg_texture;

hg_status hg_texture_create(hg_texture **texture, const hg_groom *groom, int64_t size);
void      hg_texture_destroy(hg_texture *texture);
void      hg_texture_draw(const hg_texture *texture, int64_t channels, const float *strands /* [S,C] */, float *image /* [C,T,T], 0 where empty */);
void      hg_texture_pick(const hg_texture *texture, int64_t channels, const float *image /* [C,T,T] */, float *kept /* [kept,C] */);
/* The kept strands of the groom that it was made of, with their roots; points from an image [V 3,T,T], NULL: as they were. In the new
 * groom every strand has a texel: it is what a network of textures is trained on. */
hg_status hg_texture_groom(hg_groom **groom, const hg_texture *texture, const hg_groom *from, const float *image);
/* Images [B,C,T,T] of a network -> rows [n,C] at places i32 [n]. Places of n strands (NULL: the first n kept) in image b are b T T
 * + texel, no two of them equal: the gradient of a texel without a strand is zero. */
hg_status  hg_texture_places(const hg_texture *texture, int64_t image, int64_t n, const int32_t *strand, int32_t *places);
hg_tensor *hg_texture_gather(hg_ctx *ctx, hg_tensor *images, hg_tensor *places);

/* ---- body --------------------------------------------------------------------------------------------------- */

#define HG_INFLUENCES 8
typedef struct {
    int64_t  vertices, faces, joints;
    float   *points;          /* [N,3] neutral rest */
    int32_t *triangles;       /* [F,3] */
    float   *uv;              /* [N,2] scalp projection where on the scalp, else the mesh's own; may be NULL */
    char   **joint_name;      /* [J] */
    int32_t *parent;          /* [J], -1 for the root; parents come first */
    float   *joint;           /* [J,3] at neutral rest */
    float   *joint_shapes;    /* [HG_SHAPES,J,3] how joints follow the shapes: joint + sum of beta_k joint_shapes[k] */
    int32_t *influence;       /* [N,HG_INFLUENCES] joints */
    float   *weight;          /* [N,HG_INFLUENCES], sum 1 */
    float   *shapes;          /* [HG_SHAPES,N,3] */
    char   **shape_name;      /* [HG_SHAPES] */
    double   shape_spread[HG_SHAPES]; /* deviation to sample with; clipped to [-1,1] */
    int32_t *scalp; int64_t scalp_faces; /* faces that carry roots, ascending */
    int32_t *collider; int64_t collider_faces; /* faces that hair can reach */
    double   scalp_axis[3], scalp_centre[3]; /* of the UV projection */
} hg_body;

void      hg_body_destroy(hg_body *body);
hg_status hg_body_load(hg_body **body, const char *path);
hg_status hg_body_save(const hg_body *body, const char *path);
uint64_t  hg_body_hash(const hg_body *body);
int       hg_body_joint(const hg_body *body, const char *name);                   /* -1 when it has none; "Head", "Neck", "Spine1"... are found under what SMPL, Mixamo and game engines call them, too */
void      hg_scalp_project(const hg_body *body, const float point[3], float uv[2]); /* Lambert azimuthal, no seam */

/* ---- motion ------------------------------------------------------------------------------------------------- */

typedef struct {
    int64_t  frames, joints;
    double   rate;            /* frames per second */
    char   **joint_name;      /* those of the body */
    float   *rotation;        /* [T,J,4] local */
    float   *translation;     /* [T,3] of the root joint from its rest place [m] */
    char    *name;
} hg_motion;

hg_status hg_motion_create(hg_motion **motion, int64_t frames, const hg_body *body, double rate);
void      hg_motion_destroy(hg_motion *motion);
hg_status hg_motion_load(hg_motion **motion, const char *path, const hg_body *body); /* joints must be the body's; NULL: not checked */
hg_status hg_motion_save(const hg_motion *motion, const char *path);
hg_status hg_motion_resample(hg_motion **out, const hg_motion *motion, double rate); /* slerp, the short way */
hg_status hg_motion_mirror(hg_motion **out, const hg_motion *motion);               /* left to right; Left.. and Right.. (L.. and R..) change places */
hg_status hg_motion_combine(hg_motion **out, const hg_motion *motion, const hg_motion *above); /* local rotations motion * above, ways added; frames of `motion` */

/* ---- posing ------------------------------------------------------------------------------------------------- */

typedef struct hg_poser hg_poser;     /* scratch and precomputed data of a body; one per thread of the caller's */
hg_status hg_poser_create(hg_poser **poser, const hg_body *body, bool collider_only /* skins only vertices of collider and scalp faces */);
void      hg_poser_destroy(hg_poser *poser);
int64_t   hg_poser_vertices(const hg_poser *poser);                /* body->vertices, or the kept ones */
const int32_t *hg_poser_vertex(const hg_poser *poser);             /* [vertices] their numbers in the body */
const int32_t *hg_poser_collider(const hg_poser *poser, int64_t *faces); /* [faces,3] collider triangles in kept numbering */
/* Shaped rest, joints recomputed, linear blend skinning. frame is clamped to the clip and truncated to a whole frame.
 * shape [HG_SHAPES] or NULL. vertices [vertices,3]; joint_position [J,3], joint_rotation [J,4] global (may be NULL). */
hg_status hg_pose(hg_ctx *ctx, hg_poser *poser, const double *shape, const hg_motion *motion, int64_t frame,
                  float *vertices, float *joint_position, float *joint_rotation);
/* Rigid frames of strands' roots on the posed vertices: rotation against the neutral rest triangle (edge 0 -> 1 and the
 * normal). strand NULL: all of the groom. rotation [n,4], position [n,3]. A degenerate triangle gives the identity. */
hg_status hg_pose_roots(hg_ctx *ctx, const hg_poser *poser, const hg_groom *groom, const int32_t *strand, int64_t n,
                        const float *vertices, float *rotation, float *position);
/* The same for many poses at once on a context's device. The host works out what moves the body, which is little: the shape as
 * floats, and for each joint the rows of (R | what is added) that move a shaped rest point. From these tensors bodies [P,N,3]
 * and roots [P,S,..] are made, of the step; N are the poser's vertices. Equal to hg_pose and hg_pose_roots but for rounding. */
hg_status  hg_pose_joints(hg_poser *poser, const double *shape, const hg_motion *motion, int64_t frame, float shapes[HG_SHAPES], float *transform /* [J,12] */);
hg_tensor *hg_pose_bodies(hg_ctx *ctx, hg_poser *poser, const hg_tensor *shape /* [P,HG_SHAPES] */, const hg_tensor *transform /* [P,J,12] */);
typedef struct hg_roots hg_roots;     /* the roots of as many strands of each of G grooms, on a device; destroyed before its context */
hg_status  hg_roots_create(hg_roots **roots, hg_ctx *ctx, const hg_poser *poser, int grooms, const hg_groom *const *groom, int64_t n, const int32_t *strand /* [G,n] */);
void       hg_roots_destroy(hg_roots *roots);
hg_status  hg_roots_pose(hg_ctx *ctx, const hg_roots *roots, const hg_tensor *groom /* [P] or a part of it that is repeated, i32 of 0 .. G-1; NULL: 0 */, const hg_tensor *vertices, hg_tensor **rotation, hg_tensor **position);
/* x = p + R (rest - rest_root) */
void hg_pose_strands(hg_ctx *ctx, int64_t strands, int64_t vertices, const float *rest, const float *rotation, const float *position, float *x);

/* A posed scene as a file, frame by frame: body_vertices [T,N,3] in the mesh's own order, joints [T,J,3], root_rotation
 * [T,S,4], root_position [T,S,3], strands [T,S,V,3]. groom NULL: only the body. frames 0: to the end of the clip. */
typedef struct { const hg_body *body; const hg_groom *groom; const hg_motion *motion; const double *shape /* [HG_SHAPES] or NULL */; int64_t first, frames; } hg_posed_scene;
hg_status hg_posed_scene_write(hg_ctx *ctx, const hg_posed_scene *scene, const char *path, const hg_progress *progress);

/* ---- fitting ------------------------------------------------------------------------------------------------ */

typedef struct { double scale, rotation[4], translation[3]; } hg_similarity;       /* x' = scale R x + t */
/* Found by trimmed ICP without rotation: source vertices near the roots onto the body. */
hg_status hg_fit_similarity(hg_ctx *ctx, const hg_body *body, int64_t n_vertices, const float *source /* [n,3] */, const hg_groom *groom, hg_similarity *found);
typedef struct { double moved_median, moved_p95, moved_max; int64_t moved_far, inside_before, inside_after; } hg_fit_report;
/* Moves the groom, projects roots to the scalp (strands follow), binds them, pushes inside vertices out once. */
hg_status hg_fit_groom(hg_ctx *ctx, hg_groom *groom, const hg_body *body, const hg_similarity *similarity, hg_fit_report *report);

/* ---- readers ------------------------------------------------------------------------------------------------ */

/* A reader is one file that registers itself under the kind and extension it reads. */
typedef struct {
    const char *extension, *what;
    hg_status (*read)(hg_curves **curves, const char *path);
    const char *unit;                                                             /* of a format that does not say: what is found, for messages; NULL: nothing is known */
    hg_status (*read_frame)(hg_curves **curves, const char *path, int64_t frame); /* of a file that moves; NULL: it does not */
    bool metres;                                                                  /* the file knows its unit and axes: metres, +Y up when read */
} hg_groom_reader;                                                                /* kind "groom reader" */
const hg_groom_reader *hg_groom_reader_find(const char *path);                    /* by extension, in either case; NULL and a message that lists the known */
hg_status hg_curves_read(hg_curves **curves, const char *path);                   /* by extension; unknown: lists the known */
hg_status hg_curves_read_frame(hg_curves **curves, const char *path, int64_t frame);

/* A writer is one file too. Root first; a strand that the format cannot hold is an error that names it. */
typedef struct {
    const char *extension, *what;
    const char *variants;                                                         /* "4|3", the usual one first; NULL: there is one */
    hg_status (*write)(const hg_curves *curves, const char *path, const char *variant /* one of them; NULL when there is one */);
    bool metres;                                                                  /* the format says metres, +Y up */
} hg_groom_writer;                                                                /* kind "groom writer" */
const hg_groom_writer *hg_groom_writer_find(const char *path);
hg_status hg_curves_write(const hg_curves *curves, const char *path, const char *variant /* NULL: the usual one */);

typedef struct { int64_t vertices, faces; float *points /* [N,3] */, *uv /* [N,2] of the vertex's first corner; NULL: none */; int32_t *triangles /* [F,3] */;
                 int32_t *polygon /* [F] of the file that a triangle was cut from, ascending */; char **group; int32_t *group_of_face /* [F], -1: none */; int n_groups; } hg_mesh; /* .obj; polygons are cut as a fan from their first corner: quads at the diagonal 0-2 */
hg_status hg_mesh_read_obj(hg_mesh **mesh, const char *path);
void      hg_mesh_destroy(hg_mesh *mesh);
/* What a file does not say and the person asking may. {0} is fine: what is usual for the format. */
typedef struct {
    double         unit;      /* metres of the file's unit of length; 0: as usual */
    char           up;        /* axis that is up in the file, 'y' or 'z'; 0: as usual */
    const char    *rig;       /* MakeHuman: of rig.NAME.json; NULL: cmu_mb */
    const char    *scalp;     /* bodies: a file of face numbers, or a length about the top of the head ("9 cm"); NULL: found */
    const char    *skeleton;  /* motions: .asf of an .amc; SMPL-like body of an AMASS clip (NULL: `body`, else the mean person) */
    const char    *animation; /* motions: glTF, name or number; NULL: the first */
    const hg_body *body;      /* motions: the body that is to move; may be NULL */
} hg_import;
/* notes: lines on what was found, assumed and left out, for the person asking; may be NULL. */
typedef struct { const char *extension /* "": a folder */, *what; hg_status (*read)(hg_ctx *ctx, hg_body **body, const char *path, const hg_import *with, hg_text *notes); } hg_body_reader; /* kind "body reader" */
hg_status hg_body_read(hg_ctx *ctx, hg_body **body, const char *path, const hg_import *with /* or NULL */, hg_text *notes);
/* MakeHuman base mesh with an MPFB rig: folder as ../data/bodies (makehuman/base.obj, makehuman/targets, mpfb2/rig.*.json, weights.*.json). */
hg_status hg_body_read_makehuman(hg_ctx *ctx, hg_body **body, const char *folder, const char *rig /* "cmu_mb" */);

/* ---- checks ------------------------------------------------------------------------------------------------- */

/* What there is to say about a file, one finding a line: fine, a warning (it will work, perhaps not as meant) or an error. */
typedef enum { HG_FINE, HG_WARNING, HG_ERROR } hg_severity;
typedef struct { hg_severity severity; const char *about /* a word, constant */; char *text; } hg_finding;
typedef struct { int n, capacity; hg_finding *list; bool failed /* out of memory */; } hg_findings;    /* {0} is empty */
void hg_findings_add(hg_findings *findings, hg_severity severity, const char *about, const char *format, ...) HG_PRINTF(4, 5);
int  hg_findings_count(const hg_findings *findings, hg_severity severity);
void hg_findings_free(hg_findings *findings);

typedef enum { HG_STRAND_FINE, HG_STRAND_DROPPED, HG_STRAND_DUPLICATE, HG_STRAND_EDGES, HG_STRAND_ROOT, HG_STRAND_INSIDE } hg_strand_problem; /* the worst of each strand */
/* Strands in metres, +Y up: number, lengths and unit, edges, duplicates, up axis, root UV; with a body the roots' distance to its
 * scalp, vertices inside it and whether the groom is bound to it. problem [S], NULL: not asked for. */
hg_status hg_check_groom(hg_ctx *ctx, hg_findings *findings, const hg_curves *curves, const hg_body *body, uint8_t *problem);
hg_status hg_check_body(hg_findings *findings, const hg_body *body);
hg_status hg_check_motion(hg_findings *findings, const hg_motion *motion, const hg_body *body /* NULL: its joints are not compared */);
/* Are these lengths those of hair in metres? If not, `text` says what they look like. Looked at: the extent of the roots, about
 * 0.2 m on a head, and the median length. */
bool hg_curves_in_metres(const hg_curves *curves, char text[160]);

/* A skeleton with its own rest pose and a clip on it, as a file has it. Retargeting makes an hg_motion of it. */
typedef struct {
    int64_t joints, frames; double rate;
    char **name; int32_t *parent; double *offset /* [J,3] rest bone offsets [m] */; double *rotation /* [T,J,4] local */; double *translation /* [T,3] root [m] */;
    bool standard_rest; /* all skeletons of these names rest alike (SMPL): rotations need no change between them */
} hg_clip;
void      hg_clip_destroy(hg_clip *clip);
hg_status hg_clip_read_amc(hg_clip **clip, const char *asf, const char *amc);
hg_status hg_clip_read_bvh(hg_clip **clip, const char *path);
typedef struct { const char *extension, *what; hg_status (*read)(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes); } hg_clip_reader; /* kind "motion reader" */
hg_status hg_clip_read(hg_clip **clip, const char *path, const hg_import *with /* or NULL */, hg_text *notes);
hg_status hg_clip_retarget(hg_motion **motion, const hg_clip *clip, const hg_body *body, double rate);

/* ---- procedural scenes -------------------------------------------------------------------------------------- */

hg_status hg_bust_create(hg_body **body);                                         /* head, neck, shoulders; rig with CMU names; 10 shapes */
hg_status hg_groom_grow(hg_ctx *ctx, hg_groom **groom, const hg_body *body, const char *style /* straight|wavy|curly|short|long */, int64_t strands, int64_t vertices, uint64_t seed);
hg_status hg_motion_make(hg_motion **motion, const hg_body *body, const char *kind /* nod|turn|shake|walk|jump|mixed */, double seconds, double rate, uint64_t seed);

#ifdef __cplusplus
}
#endif
#endif
