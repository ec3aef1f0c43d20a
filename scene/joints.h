/* What rigs call their joints. Private to scene/. */
#ifndef HG_SCENE_JOINTS_H
#define HG_SCENE_JOINTS_H

#include "base/base.h"

/* How the rest pose of a joint is brought over to another rig: as it is; along its bone to `other`; as the joint above;
 * by the shin of `other`, which leaves soles flat. */
typedef enum { JOINT_KEEP, JOINT_CHAIN, JOINT_PARENT, JOINT_SOLE } joint_rule;

/* Families of names. JOINTS_OWN: the CMU rig of MakeHuman and of the bust, whose names are used here for all of them. */
typedef enum {
    JOINTS_OWN,
    JOINTS_ASF,     /* CMU .asf */
    JOINTS_BUILDER, /* CMU .bvh made for MotionBuilder */
    JOINTS_POSER,   /* CMU .bvh made for Poser */
    JOINTS_SMPL,    /* SMPL, SMPL-H, SMPL-X and AMASS */
    JOINTS_MIXAMO,  /* with or without "mixamorig:" */
    JOINTS_GAME,    /* of game engines: pelvis, spine_01, upperarm_l... */
    JOINTS_FAMILIES
} joint_family;

typedef struct {
    const char *name[JOINTS_FAMILIES]; /* NULL: that family has none */
    joint_rule rule;
    const char *other; /* own name */
} joint_row;

extern const joint_row joint_rows[];
extern const int joint_row_count;

joint_family joints_family(char *const *names, int64_t n);          /* that has most of these names */
const joint_row *joints_row(const char *name, joint_family family); /* NULL when it has none */
int joints_find(char *const *names, int64_t n, const char *name);   /* exactly; -1: none */
int joints_find_row(char *const *names, int64_t n, const joint_row *row, joint_family family); /* -1: none */
bool joints_flat(joint_family family); /* soles are flat in the rest pose */

/* Of the 24, 52 or 55 joints of SMPL, SMPL-H and SMPL-X, or the 22 without hands; NULL: no model has so many. */
const char *const *joints_smpl(int64_t count);
const int32_t *joints_smpl_parents(int64_t count);

#endif
