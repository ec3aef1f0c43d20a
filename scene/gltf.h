/* A glTF 2.0 file: its JSON, its buffers, its accessors as numbers, its tree of nodes and its skeleton. Private to
 * scene/. */
#ifndef HG_SCENE_GLTF_H
#define HG_SCENE_GLTF_H

#include "scene/internal.h"

#include <cjson/cJSON.h>

typedef struct {
    double m[12]; /* rows of (A | b) */
} gltf_affine;

typedef struct {
    int parent;
    double translation[3], rotation[4] /* w x y z */, scale[3];
    bool is_matrix;
    gltf_affine matrix;
    const char *name; /* in the JSON; may be NULL */
} gltf_node;

typedef struct {
    char *path;
    uint8_t *bytes; /* of the file itself */
    size_t size;
    cJSON *json;
    int n_buffers;
    struct {
        const uint8_t *bytes;
        size_t size;
        void *owned;
    } * buffer;
    int n_nodes;
    gltf_node *node;
    int *order; /* [nodes] parents first */
} gltf_file;

hg_status gltf_open(gltf_file **file, const char *path);
void gltf_close(gltf_file *file);

const cJSON *gltf_item(const gltf_file *file, const char *list, int64_t index); /* NULL: none */
int gltf_count(const gltf_file *file, const char *list);
/* A whole number from low to high - 1 under a key; `otherwise` when it is absent. `where` is for messages. */
hg_status gltf_integer(const gltf_file *file, const cJSON *object, const char *where, const char *key,
                       int64_t otherwise, int64_t low, int64_t high, int64_t *value);
hg_status gltf_fail(const gltf_file *file, const char *format, ...) HG_PRINTF(2, 3);

/* All numbers of an accessor, [count, components], normalised integers as 0 to 1 or -1 to 1. components 0: as it has;
 * whole numbers come whole. Sparse accessors are filled in. */
hg_status gltf_read(const gltf_file *file, int64_t accessor, int components, int64_t *count, double **numbers);

gltf_affine gltf_multiply(const gltf_affine *a, const gltf_affine *b);
bool gltf_invert(const gltf_affine *a, gltf_affine *inverse);
hg_vec3d gltf_point(const gltf_affine *a, hg_vec3d p);
hg_vec3d gltf_direction(const gltf_affine *a, hg_vec3d d);
hg_quatd gltf_rotation(const gltf_affine *a); /* nearest by Gram and Schmidt; mirrored axes count as rotated */
gltf_affine gltf_local(const gltf_node *node);
/* Places of all nodes in the world; `top` stands above the tree (unit and axes). */
void gltf_globals(const gltf_file *file, const gltf_node *nodes, const gltf_affine *top, gltf_affine *global);

/* The skeleton of all skins that meshes use, parents first, with one root. */
typedef struct {
    int joints;
    int *node;          /* [joints] -1: a root that was added above several */
    int *parent;        /* [joints] */
    char **name;        /* [joints] each once */
    gltf_affine *bind;  /* [joints] in the world, at rest */
    int *joint_of_node; /* [nodes] -1: none */
    int skins;
    gltf_affine *place; /* [skins] of a skin's vertices in the world, at rest */
    bool posed;         /* the nodes do not stand as the skins rest */
} gltf_rig;
hg_status gltf_rig_create(const gltf_file *file, const gltf_affine *top, gltf_rig *rig);
void gltf_rig_free(gltf_rig *rig);
gltf_affine gltf_top(const scene_axes *axes);

#endif
