/* The surface of the procedural bust: ellipsoids and tapered capsules joined by smooth minima, meshed by surface nets
 * (Gibson 1998): one vertex per grid cell that the surface passes, drawn onto the surface and evened out along it. */
#include "scene/bust.h"

/* ---- the implicit surface ----------------------------------------------------------------------------------- */

/* Distance to an ellipsoid, exact to first order near its surface. */
static double ellipsoid(hg_vec3d p, hg_vec3d centre, hg_vec3d radius)
{
    hg_vec3d d = hg_vec3d_sub(p, centre);
    hg_vec3d a = hg_vec3d_make(d.x / radius.x, d.y / radius.y, d.z / radius.z);
    hg_vec3d b = hg_vec3d_make(a.x / radius.x, a.y / radius.y, a.z / radius.z);
    double length = hg_vec3d_norm(a), slope = hg_vec3d_norm(b);
    return slope > 1e-9 ? length * (length - 1) / slope : -fmin(radius.x, fmin(radius.y, radius.z));
}

static double capsule(hg_vec3d p, hg_vec3d a, double radius_a, hg_vec3d b, double radius_b)
{
    hg_vec3d axis = hg_vec3d_sub(b, a);
    double t = hg_vec3d_dot(hg_vec3d_sub(p, a), axis) / hg_vec3d_norm2(axis);
    t = fmin(fmax(t, 0), 1);
    return hg_vec3d_distance(p, hg_vec3d_add_scaled(a, t, axis)) - (radius_a + t * (radius_b - radius_a));
}

/* Minimum with the crease filled over the width k; maximum with the edge rounded. */
static double join(double a, double b, double k)
{
    double h = fmax(k - fabs(a - b), 0) / k;
    return fmin(a, b) - 0.25 * h * h * k;
}

static double cut(double a, double b, double k) { return -join(-a, -b, k); }

#define AT hg_vec3d_make

/* x is |x|: both sides are the same. */
static double head_distance(hg_vec3d p)
{
    double d = ellipsoid(p, AT(0, 0.758, 0.026), AT(0.0765, 0.084, 0.0955));                 /* cranium */
    d = join(d, ellipsoid(p, AT(0, 0.742, 0.078), AT(0.0655, 0.062, 0.056)), 0.03);          /* forehead and temples */
    d = join(d, ellipsoid(p, AT(0, 0.686, 0.070), AT(0.0575, 0.072, 0.058)), 0.04);          /* face */
    d = join(d, ellipsoid(p, AT(0.028, 0.660, 0.055), AT(0.028, 0.032, 0.045)), 0.03);       /* jaw */
    d = join(d, ellipsoid(p, AT(0, 0.632, 0.112), AT(0.022, 0.017, 0.017)), 0.03);           /* chin */
    d = join(d, ellipsoid(p, AT(0.037, 0.706, 0.104), AT(0.022, 0.018, 0.020)), 0.025);      /* cheekbone */
    d = join(d, ellipsoid(p, AT(0.024, 0.754, 0.126), AT(0.026, 0.009, 0.010)), 0.02);       /* brow */
    d = cut(d, -ellipsoid(p, AT(0.032, 0.737, 0.142), AT(0.019, 0.012, 0.015)), 0.012);      /* eye socket */
    d = join(d, ellipsoid(p, AT(0.031, 0.736, 0.119), AT(0.013, 0.012, 0.013)), 0.006);      /* eye */
    d = join(d, capsule(p, AT(0, 0.742, 0.131), 0.007, AT(0, 0.705, 0.146), 0.0110), 0.014); /* nose */
    d = join(d, ellipsoid(p, AT(0.011, 0.701, 0.139), AT(0.008, 0.008, 0.010)), 0.008);
    d = join(d, ellipsoid(p, AT(0, 0.680, 0.108), AT(0.032, 0.026, 0.024)), 0.016);  /* round the mouth */
    d = join(d, ellipsoid(p, AT(0, 0.673, 0.127), AT(0.021, 0.0065, 0.009)), 0.006); /* lips */
    d = join(d, ellipsoid(p, AT(0, 0.661, 0.125), AT(0.018, 0.007, 0.009)), 0.006);
    return join(d, ellipsoid(p, AT(0.078, 0.722, 0.022), AT(0.0085, 0.031, 0.018)), 0.010); /* ear */
}

static double neck_distance(hg_vec3d p)
{
    double d = capsule(p, AT(0, 0.545, -0.018), 0.060, AT(0, 0.70, 0.012), 0.054);
    return join(d, capsule(p, AT(0.012, 0.540, 0.045), 0.010, AT(0.050, 0.690, 0.010), 0.014),
                0.03); /* the muscle to the ear */
}

static double torso_distance(hg_vec3d p)
{
    double d = ellipsoid(p, AT(0, 0.420, -0.006), AT(0.152, 0.155, 0.092));             /* chest */
    d = join(d, ellipsoid(p, AT(0.070, 0.425, 0.040), AT(0.070, 0.070, 0.046)), 0.06);  /* breast */
    d = join(d, ellipsoid(p, AT(0.070, 0.440, -0.070), AT(0.070, 0.085, 0.035)), 0.05); /* shoulder blade */
    d = join(d, capsule(p, AT(0.020, 0.585, -0.028), 0.040, AT(0.160, 0.520, -0.018), 0.034), 0.05); /* trapezius */
    d = join(d, capsule(p, AT(0.010, 0.528, 0.040), 0.018, AT(0.150, 0.535, 0.000), 0.020), 0.045);  /* collar bone */
    d = join(d, ellipsoid(p, AT(0.170, 0.500, -0.012), AT(0.048, 0.058, 0.052)), 0.05);              /* shoulder */
    d = join(d, capsule(p, AT(0.174, 0.500, -0.014), 0.044, AT(0.194, 0.340, -0.018), 0.040), 0.05); /* arm */
    double below = 0.345 + 0.075 * scene_ramp(0.06, 0.22, p.x); /* sculptors cut higher under the arms */
    return cut(d, below - p.y, 0.035);
}

bust_distance bust_measure(hg_vec3d p)
{
    bust_distance d;
    p.x = fabs(p.x);
    d.head = head_distance(p), d.neck = neck_distance(p), d.torso = torso_distance(p);
    d.all = join(join(d.head, d.neck, 0.025), d.torso, 0.045);
    return d;
}

static hg_vec3d gradient(hg_vec3d p)
{
    const double e = 1e-5;
    return hg_vec3d_scale(AT(bust_measure(AT(p.x + e, p.y, p.z)).all - bust_measure(AT(p.x - e, p.y, p.z)).all,
                             bust_measure(AT(p.x, p.y + e, p.z)).all - bust_measure(AT(p.x, p.y - e, p.z)).all,
                             bust_measure(AT(p.x, p.y, p.z + e)).all - bust_measure(AT(p.x, p.y, p.z - e)).all),
                          0.5 / e);
}

hg_vec3d bust_normal(hg_vec3d p) { return hg_vec3d_normalize(gradient(p)); }

/* ---- the mesh ----------------------------------------------------------------------------------------------- */

static const double low[3] = { -0.27, 0.30, -0.15 }, high[3] = { 0.27, 0.87, 0.19 };

typedef struct {
    int n[3]; /* grid points along each axis; even number of cells along x, so that the mesh is symmetric */
    double cell;
    double *value;   /* at grid points */
    int32_t *vertex; /* of cells (by their low corner), -1: the surface does not pass */
} net;

static int64_t net_index(const net *g, int x, int y, int z) { return ((int64_t)z * g->n[1] + y) * g->n[0] + x; }

static hg_vec3d net_point(const net *g, int x, int y, int z)
{
    return AT((x - (g->n[0] - 1) / 2) * g->cell, low[1] + y * g->cell, low[2] + z * g->cell);
}

/* The mean of the points where the surface cuts the edges of a cell; false when it cuts none. */
static bool cell_vertex(const net *g, int x, int y, int z, hg_vec3d *vertex)
{
    hg_vec3d sum = { 0 };
    int cuts = 0;
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 4; k++) {
            int a[3] = { x, y, z }, b[3];
            a[(axis + 1) % 3] += k & 1, a[(axis + 2) % 3] += k >> 1;
            for (int c = 0; c < 3; c++) b[c] = a[c] + (c == axis);
            double fa = g->value[net_index(g, a[0], a[1], a[2])], fb = g->value[net_index(g, b[0], b[1], b[2])];
            if ((fa < 0) == (fb < 0)) continue;
            hg_vec3d pa = net_point(g, a[0], a[1], a[2]), pb = net_point(g, b[0], b[1], b[2]);
            sum = hg_vec3d_add(sum, hg_vec3d_mix(pa, pb, fa / (fa - fb)));
            cuts++;
        }
    if (cuts) *vertex = hg_vec3d_scale(sum, 1.0 / cuts);
    return cuts > 0;
}

/* Onto the surface, a few steps of Newton. */
static hg_vec3d onto_surface(hg_vec3d p)
{
    for (int i = 0; i < 4; i++) {
        hg_vec3d slope = gradient(p);
        p = hg_vec3d_add_scaled(p, -bust_measure(p).all / fmax(hg_vec3d_norm2(slope), 0.1), slope);
    }
    return p;
}

/* Every edge of the grid that the surface cuts makes a quad of the four cells around it, cut at its shorter diagonal. */
static int64_t net_faces(const net *g, const hg_vec3d *at, int32_t *triangles)
{
    int64_t faces = 0;
    for (int z = 1; z + 1 < g->n[2]; z++)
        for (int y = 1; y + 1 < g->n[1]; y++)
            for (int x = 1; x + 1 < g->n[0]; x++)
                for (int axis = 0; axis < 3; axis++) {
                    int next[3] = { x + (axis == 0), y + (axis == 1), z + (axis == 2) };
                    bool inside = g->value[net_index(g, x, y, z)] < 0;
                    if (inside == (g->value[net_index(g, next[0], next[1], next[2])] < 0)) continue;
                    int32_t quad[4];
                    for (int k = 0; k < 4; k++) {
                        int c[3] = { x, y, z };
                        c[(axis + 1) % 3] -= k == 1 || k == 2, c[(axis + 2) % 3] -= k >= 2;
                        quad[inside ? k : 3 - k] = g->vertex[net_index(g, c[0], c[1], c[2])];
                    }
                    bool other =
                        hg_vec3d_distance(at[quad[1]], at[quad[3]]) < hg_vec3d_distance(at[quad[0]], at[quad[2]]);
                    for (int k = 0; k < 6 && triangles; k++) {
                        static const int corner[2][6] = { { 0, 1, 2, 0, 2, 3 }, { 0, 1, 3, 1, 2, 3 } };
                        triangles[3 * faces + k] = quad[corner[other][k]];
                    }
                    faces += 2;
                }
    return faces;
}

/* Moves vertices towards the mean of their neighbours and back onto the surface: triangles of even size. */
static void relax(int64_t vertices, hg_vec3d *at, hg_vec3d *sum, int64_t faces, const int32_t *triangles)
{
    for (int round = 0; round < 6; round++) {
        for (int64_t v = 0; v < 2 * vertices; v++) sum[v] = (hg_vec3d){ 0 };
        for (int64_t f = 0; f < faces; f++)
            for (int c = 0; c < 3; c++) {
                int32_t a = triangles[3 * f + c], b = triangles[3 * f + (c + 1) % 3];
                sum[2 * a] = hg_vec3d_add(sum[2 * a], at[b]), sum[2 * a + 1].x++;
                sum[2 * b] = hg_vec3d_add(sum[2 * b], at[a]), sum[2 * b + 1].x++;
            }
        for (int64_t v = 0; v < vertices; v++) {
            hg_vec3d mean = hg_vec3d_scale(sum[2 * v], 1 / sum[2 * v + 1].x);
            at[v] = onto_surface(hg_vec3d_mix(at[v], mean, 0.5));
        }
    }
}

static hg_status net_mesh(net *g, int64_t *vertices, float **points, int64_t *faces, int32_t **triangles)
{
    hg_vec3d *at = NULL, *sum = NULL;
    hg_status status = HG_MEMORY;
    for (int z = 0; z < g->n[2]; z++)
        for (int y = 0; y < g->n[1]; y++)
            for (int x = 0; x < g->n[0]; x++) {
                g->value[net_index(g, x, y, z)] = bust_measure(net_point(g, x, y, z)).all;
                g->vertex[net_index(g, x, y, z)] = -1;
            }
    for (int pass = 0; pass < 2; pass++) { /* count, then place */
        *vertices = 0;
        for (int z = 0; z + 1 < g->n[2]; z++)
            for (int y = 0; y + 1 < g->n[1]; y++)
                for (int x = 0; x + 1 < g->n[0]; x++) {
                    hg_vec3d p;
                    if (!cell_vertex(g, x, y, z, &p)) continue;
                    if (pass) at[*vertices] = onto_surface(p);
                    g->vertex[net_index(g, x, y, z)] = (int32_t)(*vertices)++;
                }
        if (pass == 0 && !(at = hg_alloc((size_t)*vertices, sizeof *at))) goto done;
    }
    *faces = net_faces(g, at, NULL);
    *triangles = hg_alloc((size_t)*faces, 3 * sizeof **triangles);
    *points = hg_alloc((size_t)*vertices, 3 * sizeof **points);
    sum = hg_alloc((size_t)*vertices, 2 * sizeof *sum);
    if (!*triangles || !*points || !sum) goto done;
    net_faces(g, at, *triangles);
    relax(*vertices, at, sum, *faces, *triangles);
    net_faces(g, at, *triangles); /* the diagonals that are shorter now */
    for (int64_t v = 0; v < *vertices; v++) scene_put(*points + 3 * v, at[v]);
    status = HG_OK;
done:
    hg_free(at);
    hg_free(sum);
    return status;
}

hg_status bust_mesh(double cell, int64_t *vertices, float **points, int64_t *faces, int32_t **triangles)
{
    net g = { .cell = cell };
    *points = NULL, *triangles = NULL;
    g.n[0] = 2 * (int)ceil(high[0] / cell) + 1;
    for (int i = 1; i < 3; i++) g.n[i] = (int)ceil((high[i] - low[i]) / cell) + 1;
    size_t count = (size_t)g.n[0] * (size_t)g.n[1] * (size_t)g.n[2];
    g.value = hg_alloc(count, sizeof *g.value);
    g.vertex = hg_alloc(count, sizeof *g.vertex);
    hg_status status = g.value && g.vertex ? net_mesh(&g, vertices, points, faces, triangles) : HG_MEMORY;
    hg_free(g.value);
    hg_free(g.vertex);
    if (status != HG_OK) {
        hg_free(*points);
        hg_free(*triangles);
        *points = NULL, *triangles = NULL;
    }
    return status;
}
