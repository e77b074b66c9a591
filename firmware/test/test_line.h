/* SPDX-License-Identifier: Apache-2.0 */
/* Frames, numbers and what a host says, by streams of bytes. Included by test_box.c. */
#ifndef HYDRO_TEST_LINE_H
#define HYDRO_TEST_LINE_H

#include "check.h"

#define GREETING (93u + 81u + 141u) /* bytes of HELLO, DETAILS and LAW */

static const float NO_GAINS[3] = {0.0f, 0.0f, 0.0f}, REST[4] = {0.0f, 0.0f, 1.0f, 0.0f};

/* Bytes into a stream; how many whole frames they ended. */
static int feed(hydro_stream *stream, hydro_body *body, const uint8_t *data, size_t count)
{
    int frames = 0;
    for (size_t i = 0; i < count; i++) {
        frames += hydro_byte(stream, data[i], body);
    }
    return frames;
}

static void test_stream(void)
{
    static hydro_stream stream;
    hydro_body body;
    uint8_t payload[73] = {0}, wire[HYDRO_ENCODED_MAX + 2];
    size_t count;
    memset(&stream, 0xAA, sizeof stream);
    hydro_stream_reset(&stream);
    host_command(payload, 2, NO_GAINS, HYDRO_HOLD, REST);
    count = host_frame(HYDRO_VERSION, HYDRO_COMMAND, 7, payload, 72, wire);
    CHECK(feed(&stream, &body, wire, count) == 1 && body.sequence == 7 && body.length == 72);
    CHECK(feed(&stream, &body, wire, count - 9) == 0 && feed(&stream, &body, wire, count) == 1);
    CHECK(stream.frames == 2 && stream.bad == 1); /* the truncated one */
    wire[count / 2] ^= 0x80;
    CHECK(feed(&stream, &body, wire, count) == 0 && stream.bad == 2);
    /* shorter than a header, and a code that leads beyond the end */
    CHECK(feed(&stream, &body, (const uint8_t *)"\0\3\1\1\0\2\0", 7) == 0 && stream.bad == 4);
    memset(wire, 1, sizeof wire);
    wire[HYDRO_ENCODED_MAX] = 0;
    CHECK(feed(&stream, &body, wire, HYDRO_ENCODED_MAX + 1) == 0 && stream.bad == 5); /* the longest: no check sum */
    wire[HYDRO_ENCODED_MAX] = 1;
    wire[HYDRO_ENCODED_MAX + 1] = 0;
    CHECK(feed(&stream, &body, wire, HYDRO_ENCODED_MAX + 2) == 0 && stream.bad == 6); /* a byte too long */
    for (uint8_t version = 0; version < 6; version++) {
        count = host_frame(version, HYDRO_COMMAND, 1, payload, 72, wire);
        CHECK(feed(&stream, &body, wire, count) == (version == HYDRO_VERSION));
        count = host_frame(version, HYDRO_HELLO, 1, payload, 72, wire);
        CHECK(feed(&stream, &body, wire, count) == (version == 0));
    }
    CHECK(stream.foreign == 5 + 5 && stream.unknown == 0 && stream.frames == 4);
    CHECK(feed(&stream, &body, wire, host_frame(HYDRO_VERSION, HYDRO_STATE, 1, payload, 64, wire)) == 0 && stream.unknown == 1);
    CHECK(feed(&stream, &body, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 1, payload, 73, wire)) == 0 && stream.bad == 7);
    CHECK(feed(&stream, &body, wire, host_frame(0, HYDRO_HELLO, 1, payload, 73, wire)) == 0 && stream.bad == 8);
    CHECK(feed(&stream, &body, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 1, payload, 40, wire)) == 0 && stream.bad == 9);
}

/* Pieces of the shortest and the longest length that may be a frame, and a byte beyond each. */
static void test_lengths(void)
{
    static hydro_stream stream;
    hydro_body body;
    uint8_t data[HYDRO_ENCODED_MAX], wire[HYDRO_ENCODED_MAX + 8];
    hydro_stream_reset(&stream);
    memset(data, 1, sizeof data);
    CHECK(feed(&stream, &body, wire, host_frame(HYDRO_VERSION, 200, 1, data, 0, wire)) == 0 && stream.unknown == 1);
    CHECK(feed(&stream, &body, wire, hydro_wrap(data, HYDRO_HEADER - 1, wire)) == 0 && stream.bad == 1);
    data[0] = HYDRO_VERSION;
    data[1] = 200;
    CHECK(hydro_wrap(data, HYDRO_ENCODED_MAX - 5, wire) == HYDRO_ENCODED_MAX + 2);
    CHECK(feed(&stream, &body, wire, HYDRO_ENCODED_MAX + 2) == 0 && stream.unknown == 2 && stream.bad == 1);
    wire[HYDRO_ENCODED_MAX + 1] = HYDRO_ENCODED_MAX - 1;
    wire[HYDRO_ENCODED_MAX + 2] = wire[HYDRO_ENCODED_MAX]; /* the end once more: nothing of the piece is taken up */
    wire[HYDRO_ENCODED_MAX + 3] = 0;
    CHECK(feed(&stream, &body, wire, HYDRO_ENCODED_MAX + 4) == 0 && stream.unknown == 2 && stream.bad == 2);
}

static void test_numbers(void)
{
    hydro_real infinite = (hydro_real)number(0x7F800000u), none = (hydro_real)number(0x7FC00000u);
    CHECK(hydro_fraction(1.25) == 0.25 && hydro_fraction(-1.25) == 0.75 && hydro_fraction(-2.0) == 0.0);
    CHECK(hydro_fraction(1e300) == 0.0 && hydro_fraction(-1e300) == 0.0);
    CHECK(hydro_fraction(4503599627370496.0) == 0.0 && hydro_fraction(4503599627370495.5) == 0.5);
    CHECK(hydro_bits(1) == 0x3F800000u && hydro_bits(-2) == 0xC0000000u);
    CHECK(hydro_bits(infinite) == 0x7F800000u && hydro_bits(-infinite) == 0xFF800000u);
    CHECK((hydro_bits(none) & 0x7FC00000u) == 0x7FC00000u && hydro_finite(1) && !hydro_finite(none));
#ifndef HYDRO_SINGLE /* beyond a float */
    CHECK(hydro_bits(1e39) == 0x7F800000u && hydro_bits(-1e39) == 0xFF800000u);
    CHECK(hydro_bits(3.4028234e38) == 0x7F7FFFFFu && hydro_bits(-3.4028234e38) == 0xFF7FFFFFu);
#endif
    CHECK(hydro_nan(none) && !hydro_nan(infinite) && hydro_abs(-3) == 3 && hydro_abs(HYDRO_R(0.5)) > 0);
    CHECK(hydro_within(-2, 2) && !hydro_within(HYDRO_R(2.1), 2) && !hydro_within(-3, 2));
    CHECK(!hydro_within(none, 2) && !hydro_within(-infinite, 2));
    CHECK(hydro_clamp(-2, -1, 1) == -1 && hydro_clamp(2, -1, 1) == 1 && hydro_clamp(0, -1, 1) == 0);
    CHECK(hydro_max(1, 2) == 2 && hydro_max(2, 1) == 2);
}

/* A command of a waveform that is none, numbers that are none, hosts of any version, and what DETAILS tell. */
static void test_conversation(void)
{
    static hydro_box box;
    hydro_config hydraulic = CONFIG;
    uint8_t payload[72] = {0}, wire[HYDRO_ENCODED_MAX], out[HYDRO_BURST_MAX];
    const float broken[3] = {number(0x7FC00000u), number(0x7F800000u), 0.001f};
    hydraulic.feedback = 0;
    hydro_box_power_on(&box, &hydraulic, 9);
    CHECK(box.hellos == 0);
    host_command(payload, 0, broken, HYDRO_SMOOTH_STEP + 1, REST);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 5, payload, 72, wire));
    CHECK(box.stream.bad == 1 && !box.has_now);
    host_command(payload, 0, broken, HYDRO_SMOOTH_STEP, REST);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 5, payload, 72, wire));
    CHECK(box.now.broken == 3 && box.now.delta_kp == 0 && box.now.delta_u == HYDRO_R(0.001f));
    (void)hydro_box_tick(&box, STILL, 0.001);
    CHECK(box.guard.refused[0] == 2 && box.guard.refused[1] == 0);
    for (uint8_t host = 0; host < 10; host++) { /* each hears the same, and whether it is understood is its own matter */
        memset(payload, 0, sizeof payload);
        payload[1] = host;
        hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, payload, 72, wire));
        CHECK(box.hellos == host + 1u);
        (void)hydro_box_tick(&box, STILL, 0.002 + 1e-3 * host);
        CHECK(hydro_box_frames(&box, out) == GREETING + 133);
    }
    CHECK(hydro_unstuff(wire + 1, hydro_encode_details(1, 0, 9, &CONFIG, wire) - 2) == HYDRO_HEADER + 64);
    CHECK(wire[1] == HYDRO_VERSION && wire[1 + HYDRO_HEADER + 16] == 1 && wire[1 + HYDRO_HEADER + 17] == 3);
    CHECK(hydro_unstuff(out + 1, hydro_encode_details(1, 0, 9, &hydraulic, out) - 2) == HYDRO_HEADER + 64);
    CHECK(out[1 + HYDRO_HEADER + 16] == 2); /* the hydraulic force */
}

/* A frame of the box, between its delimiters, as its body: into `data`; how many bytes it took of `wire`. */
static size_t opened(const uint8_t *wire, uint8_t *data)
{
    size_t count = 1;
    CHECK(wire[0] == 0);
    while (wire[count] != 0) {
        count++;
    }
    memcpy(data, wire + 1, count - 1);
    CHECK(hydro_unstuff(data, count - 1) == count - 2);
    return count + 1;
}

/* What power-on leaves of a box that was in the middle of something, and what goes up the line then. */
static void test_a_box_begins_anew(void)
{
    static hydro_box box;
    uint8_t out[HYDRO_BURST_MAX], data[HYDRO_ENCODED_MAX];
    size_t hello, state;
    hydro_box_power_on(&box, &CONFIG, 1);
    box.has_now = box.has_next = box.greeted = true;
    box.greeting = false;
    box.integral = 5;
    hydro_box_power_on(&box, &CONFIG, 9);
    CHECK(!box.has_now && !box.has_next && !box.greeted && box.greeting && box.integral == 0 && box.epoch == 9);
    (void)hydro_box_tick(&box, STILL, 0.001);
    CHECK(box.sample.sequence == 0 && box.sample.time == 0.001);
    CHECK(memcmp(box.sample.values, STILL, sizeof STILL) == 0);
    CHECK(hydro_box_frames(&box, out) == GREETING + 133);
    hello = opened(out, data);
    CHECK(data[0] == 0 && data[1] == HYDRO_HELLO && hydro_read32(data + 2) == 0 && hydro_read32(data + 6) == 1000);
    CHECK(opened(out + hello, data) == 81 && data[0] == HYDRO_VERSION && data[1] == HYDRO_DETAILS);
    CHECK(opened(out + hello + 81, data) == 141 && data[0] == HYDRO_VERSION && data[1] == HYDRO_LAW);
    state = opened(out + GREETING, data);
    CHECK(data[0] == HYDRO_VERSION && data[1] == HYDRO_STATE && hydro_read32(data + 2) == 0);
    CHECK(state == 133 && hydro_read32(data + 6) == 1000);
    (void)hydro_box_tick(&box, STILL, 4294.967297);
    CHECK(hydro_box_frames(&box, out) == 133 && opened(out, data) == 133 && hydro_read32(data + 2) == 1);
    CHECK(hydro_read32(data + 6) == 1 && hydro_read32(data + 10) == 1); /* us, beyond 32 bits */
}

/* Bytes one by one; a frame without its end; and what stands between two greetings of one sample. */
static void test_what_waits(void)
{
    static hydro_box box;
    uint8_t payload[72] = {0}, hello[HYDRO_ENCODED_MAX], wire[HYDRO_ENCODED_MAX];
    size_t greeting, count;
    payload[1] = 2;
    greeting = host_frame(0, HYDRO_HELLO, 0, payload, 72, hello);
    host_command(payload, 2, NO_GAINS, HYDRO_HOLD, REST);
    count = host_frame(HYDRO_VERSION, HYDRO_COMMAND, 5, payload, 72, wire);
    hydro_box_power_on(&box, &CONFIG, 9);
    hydro_box_bytes(&box, wire, count - 1); /* its delimiter lies behind */
    CHECK(!box.has_now && box.taken == 0);
    hydro_box_bytes(&box, wire + count - 1, 1);
    CHECK(box.has_now && box.taken == 1);
    hydro_box_bytes(&box, hello, greeting);
    hydro_box_bytes(&box, wire, count);
    hydro_box_bytes(&box, hello, greeting);
    (void)hydro_box_tick(&box, STILL, 0.001);
    CHECK(!box.has_now && box.confirmed == 5 && box.taken == 1); /* of both commands the first alone was seen */
    hydro_box_bytes(&box, hello, greeting);
    hydro_box_bytes(&box, wire, count);
    (void)hydro_box_tick(&box, STILL, 0.002);
    CHECK(box.has_now && box.taken == 2);
    (void)hydro_box_tick(&box, STILL, 0.003);
    CHECK(!box.has_now && !box.has_next && !box.greeted && box.arming.received_at == 0.003);
}

/* An armed box away from 0 N: the error is f_r - f, the reference is shown, and delta_u acts up to 3.5 ms, these too. */
static void test_an_armed_sample(void)
{
    static hydro_box box;
    const float gains[3] = {0.0f, 0.0f, 0.001f}, away[4] = {0.0f, 50.0f, 1.0f, 0.0f};
    uint8_t payload[72], wire[HYDRO_ENCODED_MAX];
    hydro_real x[HYDRO_MEASURED];
    memcpy(x, STILL, sizeof x);
    x[2] = 30;
    hydro_box_power_on(&box, &CONFIG, 9);
    for (uint32_t k = 1; k < 3; k++) {
        host_command(payload, k == 1 ? 2 : 3, gains, HYDRO_HOLD, away);
        hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, k, payload, 72, wire));
        (void)hydro_box_tick(&box, x, k * 1e-3);
    }
    CHECK(box.sample.values[HYDRO_NOMINAL] == 0 && box.sample.values[HYDRO_REFERENCE] == 30);
    box.arming.received_at = 0.0;
    CHECK(hydro_box_tick(&box, x, HYDRO_CORRECTION_HOLD) - box.sample.values[HYDRO_NOMINAL] > HYDRO_R(0.0009));
    (void)hydro_box_tick(&box, x, 0.152); /* in the middle of its fade */
    CHECK(box.sample.values[HYDRO_REFERENCE] > 39 && box.sample.values[HYDRO_REFERENCE] < 41);
    CHECK(box.sample.values[HYDRO_REFERENCE_RATE] > 145 && box.sample.values[HYDRO_REFERENCE_RATE] < 147);
}

/* What no command leads to: a current that is not finite disarms and trips, and the valve rests. */
static void test_a_current_that_cannot_be(void)
{
    static hydro_box box;
    uint8_t payload[72], wire[HYDRO_ENCODED_MAX];
    const float away[4] = {0.0f, 50.0f, 1.0f, 0.0f};
    hydro_box_power_on(&box, &CONFIG, 9);
    host_command(payload, 0, NO_GAINS, HYDRO_HOLD, away);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 1, payload, 72, wire));
    (void)hydro_box_tick(&box, STILL, 0.001);
    host_command(payload, 3, NO_GAINS, HYDRO_HOLD, away);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 2, payload, 72, wire));
    (void)hydro_box_tick(&box, STILL, 0.002);
    CHECK(hydro_box_tick(&box, STILL, 0.05) > 0 && box.sample.flags == HYDRO_ARMED);
    box.guard.delta_kp = (hydro_real)number(0x7F800000u);
    CHECK(hydro_box_tick(&box, STILL, 0.051) == 0 && box.sample.flags == HYDRO_TRIPPED);
    CHECK(box.sample.values[HYDRO_NOMINAL] == 0 && box.sample.values[HYDRO_REFERENCE] == STILL[2]);
    CHECK(box.acting.reference == STILL[2] && box.acting.reference_rate == 0);
}

#endif
