/* judge: chosen strands of the current groom under the config's energies in f64, for what is compared with a solver. Private to
 * tasks/. */
#ifndef HG_TASKS_JUDGE_H
#define HG_TASKS_JUDGE_H

#include "tasks/hair.h"

/* The terms of the config, with the materials of a drape and what was learnt in the place of the config's numbers. moving false:
 * without those that look at other frames. column[i]: number of term i in the config. params holds the numbers. */
hg_status hg_hair_terms_now(hg_hair_task *task, bool moving, double params[HG_HAIR_TERMS][HG_ENERGY_PARAMS],
                            hg_term term[HG_HAIR_TERMS], int column[HG_HAIR_TERMS], int *n);
/* Does an energy of the config look at other frames? */
hg_status hg_hair_is_dynamic(hg_hair_task *task, bool *dynamic);

typedef struct {
    hg_hair_task *task;
    hg_ctx *ctx; /* of the host */
    int64_t S, V;
    hg_hair_subset subset;
    hg_hair_numbers numbers;
    hg_physics *physics[2]; /* at rest, moving */
    int n_terms[2], column[2][HG_HAIR_TERMS];
    hg_tensor *x, *before, *predicted, *root_rotation, *root_position, *body_vertices;
    hg_tensor *posed, *q; /* NULL where no energy asks for them */
    float *edges;         /* [S,V-1,4] frames of the rest edges */
    hg_body_refit *refit;
    float *contact_point, *contact_normal;
    int32_t *triangle;
    double *terms; /* [S,terms] */
} hg_hair_judge;

hg_status hg_hair_judge_create(hg_hair_judge *judge, hg_hair_task *task, hg_ctx *ctx, const int32_t *strand, int64_t n);
void hg_hair_judge_free(hg_hair_judge *judge);
/* The frame that is judged from now on: root_rotation [S,4], root_position [S,3], posed [S,V,3], collider [N,3]. */
hg_status hg_hair_judge_frame(hg_hair_judge *judge, const float *root_rotation, const float *root_position,
                              const float *posed, const float *collider);
/* Adds the weighted energies of all strands x [S,V,3] by the config's terms; before and older: of the frames before, NULL: at
 * rest. q [S,V-1,4]: orientations of its edges, NULL: the posed groom's.
 * per_strand [2,S]: set to the sums of the terms, and to those without contact; NULL: not wanted. */
hg_status hg_hair_judge_energies(hg_hair_judge *judge, const float *x, const float *q, const float *before,
                                 const float *older, double energy[HG_HAIR_TERMS], double *per_strand);
hg_status hg_hair_judge_inside(hg_hair_judge *judge, const float *x, int64_t *inside);

void hg_hair_against_gaps(hg_against *against); /* from what the sides have above the reference */

#endif
