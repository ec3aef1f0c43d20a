/* The gravity of every strand of a batch if it were a point at its root: counted from there, the loss says how the hair hangs and
 * not how high the person stands. A constant for the network, summed in f64. */
#include "tensor/block.h"
#include "tensor/kernel.h"

typedef struct {
    int64_t frames, strands;
    const float *position; /* [B,S,3] of the roots */
    const double *mass;    /* [G,S] of a strand [kg] */
    const int32_t *groom;  /* [B] */
    double g[3];
    int terms, term; /* the energies, and which of them is gravity */
    double scale;    /* from joule to the loss */
    double *joule;   /* [terms], what to take off each: zero but for gravity */
    float *loss;     /* [] what to add to the loss */
} root_gravity_args;

HG_BODY double root_gravity_of(const root_gravity_args *p, int64_t i, double energy)
{
    int64_t s, b = hg_divide(i, p->strands, &s);
    const double mass = p->mass[p->groom[b] * p->strands + s];
    for (int c = 0; c < 3; c++) energy -= mass * p->g[c] * (double)p->position[3 * i + c];
    return energy;
}

HG_BODY void root_gravity_put(const root_gravity_args *p, double energy)
{
    for (int t = 0; t < p->terms; t++) p->joule[t] = t == p->term ? energy : 0;
    *p->loss = (float)(-p->scale * energy);
}

/* One index: the whole batch. */
HG_BODY void root_gravity(const root_gravity_args *p, int64_t first, int64_t last)
{
    double energy = 0;
    if (first == last) return;
    for (int64_t i = 0; i < p->frames * p->strands; i++) energy = root_gravity_of(p, i, energy);
    root_gravity_put(p, energy);
}

#ifdef HG_CUDA
HG_BODY void root_gravity_block(const root_gravity_args *p, int64_t index)
{
    double energy = 0;
    (void)index;
    for (int64_t i = threadIdx.x; i < p->frames * p->strands; i += blockDim.x) energy = root_gravity_of(p, i, energy);
    energy = hg_block_sum(energy);
    if (threadIdx.x == 0) root_gravity_put(p, energy);
}
#endif
HG_KERNEL_BLOCK(root_gravity, root_gravity_args, 1, 256)
