/* Tensors: making, moving, viewing, converting. */
#include "tensor/context.h"
#include "tensor/tensor.kernel.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- bf16 ---- */

uint16_t hg_bf16_from_f32(float x) { return bf16_of_f32(x); }
float hg_f32_from_bf16(uint16_t x) { return f32_of_bf16(x); }

/* ---- making ---- */

int64_t hg_tensor_count(const hg_tensor *tensor)
{
    int64_t count = 1;
    for (int i = 0; i < tensor->rank; i++) count *= tensor->shape[i];
    return count;
}

size_t hg_tensor_bytes(const hg_tensor *tensor)
{
    return (size_t)hg_tensor_count(tensor) * hg_dtype_size(tensor->dtype);
}

const char *hg_shape_text(const hg_tensor *tensor, char text[96])
{
    if (!tensor) return memcpy(text, "NULL", 5), text;
    int at = snprintf(text, 96, "%s [", hg_dtype_name(tensor->dtype));
    for (int i = 0; i < tensor->rank && at < 94; i++)
        at += snprintf(text + at, (size_t)(96 - at), "%s%lld", i ? "," : "", (long long)tensor->shape[i]);
    if (at < 95) snprintf(text + at, (size_t)(96 - at), "]");
    return text;
}

/* Checks a shape and gives its bytes; the header of the tensor is filled but for its data. */
static hg_status describe(hg_tensor *tensor, hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape)
{
    if (rank < 0 || rank > HG_MAX_RANK)
        return hg_ctx_fail(ctx, HG_INVALID, "a tensor of %d axes: 0 to %d are possible", rank, HG_MAX_RANK);
    if (hg_dtype_size(dtype) == 0) return hg_ctx_fail(ctx, HG_INVALID, "%d is no dtype", (int)dtype);
    *tensor = (hg_tensor){ .ctx = ctx, .rank = rank, .dtype = dtype };
    int64_t count = (int64_t)hg_dtype_size(dtype);
    for (int i = 0; i < HG_MAX_RANK; i++) {
        tensor->shape[i] = i < rank ? shape[i] : 1;
        if (tensor->shape[i] < 0)
            return hg_ctx_fail(ctx, HG_INVALID, "axis %d of a tensor has %lld elements", i, (long long)shape[i]);
        if (__builtin_mul_overflow(count, tensor->shape[i], &count))
            return hg_ctx_fail(ctx, HG_MEMORY, "a tensor whose size does not fit in 64 bits");
    }
    return HG_OK;
}

/* Why a device had no memory: what is free there. */
static const char *device_says(const hg_ctx *ctx)
{
    static _Thread_local char text[256];
    text[0] = 0;
    if (!ctx->device->host) snprintf(text, sizeof text, " (%s)", hg_message());
    return text;
}

hg_tensor *hg_tensor_wrap(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, void *data)
{
    if (ctx->status != HG_OK) return NULL;
    hg_tensor *tensor = hg_step_alloc(ctx, sizeof *tensor);
    if (!tensor || describe(tensor, ctx, dtype, rank, shape) != HG_OK) return NULL;
    tensor->data = data;
    return tensor;
}

hg_tensor *hg_tensor_make(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape)
{
    hg_tensor *tensor = hg_tensor_wrap(ctx, dtype, rank, shape, NULL);
    if (!tensor) return NULL;
    char text[96];
    tensor->data = hg_arena_alloc(&ctx->data, hg_tensor_bytes(tensor));
    if (!tensor->data) {
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: %s takes %zu bytes beside the %zu of this step%s",
                    hg_shape_text(tensor, text), hg_tensor_bytes(tensor), hg_step_bytes(ctx), device_says(ctx));
        return NULL;
    }
    return tensor;
}

hg_tensor *hg_tensor_from(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape, const void *host)
{
    if (ctx->device->host) return hg_tensor_wrap(ctx, dtype, rank, shape, (void *)(uintptr_t)host);
    hg_tensor *tensor = hg_tensor_make(ctx, dtype, rank, shape);
    return tensor && hg_tensor_write(tensor, host) == HG_OK ? tensor : NULL;
}

hg_tensor *hg_tensor_create(hg_ctx *ctx, hg_dtype dtype, int rank, const int64_t *shape)
{
    if (ctx->status != HG_OK) return NULL;
    hg_tensor *tensor = hg_alloc(1, sizeof *tensor);
    if (!tensor) {
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: a tensor");
        return NULL;
    }
    if (describe(tensor, ctx, dtype, rank, shape) != HG_OK) goto failed;
    char text[96];
    size_t bytes = hg_tensor_bytes(tensor);
    tensor->owned = true;
    tensor->data = ctx->device->alloc(ctx->device, bytes ? bytes : HG_ALIGNMENT);
    if (!tensor->data) {
        hg_ctx_fail(ctx, HG_MEMORY, "out of memory: %s takes %zu bytes%s", hg_shape_text(tensor, text), bytes,
                    device_says(ctx));
        goto failed;
    }
    if (hg_tensor_fill(tensor, 0) == HG_OK) return tensor;
    ctx->device->free(ctx->device, tensor->data);
failed:
    hg_free(tensor);
    return NULL;
}

void hg_tensor_destroy(hg_tensor *tensor)
{
    if (!tensor || !tensor->owned) return;
    hg_ctx *ctx = tensor->ctx;
    for (int i = 0; i < HG_HOOKS; i++)
        if (ctx->on_tensor_destroy[i]) ctx->on_tensor_destroy[i](tensor);
    if (!tensor->base) ctx->device->free(ctx->device, tensor->data);
    hg_free(tensor);
}

hg_tensor *hg_tensor_rows(hg_ctx *ctx, hg_tensor *tensor, int64_t first, int64_t count)
{
    if (ctx->status != HG_OK || !tensor) return NULL;
    char text[96];
    if (tensor->rank == 0 || first < 0 || count < 0 || first > tensor->shape[0] - count) {
        hg_ctx_fail(ctx, HG_INVALID, "rows: %lld rows from row %lld of %s", (long long)count, (long long)first,
                    hg_shape_text(tensor, text));
        return NULL;
    }
    int64_t shape[HG_MAX_RANK];
    memcpy(shape, tensor->shape, sizeof shape);
    shape[0] = count;
    int64_t row = tensor->shape[0] ? hg_tensor_count(tensor) / tensor->shape[0] : 0;
    size_t offset = (size_t)(first * row) * hg_dtype_size(tensor->dtype);
    hg_tensor *view = hg_tensor_wrap(ctx, tensor->dtype, tensor->rank, shape, (unsigned char *)tensor->data + offset);
    if (view) view->base = tensor;
    return view;
}

/* A view that is written to changes what it looks into. */
void hg_tensor_touch(hg_tensor *tensor)
{
    for (; tensor; tensor = tensor->base) tensor->version++;
}

/* ---- data ---- */

hg_status hg_tensor_write(hg_tensor *tensor, const void *from)
{
    size_t bytes = hg_tensor_bytes(tensor);
    if (bytes) HG_TRY(tensor->ctx->device->upload(tensor->ctx->device, tensor->data, from, bytes));
    hg_tensor_touch(tensor);
    return HG_OK;
}

hg_status hg_tensor_read(const hg_tensor *tensor, void *to)
{
    size_t bytes = hg_tensor_bytes(tensor);
    return bytes ? tensor->ctx->device->download(tensor->ctx->device, to, tensor->data, bytes) : HG_OK;
}

hg_status hg_tensor_fill(hg_tensor *tensor, double value)
{
    const fill_args args = { tensor->data, value, (int)tensor->dtype };
    if (tensor->dtype == HG_I32 && !(value >= INT32_MIN && value <= INT32_MAX))
        return hg_ctx_fail(tensor->ctx, HG_INVALID, "fill: %g does not fit in i32", value);
    HG_TRY(hg_launch(tensor->ctx, &fill_kernel, hg_tensor_count(tensor), &args));
    hg_tensor_touch(tensor);
    return HG_OK;
}

hg_status hg_tensor_copy(hg_tensor *to, const hg_tensor *from)
{
    char a[96], b[96];
    if (hg_tensor_count(to) != hg_tensor_count(from))
        return hg_ctx_fail(to->ctx, HG_INVALID, "copy: %s into %s: the counts differ", hg_shape_text(from, a),
                           hg_shape_text(to, b));
    const copy_args args = { to->data, from->data, (int)to->dtype, (int)from->dtype };
    HG_TRY(hg_launch(to->ctx, &copy_kernel, hg_tensor_count(to), &args));
    hg_tensor_touch(to);
    return HG_OK;
}

hg_status hg_tensor_numbers(const hg_tensor *tensor, double *to)
{
    const int64_t n = hg_tensor_count(tensor);
    void *copy = NULL;
    if (!tensor->ctx->device->host) {
        copy = hg_alloc(hg_tensor_bytes(tensor) + 1, 1);
        if (!copy) return HG_MEMORY;
        const hg_status status = hg_tensor_read(tensor, copy);
        if (status != HG_OK) {
            hg_free(copy);
            return status;
        }
    }
    for (int64_t i = 0; i < n; i++) to[i] = number_at(copy ? copy : tensor->data, (int)tensor->dtype, i);
    hg_free(copy);
    return HG_OK;
}

double hg_tensor_item(const hg_tensor *tensor, int64_t i)
{
    if (!tensor || i < 0 || i >= hg_tensor_count(tensor)) return (double)NAN;
    unsigned char bytes[8];
    size_t size = hg_dtype_size(tensor->dtype);
    const unsigned char *at = (const unsigned char *)tensor->data + (size_t)i * size;
    if (tensor->ctx->device->download(tensor->ctx->device, bytes, at, size) != HG_OK) return (double)NAN;
    double value = 0;
    switch (tensor->dtype) {
    case HG_F32: {
        float x;
        memcpy(&x, bytes, sizeof x);
        value = (double)x;
        break;
    }
    case HG_F64: {
        memcpy(&value, bytes, sizeof value);
        break;
    }
    case HG_I32: {
        int32_t x;
        memcpy(&x, bytes, sizeof x);
        value = x;
        break;
    }
    case HG_BF16: {
        uint16_t x;
        memcpy(&x, bytes, sizeof x);
        value = (double)hg_f32_from_bf16(x);
        break;
    }
    case HG_TF32:
        break;
    }
    return value;
}
