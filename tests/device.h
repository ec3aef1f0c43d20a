/* The device that a test runs on: the cpu, or what HG_TEST_DEVICE names. A test program that calls test_device() is run a second
 * time on the emulated GPU (tests/meson.build), so it reads and writes tensors by hg_tensor_read, _write and _item alone. */
#ifndef TESTS_DEVICE_H
#define TESTS_DEVICE_H

#include <stdlib.h>

#include "tensor/tensor.h"

/* A real GPU (HG_TEST_GPU, which on_cuda.sh sets) is held on to: to make its context anew takes a quarter of a second. */
__attribute__((unused)) static const char *test_device(void)
{
    static hg_ctx *held;
    const char *name = getenv("HG_TEST_DEVICE");
    if (name && getenv("HG_TEST_GPU") && !held) hg_ctx_create(&held, &(hg_ctx_options){ .device = name });
    return name;
}

#endif
