/* Wavefront .obj. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_mesh *mesh = NULL;
    if (hg_mesh_read_obj(&mesh, fuzz_file(data, size, "obj")) == HG_OK) hg_mesh_destroy(mesh);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number == 0) return small_seed(small_obj, sizeof small_obj - 1, to, room);
    return 0;
}
