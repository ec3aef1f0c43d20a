/* A skeleton with a clip on it, as a motion file has it. */
#include "scene/clip.h"

#include <string.h>

hg_status clip_create(hg_clip **out, int64_t joints)
{
    hg_clip *clip = *out = hg_alloc(1, sizeof *clip);
    if (!clip) return HG_MEMORY;
    clip->joints = joints;
    clip->name = hg_alloc((size_t)joints, sizeof *clip->name);
    clip->parent = hg_alloc((size_t)joints, sizeof *clip->parent);
    clip->offset = hg_alloc((size_t)joints, 3 * sizeof *clip->offset);
    if (!clip->name || !clip->parent || !clip->offset) return HG_MEMORY;
    for (int64_t j = 0; j < joints; j++) clip->parent[j] = -1;
    return HG_OK;
}

hg_status clip_frames(hg_clip *clip, int64_t frames)
{
    clip->frames = frames;
    clip->rotation = hg_alloc((size_t)(frames * clip->joints), 4 * sizeof *clip->rotation);
    clip->translation = hg_alloc((size_t)frames, 3 * sizeof *clip->translation);
    if (!clip->rotation || !clip->translation) return HG_MEMORY;
    for (int64_t i = 0; i < frames * clip->joints; i++) clip->rotation[4 * i] = 1;
    return HG_OK;
}

int clip_joint(const hg_clip *clip, const char *name)
{
    for (int j = 0; j < clip->joints; j++)
        if (clip->name[j] && strcmp(clip->name[j], name) == 0) return j;
    return -1;
}

void hg_clip_destroy(hg_clip *clip)
{
    if (!clip) return;
    for (int64_t j = 0; clip->name && j < clip->joints; j++) hg_free(clip->name[j]);
    hg_free(clip->name);
    hg_free(clip->parent);
    hg_free(clip->offset);
    hg_free(clip->rotation);
    hg_free(clip->translation);
    hg_free(clip);
}
