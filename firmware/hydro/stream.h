/* SPDX-License-Identifier: Apache-2.0 */
/* From a stream of bytes to whole frames, whatever happens on the way. Memory: one frame. */
#ifndef HYDRO_STREAM_H
#define HYDRO_STREAM_H

#include "protocol.h"

typedef struct {
    uint8_t piece[HYDRO_ENCODED_MAX];
    uint32_t count; /* bytes of the piece under way; HYDRO_ENCODED_MAX + 1: it is too long */
    uint32_t frames, bad, unknown, foreign;
} hydro_stream;

/* A body that came whole: header and payload, without its check sum. */
typedef struct {
    const uint8_t *payload;
    uint32_t length; /* of the payload */
    uint32_t kind, sequence;
} hydro_body;

static inline void hydro_stream_reset(hydro_stream *stream)
{
    stream->count = 0;
    stream->frames = stream->bad = stream->unknown = stream->foreign = 0;
}

/* The piece between two delimiters as a body; false, and counted, if it is none that a box reads. */
static inline bool hydro_check(hydro_stream *stream, hydro_body *body)
{
    size_t count = hydro_unstuff(stream->piece, stream->count);
    const uint8_t *data = stream->piece;
    bool hello;
    if (count < HYDRO_HEADER + 4 || hydro_crc(data, count - 4) != hydro_read32(data + count - 4)) {
        stream->bad++;
        return false;
    }
    body->kind = data[1];
    body->sequence = hydro_read32(data + 2);
    body->payload = data + HYDRO_HEADER;
    body->length = (uint32_t)(count - 4 - HYDRO_HEADER);
    hello = body->kind == HYDRO_HELLO;
    if (data[0] != (hello ? 0u : HYDRO_VERSION)) {
        stream->foreign++;
        return false;
    }
    if (!hello && body->kind != HYDRO_COMMAND) {
        stream->unknown++;
        return false;
    }
    if (body->length != 72u) {
        stream->bad++;
        return false;
    }
    stream->frames++;
    return true;
}

/* Take one byte; true if it ended a frame, which `body` then shows until the next byte. */
static inline bool hydro_byte(hydro_stream *stream, uint8_t byte, hydro_body *body)
{
    bool whole = false;
    if (byte != 0) {
        if (stream->count < HYDRO_ENCODED_MAX) {
            stream->piece[stream->count++] = byte;
        } else {
            stream->count = HYDRO_ENCODED_MAX + 1;
        }
        return false;
    }
    if (stream->count > HYDRO_ENCODED_MAX) {
        stream->bad++;
    } else if (stream->count > 0) {
        whole = hydro_check(stream, body);
    }
    stream->count = 0;
    return whole;
}

#endif
