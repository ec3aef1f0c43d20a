/* Procedural motions: nods, turns, shakes, walking, jumps. Angles are sums of a few sines under smooth windows, so that
 * they are band-limited; a clip starts and ends at rest. The speeds are those of recorded people: the head turns with a
 * median of 20 to 80 degrees per second, and up to 300 to 450 in a shake or a fast turn. */
#include "scene/internal.h"

#include <string.h>

#define DEGREE  (SCENE_PI / 180)
#define GRAVITY 9.81

/* Where the body is at one time: the turn of the head against the chest, that of the chest against the hips (rotation
 * vectors), and the way of the hips. */
typedef struct {
    hg_vec3d head, chest, way;
} gesture;

/* Random numbers of one gesture: the same seed and stream give the same ones. */
typedef struct {
    uint64_t seed, stream;
} draw;

static double uniform(draw d, uint64_t i, double low, double high)
{
    return low + (high - low) * hg_random_uniform(d.seed, d.stream, i);
}

/* ---- windows ------------------------------------------------------------------------------------------------ */

/* 0 outside [0, length], 1 inside, ramps of `soft` seconds. */
static double window(double t, double length, double soft)
{
    soft = fmin(soft, 0.5 * length);
    return scene_ramp(0, soft, t) * (1 - scene_ramp(length - soft, length, t));
}

/* Bursts: on for some of every period, softly. People hold still between two movements. */
static double bursts(draw d, double t, double period, double on)
{
    double k = floor(t / period), start = uniform(d, 100 + (uint64_t)fmax(k, 0), 0, period - on);
    return window(t - k * period - start, on, 0.4 * on);
}

/* Three sines about `frequency`, with the amplitudes 1, 0.4, 0.25 and some phase. */
static double sines(draw d, uint64_t i, double t, double frequency)
{
    static const double amplitude[3] = { 1, 0.4, 0.25 }, ratio[3] = { 1, 0.53, 1.37 };
    double sum = 0;
    for (uint64_t k = 0; k < 3; k++) {
        double f = frequency * ratio[k] * uniform(d, i + 10 * k, 0.9, 1.1),
               phase = uniform(d, i + 10 * k + 5, 0, 2 * SCENE_PI);
        sum += amplitude[k] * sin(2 * SCENE_PI * f * t + phase);
    }
    return sum / 1.3;
}

/* ---- gestures ----------------------------------------------------------------------------------------------- */

/* Movements that never stop: balance, and looking about. */
static void sway(draw d, double t, gesture *g)
{
    g->head.x += 5 * DEGREE * sines(d, 40, t, 0.5);
    g->head.y += 9 * DEGREE * sines(d, 41, t, 0.45);
    g->head.z += 4 * DEGREE * sines(d, 42, t, 0.4);
    g->chest.x += 1 * DEGREE * sines(d, 43, t, 0.3);
    g->chest.z += 1 * DEGREE * sines(d, 44, t, 0.2);
    g->way.x += 0.006 * sines(d, 45, t, 0.25);
}

static void nod(draw d, double t, gesture *g)
{
    double on = bursts(d, t, 3, uniform(d, 0, 2, 2.6));
    sway(d, t, g);
    g->head.x += on * uniform(d, 1, 18, 26) * DEGREE * sines(d, 2, t, uniform(d, 3, 0.8, 1.2));
    g->head.x += uniform(d, 4, 4, 12) * DEGREE * scene_ramp(0, 1.5, t);
    g->chest.x += on * 3 * DEGREE * sines(d, 2, t, uniform(d, 3, 0.8, 1.2));
}

/* From one side to another, quickly, and looking there for a while. */
static void turn(draw d, double t, gesture *g)
{
    double period = uniform(d, 0, 1.0, 1.3), k = floor(t / period), at = t - k * period;
    double from = k > 0 ? uniform(d, 200 + (uint64_t)k, 25, 65) : 0,
           to = uniform(d, 201 + (uint64_t)fmax(k, 0), 25, 65);
    double side = fmod(k, 2) == 0 ? 1 : -1, lasts = uniform(d, 300 + (uint64_t)fmax(k, 0), 0.5, 0.85);
    double yaw = -side * from + side * (from + to) * scene_ramp(0, lasts, at);
    sway(d, t, g);
    g->head.y += yaw * DEGREE;
    g->head.x += 0.12 * fabs(yaw) * DEGREE;
    g->chest.y += 0.12 * yaw * DEGREE;
}

static void shake(draw d, double t, gesture *g)
{
    double on = bursts(d, t, 2.8, uniform(d, 0, 1.9, 2.4));
    double frequency = uniform(d, 1, 1.5, 2.1), speed = uniform(d, 2, 280, 350);
    double amplitude = speed / (2 * SCENE_PI * frequency);
    sway(d, t, g);
    g->head.y += on * amplitude * DEGREE * sines(d, 3, t, frequency);
    g->head.z += on * 0.15 * amplitude * DEGREE * sines(d, 4, t, frequency);
    g->chest.y += on * 0.1 * amplitude * DEGREE * sines(d, 3, t, frequency);
}

/* On the spot: two bobs and one sway of the hips in a stride, the chest against the hips, the head nearly steady. */
static void walk(draw d, double t, gesture *g)
{
    double stride = uniform(d, 0, 0.85, 1.05), pace = scene_ramp(0, 1.2, t);
    double a = 2 * SCENE_PI * stride * t, bob = uniform(d, 1, 0.018, 0.028);
    sway(d, t, g);
    g->way.y += pace * bob * (cos(2 * a) - 1);
    g->way.x += pace * 0.02 * sin(a);
    g->way.z += pace * 0.012 * sin(2 * a + 0.7);
    g->chest.y += pace * 7 * DEGREE * sin(a + 0.3);
    g->chest.z += pace * 3 * DEGREE * sin(a);
    g->chest.x += pace * (3 + 1.5 * sin(2 * a + 1)) * DEGREE;
    g->head.y -= pace * 5 * DEGREE * sin(a + 0.3);
    g->head.x += pace * 2.5 * DEGREE * sin(2 * a + 2);
    g->head.y += pace * bursts(d, t, 3.4, 2) * 22 * DEGREE * sines(d, 2, t, 0.6);
}

/* The height of somebody who moves from height a with speed va to height b with speed vb, no pull at either end. */
static double quintic(double a, double va, double b, double vb, double lasts, double t)
{
    double u = fmin(fmax(t / lasts, 0), 1), d = b - a, p = va * lasts, q = vb * lasts;
    return a +
           u * (p + u * u * ((10 * d - 6 * p - 4 * q) + u * (-15 * d + 8 * p + 7 * q + u * (6 * d - 3 * p - 3 * q))));
}

/* Crouch, push off, fly as gravity has it, land, rise: one jump in a period. */
static void jump(draw d, double t, gesture *g)
{
    enum { PERIOD = 3 };
    double k = fmax(floor(t / PERIOD), 0), at = t - k * PERIOD - uniform(d, 400 + (uint64_t)k, 0.2, 0.6);
    double speed = uniform(d, 500 + (uint64_t)k, 1.5, 2.2), depth = 0.09 * speed, crouch = 0.5, push = 0.2, land = 0.24;
    double flight = 2 * speed / GRAVITY, y = 0, bend = 0;
    sway(d, t, g);
    if (at < 0) {
        y = 0;
    } else if (at < crouch) {
        y = -depth * scene_ramp(0, crouch, at), bend = scene_ramp(0, crouch, at);
    } else if ((at -= crouch) < push) {
        y = quintic(-depth, 0, 0, speed, push, at), bend = 1 - scene_ramp(0, push, at);
    } else if ((at -= push) < flight) {
        y = at * (speed - 0.5 * GRAVITY * at);
    } else if ((at -= flight) < land) {
        y = quintic(0, -speed, -0.8 * depth, 0, land, at), bend = 0.8 * scene_ramp(0, land, at);
    } else {
        at -= land;
        y = -0.8 * depth * (1 - scene_ramp(0, 0.6, at)), bend = 0.8 * (1 - scene_ramp(0, 0.6, at));
    }
    g->way.y += y;
    g->way.z -= 0.03 * bend;
    g->chest.x += 22 * DEGREE * bend;
    g->head.x -= 10 * DEGREE * bend;
}

typedef struct {
    const char *name;
    void (*at)(draw d, double t, gesture *g);
} gesture_kind;

static const gesture_kind gestures[] = {
    { "nod", nod }, { "turn", turn }, { "shake", shake }, { "walk", walk }, { "jump", jump }
};

enum { GESTURES = sizeof gestures / sizeof *gestures };

/* ---- on a rig ----------------------------------------------------------------------------------------------- */

/* How much of the head's turn against the chest, and of the chest's against the hips, each joint takes. */
static const struct {
    const char *joint;
    double head, chest;
} shares[] = { { "LowerBack", 0, 0.3 }, { "Spine", 0, 0.35 }, { "Spine1", 0, 0.35 },
               { "Neck", 0.25, 0 },     { "Neck1", 0.3, 0 },  { "Head", 0.45, 0 } };

enum { SHARES = sizeof shares / sizeof *shares, SEGMENT = 6 };

/* Windowed to be at rest at both ends. A mixed clip is one kind after another. */
static gesture gesture_at(int kind, uint64_t seed, double t, double seconds)
{
    gesture g = { 0 };
    double length = seconds, weight;
    uint64_t segment = 0;
    if (kind == GESTURES) {
        double n = fmax(floor(seconds / SEGMENT), 1);
        length = seconds / n;
        segment = (uint64_t)fmin(floor(t / length), n - 1);
        t -= (double)segment * length;
        /* every kind once in a random order before any comes again */
        int order[GESTURES] = { 0, 1, 2, 3, 4 };
        for (int i = GESTURES - 1; i > 0; i--) {
            int k = (int)hg_random_below(seed, 77 + segment / GESTURES, (uint64_t)i, (uint64_t)i + 1), held = order[i];
            order[i] = order[k], order[k] = held;
        }
        kind = order[segment % GESTURES];
    }
    gestures[kind].at((draw){ seed, 1000 + 10 * segment + (uint64_t)kind }, t, &g);
    weight = window(t, length, 0.8);
    g.head = hg_vec3d_scale(g.head, weight), g.chest = hg_vec3d_scale(g.chest, weight),
    g.way = hg_vec3d_scale(g.way, weight);
    return g;
}

hg_status hg_motion_make(hg_motion **motion, const hg_body *body, const char *kind, double seconds, double rate,
                         uint64_t seed)
{
    const char *names[GESTURES + 1];
    int index = -1, joint[SHARES];
    double head = 0, chest = 0;
    *motion = NULL;
    for (int i = 0; i <= GESTURES; i++) {
        names[i] = i < GESTURES ? gestures[i].name : "mixed";
        if (strcmp(kind, names[i]) == 0) index = i;
    }
    if (index < 0) {
        const char *near = hg_nearest_of(kind, names, GESTURES + 1);
        return hg_fail(HG_INVALID, "no motion is called \"%s\"%s%s%s: there are nod, turn, shake, walk, jump, mixed",
                       kind, near ? " (did you mean " : "", near ? near : "", near ? "?)" : "");
    }
    if (!(seconds >= 0 && seconds <= 1e5 && rate > 0 && rate <= 1e4))
        return hg_fail(HG_INVALID, "a motion of %g s at %g frames per second: both must be positive", seconds, rate);
    for (int i = 0; i < SHARES; i++) {
        joint[i] = hg_body_joint(body, shares[i].joint);
        if (joint[i] >= 0) head += shares[i].head, chest += shares[i].chest;
    }
    if (!(head > 0))
        return hg_fail(HG_INVALID, "the body has none of the joints Neck, Neck1, Head: nothing to nod with");

    int64_t frames = (int64_t)llround(seconds * rate) + 1;
    hg_motion *m;
    HG_TRY(hg_motion_create(&m, frames, body, rate));
    m->name = hg_format("%s %llu", kind, (unsigned long long)seed);
    if (!m->name) {
        hg_motion_destroy(m);
        return HG_MEMORY;
    }
    for (int64_t t = 0; t < frames; t++) {
        gesture g = gesture_at(index, seed, (double)t / rate, seconds);
        for (int i = 0; i < SHARES; i++) {
            if (joint[i] < 0) continue;
            hg_vec3d r = hg_vec3d_scale(g.head, shares[i].head / head);
            if (chest > 0) r = hg_vec3d_add_scaled(r, shares[i].chest / chest, g.chest);
            hg_quatf_store(m->rotation + 4 * (t * m->joints + joint[i]),
                           hg_quatf_from_d(hg_quatd_from_rotation_vector(r)));
        }
        scene_put(m->translation + 3 * t, g.way);
    }
    *motion = m;
    return HG_OK;
}
