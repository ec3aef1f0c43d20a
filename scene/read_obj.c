/* Wavefront .obj: vertices, texture coordinates, polygons and groups. Polygons are cut as a fan from their first
 * corner, so a quad is cut at the diagonal from corner 0 to corner 2. Everything else in such a file is passed over. */
#include "scene/lines.h"
#include "scene/scene.h"

#include <limits.h>
#include <string.h>

#define MAX_CORNERS 1024

/* Arrays that grow as lines come: never more memory than a small multiple of the file. */
typedef struct {
    hg_mesh *mesh;
    int64_t vertex_capacity, face_capacity, group_capacity, coordinates, coordinate_capacity;
    float *coordinate;          /* [coordinates,2] vt lines */
    int32_t *vertex_coordinate; /* [vertex_capacity] vt of the first corner at a vertex, plus 1 */
    int32_t polygon, group;
} builder;

static hg_status grow(void **array, int64_t *capacity, int64_t count, size_t size)
{
    if (count <= *capacity) return HG_OK;
    int64_t larger = count + count / 2 + 1024;
    void *bigger = hg_resize(*array, (size_t)*capacity, (size_t)larger, size);
    if (!bigger) return HG_MEMORY;
    *array = bigger;
    *capacity = larger;
    return HG_OK;
}

static hg_status read_group(builder *b, hg_lines *lines)
{
    hg_mesh *mesh = b->mesh;
    hg_word word;
    if (!hg_lines_word(lines, &word)) word = (hg_word){ "default", 7 };
    for (b->group = 0; b->group < mesh->n_groups; b->group++)
        if (hg_word_is(word, mesh->group[b->group])) return HG_OK;
    int64_t count = (int64_t)mesh->n_groups + 1;
    if (count > 65536) return hg_lines_fail(lines, "more than 65536 groups");
    HG_TRY(grow((void **)&mesh->group, &b->group_capacity, count, sizeof *mesh->group));
    mesh->group[b->group] = hg_word_copy(word);
    if (!mesh->group[b->group]) return HG_MEMORY;
    mesh->n_groups++;
    return HG_OK;
}

/* One corner, "v", "v/t", "v//n" or "v/t/n"; numbers count from 1, negative ones back from the last. */
static hg_status read_corner(const builder *b, const hg_lines *lines, hg_word word, int32_t *vertex,
                             int32_t *coordinate)
{
    int64_t number[2] = { 0, 0 }, count[2] = { b->mesh->vertices, b->coordinates };
    for (int k = 0; k < 2; k++) {
        const char *slash = word.size ? memchr(word.at, '/', word.size) : NULL;
        size_t size = slash ? (size_t)(slash - word.at) : word.size;
        if (size > 0 || k == 0) {
            if (!hg_word_integer((hg_word){ word.at, size }, &number[k]))
                return hg_lines_fail(lines, "corner \"%.*s\" is not a vertex number", hg_word_length(word), word.at);
            if (number[k] < 0) number[k] += count[k] + 1;
            if (number[k] < 1 || number[k] > count[k])
                return hg_lines_fail(lines, "corner \"%.*s\" asks for %s that is not among the %lld before this line",
                                     hg_word_length(word), word.at, k ? "a texture coordinate" : "a vertex",
                                     (long long)count[k]);
        }
        word.at += slash ? size + 1 : size;
        word.size -= slash ? size + 1 : size;
    }
    *vertex = (int32_t)number[0] - 1;
    *coordinate = (int32_t)number[1];
    return HG_OK;
}

static hg_status read_face(builder *b, hg_lines *lines)
{
    hg_mesh *mesh = b->mesh;
    int32_t corner[MAX_CORNERS], coordinate = 0;
    int corners = 0;
    hg_word word;
    while (hg_lines_word(lines, &word)) {
        if (corners == MAX_CORNERS) return hg_lines_fail(lines, "a polygon of more than %d corners", MAX_CORNERS);
        HG_TRY(read_corner(b, lines, word, &corner[corners], &coordinate));
        if (coordinate > 0 && b->vertex_coordinate[corner[corners]] == 0)
            b->vertex_coordinate[corner[corners]] = coordinate;
        corners++;
    }
    if (corners < 3) return hg_lines_fail(lines, "a polygon of %d corners; at least 3 are needed", corners);
    int64_t count = mesh->faces + corners - 2, capacity = b->face_capacity;
    if (count > INT32_MAX / 3) return hg_lines_fail(lines, "more triangles than can be numbered");
    HG_TRY(grow((void **)&mesh->triangles, &capacity, count, 3 * sizeof *mesh->triangles));
    capacity = b->face_capacity;
    HG_TRY(grow((void **)&mesh->polygon, &capacity, count, sizeof *mesh->polygon));
    capacity = b->face_capacity;
    HG_TRY(grow((void **)&mesh->group_of_face, &capacity, count, sizeof *mesh->group_of_face));
    b->face_capacity = capacity;
    for (int k = 1; k + 1 < corners; k++) {
        int64_t f = mesh->faces++;
        mesh->triangles[3 * f] = corner[0];
        mesh->triangles[3 * f + 1] = corner[k];
        mesh->triangles[3 * f + 2] = corner[k + 1];
        mesh->polygon[f] = b->polygon;
        mesh->group_of_face[f] = b->group;
    }
    b->polygon++;
    return HG_OK;
}

static hg_status read_vertex(builder *b, hg_lines *lines)
{
    hg_mesh *mesh = b->mesh;
    if (mesh->vertices >= INT32_MAX / 3) return hg_lines_fail(lines, "more vertices than can be numbered");
    int64_t capacity = b->vertex_capacity;
    HG_TRY(grow((void **)&mesh->points, &capacity, mesh->vertices + 1, 3 * sizeof *mesh->points));
    capacity = b->vertex_capacity;
    HG_TRY(grow((void **)&b->vertex_coordinate, &capacity, mesh->vertices + 1, sizeof *b->vertex_coordinate));
    b->vertex_capacity = capacity;
    for (int k = 0; k < 3; k++) {
        double number;
        HG_TRY(hg_lines_number(lines, &number, "vertex"));
        mesh->points[3 * mesh->vertices + k] = (float)number;
    }
    mesh->vertices++;
    return HG_OK;
}

static hg_status read_coordinate(builder *b, hg_lines *lines)
{
    HG_TRY(grow((void **)&b->coordinate, &b->coordinate_capacity, b->coordinates + 1, 2 * sizeof *b->coordinate));
    for (int k = 0; k < 2; k++) {
        double number = 0;
        hg_word word;
        if (hg_lines_word(lines, &word) && !hg_word_number(word, &number))
            return hg_lines_fail(lines, "texture coordinate \"%.*s\" is not a finite number", hg_word_length(word),
                                 word.at);
        b->coordinate[2 * b->coordinates + k] = (float)number;
    }
    b->coordinates++;
    return HG_OK;
}

static hg_status read_lines(builder *b, hg_lines *lines)
{
    hg_word word;
    while (hg_lines_next(lines)) {
        hg_lines_word(lines, &word);
        if (hg_word_is(word, "v"))
            HG_TRY(read_vertex(b, lines));
        else if (hg_word_is(word, "vt"))
            HG_TRY(read_coordinate(b, lines));
        else if (hg_word_is(word, "f"))
            HG_TRY(read_face(b, lines));
        else if (hg_word_is(word, "g") || hg_word_is(word, "o"))
            HG_TRY(read_group(b, lines));
    }
    hg_mesh *mesh = b->mesh;
    if (mesh->vertices == 0) return hg_fail(HG_FORMAT, "%s: no vertex (a line \"v x y z\") in the file", lines->path);
    if (b->coordinates == 0) return HG_OK;
    mesh->uv = hg_alloc((size_t)mesh->vertices, 2 * sizeof *mesh->uv);
    if (!mesh->uv) return HG_MEMORY;
    for (int64_t v = 0; v < mesh->vertices; v++)
        if (b->vertex_coordinate[v] > 0)
            memcpy(mesh->uv + 2 * v, b->coordinate + 2 * (b->vertex_coordinate[v] - 1), 2 * sizeof *mesh->uv);
    return HG_OK;
}

hg_status hg_mesh_read_obj(hg_mesh **mesh, const char *path)
{
    *mesh = NULL;
    hg_lines lines;
    HG_TRY(hg_lines_open(&lines, path));
    builder b = { .mesh = hg_alloc(1, sizeof *b.mesh), .group = -1 };
    hg_status status = b.mesh ? read_lines(&b, &lines) : HG_MEMORY;
    hg_free(b.coordinate);
    hg_free(b.vertex_coordinate);
    hg_lines_close(&lines);
    if (status == HG_OK)
        *mesh = b.mesh;
    else
        hg_mesh_destroy(b.mesh);
    return status;
}

void hg_mesh_destroy(hg_mesh *mesh)
{
    if (!mesh) return;
    for (int i = 0; i < mesh->n_groups; i++) hg_free(mesh->group[i]);
    hg_free(mesh->group);
    hg_free(mesh->points);
    hg_free(mesh->uv);
    hg_free(mesh->triangles);
    hg_free(mesh->polygon);
    hg_free(mesh->group_of_face);
    hg_free(mesh);
}
