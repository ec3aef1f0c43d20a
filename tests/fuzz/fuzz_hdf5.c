/* Strands in HDF5 as read_hdf5.c finds them: VTKHDF polylines. (Grooms of ours: fuzz_h5_groom.c, fuzz_h5_lies.c.) */
#include "export/export.h"
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_curves *curves = NULL;
    const char *path = fuzz_file(data, size, "vtkhdf");
    for (int64_t frame = 0; frame < 2; frame++) {
        if (hg_curves_read_frame(&curves, path, frame) != HG_OK && curves) abort();
        hg_curves_destroy(curves);
    }
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    const char *path = small_path("seed.vtkhdf");
    hg_vtkhdf *file = NULL;
    void *bytes = NULL;
    size_t size = 0;
    float points[15] = { 0 };
    for (int i = 0; i < 15; i++) points[i] = 0.01F * (float)i;
    if (number > 0) return 0;
    if (hg_vtkhdf_create_polylines(&file, path, 2, 2, (int64_t[]){ 0, 3, 5 }, 30) != HG_OK ||
        hg_vtkhdf_add(file, points) != HG_OK || hg_vtkhdf_add(file, points) != HG_OK ||
        hg_vtkhdf_commit(file) != HG_OK || hg_file_read(path, &bytes, &size) != HG_OK) {
        fprintf(stderr, "%s\n", hg_message());
        abort();
    }
    size = small_seed(bytes, size, to, room);
    hg_free(bytes);
    return size;
}
