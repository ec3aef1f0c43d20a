/* How the processor searches the body tree, for one precision: sixteen boxes or triangles at a time, and for points in a row what is
 * near all of them once. Included by geometry/body.inc. */

HG_BODY int32_t HG_B(nearest)(const HG_B(view) * body, HG_VEC3 p, hg_real bound, const void *around);
HG_BODY bool HG_B(contact)(const hg_body_query *query, const HG_B(view) * body, int64_t i, HG_VEC3 p, int32_t face,
                           double *distance);

static inline void HG_B(box_distances)(const HG_B(node) * node, HG_VEC3 p, hg_real *restrict out)
{
    for (int l = 0; l < HG_BODY_LANES; l++) out[l] = HG_B(box_distance2)(node, l, p);
}

static inline void HG_B(leaf_distances)(const HG_B(leaf) * leaf, HG_VEC3 p, hg_real *restrict out)
{
    for (int l = 0; l < HG_BODY_LANES; l++) out[l] = HG_B(triangle_distance2)(leaf, l, p);
}

/* The triangles of a leaf that are within found->bound are met. */
static void HG_B(open_leaf)(const HG_B(view) * body, HG_VEC3 p, int32_t index, bool second, HG_B(found) * found)
{
    const hg_body_fit *tree = body->tree;
    _Alignas(64) hg_real distance2[HG_BODY_LANES];
    HG_B(leaf_distances)(body->leaves + index, p, distance2);
    for (uint32_t hit = HG_B(lanes_within)(distance2, found->bound); hit; hit &= hit - 1) {
        int lane = __builtin_ctz(hit);
        int64_t place = (int64_t)index * HG_BODY_LANES + lane;
        if (distance2[lane] <= found->bound && place < tree->n_faces)
            HG_B(meet)(body, p, tree->order[place], distance2[lane], second, found);
    }
}

/* Nearest boxes first; everything within found->bound is met. */
static void HG_B(search)(const HG_B(view) * body, HG_VEC3 p, bool second, HG_B(found) * found)
{
    const hg_body_fit *tree = body->tree;
    const HG_B(node) *nodes = body->nodes;
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
            HG_B(open_leaf)(body, p, index, second, found);
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
static void HG_B(look_around)(const HG_B(view) * body, const HG_VEC3 *more, int64_t n, const hg_real *points,
                              hg_real within2, HG_B(around) * around)
{
    const hg_body_fit *tree = body->tree;
    hg_real lo[3] = { HG_BODY_INFINITY, HG_BODY_INFINITY, HG_BODY_INFINITY },
            hi[3] = { -HG_BODY_INFINITY, -HG_BODY_INFINITY, -HG_BODY_INFINITY };
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
            around->boxes.lo[k][l] = HG_BODY_INFINITY;
            around->boxes.hi[k][l] = -HG_BODY_INFINITY;
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
        const HG_B(node) *node = body->nodes + tree->level_start[level - 1] + index;
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
static void HG_B(search_around)(const HG_B(view) * body, HG_VEC3 p, const HG_B(around) * around, bool second,
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
        HG_B(open_leaf)(body, p, around->leaf[order[i]], second, found);
}

static inline void HG_B(body_closest)(const hg_body_query *query, int64_t first, int64_t last)
{
    const hg_body_fit *tree = &query->body;
    const HG_B(view) body = HG_B(view_of)(tree, 0);
    const HG_B(node) *root = body.nodes + tree->level_start[tree->levels - 1];
    const hg_real *points = query->points;
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
        HG_VEC3 p = HG_V(load)(points + 3 * i), zero = { 0, 0, 0 };
        int32_t guess = query->triangle[i] >= 0 && query->triangle[i] < tree->n_faces ? query->triangle[i] : before;
        query->triangle[i] = -1;
        if (!HG_V(finite)(p)) {
            HG_V(store)((hg_real *)query->contact_point + 3 * i, zero);
            HG_V(store)((hg_real *)query->contact_normal + 3 * i, zero);
            continue;
        }
        if (bounded && i >= group_end) {
            const bool joined = i > first && free_radius > 0 && HG_V(distance)(p, free_at) <= (hg_real)HG_BODY_JUMP;
            group_end = HG_B(group)(i, last, points);
            HG_B(look_around)(&body, joined ? &free_at : NULL, group_end - i, points + 3 * i, within, &around);
            group_outside = joined && around.n == 0;
        }
        /* Along a strand the free ball around the last point often holds this one: then it is outside, too. */
        hg_real free_here = (free_radius - HG_V(distance)(p, free_at)) * (hg_real)(1.0 - 1e-5);
        if (group_outside) free_here = 2 * (reach + (hg_real)HG_BODY_TIE);
        int32_t face = -1;
        bool far = free_here > reach + (hg_real)HG_BODY_TIE;
        if (group_outside) free_here = reach;
        if (!far) {
            const HG_B(around) *near = bounded && around.n >= 0 ? &around : NULL;
            hg_real bound = (hg_real)HG_BODY_FAR;
            if (guess >= 0) {
                bound = HG_B(tie_bound)(HG_B(guess_distance2)(&body, p, guess));
                if (!(bound < (hg_real)HG_BODY_FAR)) bound = (hg_real)HG_BODY_FAR;
            }
            if (within < bound) {
                _Alignas(64) hg_real distance2[HG_BODY_LANES];
                HG_B(box_distances)(root, p, distance2);
                hg_real box2 = distance2[0]; /* from p to the body's boxes */
                for (int l = 1; l < HG_BODY_LANES; l++) box2 = distance2[l] < box2 ? distance2[l] : box2;
                far = box2 > within;
                if (!far && free_here > 0) {
                    face = HG_B(nearest)(&body, p, within, near);
                    far = face < 0;
                }
                free_here = reach;
            }
            if (!far && face < 0) face = HG_B(nearest)(&body, p, bound, bound <= within ? near : NULL);
            if (!far && face < 0) face = HG_B(nearest)(&body, p, (hg_real)HG_BODY_FAR, NULL);
        }
        double distance;
        const bool outside = HG_B(contact)(query, &body, i, p, face, &distance);
        if (face >= 0) {
            before = face;
            free_here = outside ? (hg_real)(distance - HG_BODY_TIE) : 0;
        }
        free_at = p;
        free_radius = free_here;
        group_outside = bounded && around.n == 0 && free_here > 0;
    }
}
