/* Body tree: topology. The order of the triangles in the tree, who shares a corner or an edge, and the plain search
 * that the tree is checked against. Frames and queries are in body_query.c.
 *
 * Sign: Baerentzen and Aanaes 2005, "Signed distance computation using the angle weighted pseudonormal". */
#include "geometry/body.h"

#include <stdlib.h>
#include <string.h>

/* ---- order of the triangles ---- */

typedef struct {
    double key;
    int32_t face;
} sorted_face;

typedef struct {
    double lo[3], hi[3];
} box;

typedef struct {
    const box *boxes;  /* of every face at rest */
    int32_t *order[3]; /* faces by centre along each axis; a range of the tree is the same range of all three */
    int32_t *scratch;  /* [F] */
    uint8_t *left;     /* [F] marks while a range is parted */
} builder;

static int compare_sorted(const void *a, const void *b)
{
    const sorted_face *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return x->face < y->face ? -1 : x->face > y->face;
}

static const box empty_box = { { HUGE_VAL, HUGE_VAL, HUGE_VAL }, { -HUGE_VAL, -HUGE_VAL, -HUGE_VAL } };

static void box_grow(box *a, const box *b)
{
    for (int k = 0; k < 3; k++) {
        if (b->lo[k] < a->lo[k]) a->lo[k] = b->lo[k];
        if (b->hi[k] > a->hi[k]) a->hi[k] = b->hi[k];
    }
}

static double box_area(const box *b)
{
    double x = b->hi[0] - b->lo[0], y = b->hi[1] - b->lo[1], z = b->hi[2] - b->lo[2];
    return x * y + y * z + z * x;
}

/* Parts [first, last) so that the faces before `middle` along `axis` come first in all three orders. */
static void part_range(builder *b, int axis, int64_t first, int64_t middle, int64_t last)
{
    for (int64_t i = first; i < last; i++) b->left[b->order[axis][i]] = i < middle;
    for (int other = 0; other < 3; other++) {
        if (other == axis) continue;
        int32_t *order = b->order[other];
        int64_t n_left = first, n_right = middle;
        for (int64_t i = first; i < last; i++) {
            if (b->left[order[i]])
                b->scratch[n_left++] = order[i];
            else
                b->scratch[n_right++] = order[i];
        }
        memcpy(order + first, b->scratch + first, (size_t)(last - first) * sizeof *order);
    }
}

/* Cuts [first, last), at most 16 units, into units, always where the surface area heuristic is least. */
static void cut_range(builder *b, int64_t first, int64_t last, int64_t unit)
{
    while (last - first > unit) {
        int64_t n_units = (last - first + unit - 1) / unit;
        double best = HUGE_VAL;
        int best_axis = 0;
        int64_t best_cut = 1;
        for (int axis = 0; axis < 3; axis++) {
            const int32_t *order = b->order[axis];
            double area_left[HG_BODY_LANES + 1], area_right[HG_BODY_LANES + 1];
            box grown = empty_box;
            for (int64_t i = first; i < last; i++) {
                if ((i - first) % unit == 0 && i > first) area_left[(i - first) / unit] = box_area(&grown);
                box_grow(&grown, &b->boxes[order[i]]);
            }
            grown = empty_box;
            for (int64_t i = last - 1; i >= first; i--) {
                box_grow(&grown, &b->boxes[order[i]]);
                if ((i - first) % unit == 0) area_right[(i - first) / unit] = box_area(&grown);
            }
            for (int64_t cut = 1; cut < n_units; cut++) {
                double cost =
                    area_left[cut] * (double)(cut * unit) + area_right[cut] * (double)(last - first - cut * unit);
                if (cost < best) {
                    best = cost;
                    best_axis = axis;
                    best_cut = cut;
                }
            }
        }
        int64_t middle = first + best_cut * unit;
        part_range(b, best_axis, first, middle, last);
        /* The recursion goes at most 16 deep: each call has fewer units than its caller. */
        cut_range(b, first, middle, unit);
        first = middle;
    }
}

static hg_status order_faces(hg_body_tree *tree, const double *vertices)
{
    int64_t n = tree->n_faces;
    hg_status status = HG_MEMORY;
    builder b = { 0 };
    box *boxes = hg_alloc((size_t)n, sizeof *boxes);
    sorted_face *sorted = hg_alloc((size_t)n, sizeof *sorted);
    b.scratch = hg_alloc((size_t)n, sizeof *b.scratch);
    b.left = hg_alloc((size_t)n, 1);
    for (int axis = 0; axis < 3; axis++) b.order[axis] = hg_alloc((size_t)n, sizeof(int32_t));
    if (!boxes || !sorted || !b.scratch || !b.left || !b.order[0] || !b.order[1] || !b.order[2]) goto done;

    for (int64_t f = 0; f < n; f++) {
        boxes[f] = empty_box;
        for (int k = 0; k < 3; k++) {
            box corner;
            memcpy(corner.lo, vertices + 3 * tree->faces[3 * f + k], sizeof corner.lo);
            memcpy(corner.hi, corner.lo, sizeof corner.hi);
            box_grow(&boxes[f], &corner);
        }
    }
    b.boxes = boxes;
    for (int axis = 0; axis < 3; axis++) {
        for (int64_t f = 0; f < n; f++) sorted[f] = (sorted_face){ boxes[f].lo[axis] + boxes[f].hi[axis], (int32_t)f };
        qsort(sorted, (size_t)n, sizeof *sorted, compare_sorted);
        for (int64_t f = 0; f < n; f++) b.order[axis][f] = sorted[f].face;
    }
    int64_t unit = HG_BODY_LANES;
    while (unit * HG_BODY_LANES < n) unit *= HG_BODY_LANES;
    for (; unit >= HG_BODY_LANES; unit /= HG_BODY_LANES)
        for (int64_t first = 0; first < n; first += unit * HG_BODY_LANES) {
            int64_t last = first + unit * HG_BODY_LANES;
            cut_range(&b, first, last < n ? last : n, unit);
        }
    memcpy(tree->order, b.order[0], (size_t)n * sizeof *tree->order);
    status = HG_OK;
done:
    hg_free(boxes);
    hg_free(sorted);
    hg_free(b.scratch);
    hg_free(b.left);
    for (int axis = 0; axis < 3; axis++) hg_free(b.order[axis]);
    return status;
}

/* ---- who shares what ---- */

typedef struct {
    int32_t low, high, half; /* half edge: face * 3 + corner */
} half_edge;

static int compare_half_edges(const void *a, const void *b)
{
    const half_edge *x = a, *y = b;
    if (x->low != y->low) return x->low < y->low ? -1 : 1;
    if (x->high != y->high) return x->high < y->high ? -1 : 1;
    return x->half < y->half ? -1 : x->half > y->half;
}

static hg_status find_shared(hg_body_tree *tree)
{
    int64_t n = 3 * tree->n_faces;
    for (int64_t h = 0; h < n; h++) tree->corner_start[tree->faces[h] + 1]++;
    for (int64_t v = 0; v < tree->n_vertices; v++) tree->corner_start[v + 1] += tree->corner_start[v];
    for (int64_t h = 0; h < n; h++) tree->corners[tree->corner_start[tree->faces[h]]++] = (int32_t)h;
    for (int64_t v = tree->n_vertices; v > 0; v--) tree->corner_start[v] = tree->corner_start[v - 1];
    tree->corner_start[0] = 0;

    half_edge *halves = hg_alloc((size_t)n, sizeof *halves);
    if (!halves) return HG_MEMORY;
    for (int64_t h = 0; h < n; h++) {
        int32_t from = tree->faces[h], to = tree->faces[h - h % 3 + (h + 1) % 3];
        halves[h] = (half_edge){ from < to ? from : to, from < to ? to : from, (int32_t)h };
    }
    qsort(halves, (size_t)n, sizeof *halves, compare_half_edges);
    for (int64_t i = 0; i < n; i++) {
        if (i == 0 || halves[i].low != halves[i - 1].low || halves[i].high != halves[i - 1].high)
            tree->edge_start[tree->n_edges++] = (int32_t)i;
        tree->face_edges[halves[i].half] = (int32_t)(tree->n_edges - 1);
        tree->edge_faces[i] = halves[i].half / 3;
    }
    tree->edge_start[tree->n_edges] = (int32_t)n;
    hg_free(halves);
    return HG_OK;
}

hg_status hg_body_tree_create(hg_body_tree **out, int64_t n_vertices, const double *rest_vertices, int64_t n_faces,
                              const int32_t *faces)
{
    *out = NULL;
    if (n_vertices < 1 || n_faces < 1 || !rest_vertices || !faces)
        return hg_fail(HG_INVALID, "body: %lld vertices and %lld triangles; a body needs at least one of each",
                       (long long)n_vertices, (long long)n_faces);
    if (n_faces > INT32_MAX / 3 || n_vertices > INT32_MAX / 3)
        return hg_fail(HG_INVALID, "body: %lld vertices and %lld triangles are more than the %d that can be numbered",
                       (long long)n_vertices, (long long)n_faces, INT32_MAX / 3);
    for (int64_t i = 0; i < 3 * n_faces; i++)
        if (faces[i] < 0 || faces[i] >= n_vertices)
            return hg_fail(HG_INVALID, "body: triangle %lld names vertex %d, but there are %lld", (long long)(i / 3),
                           faces[i], (long long)n_vertices);
    for (int64_t i = 0; i < 3 * n_faces; i++)
        if (!hg_vec3d_finite(hg_vec3d_load(rest_vertices + 3 * (int64_t)faces[i])))
            return hg_fail(HG_NUMERIC, "body: rest vertex %d is not finite", faces[i]);

    hg_body_tree *tree = hg_alloc(1, sizeof *tree);
    if (!tree) return HG_MEMORY;
    tree->n_vertices = n_vertices;
    tree->n_faces = n_faces;
    size_t n_corners = 3 * (size_t)n_faces;
    tree->faces = hg_alloc(n_corners, sizeof *tree->faces);
    tree->order = hg_alloc((size_t)n_faces, sizeof *tree->order);
    tree->corner_start = hg_alloc((size_t)n_vertices + 1, sizeof *tree->corner_start);
    tree->corners = hg_alloc(n_corners, sizeof *tree->corners);
    tree->face_edges = hg_alloc(n_corners, sizeof *tree->face_edges);
    tree->edge_start = hg_alloc(n_corners + 1, sizeof *tree->edge_start);
    tree->edge_faces = hg_alloc(n_corners, sizeof *tree->edge_faces);
    hg_status status = HG_MEMORY;
    if (tree->faces && tree->order && tree->corner_start && tree->corners && tree->face_edges && tree->edge_start &&
        tree->edge_faces) {
        memcpy(tree->faces, faces, n_corners * sizeof *faces);
        status = order_faces(tree, rest_vertices);
        if (status == HG_OK) status = find_shared(tree);
    }
    if (status != HG_OK) {
        hg_body_tree_destroy(tree);
        return status;
    }
    tree->n_leaves = (n_faces + HG_BODY_LANES - 1) / HG_BODY_LANES;
    int64_t below = tree->n_leaves;
    do {
        below = (below + HG_BODY_LANES - 1) / HG_BODY_LANES;
        tree->level_start[tree->levels + 1] = tree->level_start[tree->levels] + below;
        tree->levels++;
    } while (below > 1);
    *out = tree;
    return HG_OK;
}

void hg_body_tree_destroy(hg_body_tree *tree)
{
    if (!tree) return;
    hg_free(tree->faces);
    hg_free(tree->order);
    hg_free(tree->corner_start);
    hg_free(tree->corners);
    hg_free(tree->face_edges);
    hg_free(tree->edge_start);
    hg_free(tree->edge_faces);
    hg_free(tree);
}

int64_t hg_body_tree_faces(const hg_body_tree *tree) { return tree->n_faces; }

int64_t hg_body_tree_vertices(const hg_body_tree *tree) { return tree->n_vertices; }

/* ---- plain search ---- */

static hg_vec3d face_normal(const double *vertices, const int32_t *face)
{
    hg_vec3d a = hg_vec3d_load(vertices + 3 * (int64_t)face[0]);
    hg_vec3d ab = hg_vec3d_sub(hg_vec3d_load(vertices + 3 * (int64_t)face[1]), a);
    hg_vec3d ac = hg_vec3d_sub(hg_vec3d_load(vertices + 3 * (int64_t)face[2]), a);
    return hg_vec3d_normalize(hg_vec3d_cross(ab, ac));
}

/* Sum of the normals of the faces that have the place, weighted by their angle there (pi on an edge, so 1 each). */
static hg_vec3d outward_brute(const double *vertices, int64_t n_faces, const int32_t *faces, int64_t triangle,
                              const hg_body_place *place)
{
    if (place->feature == HG_ON_FACE) return face_normal(vertices, faces + 3 * triangle);
    int32_t v = faces[3 * triangle + place->corner], w = faces[3 * triangle + (place->corner + 1) % 3];
    hg_vec3d sum = { 0.0, 0.0, 0.0 };
    for (int64_t f = 0; f < n_faces; f++)
        for (int k = 0; k < 3; k++) {
            const int32_t *face = faces + 3 * f;
            int32_t here = face[k], next = face[(k + 1) % 3], last = face[(k + 2) % 3];
            if (place->feature == HG_ON_EDGE && ((here == v && next == w) || (here == w && next == v)))
                sum = hg_vec3d_add(sum, face_normal(vertices, face));
            if (place->feature == HG_ON_VERTEX && here == v) {
                hg_vec3d at = hg_vec3d_load(vertices + 3 * (int64_t)here);
                hg_vec3d to_next = hg_vec3d_sub(hg_vec3d_load(vertices + 3 * (int64_t)next), at);
                hg_vec3d to_last = hg_vec3d_sub(hg_vec3d_load(vertices + 3 * (int64_t)last), at);
                double angle = atan2(hg_vec3d_norm(hg_vec3d_cross(to_next, to_last)), hg_vec3d_dot(to_next, to_last));
                sum = hg_vec3d_add_scaled(sum, angle, face_normal(vertices, face));
            }
        }
    return sum;
}

void hg_body_closest_brute(int64_t n_vertices, const double *vertices, int64_t n_faces, const int32_t *faces,
                           hg_contact_mode mode, const double point[3], int32_t *triangle, double contact_point[3],
                           double contact_normal[3])
{
    (void)n_vertices;
    hg_vec3d p = hg_vec3d_load(point), zero = { 0.0, 0.0, 0.0 };
    *triangle = -1;
    hg_vec3d_store(contact_point, zero);
    hg_vec3d_store(contact_normal, zero);
    if (!hg_vec3d_finite(p)) return;
    double nearest = HUGE_VAL;
    for (int64_t f = 0; f < n_faces; f++) {
        hg_vec3d a = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f]);
        hg_vec3d b = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f + 1]);
        hg_vec3d c = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f + 2]);
        double d = sqrt(hg_body_place_on_triangle(p, a, b, c).distance2);
        if (d < nearest) nearest = d;
    }
    double best_height = -1.0;
    hg_body_place best = { .distance2 = HUGE_VAL };
    for (int64_t f = 0; f < n_faces; f++) {
        hg_vec3d a = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f]);
        hg_vec3d b = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f + 1]);
        hg_vec3d c = hg_vec3d_load(vertices + 3 * (int64_t)faces[3 * f + 2]);
        hg_body_place place = hg_body_place_on_triangle(p, a, b, c);
        double height = fabs(hg_vec3d_dot(face_normal(vertices, faces + 3 * f), hg_vec3d_sub(p, a)));
        if (sqrt(place.distance2) <= nearest + HG_BODY_TIE && height > best_height) {
            best_height = height;
            best = place;
            *triangle = (int32_t)f;
        }
    }
    if (*triangle < 0) return;
    hg_vec3d outward = outward_brute(vertices, n_faces, faces, *triangle, &best);
    hg_vec3d normal = face_normal(vertices, faces + 3 * (int64_t)*triangle);
    hg_vec3d_store(contact_point, best.point);
    hg_vec3d_store(contact_normal, hg_body_contact_normal(mode, &best, p, normal, outward, 1e-9));
}
