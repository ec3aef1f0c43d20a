/* The example of export/export.h, run with a network of one multiplication. */
#include "export/export.h"

#include <stdio.h>
#include <unistd.h>

static hg_tensor *forward(void *self, hg_ctx *ctx, hg_tensor *input) { return hg_matmul(ctx, input, self); }

int main(int count, char **words)
{
    hg_ctx *ctx;
    hg_vtkhdf *file = NULL;
    hg_image *image;
    const int64_t frames = 2, strands = 3, vertices = 4;
    static const float points[3 * 4 * 3] = { 0 };
    if (count < 2 || chdir(words[1]) != 0 || hg_ctx_create(&ctx, &(hg_ctx_options){ .threads = 1 }) != HG_OK) return 1;
    if (hg_image_create(&image, 8, 8, (uint8_t[3]){ 1, 2, 3 }) != HG_OK) return 2;
    hg_tensor *self = hg_tensor_create(ctx, HG_F32, 2, (int64_t[]){ 748, 72 });
#include "example.inc"
    hg_status status = file == NULL ? HG_INVALID : hg_vtkhdf_add(file, points);
    if (status == HG_OK) status = hg_vtkhdf_add(file, points);
    if (status == HG_OK) status = hg_vtkhdf_commit(file);
    int wrong = status != HG_OK || !hg_file_exists("model.onnx") || !hg_file_exists("drape.vtkhdf") ||
                !hg_file_exists("drape.png");
    if (wrong) fprintf(stderr, "%s\n", hg_message());
    hg_tensor_destroy(self);
    hg_image_destroy(image);
    hg_ctx_destroy(ctx);
    return wrong;
}
