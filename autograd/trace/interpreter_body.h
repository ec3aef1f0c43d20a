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

STEPS_ATTRIBUTE void NAME(hg_steps_run)(const hg_steps *steps, REAL *const *base)
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
    for (int i = 0; i < f->n_inputs; i++)
        for (int l = 0; l < LANES && !(in && in[i]); l++) ins[i * LANES + l] = (REAL)uniform[i];
    for (int64_t first = 0; first < n; first += LANES) {
        const int64_t count = n - first < LANES ? n - first : LANES;
        for (int i = 0; i < f->n_inputs; i++) {
            if (!in || !in[i]) continue;
            REAL *to = ins + i * LANES;
            const REAL *from = (const REAL *)in[i] + first;
            memcpy(to, from, (size_t)count * sizeof *to);
            for (int64_t l = count; l < LANES; l++) to[l] = from[count - 1];
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

/* The steps of one vertex: everything that goes along with it is put there. */
static void NAME(at_vertex)(const hg_strand_program *p, const hg_steps *steps, REAL **base, REAL *scratch,
                            const REAL *sites, int64_t V, int64_t i)
{
#define TILE(tile) (scratch + ((tile).rows * V + (tile).extra) * LANES)
    for (int k = 0; k < p->n_arrays; k++) {
        const hg_strand_input *array = &p->arrays[k];
        base[HG_PLACE_ARRAY + k] = TILE(array->tile) + i * array->width * LANES;
        base[HG_PLACE_ARRAY_GRADIENT + k] = TILE(array->gradient_tile) + i * array->width * LANES;
    }
    base[HG_PLACE_SITE] = (REAL *)sites + i * p->n_site * LANES;
    base[HG_PLACE_CARRY] = TILE(p->carry_tile) + i * p->n_carry * LANES;
    base[HG_PLACE_CARRY_ADJOINT] = TILE(p->carry_adjoint_tile) + i * p->n_carry * LANES;
    NAME(hg_steps_run)(steps, base);
}

static void NAME(interpret)(const hg_strand_program *p, const hg_strand_args *args, int64_t first, int64_t last,
                            REAL *scratch)
{
    const int64_t V = args->vertices, S = args->strands, second = V > 1 ? 3 * LANES : 0;
    REAL *base[HG_PLACES];
    REAL *inputs = TILE(p->tiles), *input_gradients = inputs + p->input_width * LANES,
         *energy = input_gradients + p->input_width * LANES, *adjoint = energy + p->n_terms * LANES,
         *strand = adjoint + p->n_adjoint * LANES, *slots = strand + p->n_strand * LANES;
    for (int k = 0; k < HG_PLACES; k++) base[k] = slots;
    base[HG_PLACE_NUMBER] = (REAL *)p->number_table;
    base[HG_PLACE_UNIFORM] = (REAL *)args->uniform;
    base[HG_PLACE_STRAND_INPUT] = inputs;
    base[HG_PLACE_STRAND_INPUT_GRADIENT] = input_gradients;
    base[HG_PLACE_ENERGY] = energy;
    base[HG_PLACE_ADJOINT] = adjoint;
    base[HG_PLACE_STRAND] = strand;
    for (int k = 0; k < p->n_arrays; k++) {
        const hg_strand_input *array = &p->arrays[k];
        const int rest = array->kind == HG_INPUT_REST;
        if (!rest && array->kind != HG_INPUT_X) continue;
        base[rest ? HG_PLACE_ROOT_REST0 : HG_PLACE_ROOT_X0] = TILE(array->tile);
        base[rest ? HG_PLACE_ROOT_REST1 : HG_PLACE_ROOT_X1] = TILE(array->tile) + second;
        base[rest ? HG_PLACE_GRADIENT_REST0 : HG_PLACE_GRADIENT_X0] = TILE(array->gradient_tile);
        base[rest ? HG_PLACE_GRADIENT_REST1 : HG_PLACE_GRADIENT_X1] = TILE(array->gradient_tile) + second;
    }

    for (int64_t t = first; t < last; t++) {
        const int64_t frame = t / args->tiles, in_frame = t % args->tiles, s = in_frame * LANES;
        const int64_t count = S - s < LANES ? S - s : LANES, groom = args->groom ? args->groom[frame] : 0;
        const int64_t stored = groom * args->tiles + in_frame, at = frame * S + s;
        const REAL *sites = (const REAL *)args->site + stored * V * p->n_site * LANES;
        for (int k = 0; k < p->n_arrays; k++) {
            const hg_strand_input *array = &p->arrays[k];
            const int64_t width = array->width * (V - array->missing), row = array->rest ? groom * S + s : at;
            NAME(transpose_in)(TILE(array->tile), (const REAL *)args->array[k] + row * width, width, count);
            if (p->n_carry && array->gradient) /* on the way back no site is the first to touch a vertex */
                memset(TILE(array->gradient_tile), 0, (size_t)(width * LANES) * sizeof(REAL));
        }
        for (int j = 0; j < p->n_inputs; j++) {
            const hg_strand_input *input = &p->inputs[j];
            if (args->strand_input[j]) NAME(transpose_in)
            (inputs + input->first * LANES, (const REAL *)args->strand_input[j] + input->width * at, input->width,
             count);
        }
        memset(energy, 0, (size_t)((p->n_terms + p->n_adjoint) * LANES) * sizeof(REAL));
        base[HG_PLACE_GROOM_STRAND] = (REAL *)args->groom_strand + stored * p->n_groom_strand * LANES;

        NAME(hg_steps_run)(&p->steps[HG_STRAND_BODIES], base);
        if (p->n_carry) {
            const int64_t end = V * p->n_carry * LANES;
            for (int64_t i = 0; i < V; i++)
                NAME(at_vertex)(p, &p->forward_steps[i < p->bodies ? i : p->bodies - 1], base, scratch, sites, V, i);
            memset(TILE(p->carry_adjoint_tile) + end, 0, (size_t)(p->n_carry * LANES) * sizeof(REAL));
            for (int64_t i = V - 1; i >= 0; i--)
                NAME(at_vertex)(p, &p->steps[i < p->bodies ? i : p->bodies - 1], base, scratch, sites, V, i);
        } else {
            for (int64_t i = 0; i < V; i++)
                NAME(at_vertex)(p, &p->steps[i < p->bodies ? i : p->bodies - 1], base, scratch, sites, V, i);
        }
        NAME(hg_steps_run)(&p->steps[HG_STRAND_BODIES + 1], base);

        for (int k = 0; k < p->n_arrays; k++) {
            const hg_strand_input *array = &p->arrays[k];
            const int64_t width = array->width * (V - array->missing);
            if (array->gradient && args->array_gradient[k]) NAME(transpose_out)
            ((REAL *)args->array_gradient[k] + at * width, TILE(array->gradient_tile), width, count);
        }
        for (int j = 0; j < p->n_inputs; j++) {
            const hg_strand_input *input = &p->inputs[j];
            if (input->gradient && args->strand_input_gradient[j]) NAME(transpose_out)
            ((REAL *)args->strand_input_gradient[j] + input->width * at, input_gradients + input->first * LANES,
             input->width, count);
        }
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

#undef TILE
#undef EACH
#undef BINARY
#undef UNARY
#undef TERNARY
