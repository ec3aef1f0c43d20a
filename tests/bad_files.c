/* HDF5 files that are wrong in one way each, for test_bad_input.sh: bad_files FOLDER. The sound ones come from the program. */
#include "scene/scene.h"

#include <hdf5.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define DO(call)                                                                                                       \
    do {                                                                                                               \
        if ((call) != HG_OK) {                                                                                         \
            fprintf(stderr, "bad_files: %s\n", hg_message());                                                          \
            exit(1);                                                                                                   \
        }                                                                                                              \
    } while (0)

static const char *in(const char *folder, const char *name)
{
    static char path[1024];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

/* A groom as it should be, but for one thing. */
static void groom(const char *folder, const char *name, int64_t strands, int64_t faces, float first, const char *format,
                  int64_t version)
{
    float points[4 * 3 * 3], bary[4 * 3], uv[4 * 2];
    int32_t face[4] = { 0, 0, 0, 0 };
    for (int i = 0; i < 36; i++) points[i] = (float)i * 0.01f;
    for (int i = 0; i < 12; i++) bary[i] = 1.0f / 3.0f;
    for (int i = 0; i < 8; i++) uv[i] = 0.5f;
    points[0] = first;
    hg_h5 *file;
    DO(hg_h5_create(&file, in(folder, name)));
    DO(hg_h5_set_text(file, "", "format", format));
    DO(hg_h5_set_integers(file, "", "version", 1, &version));
    DO(hg_h5_set_text(file, "", "unit", "m"));
    DO(hg_h5_set_text(file, "", "up_axis", "+Y"));
    DO(hg_h5_set_text(file, "", "name", "bad"));
    DO(hg_h5_set_text(file, "", "body_hash", "0"));
    DO(hg_h5_write(file, "strands", HG_F32, 3, (int64_t[]){ strands, 3, 3 }, points));
    DO(hg_h5_write(file, "root_face", HG_I32, 1, (int64_t[]){ faces }, face));
    DO(hg_h5_write(file, "root_barycentric", HG_F32, 2, (int64_t[]){ faces, 3 }, bary));
    DO(hg_h5_write(file, "root_uv", HG_F32, 2, (int64_t[]){ faces, 2 }, uv));
    DO(hg_h5_commit(file));
}

int main(int count, char **words)
{
    if (count < 2) return 2;
    const char *folder = words[1];
    groom(folder, "nan_groom.h5", 4, 4, (float)NAN, "hairgrad groom", 1);
    groom(folder, "lying_groom.h5", 4, 3, 0.0f, "hairgrad groom", 1);
    groom(folder, "no_strands.h5", 0, 0, 0.0f, "hairgrad groom", 1);
    groom(folder, "other_kind.h5", 4, 4, 0.0f, "hairgrad motion", 1);
    groom(folder, "new_version.h5", 4, 4, 0.0f, "hairgrad groom", 2);

    hg_body *body;
    DO(hg_bust_create(&body));
    hg_motion *motion;
    DO(hg_motion_make(&motion, body, "nod", 0.5, 30.0, 1));
    DO(hg_motion_save(motion, in(folder, "motion.h5")));
    hg_free(motion->joint_name[motion->joints - 1]);
    motion->joint_name[motion->joints - 1] = hg_strdup("Tail");
    DO(hg_motion_save(motion, in(folder, "other_joints.h5")));
    hg_motion_destroy(motion);
    DO(hg_body_save(body, in(folder, "no_scalp.h5")));
    hg_body_destroy(body);
    hid_t file = H5Fopen(in(folder, "no_scalp.h5"), H5F_ACC_RDWR, H5P_DEFAULT),
          space = H5Screate_simple(1, &(hsize_t){ 0 }, NULL);
    H5Ldelete(file, "scalp", H5P_DEFAULT);
    hid_t scalp = H5Dcreate2(file, "scalp", H5T_STD_I32LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    if (scalp < 0 || H5Dclose(scalp) < 0 || H5Sclose(space) < 0 || H5Fclose(file) < 0) return 1;
    return 0;
}
