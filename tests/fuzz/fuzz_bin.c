/* CT2Hair's .bin, and what becomes of its strands. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

int fuzz_one(const uint8_t *data, size_t size)
{
    hg_curves *curves = NULL;
    hg_groom *groom = NULL;
    hg_groom_report report;
    if (hg_curves_read(&curves, fuzz_file(data, size, "bin")) == HG_OK &&
        hg_groom_from_curves(&groom, curves, 5, &report) == HG_OK)
        hg_groom_destroy(groom);
    hg_curves_destroy(curves);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    uint8_t bytes[1024];
    if (number == 0) return small_seed(bytes, small_data(7, bytes), to, room);
    return 0;
}
