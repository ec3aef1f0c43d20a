/* PLY files, element by element. Private to scene/.
 *
 *     ply file;
 *     HG_TRY(ply_open(&file, path));                       the header
 *     for (int e = 0; e < file.n; e++) {                   elements in the file's order, every row of every one
 *         int x = ply_scalar(&file.element[e], "x");       -1: it has none
 *         for (int64_t i = 0; i < file.element[e].count; i++) {
 *             HG_TRY(ply_row(&file, &file.element[e]));
 *             ... file.value[x], or file.list[0 .. file.list_count) of the property file.keep
 *         }
 *     }
 *     ply_close(&file);
 */
#ifndef HG_SCENE_PLY_H
#define HG_SCENE_PLY_H

#include "scene/lines.h"

enum { PLY_ELEMENTS = 16, PLY_PROPERTIES = 48, PLY_NAME = 40 };
typedef struct {
    char name[PLY_NAME];
    int type, count_type; /* of ply_types; count_type -1: a scalar, else a list */
} ply_property;
typedef struct {
    char name[PLY_NAME];
    int64_t count;
    int n;
    ply_property property[PLY_PROPERTIES];
} ply_element;
typedef struct {
    hg_lines lines; /* the whole file; of an ascii one the reading place too */
    hg_bytes bytes; /* the reading place of a binary one */
    bool ascii, big_endian;
    int n;
    ply_element element[PLY_ELEMENTS];
    double value[PLY_PROPERTIES]; /* scalars of the row read last */
    int keep;                     /* property whose list is kept */
    int64_t *list, list_count, list_capacity;
} ply;

hg_status ply_open(ply *file, const char *path);
void ply_close(ply *file);
hg_status ply_row(ply *file, const ply_element *element); /* the next one */
int ply_scalar(const ply_element *element, const char *name);
int ply_list(const ply_element *element, const char *name);

#endif
