/* hairgrad: autodiff for hair losses. Includes every floor; each header is the manual of its folder. */
#ifndef HAIRGRAD_H
#define HAIRGRAD_H
#include "autograd/autograd.h"
#include "autograd/trace/trace.h"
#include "base/base.h"
#include "export/export.h"
#include "geometry/geometry.h"
#include "hairloss/hairloss.h"
#include "models/models.h"
#include "scene/scene.h"
#include "solvers/solvers.h"
#include "tasks/tasks.h"
#include "tensor/tensor.h"
#include "train/train.h"
#endif
