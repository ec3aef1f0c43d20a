/* tensorboard: the scalars of a log as an event file that TensorBoard reads.
 *
 * The file is a sequence of TFRecords: length u64, its masked CRC32C, the bytes, their masked CRC32C (all little-endian;
 * the mask turns the sum right by 15 bits and adds 0xa282ead8). The bytes are an Event message of protocol buffers, small
 * enough to be written by hand (tensorflow/core/util/event.proto, framework/summary.proto):
 *   Event   1 wall_time double, 2 step varint, 3 file_version string, 5 summary
 *   Summary 1 value, repeated: 1 tag string, 2 simple_value float */
#include "train/log.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

uint32_t hg_crc32c(const void *bytes, size_t size)
{
    const uint8_t *at = bytes;
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < size; i++) {
        crc ^= at[i];
        for (int k = 0; k < 8; k++) crc = crc >> 1 ^ (crc & 1 ? 0x82f63b78u : 0); /* Castagnoli, reflected */
    }
    return ~crc;
}

static uint32_t masked(const void *bytes, size_t size)
{
    const uint32_t crc = hg_crc32c(bytes, size);
    return (crc >> 15 | crc << 17) + 0xa282ead8u;
}

/* ---- messages ------------------------------------------------------------------------------------------------ */

typedef struct {
    uint8_t *bytes;
    size_t size, room;
    bool failed;
} message;

static void put(message *m, const void *bytes, size_t size)
{
    if (m->failed) return;
    if (m->size + size > m->room) {
        const size_t room = 2 * (m->size + size) + 256;
        uint8_t *grown = hg_resize(m->bytes, m->room, room, 1);
        if (!grown) {
            m->failed = true;
            return;
        }
        m->bytes = grown;
        m->room = room;
    }
    memcpy(m->bytes + m->size, bytes, size);
    m->size += size;
}

static void put_varint(message *m, uint64_t value)
{
    do {
        const uint8_t byte = (uint8_t)((value & 0x7f) | (value > 0x7f ? 0x80 : 0));
        put(m, &byte, 1);
        value >>= 7;
    } while (value);
}

static void store_little(uint8_t *to, uint64_t bits, int size)
{
    for (int k = 0; k < size; k++) to[k] = (uint8_t)(bits >> 8 * k);
}

static void put_little(message *m, uint64_t bits, int size)
{
    uint8_t bytes[8];
    store_little(bytes, bits, size);
    put(m, bytes, (size_t)size);
}

enum { VARINT = 0, EIGHT = 1, BYTES = 2, FOUR = 5 };
static void put_key(message *m, unsigned field, unsigned type) { put_varint(m, field << 3 | type); }

static void put_double(message *m, unsigned field, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_key(m, field, EIGHT);
    put_little(m, bits, 8);
}

static void put_float(message *m, unsigned field, double value)
{
    const float narrow = (float)value;
    uint32_t bits;
    memcpy(&bits, &narrow, sizeof bits);
    put_key(m, field, FOUR);
    put_little(m, bits, 4);
}

static void put_bytes(message *m, unsigned field, const void *bytes, size_t size)
{
    put_key(m, field, BYTES);
    put_varint(m, size);
    put(m, bytes, size);
}

/* ---- the file ------------------------------------------------------------------------------------------------ */

struct hg_events {
    FILE *file;
    char *path;
    message event, summary, value; /* kept, so that a logged step allocates nothing */
};

static hg_status write_record(hg_events *events, const message *m)
{
    if (m->failed) return HG_MEMORY;
    uint8_t head[12], tail[4];
    store_little(head, m->size, 8);
    store_little(head + 8, masked(head, 8), 4);
    store_little(tail, masked(m->bytes, m->size), 4);
    if (fwrite(head, 1, sizeof head, events->file) != sizeof head ||
        fwrite(m->bytes, 1, m->size, events->file) != m->size ||
        fwrite(tail, 1, sizeof tail, events->file) != sizeof tail || fflush(events->file))
        return hg_fail(HG_IO, "%s: cannot be written: %s", events->path, strerror(errno));
    return HG_OK;
}

static void begin_event(hg_events *events, int64_t step)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    events->event.size = 0;
    put_double(&events->event, 1, (double)now.tv_sec + 1e-9 * (double)now.tv_nsec);
    put_key(&events->event, 2, VARINT);
    put_varint(&events->event, (uint64_t)step);
}

hg_status hg_events_write(hg_events *events, int64_t step, const hg_report *report)
{
    if (!events) return HG_OK;
    events->summary.size = 0;
    for (int i = 0; i < report->n; i++) {
        if (!isfinite(report->item[i].value)) continue;
        events->value.size = 0;
        put_bytes(&events->value, 1, report->item[i].name, strlen(report->item[i].name));
        put_float(&events->value, 2, report->item[i].value);
        if (events->value.failed) return HG_MEMORY;
        put_bytes(&events->summary, 1, events->value.bytes, events->value.size);
    }
    if (events->summary.failed) return HG_MEMORY;
    if (!events->summary.size) return HG_OK;
    begin_event(events, step);
    put_bytes(&events->event, 5, events->summary.bytes, events->summary.size);
    return write_record(events, &events->event);
}

/* The step of an event, read from its bytes; -1 where they are not an event. Only our own events come here. */
static int64_t step_of(const uint8_t *bytes, size_t size)
{
    if (size < 10 || bytes[0] != (1 << 3 | EIGHT) || bytes[9] != (2 << 3 | VARINT)) return -1;
    uint64_t step = 0;
    for (size_t i = 10, shift = 0; i < size && shift < 63; i++, shift += 7) {
        step |= (uint64_t)(bytes[i] & 0x7f) << shift;
        if (!(bytes[i] & 0x80)) return (int64_t)step;
    }
    return -1;
}

static uint64_t little(const uint8_t *bytes, int size)
{
    uint64_t bits = 0;
    for (int k = 0; k < size; k++) bits |= (uint64_t)bytes[k] << 8 * k;
    return bits;
}

/* Keeps the whole records of steps up to `step`: a resumed run writes the later ones again. */
static hg_status keep_until(const char *path, int64_t step)
{
    if (step <= 0 || !hg_file_exists(path)) return hg_file_write(path, "", 0);
    void *read = NULL;
    size_t size = 0, kept = 0;
    HG_TRY(hg_file_read(path, &read, &size));
    uint8_t *bytes = read;
    for (size_t at = 0; size - at >= 16;) {
        const uint64_t length = little(bytes + at, 8);
        if (length > size - at - 16 || little(bytes + at + 8, 4) != masked(bytes + at, 8) ||
            little(bytes + at + 12 + length, 4) != masked(bytes + at + 12, (size_t)length))
            break; /* cut short by a killed run */
        const int64_t of = step_of(bytes + at + 12, (size_t)length);
        const size_t whole = (size_t)length + 16;
        if (of >= 0 && of <= step) {
            memmove(bytes + kept, bytes + at, whole);
            kept += whole;
        }
        at += whole;
    }
    const hg_status status = hg_file_write(path, bytes, kept);
    hg_free(read);
    return status;
}

hg_status hg_events_open(hg_events **out, const char *folder, int64_t step)
{
    *out = NULL;
    hg_events *events = hg_alloc(1, sizeof *events);
    if (!events) return HG_MEMORY;
    events->path = hg_path_join(folder, "events.out.tfevents.0000000000.hairgrad");
    hg_status status = events->path ? keep_until(events->path, step) : HG_MEMORY;
    if (status == HG_OK && !(events->file = fopen(events->path, "ab")))
        status = hg_fail(HG_IO, "%s: cannot be written: %s", events->path, strerror(errno));
    if (status == HG_OK && (fseek(events->file, 0, SEEK_END), ftell(events->file) == 0)) {
        begin_event(events, 0);
        put_bytes(&events->event, 3, "brain.Event:2", 13);
        status = write_record(events, &events->event);
    }
    if (status != HG_OK) {
        hg_events_close(events);
        return status;
    }
    *out = events;
    return HG_OK;
}

void hg_events_close(hg_events *events)
{
    if (!events) return;
    if (events->file) fclose(events->file);
    hg_free(events->event.bytes);
    hg_free(events->summary.bytes);
    hg_free(events->value.bytes);
    hg_free(events->path);
    hg_free(events);
}
