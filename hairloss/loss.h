/* loss (private): energies on arrays of a file.
 *
 *   loss_terms.c   energies by name, "key=value" settings
 *   loss_data.c    datasets -> groom data and frame
 *   loss.c         value, gradients, what is written
 */
#ifndef HG_HAIRLOSS_LOSS_H
#define HG_HAIRLOSS_LOSS_H

#include "hairloss/physics.h"

enum { LOSS_TERMS = 8, LOSS_ARRAYS = 48, LOSS_NAMES = 16 };

/* A dataset, or what stands for one that is absent. `axes` says what its axes are, one letter each: g grooms, b frames,
 * s strands, v vertices, e edges, n body vertices; a digit is a width. */
typedef struct {
    char *name, *full; /* "stiffness", "stretch.stiffness"; full is NULL where they are the same */
    const char *unit;  /* of a parameter, for settings */
    char axes[8];
    int rank; /* as given: without the first axis where that is one frame or groom */
    int64_t shape[4], count;
    double *values;
    bool given, set;      /* in the file; by a setting */
    int term, param;      /* a parameter's: number of its term, of (the first component of) itself; else -1 */
    hg_tensor *tensor[3]; /* on the tape: one, or three of a vector parameter; NULL: not there */
} loss_array;

/* What the formulas of all terms read. */
typedef struct {
    uint32_t kinds; /* HG_ALLOW(kind) */
    bool pairs, field, contact;
    int n_attributes, n_frame;
    char *attribute[LOSS_NAMES]; /* names of groom attributes */
    char *frame[LOSS_NAMES];     /* names of arrays of the frame */
    int width[LOSS_NAMES];       /* 1 or 3 */
} loss_reads;

typedef struct {
    hg_ctx *ctx;
    const char *path;
    hg_h5 *file;
    hg_dtype dtype;
    int n_terms;
    hg_term term[LOSS_TERMS];
    double params[LOSS_TERMS][HG_ENERGY_PARAMS];
    const char *options[LOSS_TERMS][HG_ENERGY_OPTIONS];
    loss_reads reads;
    int64_t size[26]; /* of the axes, by letter; -1: not known yet */
    int n_arrays;
    loss_array array[LOSS_ARRAYS];
    bool has_x;

    hg_groom_data data;
    double *mass;
    hg_groom_attribute attribute[LOSS_NAMES];
    hg_body_tree *body;
    hg_pairs *pairs;
    int32_t *groom;
    hg_frame frame;
    hg_frame_input input[LOSS_ARRAYS + 2];
    char *texts[4 * LOSS_ARRAYS]; /* names and choices that live as long as this */
    int n_texts;
} loss;

/* Keeps a new string until the end; NULL when there is no memory. */
char *loss_keep(loss *l, char *text);
loss_array *loss_find(loss *l, const char *name); /* by name or full name; NULL */
loss_array *loss_add(loss *l, const char *name);  /* NULL and a message: no room, no memory */
hg_status loss_read_terms(loss *l, const char *energies, int n_set, const char *const *set);
hg_status loss_read_data(loss *l);
/* Tensors of the tape for what the frame brings and for the arrays named in wrt. */
hg_status loss_make_frame(loss *l, int n_wrt, loss_array *const *wrt);
void loss_free(loss *l);

#endif
