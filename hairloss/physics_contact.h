/* Where strands are near the body; private to hairloss/. */
#ifndef HG_HAIRLOSS_PHYSICS_CONTACT_H
#define HG_HAIRLOSS_PHYSICS_CONTACT_H

#include "hairloss/hairloss.h"

typedef struct {
    hg_contact_mode mode;
    hg_body_refit *refit; /* of the frames of the batch */
    hg_tensor *triangles; /* [B,S,V] the last closest triangles: guesses for the next call */
    int64_t frames;       /* how many the two have room for */

    bool held, known;                  /* the body stays where it is; it was looked at since */
    int64_t room;                      /* vertices that what follows has room for */
    char *x, *point, *normal;          /* [S,V,3] of the last call, in the dtype of the physics */
    int32_t *moved, *triangle;         /* [S V] vertices that moved since then, their guesses */
    char *at, *its_point, *its_normal; /* [S V,3] of those */
} hg_physics_contact;

void hg_physics_contact_free(hg_physics_contact *contact);
/* Memory of the step, or the contact's own while the body is held. */
hg_status hg_physics_contact_find(hg_physics_contact *contact, hg_ctx *ctx, hg_dtype dtype, const hg_body_tree *body,
                                  const hg_tensor *body_vertices, const hg_tensor *x, double reach, void **point,
                                  void **normal);

#endif
