/* The sums of built-in energies that kernels are printed for: printed by generate_kernels.c, tested by test_energies.c.
 * Energies in any order; options in the order of the energy, the missing ones by default. */
#ifndef HG_HAIRLOSS_USUAL_SUMS_H
#define HG_HAIRLOSS_USUAL_SUMS_H

#include "hairloss/hairloss.h"

enum { USUAL_TERMS = 8 };
typedef struct {
    const char *energy, *options[HG_ENERGY_OPTIONS];
} usual_term;

#define USUAL_STILL(strain_, root_)                                                                                    \
    { "stretch", { 0 } }, { "bend_twist", { strain_, root_ } },                                                        \
    {                                                                                                                  \
        "gravity", { 0 }                                                                                               \
    }
#define USUAL_CHAIN(strain_, root_)                                                                                    \
    { "stretch", { 0 } }, { "bend_twist_chain", { strain_, root_ } },                                                  \
    {                                                                                                                  \
        "gravity", { 0 }                                                                                               \
    }
#define USUAL_CONTACT                                                                                                  \
    {                                                                                                                  \
        "body_collision", { "exact", "true" }                                                                          \
    }
#define USUAL_MOVING                                                                                                   \
    { "inertia", { 0 } },                                                                                              \
    {                                                                                                                  \
        "drag", { 0 }                                                                                                  \
    }
#define USUAL_STYLE                                                                                                    \
    {                                                                                                                  \
        "hair_style", { "scalp" }                                                                                      \
    }

static const usual_term usual_sums[][USUAL_TERMS] = {
    { USUAL_STILL("published", "free"), { "inertia", { 0 } } },
    /* dynamic, as the recipes train: the first two vertices pinned, the root edge clamped, or held by its style */
    { USUAL_STILL("published", "free"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_STILL("published", "free"), USUAL_CONTACT, { "inertia", { 0 } } },
    { USUAL_STILL("published", "clamped"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_STILL("published", "clamped"), USUAL_CONTACT, USUAL_MOVING, USUAL_STYLE },
    { USUAL_STILL("smooth", "free"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_STILL("smooth", "clamped"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_STILL("smooth", "clamped"), USUAL_CONTACT, USUAL_MOVING, USUAL_STYLE },
    /* quasi-static */
    { USUAL_STILL("published", "free"), USUAL_CONTACT },
    { USUAL_STILL("published", "clamped"), USUAL_CONTACT },
    { USUAL_STILL("published", "clamped"), USUAL_CONTACT, USUAL_STYLE },
    { USUAL_STILL("smooth", "free"), USUAL_CONTACT },
    { USUAL_STILL("smooth", "clamped"), USUAL_CONTACT },
    { USUAL_STILL("smooth", "clamped"), USUAL_CONTACT, USUAL_STYLE },
    /* as published, dynamic and quasi-static */
    { USUAL_STILL("published", "free"),
      { "body_collision", { "plane" } },
      { "inertia", { 0 } },
      { "hair_style", { 0 } } },
    { USUAL_STILL("published", "free"), { "body_collision", { "plane" } }, { "hair_style", { 0 } } },
    /* with the frame carried along the strand */
    { USUAL_CHAIN("published", "free"), { "inertia", { 0 } } },
    { USUAL_CHAIN("published", "free"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_CHAIN("published", "clamped"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_CHAIN("smooth", "free"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_CHAIN("smooth", "clamped"), USUAL_CONTACT, USUAL_MOVING },
    { USUAL_CHAIN("published", "clamped"), USUAL_CONTACT },
    { USUAL_CHAIN("smooth", "clamped"), USUAL_CONTACT },
};
enum { USUAL_SUMS = sizeof usual_sums / sizeof *usual_sums };

#endif
