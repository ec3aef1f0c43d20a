/* Small valid files of every format that is read, for the tests of the readers and as seeds of their fuzzing. */
#ifndef HG_TESTS_SMALL_FILES_H
#define HG_TESTS_SMALL_FILES_H

#include "scene/scene.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static inline void small_remove(const char *path)
{
    DIR *folder = opendir(path);
    if (!folder) {
        unlink(path);
        return;
    }
    for (struct dirent *entry; (entry = readdir(folder));) {
        if (!strcmp(entry->d_name, ".") || !strcmp(entry->d_name, "..")) continue;
        char *inside = hg_path_join(path, entry->d_name);
        if (inside) small_remove(inside);
        hg_free(inside);
    }
    closedir(folder);
    rmdir(path);
}

static void small_folder_remove(void);

/* A folder of its own for the process that is gone when it ends. */
static inline const char *small_folder(void)
{
    static char folder[256];
    if (folder[0]) return folder;
    const char *where = getenv("TMPDIR");
    snprintf(folder, sizeof folder, "%s/hairgrad-XXXXXX", where && *where ? where : P_tmpdir);
    if (!mkdtemp(folder)) {
        perror(folder);
        exit(1);
    }
    atexit(small_folder_remove);
    return folder;
}

static void small_folder_remove(void) { small_remove(small_folder()); }

/* The path of a file in that folder; a few are alive at a time. */
static inline const char *small_path(const char *name)
{
    static char paths[8][512];
    static int next;
    char *path = paths[next++ % 8];
    snprintf(path, sizeof paths[0], "%s/%s", small_folder(), name);
    return path;
}

static inline const char *small_write(const char *name, const void *bytes, size_t size)
{
    const char *path = small_path(name);
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(bytes, 1, size, file) != size || fclose(file)) {
        perror(path);
        exit(1);
    }
    return path;
}

static inline const char *small_write_text(const char *name, const char *text)
{
    return small_write(name, text, strlen(text));
}

/* A fuzz_seed of one of these texts or byte ranges. */
static inline size_t small_seed(const void *bytes, size_t size, uint8_t *to, size_t room)
{
    if (size > room) return 0;
    memcpy(to, bytes, size);
    return size;
}

/* ---- TressFX: 3 strands of 4 points, 1 cm apart ------------------------------------------------------------------ */

static inline size_t small_tfx(int version, uint8_t bytes[1024])
{
    float number = (float)version;
    uint32_t strands = 3, points = 4, offset = version == 4 ? 160 : 296;
    size_t width = version == 4 ? 16 : 12, size = offset;
    memset(bytes, 0, 1024);
    memcpy(bytes, &number, 4);
    memcpy(bytes + 4, &strands, 4);
    memcpy(bytes + 8, &points, 4);
    memcpy(bytes + (version == 4 ? 12 : 144), &offset, 4);
    for (uint32_t s = 0; s < strands; s++)
        for (uint32_t p = 0; p < points; p++, size += width) {
            float x[4] = { (float)s, 0.01F * (float)p, 0.5F, p ? 1.0F : 0.0F };
            memcpy(bytes + size, x, width);
        }
    return size;
}

static const char small_tfx2[] = "version 2.0\nscale 1\nrotation 0 0 0\nnumStrands 2\nis sorted 1\n"
                                 "strand 0 numVerts 3 texcoord 0.1 0.2\n0.0, 0.0, 0.0\n0.0, 1.0, 0.0\n0.0, 2.0, 0.5\n"
                                 "strand 1 numVerts 2 texcoord 0.3 0.4\n1.0, 0.0, 0.0\n1.0, 1.0, 0.25\n";

/* ---- other strands: a bald one, one of 3 points and one of 2, a step up for every point --------------------------- */

static inline void small_point(uint32_t strand, uint32_t point, float x[3])
{
    x[0] = (float)strand, x[1] = 0.25F * (float)point, x[2] = -0.5F;
}

static const uint32_t small_counts[3] = { 1, 3, 2 };

/* Yuksel's .hair; ragged: with segments and every other array, else 2 strands of 3 points and no array but the points. */
static inline size_t small_hair(bool ragged, uint8_t bytes[1024])
{
    uint32_t head[5] = { 0x52494148, ragged ? 3 : 2, 6, ragged ? 31 : 2, ragged ? 0 : 2 };
    size_t size = 128;
    memset(bytes, 0, 1024);
    memcpy(bytes, head, sizeof head);
    for (int s = 0; ragged && s < 3; s++, size += 2) {
        uint16_t segments = (uint16_t)(small_counts[s] - 1);
        memcpy(bytes + size, &segments, 2);
    }
    for (uint32_t s = 0; s < head[1]; s++)
        for (uint32_t p = 0; p < (ragged ? small_counts[s] : 3); p++, size += 12) {
            float x[3];
            small_point(s, p, x);
            memcpy(bytes + size, x, 12);
        }
    return size + (ragged ? 6 * 20 : 0);
}

/* .data (width 3) and .bin (width 7) */
static inline size_t small_data(size_t width, uint8_t bytes[1024])
{
    uint32_t strands = 3;
    size_t size = 4;
    memset(bytes, 0, 1024);
    memcpy(bytes, &strands, 4);
    for (uint32_t s = 0; s < strands; s++) {
        memcpy(bytes + size, &small_counts[s], 4);
        size += 4;
        for (uint32_t p = 0; p < small_counts[s]; p++, size += 4 * width) {
            float x[3];
            small_point(s, p, x);
            memcpy(bytes + size, x, 12);
        }
    }
    return size;
}

enum { SMALL_PLYS = 6 };
#define SMALL_PLY_POINTS "0 0 -0.5\n1 0 -0.5\n1 0.25 -0.5\n1 0.5 -0.5\n2 0 -0.5\n2 0.25 -0.5\n"
#define SMALL_PLY_HEAD                                                                                                 \
    "ply\nformat ascii 1.0\ncomment six points\nelement vertex 6\nproperty float x\nproperty float y\nproperty float " \
    "z\n"
static const char *const small_ply[SMALL_PLYS] = {
    SMALL_PLY_HEAD "element edge 3\nproperty int vertex1\nproperty int vertex2\nend_header\n" SMALL_PLY_POINTS
                   "4 5\n1 2\n2 3\n",
    SMALL_PLY_HEAD
    "element edge 3\nproperty int vertex1\nproperty int vertex2\nproperty uchar red\nend_header\n" SMALL_PLY_POINTS
    "4 5 0\n2 1 0\n2 3 0\n",
    SMALL_PLY_HEAD "element strand 3\nproperty ushort nsegs\nend_header\n" SMALL_PLY_POINTS "0\n2\n1\n",
    SMALL_PLY_HEAD "element polyline 3\nproperty list uchar int vertex_indices\nend_header\n" SMALL_PLY_POINTS
                   "1 0\n3 1 2 3\n2 4 5\n",
    "ply\r\nformat ascii 1.0\r\nelement camera 2\r\nproperty list uchar float view\r\nelement vertex 6\r\nproperty int "
    "strand_index\r\n"
    "property double x\r\nproperty double y\r\nproperty double z\r\nend_header\r\n2 1 1\r\n0\r\n"
    "7 1 0 -0.5\r\n3 0 0 -0.5\r\n9 2 0 -0.5\r\n7 1 0.25 -0.5\r\n9 2 0.25 -0.5\r\n7 1 0.5 -0.5\r\n",
    SMALL_PLY_HEAD
    "element line 3\nproperty uchar kind\nproperty list int uint vertex_index\nend_header\n" SMALL_PLY_POINTS
    "0 1 0\n0 3 1 2 3\n0 2 4 5\n",
};

/* The same with edges, in binary. */
static inline size_t small_ply_binary(bool big_endian, uint8_t bytes[1024])
{
    static const uint32_t edges[6] = { 4, 5, 1, 2, 2, 3 };
    size_t size =
        (size_t)snprintf((char *)bytes, 1024,
                         "ply\nformat binary_%s_endian 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
                         "property float z\nproperty short label\nelement edge 3\nproperty int vertex1\n"
                         "property int vertex2\nend_header\n",
                         big_endian ? "big" : "little");
    for (int word = 0; word < 18 + 6 + 6; word++) {
        static const uint32_t strand[6] = { 0, 1, 1, 1, 2, 2 }, point[6] = { 0, 0, 1, 2, 0, 1 };
        uint32_t bits = 0;
        float x[3];
        size_t width = 4;
        if (word < 24) {
            small_point(strand[word / 4], point[word / 4], x);
            if (word % 4 < 3)
                memcpy(&bits, &x[word % 4], 4);
            else
                bits = 0xfffe, width = 2;
        } else {
            bits = edges[word - 24];
        }
        for (size_t i = 0; i < width; i++) bytes[size++] = (uint8_t)(bits >> 8 * (big_endian ? width - 1 - i : i));
    }
    return size;
}

/* ---- a body of MakeHuman's kind: a box where the head is, joint cubes, 4 bones ----------------------------------- */

static const char small_obj[] =
    "# a box with helpers\n"
    "v -0.7 7.0 -0.3\nv 0.7 7.0 -0.3\nv 0.7 8.4 -0.3\nv -0.7 8.4 -0.3\n"
    "v -0.7 7.0 1.1\nv 0.7 7.0 1.1\nv 0.7 8.4 1.1\nv -0.7 8.4 1.1\n"
    "v -0.1 0.4 0\nv 0.1 0.4 0\nv 0.1 0.6 0\nv -0.1 0.6 0\n"
    "v -0.1 6.8 0.4\nv 0.1 6.8 0.4\nv 0.1 7.0 0.4\nv -0.1 7.0 0.4\n"
    "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    "g body\ns off\n"
    "f 4/4 3/3 2/2 1/1\nf 5/1 6/2 7/3 8/4\nf 1/1 2/2 6/3 5/4\nf 2/1 3/2 7/3 6/4\nf 3/1 4/2 8/3 7/4\nf 4/1 1/2 5/3 8/4\n"
    "g joint-root\nf 9/1 10/2 11/3 12/4\ng joint-head\nf 13/1 14/2 15/3 16/4\n";

static const char small_rig[] =
    "{\"Head\": {\"head\": {\"cube_name\": \"joint-head\", \"strategy\": \"CUBE\"}, \"parent\": \"Neck\"},\n"
    " \"Hips\": {\"head\": {\"cube_name\": \"joint-root\", \"strategy\": \"CUBE\"}, \"parent\": \"\"},\n"
    " \"Neck\": {\"head\": {\"vertex_indices\": [0, 1, 12], \"strategy\": \"MEAN\"}, \"parent\": \"Spine1\"},\n"
    " \"Spine1\": {\"head\": {\"vertex_indices\": [8, 9], \"strategy\": \"MEAN\"}, \"parent\": \"Hips\"}}\n";

static const char small_weights[] =
    "{\"name\": \"w\", \"weights\": {\n"
    " \"Head\": [[0, 0.75], [1, 0.75], [2, 1.0], [3, 1.0], [4, 1.0], [5, 1.0], [6, 1.0], [7, 1.0], [12, 1.0]],\n"
    " \"Neck\": [[0, 0.75], [1, 0.25]], \"Hips\": [], \"Spine1\": []}}\n";

static const char small_target[] = "# offsets\n0 0.06 0 0\n3 0 -.12 0.3\n12 0 0.6 0\n";

/* The folder of such a body; every shape target holds small_target. */
static inline const char *small_makehuman(void)
{
    static const char *const folders[] = { "makehuman",
                                           "makehuman/targets",
                                           "makehuman/targets/macrodetails",
                                           "makehuman/targets/head",
                                           "makehuman/targets/neck",
                                           "mpfb2" };
    static const char *const races[] = { "african", "asian", "caucasian" }, *const sexes[] = { "female", "male" };
    static const char *const builds[] = { "minmuscle-maxweight", "minmuscle-minweight", "maxmuscle-maxweight" };
    static const char *const heads[] = { "head/head-scale-horiz", "head/head-scale-vert", "head/head-scale-depth",
                                         "neck/neck-scale-vert" };
    char name[256];
    for (int i = 0; i < 6; i++) hg_folder_create(small_path(folders[i]));
    small_write_text("makehuman/base.obj", small_obj);
    small_write_text("mpfb2/rig.cmu_mb.json", small_rig);
    small_write_text("mpfb2/weights.cmu_mb.json", small_weights);
    for (int sex = 0; sex < 2; sex++) {
        for (int race = 0; race < 3; race++)
            for (int old = 0; old < 2; old++) {
                snprintf(name, sizeof name, "makehuman/targets/macrodetails/%s-%s-%s.target", races[race], sexes[sex],
                         old ? "old" : "young");
                small_write_text(name, small_target);
            }
        for (int build = 0; build < 3; build++) {
            snprintf(name, sizeof name, "makehuman/targets/macrodetails/universal-%s-young-%s.target", sexes[sex],
                     builds[build]);
            small_write_text(name, small_target);
        }
        for (int head = 0; head < 4; head++) {
            snprintf(name, sizeof name, "makehuman/targets/%s-%s.target", heads[head], sex ? "incr" : "decr");
            small_write_text(name, sex ? small_target : "# nothing\n");
        }
    }
    return small_folder();
}

/* The small body, and two strands on its first scalp face. */
static inline hg_status small_body(hg_body **body)
{
    return hg_body_read_makehuman(NULL, body, small_makehuman(), "cmu_mb");
}

static inline hg_status small_groom(hg_groom **groom, const hg_body *body)
{
    HG_TRY(hg_groom_create(groom, 2, 3));
    for (int i = 0; i < 6; i++) {
        const float *root = body->points + 3 * body->triangles[3 * body->scalp[0]];
        for (int k = 0; k < 3; k++) (*groom)->points[3 * i + k] = root[k] + (k == 1 ? 0.01F * (float)(i % 3) : 0.0F);
    }
    for (int s = 0; s < 2; s++) {
        (*groom)->root_face[s] = body->scalp[0];
        (*groom)->root_bary[3 * s] = 1;
    }
    return HG_OK;
}

/* ---- clips ------------------------------------------------------------------------------------------------------ */

static const char small_asf[] =
    "# a skeleton\n:version 1.10\n:name VICON\n:units\n  mass 1.0\n  length 0.45\n  angle deg\n"
    ":documentation\n   words\n"
    ":root\n   order TX TY TZ RX RY RZ\n   axis XYZ\n   position 0 0 0\n   orientation 0 0 0\n"
    ":bonedata\n"
    "  begin\n     id 1\n     name lowerneck\n     direction 0 1 0\n     length 9\n     axis 0 0 0  XYZ\n"
    "    dof rx ry rz\n    limits (-180.0 180.0)\n           (-180.0 180.0)\n           (-180.0 180.0)\n  end\n"
    "  begin\n     id 2\n     name head\n     direction 0 0.6 0.8\n     length 4.5\n     axis 0 0 20   XYZ\n    dof rx "
    "rz\n  end\n"
    ":hierarchy\n  begin\n    root lowerneck\n    lowerneck head\n  end\n";

static const char small_amc[] = "#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n"
                                "1\nroot 1 9 2 0 0 0\nlowerneck 0 0 0\nhead 0 0\n"
                                "2\nroot 1 9 2 0 90 0\nlowerneck 90 0 0\nhead 30 10\n"
                                "3\nroot 2 9 2 10 20 30\nlowerneck 10 20 30\nhead -5.5e0 1e1\n";

static const char small_bvh[] =
    "HIERARCHY\nROOT Hips\n{\n\tOFFSET 0 0 0\n\tCHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation "
    "Xrotation\n"
    "\tJOINT LeftUpLeg\n\t{\n\t\tOFFSET 1 -8 0\n\t\tCHANNELS 3 Zrotation Yrotation Xrotation\n"
    "\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 -8 0\n\t\t}\n\t}\n"
    "\tJOINT Neck\n\t{\n\t\tOFFSET 0 9 0\n\t\tCHANNELS 3 Zrotation Yrotation Xrotation\n"
    "\t\tJOINT Head\n\t\t{\n\t\t\tOFFSET 0 2 1\n\t\t\tCHANNELS 3 Zrotation Yrotation Xrotation\n"
    "\t\t\tEnd Site\n\t\t\t{\n\t\t\t\tOFFSET 0 2 0\n\t\t\t}\n\t\t}\n\t}\n}\n"
    "MOTION\nFrames: 3\nFrame Time: .0083333\n"
    "0 8 0  0 0 0  0 0 0  0 0 0  0 0 0\n"
    "1 8 2  0 90 0  0 0 90  0 0 45  10 20 30\n"
    "1 8 3  10 90 0  0 0 90  0 0 45  -10 -20 -30\n";

#endif
