/* The device that a test runs on: the cpu, or what HG_TEST_DEVICE names. A test program that calls test_device() is run a second
 * time on the emulated GPU (tests/meson.build), so it reads and writes tensors by hg_tensor_read, _write and _item alone. */
#ifndef TESTS_DEVICE_H
#define TESTS_DEVICE_H

#include <stdlib.h>

static inline const char *test_device(void) { return getenv("HG_TEST_DEVICE"); }

#endif
