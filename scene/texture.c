/* Grooms as images over the scalp UV: which strand a texel holds, strands drawn into images and read back, and the rows of
 * strands in the images that a network makes. */
#include "scene/scene.h"

#include "autograd/autograd.h"

#include <math.h>
#include <string.h>

enum { LARGEST = 4096 }; /* texels of a side */

void hg_texture_destroy(hg_texture *texture)
{
    if (!texture) return;
    hg_free(texture->strand);
    hg_free(texture->texel);
    hg_free(texture->kept_strand);
    hg_free(texture->kept_texel);
    hg_free(texture->mask);
    hg_free(texture);
}

/* Squared, in texels. */
static double from_centre(const float uv[2], int64_t size, int64_t texel)
{
    const double u = (double)uv[0] * (double)size - ((double)(texel % size) + 0.5),
                 v = (double)uv[1] * (double)size - ((double)(texel / size) + 0.5);
    return u * u + v * v;
}

static int64_t along(float uv, int64_t size)
{
    const int64_t at = (int64_t)((double)uv * (double)size);
    return at < size ? at : size - 1; /* 1 belongs to the last one */
}

static hg_status check_roots(const hg_groom *groom)
{
    bool found = false;
    for (int64_t s = 0; groom->root_uv && s < groom->strands; s++) {
        const float *uv = groom->root_uv + 2 * s;
        if (!(uv[0] >= 0 && uv[0] <= 1 && uv[1] >= 0 && uv[1] <= 1))
            return hg_fail(
                HG_INVALID,
                "texture of a groom: strand %lld has root UV (%g, %g), expected numbers from 0 to 1; fit the "
                "groom to a body, which gives its roots the UV of the scalp",
                (long long)s, (double)uv[0], (double)uv[1]);
        found |= uv[0] != 0 || uv[1] != 0;
    }
    if (found) return HG_OK;
    return hg_fail(HG_INVALID,
                   "texture of a groom: %s; fit the groom to a body, which gives its roots the UV of the scalp",
                   groom->strands ? "no strand has a root UV" : "the groom has no strands");
}

hg_status hg_texture_create(hg_texture **texture, const hg_groom *groom, int64_t size)
{
    *texture = NULL;
    if (size < 2 || size > LARGEST)
        return hg_fail(HG_INVALID, "texture of a groom: %lld texels a side, expected 2 to %d", (long long)size,
                       (int)LARGEST);
    HG_TRY(check_roots(groom));
    const size_t texels = (size_t)(size * size), strands = (size_t)groom->strands;
    hg_texture *t = hg_alloc(1, sizeof *t);
    if (!t) return HG_MEMORY;
    t->size = size, t->strands = groom->strands;
    t->strand = hg_alloc(texels, sizeof *t->strand);
    t->texel = hg_alloc(strands, sizeof *t->texel);
    t->mask = hg_alloc(texels, sizeof *t->mask);
    if (!t->strand || !t->texel || !t->mask) goto failed;
    for (size_t i = 0; i < texels; i++) t->strand[i] = -1;
    for (int64_t s = 0; s < groom->strands; s++) {
        const float *uv = groom->root_uv + 2 * s;
        const int64_t texel = along(uv[1], size) * size + along(uv[0], size), other = t->strand[texel];
        t->texel[s] = -1;
        if (other >= 0) {
            if (from_centre(uv, size, texel) >= from_centre(groom->root_uv + 2 * other, size, texel)) continue;
            t->texel[other] = -1;
        }
        t->kept += other < 0;
        t->strand[texel] = (int32_t)s;
        t->texel[s] = (int32_t)texel;
    }
    t->left_out = t->strands - t->kept;
    t->kept_strand = hg_alloc((size_t)t->kept, sizeof *t->kept_strand);
    t->kept_texel = hg_alloc((size_t)t->kept, sizeof *t->kept_texel);
    if (!t->kept_strand || !t->kept_texel) goto failed;
    for (int64_t s = 0, n = 0; s < t->strands; s++) {
        if (t->texel[s] < 0) continue;
        t->kept_strand[n] = (int32_t)s, t->kept_texel[n++] = t->texel[s];
        t->mask[t->texel[s]] = 1;
    }
    *texture = t;
    return HG_OK;
failed:
    hg_texture_destroy(t);
    return HG_MEMORY;
}

/* ---- strands into images and back --------------------------------------------------------------------------- */

void hg_texture_draw(const hg_texture *texture, int64_t channels, const float *strands, float *image)
{
    const int64_t texels = texture->size * texture->size;
    memset(image, 0, (size_t)(channels * texels) * sizeof *image);
    for (int64_t i = 0; i < texture->kept; i++)
        for (int64_t c = 0; c < channels; c++)
            image[c * texels + texture->kept_texel[i]] = strands[texture->kept_strand[i] * channels + c];
}

void hg_texture_pick(const hg_texture *texture, int64_t channels, const float *image, float *kept)
{
    const int64_t texels = texture->size * texture->size;
    for (int64_t i = 0; i < texture->kept; i++)
        for (int64_t c = 0; c < channels; c++) kept[i * channels + c] = image[c * texels + texture->kept_texel[i]];
}

hg_status hg_texture_groom(hg_groom **groom, const hg_texture *texture, const hg_groom *from, const float *image)
{
    *groom = NULL;
    if (from->strands != texture->strands)
        return hg_fail(HG_INVALID, "texture of a groom: it was made of %lld strands, and this groom has %lld",
                       (long long)texture->strands, (long long)from->strands);
    hg_groom *g;
    HG_TRY(hg_groom_create(&g, texture->kept, from->vertices));
    const int64_t row = 3 * from->vertices;
    for (int64_t i = 0; i < texture->kept; i++) {
        const int64_t s = texture->kept_strand[i];
        memcpy(g->points + i * row, from->points + s * row, (size_t)row * sizeof *g->points);
        g->root_face[i] = from->root_face[s];
        memcpy(g->root_bary + 3 * i, from->root_bary + 3 * s, 3 * sizeof *g->root_bary);
        memcpy(g->root_uv + 2 * i, from->root_uv + 2 * s, 2 * sizeof *g->root_uv);
    }
    if (image) hg_texture_pick(texture, row, image, g->points);
    g->body_hash = from->body_hash;
    if (from->name && !(g->name = hg_strdup(from->name))) {
        hg_groom_destroy(g);
        return HG_MEMORY;
    }
    *groom = g;
    return HG_OK;
}

/* ---- rows of a network's images ----------------------------------------------------------------------------- */

hg_status hg_texture_places(const hg_texture *texture, int64_t image, int64_t n, const int32_t *strand, int32_t *places)
{
    const int64_t texels = texture->size * texture->size;
    if (image < 0 || image >= INT32_MAX / texels)
        return hg_fail(HG_INVALID, "texture of a groom: image %lld of %lld x %lld texels: indices end at 2^31",
                       (long long)image, (long long)texture->size, (long long)texture->size);
    if (!strand && n > texture->kept)
        return hg_fail(HG_INVALID, "texture of a groom: %lld strands are asked for, and %lld have a texel",
                       (long long)n, (long long)texture->kept);
    for (int64_t i = 0; i < n; i++) {
        const int64_t s = strand ? strand[i] : texture->kept_strand[i];
        if (s < 0 || s >= texture->strands)
            return hg_fail(HG_INVALID, "texture of a groom: there is no strand %lld among %lld", (long long)s,
                           (long long)texture->strands);
        if (texture->texel[s] < 0)
            return hg_fail(HG_INVALID,
                           "texture of a groom: strand %lld was left out, another one is nearer to the centre of its "
                           "texel; ask for strands that have one (kept_strand)",
                           (long long)s);
        places[i] = (int32_t)(image * texels + texture->texel[s]);
    }
    return HG_OK;
}

hg_tensor *hg_texture_gather(hg_ctx *ctx, hg_tensor *images, hg_tensor *places)
{
    if (!images || !places) return NULL;
    if (images->rank != 4) {
        char text[96];
        hg_ctx_fail(ctx, HG_INVALID, "hg_texture_gather: images are [images,channels,T,T], not %s",
                    hg_shape_text(images, text));
        return NULL;
    }
    hg_tensor *last = hg_permute(ctx, images, (int[]){ 0, 2, 3, 1 });
    return hg_gather(ctx, hg_reshape(ctx, last, 2, (int64_t[]){ -1, images->shape[1] }), places);
}
