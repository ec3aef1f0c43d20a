/* Biovision .bvh: a hierarchy of joints with offsets and channels, then one line of channel values per frame.
 *
 * Channels are applied in the order given: rotations Z, Y, X mean Rz Ry Rx. Positions of joints other than the root are
 * passed over. A first frame with an unturned root, whole degrees and nearly all of them zero is a T-pose that
 * converters put before a clip, and is dropped.
 * A .bvh stores no unit. It is taken to be that of the CMU skeletons unless another one makes the legs human; and in
 * some files offsets are in another power of ten than the root's track: they are brought to the scale of the track. */
#include "scene/clip.h"
#include "scene/lines.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    int32_t joint;
    int8_t axis;
    bool rotation;
} channel;
typedef struct {
    hg_clip *clip;
    int64_t joint_capacity, channel_capacity, channels;
    channel *channel;
} builder;

static hg_status expect(hg_lines *lines, const char *text)
{
    hg_word word;
    if (!hg_lines_flow(lines, &word)) return hg_lines_fail(lines, "the file ends where \"%s\" is expected", text);
    if (!hg_word_is_any_case(word, text))
        return hg_lines_fail(lines, "\"%.*s\" where \"%s\" is expected", hg_word_length(word), word.at, text);
    return HG_OK;
}

static hg_status read_offset(hg_lines *lines, double offset[3])
{
    HG_TRY(expect(lines, "OFFSET"));
    for (int k = 0; k < 3; k++) HG_TRY(hg_lines_number(lines, &offset[k], "OFFSET"));
    return HG_OK;
}

static hg_status read_channels(builder *b, hg_lines *lines, int joint)
{
    hg_word word;
    int64_t count;
    if (!hg_lines_word(lines, &word) || !hg_word_integer(word, &count) || count < 0 || count > 6)
        return hg_lines_fail(lines, "CHANNELS is not followed by a number from 0 to 6");
    for (int64_t i = 0; i < count; i++) {
        static const char *const names[] = { "Xposition", "Yposition", "Zposition",
                                             "Xrotation", "Yrotation", "Zrotation" };
        if (!hg_lines_word(lines, &word))
            return hg_lines_fail(lines, "%lld channels announced, %lld named", (long long)count, (long long)i);
        int kind = 0;
        while (kind < 6 && !hg_word_is_any_case(word, names[kind])) kind++;
        if (kind == 6) return hg_lines_fail(lines, "\"%.*s\" is not a channel", hg_word_length(word), word.at);
        if (b->channels == b->channel_capacity) {
            int64_t larger = 2 * b->channel_capacity + 64;
            channel *bigger = hg_resize(b->channel, (size_t)b->channel_capacity, (size_t)larger, sizeof *bigger);
            if (!bigger) return HG_MEMORY;
            b->channel = bigger;
            b->channel_capacity = larger;
        }
        b->channel[b->channels++] = (channel){ joint, (int8_t)(kind % 3), kind >= 3 };
    }
    return HG_OK;
}

/* A joint that was just named, up to its opening brace, offset and channels. */
static hg_status read_joint(builder *b, hg_lines *lines, int parent, int *joint)
{
    hg_clip *clip = b->clip;
    hg_word word;
    if (!hg_lines_word(lines, &word)) return hg_lines_fail(lines, "a joint without a name");
    if (clip->joints == CLIP_MAX_JOINTS) return hg_lines_fail(lines, "more than %d joints", CLIP_MAX_JOINTS);
    int j = *joint = (int)clip->joints;
    if (!(clip->name[j] = hg_word_copy(word))) return HG_MEMORY;
    clip->joints++;
    if (clip_joint(clip, clip->name[j]) != j) return hg_lines_fail(lines, "a second joint \"%s\"", clip->name[j]);
    clip->parent[j] = parent;
    HG_TRY(expect(lines, "{"));
    HG_TRY(read_offset(lines, clip->offset + 3 * j));
    HG_TRY(expect(lines, "CHANNELS"));
    return read_channels(b, lines, j);
}

static hg_status read_hierarchy(builder *b, hg_lines *lines)
{
    hg_word word;
    HG_TRY(expect(lines, "HIERARCHY"));
    HG_TRY(expect(lines, "ROOT"));
    int at;
    HG_TRY(read_joint(b, lines, -1, &at));
    while (at >= 0) {
        if (!hg_lines_flow(lines, &word)) return hg_lines_fail(lines, "the file ends inside the hierarchy");
        if (hg_word_is_any_case(word, "JOINT")) {
            HG_TRY(read_joint(b, lines, at, &at));
        } else if (hg_word_is_any_case(word, "End")) {
            double end[3];
            HG_TRY(expect(lines, "Site"));
            HG_TRY(expect(lines, "{"));
            HG_TRY(read_offset(lines, end));
            HG_TRY(expect(lines, "}"));
        } else if (hg_word_is(word, "}")) {
            at = b->clip->parent[at];
        } else {
            return hg_lines_fail(lines, "\"%.*s\" where JOINT, End Site or } is expected", hg_word_length(word),
                                 word.at);
        }
    }
    return HG_OK;
}

static hg_status read_motion(builder *b, hg_lines *lines)
{
    hg_clip *clip = b->clip;
    hg_word word;
    int64_t frames;
    double time;
    HG_TRY(expect(lines, "MOTION"));
    HG_TRY(expect(lines, "Frames:"));
    if (b->channels < 3 || 4 * b->channels < clip->joints)
        return hg_lines_fail(lines, "%lld channels are too few for %lld joints", (long long)b->channels,
                             (long long)clip->joints);
    /* a value takes at least a digit and a separator, so that the file bounds what may be asked for */
    if (!hg_lines_word(lines, &word) || !hg_word_integer(word, &frames) || frames < 1 ||
        (uint64_t)frames > hg_lines_left(lines) / (2 * (uint64_t)b->channels) + 1)
        return hg_lines_fail(
            lines, "Frames: is not a number of frames of %lld channels that the file can hold; it may be truncated",
            (long long)b->channels);
    HG_TRY(expect(lines, "Frame"));
    HG_TRY(expect(lines, "Time:"));
    HG_TRY(hg_lines_number(lines, &time, "Frame Time"));
    if (!(time > 1e-5 && time < 1e3)) return hg_lines_fail(lines, "a Frame Time of %g s", time);
    /* written with few digits: a rate within 0.01 % of a whole number is meant to be that number */
    double rate = 1 / time, whole = round(rate);
    clip->rate = fabs(rate - whole) < 1e-4 * whole ? whole : rate;
    HG_TRY(clip_frames(clip, frames));
    bool t_pose[2] = { false, false }; /* whether the first and the second frame look like one */
    for (int64_t t = 0; t < frames; t++) {
        int64_t zero = 0, odd = 0; /* rotations that are zero; that no T-pose has */
        for (int64_t c = 0; c < b->channels; c++) {
            double value;
            if (!hg_lines_flow(lines, &word))
                return hg_lines_fail(lines, "the file ends in frame %lld of %lld; it is truncated", (long long)t,
                                     (long long)frames);
            if (!hg_word_number(word, &value))
                return hg_lines_fail(lines, "frame %lld: \"%.*s\" is not a finite number", (long long)t,
                                     hg_word_length(word), word.at);
            const channel *what = b->channel + c;
            double *q = clip->rotation + 4 * (t * clip->joints + what->joint);
            zero += what->rotation && value == 0;
            odd += what->rotation && (value != round(value) || (what->joint == 0 && value != 0));
            if (what->rotation)
                hg_quatd_store(q, hg_quatd_mul(hg_quatd_load(q), clip_turn(what->axis, value)));
            else if (what->joint == 0)
                clip->translation[3 * t + what->axis] = value;
        }
        if (t < 2) t_pose[t] = odd == 0 && 4 * zero >= 3 * (b->channels - 3);
    }
    if (hg_lines_flow(lines, &word))
        return hg_lines_fail(lines, "more values than %lld frames of %lld channels", (long long)frames,
                             (long long)b->channels);
    if (t_pose[0] && frames > 1 && !t_pose[1]) {
        clip->frames--;
        memmove(clip->rotation, clip->rotation + 4 * clip->joints,
                (size_t)(4 * clip->frames * clip->joints) * sizeof(double));
        memmove(clip->translation, clip->translation + 3, (size_t)(3 * clip->frames) * sizeof(double));
    }
    return HG_OK;
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Offsets to the root track's scale, then both to metres. */
static hg_status find_scale(hg_clip *clip)
{
    double lowest = 0; /* of the rest joints below the root, in offset units: the length of the legs */
    hg_vec3d place[CLIP_MAX_JOINTS];
    for (int64_t j = 0; j < clip->joints; j++) {
        hg_vec3d offset = hg_vec3d_load(clip->offset + 3 * j);
        place[j] = clip->parent[j] < 0 ? hg_vec3d_make(0, 0, 0) : hg_vec3d_add(place[clip->parent[j]], offset);
        lowest = fmin(lowest, place[j].y);
    }
    double legs = -lowest, offset_scale = 1, metres = CLIP_CMU_METRES;
    double *height = hg_alloc((size_t)clip->frames, sizeof *height);
    if (!height) return HG_MEMORY;
    for (int64_t t = 0; t < clip->frames; t++) height[t] = clip->translation[3 * t + 1];
    qsort(height, (size_t)clip->frames, sizeof *height, compare);
    double root = height[clip->frames / 2];
    hg_free(height);
    if (legs > 0 && root > 0) { /* a root stands about as high as its legs are long */
        double power = pow(10, round(log10(root / legs))), ratio = root / legs / power;
        if (power > 1e-6 && power < 1e6 && ratio > 0.6 && ratio < 1.6) offset_scale = power;
    }
    const double units[] = { CLIP_CMU_METRES, 0.01, 0.0254, 1, 0.1, 0.001 };
    for (int i = 0; legs > 0 && i < 6; i++) {
        double length = legs * offset_scale * units[i];
        if (length > 0.6 && length < 1.3) {
            metres = units[i];
            break;
        }
    }
    for (int64_t i = 0; i < 3 * clip->joints; i++) clip->offset[i] *= offset_scale * metres;
    for (int64_t i = 0; i < 3 * clip->frames; i++) clip->translation[i] *= metres;
    return HG_OK;
}

hg_status hg_clip_read_bvh(hg_clip **clip, const char *path)
{
    *clip = NULL;
    hg_lines lines;
    HG_TRY(hg_lines_open(&lines, path));
    builder b = { 0 };
    hg_status status = clip_create(&b.clip, CLIP_MAX_JOINTS);
    if (status == HG_OK) b.clip->joints = 0;
    if (status == HG_OK) status = read_hierarchy(&b, &lines);
    if (status == HG_OK) status = read_motion(&b, &lines);
    if (status == HG_OK) status = find_scale(b.clip);
    hg_free(b.channel);
    hg_lines_close(&lines);
    if (status == HG_OK)
        *clip = b.clip;
    else
        hg_clip_destroy(b.clip);
    return status;
}

static hg_status read_clip(hg_clip **clip, const char *path, const hg_import *with, hg_text *notes)
{
    (void)notes;
    if (with->skeleton) return hg_fail(HG_INVALID, "--skeleton belongs to an .amc file; %s has its own", path);
    return hg_clip_read_bvh(clip, path);
}

static const hg_clip_reader reader = { .extension = "bvh", .what = "Biovision motion", .read = read_clip };
HG_REGISTER("motion reader", bvh, &reader);
