/* The interpreter for one number type: included by interpreter.c with REAL, LANES, NAME(name) and MATH(name) defined.
 * A step is one operation on LANES strands (or gathered values); the loop over the lanes is what the compiler turns into
 * SIMD, so that the price of deciding what to do is shared by all of them. */

#define EACH _Pragma("omp simd") for (int l = 0; l < LANES; l++)

#define BINARY(op_, expression_)                                                                                       \
    case 4 * op_:                                                                                                      \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL a = p[l], b = q[l];                                                                             \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
        break;                                                                                                         \
    case 4 * op_ + 1: {                                                                                                \
        const REAL a = p[0];                                                                                           \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL b = q[l];                                                                                       \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
    } break;                                                                                                           \
    case 4 * op_ + 2: {                                                                                                \
        const REAL b = q[0];                                                                                           \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL a = p[l];                                                                                       \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
    } break;

#define UNARY(op_, expression_)                                                                                        \
    case 4 * op_:                                                                                                      \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL a = p[l];                                                                                       \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
        break;

#define TERNARY(op_, expression_)                                                                                      \
    case 4 * op_:                                                                                                      \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL a = p[l], b = q[l], c = r[l];                                                                   \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
        break;                                                                                                         \
    case 4 * op_ + 1: {                                                                                                \
        const REAL a = p[0];                                                                                           \
        EACH                                                                                                           \
        {                                                                                                              \
            const REAL b = q[l], c = r[l];                                                                             \
            to[l] = expression_;                                                                                       \
        }                                                                                                              \
    } break;

void NAME(hg_steps_run)(const hg_steps *steps, REAL *const *base)
{
    for (const hg_step *step = steps->steps, *end = step + steps->n; step < end; step++) {
        REAL *to = base[step->to] + step->to_at;
        const REAL *p = base[step->a] + step->a_at, *q = base[step->b] + step->b_at, *r = base[step->c] + step->c_at;
        switch (step->op) {
            BINARY(HG_NODE_ADD, a + b)
            BINARY(HG_NODE_SUB, a - b)
            BINARY(HG_NODE_MUL, a * b)
            BINARY(HG_NODE_DIV, a / b)
            BINARY(HG_NODE_MIN, b < a ? b : a)
            BINARY(HG_NODE_MAX, a < b ? b : a)
            BINARY(HG_NODE_LESS, a < b ? (REAL)1 : (REAL)0)
            UNARY(HG_NODE_NEG, -a)
            UNARY(HG_NODE_SQRT, MATH(sqrt)(a))
            UNARY(HG_NODE_RSQRT, (REAL)1 / MATH(sqrt)(a))
            UNARY(HG_NODE_ABS, MATH(fabs)(a))
            TERNARY(HG_DO_MULADD, a * b + c)
            TERNARY(HG_DO_MULSUB, a * b - c)
            TERNARY(HG_DO_SUBMUL, c - a * b)
        case 4 * HG_NODE_EXP:
            for (int l = 0; l < LANES; l++) to[l] = MATH(exp)(p[l]);
            break;
        case 4 * HG_NODE_LOG:
            for (int l = 0; l < LANES; l++) to[l] = MATH(log)(p[l]);
            break;
        case 4 * HG_NODE_SIN:
            for (int l = 0; l < LANES; l++) to[l] = MATH(sin)(p[l]);
            break;
        case 4 * HG_NODE_COS:
            for (int l = 0; l < LANES; l++) to[l] = MATH(cos)(p[l]);
            break;
        case 4 * HG_NODE_ATAN2:
            for (int l = 0; l < LANES; l++) to[l] = MATH(atan2)(p[l], q[l]);
            break;
        case 4 * HG_NODE_SELECT:
            EACH
            {
                const REAL b = q[l], c = r[l];
                to[l] = p[l] != 0 ? b : c;
            }
            break;
        case 4 * HG_NODE_SELECT + 1: {
            const REAL b = q[0];
            EACH
            {
                const REAL c = r[l];
                to[l] = p[l] != 0 ? b : c;
            }
        } break;
        case 4 * HG_NODE_SELECT + 2: {
            const REAL c = r[0];
            EACH
            {
                const REAL b = q[l];
                to[l] = p[l] != 0 ? b : c;
            }
        } break;
        case 4 * HG_NODE_SELECT + 3: {
            const REAL b = q[0], c = r[0];
            EACH to[l] = p[l] != 0 ? b : c;
        } break;
        case 4 * HG_DO_SET:
            EACH to[l] = p[l];
            break;
        case 4 * HG_DO_SET + 1: {
            const REAL a = p[0];
            EACH to[l] = a;
        } break;
        case 4 * HG_DO_ADD_TO:
            EACH to[l] += p[l];
            break;
        default:
            break;
        }
    }
}

/* ---- functions ---------------------------------------------------------------------------------------------- */

static void NAME(function_run)(const hg_function *f, int64_t n, const void *const *in, const double *uniform,
                               void *const *out)
{
    REAL memory[FUNCTION_SLOTS * LANES] __attribute__((aligned(64)));
    REAL *ins = memory, *outs = ins + f->n_inputs * LANES, *slots = outs + f->n_outputs * LANES;
    REAL *base[HG_PLACES] = { [HG_PLACE_NONE] = memory,
                              [HG_PLACE_REGISTER] = slots,
                              [HG_PLACE_NUMBER] = f->NAME(numbers),
                              [HG_PLACE_IN] = ins,
                              [HG_PLACE_OUT] = outs };
    for (int64_t first = 0; first < n; first += LANES) {
        const int64_t count = n - first < LANES ? n - first : LANES;
        for (int i = 0; i < f->n_inputs; i++) {
            REAL *to = ins + i * LANES;
            if (in && in[i]) {
                const REAL *from = (const REAL *)in[i] + first;
                for (int64_t l = 0; l < LANES; l++) to[l] = from[l < count ? l : count - 1];
            } else {
                for (int l = 0; l < LANES; l++) to[l] = (REAL)uniform[i];
            }
        }
        NAME(hg_steps_run)(&f->NAME(steps), base);
        for (int j = 0; j < f->n_outputs; j++)
            if (out[j]) memcpy((REAL *)out[j] + first, outs + j * LANES, (size_t)count * sizeof(REAL));
    }
}

/* ---- strands ------------------------------------------------------------------------------------------------ */

/* rows of `width` numbers, one per strand, to [width, LANES] and back; strands that are missing repeat the last one */
static void NAME(transpose_in)(REAL *tile, const REAL *rows, int64_t width, int64_t count)
{
    for (int64_t first = 0; first < LANES; first += 16)
        for (int64_t j = 0; j < width; j += 8) {
            const int64_t end = j + 8 < width ? j + 8 : width;
            for (int64_t l = first; l < first + 16; l++) {
                const REAL *row = rows + (l < count ? l : count - 1) * width;
                for (int64_t k = j; k < end; k++) tile[k * LANES + l] = row[k];
            }
        }
}

static void NAME(transpose_out)(REAL *rows, const REAL *tile, int64_t width, int64_t count)
{
    for (int64_t first = 0; first < count; first += 16)
        for (int64_t j = 0; j < width; j += 8) {
            const int64_t end = j + 8 < width ? j + 8 : width, last = first + 16 < count ? first + 16 : count;
            for (int64_t l = first; l < last; l++)
                for (int64_t k = j; k < end; k++) rows[l * width + k] = tile[k * LANES + l];
        }
}

static void NAME(interpret)(const hg_strand_program *p, const hg_strand_args *args, int64_t first, int64_t last,
                            REAL *scratch)
{
    const int64_t V = args->vertices, S = args->strands, width = 3 * V, row = width * LANES;
    REAL *tile[HG_STRAND_ARRAYS] = { 0 }, *base[HG_PLACES];
    for (int k = 0; k < HG_STRAND_ARRAYS; k++)
        if (k == HG_STRAND_X || p->arrays & 1u << k) {
            tile[k] = scratch;
            scratch += row;
        }
    REAL *gradient = scratch, *root = gradient + row, *energy = root + 7 * LANES,
         *adjoint = energy + p->n_terms * LANES, *strand = adjoint + p->n_adjoint * LANES,
         *slots = strand + p->n_strand * LANES;
    for (int k = 0; k < HG_PLACES; k++) base[k] = slots;
    base[HG_PLACE_NUMBER] = (REAL *)p->number_table;
    base[HG_PLACE_UNIFORM] = (REAL *)args->uniform;
    base[HG_PLACE_ROOT] = root;
    base[HG_PLACE_ENERGY] = energy;
    base[HG_PLACE_ADJOINT] = adjoint;
    base[HG_PLACE_STRAND] = strand;
    base[HG_PLACE_ROOT_X0] = tile[HG_STRAND_X];
    base[HG_PLACE_ROOT_X1] = tile[HG_STRAND_X] + (V > 1 ? 3 * LANES : 0);
    base[HG_PLACE_GRADIENT0] = gradient;
    base[HG_PLACE_GRADIENT1] = gradient + (V > 1 ? 3 * LANES : 0);

    for (int64_t t = first; t < last; t++) {
        const int64_t frame = t / args->tiles, in_frame = t % args->tiles, s = in_frame * LANES;
        const int64_t count = S - s < LANES ? S - s : LANES, groom = args->groom ? args->groom[frame] : 0;
        const int64_t stored = groom * args->tiles + in_frame, at = frame * S + s;
        for (int k = 0; k < HG_STRAND_ARRAYS; k++)
            if (tile[k]) NAME(transpose_in)(tile[k], (const REAL *)args->array[k] + at * width, width, count);
        if (args->root_rotation) NAME(transpose_in)(root, (const REAL *)args->root_rotation + 4 * at, 4, count);
        if (args->root_position)
            NAME(transpose_in)(root + 4 * LANES, (const REAL *)args->root_position + 3 * at, 3, count);
        memset(energy, 0, (size_t)((p->n_terms + p->n_adjoint) * LANES) * sizeof(REAL));
        base[HG_PLACE_GROOM_STRAND] = (REAL *)args->groom_strand + stored * p->n_groom_strand * LANES;

        NAME(hg_steps_run)(&p->steps[HG_STRAND_BODIES], base);
        for (int64_t i = 0; i < V; i++) {
            const int64_t vertex = 3 * i * LANES;
            for (int k = 0; k < HG_STRAND_ARRAYS; k++)
                if (tile[k]) base[HG_PLACE_X + k] = tile[k] + vertex;
            base[HG_PLACE_GRADIENT] = gradient + vertex;
            base[HG_PLACE_SITE] = (REAL *)args->site + (stored * V + i) * p->n_site * LANES;
            NAME(hg_steps_run)(&p->steps[i < p->bodies ? i : p->bodies - 1], base);
        }
        NAME(hg_steps_run)(&p->steps[HG_STRAND_BODIES + 1], base);

        if (args->gradient) NAME(transpose_out)((REAL *)args->gradient + at * width, gradient, width, count);
        for (int k = 0; k < p->n_terms; k++) {
            double sum = 0;
            for (int64_t l = 0; l < count; l++) sum += (double)energy[k * LANES + l];
            args->energy[t * p->n_terms + k] = sum;
            if (!args->per_strand) continue;
            for (int64_t l = 0; l < count; l++)
                args->per_strand[(at + l) * args->stride + args->column[k]] = (double)energy[k * LANES + l];
        }
    }
}

#undef EACH
#undef BINARY
#undef UNARY
#undef TERNARY
