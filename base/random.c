/* Counter-based random numbers: Philox 4x32-10 (Salmon et al. 2011), as Random123 has it. */
#include "base/base.h"

#include <Random123/philox.h>
#include <math.h>

__extension__ typedef unsigned __int128 wide;

void hg_random_bits(uint64_t seed, uint64_t stream, uint64_t counter, uint32_t out[4])
{
    philox4x32_key_t key = { { (uint32_t)seed, (uint32_t)(seed >> 32) } };
    philox4x32_ctr_t where = { { (uint32_t)counter, (uint32_t)(counter >> 32), (uint32_t)stream,
                                 (uint32_t)(stream >> 32) } };
    philox4x32_ctr_t bits = philox4x32_R(10, where, key);
    for (int i = 0; i < 4; i++) out[i] = bits.v[i];
}

static double unit(uint32_t high, uint32_t low) { return (double)(((uint64_t)high << 32 | low) >> 11) * 0x1p-53; }

double hg_random_uniform(uint64_t seed, uint64_t stream, uint64_t counter)
{
    uint32_t bits[4];
    hg_random_bits(seed, stream, counter, bits);
    return unit(bits[0], bits[1]);
}

/* Box and Muller; 1 - u is in (0, 1], so that the logarithm is finite. */
double hg_random_normal(uint64_t seed, uint64_t stream, uint64_t counter)
{
    uint32_t bits[4];
    hg_random_bits(seed, stream, counter, bits);
    double radius = sqrt(-2.0 * log(1.0 - unit(bits[0], bits[1])));
    return radius * cos(6.283185307179586 * unit(bits[2], bits[3]));
}

uint64_t hg_random_below(uint64_t seed, uint64_t stream, uint64_t counter, uint64_t n)
{
    uint32_t bits[4];
    hg_random_bits(seed, stream, counter, bits);
    return (uint64_t)((wide)((uint64_t)bits[0] << 32 | bits[1]) * n >> 64);
}
