/* Strands in a PLY file: a cloud of vertices, and how they make strands is said by one of
 *   element polyline (line, curve, strand) with a list of vertex numbers (vertex_indices, vertex_index), root first;
 *   element strand with a number of segments (nsegs) for each, of vertices that lie one after the other (hairutil);
 *   element edge with vertex1, vertex2: chains. The root is where the edges lead away from, or, where they have no common
 *     direction, the end with the lower number;
 *   a scalar strand, strand_id or strand_index of element vertex; vertices of a strand in the file's order. */
#include "scene/ply.h"
#include "scene/scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int64_t vertices;
    float *points;   /* [N,3] */
    int64_t *index;  /* [N] strand of a vertex; NULL: not said */
    int64_t edges;   /* -1: no such element */
    int32_t *edge;   /* [M,2] */
    int64_t strands; /* said by polylines or segments; -1: by neither */
    int64_t *start;  /* [strands+1] */
    int64_t *order;  /* [start[strands]] vertex numbers; NULL: 0, 1, 2 ... */
    int64_t order_capacity;
} cloud;

static void cloud_free(cloud *c)
{
    hg_free(c->points);
    hg_free(c->index);
    hg_free(c->edge);
    hg_free(c->start);
    hg_free(c->order);
}

/* ---- elements ----------------------------------------------------------------------------------------------- */

static hg_status read_vertices(ply *file, const ply_element *element, cloud *c)
{
    static const char *const names[] = { "strand_index", "strand_id", "strand" };
    int at[3] = { ply_scalar(element, "x"), ply_scalar(element, "y"), ply_scalar(element, "z") }, index = -1;
    if (at[0] < 0 || at[1] < 0 || at[2] < 0)
        return hg_fail(HG_FORMAT, "%s: element vertex has no x, y and z", file->lines.path);
    if (c->points) return hg_fail(HG_FORMAT, "%s: element vertex is there twice", file->lines.path);
    if (element->count < 1 || element->count > INT32_MAX)
        return hg_fail(HG_FORMAT, "%s: %lld vertices, expected 1 to 2147483647", file->lines.path,
                       (long long)element->count);
    for (int i = 0; i < 3 && index < 0; i++) index = ply_scalar(element, names[i]);
    c->vertices = element->count;
    c->points = hg_alloc((size_t)element->count, 3 * sizeof *c->points);
    if (index >= 0) c->index = hg_alloc((size_t)element->count, sizeof *c->index);
    if (!c->points || (index >= 0 && !c->index)) return HG_MEMORY;
    for (int64_t i = 0; i < element->count; i++) {
        HG_TRY(ply_row(file, element));
        for (int k = 0; k < 3; k++) c->points[3 * i + k] = (float)file->value[at[k]];
        if (index < 0) continue;
        double strand = file->value[index];
        if (!(strand >= 0 && strand < 0x1p53 && strand == floor(strand)))
            return hg_fail(HG_FORMAT, "%s: vertex %lld is of strand %g, expected a number from 0 on", file->lines.path,
                           (long long)i, strand);
        c->index[i] = (int64_t)strand;
    }
    return HG_OK;
}

static hg_status read_edges(ply *file, const ply_element *element, cloud *c)
{
    int a = ply_scalar(element, "vertex1"), b = ply_scalar(element, "vertex2");
    if (a < 0 || b < 0 || c->edges >= 0)
        return hg_fail(HG_FORMAT, "%s: element edge %s", file->lines.path,
                       c->edges >= 0 ? "is there twice" : "has no vertex1 and vertex2");
    c->edge = hg_alloc(element->count ? (size_t)element->count : 1, 2 * sizeof *c->edge);
    if (!c->edge) return HG_MEMORY;
    c->edges = element->count;
    for (int64_t i = 0; i < element->count; i++) {
        HG_TRY(ply_row(file, element));
        for (int side = 0; side < 2; side++) {
            double vertex = file->value[side ? b : a];
            c->edge[2 * i + side] = vertex >= 0 && vertex < INT32_MAX ? (int32_t)vertex : -1;
        }
    }
    return HG_OK;
}

/* Lists of vertex numbers, or numbers of segments. */
static hg_status read_strands(ply *file, const ply_element *element, cloud *c)
{
    int list = ply_list(element, "vertex_indices"), segments = ply_scalar(element, "nsegs");
    if (list < 0) list = ply_list(element, "vertex_index");
    if (list < 0 && segments < 0)
        return hg_fail(HG_FORMAT, "%s: element %s has neither a list vertex_indices nor a number nsegs",
                       file->lines.path, element->name);
    if (c->strands >= 0)
        return hg_fail(HG_FORMAT, "%s: strands are said twice, by %s too", file->lines.path, element->name);
    c->start = hg_alloc((size_t)element->count + 1, sizeof *c->start);
    if (!c->start) return HG_MEMORY;
    c->strands = element->count;
    file->keep = list;
    hg_status status = HG_OK;
    for (int64_t s = 0; status == HG_OK && s < element->count; s++) {
        status = ply_row(file, element);
        if (status != HG_OK) break;
        int64_t first = c->start[s], count = file->list_count;
        if (list < 0) {
            double number = file->value[segments];
            if (!(number >= 0 && number < INT32_MAX))
                status = hg_fail(HG_FORMAT, "%s: strand %lld has %g segments", file->lines.path, (long long)s, number);
            else
                c->start[s + 1] = first + (int64_t)number + 1;
            continue;
        }
        c->start[s + 1] = first + count;
        if (first + count > c->order_capacity) {
            int64_t larger = 2 * (first + count);
            int64_t *order = hg_resize(c->order, (size_t)c->order_capacity, (size_t)larger, sizeof *order);
            if (!order) return HG_MEMORY;
            c->order = order;
            c->order_capacity = larger;
        }
        if (count > 0) memcpy(c->order + first, file->list, (size_t)count * sizeof *c->order);
    }
    file->keep = -1;
    return status;
}

static hg_status read_elements(ply *file, cloud *c)
{
    static const char *const lines[] = { "polyline", "line", "curve", "strand" };
    for (int e = 0; e < file->n; e++) {
        const ply_element *element = &file->element[e];
        bool strand = false;
        for (int i = 0; i < 4; i++) strand = strand || strcmp(element->name, lines[i]) == 0;
        if (strcmp(element->name, "vertex") == 0) {
            HG_TRY(read_vertices(file, element, c));
        } else if (strcmp(element->name, "edge") == 0) {
            HG_TRY(read_edges(file, element, c));
        } else if (strand) {
            HG_TRY(read_strands(file, element, c));
        } else if (element->n > 0) {
            for (int64_t i = 0; i < element->count; i++) HG_TRY(ply_row(file, element));
        }
    }
    return c->points ? HG_OK : hg_fail(HG_FORMAT, "%s: it has no element vertex", file->lines.path);
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

/* One chain from `vertex` on. ways [N,2]: the neighbours of a vertex, -1 for none. */
static void follow(int64_t vertex, const int32_t *ways, bool directed, bool *seen, cloud *c, int64_t *placed)
{
    while (vertex >= 0) {
        seen[vertex] = true;
        c->order[(*placed)++] = vertex;
        int64_t next = ways[2 * vertex + 1];
        if (!directed && (next < 0 || seen[next])) next = ways[2 * vertex];
        vertex = next >= 0 && !seen[next] ? next : -1;
    }
}

/* ways of chains: directed [vertex before, vertex after], else the two neighbours in any order. False: not possible. */
static bool find_ways(const cloud *c, bool directed, int32_t *ways, int64_t *crowded)
{
    for (int64_t i = 0; i < 2 * c->vertices; i++) ways[i] = -1;
    for (int64_t i = 0; i < 2 * c->edges; i++) {
        int32_t vertex = c->edge[i], other = c->edge[i ^ 1];
        int32_t *way = &ways[2 * (int64_t)vertex + (directed ? !(i & 1) : 0)];
        if (!directed && *way >= 0) way++;
        *crowded = vertex;
        if (*way >= 0) return false;
        *way = other;
    }
    return true;
}

static hg_status chain_edges(const char *path, cloud *c, int32_t *ways, bool *seen)
{
    int64_t crowded = 0, placed = 0, strands = 0;
    for (int64_t i = 0; i < c->edges; i++) {
        int32_t a = c->edge[2 * i], b = c->edge[2 * i + 1];
        if (a < 0 || b < 0 || a >= c->vertices || b >= c->vertices || a == b)
            return hg_fail(HG_FORMAT, "%s: edge %lld joins vertices %d and %d, expected two of 0 to %lld", path,
                           (long long)i, a, b, (long long)c->vertices - 1);
    }
    bool directed = find_ways(c, true, ways, &crowded);
    if (!directed && !find_ways(c, false, ways, &crowded))
        return hg_fail(HG_FORMAT, "%s: vertex %lld has more than two edges: it is no strand", path, (long long)crowded);
    for (int64_t v = 0; v < c->vertices; v++) {
        bool end = directed ? ways[2 * v] < 0 : ways[2 * v] < 0 || ways[2 * v + 1] < 0;
        if (!end || seen[v]) continue;
        follow(v, ways, directed, seen, c, &placed);
        c->start[++strands] = placed;
    }
    c->strands = strands;
    for (int64_t v = 0; v < c->vertices; v++)
        if (!seen[v])
            return hg_fail(HG_FORMAT, "%s: the edges at vertex %lld make a ring: a strand has two ends", path,
                           (long long)v);
    return HG_OK;
}

static hg_status strands_of_edges(const char *path, cloud *c)
{
    int32_t *ways = hg_alloc((size_t)c->vertices, 2 * sizeof *ways);
    bool *seen = hg_alloc((size_t)c->vertices, sizeof *seen);
    c->order = hg_alloc((size_t)c->vertices, sizeof *c->order);
    c->start = hg_alloc((size_t)c->vertices + 1, sizeof *c->start);
    hg_status status = ways && seen && c->order && c->start ? chain_edges(path, c, ways, seen) : HG_MEMORY;
    hg_free(ways);
    hg_free(seen);
    return status;
}

typedef struct {
    int64_t strand, vertex;
} numbered;

static int compare(const void *a, const void *b)
{
    const numbered *p = a, *q = b;
    if (p->strand != q->strand) return p->strand < q->strand ? -1 : 1;
    return p->vertex < q->vertex ? -1 : p->vertex > q->vertex;
}

/* Strand numbers may have gaps, and the vertices of a strand need not lie together. */
static hg_status strands_of_index(cloud *c)
{
    numbered *all = hg_alloc((size_t)c->vertices, sizeof *all);
    c->order = hg_alloc((size_t)c->vertices, sizeof *c->order);
    c->start = hg_alloc((size_t)c->vertices + 1, sizeof *c->start);
    if (!all || !c->order || !c->start) {
        hg_free(all);
        return HG_MEMORY;
    }
    for (int64_t i = 0; i < c->vertices; i++) all[i] = (numbered){ c->index[i], i };
    qsort(all, (size_t)c->vertices, sizeof *all, compare);
    c->strands = 0;
    for (int64_t i = 0; i < c->vertices; i++) {
        c->order[i] = all[i].vertex;
        if (i + 1 == c->vertices || all[i + 1].strand != all[i].strand) c->start[++c->strands] = i + 1;
    }
    hg_free(all);
    return HG_OK;
}

static hg_status strands_of(const ply *file, cloud *c)
{
    const char *path = file->lines.path;
    for (int e = 0; e < file->n; e++)
        if (strcmp(file->element[e].name, "face") == 0 && file->element[e].count > 0)
            return hg_fail(HG_FORMAT, "%s: it is a mesh of %lld faces, strands are needed", path,
                           (long long)file->element[e].count);
    if (c->strands >= 0) {
        int64_t points = c->start[c->strands];
        if (!c->order && points != c->vertices && c->strands > 0)
            return hg_fail(HG_FORMAT, "%s: the strands have %lld vertices by their segments, the file %lld", path,
                           (long long)points, (long long)c->vertices);
        for (int64_t i = 0; c->order && i < points; i++)
            if (c->order[i] < 0 || c->order[i] >= c->vertices)
                return hg_fail(HG_FORMAT, "%s: a strand names vertex %lld, expected 0 to %lld", path,
                               (long long)c->order[i], (long long)c->vertices - 1);
    } else if (c->edges > 0) {
        HG_TRY(strands_of_edges(path, c));
    } else if (c->index) {
        HG_TRY(strands_of_index(c));
    } else {
        return hg_fail(
            HG_FORMAT,
            "%s: a cloud of %lld points that does not say which make a strand; expected element edge "
            "(vertex1, vertex2), polyline (vertex_indices) or strand (nsegs), or a strand_index of each vertex",
            path, (long long)c->vertices);
    }
    return c->strands > 0 ? HG_OK : hg_fail(HG_FORMAT, "%s: it has 0 strands", path);
}

static hg_status read_from(hg_curves **curves, ply *file, cloud *c)
{
    HG_TRY(read_elements(file, c));
    HG_TRY(strands_of(file, c));
    int64_t points = c->start[c->strands];
    HG_TRY(hg_curves_create(curves, c->strands, points));
    memcpy((*curves)->start, c->start, (size_t)(c->strands + 1) * sizeof *c->start);
    for (int64_t i = 0; i < points; i++)
        memcpy((*curves)->points + 3 * i, c->points + 3 * (c->order ? c->order[i] : i), 3 * sizeof *c->points);
    return HG_OK;
}

static hg_status read_ply(hg_curves **curves, const char *path)
{
    ply *file = hg_alloc(1, sizeof *file);
    cloud c = { .edges = -1, .strands = -1 };
    *curves = NULL;
    hg_status status = file ? ply_open(file, path) : HG_MEMORY;
    if (status == HG_OK) {
        status = read_from(curves, file, &c);
        ply_close(file);
    }
    cloud_free(&c);
    hg_free(file);
    if (status != HG_OK) {
        hg_curves_destroy(*curves);
        *curves = NULL;
    }
    return status;
}

static const hg_groom_reader reader = { .extension = "ply",
                                        .what = "strands as edges, polylines, segments or strand numbers",
                                        .read = read_ply };
HG_REGISTER("groom reader", ply, &reader);
