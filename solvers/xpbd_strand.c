/* xpbd_strand: substeps of a tile of strands. What the constraints are is said in xpbd.c.
 *
 * A multiplier is kept as the generalised force of its constraint times h^2, so that a stiffness of zero is no special case:
 *
 *     change = -(kappa C + force) / (kappa D + 1),   kappa = stiffness h^2,   D = sum of w |dC/d.|^2,   . += w dC/d. change
 *
 * Every D is a number: the derivatives of the three components of a constraint are perpendicular and equally long. */
#include "solvers/xpbd.h"

#include <math.h>
#include <string.h>

static const double PACE_MOST = 1e4, PACE_LEAST = 1.0 / 50; /* of h^2 */

#define INSIDE static inline __attribute__((always_inline))

typedef int64_t mask __attribute__((vector_size(HG_XPBD_LANES * sizeof(int64_t))));
typedef struct {
    hg_lanes x, y, z;
} vec;
typedef struct {
    hg_lanes w, x, y, z;
} quat;

INSIDE hg_lanes choose(mask condition, hg_lanes a, hg_lanes b)
{
    return (hg_lanes)((condition & (mask)a) | (~condition & (mask)b));
}
INSIDE hg_lanes positive(hg_lanes a) { return choose(a > 0, a, a - a); }

INSIDE hg_lanes root(hg_lanes a)
{
    hg_lanes out;
    for (int l = 0; l < HG_XPBD_LANES; l++) out[l] = sqrt(a[l]);
    return out;
}

INSIDE vec load(const hg_lanes *a) { return (vec){ a[0], a[1], a[2] }; }
INSIDE void store(hg_lanes *to, vec a) { to[0] = a.x, to[1] = a.y, to[2] = a.z; }
INSIDE vec plus(vec a, vec b) { return (vec){ a.x + b.x, a.y + b.y, a.z + b.z }; }
INSIDE vec minus(vec a, vec b) { return (vec){ a.x - b.x, a.y - b.y, a.z - b.z }; }
INSIDE vec times(vec a, hg_lanes s) { return (vec){ a.x * s, a.y * s, a.z * s }; }
INSIDE hg_lanes dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

INSIDE quat qload(const hg_lanes *a) { return (quat){ a[0], a[1], a[2], a[3] }; }
INSIDE void qstore(hg_lanes *to, quat a) { to[0] = a.w, to[1] = a.x, to[2] = a.y, to[3] = a.z; }
INSIDE quat qplus(quat a, quat b) { return (quat){ a.w + b.w, a.x + b.x, a.y + b.y, a.z + b.z }; }
INSIDE quat qminus(quat a, quat b) { return (quat){ a.w - b.w, a.x - b.x, a.y - b.y, a.z - b.z }; }
INSIDE quat qtimes(quat a, hg_lanes s) { return (quat){ a.w * s, a.x * s, a.y * s, a.z * s }; }
INSIDE quat conjugate(quat a) { return (quat){ a.w, -a.x, -a.y, -a.z }; }
INSIDE hg_lanes qdot(quat a, quat b) { return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z; }
INSIDE quat product(quat a, quat b)
{
    return (quat){ a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                   a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w };
}
/* Length one; what has no length stays as it was. */
INSIDE quat unit(quat a, quat otherwise)
{
    const hg_lanes square = qdot(a, a);
    const mask there = square > 1e-30;
    const hg_lanes scale = 1 / root(choose(there, square, square - square + 1));
    const quat u = qtimes(a, scale);
    return (quat){ choose(there, u.w, otherwise.w), choose(there, u.x, otherwise.x), choose(there, u.y, otherwise.y),
                   choose(there, u.z, otherwise.z) };
}

/* The direction of an edge, rotate(q, e3), and 2 f q e3: how a force f on -direction turns q. */
INSIDE vec direction(quat q)
{
    return (vec){ 2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x),
                  q.w * q.w - q.x * q.x - q.y * q.y + q.z * q.z };
}
INSIDE quat turning(vec f, quat q)
{
    const quat fq = product((quat){ f.x - f.x, f.x, f.y, f.z }, q);
    return qtimes((quat){ -fq.z, fq.y, -fq.x, fq.w }, (fq.w - fq.w) + 2);
}

/* ---- constraints: a change of the multiplier, and what it does --------------------------------------------------- */

INSIDE void shear(const hg_xpbd_tile *t, int64_t i, hg_lanes h2)
{
    const hg_lanes *w = t->weight + i, inverse = t->over_length[i], kappa = t->shear[i] * h2;
    vec a = load(t->x + 3 * i), b = load(t->x + 3 * i + 3), force = load(t->shear_force + 3 * i);
    const quat q = qload(t->q + 4 * i);
    const vec strain = minus(times(minus(b, a), inverse), direction(q));
    const hg_lanes d = (w[0] + w[1]) * inverse * inverse + 4 * t->q_weight[i], scale = -1 / (kappa * d + 1);
    const vec change = times(plus(times(strain, kappa), force), scale);
    store(t->shear_force + 3 * i, plus(force, change));
    store(t->x + 3 * i, minus(a, times(change, w[0] * inverse)));
    store(t->x + 3 * i + 3, plus(b, times(change, w[1] * inverse)));
    qstore(t->q + 4 * i, unit(qplus(q, qtimes(turning(change, q), t->q_weight[i])), q));
}

/* Of the pair (i - 1, i): conj(p) q against r0, with the sign that is nearer. */
INSIDE void bend(const hg_xpbd *s, const hg_xpbd_tile *t, int64_t i, hg_lanes h2)
{
    const hg_lanes kappa = t->bend[i] * h2, about = s->twist * kappa, wp = i ? t->q_weight[i - 1] : kappa - kappa,
                   wq = t->q_weight[i];
    const quat p = i ? qload(t->q + 4 * i - 4) : qload(t->root), q = qload(t->q + 4 * i), r0 = qload(t->rest + 4 * i);
    const quat r = product(conjugate(p), q), force = qload(t->bend_force + 4 * i);
    const hg_lanes one = kappa - kappa + 1, sign = choose(qdot(r, r0) < 0, -one, one);
    quat strain = qminus(qtimes(r, sign), r0);
    if (!s->smooth) strain.w = kappa - kappa;
    const hg_lanes scale = -1 / (kappa * (wp + wq) + 1);
    quat change = qtimes(qplus(qtimes(strain, kappa), force), scale);
    change.z = -(about * strain.z + force.z) / (about * (wp + wq) + 1);
    const quat turned = qtimes(change, sign);
    qstore(t->bend_force + 4 * i, qplus(force, change));
    if (i) qstore(t->q + 4 * i - 4, unit(qplus(p, qtimes(product(q, conjugate(turned)), wp)), p));
    qstore(t->q + 4 * i, unit(qplus(q, qtimes(product(p, turned), wq)), q));
}

/* k max(D - d, 0)^3 as a spring of stiffness 3 k depth, which has the same force; its stiffness doubles on the way in. */
INSIDE void contact(const hg_xpbd_tile *t, int64_t v, hg_lanes h2, double stiffness)
{
    const hg_lanes w = t->weight[v], force = t->contact_force[v];
    const vec x = load(t->x + 3 * v), n = load(t->normal + 3 * v);
    const hg_lanes depth = positive(t->clearance[v] + t->offset[v] - dot(n, x)), kappa = 3 * stiffness * h2 * depth;
    const hg_lanes wanted = force + (kappa * depth - force) / (2 * kappa * w + 1), change = positive(wanted) - force;
    t->contact_force[v] = force + change;
    store(t->x + 3 * v, plus(x, times(n, w * change)));
}

INSIDE void style(const hg_xpbd_tile *t, int64_t v, hg_lanes h2)
{
    const hg_lanes w = t->weight[v], kappa = t->style[v] * h2;
    const vec x = load(t->x + 3 * v), force = load(t->style_force + 3 * v);
    const vec off = minus(x, load(t->posed + 3 * v));
    const vec change = times(plus(times(off, kappa), force), -1 / (kappa * w + 1));
    store(t->style_force + 3 * v, plus(force, change));
    store(t->x + 3 * v, plus(x, times(change, w)));
}

/* ---- a substep --------------------------------------------------------------------------------------------------- */

/* From one orientation to another, the short way. */
INSIDE quat turned(quat from, quat to, double part)
{
    const hg_lanes zero = to.w - to.w, sign = choose(qdot(from, to) < 0, zero - 1, zero + 1);
    return part < 1 ? unit(qplus(qtimes(from, zero + (1 - part)), qtimes(to, sign * part)), to) : to;
}

/* slowed, h2: what velocity and gravity act for, h and h^2 but for drag. */
INSIDE void predict(const hg_xpbd *s, const hg_xpbd_tile *t, double part, double h, double slowed, hg_lanes h2,
                    bool dynamic)
{
    for (int64_t v = 0; v < s->V; v++) {
        const vec x = load(t->x + 3 * v);
        store(t->before + 3 * v, x);
        if (v < s->pinned) {
            const vec from = load(t->pin + 3 * v), to = load(t->pin_to + 3 * v);
            store(t->x + 3 * v, part < 1 ? plus(from, times(minus(to, from), to.x - to.x + part)) : to);
            continue;
        }
        const vec fall = { h2 * s->gravity[0], h2 * s->gravity[1], h2 * s->gravity[2] };
        const vec way = dynamic ? times(load(t->velocity + 3 * v), x.x - x.x + slowed) : minus(x, x);
        store(t->x + 3 * v, plus(x, plus(way, fall)));
    }
    qstore(t->root, turned(qload(t->root_pin), qload(t->root_pin_to), part));
    for (int64_t i = 0; i < s->E; i++) {
        const quat q = qload(t->q + 4 * i);
        qstore(t->q_before + 4 * i, q);
        if (i + 1 < s->pinned) {
            qstore(t->q + 4 * i, turned(qload(t->q_pin + 4 * i), qload(t->q_pin_to + 4 * i), part));
        } else if (dynamic) {
            qstore(t->q + 4 * i, unit(qplus(q, qtimes(qload(t->q_velocity + 4 * i), q.w - q.w + h)), q));
        }
    }
}

static void forget(const hg_xpbd *s, const hg_xpbd_tile *t)
{
    const size_t V = (size_t)s->V, E = (size_t)s->E;
    memset(t->shear_force, 0, 3 * E * sizeof(hg_lanes));
    memset(t->bend_force, 0, 4 * E * sizeof(hg_lanes));
    memset(t->style_force, 0, 3 * V * sizeof(hg_lanes));
    memset(t->contact_force, 0, V * sizeof(hg_lanes));
}

/* From root to tip, then back. */
INSIDE void sweep(const hg_xpbd *s, const hg_xpbd_tile *t, hg_lanes h2, bool back)
{
    const int64_t E = s->E;
    for (int64_t k = 0; k < E; k++) {
        const int64_t i = back ? E - 1 - k : k;
        if (!back) bend(s, t, i, h2);
        shear(t, i, h2);
        if (back) bend(s, t, i, h2);
        if (s->contact) contact(t, i + 1, h2, s->contact_stiffness);
        if (s->styled) style(t, i + 1, h2);
    }
}

/* ---- all constraints of a strand at once ------------------------------------------------------------------------- */

/* Of the edge i and the vertex at its end: a turn d q_i (a rotation vector of the world) and a way of x_{i+1}. */
enum { OF = HG_XPBD_BLOCK };
typedef struct {
    hg_lanes own[OF][OF]; /* of the block, lower triangle; then its Cholesky factor */
    hg_lanes across[OF]
                   [OF]; /* [row of the block before][row of this one]; then solved by the factor of the block before */
    hg_lanes force[OF];  /* then the step */
} block;

INSIDE vec cross(vec a, vec b) { return (vec){ a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x }; }
INSIDE vec rotated(quat q, vec a)
{
    const vec u = { q.x, q.y, q.z }, t = cross(plus(u, u), a);
    return plus(plus(a, times(t, q.w)), cross(u, t));
}

/* own[at..] += scale (1 - sigma a a^T), and a little more: a strand that may turn about itself has nothing that resists. */
INSIDE void add_projection(block *b, int at, hg_lanes scale, hg_lanes sigma, vec a)
{
    const hg_lanes c[3] = { a.x, a.y, a.z };
    for (int r = 0; r < 3; r++)
        for (int k = 0; k <= r; k++)
            b->own[at + r][at + k] += (r == k ? scale * (1 + 1e-10) : scale - scale) - scale * sigma * c[r] * c[k];
}

/* own[at..] += scale a a^T */
INSIDE void add_outer(block *b, int at, hg_lanes scale, vec a)
{
    const hg_lanes c[3] = { a.x, a.y, a.z };
    for (int r = 0; r < 3; r++)
        for (int k = 0; k <= r; k++) b->own[at + r][at + k] += scale * c[r] * c[k];
}

INSIDE void add_force(block *b, int at, vec f)
{
    b->force[at] += f.x, b->force[at + 1] += f.y, b->force[at + 2] += f.z;
}

/* Inertia of the block, contact and style at its vertex; sets everything. */
INSIDE void begin_block(const hg_xpbd *s, const hg_xpbd_tile *t, int64_t i, hg_lanes over_h2, block *b)
{
    const int64_t v = i + 1;
    const hg_lanes turn = over_h2 / (4 * t->q_weight[i]);
    memset(b, 0, sizeof *b);
    const quat q = qload(t->q + 4 * i), off = product(q, conjugate(qload(t->q_aim + 4 * i)));
    const vec x = load(t->x + 3 * v);
    hg_lanes mass = over_h2 / t->weight[v];
    add_force(b, 0, times((vec){ off.x, off.y, off.z }, -2 * turn * off.w));
    add_force(b, 3, times(minus(x, load(t->aim + 3 * v)), -mass));
    if (s->styled) {
        mass += t->style[v];
        add_force(b, 3, times(minus(x, load(t->posed + 3 * v)), -t->style[v]));
    }
    for (int c = 0; c < 3; c++) b->own[c][c] = turn, b->own[3 + c][3 + c] = mass;
    if (!s->contact) return;
    const vec n = load(t->normal + 3 * v);
    const hg_lanes depth = positive(t->clearance[v] + t->offset[v] - dot(n, x)), k = 3 * s->contact_stiffness * depth;
    add_outer(b, 3, 2 * k, n);
    add_force(b, 3, times(n, k * depth));
}

/* Stretch-shear of edge i, with the stiffness that tension gives to its direction; `before`: NULL where its first vertex is held. */
INSIDE void add_shear(const hg_xpbd_tile *t, int64_t i, block *before, block *b)
{
    const hg_lanes inverse = t->over_length[i], k = t->shear[i];
    const vec d = direction(qload(t->q + 4 * i));
    const vec strain = minus(times(minus(load(t->x + 3 * i + 3), load(t->x + 3 * i)), inverse), d);
    const vec pull = times(strain, k * inverse);
    add_projection(b, 0, k + positive(k * dot(strain, d)), inverse - inverse + 1, d);
    add_force(b, 0, times(cross(d, strain), k));
    add_force(b, 3, times(pull, inverse - inverse - 1));
    const hg_lanes coupling = k * inverse, along = coupling * inverse;
    const hg_lanes skew[3][3] = { { d.x - d.x, -d.z, d.y }, { d.z, d.x - d.x, -d.x }, { -d.y, d.x, d.x - d.x } };
    for (int c = 0; c < 3; c++) b->own[3 + c][3 + c] += along;
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) b->own[3 + r][c] += coupling * skew[r][c];
    if (!before) return;
    add_force(before, 3, pull);
    for (int c = 0; c < 3; c++) before->own[3 + c][3 + c] += along, b->across[3 + c][3 + c] = -along;
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) b->across[3 + r][c] = -coupling * skew[r][c];
}

INSIDE void add_bend(const hg_xpbd *s, const hg_xpbd_tile *t, int64_t i, block *before, block *b)
{
    const hg_lanes k = t->bend[i], one = k - k + 1;
    const quat p = i ? qload(t->q + 4 * i - 4) : qload(t->root), q = qload(t->q + 4 * i), r0 = qload(t->rest + 4 * i);
    quat r = product(conjugate(p), q);
    r = qtimes(r, choose(qdot(r, r0) < 0, -one, one));
    const quat strain = qminus(r, r0);
    const vec im = { strain.x, strain.y, s->twist * strain.z }, v = { r.x, r.y, r.z };
    vec turn = plus(times(im, r.w), cross(v, im));
    if (s->smooth) turn = minus(turn, times(v, strain.w));
    turn = rotated(p, times(turn, -0.5 * k));
    const vec axis = rotated(p, v), about = rotated(p, (vec){ r.y, -r.x, r.w }); /* how twist changes with the turn */
    const hg_lanes sigma = s->smooth ? one - one : one, quarter = 0.25 * k;
    const hg_lanes twist = (s->twist - 1) * quarter;
    add_projection(b, 0, quarter, sigma, axis);
    add_outer(b, 0, twist, about);
    add_force(b, 0, turn);
    if (!before) return;
    add_projection(before, 0, quarter, sigma, axis);
    add_outer(before, 0, twist, about);
    add_force(before, 0, times(turn, -one));
    const hg_lanes c[3] = { axis.x, axis.y, axis.z }, a[3] = { about.x, about.y, about.z };
    for (int row = 0; row < 3; row++)
        for (int col = 0; col < 3; col++)
            b->across[row][col] -=
                (row == col ? quarter : one - one) - quarter * sigma * c[row] * c[col] + twist * a[row] * a[col];
}

/* own = L L^T; force = L^-1 force */
INSIDE void factorise(block *b)
{
    for (int c = 0; c < OF; c++) {
        for (int r = c; r < OF; r++)
            for (int k = 0; k < c; k++) b->own[r][c] -= b->own[r][k] * b->own[c][k];
        const hg_lanes inverse = 1 / root(b->own[c][c]);
        for (int r = c + 1; r < OF; r++) b->own[r][c] *= inverse;
        b->own[c][c] = inverse; /* what is needed of it */
        for (int k = 0; k < c; k++) b->force[c] -= b->own[c][k] * b->force[k];
        b->force[c] *= inverse;
    }
}

INSIDE void eliminate(const block *before, block *b)
{
    for (int col = 0; col < OF; col++)
        for (int r = 0; r < OF; r++) {
            for (int k = 0; k < r; k++) b->across[r][col] -= before->own[r][k] * b->across[k][col];
            b->across[r][col] *= before->own[r][r];
        }
    for (int r = 0; r < OF; r++) {
        for (int k = 0; k < OF; k++) b->force[r] -= b->across[k][r] * before->force[k];
        for (int c = 0; c <= r; c++)
            for (int k = 0; k < OF; k++) b->own[r][c] -= b->across[k][r] * b->across[k][c];
    }
}

/* What the substep minimises: |x - aim|^2 / (2 w h^2) and all constraints. No term of it is negative. */
INSIDE hg_lanes energy_of(const hg_xpbd *s, const hg_xpbd_tile *t, hg_lanes over_h2)
{
    hg_lanes sum = t->pace[0] - t->pace[0];
    for (int64_t i = s->pinned - 1; i < s->E; i++) {
        const int64_t v = i + 1;
        const quat p = i ? qload(t->q + 4 * i - 4) : qload(t->root), q = qload(t->q + 4 * i);
        const quat r0 = qload(t->rest + 4 * i), off = product(q, conjugate(qload(t->q_aim + 4 * i)));
        const vec x = load(t->x + 3 * v), way = minus(x, load(t->aim + 3 * v)), turn = { off.x, off.y, off.z };
        const vec shear = minus(times(minus(x, load(t->x + 3 * i)), t->over_length[i]), direction(q));
        const quat r = product(conjugate(p), q);
        const hg_lanes one = sum - sum + 1;
        quat bend = qminus(qtimes(r, choose(qdot(r, r0) < 0, -one, one)), r0);
        if (!s->smooth) bend.w = one - one;
        sum += 0.5 * over_h2 * (dot(way, way) / t->weight[v] + dot(turn, turn) / t->q_weight[i]);
        sum += 0.5 *
               (t->shear[i] * dot(shear, shear) + t->bend[i] * (qdot(bend, bend) + (s->twist - 1) * bend.z * bend.z));
        if (s->contact) {
            const hg_lanes depth = positive(t->clearance[v] + t->offset[v] - dot(load(t->normal + 3 * v), x));
            sum += s->contact_stiffness * depth * depth * depth;
        }
        if (s->styled) {
            const vec away = minus(x, load(t->posed + 3 * v));
            sum += 0.5 * t->style[v] * dot(away, away);
        }
    }
    return sum;
}

/* From where the step began, a part of it. */
INSIDE void go(const hg_xpbd *s, const hg_xpbd_tile *t, const block *blocks, hg_lanes part)
{
    for (int64_t i = s->pinned - 1; i < s->E; i++) {
        const vec turn = times(load(blocks[i].force), 0.5 * part), way = times(load(blocks[i].force + 3), part);
        const quat q = qload(t->q_from + 4 * i);
        qstore(t->q + 4 * i, unit(qplus(q, product((quat){ part - part, turn.x, turn.y, turn.z }, q)), q));
        store(t->x + 3 * i + 3, plus(load(t->from + 3 * i + 3), way));
    }
}

/* A Newton step, as long as the energy of the substep sinks; the longest turn of an edge in it is half a
 * radian, and with a body no vertex goes farther than contact reaches. */
INSIDE void solve(const hg_xpbd *s, const hg_xpbd_tile *t, hg_lanes h2)
{
    enum { HALVINGS = 12 };
    const int64_t E = s->E, first = s->pinned - 1, size = (int64_t)(sizeof(block) / sizeof(hg_lanes));
    block *blocks = (block *)(void *)(s->scratch + hg_worker() * E * size);
    hg_lanes longest = t->pace[0] - t->pace[0];
    if (E <= first) return;
    for (int64_t i = first; i < E; i++) {
        block *b = blocks + i, *before = i > first ? b - 1 : NULL;
        begin_block(s, t, i, 1 / h2, b);
        add_shear(t, i, before, b);
        add_bend(s, t, i, before, b);
        if (!before) continue;
        factorise(before);
        eliminate(before, b);
    }
    factorise(blocks + E - 1);
    for (int64_t i = E - 1; i >= first; i--) {
        block *b = blocks + i;
        for (int r = OF - 1; r >= 0; r--) {
            for (int k = 0; i + 1 < E && k < OF; k++) b->force[r] -= b[1].across[r][k] * b[1].force[k];
            for (int k = r + 1; k < OF; k++) b->force[r] -= b->own[k][r] * b->force[k];
            b->force[r] *= b->own[r][r];
        }
        const hg_lanes turn = dot(load(b->force), load(b->force));
        longest = choose(turn > longest, turn, longest);
        if (!s->contact) continue;
        const hg_lanes way =
            dot(load(b->force + 3), load(b->force + 3)) * (0.25 / (s->contact_distance * s->contact_distance));
        longest = choose(way > longest, way, longest);
    }
    const hg_lanes before = energy_of(s, t, 1 / h2), limit = before * (1 + 1e-13), none = before - before;
    hg_lanes part = 0.5 / root(choose(longest > 0.25, longest, none + 0.25));
    memcpy(t->from, t->x, (size_t)(3 * s->V) * sizeof *t->x);
    memcpy(t->q_from, t->q, (size_t)(4 * E) * sizeof *t->q);
    for (int k = 0; k <= HALVINGS; k++) {
        go(s, t, blocks, part);
        if (k == HALVINGS) break;
        const mask sinks = energy_of(s, t, 1 / h2) <= limit;
        bool all = true;
        for (int l = 0; l < HG_XPBD_LANES; l++) all = all && sinks[l];
        if (all) break;
        part = choose(sinks, part, k + 2 < HALVINGS ? 0.5 * part : none);
    }
}

/* Newton's steps begin where the strand is without the push of gravity: a long substep would throw it far. */
INSIDE void aim(const hg_xpbd *s, const hg_xpbd_tile *t, hg_lanes h2)
{
    memcpy(t->aim, t->x, (size_t)(3 * s->V) * sizeof *t->x);
    memcpy(t->q_aim, t->q, (size_t)(4 * s->E) * sizeof *t->q);
    for (int64_t v = s->pinned; v < s->V; v++)
        for (int c = 0; c < 3; c++) t->x[3 * v + c] -= h2 * s->gravity[c];
}

INSIDE void velocities(const hg_xpbd *s, const hg_xpbd_tile *t, double h)
{
    const double rate = 1 / h;
    for (int64_t k = 0; k < 3 * s->V; k++) t->velocity[k] = (t->x[k] - t->before[k]) * rate;
    for (int64_t i = 0; i < s->E; i++) { /* q and -q are one orientation */
        const quat q = qload(t->q + 4 * i), before = qload(t->q_before + 4 * i);
        const hg_lanes zero = q.w - q.w, sign = choose(qdot(q, before) < 0, zero - 1, zero + 1);
        qstore(t->q_velocity + 4 * i, qtimes(qminus(q, qtimes(before, sign)), zero + rate));
    }
}

static void keep(hg_lanes *to, const hg_lanes *from, int64_t n, mask where)
{
    for (int64_t k = 0; k < n; k++) to[k] = choose(where, from[k], to[k]);
}

/* On its way to rest a strand takes longer steps as long as its energy sinks. Contact is found between steps: where the energy
 * rises with the new planes, the strand goes back to where it was, with the planes of then, and takes a shorter one. */
static void find_pace(const hg_xpbd *s, const hg_xpbd_tile *t)
{
    const hg_lanes none = t->pace[0] - t->pace[0];
    hg_lanes energy = energy_of(s, t, none), size = energy;
    for (int64_t v = s->pinned; v < s->V; v++)
        for (int c = 0; c < 3; c++) {
            const hg_lanes g = (s->gravity[c] / t->weight[v]) * (t->x[3 * v + c] - t->posed[3 * v + c]);
            energy -= g;
            size += choose(g < 0, -g, g);
        }
    const mask high = t->pace[0] > (s->neighbours ? PACE_LEAST : PACE_MOST), low = t->pace[0] < PACE_LEAST;
    mask sank = energy <= t->energy[0] + 1e-13 * size;
    if (s->neighbours) sank |= ~sank; /* what was pushed apart does not go back, and not far */
    const mask sinks = sank | low, back = ~sinks;
    t->pace[0] = choose(sank, choose(high, t->pace[0], 1.5 * t->pace[0]), choose(low, t->pace[0], 0.25 * t->pace[0]));
    keep(t->energy, &energy, 1, sinks);
    keep(t->x, t->good_x, 3 * s->V, back);
    keep(t->good_x, t->x, 3 * s->V, sinks);
    keep(t->q, t->good_q, 4 * s->E, back);
    keep(t->good_q, t->q, 4 * s->E, sinks);
    if (!s->contact) return;
    keep(t->normal, t->good_normal, 3 * s->V, back);
    keep(t->good_normal, t->normal, 3 * s->V, sinks);
    keep(t->offset, t->good_offset, s->V, back);
    keep(t->good_offset, t->offset, s->V, sinks);
}

/* ---- tiles ------------------------------------------------------------------------------------------------------- */

/* Searches see strands one after another. */
static void gather(const hg_xpbd *s, const hg_xpbd_tile *t, int64_t tile)
{
    for (int l = 0; l < HG_XPBD_LANES; l++) {
        const int64_t strand = hg_xpbd_strand(s, tile, l);
        const double *a = s->contact_point + strand * s->V * 3, *n = s->contact_normal + strand * s->V * 3;
        for (int64_t v = 0; s->contact && v < s->V; v++) {
            for (int c = 0; c < 3; c++) t->normal[3 * v + c][l] = n[3 * v + c];
            t->offset[v][l] = n[3 * v] * a[3 * v] + n[3 * v + 1] * a[3 * v + 1] + n[3 * v + 2] * a[3 * v + 2];
        }
        for (int64_t k = 0; s->neighbours && k < 3 * s->V; k++) /* they were pushed apart */
            t->x[k][l] = s->points[strand * s->V * 3 + k];
    }
}

static void scatter(const hg_xpbd *s, const hg_xpbd_tile *t, int64_t tile)
{
    for (int l = 0; l < HG_XPBD_LANES && tile * HG_XPBD_LANES + l < s->S; l++) {
        const int64_t strand = tile * HG_XPBD_LANES + l;
        for (int64_t k = 0; k < 3 * s->V; k++) s->points[strand * s->V * 3 + k] = t->x[k][l];
        for (int64_t k = 0; k < 4 * s->E; k++) s->orientation[strand * s->E * 4 + k] = t->q[k][l];
        s->moved[strand] = t->moved[0][l];
    }
}

static bool at_rest(const hg_xpbd *s, const hg_xpbd_tile *t)
{
    const double limit = s->options.movement * s->options.movement;
    bool all = true;
    for (int l = 0; l < HG_XPBD_LANES; l++) all = all && t->moved[0][l] < limit;
    return all;
}

static void run_tile(const hg_xpbd_run *run, int64_t tile)
{
    const hg_xpbd *s = run->solver;
    const double h = run->h, slowed = run->dynamic ? 1 / (1 + s->drag * h) : 1;
    const bool paced = !run->dynamic && !s->options.sweeps;
    hg_xpbd_tile t;
    hg_xpbd_tile_at(s, tile, &t);
    if (paced && !s->neighbours && at_rest(s, &t)) return;
    gather(s, &t, tile);
    if (paced) find_pace(s, &t);
    if (run->first == 0) memcpy(t.start, t.x, (size_t)(3 * s->V) * sizeof *t.x);
    for (int sub = run->first; sub < run->last; sub++) {
        hg_lanes h2 = t.pace[0] - t.pace[0] + h * h * slowed;
        if (paced) h2 *= t.pace[0];
        predict(s, &t, (sub + 1) / (double)run->substeps, h, h * slowed, h2, run->dynamic);
        if (s->options.sweeps) {
            forget(s, &t);
            for (int k = 0; k < s->options.iterations; k++) sweep(s, &t, h2, k & 1);
        } else {
            aim(s, &t, h2);
            for (int k = 0; k < s->options.iterations; k++) solve(s, &t, h2);
        }
        if (run->dynamic) velocities(s, &t, h);
    }
    hg_lanes longest = t.x[0] - t.x[0];
    if (run->first == run->last) longest = t.moved[0];
    for (int64_t v = s->pinned; run->first < run->last && v < s->V; v++) {
        const vec way = minus(load(t.x + 3 * v), load(t.start + 3 * v));
        const hg_lanes square = dot(way, way);
        longest = choose(square <= longest, longest, square); /* and what is not a number */
    }
    if (paced && run->first < run->last)
        longest = choose(t.pace[0] < 1, longest / (t.pace[0] * t.pace[0]), longest); /* slow is not at rest */
    t.moved[0] = longest;
    scatter(s, &t, tile);
}

static void run_range(const void *args, int64_t first, int64_t last)
{
    for (int64_t tile = first; tile < last; tile++) run_tile(args, tile);
}

hg_status hg_xpbd_run_tiles(const hg_xpbd_run *run)
{
    static const hg_kernel kernel = { .name = "xpbd", .args_size = sizeof(hg_xpbd_run), .cpu = run_range, .block = 1 };
    return hg_launch(run->solver->ctx, &kernel, run->solver->tiles, run);
}
