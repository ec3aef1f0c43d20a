/* Products of bf16 factors, summed in f32, on the calling thread: oneDNN's matmul primitive, one per shape, made when the
 * shape is first met and kept. What is cut into which blocks is the caller's business, as for f32 (product.c). */
#include "tensor/device.h"

#include <dnnl.h>
#include <omp.h>
#include <pthread.h>
#include <string.h>

enum { SHAPES = 1024 }; /* kept; the blocks of a training have a dozen */

typedef struct {
    int64_t m, n, k, lda, ldb, ldc;
    int64_t ta, tb, add; /* 0 or 1; as wide as the others, so that shapes are compared byte by byte */
} shape;

/* A descriptor is a struct in oneDNN 2 and a handle in oneDNN 3. */
#if DNNL_VERSION_MAJOR >= 3
#define DESCRIPTOR(d_) (d_)
typedef const_dnnl_memory_desc_t descriptor;
#else
#define DESCRIPTOR(d_) (&(d_))
typedef const dnnl_memory_desc_t *descriptor;
#endif

typedef struct product {
    shape shape;
    dnnl_primitive_t primitive;
    dnnl_primitive_desc_t description; /* owns the scratchpad's descriptor */
    dnnl_memory_desc_t a, b, c;
    descriptor scratchpad;
    size_t scratchpad_bytes;
    struct product *next;
} product;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static dnnl_engine_t engine;
static product *_Atomic products; /* only ever grows, at the front: read without the lock */
static int n_products;

/* ---- what a thread needs ---- */

typedef struct {
    dnnl_stream_t stream;
    void *scratchpad;
    size_t bytes;
} worker;

static pthread_key_t key;
static pthread_once_t once = PTHREAD_ONCE_INIT;
static bool key_made;

static void free_worker(void *memory)
{
    worker *w = memory;
    if (w->stream) dnnl_stream_destroy(w->stream);
    hg_free(w->scratchpad);
    hg_free(w);
}

static void make_key(void) { key_made = pthread_key_create(&key, free_worker) == 0; }

static worker *this_worker(size_t bytes)
{
    pthread_once(&once, make_key);
    if (!key_made) return NULL;
    worker *w = pthread_getspecific(key);
    if (!w) {
        w = hg_alloc(1, sizeof *w);
        if (!w || dnnl_stream_create(&w->stream, engine, dnnl_stream_default_flags) != dnnl_success ||
            pthread_setspecific(key, w) != 0) {
            if (w) free_worker(w);
            return NULL;
        }
    }
    if (bytes > w->bytes) {
        void *scratchpad = hg_alloc(1, bytes);
        if (!scratchpad) return NULL;
        hg_free(w->scratchpad);
        w->scratchpad = scratchpad;
        w->bytes = bytes;
    }
    return w;
}

/* ---- one primitive per shape ---- */

static bool describe(dnnl_memory_desc_t *d, int64_t rows, int64_t columns, dnnl_data_type_t type, int64_t down,
                     int64_t across)
{
    const dnnl_dims_t sizes = { rows, columns }, strides = { down, across };
#if DNNL_VERSION_MAJOR >= 3
    return dnnl_memory_desc_create_with_strides(d, 2, sizes, type, strides) == dnnl_success;
#else
    return dnnl_memory_desc_init_by_strides(d, 2, sizes, type, strides) == dnnl_success;
#endif
}

static bool set_attributes(dnnl_primitive_attr_t attributes, bool add)
{
    if (dnnl_primitive_attr_set_scratchpad_mode(attributes, dnnl_scratchpad_mode_user) != dnnl_success) return false;
    if (!add) return true;
    dnnl_post_ops_t post = NULL;
    if (dnnl_post_ops_create(&post) != dnnl_success) return false;
#if DNNL_VERSION_MAJOR >= 3
    bool good = dnnl_post_ops_append_sum(post, 1.0f, 0, dnnl_data_type_undef) == dnnl_success;
#else
    bool good = dnnl_post_ops_append_sum(post, 1.0f) == dnnl_success;
#endif
    good = good && dnnl_primitive_attr_set_post_ops(attributes, post) == dnnl_success;
    dnnl_post_ops_destroy(post);
    return good;
}

static bool make_primitive(product *p, dnnl_primitive_attr_t attributes)
{
    const shape *s = &p->shape;
    if (!set_attributes(attributes, s->add) ||
        !describe(&p->a, s->m, s->k, dnnl_bf16, s->ta ? 1 : s->lda, s->ta ? s->lda : 1) ||
        !describe(&p->b, s->k, s->n, dnnl_bf16, s->tb ? 1 : s->ldb, s->tb ? s->ldb : 1) ||
        !describe(&p->c, s->m, s->n, dnnl_f32, s->ldc, 1))
        return false;
#if DNNL_VERSION_MAJOR >= 3
    if (dnnl_matmul_primitive_desc_create(&p->description, engine, p->a, p->b, NULL, p->c, attributes) != dnnl_success)
        return false;
#else
    dnnl_matmul_desc_t matmul;
    if (dnnl_matmul_desc_init(&matmul, &p->a, &p->b, NULL, &p->c) != dnnl_success ||
        dnnl_primitive_desc_create(&p->description, &matmul, attributes, engine, NULL) != dnnl_success)
        return false;
#endif
    p->scratchpad = dnnl_primitive_desc_query_md(p->description, dnnl_query_scratchpad_md, 0);
    p->scratchpad_bytes = p->scratchpad ? dnnl_memory_desc_get_size(p->scratchpad) : 0;
    return dnnl_primitive_create(&p->primitive, p->description) == dnnl_success;
}

static void destroy(product *p)
{
    if (!p) return;
    if (p->primitive) dnnl_primitive_destroy(p->primitive);
    if (p->description) dnnl_primitive_desc_destroy(p->description);
#if DNNL_VERSION_MAJOR >= 3
    if (p->a) dnnl_memory_desc_destroy(p->a);
    if (p->b) dnnl_memory_desc_destroy(p->b);
    if (p->c) dnnl_memory_desc_destroy(p->c);
#endif
    hg_free(p);
}

static product *find(const shape *s)
{
    for (product *p = products; p; p = p->next)
        if (memcmp(&p->shape, s, sizeof *s) == 0) return p;
    return NULL;
}

/* The product of this shape; NULL when oneDNN has none, or there are too many of them. */
static product *product_of(const shape *s)
{
    product *p = find(s);
    if (p) return p;
    pthread_mutex_lock(&lock);
    p = find(s);
    dnnl_primitive_attr_t attributes = NULL;
    if (!p && n_products < SHAPES && (engine || dnnl_engine_create(&engine, dnnl_cpu, 0) == dnnl_success) &&
        dnnl_primitive_attr_create(&attributes) == dnnl_success && (p = hg_alloc(1, sizeof *p))) {
        p->shape = *s;
        if (make_primitive(p, attributes)) {
            p->next = products;
            n_products++;
            products = p;
        } else {
            destroy(p);
            p = NULL;
        }
    }
    if (attributes) dnnl_primitive_attr_destroy(attributes);
    pthread_mutex_unlock(&lock);
    return p;
}

static bool run(const shape *s, const uint16_t *a, const uint16_t *b, float *c)
{
    const product *p = product_of(s);
    worker *w = p ? this_worker(p->scratchpad_bytes + 64) : NULL;
    if (!w) return false;
    dnnl_memory_t memory[4] = { NULL };
    bool good =
        dnnl_memory_create(&memory[0], DESCRIPTOR(p->a), engine, (void *)(uintptr_t)a) == dnnl_success &&
        dnnl_memory_create(&memory[1], DESCRIPTOR(p->b), engine, (void *)(uintptr_t)b) == dnnl_success &&
        dnnl_memory_create(&memory[2], DESCRIPTOR(p->c), engine, c) == dnnl_success &&
        (!p->scratchpad || dnnl_memory_create(&memory[3], p->scratchpad, engine, w->scratchpad) == dnnl_success);
    const dnnl_exec_arg_t arguments[4] = { { DNNL_ARG_SRC, memory[0] },
                                           { DNNL_ARG_WEIGHTS, memory[1] },
                                           { DNNL_ARG_DST, memory[2] },
                                           { DNNL_ARG_SCRATCHPAD, memory[3] } };
    good = good && dnnl_primitive_execute(p->primitive, w->stream, p->scratchpad ? 4 : 3, arguments) == dnnl_success &&
           dnnl_stream_wait(w->stream) == dnnl_success;
    for (int i = 0; i < 4; i++)
        if (memory[i]) dnnl_memory_destroy(memory[i]);
    return good;
}

bool hg_cpu_has_bf16(void)
{
#if defined(__x86_64__) && (defined(__GNUC__) || defined(__clang__))
    return __builtin_cpu_supports("avx512bf16") != 0;
#else
    return false;
#endif
}

void hg_cpu_product_bf16(bool ta, bool tb, int64_t m, int64_t n, int64_t k, const uint16_t *a, int64_t lda,
                         const uint16_t *b, int64_t ldb, bool add, float *c, int64_t ldc)
{
    const shape s = { m, n, k, lda, ldb, ldc, ta, tb, add };
    /* One thread, both when a primitive is made and when it runs: see product_f32. */
    int threads = omp_get_max_threads();
    if (threads != 1) omp_set_num_threads(1);
    bool done = k > 0 && run(&s, a, b, c);
    if (threads != 1) omp_set_num_threads(threads);
    if (done) return;
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < n; j++) {
            float sum = 0;
            for (int64_t p = 0; p < k; p++)
                sum += hg_f32_from_bf16(ta ? a[p * lda + i] : a[i * lda + p]) *
                       hg_f32_from_bf16(tb ? b[j * ldb + p] : b[p * ldb + j]);
            c[i * ldc + j] = sum + (add ? c[i * ldc + j] : 0);
        }
}
