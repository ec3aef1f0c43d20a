/* trace: an energy written once, as a formula over one site, becomes value and gradient at the machine's speed.
 *
 *     static scalar stretch(void)                        Hookean stretch: k/2 (l - l_rest)^2
 *     {
 *         scalar l      = norm(sub(x(1), x(0)));
 *         scalar l_rest = norm(sub(rest(1), rest(0)));
 *         return mul(0.5, param("stiffness"), square(sub(l, l_rest)));
 *     }
 *
 * Called once, the function records a scalar graph: straight-line code over scalars, without loops or memory. The
 * graph is folded, shared, differentiated in reverse, hoisted by how often its inputs change, and lowered to short
 * instruction lists that the block interpreter runs, and that the printers turn into C (and CUDA).
 *
 * Handles are small structs, so that adding a vector to a scalar or an `if (a < b)` does not compile. The full names are
 * hg_trace_*; "autograd/trace/names.h", included last and only by energy files, gives the short ones used above.
 *
 * Branches are select, min, max, clamp: both sides are evaluated; the adjoint of the unselected side is exactly zero;
 * ties differentiate the first argument. Guard the INPUT of a division or root, never its result.
 */
#ifndef HG_TRACE_H
#define HG_TRACE_H

#include "base/base.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct { int32_t id; } hg_scalar;                        /* a node of the graph being recorded; -1 after an error */
typedef struct { hg_scalar x, y, z; } hg_vec3;
typedef struct { hg_scalar w; hg_vec3 v; } hg_quat;

/* How often an input changes; what depends only on slower inputs is computed less often. */
typedef enum {
    HG_RATE_CONSTANT,   /* a literal */
    HG_RATE_UNIFORM,    /* a parameter, the time step: once per call */
    HG_RATE_GROOM,      /* a rest quantity of a vertex: once per groom */
    HG_RATE_GROOM_STRAND, /* a rest quantity of a strand (its root): once per groom */
    HG_RATE_STRAND,     /* root rotation, root edge: once per strand and frame */
    HG_RATE_SITE        /* anything that depends on a vertex of the frame */
} hg_rate;

/* What the formula may ask for. k counts from the first vertex of the window. */
hg_vec3   hg_trace_x(int k);                 /* vertex position [m], the unknown */
hg_vec3   hg_trace_rest(int k);              /* rest groom */
hg_vec3   hg_trace_posed(int k);             /* rigidly posed groom */
hg_vec3   hg_trace_predicted(int k);         /* 2 x(t-1) - x(t-2), detached */
hg_vec3   hg_trace_previous(int k);          /* x(t-1), detached */
hg_vec3   hg_trace_contact_point(int k);     /* a on the body, and n such that the signed distance is n.(x - a); detached */
hg_vec3   hg_trace_contact_normal(int k);
hg_scalar hg_trace_contact_distance(int k);  /* n.(x - a): a function of x */
hg_vec3   hg_trace_root_x(int k);            /* vertices 0 and 1 of the strand */
hg_vec3   hg_trace_root_rest(int k);
hg_quat   hg_trace_root_rotation(void);      /* R of the strand in this frame */
hg_vec3   hg_trace_root_position(void);
hg_scalar hg_trace_mass(int k);              /* kg */
hg_scalar hg_trace_attribute(const char *name, int k); /* a groom attribute [S,V]: "body_distance", "density_rest", ... */
hg_scalar hg_trace_strand_length(void);      /* rest length of the strand: the attribute "strand_length", made of the groom's own rest where it is absent */
hg_quat   hg_trace_q(int k);                 /* free orientation of edge k (vertices k, k+1), an unknown like x */
hg_scalar hg_trace_frame_scalar(const char *name, int k); /* a named array of the frame, [B,S,V] and [B,S,V,3], */
hg_vec3   hg_trace_frame_vec3(const char *name, int k);   /* brought by hg_frame.inputs: "ghost", "wind", ... */
hg_scalar hg_trace_distance(void);           /* pairs and field kernels: |x_i - x_j| */
hg_scalar hg_trace_rest_distance(void);      /* pairs: the same at rest */
hg_scalar hg_trace_field(void);              /* field energies: the sum over neighbours at this vertex */
hg_scalar hg_trace_field_rest(void);         /* the same in the rest groom */
hg_scalar hg_trace_param(const char *name);  /* a declared parameter of the energy */
hg_vec3   hg_trace_param3(const char *name); /* a declared vector parameter */
hg_scalar hg_trace_dt(void);                 /* s */
bool      hg_trace_option(const char *name, const char *choice); /* decided while tracing: a C if is fine */

/* A scan: a value that goes from site to site, root to tip. carry: what the site before kept under that name, `first` at the
 * first site. Each name is carried once and kept once per formula. One that depends on rest data alone is made once per
 * groom. The derivative is carried back from tip to root. */
hg_scalar hg_trace_carry_scalar(const char *name, hg_scalar first);
hg_vec3   hg_trace_carry_vec3(const char *name, hg_vec3 first);
hg_quat   hg_trace_carry_quat(const char *name, hg_quat first);
void      hg_trace_keep_scalar(const char *name, hg_scalar value);
void      hg_trace_keep_vec3(const char *name, hg_vec3 value);
void      hg_trace_keep_quat(const char *name, hg_quat value);

/* Scalars */
hg_scalar hg_trace_number(double value);
hg_scalar hg_trace_add2(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_sub(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_mul2(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_div(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_neg(hg_scalar a);
hg_scalar hg_trace_sqrt(hg_scalar a);        /* derivative at 0 is 0 */
hg_scalar hg_trace_rsqrt(hg_scalar a);
hg_scalar hg_trace_abs(hg_scalar a);
hg_scalar hg_trace_exp(hg_scalar a);
hg_scalar hg_trace_log(hg_scalar a);
hg_scalar hg_trace_sin(hg_scalar a);
hg_scalar hg_trace_cos(hg_scalar a);
hg_scalar hg_trace_atan2(hg_scalar y, hg_scalar x);
hg_scalar hg_trace_min(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_max(hg_scalar a, hg_scalar b);
hg_scalar hg_trace_less(hg_scalar a, hg_scalar b);               /* 1 or 0, no derivative */
hg_scalar hg_trace_select(hg_scalar condition, hg_scalar a, hg_scalar b);
hg_scalar hg_trace_detach(hg_scalar a);                          /* its value, no derivative */

/* Vectors */
hg_scalar hg_trace_square(hg_scalar a);
hg_scalar hg_trace_clamp(hg_scalar a, hg_scalar low, hg_scalar high);
hg_vec3   hg_trace_vec3_add(hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_sub(hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_neg(hg_vec3 a);
hg_vec3   hg_trace_vec3_scale(hg_vec3 a, hg_scalar s);
hg_vec3   hg_trace_vec3_div(hg_vec3 a, hg_scalar s);
hg_scalar hg_trace_vec3_dot(hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_cross(hg_vec3 a, hg_vec3 b);
hg_scalar hg_trace_vec3_square(hg_vec3 a);                       /* a.a */
hg_scalar hg_trace_vec3_norm(hg_vec3 a);                         /* gradient of zero is zero */
hg_vec3   hg_trace_vec3_normalize(hg_vec3 a);                    /* zero stays zero, with gradient zero */
hg_vec3   hg_trace_vec3_min(hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_max(hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_select(hg_scalar condition, hg_vec3 a, hg_vec3 b);
hg_vec3   hg_trace_vec3_detach(hg_vec3 a);
hg_scalar hg_trace_rest_length(hg_vec3 a, hg_vec3 b);            /* max(|b - a|, 1e-6 m): safe to divide by */
hg_vec3   hg_trace_tangent(hg_vec3 a, hg_vec3 b, hg_scalar l0);  /* e / sqrt(max(e.e, (1e-3 l0)^2)), e = b - a */

/* Quaternions (w, x, y, z), Hamilton */
hg_quat   hg_trace_quat_add(hg_quat a, hg_quat b);
hg_quat   hg_trace_quat_sub(hg_quat a, hg_quat b);
hg_quat   hg_trace_quat_neg(hg_quat a);
hg_quat   hg_trace_quat_scale(hg_quat a, hg_scalar s);
hg_scalar hg_trace_quat_dot(hg_quat a, hg_quat b);
hg_scalar hg_trace_quat_square(hg_quat a);
hg_scalar hg_trace_quat_norm(hg_quat a);
hg_quat   hg_trace_quat_normalize(hg_quat a);                    /* zero stays zero */
hg_quat   hg_trace_quat_conj(hg_quat a);
hg_quat   hg_trace_quat_mul(hg_quat a, hg_quat b);
hg_vec3   hg_trace_quat_rotate(hg_quat q, hg_vec3 v);            /* q v conj(q) */
hg_quat   hg_trace_quat_select(hg_scalar condition, hg_quat a, hg_quat b);
hg_quat   hg_trace_quat_detach(hg_quat a);
hg_quat   hg_trace_transport(hg_vec3 a, hg_vec3 b);              /* smallest rotation a -> b of unit vectors: (a.h, a x h), h = (a+b)/sqrt(max(|a+b|^2, 1e-4)) */

#ifdef __cplusplus
}
#endif
#endif
