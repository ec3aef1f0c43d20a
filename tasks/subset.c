/* subset: the strands that a step sees, with the physics made for them.
 *
 * Drawn from (seed, purpose, epoch) alone. `locks`: whole locks, spread over the scalp by farthest-point selection from
 * a seeded first one. `spread`: strands in a seeded order within each lock, taken from all locks in turn; evaluation
 * always draws this way, so that it sees strands that training has not. Neighbour lists and rest densities belong to the
 * subset: they are made from its own rest groom. Masses and stiffnesses stay those of one hair: a guide that stands for
 * N hairs multiplies every one of them by N, which the reference energy divides out again. */
#include "tasks/hair.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- drawing ------------------------------------------------------------------------------------------------ */

typedef struct {
    uint64_t key;
    int32_t item;
} keyed;

static int by_key(const void *a_, const void *b_)
{
    const keyed *a = a_, *b = b_;
    if (a->key != b->key) return a->key < b->key ? -1 : 1;
    return a->item < b->item ? -1 : a->item > b->item;
}

static int64_t min_of(int64_t a, int64_t b) { return a < b ? a : b; }

static int by_number(const void *a_, const void *b_)
{
    const int32_t a = *(const int32_t *)a_, b = *(const int32_t *)b_;
    return a < b ? -1 : a > b;
}

static uint64_t random_key(uint64_t seed, uint64_t stream, uint64_t counter)
{
    uint32_t bits[4];
    hg_random_bits(seed, stream, counter, bits);
    return (uint64_t)bits[0] << 32 | bits[1];
}

/* Turn-taking: the k-th strand of every lock comes before the (k+1)-th of any. */
static hg_status draw_spread(const hg_hair_style *style, uint64_t seed, uint64_t stream, int64_t want, int32_t *out)
{
    const int64_t strands = style->groom->strands;
    keyed *order = hg_alloc((size_t)strands, sizeof *order);
    uint64_t *taken = hg_alloc((size_t)style->locks, sizeof *taken);
    if (!order || !taken) {
        hg_free(order);
        hg_free(taken);
        return HG_MEMORY;
    }
    for (int64_t s = 0; s < strands; s++) order[s] = (keyed){ random_key(seed, stream, (uint64_t)s), (int32_t)s };
    qsort(order, (size_t)strands, sizeof *order, by_key);
    for (int64_t i = 0; i < strands; i++) {
        const uint64_t turn = taken[style->lock[order[i].item]]++;
        order[i].key = turn << 32 | (order[i].key >> 32);
    }
    qsort(order, (size_t)strands, sizeof *order, by_key);
    for (int64_t i = 0; i < want; i++) out[i] = order[i].item;
    hg_free(order);
    hg_free(taken);
    return HG_OK;
}

static hg_status draw_locks(const hg_hair_style *style, uint64_t seed, uint64_t stream, int64_t want, int32_t *out)
{
    const int64_t strands = style->groom->strands;
    const int32_t locks = style->locks;
    double *place = hg_alloc((size_t)locks * 3, sizeof *place), *nearest = hg_alloc((size_t)locks, sizeof *nearest);
    if (!place || !nearest) {
        hg_free(place);
        hg_free(nearest);
        return HG_MEMORY;
    }
    for (int64_t s = 0; s < strands; s++) {
        double *sum = place + 3 * style->lock[s];
        sum[0] += (double)style->groom->root_uv[2 * s];
        sum[1] += (double)style->groom->root_uv[2 * s + 1];
        sum[2] += 1;
    }
    for (int32_t l = 0; l < locks; l++) {
        nearest[l] = (double)INFINITY;
        if (place[3 * l + 2] > 0) place[3 * l] /= place[3 * l + 2], place[3 * l + 1] /= place[3 * l + 2];
    }
    int32_t lock = (int32_t)hg_random_below(seed, stream, 0, (uint64_t)locks);
    for (int64_t n = 0; n < want;) {
        for (int64_t s = 0; s < strands && n < want; s++)
            if (style->lock[s] == lock) out[n++] = (int32_t)s;
        nearest[lock] = -1;
        int32_t farthest = -1;
        for (int32_t l = 0; l < locks; l++) {
            const double du = place[3 * l] - place[3 * lock], dv = place[3 * l + 1] - place[3 * lock + 1];
            if (nearest[l] >= 0) nearest[l] = fmin(nearest[l], du * du + dv * dv);
            if (nearest[l] >= 0 && (farthest < 0 || nearest[l] > nearest[farthest])) farthest = l;
        }
        if (farthest < 0) break;
        lock = farthest;
    }
    hg_free(place);
    hg_free(nearest);
    return HG_OK;
}

static hg_status draw(hg_hair_subset *subset, const hg_hair_task *task, hg_hair_purpose purpose, int64_t epoch)
{
    subset->first = purpose == HG_HAIR_EVALUATION ? task->current : 0;
    subset->grooms = purpose == HG_HAIR_EVALUATION ? 1 : task->n_grooms;
    subset->n = hg_config_integer(task->config, "training.strands");
    for (int g = 0; g < subset->grooms; g++)
        subset->n = min_of(subset->n, task->styles[subset->first + g].groom->strands);
    subset->strand = hg_alloc((size_t)(subset->grooms * subset->n), sizeof *subset->strand);
    if (!subset->strand) return HG_MEMORY;
    const bool spread =
        purpose == HG_HAIR_EVALUATION || !strcmp(hg_config_text(task->config, "training.subset"), "spread");
    for (int g = 0; g < subset->grooms; g++) {
        const int number = subset->first + g;
        const uint64_t stream =
            (7100 + 2 * (uint64_t)epoch + (purpose == HG_HAIR_EVALUATION ? 1 : 0)) + ((uint64_t)number << 40);
        int32_t *strand = subset->strand + g * subset->n;
        HG_TRY(spread ? draw_spread(&task->styles[number], task->seed, stream, subset->n, strand)
                      : draw_locks(&task->styles[number], task->seed, stream, subset->n, strand));
        qsort(strand, (size_t)subset->n, sizeof *strand, by_number);
    }
    return HG_OK;
}

/* ---- physics ------------------------------------------------------------------------------------------------ */

/* mass of a vertex: linear density x half of its adjacent rest edges. */
static double linear_density(const hg_hair_task *task)
{
    return hg_config_number(task->config, "scene.linear_density");
}

static void measure(const hg_groom *groom, int64_t strand, double density, double *lengths, double *mass)
{
    const int64_t V = groom->vertices;
    const float *x = groom->points + strand * V * 3;
    for (int64_t v = 0; v + 1 < V; v++) {
        const double dx = (double)x[3 * v + 3] - (double)x[3 * v], dy = (double)x[3 * v + 4] - (double)x[3 * v + 1],
                     dz = (double)x[3 * v + 5] - (double)x[3 * v + 2];
        lengths[v] = sqrt(dx * dx + dy * dy + dz * dz);
    }
    for (int64_t v = 0; mass && v < V; v++)
        mass[v] = density * 0.5 * ((v > 0 ? lengths[v - 1] : 0) + (v + 1 < V ? lengths[v] : 0));
}

hg_status hg_hair_numbers_create(hg_hair_numbers *numbers, hg_hair_subset *subset, const hg_hair_task *task)
{
    const int64_t n = subset->grooms * subset->n, V = task->groom->vertices;
    *numbers = (hg_hair_numbers){ 0 };
    double *rest = numbers->rest = hg_alloc((size_t)(n * V) * 3, sizeof *rest);
    double *mass = numbers->mass = hg_alloc((size_t)(n * V), sizeof *mass);
    double *body = numbers->body = hg_alloc((size_t)(n * V), sizeof *body);
    double *scalp = numbers->scalp = hg_alloc((size_t)(n * V), sizeof *scalp);
    if (!rest || !mass || !body || !scalp) return HG_MEMORY;
    for (int64_t i = 0; i < n; i++) {
        const hg_hair_style *style = &task->styles[subset->first + i / subset->n];
        const int64_t s = subset->strand[i];
        measure(style->groom, s, linear_density(task), subset->lengths + i * (V - 1), mass + i * V);
        for (int64_t v = 0; v < V; v++) subset->mass[i] += mass[i * V + v];
        for (int64_t k = 0; k < 3 * V; k++) rest[i * 3 * V + k] = (double)style->groom->points[s * 3 * V + k];
        for (int64_t v = 0; v < V; v++) {
            body[i * V + v] = (double)style->body_distance[s * V + v];
            scalp[i * V + v] = (double)style->scalp_distance[s * V + v];
        }
    }
    numbers->attributes[0] = (hg_groom_attribute){ "body_distance", body };
    numbers->attributes[1] = (hg_groom_attribute){ "scalp_distance", scalp };
    numbers->data = (hg_groom_data){ .grooms = subset->grooms,
                                     .strands = subset->n,
                                     .vertices = V,
                                     .rest = rest,
                                     .mass = mass,
                                     .attributes = numbers->attributes,
                                     .n_attributes = 2,
                                     .body = task->tree };
    return HG_OK;
}

void hg_hair_numbers_destroy(hg_hair_numbers *numbers)
{
    hg_free(numbers->rest);
    hg_free(numbers->mass);
    hg_free(numbers->body);
    hg_free(numbers->scalp);
}

static hg_status make_physics(hg_hair_subset *subset, hg_hair_task *task)
{
    hg_hair_numbers numbers;
    hg_status status = hg_hair_numbers_create(&numbers, subset, task);
    if (status == HG_OK)
        status = hg_physics_create(&subset->physics, task->ctx, HG_F32, task->terms.term, task->terms.n, &numbers.data);
    if (status == HG_OK) {
        const char *backend = hg_config_text(task->config, "training.backend");
        if (strcmp(backend, "auto"))
            status = hg_physics_backend(subset->physics,
                                        !strcmp(backend, "compiled") ? HG_BACKEND_COMPILED : HG_BACKEND_INTERPRETER);
    }
    hg_hair_numbers_destroy(&numbers);
    return status;
}

/* Once physics has filled the masses. */
static hg_status place_on_device(hg_hair_subset *subset, hg_hair_task *task)
{
    const hg_groom **grooms = hg_alloc((size_t)subset->grooms, sizeof *grooms);
    subset->weigh = hg_tensor_create(task->ctx, HG_F64, 2, (int64_t[]){ subset->grooms, subset->n });
    hg_status status = grooms && subset->weigh ? hg_tensor_write(subset->weigh, subset->mass) : HG_MEMORY;
    for (int g = 0; grooms && g < subset->grooms; g++) grooms[g] = task->styles[subset->first + g].groom;
    if (status == HG_OK && !hg_ctx_host(task->ctx))
        status =
            hg_roots_create(&subset->roots, task->ctx, task->poser, subset->grooms, grooms, subset->n, subset->strand);
    hg_free(grooms);
    return status;
}

hg_status hg_hair_subset_create(hg_hair_subset *subset, hg_hair_task *task, hg_hair_purpose purpose, int64_t epoch)
{
    *subset = (hg_hair_subset){ 0 };
    const int64_t V = task->groom->vertices;
    hg_status status = draw(subset, task, purpose, epoch);
    if (status == HG_OK) {
        const int64_t n = subset->grooms * subset->n;
        subset->lengths = hg_alloc((size_t)(n * (V - 1)), sizeof(double));
        subset->mass = hg_alloc((size_t)n, sizeof(double));
        if (!subset->lengths || !subset->mass) status = HG_MEMORY;
    }
    if (status == HG_OK) status = hg_hair_subset_features(subset, task);
    if (status == HG_OK) status = make_physics(subset, task);
    if (status == HG_OK) status = place_on_device(subset, task);
    if (status != HG_OK) hg_hair_subset_destroy(subset);
    return status;
}

static hg_status make_rows(hg_hair_subset *subset, const hg_hair_task *task)
{
    const int64_t n = subset->grooms * subset->n, rows = task->network->of_grooms ? subset->grooms : n;
    subset->rest = hg_tensor_create(task->ctx, HG_F32, 3, (int64_t[]){ n, task->groom->vertices, 3 });
    subset->features = hg_tensor_create(task->ctx, HG_F32, 2, (int64_t[]){ rows, task->strand_inputs });
    if (!subset->rest || !subset->features) return HG_MEMORY;
    if (task->asks.q) {
        subset->edges = hg_tensor_create(task->ctx, HG_F32, 3, (int64_t[]){ n, task->groom->vertices - 1, 4 });
        if (!subset->edges) return HG_MEMORY;
    }
    if (!task->styles[subset->first].texel) return HG_OK;
    int32_t *texel = hg_alloc((size_t)n, sizeof *texel);
    subset->texel = hg_tensor_create(task->ctx, HG_I32, 1, &n);
    for (int64_t i = 0; texel && i < n; i++)
        texel[i] = task->styles[subset->first + i / subset->n].texel[subset->strand[i]];
    const hg_status status = texel && subset->texel ? hg_tensor_write(subset->texel, texel) : HG_MEMORY;
    hg_free(texel);
    return status;
}

/* Rest frames of the edges of rest strands [n,V,3]. */
static hg_status write_edges(const hg_hair_subset *subset, const float *rest)
{
    const int64_t V = subset->rest->shape[1];
    float *q = hg_alloc(hg_tensor_bytes(subset->edges) + 1, 1);
    for (int64_t i = 0; q && i < subset->rest->shape[0]; i++)
        hg_hair_edge_frames(rest + i * V * 3, V, q + i * (V - 1) * 4);
    const hg_status status = q ? hg_tensor_write(subset->edges, q) : HG_MEMORY;
    hg_free(q);
    return status;
}

/* Rest strands and normalised features: the latter again when a checkpoint brought another encoder. */
hg_status hg_hair_subset_features(hg_hair_subset *subset, const hg_hair_task *task)
{
    const int64_t V = task->groom->vertices;
    const int width = task->strand_inputs;
    const bool of_grooms = task->network->of_grooms;
    if (!subset->rest) HG_TRY(make_rows(subset, task));
    float *rest = hg_alloc(hg_tensor_bytes(subset->rest) + 1, 1),
          *features = hg_alloc(hg_tensor_bytes(subset->features) + 1, 1);
    for (int64_t i = 0; rest && i < subset->grooms * subset->n; i++)
        memcpy(rest + i * V * 3, task->styles[subset->first + i / subset->n].groom->points + subset->strand[i] * V * 3,
               (size_t)V * 3 * sizeof *rest);
    for (int64_t i = 0; features && i < subset->features->shape[0]; i++) {
        const hg_hair_style *style = &task->styles[subset->first + (of_grooms ? i : i / subset->n)];
        const float *raw = style->raw + (of_grooms ? 0 : subset->strand[i]) * width;
        for (int k = 0; k < width; k++)
            features[i * width + k] = (float)(((double)raw[k] - task->mean[k]) / task->deviation[k]);
    }
    hg_status status = rest && features ? hg_tensor_write(subset->rest, rest) : HG_MEMORY;
    if (status == HG_OK) status = hg_tensor_write(subset->features, features);
    if (status == HG_OK && subset->edges) status = write_edges(subset, rest);
    hg_free(rest);
    hg_free(features);
    return status;
}

void hg_hair_subset_destroy(hg_hair_subset *subset)
{
    hg_physics_destroy(subset->physics);
    hg_tensor_destroy(subset->rest);
    hg_tensor_destroy(subset->edges);
    hg_tensor_destroy(subset->features);
    hg_tensor_destroy(subset->weigh);
    hg_roots_destroy(subset->roots);
    hg_free(subset->lengths);
    hg_free(subset->mass);
    hg_free(subset->strand);
    hg_tensor_destroy(subset->texel);
    *subset = (hg_hair_subset){ 0 };
}

hg_status hg_hair_evaluation_subset(hg_hair_task *task)
{
    if (task->evaluation.n) return HG_OK;
    return hg_hair_subset_create(&task->evaluation, task, HG_HAIR_EVALUATION, 0);
}

/* m g L of the mean strand of the grooms: the unit of the loss; and m g of its mean vertex. */
double hg_hair_reference_energy(const hg_hair_task *task, double *vertex_weight)
{
    const double density = linear_density(task);
    double length = 0, strands = 0;
    for (int g = 0; g < task->n_grooms; g++) {
        const hg_groom *groom = task->styles[g].groom;
        for (int64_t s = 0; s < groom->strands; s++) {
            const float *x = groom->points + s * groom->vertices * 3;
            for (int64_t v = 0; v + 1 < groom->vertices; v++, x += 3)
                length += sqrt(pow((double)x[3] - (double)x[0], 2) + pow((double)x[4] - (double)x[1], 2) +
                               pow((double)x[5] - (double)x[2], 2));
        }
        strands += (double)groom->strands;
    }
    length /= strands;
    *vertex_weight = fmax(density * length * 9.81 / (double)task->groom->vertices, 1e-15);
    return fmax(density * length * 9.81 * length, 1e-12);
}
