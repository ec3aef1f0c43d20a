/* Frames and queries of the body tree, for one precision: hg_real, HG_VEC3, HG_V(name) and HG_B(name) are set by
 * body_query.c, the only place that includes this.
 */

/* Sixteen triangles: first corner, two edges from it, and 1 / |ab|^2, 1 / |ac|^2, 1 / |bc|^2, 1 / (4 area^2); a zero
 * stands for one over nothing, which leaves the corner itself as the closest point. */
typedef struct {
    hg_real a[3][HG_BODY_LANES], ab[3][HG_BODY_LANES], ac[3][HG_BODY_LANES], inverse[4][HG_BODY_LANES];
} HG_B(leaf);

/* Boxes of sixteen children; those of absent ones are inside out and at infinity. */
typedef struct {
    hg_real lo[3][HG_BODY_LANES], hi[3][HG_BODY_LANES];
} HG_B(node);

/* ---- frame ---- */

typedef struct {
    hg_body_refit *refit;
    const hg_real *vertices;
} HG_B(frame);

static void HG_B(fit_faces)(const void *args, int64_t first, int64_t last)
{
    const HG_B(frame) *frame = args;
    const hg_body_tree *tree = frame->refit->tree;
    hg_real *normals = frame->refit->face_normals;
    float *angles = frame->refit->angles;
    for (int64_t f = first; f < last; f++) {
        hg_vec3d p[3], edge[3];
        for (int k = 0; k < 3; k++)
            p[k] = HG_B(widen)(HG_V(load)(frame->vertices + 3 * (int64_t)tree->faces[3 * f + k]));
        for (int k = 0; k < 3; k++) edge[k] = hg_vec3d_normalize(hg_vec3d_sub(p[(k + 1) % 3], p[k]));
        hg_vec3d across = hg_vec3d_cross(hg_vec3d_sub(p[1], p[0]), hg_vec3d_sub(p[2], p[0]));
        HG_V(store)(normals + 3 * f, HG_B(narrow)(hg_vec3d_normalize(across)));
        for (int k = 0; k < 3; k++) angles[3 * f + k] = (float)hg_body_angle(-hg_vec3d_dot(edge[k], edge[(k + 2) % 3]));
    }
}

static void HG_B(fit_vertices)(const void *args, int64_t first, int64_t last)
{
    const HG_B(frame) *frame = args;
    const hg_body_tree *tree = frame->refit->tree;
    const hg_real *face_normals = frame->refit->face_normals;
    const float *angles = frame->refit->angles;
    hg_real *normals = frame->refit->vertex_normals;
    for (int64_t v = first; v < last; v++) {
        HG_VEC3 sum = { 0, 0, 0 };
        for (int32_t i = tree->corner_start[v]; i < tree->corner_start[v + 1]; i++) {
            int32_t corner = tree->corners[i];
            sum = HG_V(add_scaled)(sum, (hg_real)angles[corner], HG_V(load)(face_normals + 3 * (int64_t)(corner / 3)));
        }
        HG_V(store)(normals + 3 * v, sum);
    }
}

static hg_real HG_B(inverse)(hg_real x) { return x > (hg_real)HG_B(least) ? (hg_real)1 / x : (hg_real)0; }

static void HG_B(fit_leaves)(const void *args, int64_t first, int64_t last)
{
    const HG_B(frame) *frame = args;
    const hg_body_tree *tree = frame->refit->tree;
    for (int64_t i = first; i < last; i++) {
        HG_B(leaf) *leaf = (HG_B(leaf) *)frame->refit->leaves + i;
        HG_B(node) *parent = (HG_B(node) *)frame->refit->nodes + i / HG_BODY_LANES;
        hg_real lo[3] = { (hg_real)INFINITY, (hg_real)INFINITY, (hg_real)INFINITY },
                hi[3] = { -(hg_real)INFINITY, -(hg_real)INFINITY, -(hg_real)INFINITY }, finite = 0;
        for (int lane = 0; lane < HG_BODY_LANES; lane++) {
            int64_t place = i * HG_BODY_LANES + lane;
            if (place >= tree->n_faces) { /* far enough never to be near, near enough to be squared */
                for (int k = 0; k < 3; k++) {
                    leaf->a[k][lane] = (hg_real)1e18;
                    leaf->ab[k][lane] = leaf->ac[k][lane] = 0;
                }
                for (int k = 0; k < 4; k++) leaf->inverse[k][lane] = 0;
                continue;
            }
            const int32_t *face = tree->faces + 3 * (int64_t)tree->order[place];
            hg_real a[3], ab[3], ac[3], ab2 = 0, ac2 = 0, bc2 = 0, abac = 0;
            for (int k = 0; k < 3; k++) {
                hg_real b = frame->vertices[3 * (int64_t)face[1] + k], c = frame->vertices[3 * (int64_t)face[2] + k];
                a[k] = frame->vertices[3 * (int64_t)face[0] + k];
                finite += a[k] * 0 + b * 0 + c * 0; /* NaN as soon as one is not finite */
                lo[k] = a[k] < lo[k] ? a[k] : lo[k];
                lo[k] = b < lo[k] ? b : lo[k];
                lo[k] = c < lo[k] ? c : lo[k];
                hi[k] = a[k] > hi[k] ? a[k] : hi[k];
                hi[k] = b > hi[k] ? b : hi[k];
                hi[k] = c > hi[k] ? c : hi[k];
                ab[k] = b - a[k];
                ac[k] = c - a[k];
                ab2 += ab[k] * ab[k];
                ac2 += ac[k] * ac[k];
                bc2 += (c - b) * (c - b);
                abac += ab[k] * ac[k];
                leaf->a[k][lane] = a[k];
                leaf->ab[k][lane] = ab[k];
                leaf->ac[k][lane] = ac[k];
            }
            hg_real area2 = ab2 * ac2 - abac * abac;
            leaf->inverse[0][lane] = HG_B(inverse)(ab2);
            leaf->inverse[1][lane] = HG_B(inverse)(ac2);
            leaf->inverse[2][lane] = HG_B(inverse)(bc2);
            /* Of a sliver only the edges are taken: nothing on it is farther from them than rounding. */
            leaf->inverse[3][lane] = area2 > (hg_real)HG_B(sliver) * ab2 * ac2 ? HG_B(inverse)(area2) : (hg_real)0;
        }
        for (int k = 0; k < 3; k++) {
            parent->lo[k][i % HG_BODY_LANES] = lo[k] + finite;
            parent->hi[k][i % HG_BODY_LANES] = hi[k] + finite;
        }
    }
}

/* Boxes of the levels above the first; false when a vertex was not finite. */
static bool HG_B(fit_nodes)(hg_body_refit *refit)
{
    const hg_body_tree *tree = refit->tree;
    HG_B(node) *nodes = refit->nodes;
    for (int level = 0; level < tree->levels; level++) {
        int64_t start = tree->level_start[level], n = tree->level_start[level + 1] - start;
        int64_t n_children = level == 0 ? tree->n_leaves : start - tree->level_start[level - 1];
        for (int64_t i = 0; i < n; i++) {
            HG_B(node) *node = nodes + start + i;
            for (int lane = 0; lane < HG_BODY_LANES; lane++) {
                int64_t child = i * HG_BODY_LANES + lane;
                if (child >= n_children) {
                    for (int k = 0; k < 3; k++) {
                        node->lo[k][lane] = (hg_real)INFINITY;
                        node->hi[k][lane] = -(hg_real)INFINITY;
                    }
                } else if (level > 0) {
                    const HG_B(node) *below = nodes + tree->level_start[level - 1] + child;
                    for (int k = 0; k < 3; k++) {
                        hg_real lo = (hg_real)INFINITY, hi = -(hg_real)INFINITY;
                        for (int l = 0; l < HG_BODY_LANES; l++) {
                            lo = below->lo[k][l] < lo ? below->lo[k][l] : lo;
                            hi = below->hi[k][l] > hi ? below->hi[k][l] : hi;
                        }
                        node->lo[k][lane] = lo;
                        node->hi[k][lane] = hi;
                    }
                } else if (!(node->lo[0][lane] - node->lo[0][lane] == 0)) {
                    return false;
                }
            }
        }
    }
    return true;
}

/* What a refit writes. */
static int64_t HG_B(bytes)(const hg_body_tree *tree)
{
    return (int64_t)sizeof(HG_B(leaf)) * tree->n_leaves +
           (int64_t)sizeof(HG_B(node)) * tree->level_start[tree->levels] + 12 * tree->n_faces +
           (int64_t)sizeof(hg_real) * 3 * (tree->n_faces + 2 * tree->n_vertices);
}

static hg_status HG_B(update)(hg_ctx *ctx, hg_body_refit *refit, const void *vertices)
{
    static const hg_kernel faces = {
        .name = "body_faces", .args_size = sizeof(HG_B(frame)), .cpu = HG_B(fit_faces), .block = 1024
    };
    static const hg_kernel corners = {
        .name = "body_vertices", .args_size = sizeof(HG_B(frame)), .cpu = HG_B(fit_vertices), .block = 1024
    };
    static const hg_kernel leaves = {
        .name = "body_leaves", .args_size = sizeof(HG_B(frame)), .cpu = HG_B(fit_leaves), .block = 64
    };
    const hg_body_tree *tree = refit->tree;
    refit->ready = false;
    memcpy(refit->vertices, vertices, 3 * (size_t)tree->n_vertices * sizeof(hg_real));
    HG_B(frame) frame = { refit, refit->vertices };
    HG_TRY(hg_launch(ctx, &faces, tree->n_faces, &frame));
    HG_TRY(hg_launch(ctx, &corners, tree->n_vertices, &frame));
    HG_TRY(hg_launch(ctx, &leaves, tree->n_leaves, &frame));
    if (!HG_B(fit_nodes)(refit))
        return hg_fail(HG_NUMERIC, "body: a vertex of this frame is not finite; check the pose and the shape");
    refit->ready = true;
    return HG_OK;
}

/* ---- query ---- */

typedef struct {
    const hg_body_refit *refit;
    hg_contact_mode mode;
    double reach;
    const hg_real *points;
    int32_t *triangle;
    hg_real *contact_point, *contact_normal;
} HG_B(query);

/* Squared distances to sixteen boxes. */
static inline void HG_B(box_distances)(const HG_B(node) * node, HG_VEC3 p, hg_real *restrict out)
{
    for (int l = 0; l < HG_BODY_LANES; l++) {
        hg_real lx = node->lo[0][l] - p.x, hx = p.x - node->hi[0][l], x = lx > hx ? lx : hx;
        hg_real ly = node->lo[1][l] - p.y, hy = p.y - node->hi[1][l], y = ly > hy ? ly : hy;
        hg_real lz = node->lo[2][l] - p.z, hz = p.z - node->hi[2][l], z = lz > hz ? lz : hz;
        x = x > 0 ? x : 0;
        y = y > 0 ? y : 0;
        z = z > 0 ? z : 0;
        out[l] = x * x + y * y + z * z;
    }
}

/* Squared distances to sixteen triangles: the least of the residuals to the three edges and the face. Every residual is
 * that of a point of the triangle, so rounding never makes a triangle nearer than it is. */
static inline void HG_B(leaf_distances)(const HG_B(leaf) * leaf, HG_VEC3 p, hg_real *restrict out)
{
    for (int l = 0; l < HG_BODY_LANES; l++) {
        hg_real ax = p.x - leaf->a[0][l], ay = p.y - leaf->a[1][l], az = p.z - leaf->a[2][l];
        hg_real bx = leaf->ab[0][l], by = leaf->ab[1][l], bz = leaf->ab[2][l];
        hg_real cx = leaf->ac[0][l], cy = leaf->ac[1][l], cz = leaf->ac[2][l];
        hg_real ab2 = bx * bx + by * by + bz * bz, ac2 = cx * cx + cy * cy + cz * cz,
                abac = bx * cx + by * cy + bz * cz;
        hg_real d1 = ax * bx + ay * by + az * bz, d2 = ax * cx + ay * cy + az * cz;

        hg_real t = d1 * leaf->inverse[0][l];
        t = t > 0 ? t : 0;
        t = t < 1 ? t : 1;
        hg_real x = ax - t * bx, y = ay - t * by, z = az - t * bz;
        hg_real best = x * x + y * y + z * z;

        t = d2 * leaf->inverse[1][l];
        t = t > 0 ? t : 0;
        t = t < 1 ? t : 1;
        x = ax - t * cx, y = ay - t * cy, z = az - t * cz;
        hg_real other = x * x + y * y + z * z;
        best = other < best ? other : best;

        hg_real ex = cx - bx, ey = cy - by, ez = cz - bz;
        x = ax - bx, y = ay - by, z = az - bz;
        t = (x * ex + y * ey + z * ez) * leaf->inverse[2][l];
        t = t > 0 ? t : 0;
        t = t < 1 ? t : 1;
        x = x - t * ex, y = y - t * ey, z = z - t * ez;
        other = x * x + y * y + z * z;
        best = other < best ? other : best;

        hg_real v = (ac2 * d1 - abac * d2) * leaf->inverse[3][l], w = (ab2 * d2 - abac * d1) * leaf->inverse[3][l];
        x = ax - v * bx - w * cx, y = ay - v * by - w * cy, z = az - v * bz - w * cz;
        other = x * x + y * y + z * z;
        hg_real inside = v < w ? v : w, rest = 1 - v - w;
        inside = inside < rest ? inside : rest;
        other = inside >= 0 ? other : (hg_real)HG_BODY_FAR;
        out[l] = other < best ? other : best;
    }
}

static hg_body_place HG_B(place)(const hg_body_refit *refit, HG_VEC3 p, int32_t f)
{
    const hg_real *vertices = refit->vertices;
    const int32_t *face = refit->tree->faces + 3 * (int64_t)f;
    return hg_body_place_on_triangle(HG_B(widen)(p), HG_B(widen)(HG_V(load)(vertices + 3 * (int64_t)face[0])),
                                     HG_B(widen)(HG_V(load)(vertices + 3 * (int64_t)face[1])),
                                     HG_B(widen)(HG_V(load)(vertices + 3 * (int64_t)face[2])));
}

/* Squared distance to a point of triangle f that is near the closest: an upper bound, at a third of the price. */
static inline hg_real HG_B(guess_distance2)(const hg_body_refit *refit, HG_VEC3 p, int32_t f)
{
    const hg_real *vertices = refit->vertices;
    const int32_t *face = refit->tree->faces + 3 * (int64_t)f;
    HG_VEC3 a = HG_V(load)(vertices + 3 * (int64_t)face[0]);
    HG_VEC3 ab = HG_V(sub)(HG_V(load)(vertices + 3 * (int64_t)face[1]), a);
    HG_VEC3 ac = HG_V(sub)(HG_V(load)(vertices + 3 * (int64_t)face[2]), a), ap = HG_V(sub)(p, a);
    hg_real ab2 = HG_V(norm2)(ab), ac2 = HG_V(norm2)(ac), abac = HG_V(dot)(ab, ac);
    hg_real d1 = HG_V(dot)(ab, ap), d2 = HG_V(dot)(ac, ap), inverse = HG_B(inverse)(ab2 * ac2 - abac * abac);
    hg_real v = (ac2 * d1 - abac * d2) * inverse, w = (ab2 * d2 - abac * d1) * inverse;
    v = v > 0 ? v : 0;
    w = w > 0 ? w : 0;
    hg_real over = v + w > 1 ? 1 / (v + w) : 1;
    return HG_V(norm2)(HG_V(add_scaled)(HG_V(add_scaled)(ap, -v * over, ab), -w * over, ac));
}

/* (sqrt(d2) + HG_BODY_TIE)^2, and a little more for rounding */
static inline hg_real HG_B(tie_bound)(hg_real d2)
{
    hg_real d = HG_MATH(sqrt)(d2) + (hg_real)HG_BODY_TIE;
    return d * d * (hg_real)HG_B(slack);
}

/* What a search has found: the triangles that may tie with the closest, in the order they were met. */
typedef struct {
    hg_real best, bound; /* squared distance of the closest, and up to which others tie with it */
    int n;
    bool full;
    struct {
        int32_t face;
        hg_real distance2;
    } tied[HG_BODY_TIES];
    /* once `full`, in a second search with the bound known: the winner so far */
    int32_t winner;
    hg_real height;
} HG_B(found);

/* Whether `face` wins over the winner so far: the largest |n.(x - a)|, then the lowest index. */
static inline void HG_B(compete)(const hg_body_refit *refit, HG_VEC3 p, int32_t face, HG_B(found) * found)
{
    int64_t corner = refit->tree->faces[3 * (int64_t)face];
    HG_VEC3 a = HG_V(load)((const hg_real *)refit->vertices + 3 * corner);
    HG_VEC3 n = HG_V(load)((const hg_real *)refit->face_normals + 3 * (int64_t)face);
    hg_real height = HG_MATH(fabs)(HG_V(dot)(n, HG_V(sub)(p, a)));
    if (found->winner < 0 || height > found->height || (height == found->height && face < found->winner)) {
        found->winner = face;
        found->height = height;
    }
}

static void HG_B(meet)(const hg_body_refit *refit, HG_VEC3 p, int32_t face, hg_real distance2, bool second,
                       HG_B(found) * found)
{
    if (second) {
        HG_B(compete)(refit, p, face, found);
        return;
    }
    if (distance2 < found->best) {
        found->best = distance2;
        found->bound = HG_B(tie_bound)(distance2);
    }
    if (found->n == HG_BODY_TIES) {
        found->n = 0;
        for (int i = 0; i < HG_BODY_TIES; i++)
            if (found->tied[i].distance2 <= found->bound) found->tied[found->n++] = found->tied[i];
        if (found->n == HG_BODY_TIES) {
            found->full = true;
            return;
        }
    }
    found->tied[found->n].face = face;
    found->tied[found->n++].distance2 = distance2;
}

/* The triangles of a leaf that are within found->bound are met. */
static void HG_B(open_leaf)(const hg_body_refit *refit, HG_VEC3 p, int32_t index, bool second, HG_B(found) * found)
{
    const hg_body_tree *tree = refit->tree;
    _Alignas(64) hg_real distance2[HG_BODY_LANES];
    HG_B(leaf_distances)((const HG_B(leaf) *)refit->leaves + index, p, distance2);
    for (uint32_t hit = HG_B(lanes_within)(distance2, found->bound); hit; hit &= hit - 1) {
        int lane = __builtin_ctz(hit);
        int64_t place = (int64_t)index * HG_BODY_LANES + lane;
        if (distance2[lane] <= found->bound && place < tree->n_faces)
            HG_B(meet)(refit, p, tree->order[place], distance2[lane], second, found);
    }
}

/* Nearest boxes first; everything within found->bound is met. */
static void HG_B(search)(const hg_body_refit *refit, HG_VEC3 p, bool second, HG_B(found) * found)
{
    const hg_body_tree *tree = refit->tree;
    const HG_B(node) *nodes = refit->nodes;
    struct {
        int32_t level, index; /* level 0 is the leaves */
        hg_real distance2;
    } stack[HG_BODY_LEVELS * HG_BODY_LANES];
    int top = 0;
    stack[top].level = tree->levels;
    stack[top].index = 0;
    stack[top++].distance2 = 0;
    _Alignas(64) hg_real distance2[HG_BODY_LANES];
    while (top > 0) {
        top--;
        if (stack[top].distance2 > found->bound) continue;
        int32_t level = stack[top].level, index = stack[top].index;
        if (level == 0) {
            HG_B(open_leaf)(refit, p, index, second, found);
            continue;
        }
        HG_B(box_distances)(nodes + tree->level_start[level - 1] + index, p, distance2);
        int bottom = top;
        for (uint32_t hit = HG_B(lanes_within)(distance2, found->bound); hit; hit &= hit - 1) {
            int lane = __builtin_ctz(hit), at = top++;
            for (; at > bottom && stack[at - 1].distance2 < distance2[lane]; at--) stack[at] = stack[at - 1];
            stack[at].level = level - 1;
            stack[at].index = index * HG_BODY_LANES + lane;
            stack[at].distance2 = distance2[lane];
        }
    }
}

/* The leaves near some points in a row, which mostly lie along a strand: their searches start here and not at the root. */
typedef struct {
    HG_B(node) boxes;
    int32_t leaf[HG_BODY_LANES];
    int n; /* -1: too many */
} HG_B(around);

/* Points from `first` on that follow each other closely, a few at most: the number of the one behind them. */
static int64_t HG_B(group)(int64_t first, int64_t last, const hg_real *points)
{
    enum { MOST = 8 };
    int64_t end = first + 1;
    for (; end < last && end < first + MOST; end++)
        if (!(HG_V(distance)(HG_V(load)(points + 3 * end), HG_V(load)(points + 3 * end - 3)) <= (hg_real)HG_BODY_JUMP))
            break;
    return end;
}

/* All leaves within sqrt(within2) of the box of n points, which are finite but for the first, and of one more. */
static void HG_B(look_around)(const hg_body_refit *refit, const HG_VEC3 *more, int64_t n, const hg_real *points,
                              hg_real within2, HG_B(around) * around)
{
    const hg_body_tree *tree = refit->tree;
    hg_real lo[3] = { (hg_real)INFINITY, (hg_real)INFINITY, (hg_real)INFINITY },
            hi[3] = { -(hg_real)INFINITY, -(hg_real)INFINITY, -(hg_real)INFINITY };
    for (int64_t i = 0; i < n; i++) {
        if (!HG_V(finite)(HG_V(load)(points + 3 * i))) continue;
        for (int k = 0; k < 3; k++) {
            lo[k] = points[3 * i + k] < lo[k] ? points[3 * i + k] : lo[k];
            hi[k] = points[3 * i + k] > hi[k] ? points[3 * i + k] : hi[k];
        }
    }
    if (more) {
        const hg_real extra[3] = { more->x, more->y, more->z };
        for (int k = 0; k < 3; k++) {
            lo[k] = extra[k] < lo[k] ? extra[k] : lo[k];
            hi[k] = extra[k] > hi[k] ? extra[k] : hi[k];
        }
    }
    around->n = 0;
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < HG_BODY_LANES; l++) {
            around->boxes.lo[k][l] = (hg_real)INFINITY;
            around->boxes.hi[k][l] = -(hg_real)INFINITY;
        }
    struct {
        int32_t level, index;
    } stack[HG_BODY_LEVELS * HG_BODY_LANES];
    int top = 0;
    stack[top].level = tree->levels;
    stack[top++].index = 0;
    _Alignas(64) hg_real distance2[HG_BODY_LANES];
    while (top > 0) {
        const int32_t level = stack[--top].level, index = stack[top].index;
        const HG_B(node) *node = (const HG_B(node) *)refit->nodes + tree->level_start[level - 1] + index;
        for (int l = 0; l < HG_BODY_LANES; l++) {
            hg_real sum = 0;
            for (int k = 0; k < 3; k++) {
                const hg_real below = node->lo[k][l] - hi[k], above = lo[k] - node->hi[k][l];
                hg_real gap = below > above ? below : above;
                gap = gap > 0 ? gap : 0;
                sum += gap * gap;
            }
            distance2[l] = sum;
        }
        for (uint32_t hit = HG_B(lanes_within)(distance2, within2); hit; hit &= hit - 1) {
            const int lane = __builtin_ctz(hit);
            if (level > 1) {
                stack[top].level = level - 1;
                stack[top++].index = index * HG_BODY_LANES + lane;
                continue;
            }
            if (around->n == HG_BODY_LANES) {
                around->n = -1;
                return;
            }
            for (int k = 0; k < 3; k++) {
                around->boxes.lo[k][around->n] = node->lo[k][lane];
                around->boxes.hi[k][around->n] = node->hi[k][lane];
            }
            around->leaf[around->n++] = index * HG_BODY_LANES + lane;
        }
    }
}

/* search among them: nearest boxes first */
static void HG_B(search_around)(const hg_body_refit *refit, HG_VEC3 p, const HG_B(around) * around, bool second,
                                HG_B(found) * found)
{
    _Alignas(64) hg_real distance2[HG_BODY_LANES];
    HG_B(box_distances)(&around->boxes, p, distance2);
    int8_t order[HG_BODY_LANES];
    int n = 0;
    for (uint32_t hit = HG_B(lanes_within)(distance2, found->bound); hit; hit &= hit - 1) {
        const int lane = __builtin_ctz(hit);
        int at = n++;
        for (; at > 0 && distance2[order[at - 1]] > distance2[lane]; at--) order[at] = order[at - 1];
        order[at] = (int8_t)lane;
    }
    for (int i = 0; i < n && distance2[order[i]] <= found->bound; i++)
        HG_B(open_leaf)(refit, p, around->leaf[order[i]], second, found);
}

/* The triangle that the rule of hg_body_closest names among all within sqrt(bound) of p; -1 when there is none. around:
 * leaves that hold all of these, NULL: not known. */
static int32_t HG_B(nearest)(const hg_body_refit *refit, HG_VEC3 p, hg_real bound, const HG_B(around) * around)
{
    const bool known = around && around->n >= 0;
    HG_B(found) found;
    found.best = found.bound = bound;
    found.n = 0;
    found.full = false;
    found.winner = -1;
    found.height = 0;
    if (known)
        HG_B(search_around)(refit, p, around, false, &found);
    else
        HG_B(search)(refit, p, false, &found);
    if (found.full) {
        if (known)
            HG_B(search_around)(refit, p, around, true, &found);
        else
            HG_B(search)(refit, p, true, &found);
        return found.winner;
    }
    /* Usually one is left. */
    int kept = 0;
    for (int i = 0; i < found.n; i++)
        if (found.tied[i].distance2 <= found.bound) found.tied[kept++] = found.tied[i];
    if (kept == 1) return found.tied[0].face;
    for (int i = 0; i < kept; i++) HG_B(compete)(refit, p, found.tied[i].face, &found);
    return found.winner;
}

/* Angle-weighted normal of a place on triangle f; on an edge the angles are all pi. */
static hg_vec3d HG_B(outward)(const hg_body_refit *refit, int32_t f, const hg_body_place *place)
{
    const hg_body_tree *tree = refit->tree;
    const hg_real *normals = refit->face_normals;
    if (place->feature == HG_ON_FACE) return HG_B(widen)(HG_V(load)(normals + 3 * (int64_t)f));
    int64_t half = 3 * (int64_t)f + place->corner;
    if (place->feature == HG_ON_VERTEX)
        return HG_B(widen)(HG_V(load)((const hg_real *)refit->vertex_normals + 3 * (int64_t)tree->faces[half]));
    hg_vec3d sum = { 0.0, 0.0, 0.0 };
    int32_t edge = tree->face_edges[half];
    for (int32_t i = tree->edge_start[edge]; i < tree->edge_start[edge + 1]; i++)
        sum = hg_vec3d_add(sum, HG_B(widen)(HG_V(load)(normals + 3 * (int64_t)tree->edge_faces[i])));
    return sum;
}

static void HG_B(closest)(const void *args, int64_t first, int64_t last)
{
    const HG_B(query) *query = args;
    const hg_body_refit *refit = query->refit;
    const hg_body_tree *tree = refit->tree;
    const HG_B(node) *root = (const HG_B(node) *)refit->nodes + tree->level_start[tree->levels - 1];
    const hg_real reach = (hg_real)(query->reach < 1e17 ? query->reach : 1e17);
    const hg_real within = HG_B(tie_bound)(reach * reach);
    int32_t before = -1; /* the last point's triangle: a guess where there is no other */
    HG_VEC3 free_at = { 0, 0, 0 };
    hg_real free_radius = 0; /* no triangle is nearer than this to free_at, which is outside */
    const bool bounded = query->reach < 1;
    HG_B(around) around;
    int64_t group_end = first;  /* where the points end whose surroundings these are */
    bool group_outside = false; /* nothing is within reach of their box, and one of them is outside: all are */
    for (int64_t i = first; i < last; i++) {
        HG_VEC3 p = HG_V(load)(query->points + 3 * i), zero = { 0, 0, 0 };
        int32_t guess = query->triangle[i] >= 0 && query->triangle[i] < tree->n_faces ? query->triangle[i] : before;
        query->triangle[i] = -1;
        if (!HG_V(finite)(p)) {
            HG_V(store)(query->contact_point + 3 * i, zero);
            HG_V(store)(query->contact_normal + 3 * i, zero);
            continue;
        }
        if (bounded && i >= group_end) {
            const bool joined = i > first && free_radius > 0 && HG_V(distance)(p, free_at) <= (hg_real)HG_BODY_JUMP;
            group_end = HG_B(group)(i, last, query->points);
            HG_B(look_around)(refit, joined ? &free_at : NULL, group_end - i, query->points + 3 * i, within, &around);
            group_outside = joined && around.n == 0;
        }
        /* Along a strand the free ball around the last point often holds this one: then it is outside, too. */
        hg_real free_here = (free_radius - HG_V(distance)(p, free_at)) * (hg_real)(1.0 - 1e-5);
        if (group_outside) free_here = 2 * (reach + (hg_real)HG_BODY_TIE);
        int32_t face = -1;
        bool far = free_here > reach + (hg_real)HG_BODY_TIE;
        if (group_outside) free_here = reach;
        if (!far) {
            const HG_B(around) *near = bounded ? &around : NULL;
            hg_real bound = (hg_real)HG_BODY_FAR;
            if (guess >= 0) {
                bound = HG_B(tie_bound)(HG_B(guess_distance2)(refit, p, guess));
                if (!(bound < (hg_real)HG_BODY_FAR)) bound = (hg_real)HG_BODY_FAR;
            }
            if (within < bound) {
                _Alignas(64) hg_real distance2[HG_BODY_LANES];
                HG_B(box_distances)(root, p, distance2);
                hg_real box2 = distance2[0]; /* from p to the body's boxes */
                for (int l = 1; l < HG_BODY_LANES; l++) box2 = distance2[l] < box2 ? distance2[l] : box2;
                far = box2 > within;
                if (!far && free_here > 0) {
                    face = HG_B(nearest)(refit, p, within, near);
                    far = face < 0;
                }
                free_here = reach;
            }
            if (!far && face < 0) face = HG_B(nearest)(refit, p, bound, bound <= within ? near : NULL);
            if (!far && face < 0) face = HG_B(nearest)(refit, p, (hg_real)HG_BODY_FAR, NULL);
        }
        hg_vec3d at = HG_B(widen)(p), normal = { 0.0, 1.0, 0.0 }, point = at;
        if (face >= 0) {
            before = face;
            hg_body_place place = HG_B(place)(refit, p, face);
            hg_vec3d outward = HG_B(outward)(refit, face, &place);
            hg_vec3d own = HG_B(widen)(HG_V(load)((const hg_real *)refit->face_normals + 3 * (int64_t)face));
            normal = hg_body_contact_normal(query->mode, &place, at, own, outward, HG_B(near));
            point = place.point;
            bool outside = hg_vec3d_dot(outward, hg_vec3d_sub(at, point)) > 0.0;
            free_here = outside ? (hg_real)(sqrt(place.distance2) - HG_BODY_TIE) : 0;
        } else {
            point.y -= (double)reach;
        }
        free_at = p;
        free_radius = free_here;
        group_outside = bounded && around.n == 0 && free_here > 0;
        query->triangle[i] = face;
        HG_V(store)(query->contact_point + 3 * i, HG_B(narrow)(point));
        HG_V(store)(query->contact_normal + 3 * i, HG_B(narrow)(normal));
    }
}

static hg_status HG_B(run)(hg_ctx *ctx, const hg_body_refit *refit, hg_contact_mode mode, double reach, int64_t n,
                           const void *points, int32_t *triangle, void *contact_point, void *contact_normal)
{
    static const hg_kernel kernel = {
        .name = "body_closest", .args_size = sizeof(HG_B(query)), .cpu = HG_B(closest), .block = 512
    };
    HG_B(query) query = { refit, mode, reach, points, triangle, contact_point, contact_normal };
    return hg_launch(ctx, &kernel, n, &query);
}
