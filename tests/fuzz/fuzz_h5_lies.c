/* Groom, body and motion files that are sound HDF5 but lie: datasets that are gone, of another shape, type or size (up
 * to sizes that no memory holds, which cost nothing in a file), strange values, strange attributes. */
#include "tests/fuzz/fuzz.h"
#include "tests/small_files.h"

#include <hdf5.h>
#include <math.h>

enum { most_names = 32 };
typedef struct {
    const char *path;
    void *bytes;
    size_t size;
    char names[most_names][64];
    int count;
} sound_file;
static sound_file files[3];

static herr_t take_name(hid_t group, const char *name, const H5L_info_t *info, void *to)
{
    (void)info;
    sound_file *file = to;
    hid_t dataset = H5Dopen2(group, name, H5P_DEFAULT);
    if (dataset >= 0) {
        if (file->count < most_names) snprintf(file->names[file->count++], sizeof file->names[0], "%s", name);
        H5Dclose(dataset);
    }
    return 0;
}

static void check(bool good)
{
    if (good) return;
    fprintf(stderr, "no sound file to begin with: %s\n", hg_message());
    abort();
}

static void make_sound_files(void)
{
    static const char *const names[] = { "groom.h5", "body.h5", "motion.h5" };
    hg_body *body = NULL;
    hg_groom *groom = NULL;
    hg_motion *motion = NULL;
    check(small_body(&body) == HG_OK && small_groom(&groom, body) == HG_OK &&
          hg_motion_make(&motion, body, "nod", 0.2, 30, 1) == HG_OK);
    for (int i = 0; i < 3; i++) {
        char *path = hg_strdup(small_path(names[i]));
        files[i].path = path;
        check((i == 0   ? hg_groom_save(groom, path)
               : i == 1 ? hg_body_save(body, path)
                        : hg_motion_save(motion, path)) == HG_OK);
        check(hg_file_read(path, &files[i].bytes, &files[i].size) == HG_OK);
        hid_t file = H5Fopen(path, H5F_ACC_RDONLY, H5P_DEFAULT);
        check(file >= 0 && H5Lvisit(file, H5_INDEX_NAME, H5_ITER_INC, take_name, &files[i]) >= 0 && files[i].count > 0);
        H5Fclose(file);
    }
    hg_groom_destroy(groom);
    hg_motion_destroy(motion);
    hg_body_destroy(body);
}

/* Another dataset under an old name; nothing is stored, so that readers see zeros. */
static void replace(hid_t file, const char *name, const uint8_t *what)
{
    static const hsize_t sizes[] = {
        0, 1, 2, 3, 4, 8, 12, 31, 1000, 1u << 20, 1u << 31, (hsize_t)1 << 33, (hsize_t)1 << 45
    };
    const hid_t types[] = { H5T_NATIVE_FLOAT, H5T_NATIVE_DOUBLE, H5T_NATIVE_INT,
                            H5T_NATIVE_UCHAR, H5T_NATIVE_INT64,  H5T_C_S1 };
    hsize_t shape[8];
    int rank = what[0] % 8;
    for (int i = 0; i < rank; i++) shape[i] = sizes[what[1 + i % 3] / (1 + i / 3) % (sizeof sizes / sizeof *sizes)];
    hid_t space = rank > 0 ? H5Screate_simple(rank, shape, NULL) : H5Screate(what[1] & 1 ? H5S_NULL : H5S_SCALAR);
    H5Ldelete(file, name, H5P_DEFAULT);
    hid_t dataset = H5Dcreate2(file, name, types[what[4] % 6], space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    if (dataset >= 0) H5Dclose(dataset);
    if (space >= 0) H5Sclose(space);
}

/* One strange number at a random place of a dataset. */
static void poke(hid_t file, const char *name, const uint8_t *what)
{
    static const double odd[] = { -1, 0, 1, 1e30, 2147483647, -2147483648.0, 13380, 7 };
    hid_t dataset = H5Dopen2(file, name, H5P_DEFAULT), space = dataset < 0 ? -1 : H5Dget_space(dataset);
    hssize_t count = space < 0 ? 0 : H5Sget_simple_extent_npoints(space);
    hid_t type = dataset < 0 ? -1 : H5Dget_type(dataset);
    bool number = type >= 0 && (H5Tget_class(type) == H5T_FLOAT || H5Tget_class(type) == H5T_INTEGER);
    if (number && count > 0 && count < 1 << 16) {
        double *values = malloc((size_t)count * sizeof *values);
        if (values && H5Dread(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) >= 0) {
            values[(what[0] * 256 + what[1]) % count] = what[2] % 10 == 8   ? (double)NAN
                                                        : what[2] % 10 == 9 ? (double)INFINITY
                                                                            : odd[what[2] % 8];
            H5Dwrite(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values);
        }
        free(values);
    }
    if (type >= 0) H5Tclose(type);
    if (space >= 0) H5Sclose(space);
    if (dataset >= 0) H5Dclose(dataset);
}

static void change_attribute(hid_t file, const uint8_t *what)
{
    int count = (int)H5Aget_num_attrs(file);
    char name[64];
    if (count <= 0 || H5Aget_name_by_idx(file, ".", H5_INDEX_NAME, H5_ITER_INC, (hsize_t)(what[0] % count), name,
                                         sizeof name, H5P_DEFAULT) < 0)
        return;
    H5Adelete(file, name);
    if (what[1] % 4 == 0) return;
    double number = what[2] % 3 == 0 ? -1 : what[2] % 3 == 1 ? 1e300 : (double)NAN;
    hid_t text = H5Tcopy(H5T_C_S1), space = H5Screate(H5S_SCALAR);
    H5Tset_size(text, what[1] % 4 == 1 ? 4 : 1);
    bool as_number = what[1] % 4 == 3;
    hid_t attribute = H5Acreate2(file, name, as_number ? H5T_NATIVE_DOUBLE : text, space, H5P_DEFAULT, H5P_DEFAULT);
    if (attribute >= 0) {
        H5Awrite(attribute, as_number ? H5T_NATIVE_DOUBLE : text, as_number ? (const void *)&number : "1 km");
        H5Aclose(attribute);
    }
    H5Sclose(space);
    H5Tclose(text);
}

/* The first byte chooses the file; then commands of eight bytes. */
int fuzz_one(const uint8_t *data, size_t size)
{
    if (!files[0].path) {
        H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
        make_sound_files();
    }
    if (size < 1) return 0;
    int kind = data[0] % 3;
    sound_file *sound = &files[kind];
    const char *path = fuzz_file(sound->bytes, sound->size, "h5");
    hid_t file = H5Fopen(path, H5F_ACC_RDWR, H5P_DEFAULT);
    for (size_t at = 1; file >= 0 && at + 8 <= size && at < 65; at += 8) {
        const uint8_t *command = data + at;
        const char *name = sound->names[command[1] % sound->count];
        if (command[0] % 4 == 0 && H5Lexists(file, name, H5P_DEFAULT) > 0) H5Ldelete(file, name, H5P_DEFAULT);
        if (command[0] % 4 == 1 && H5Lexists(file, name, H5P_DEFAULT) > 0) replace(file, name, command + 2);
        if (command[0] % 4 == 2) poke(file, name, command + 2);
        if (command[0] % 4 == 3) change_attribute(file, command + 2);
    }
    if (file >= 0) H5Fclose(file);
    hg_groom *groom = NULL;
    hg_body *body = NULL;
    hg_motion *motion = NULL;
    if (kind == 0 && hg_groom_load(&groom, path) == HG_OK) hg_groom_destroy(groom);
    if (kind == 1 && hg_body_load(&body, path) == HG_OK) hg_body_destroy(body);
    if (kind == 2 && hg_motion_load(&motion, path, NULL) == HG_OK) hg_motion_destroy(motion);
    return 0;
}

size_t fuzz_seed(int number, uint8_t *to, size_t room)
{
    if (number >= 24 || room < 17) return 0;
    memset(to, 0, 17);
    to[0] = (uint8_t)number;
    for (int i = 0; i < 16; i++) to[1 + i] = (uint8_t)(number * 31 + i * (number + 5));
    return 17;
}
