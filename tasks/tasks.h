/* tasks: what a model is trained on. Features, frames, sampling, losses, metrics; from one YAML config.
 *
 *     hg_hair_task *hair;
 *     hg_hair_task_create(&hair, ctx, config, "out/run", &progress);        loads or makes groom, body, motions; encoder; physics
 *     hg_train(ctx, hg_hair_model(hair), hg_hair_task_of(hair), &options, &progress, &result);
 *     hg_hair_evaluate(hair, ctx, clip, shape, clip->frames, &metrics, &progress);
 *
 * Order and scaling of every network input: docs/neuralocks.md.
 */
#ifndef HG_TASKS_H
#define HG_TASKS_H

#include "hairloss/hairloss.h"
#include "scene/scene.h"
#include "solvers/solvers.h"
#include "train/train.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- config ------------------------------------------------------------------------------------------------- */

/* The schema: scene, model, losses (one section per registered energy, made from its parameters), training. */
const hg_config_row *hg_hair_schema(int *n);
hg_status hg_hair_config_load(hg_config **config, const char *path);
hg_status hg_hair_config_check(hg_ctx *ctx, hg_findings *findings, const char *path); /* all that can be known without training; writes nothing */

/* ---- task --------------------------------------------------------------------------------------------------- */

typedef struct hg_hair_task hg_hair_task;
hg_status hg_hair_task_create(hg_hair_task **task, hg_ctx *ctx, const hg_config *config, const char *run_folder, const hg_progress *progress);
void      hg_hair_task_destroy(hg_hair_task *task);
const hg_task *hg_hair_task_of(hg_hair_task *task);
hg_model *hg_hair_model(hg_hair_task *task);
hg_train_options hg_hair_train_options(const hg_hair_task *task);
/* From a run folder: config, checkpoint (best when there is one) and everything ready to drape. */
hg_status hg_hair_task_open(hg_hair_task **task, hg_ctx *ctx, const char *run_folder, const hg_progress *progress);
/* The same with values of its config replaced ("KEY=VALUE"): the same weights judged by other energies. */
hg_status hg_hair_task_open_with(hg_hair_task **task, hg_ctx *ctx, const char *run_folder, int n, const char *const *overrides, const hg_progress *progress);
const hg_groom *hg_hair_groom(const hg_hair_task *task);
int hg_hair_grooms(const hg_hair_task *task);                     /* trained on; hg_hair_groom is the one that is draped */
const hg_groom *hg_hair_groom_at(const hg_hair_task *task, int i);
/* Strands of groom i (-1: of hg_hair_groom) that the network cannot draw: hg_hair_groom is without them. */
int64_t hg_hair_left_out(const hg_hair_task *task, int i);
/* The groom to drape and evaluate from now on: one of those trained on, by its file's name or its style, or another: a
 * file or a style. Its strands need as many vertices. */
hg_status hg_hair_choose_groom(hg_hair_task *task, const char *name);
hg_status hg_hair_find_groom(hg_hair_task *task, const char *name, int *i); /* the same groom's number, for hg_hair_groom_at; nothing is chosen */
const char *hg_hair_groom_name(const hg_hair_task *task, int i);
const hg_physics *hg_hair_physics(const hg_hair_task *task);
const hg_body  *hg_hair_body(const hg_hair_task *task);
double hg_hair_rate(const hg_hair_task *task);                    /* frames per second that the network was trained for */
int hg_hair_clips(const hg_hair_task *task, bool held_out);
const hg_motion *hg_hair_clip(const hg_hair_task *task, bool held_out, int i);

/* Materials that are inputs of the network (`features.materials`): what a drape, an evaluation and exported sample rows have. */
int       hg_hair_materials(const hg_hair_task *task);
hg_status hg_hair_material_at(const hg_hair_task *task, int i, const char **name, const char **unit, double range[2], double *value);
hg_status hg_hair_set_material(hg_hair_task *task, const char *name, double value); /* "bend_twist.stiffness"; outside of its range is an error */

/* ---- network input and output, for export ------------------------------------------------------------------- */

typedef struct { const char *name; int first, count; double mean, deviation; } hg_feature; /* of the concatenated input, in order */
int hg_hair_features(const hg_hair_task *task, const hg_feature **features);      /* count; strand features first */
int hg_hair_strand_inputs(const hg_hair_task *task);                              /* how many input columns, the first ones, stay the same over frames: a strand's, or its groom's */
/* Raw features (not normalised) of a strand subset and of one frame. With `model.output: directions` the last of a
 * strand's is "rest": its vertices 1.. relative to the root, [(V-1)*3]: what the turned edges start from. */
hg_status hg_hair_strand_features(hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t n, float *out /* [n,strand_inputs] */);
hg_status hg_hair_frame_features(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, int64_t frame, const double *shape, float *out /* [frame_inputs] */);
/* Columns of turns behind the displacements, of a network with `model.orientations`: (V-1)*4, else 0. Turns o [V-1,4] (w,x,y,z) are
 * nearly of length one: the orientation of an edge is R o q0, R the root's rotation and q0 its frame at rest, carried along the rest
 * strand; with `model.orientation_of: edges` T R o q0, T the short way from the posed edge's direction to the edge's. */
int  hg_hair_turns(const hg_hair_task *task);
bool hg_hair_turns_edges(const hg_hair_task *task);                               /* with T */
/* Of a network that makes images of grooms: their side T, and of each strand of the groom its texel, row T + column, and its number in
 * the groom before strands without a texel were left out. Else 0. */
int hg_hair_texture(const hg_hair_task *task, const int32_t **texel, const int32_t **strand);

/* The network as formulas of raw inputs, as it is exported. Formulas of one form belong together: a part's output is an input of the
 * next. The first form's has one input, which has all columns of hg_hair_features. */
typedef struct { const char *name; int columns /* -1: as many as the output of the formula before */; const char *rows; } hg_hair_formula_input;
typedef struct {
    const char *form, *part;                  /* "concatenated"; "factored", "strand"; part NULL: the only one */
    const char *what, *takes, *output, *gives; /* a sentence; what the inputs are; the output's name, and what it is */
    int n_inputs; hg_hair_formula_input input[3];
    int n_rows; const char *rows[2];          /* leading axes of the output that are as long as inputs */
    hg_tensor *(*forward)(void *task, hg_ctx *ctx, hg_tensor **in);
} hg_hair_formula;
enum { HG_HAIR_FORMULAS = 4 };
int hg_hair_formulas(const hg_hair_task *task, hg_hair_formula formulas[HG_HAIR_FORMULAS]); /* how many */

/* ---- drape -------------------------------------------------------------------------------------------------- */

/* A whole motion, every strand of the groom (or every `stride`-th). Calls back once per frame, in order. */
typedef struct { int64_t frame, strands, vertices; const int32_t *strand; const float *x /* [S,V,3] */, *posed; const float *body_vertices /* [N,3] */; const float *root_rotation, *root_position; const float *q /* [S,V-1,4] orientations of the edges, where energies ask for them; NULL: none */; } hg_drape_frame;
typedef hg_status (*hg_drape_sink)(void *self, const hg_drape_frame *frame);
hg_status hg_hair_drape(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape, int64_t first, int64_t frames, int64_t stride,
                        hg_drape_sink sink, void *self, const hg_progress *progress);

/* Many pairs of a groom and a pose, in their order: what a frame of theirs in hg_hair_drape is. A network that makes images of grooms
 * makes those of many pairs at once. */
typedef struct { int groom; /* see hg_hair_find_groom */ const hg_motion *motion; int64_t frame; const double *shape; /* NULL: the neutral body */ } hg_drape_pair;
typedef struct {
    int64_t stride;      /* every so many-th strand; 0: all */
    int64_t together;    /* pairs at once; 0: as many as 256 MB hold of the network's numbers */
    bool bodies, posed;  /* the frames have body_vertices, posed; else these are NULL */
} hg_drape_pairs_options;
typedef hg_status (*hg_drape_pairs_sink)(void *self, int64_t pair, const hg_drape_frame *frame);
hg_status hg_hair_drape_pairs(hg_hair_task *task, hg_ctx *ctx, int64_t n, const hg_drape_pair *pairs, const hg_drape_pairs_options *options,
                              hg_drape_pairs_sink sink, void *self, const hg_progress *progress);

/* ---- material of an observed drape --------------------------------------------------------------------------- */

/* Strands of the current groom as they were seen, in the world. before, older: one and two frames earlier, NULL: at rest. */
typedef struct { const float *x /* [S,V,3] */, *before, *older; const float *body_vertices /* [N,3] */; const float *root_rotation /* [S,4] */, *root_position /* [S,3] */; } hg_observed_frame;
/* The values of parameters of the config's energies with which these frames are in balance (solvers/solvers.h). */
hg_status hg_hair_fit_material(hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t strands, int n, const hg_observed_frame *frames, const hg_material_options *options, hg_material_fit *fit);

/* ---- metrics ------------------------------------------------------------------------------------------------ */

typedef struct {
    int64_t frames, strands;
    double length_error;          /* mean |l - l0| / l0, % */
    double orientation;           /* mean angle of segments against the posed groom, degrees */
    double inside, inside_posed;  /* vertices deeper than 0.1 mm in the body, roots left out, % */
    double energy, energy_posed;  /* total per strand [J], gravity counted from the posed groom */
    double gravity_body, gravity_body_posed;
    int n_terms; const char *term[16]; double term_energy[16], term_posed[16];  /* per strand [J] */
    double curl;                  /* mean angle between neighbouring segments over that of the posed groom: 1 keeps the style, 0 is straight */
    double tip_moved;             /* mean distance of the tips from the posed groom's, % of the strands' length: how far the hair hangs */
    double tip_amplitude;         /* rms tip speed in the head's frame [m/s] */
    double tip_lag;               /* s, by the largest correlation of tip and head angular movement; NAN when still */
} hg_hair_metrics;
/* `frames` 0: the whole clip. Strands are drawn over the whole groom, as many as in training. */
hg_status hg_hair_evaluate(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape, int64_t frames, hg_hair_metrics *metrics, const hg_progress *progress);

void      hg_hair_held_out_shape(const hg_hair_task *task, int64_t i, double shape[HG_SHAPES]); /* the i-th body shape that training does not draw */
/* Mean over clips, weighted by their frames; tip_lag over those that have one. */
void      hg_hair_metrics_mean(const hg_hair_metrics *metrics, int n, hg_hair_metrics *mean);
/* { "clips": [ { "clip": name, .. }, .. ], "mean": { .. } }, every number with its unit in its name. */
hg_status hg_hair_metrics_write(const char *path, int n, const char *const *clips, const hg_hair_metrics *metrics);

/* ---- the minimum that a network is to find ------------------------------------------------------------------- */

/* The config's energies minimised over a motion, frame by frame, without the network. Quasi-static: each frame from the posed
 * groom, and energies that know of other frames (inertia, drag) are left out. dynamic: frame `first` so, at rest; then each frame is
 * the minimum of all energies with the two frames before it. */
typedef struct {
    hg_minimise_options minimise;        /* pinned 0: the config's; its method says who solves */
    hg_xpbd_options xpbd;                /* method HG_XPBD; pinned, dt and stop are the solve's */
    bool dynamic;
    int64_t first, frames;               /* frames 0: to the end of the clip */
    int64_t strands;                     /* so many, evenly over the groom; 0: as many as a training step has */
    const int32_t *strand;               /* [strands] of the groom: these ones; NULL: evenly */
} hg_hair_solve_options;
typedef struct {
    hg_hair_metrics metrics;             /* of the minimum; the last two of them are NAN. Its energies are those that were minimised; dynamic: without the first frame */
    int64_t solves, converged, stalled;  /* strands times frames; see hg_minimised */
    int64_t evaluations;
    double iterations, seconds;          /* mean of a strand; of it all */
    double force, movement;              /* largest that is left anywhere: N, m. xpbd: no force; movement and converged are those of the last step to rest, and of frames at rest alone */
    char left_out[256];                  /* xpbd: energies that it has no constraint for, "adhesion, self_collision"; they are in the metrics all the same */
    bool interrupted;
} hg_hair_solution;
hg_status hg_hair_solve(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape, const hg_hair_solve_options *options,
                        hg_drape_sink sink, void *self, hg_hair_solution *solution, const hg_progress *progress);
hg_status hg_hair_solution_write(const char *path, const char *clip, const hg_hair_solution *solution); /* JSON, units in the names */

/* ---- a network beside solvers: docs/evaluate.md --------------------------------------------------------------- */

/* Who drapes: frames first .. first + frames - 1 of a motion, every stride-th strand, to the sink. NULL: the task's network. */
typedef hg_status (*hg_hair_draper)(void *self, const hg_motion *motion, const double *shape, int64_t first, int64_t frames, int64_t stride, hg_drape_sink sink, void *to);
typedef struct { const char *name; hg_hair_solve_options how; /* method and its limits; motion, frames and strands are set here */ } hg_against_solver;
typedef struct {
    int n_solvers; const hg_against_solver *solver; /* at most HG_AGAINST_SIDES - 2; the first lbfgs among them is the reference, else the first */
    int64_t poses;                       /* held still, evenly over the clip; 0: 6 */
    int64_t frames;                      /* consecutive, where the head moves most; for energies that know of other frames; 0: 45; 1: no motion */
    int64_t settle;                      /* frames before them in which the solvers come from rest into the motion; 0: half a second */
    int64_t strands;                     /* about so many, evenly over the groom; 0: 200 */
    hg_hair_draper drape; void *self;
} hg_against_options;

/* Poses, or frames of a motion. Energies are weighted, per strand [J], gravity counted from the posed groom. In motion they are those
 * of a side's movement with its own past, and excess is not their difference: there all sides are put into the energy of each frame
 * whose past is the reference's, of which the reference is the minimum. */
typedef struct {
    double seconds;                      /* of a frame, the body posed; NAN: nobody's */
    double length_error, orientation, curl, inside; /* %, degrees, 1, %: as in hg_hair_metrics */
    double distance, distance_p95;       /* m: of free vertices from the reference's, mean and 95th percentile */
    double energy, term_energy[16];
    double excess, excess_free;          /* J per strand above the reference; without the energies of contact */
    double excess_median, excess_free_median; /* of strands and frames: one vertex deep in the body is most of a mean */
    double gap, gap_median;              /* excess over the posed groom's excess_free, and of their medians: 0 is the reference; the posed groom has 1. NAN where it has none */
    double gap_free;                     /* without contact on either side; hair that goes through the body can be below 0 */
    double gap_contact;                  /* excess over the posed groom's excess: it stands in shoulders, and its contact makes every network look good */
    int64_t solves, converged, stalled;  /* of a solver: strands times frames; neither: an upper bound of the minimum */
} hg_against_part;
/* Tips as seen from their roots' rigid frames, where posed ones stand still. */
typedef struct {
    double speed, excursion;             /* rms: m/s; m about their mean place */
    double correlation;                  /* of the ways about their means with the reference's: 1 the same, 0 nothing in common */
    double lag;                          /* s behind the reference, by the largest correlation of velocities; NAN when either is still */
} hg_against_tips;
#define HG_AGAINST_SIDES 6
typedef struct { const char *name; hg_against_part rest, motion; hg_against_tips tips; } hg_against_side;
typedef struct {
    int64_t strands, poses, frames, first; /* frames 0: no motion was compared; first: of the clip */
    double rate;                         /* frames per second */
    int n_terms; const char *term[16]; bool term_moves[16]; /* moves: knows of other frames, and is 0 at rest */
    int n_sides, reference;              /* the network, the solvers in their order, the posed groom */
    hg_against_side side[HG_AGAINST_SIDES];
    int n_tips; double *tip;             /* [n_tips,n_sides,frames] m off the posed place, along the widest way of the reference: a tip that swings much, one as most do */
} hg_against;
/* The same strands of the current groom, the same clip and body shape for all. Names are the options' and the registry's. */
hg_status hg_hair_against(hg_hair_task *task, hg_ctx *ctx, const hg_motion *motion, const double *shape, const hg_against_options *options, hg_against *against, const hg_progress *progress);
void      hg_hair_against_free(hg_against *against);
/* Over clips of one comparison, weighted by poses and frames; a gap is that of the means. Has no tips; is not freed. */
void      hg_hair_against_mean(const hg_against *against, int n, hg_against *mean);
/* { "against": { "clips": [ { "clip": name, .. }, .. ], "mean": { .. } } }, every number with its unit in its name. */
hg_status hg_hair_against_write(const char *path, int n, const char *const *clips, const hg_against *against);

#ifdef __cplusplus
}
#endif
#endif
