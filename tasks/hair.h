/* hair: the parts of the hair task; private to tasks/.
 *
 *   schema.c     keys of a config, energies of a config         world.c      body, groom, clips
 *   features.c   what belongs to a frame, normalisation         encoder.c    what describes grooms: learnt, kept, read
 *   subset.c     strands of a step and their physics            sample.c     the batch of a step
 *   material.c   parameters of energies that are inputs of the network, or learnt
 *   network.c    what an output is, strands from the network    network_*.c  a family of networks each
 *   inputs.c     what else energies ask for: materials, ghosts, deformations, orientations
 *   segments.c   lengths, turns and bends of strands
 *   hair_task.c  create, loss, validation, checkpoint           drape.c, metrics.c, solve.c
 */
#ifndef HG_TASKS_HAIR_H
#define HG_TASKS_HAIR_H

#include "tasks/tasks.h"

#include <stdio.h>

/* ---- schema ------------------------------------------------------------------------------------------------- */

enum { HG_HAIR_TERMS = 16 };
typedef struct {
    int n;
    hg_term term[HG_HAIR_TERMS];
    double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS];
    const char *options[HG_HAIR_TERMS][HG_ENERGY_OPTIONS]; /* point into the config */
} hg_hair_terms;                                           /* points into itself: never copied */

int hg_hair_energies(const hg_energy **energies /* [256] */); /* registered ones, by name */
hg_status
hg_hair_config_loaded(hg_status status); /* of a load: an unknown energy may be a plug-in's, and that is said */
hg_status hg_hair_config_copy(hg_config **copy, const hg_config *config); /* weight 0: the energy is off */
bool hg_hair_is_usual_list(const hg_config *config,
                           const char *key); /* the list that stands there when nothing is written */
hg_status hg_hair_terms_create(hg_hair_terms *terms, const hg_config *copy);

/* What energies ask for beside positions; the names are of an energy that does, for messages. */
typedef struct {
    bool ghost;
    const char *deformation, *q;
} hg_hair_asks;
hg_status hg_hair_asks_of(hg_hair_asks *asks, const hg_hair_terms *terms);

/* ---- features of frames ------------------------------------------------------------------------------------- */

enum { HG_HAIR_JOINTS = 32 };
typedef struct {
    bool shape, linear, acceleration; /* inputs: the shape; the head's linear motion, as acceleration */
    int pose_columns;                 /* of a joint: 6, two columns of its rotation; 3, a rotation vector */
    int history, n_pose, n_velocity;
    int pose[HG_HAIR_JOINTS], velocity[HG_HAIR_JOINTS]; /* joints of the body */
    int head;
    int pose_inputs, velocity_inputs; /* per frame */
    int materials;
    int frame_inputs; /* shape + pose + history * velocity + materials */
} hg_hair_layout;

/* What the joints of a clip do, frame by frame; nothing here depends on the body shape. */
typedef struct {
    int64_t frames;
    float *pose;     /* [T,pose_inputs] */
    float *velocity; /* [T,velocity_inputs], frame 0 at rest */
} hg_hair_track;

typedef struct {
    hg_motion *motion;
    hg_hair_track track;
} hg_hair_clip_data;

bool hg_hair_is_all_joints(const hg_config *config, const char *key); /* `[all]` stands there */
hg_status hg_hair_layout_create(hg_hair_layout *layout, const hg_config *config, const hg_body *body);
hg_status hg_hair_track_create(hg_hair_track *track, const hg_hair_layout *layout, const hg_body *body,
                               const hg_motion *motion);
void hg_hair_track_destroy(hg_hair_track *track);
/* Raw features of one frame: shape, pose, then velocities of frame, frame - 1, .. (zero before the clip). */
void hg_hair_track_frame(const hg_hair_layout *layout, const hg_hair_track *track, int64_t frame, const double *shape,
                         float *out);
/* Global rotations and places of all joints on the neutral body. rotation [J,4], position [J,3]. */
void hg_hair_joints(const hg_body *body, const hg_motion *motion, int64_t frame, double *rotation, double *position);

/* ---- grooms ------------------------------------------------------------------------------------------------- */

/* A groom and what is known of its strands before any is drawn. All of a task have as many vertices a strand. */
typedef struct {
    hg_groom *groom;
    char *name;
    float *body_distance, *scalp_distance; /* [S,V] of the rest groom */
    int32_t *lock, locks;                  /* [S] lock of a strand; how many there are */
    float *raw;                            /* [S,strand_inputs]; of a network of grooms [strand_inputs] */
    int32_t *texel;                        /* [S] of a network that makes images: where in them; else NULL */
    int64_t left_out;                      /* strands that the network cannot draw: not in groom */
    int32_t *number;                       /* [S] with left_out: what the strands' numbers were before */
} hg_hair_style;

/* ---- strands of a step -------------------------------------------------------------------------------------- */

/* As many strands of each of G grooms: those from `first` on of the task. */
typedef struct {
    int first, grooms;
    int64_t n;
    int32_t *strand;     /* [G,n] of the groom, ascending */
    hg_tensor *rest;     /* [G n,V,3] f32 */
    hg_tensor *edges;    /* [G n,V-1,4] f32 their rest frames, where the task knows of orientations; else NULL */
    hg_tensor *features; /* [G n,strand_inputs] f32, normalised; of a network of grooms [G,strand_inputs] */
    hg_tensor *texel;    /* [G n] i32 or NULL, as that of hg_hair_style */
    double *lengths;     /* [G n,V-1] rest edges */
    double *mass;        /* [G n] of a strand [kg] */
    hg_tensor *weigh;    /* the same, where the task computes */
    hg_roots *roots;     /* there, when that is not the host */
    hg_physics *physics;
} hg_hair_subset;

/* What physics is made from, for the strands of a subset, whose lengths and masses it fills. data points into itself. */
typedef struct {
    double *rest, *mass, *body, *scalp;
    hg_groom_attribute attributes[2];
    hg_groom_data data;
} hg_hair_numbers;

typedef enum { HG_HAIR_TRAINING = 0, HG_HAIR_EVALUATION = 1 } hg_hair_purpose;

/* ---- materials ---------------------------------------------------------------------------------------------- */

enum { HG_HAIR_MATERIALS = 8 };
typedef struct {
    char *name; /* "bend_twist.stiffness" */
    const char *unit;
    double low, high;
    double value; /* of a drape; at first the config's */
} hg_hair_material;

/* A parameter that begins at a part of its value and has all of it from step `steps` on. */
typedef struct {
    char *name; /* "body_collision.stiffness" */
    double value, start;
} hg_hair_ramp;

typedef struct {
    char *name, *report; /* "bend_twist.stiffness"; with "material." before it */
    double start;
    hg_tensor *theta; /* [] f32: the value is start * exp(theta) */
} hg_hair_learnt;

/* ---- batch -------------------------------------------------------------------------------------------------- */

/* B frames in R runs of N consecutive ones, and the two times before each run, as rows [t-2 of all runs | t-1 of all runs |
 * the frames of the first run, of the second, ..]: P = 2 R + B of them; with N = 1 these are [t-2 | t-1 | t] of all frames.
 * Pointers go into the same block. Bodies and roots are posed when the batch is made where the task computes on the host;
 * another device poses them in the step, from what moves the body. */
typedef struct {
    int64_t frames, runs, consecutive, rows, strands, body_vertices;
    int32_t *groom;   /* [P] of the subset's; runs of one groom stand together */
    float *inputs;    /* [P,frame_inputs] normalised */
    double *material; /* [B,materials + ramps] */
    /* host: */
    float *rotation; /* [P,S,4] */
    float *position; /* [P,S,3] */
    float *body;     /* [B,N,3] of the frames */
    /* another device: */
    float *shape;     /* [P,HG_SHAPES] */
    float *transform; /* [P,J,12] */
} hg_hair_batch;

/* ---- network ------------------------------------------------------------------------------------------------ */

/* What is the same for strands in every frame: made of a subset's features once a step, or once a drape. */
typedef struct {
    int64_t grooms, strands; /* strands of each */
    hg_tensor *rows;         /* [grooms strands,..]; of a network of grooms [grooms,..] */
    hg_tensor *texel;        /* [grooms strands] i32 the subset's, or NULL */
    hg_tensor *edges;        /* the subset's */
} hg_hair_part;

/* Strands as a network or a solution has them. */
typedef struct {
    hg_tensor *x;    /* [B,S,V,3] */
    hg_tensor *q;    /* [B,S,V-1,4] orientations of the edges; NULL: those of the posed groom */
    hg_tensor *mean; /* [B,S,V,3] of x - posed over a run; NULL: over the batch's own runs */
} hg_hair_strands;

/* A family of networks, in one file each: what an architecture is told of grooms, and how strands come out of it. It is found from
 * what the architecture declares; nothing else in here knows which one it serves. */
typedef struct {
    bool of_grooms;   /* what it is told beside the frame belongs to a groom, not to each of its strands */
    int64_t together; /* strands of a frame that are predicted at a time, so that they stay in the cache; 0: all */
    const char *encoder_label; /* what is shown while the encoder learns */
    /* Keeps of a groom that was loaded the strands that the network can draw. NULL: it draws all. */
    hg_status (*choose)(const hg_hair_task *task, hg_hair_style *style);
    /* Once the grooms are there: task->encoder as it begins, latent and strand_inputs. */
    hg_status (*make_encoder)(hg_hair_task *task);
    hg_status (*train_encoder)(hg_hair_task *task, const hg_progress *progress);
    hg_status (*encode)(hg_hair_task *task, hg_hair_style *style); /* fills its raw features */
    hg_status (*name_features)(hg_hair_task *task); /* the first strand_inputs, with their normalisation */
    hg_status (*check_model)(const hg_hair_task *task, const hg_model *model);
    hg_tensor *(*part)(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *features); /* rows of hg_hair_part */
    /* Rows of a batch of any grooms at once: row r of inputs [R,frame_inputs] shows groom[r] -> [R,..], which `outputs` takes
     * pieces of. NULL: nothing is gained by it, and `outputs` takes pieces of the inputs. */
    hg_tensor *(*images)(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                         hg_tensor *inputs);
    /* `rows` rows from `first` on, all of the one groom -> [rows,strands,outputs]. */
    hg_tensor *(*outputs)(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *whole,
                          int64_t first, int64_t rows, int32_t groom);
    int (*formulas)(const hg_hair_task *task, hg_hair_formula formulas[HG_HAIR_FORMULAS]);
} hg_hair_network;

extern const hg_hair_network hg_hair_network_strands; /* a row of numbers for each strand */
extern const hg_hair_network hg_hair_network_texture; /* an image of all strands of a groom */

/* ---- task --------------------------------------------------------------------------------------------------- */

struct hg_hair_task {
    hg_ctx *ctx;
    hg_config *config;
    uint64_t config_hash, seed;
    hg_dtype compute; /* of the network's products in a training step; validations are f32 */
    char *folder, *backend, *backend_note, *note, *start_from; /* start_from: a checkpoint; NULL: none */
    bool opened;                                               /* a finished run: nothing is trained or written */
    bool folder_made, encoder_trained;                         /* now: not there before */

    hg_body *body;
    hg_hair_style *styles; /* [n_styles]: the n_grooms trained on, then those that are only draped */
    int n_grooms, n_styles;
    int current;                 /* the one that is draped and evaluated */
    const hg_groom *groom;       /* of styles[current] */
    hg_hair_clip_data *clips[2]; /* trained on, held out */
    int n_clips[2];
    int64_t training_frames, consecutive; /* consecutive: frames of a run in a step */
    double rate, spread[HG_SHAPES];

    const hg_hair_network *network;
    hg_poser *poser;
    int64_t body_vertices; /* kept by the poser */
    float *posed_body;     /* [body_vertices,3] scratch */
    hg_body_tree *tree;    /* collider */

    hg_hair_layout layout;
    int strand_inputs, inputs, outputs, pinned, latent;
    int rest_columns;  /* of the concatenated input, behind the strand's: only for directions */
    bool directions;   /* outputs turn edges */
    bool orientations; /* the last 4 (V - pinned) outputs turn the frames of the edges */
    bool world;        /* displacements, and turns, are along the axes of the world, not of the head at rest */
    double output_scale, orientation_scale;
    double *mean, *deviation; /* [inputs] */
    hg_feature *features;     /* [inputs] */
    int n_features;
    double strand_scale; /* of the encoder's inputs [1/m] */
    hg_model *encoder, *model;
    hg_model whole; /* model, with what else is learnt among its parameters */
    hg_tensor **whole_params;
    hg_hair_material materials[HG_HAIR_MATERIALS];
    hg_hair_learnt learnt[HG_HAIR_MATERIALS];
    hg_hair_ramp ramps[HG_HAIR_MATERIALS];
    int n_ramps;
    double ramp_steps;
    int n_materials, n_learnt;
    hg_tensor *no_turn;    /* [4]: 1, 0, 0, 0, where there are orientations */
    hg_tensor *along;      /* [3]: 0, 0, 1, where they are carried to the strands' own edges; else NULL */
    hg_tensor *output_map; /* [outputs,(V-1)*3]: outputs -> displacements */
    hg_tensor *mean_tensor, *inverse_deviation;

    hg_hair_terms terms;
    hg_hair_asks asks;
    char *term_name[HG_HAIR_TERMS][3]; /* weighted, in joule, of a validation: for the log */
    bool moves;                        /* an energy knows of the frames before */
    double reference;                  /* m g L of the mean strand [J] */
    double clip_vertex;                /* largest force on a vertex that is learnt from [N]; 0: none */

    hg_hair_subset subset, evaluation;
    int64_t subset_epoch;
    void *validation_batch;
    size_t batch_bytes;
    hg_task task;
    hg_train_options options;
};

hg_status hg_hair_world_create(hg_hair_task *task, const hg_progress *progress);
hg_status hg_hair_encoder_create(hg_hair_task *task, const hg_progress *progress); /* and what belongs to each groom */
hg_status hg_hair_encoder_learn(hg_hair_task *task, const hg_task *learn, const hg_progress *progress);
hg_status hg_hair_encoder_save(const hg_hair_task *task, hg_h5 *file);
hg_status hg_hair_encoder_keep(const hg_hair_task *task); /* in the run folder, when it was trained now */
hg_status hg_hair_encoder_load(hg_hair_task *task, hg_h5 *file);
hg_status hg_hair_encode(hg_hair_task *task); /* raw features of all grooms from the encoder as it is */
hg_status hg_hair_style_strands(hg_hair_task *task,
                                hg_hair_style *style); /* makes and fills what belongs to its strands */
void hg_hair_style_destroy(hg_hair_style *style);
uint64_t hg_hair_grooms_hash(const hg_hair_task *task); /* of those trained on; of a single one its own */
hg_status hg_hair_features_create(hg_hair_task *task);  /* names and normalisation; once the strands are there */
hg_status hg_hair_add_feature(hg_hair_task *task, char *name /* taken over */, double mean, double deviation);
hg_status hg_hair_features_tensors(hg_hair_task *task);
void hg_hair_normalise_frame(const hg_hair_task *task, const float *raw, float *out);

/* TRAINING: of all grooms trained on. EVALUATION: of the current one. */
hg_status hg_hair_subset_create(hg_hair_subset *subset, hg_hair_task *task, hg_hair_purpose purpose, int64_t epoch);
void hg_hair_subset_destroy(hg_hair_subset *subset);
hg_status hg_hair_subset_features(hg_hair_subset *subset, const hg_hair_task *task); /* and its rest strands */
hg_status hg_hair_numbers_create(hg_hair_numbers *numbers, hg_hair_subset *subset, const hg_hair_task *task);
void hg_hair_numbers_destroy(hg_hair_numbers *numbers);
double hg_hair_reference_energy(const hg_hair_task *task, double *vertex_weight); /* J; N */
hg_status hg_hair_evaluation_subset(hg_hair_task *task);                          /* made at the first call */

int64_t hg_hair_batch_rows(const hg_hair_task *task, int64_t frames);
size_t hg_hair_batch_bytes(const hg_hair_task *task, int64_t frames, int64_t strands);
hg_hair_batch *hg_hair_batch_lay_out(const hg_hair_task *task, void *bytes, int64_t frames, int64_t strands);
/* Fills a run of a batch: the clip from frame - 2 to frame + N - 1, with a body shape and one of the subset's grooms. */
hg_status hg_hair_batch_fill(hg_hair_task *task, hg_ctx *ctx, hg_hair_batch *batch, const hg_hair_subset *subset,
                             int64_t run, int32_t groom, const hg_hair_clip_data *clip, int64_t frame,
                             const double shape[HG_SHAPES], const double *material);
hg_status hg_hair_sample(void *self, hg_ctx *ctx, uint64_t seed, uint64_t step, void *batch);
void hg_hair_draw_shape(const hg_hair_task *task, uint64_t seed, uint64_t counter, double shape[HG_SHAPES]);

hg_status hg_hair_materials_create(hg_hair_task *task); /* once the terms are there */
void hg_hair_materials_destroy(hg_hair_task *task);
hg_status hg_hair_whole_model(hg_hair_task *task);
/* step: of the training, for what rises; negative: it has risen. values [materials + ramps], at most HG_HAIR_GIVEN. */
enum { HG_HAIR_GIVEN = 2 * HG_HAIR_MATERIALS };
void hg_hair_draw_materials(const hg_hair_task *task, uint64_t seed, uint64_t counter, int64_t step, double *values);
/* Fills the last raw columns of a frame; values NULL: those of a drape. */
void hg_hair_material_features(const hg_hair_task *task, const double *values, float *frame);
void hg_hair_report_learnt(const hg_hair_task *task, hg_ctx *ctx,
                           hg_report *report); /* of the step, read when it is logged */

hg_status hg_hair_network_find(hg_hair_task *task);   /* the family of the config's model */
hg_status hg_hair_network_create(hg_hair_task *task); /* the model and what its outputs mean */
hg_hair_part hg_hair_part_of(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset); /* of the step */
hg_status hg_hair_part_keep(hg_hair_part *part, const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset);
void hg_hair_part_free(hg_hair_part *part); /* one that was kept */
/* Strands [R,S,V,3] of rows of inputs [R,frame_inputs]: row r shows the part's groom groom[r] (NULL: its only one), whose rest
 * strands are in rest [grooms S,V,3]; rotation [R,S,4], position [R,S,3]. Rows of one groom best stand together. */
hg_tensor *hg_hair_predict(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                           hg_tensor *inputs, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position);
/* The same with the orientations of their edges [R,S,V-1,4], where the network predicts any; else NULL. */
hg_tensor *hg_hair_predict_edges(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                                 hg_tensor *inputs, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position,
                                 hg_tensor **q);
/* Frames of any grooms [R,frame_inputs], those of part -> what hg_hair_predict_row takes rows of. */
hg_tensor *hg_hair_images(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const int32_t *groom,
                          hg_tensor *inputs);
/* Row `row` of it, without gradient: part, rest [n,V,3], rotation [n,4] and position [n,3] of the strands of its groom
 * -> x [n,V,3], and q [n,V-1,4], the orientations of a network that predicts them and whose part has edges; NULL: not wanted. */
hg_status hg_hair_predict_row(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, hg_tensor *whole,
                              int64_t row, hg_tensor *rest, const float *rotation, const float *position, float *x,
                              float *q);
/* Both, of one frame: inputs [frame_inputs]. */
hg_status hg_hair_predict_frame(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_part *part, const float *inputs,
                                hg_tensor *rest, const float *rotation, const float *position, float *x);
/* For formulas: columns first.. of (raw - mean) / deviation; outputs [..,S,outputs] as displacements, and turns, in rows; what these
 * are, as a sentence. rest [S,V,3]: with directions. */
hg_tensor *hg_hair_normalised(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw, int64_t first, int64_t count);
hg_tensor *hg_hair_as_rows(const hg_hair_task *task, hg_ctx *ctx, hg_tensor *outputs, hg_tensor *rest);
const char *hg_hair_displacements_are(const hg_hair_task *task);
/* Those of networks of strands: ONE concatenated raw input [N,inputs] -> rows [N,..]; and in two parts: what belongs to the strands,
 * raw [S,strand_inputs] without the rest columns -> [S,width], and the rest: part, raw frame features [B,frame_inputs], and with
 * directions the rest columns [S,(V-1)*3] (else NULL) -> [B,S,..]. */
hg_tensor *hg_hair_forward_concatenated(hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw);
hg_tensor *hg_hair_forward_strands(hg_hair_task *task, hg_ctx *ctx, hg_tensor *raw);
hg_tensor *hg_hair_forward_frames(hg_hair_task *task, hg_ctx *ctx, hg_tensor *part, hg_tensor *raw, hg_tensor *rest);
/* Frames q [V-1,4] of the edges of a rest strand [V,3], carried along it. */
void hg_hair_edge_frames(const float *rest, int64_t vertices, float *q);
/* The posed groom [B,S,V,3] of rest strands [S,V,3] or [B,S,V,3]; of the step. */
hg_tensor *hg_hair_posed(hg_ctx *ctx, hg_tensor *rest, hg_tensor *rotation, hg_tensor *position);
/* What physics takes beside x, into the frame (whose groom and roots are there). materials [B,n_materials], NULL: those of a
 * drape. Lives in the step. */
hg_status hg_hair_physics_inputs(const hg_hair_task *task, hg_ctx *ctx, const hg_hair_subset *subset,
                                 const double *materials, const hg_hair_strands *strands, hg_frame *frame);
/* Adds the vertices of strands x [S,V,3] that are deeper than 0.1 mm in the body, roots left out. triangle [S,V] keeps
 * guesses from call to call, at first -1; the others [S,V,3] are scratch. */
hg_status hg_hair_count_inside(hg_ctx *host, hg_body_refit *refit, int64_t S, int64_t V, const float *x,
                               int32_t *triangle, float *contact_point, float *contact_normal, int64_t *inside);
/* Sums over strands x [S,V,3] and the same ones rigidly posed; lengths [S,V-1] of the rest edges. */
typedef struct {
    double length_error, orientation, bend[2] /* of x, posed */, tips;
    int64_t strands, segments;
} hg_hair_segments;
void hg_hair_segments_add(hg_hair_segments *sum, int64_t S, int64_t V, const float *x, const float *posed,
                          const double *lengths);
void hg_hair_segments_mean(const hg_hair_segments *sum, hg_hair_metrics *metrics);
/* unweighted: [terms] f64, joule of the batch, gravity counted from the roots; of the step. */
hg_tensor *hg_hair_energy(hg_hair_task *task, hg_ctx *ctx, const hg_hair_batch *batch, hg_hair_subset *subset,
                          hg_tensor **unweighted);

#endif
