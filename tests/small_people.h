/* Small people: an SMPL-like body and an AMASS-like clip as .npz, a skinned box with an animation as glTF. */
#ifndef HG_TESTS_SMALL_PEOPLE_H
#define HG_TESTS_SMALL_PEOPLE_H

#include "geometry/vector.h"
#include "scene/joints.h"
#include "scene/npz.h"
#include "tests/small_files.h"

#include <math.h>

/* The corners of a head, and its faces. */
static const float small_head[8][3] = { { -0.07F, 0.70F, -0.03F }, { 0.07F, 0.70F, -0.03F }, { 0.07F, 0.84F, -0.03F },
                                        { -0.07F, 0.84F, -0.03F }, { -0.07F, 0.70F, 0.11F }, { 0.07F, 0.70F, 0.11F },
                                        { 0.07F, 0.84F, 0.11F },   { -0.07F, 0.84F, 0.11F } };
static const int32_t small_faces[12][3] = { { 3, 2, 1 }, { 3, 1, 0 }, { 4, 5, 6 }, { 4, 6, 7 },
                                            { 0, 1, 5 }, { 0, 5, 4 }, { 1, 2, 6 }, { 1, 6, 5 },
                                            { 2, 3, 7 }, { 2, 7, 6 }, { 3, 0, 4 }, { 3, 4, 7 } };

/* Places of 24 joints of a standing person; fingers and the like are not there. */
static inline void small_places(float place[24][3])
{
    static const float left[24][3] = { { 0, -0.2F, 0 },
                                       { 0.07F, -0.3F, 0 },
                                       { 0, 0, 0 },
                                       { 0, -0.1F, 0 },
                                       { 0.08F, -0.7F, 0 },
                                       { 0, 0, 0 },
                                       { 0, 0.1F, 0 },
                                       { 0.08F, -1.1F, 0 },
                                       { 0, 0, 0 },
                                       { 0, 0.3F, 0 },
                                       { 0.1F, -1.15F, 0.1F },
                                       { 0, 0, 0 },
                                       { 0, 0.6F, 0 },
                                       { 0.06F, 0.5F, 0 },
                                       { 0, 0, 0 },
                                       { 0, 0.72F, 0.02F },
                                       { 0.18F, 0.52F, 0 },
                                       { 0, 0, 0 },
                                       { 0.44F, 0.52F, 0 },
                                       { 0, 0, 0 },
                                       { 0.7F, 0.52F, 0 },
                                       { 0, 0, 0 },
                                       { 0.78F, 0.52F, 0 },
                                       { 0, 0, 0 } };
    const char *const *name = joints_smpl(24);
    for (int j = 0; j < 24; j++) {
        int from = strncmp(name[j], "right", 5) == 0 ? j - 1 : j; /* the right one comes after the left one */
        for (int k = 0; k < 3; k++) place[j][k] = k == 0 && from != j ? -left[from][k] : left[from][k];
    }
}

/* One more array, or one instead of another of the same name, in what is written. */
static inline const char *small_smpl(const char *name, const npz_item *other)
{
    static float place[24][3], weights[8][24], shapes[8][3][2];
    static int32_t tree[2][24];
    small_places(place);
    memset(weights, 0, sizeof weights);
    for (int j = 0; j < 24; j++) tree[0][j] = joints_smpl_parents(24)[j], tree[1][j] = j;
    for (int v = 0; v < 8; v++) {
        weights[v][15] = v < 2 ? 0.75F : 1;
        if (v < 2) weights[v][12] = 0.25F;
        shapes[v][0][0] = small_head[v][0]; /* wider */
        shapes[v][1][1] = v >= 2 ? 0.02F : 0;
    }
    npz_item items[8] = { { "v_template", HG_F32, 2, { 8, 3 }, small_head },
                          { "f", HG_I32, 2, { 12, 3 }, small_faces },
                          { "weights", HG_F32, 2, { 8, 24 }, weights },
                          { "kintree_table", HG_I32, 2, { 2, 24 }, tree },
                          { "J", HG_F32, 2, { 24, 3 }, place },
                          { "shapedirs", HG_F32, 3, { 8, 3, 2 }, shapes } };
    int n = 6;
    for (int i = 0; other && i < 6; i++)
        if (strcmp(items[i].name, other->name) == 0) {
            items[i] = *other;
            other = NULL;
        }
    if (other) items[n++] = *other;
    const char *path = small_path(name);
    if (npz_write(path, n, items) != HG_OK) exit(1);
    return path;
}

/* Five frames in a Z-up world: the person stands (90 degrees about X), turns the head, lifts an arm and walks. */
static inline const char *small_amass(const char *name, const npz_item *other)
{
    static float poses[5][72], way[5][3];
    static const double rate = 60, betas[16] = { 0.5, -1 };
    memset(poses, 0, sizeof poses);
    for (int t = 0; t < 5; t++) {
        poses[t][0] = 1.5707963F;
        poses[t][3 * 15 + 1] = 0.2F * (float)t;
        poses[t][3 * 12] = 0.1F * (float)t;
        poses[t][3 * 16 + 2] = -0.3F * (float)t;
        way[t][0] = 0.01F * (float)t, way[t][1] = -0.1F * (float)t, way[t][2] = 1.1F;
    }
    npz_item items[5] = { { "poses", HG_F32, 2, { 5, 72 }, poses },
                          { "trans", HG_F32, 2, { 5, 3 }, way },
                          { "mocap_framerate", HG_F64, 0, { 0 }, &rate },
                          { "betas", HG_F64, 1, { 16 }, betas } };
    int n = 4;
    for (int i = 0; other && i < 4; i++)
        if (strcmp(items[i].name, other->name) == 0) {
            items[i] = *other;
            other = NULL;
        }
    if (other) items[n++] = *other;
    const char *path = small_path(name);
    if (npz_write(path, n, items) != HG_OK) exit(1);
    return path;
}

/* ---- glTF -------------------------------------------------------------------------------------------------------- */

/* Twice as large as the head above, under a node that halves it. Hips and neck rest turned by 90 degrees about Z, the
 * head does not. Vertex 8 is vertex 7 at a seam. Bytes of: 0 positions, 108 joints, 144 weights, 216 texture coordinates,
 * 288 indices, 360 matrices, 552 times, 564 turns of the head, 612 ways of the hips, 648 splines of the neck, 792 a morph
 * target, 900 one sparse index, 904 its value. */
enum { SMALL_GLTF_BYTES = 916 };

static inline void small_gltf_bytes(uint8_t bytes[SMALL_GLTF_BYTES])
{
    memset(bytes, 0, SMALL_GLTF_BYTES);
    float *f;
    float points[9][3], uv[9][2], matrices[3][16] = { 0 }, turns[3][4], ways[3][3], splines[9][4] = { 0 },
                                  morph[9][3] = { 0 };
    uint16_t weights[9][4] = { 0 }, index[36];
    for (int v = 0; v < 9; v++) {
        int from = v < 8 ? v : 7;
        for (int k = 0; k < 3; k++) points[v][k] = 2 * small_head[from][k];
        uv[v][0] = (float)v / 8, uv[v][1] = 0.25F;
        bytes[108 + 4 * v] = 2, bytes[108 + 4 * v + 1] = 1; /* head, neck */
        weights[v][0] = from < 2 ? 49151 : 65535, weights[v][1] = from < 2 ? 16384 : 0;
        morph[v][1] = from == 2 ? 0.1F : 0;
    }
    for (int i = 0; i < 36; i++)
        index[i] = (uint16_t)(i >= 33 && small_faces[11][i - 33] == 7 ? 8 : small_faces[i / 3][i % 3]);
    const float height[3] = { 1, 1.35F, 1.45F };
    for (int j = 0; j < 3; j++) { /* inverse of (turn | 0, height, 0), by columns */
        float turned[16] = { 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, -height[j], 0, 0, 1 };
        float straight[16] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -height[j], 0, 1 };
        memcpy(matrices[j], j < 2 ? turned : straight, sizeof turned);
    }
    const float half = 0.70710678F;
    for (int t = 0; t < 3; t++) {
        /* head: -90 degrees about Z, then t 40 degrees about X: as a product */
        double a = t * 20 * 3.14159265358979323846 / 180;
        float s = (float)sin(a), c = (float)cos(a);
        turns[t][0] = half * s, turns[t][1] = -half * s, turns[t][2] = -half * c, turns[t][3] = half * c;
        ways[t][0] = 0, ways[t][1] = 1, ways[t][2] = 0.2F * (float)t;
        double b = (t == 1 ? 30 : 0) * 3.14159265358979323846 / 180; /* neck: 60 degrees about its X */
        splines[3 * t + 1][0] = (float)sin(b), splines[3 * t + 1][3] = (float)cos(b);
    }
    const float times[3] = { 0, 0.5F, 1 }, sparse[3] = { 0, 0, 0.3F };
    memcpy(bytes, points, 108);
    memcpy(bytes + 144, weights, 72);
    memcpy(bytes + 216, uv, 72);
    memcpy(bytes + 288, index, 72);
    memcpy(bytes + 360, matrices, 192);
    memcpy(bytes + 552, times, 12);
    memcpy(bytes + 564, turns, 48);
    memcpy(bytes + 612, ways, 36);
    memcpy(bytes + 648, splines, 144);
    memcpy(bytes + 792, morph, 108);
    bytes[900] = 3;
    f = (float *)(void *)(bytes + 904);
    memcpy(f, sparse, 12);
}

static const char small_gltf_json[] =
    "{\"asset\": {\"version\": \"2.0\"},\n"
    "\"buffers\": [{\"byteLength\": 916%s}],\n"
    "\"bufferViews\": [{\"buffer\": 0, \"byteLength\": 108}, {\"buffer\": 0, \"byteOffset\": 108, \"byteLength\": "
    "36},\n"
    " {\"buffer\": 0, \"byteOffset\": 144, \"byteLength\": 72}, {\"buffer\": 0, \"byteOffset\": 216, \"byteLength\": "
    "72, "
    "\"byteStride\": 8},\n"
    " {\"buffer\": 0, \"byteOffset\": 288, \"byteLength\": 72}, {\"buffer\": 0, \"byteOffset\": 360, \"byteLength\": "
    "192},\n"
    " {\"buffer\": 0, \"byteOffset\": 552, \"byteLength\": 240}, {\"buffer\": 0, \"byteOffset\": 792, \"byteLength\": "
    "124}],\n"
    "\"accessors\": [{\"bufferView\": 0, \"componentType\": 5126, \"count\": 9, \"type\": \"VEC3\"},\n"
    " {\"bufferView\": 1, \"componentType\": 5121, \"count\": 9, \"type\": \"VEC4\"},\n"
    " {\"bufferView\": 2, \"componentType\": 5123, \"count\": 9, \"type\": \"VEC4\", \"normalized\": true},\n"
    " {\"bufferView\": 3, \"componentType\": 5126, \"count\": 9, \"type\": \"VEC2\"},\n"
    " {\"bufferView\": 4, \"componentType\": 5123, \"count\": 36, \"type\": \"SCALAR\"},\n"
    " {\"bufferView\": 5, \"componentType\": 5126, \"count\": 3, \"type\": \"MAT4\"},\n"
    " {\"bufferView\": 6, \"componentType\": 5126, \"count\": 3, \"type\": \"SCALAR\"},\n"
    " {\"bufferView\": 6, \"byteOffset\": 12, \"componentType\": 5126, \"count\": 3, \"type\": \"VEC4\"},\n"
    " {\"bufferView\": 6, \"byteOffset\": 60, \"componentType\": 5126, \"count\": 3, \"type\": \"VEC3\"},\n"
    " {\"bufferView\": 6, \"byteOffset\": 96, \"componentType\": 5126, \"count\": 9, \"type\": \"VEC4\"},\n"
    " {\"bufferView\": 7, \"componentType\": 5126, \"count\": 9, \"type\": \"VEC3\"},\n"
    " {\"componentType\": 5126, \"count\": 9, \"type\": \"VEC3\", \"sparse\": {\"count\": 1, \"indices\": "
    "{\"bufferView\": 7, "
    "\"byteOffset\": 108, \"componentType\": 5123},\n"
    "  \"values\": {\"bufferView\": 7, \"byteOffset\": 112}}}],\n"
    "\"meshes\": [{\"primitives\": [{\"attributes\": {\"POSITION\": 0, \"JOINTS_0\": 1, \"WEIGHTS_0\": 2, "
    "\"TEXCOORD_0\": 3}, "
    "\"indices\": 4,\n"
    " \"targets\": [{\"POSITION\": 10}, {\"POSITION\": 11}]}], \"extras\": {\"targetNames\": [\"tall\"]}}],\n"
    "\"skins\": [{\"inverseBindMatrices\": 5, \"joints\": [1, 2, 3]}],\n"
    "\"nodes\": [{\"name\": \"armature\", \"scale\": [0.5, 0.5, 0.5], \"children\": [1, 4]},\n"
    " {\"name\": \"mixamorig:Hips\", \"translation\": [0, 1, 0], \"rotation\": [0, 0, 0.70710678, 0.70710678], "
    "\"children\": [2]},\n"
    " {\"name\": \"mixamorig:Neck\", \"translation\": [0.35, 0, 0], \"children\": [3]},\n"
    " {\"name\": \"mixamorig:Head\", \"translation\": [0.1, 0, 0], \"rotation\": [0, 0, -0.70710678, 0.70710678]},\n"
    " {\"mesh\": 0, \"skin\": 0}],\n"
    "\"animations\": [{\"name\": \"nod\", \"channels\": [{\"sampler\": 0, \"target\": {\"node\": 3, \"path\": "
    "\"rotation\"}},\n"
    " {\"sampler\": 1, \"target\": {\"node\": 1, \"path\": \"translation\"}},\n"
    " {\"sampler\": 2, \"target\": {\"node\": 2, \"path\": \"rotation\"}}],\n"
    " \"samplers\": [{\"input\": 6, \"output\": 7}, {\"input\": 6, \"output\": 8, \"interpolation\": \"STEP\"},\n"
    " {\"input\": 6, \"output\": 9, \"interpolation\": \"CUBICSPLINE\"}]}]}\n";

/* With its bytes as base64 in the text. Returns the size of the text. */
static inline size_t small_gltf(char text[8192])
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    uint8_t bytes[SMALL_GLTF_BYTES + 2] = { 0 };
    char uri[1400] = ", \"uri\": \"data:application/octet-stream;base64,";
    small_gltf_bytes(bytes);
    char *to = uri + strlen(uri);
    for (int i = 0; i < SMALL_GLTF_BYTES; i += 3) {
        uint32_t three = (uint32_t)bytes[i] << 16 | (uint32_t)bytes[i + 1] << 8 | bytes[i + 2];
        for (int k = 0; k < 4; k++) *to++ = i + k > SMALL_GLTF_BYTES ? '=' : digits[three >> (18 - 6 * k) & 63];
    }
    memcpy(to, "\"", 2);
    return (size_t)snprintf(text, 8192, small_gltf_json, uri);
}

/* The same as .glb. */
static inline size_t small_glb(uint8_t to[8192])
{
    char json[8000];
    size_t size = (size_t)snprintf(json, sizeof json, small_gltf_json, "");
    while (size % 4) json[size++] = ' ';
    const uint32_t words[] = { 2, (uint32_t)(28 + size + SMALL_GLTF_BYTES), (uint32_t)size, 0x4e4f534a },
                   second[] = { SMALL_GLTF_BYTES, 0x004e4942 };
    memcpy(to, "glTF", 4);
    memcpy(to + 4, words, 16);
    memcpy(to + 20, json, size);
    memcpy(to + 20 + size, second, 8);
    small_gltf_bytes(to + 28 + size);
    return 28 + size + SMALL_GLTF_BYTES;
}

#endif
