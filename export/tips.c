/* Do tips lag and swing? A few tips seen from the head: each strand's tip in its root's rigid frame, where a rigidly
 * posed strand stands still, as paths from above and over time beneath the turning of the head. */
#include "export/draw.h"
#include "export/source.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define TIPS 4

static const char *const tip_name[TIPS] = { "front left", "front right", "back left", "back right" };

/* v turned by the conjugate of q (w,x,y,z): from the world into the root's frame. */
static void turn_back(const float *q, const double v[3], double out[3])
{
    double w = (double)q[0], u[3] = { -(double)q[1], -(double)q[2], -(double)q[3] };
    double c[3] = { u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0] };
    double d[3] = { u[1] * c[2] - u[2] * c[1], u[2] * c[0] - u[0] * c[2], u[0] * c[1] - u[1] * c[0] };
    for (int k = 0; k < 3; k++) out[k] = v[k] + 2.0 * (w * c[k] + d[k]);
}

static double length_of(const hg_source *s, int64_t strand)
{
    double length = 0.0;
    const float *p = s->rest + 3 * strand * s->vertices;
    for (int64_t v = 0; v + 1 < s->vertices; v++, p += 3)
        length += sqrt(pow((double)(p[3] - p[0]), 2) + pow((double)(p[4] - p[1]), 2) + pow((double)(p[5] - p[2]), 2));
    return length;
}

/* The longest strand of each diagonal of the head, within a sixth of a turn: front or back, left or right of the roots'
 * middle. -1: there is none. */
static void choose(const hg_source *s, int64_t chosen[TIPS])
{
    double middle[2] = { 0.0, 0.0 }, longest[TIPS] = { 0 };
    for (int64_t i = 0; i < s->strands; i++) {
        middle[0] += (double)s->rest[3 * i * s->vertices] / (double)s->strands;
        middle[1] += (double)s->rest[3 * i * s->vertices + 2] / (double)s->strands;
    }
    for (int k = 0; k < TIPS; k++) chosen[k] = -1;
    for (int64_t i = 0; i < s->strands; i++) {
        const float *root = s->rest + 3 * i * s->vertices;
        double left = (double)root[0] - middle[0], ahead = (double)root[2] - middle[1];
        double slant = atan2(fabs(ahead), fabs(left));
        if (hypot(left, ahead) < 0.02 || fabs(slant - 0.785) > 0.524) continue;
        int quarter = (ahead < 0.0 ? 2 : 0) + (left < 0.0 ? 1 : 0);
        double length = length_of(s, i);
        if (length > longest[quarter]) longest[quarter] = length, chosen[quarter] = i;
    }
}

typedef struct {
    int64_t n;
    int64_t strand[TIPS];
    double *time, *turning;           /* s; degrees per second about the vertical, to the left positive */
    double *side[TIPS], *ahead[TIPS]; /* cm in the head's frame: to the character's right, forwards */
    double *swing[TIPS]; /* cm that the tip is off its rigidly posed place, in the sense of a turn to the left */
    double rest_side[TIPS][1], rest_ahead[TIPS][1];
} paths;

static void paths_free(paths *p)
{
    hg_free(p->time);
    hg_free(p->turning);
    for (int k = 0; k < TIPS; k++) {
        hg_free(p->side[k]);
        hg_free(p->ahead[k]);
        hg_free(p->swing[k]);
    }
}

/* Mean heading of the roots, an angle about the vertical. */
static double heading_of(const hg_source *s)
{
    double x = 0.0, z = 0.0;
    for (int64_t i = 0; i < s->strands; i++) {
        const float *q = s->rotation + 4 * i;
        x += 2.0 * ((double)q[1] * (double)q[3] + (double)q[0] * (double)q[2]);
        z += 1.0 - 2.0 * ((double)q[1] * (double)q[1] + (double)q[2] * (double)q[2]);
    }
    return atan2(x, z);
}

/* Along the circle around the head's vertical axis, in the sense of a turn to the left. */
static double swing_of(double side, double ahead, double rest_side, double rest_ahead, const double middle[2])
{
    double x = rest_side - middle[0], z = rest_ahead - middle[1], radius = hypot(x, z);
    if (radius < 1.0) return side - rest_side;
    return (-z * (side - rest_side) + x * (ahead - rest_ahead)) / radius;
}

static hg_status follow(hg_source *s, paths *p)
{
    size_t n = (size_t)s->frames;
    p->n = s->frames;
    p->time = hg_alloc(n, sizeof(double));
    p->turning = hg_alloc(n, sizeof(double));
    bool room = p->time && p->turning;
    for (int k = 0; k < TIPS; k++) {
        p->side[k] = hg_alloc(n, sizeof(double));
        p->ahead[k] = hg_alloc(n, sizeof(double));
        p->swing[k] = hg_alloc(n, sizeof(double));
        room = room && p->side[k] && p->ahead[k] && p->swing[k];
    }
    if (!room) return HG_MEMORY;
    choose(s, p->strand);
    double before = 0.0, middle[2] = { 0.0, 0.0 }; /* of the roots, to the right and forwards [cm] */
    for (int64_t i = 0; i < s->strands; i++) {
        middle[0] -= 100.0 * (double)s->rest[3 * i * s->vertices] / (double)s->strands;
        middle[1] += 100.0 * (double)s->rest[3 * i * s->vertices + 2] / (double)s->strands;
    }
    for (int64_t t = 0; t < s->frames; t++) {
        HG_TRY(hg_source_read(s, t, SOURCE_FILE));
        double heading = heading_of(s);
        p->time[t] = (double)t / s->rate;
        p->turning[t] = t ? remainder(heading - before, 6.283185307179586) * s->rate * 57.29577951308232 : 0.0;
        before = heading;
        for (int k = 0; k < TIPS; k++) {
            int64_t i = p->strand[k];
            if (i < 0) continue;
            const float *tip = s->x + 3 * ((i + 1) * s->vertices - 1), *root = s->position + 3 * i;
            const float *rest_root = s->rest + 3 * i * s->vertices, *rest_tip = rest_root + 3 * (s->vertices - 1);
            double offset[3] = { (double)(tip[0] - root[0]), (double)(tip[1] - root[1]), (double)(tip[2] - root[2]) };
            double local[3];
            turn_back(s->rotation + 4 * i, offset, local);
            p->side[k][t] = -100.0 * (local[0] + (double)rest_root[0]);
            p->ahead[k][t] = 100.0 * (local[2] + (double)rest_root[2]);
            p->rest_side[k][0] = -100.0 * (double)rest_tip[0];
            p->rest_ahead[k][0] = 100.0 * (double)rest_tip[2];
            p->swing[k][t] = swing_of(p->side[k][t], p->ahead[k][t], p->rest_side[k][0], p->rest_ahead[k][0], middle);
        }
    }
    return HG_OK;
}

static hg_status draw(hg_image *image, const paths *p)
{
    int width = image->width, height = image->height, left = height < width / 2 ? height : width / 2;
    hg_curve curves[2 * TIPS];
    int n = 0;
    for (int k = 0; k < TIPS; k++) {
        if (p->strand[k] < 0) continue;
        curves[n++] = (hg_curve){ tip_name[k], p->n, p->side[k], p->ahead[k] };
        curves[n++] = (hg_curve){ NULL, 1, p->rest_side[k], p->rest_ahead[k] };
    }
    HG_TRY(hg_plot(image, 0, 0, left, height, "tips seen from the head, from above (dots: rigidly posed)",
                   "to the right [cm]", "forwards [cm]", n, curves, true));
    const hg_curve turning = { NULL, p->n, p->time, p->turning };
    HG_TRY(hg_plot(image, left, 0, width - left, height / 2, "turning of the head", "time [s]", "deg/s, left positive",
                   1, &turning, false));
    n = 0;
    for (int k = 0; k < TIPS; k++)
        if (p->strand[k] >= 0) curves[n++] = (hg_curve){ tip_name[k], p->n, p->time, p->swing[k] };
    return hg_plot(image, left, height / 2, width - left, height - height / 2, "tips off their rigidly posed place",
                   "time [s]", "along the turn [cm]", n, curves, false);
}

hg_status hg_tips_draw(hg_image **picture, const char *path, int width, int height)
{
    static const uint8_t white[3] = { 255, 255, 255 };
    *picture = NULL;
    hg_source *s;
    HG_TRY(hg_source_open(&s, NULL, path, NULL));
    paths p = { 0 };
    hg_image *image = NULL;
    hg_status status = HG_OK;
    if (!s->rest || !s->rotations || !s->positions || s->frames < 2)
        status = hg_fail(HG_INVALID,
                         "%s: tip paths need a drape with its rest groom and root frames and at least two "
                         "frames",
                         path);
    if (status == HG_OK) status = follow(s, &p);
    if (status == HG_OK) status = hg_image_create(&image, width > 0 ? width : 1400, height > 0 ? height : 700, white);
    if (status == HG_OK) status = draw(image, &p);
    paths_free(&p);
    hg_source_close(s);
    if (status == HG_OK)
        *picture = image;
    else
        hg_image_destroy(image);
    return status;
}
