/* Kernels are written once in a .inc file over REAL and F(name), and included for f32 and for f64 by NAME.kernel.h. */
#ifndef HG_AUTOGRAD_FLOATS_H
#define HG_AUTOGRAD_FLOATS_H

#include "tensor/kernel.h"
#include "tensor/math.h"

#define F(name_)       HG_PASTE(name_, SUFFIX)
#define F_BLOCK(name_) HG_PASTE(HG_PASTE(name_, SUFFIX), _block) /* what HG_KERNELS_BLOCK calls on a GPU */

/* Before a loop that has to become vectors. In f64 the C library's functions are called one by one, so there it is only
 * the compiler's choice: HG_SIMD is empty while the f64 kernels are included. */
#define HG_SIMD_f32 HG_SIMD_
#define HG_SIMD_f64
#define HG_SIMD HG_PASTE(HG_SIMD, SUFFIX)

#endif
