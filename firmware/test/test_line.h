/* SPDX-License-Identifier: Apache-2.0 */
/* Frames, numbers, references and the force law, by streams of bytes and by samples. Included by test_box.c. */
#ifndef HYDRO_TEST_LINE_H
#define HYDRO_TEST_LINE_H

#include "check.h"

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
    count = host_frame(1, HYDRO_COMMAND, 7, payload, 40, wire);
    CHECK(feed(&stream, &body, wire, count) == 1 && body.sequence == 7 && body.length == 40 && body.version == 1);
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
    for (uint8_t version = 0; version < 5; version++) {
        count = host_frame(version, HYDRO_COMMAND, 1, payload, 40, wire);
        CHECK(feed(&stream, &body, wire, count) == (version == 1 || version == 2));
        count = host_frame(version, HYDRO_HELLO, 1, payload, 72, wire);
        CHECK(feed(&stream, &body, wire, count) == (version == 0));
    }
    CHECK(stream.foreign == 3 + 4 && stream.unknown == 0 && stream.frames == 5);
    CHECK(feed(&stream, &body, wire, host_frame(1, HYDRO_STATE, 1, payload, 64, wire)) == 0 && stream.unknown == 1);
    CHECK(feed(&stream, &body, wire, host_frame(1, HYDRO_COMMAND, 1, payload, 41, wire)) == 0 && stream.bad == 7);
    CHECK(feed(&stream, &body, wire, host_frame(0, HYDRO_HELLO, 1, payload, 73, wire)) == 0 && stream.bad == 8);
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
#endif
    CHECK(hydro_nan(none) && !hydro_nan(infinite) && hydro_abs(-3) == 3 && hydro_abs(3) == 3);
    CHECK(hydro_clamp(-2, -1, 1) == -1 && hydro_clamp(2, -1, 1) == 1 && hydro_clamp(0, -1, 1) == 0);
    CHECK(hydro_max(1, 2) == 2 && hydro_max(2, 1) == 2);
}

static bool near(hydro_real found, double wanted)
{
    return hydro_abs(found - HYDRO_R(wanted)) < HYDRO_R(1e-4);
}

static void test_waveforms(void)
{
    hydro_signal signal = {HYDRO_SINE, 2, 10, 0.5, HYDRO_PI / 6.0, 1.0};
    hydro_wave wave = hydro_play(&signal, 1.0);
    CHECK(near(wave.value, 11.0) && near(wave.rate, 2.0 * HYDRO_PI * 0.5 * 2.0 * 0.8660254));
    signal.waveform = HYDRO_HOLD;
    wave = hydro_play(&signal, 1.3);
    CHECK(wave.value == 10 && wave.rate == 0);
    signal.waveform = HYDRO_MULTISINE; /* at its own time 0: weights times sin(n phase) */
    wave = hydro_play(&signal, 1.0);
    CHECK(near(wave.value, 10.0 + 2.0 * (0.4478953 * 0.5 + 0.2585924 * 0.8660254 + 0.1692885 + 0.1242238 * 0.8660254)));
    signal.waveform = HYDRO_SMOOTH_STEP;
    signal.phase = 0.0;
    CHECK(near(hydro_play(&signal, 1.0).value, 8.0)); /* the first edge goes up from -1, for an eighth of 2 s */
    CHECK(near(hydro_play(&signal, 1.125).value, 10.0) && near(hydro_play(&signal, 1.25).value, 12.0));
    CHECK(near(hydro_play(&signal, 1.125).rate, 2.0 * HYDRO_PI / 0.25));
    CHECK(hydro_play(&signal, 1.9).value == 12 && hydro_play(&signal, 1.9).rate == 0);
    CHECK(near(hydro_play(&signal, 2.0).value, 12.0) && near(hydro_play(&signal, 2.125).rate, -2.0 * HYDRO_PI / 0.25));
    CHECK(hydro_play(&signal, 2.5).value == 8);
}

static void test_fades(void)
{
    static hydro_reference reference;
    hydro_signal wanted = {HYDRO_HOLD, 0, 30, 1.0, 0.0, 0.0};
    hydro_signal others[5];
    memset(&reference, 0xAA, sizeof reference);
    hydro_reference_reset(&reference);
    reference.wanted = wanted;
    hydro_begin(&reference, -30, 1.0);
    CHECK(hydro_advance(&reference, 1.0).value == -30 && hydro_advance(&reference, 1.0).rate == 0);
    CHECK(near(hydro_advance(&reference, 1.15).value, 0.0) && near(hydro_advance(&reference, 1.15).rate, 300.0));
    reference.wanted.offset = 60; /* a change waits for the end of the fade */
    CHECK(near(hydro_advance(&reference, 1.2999).value, 30.0));
    CHECK(near(hydro_advance(&reference, 1.31).value, 30.0) && reference.fade_start == 1.31);
    CHECK(near(hydro_advance(&reference, 1.46).value, 45.0) && hydro_advance(&reference, 1.7).value == 60);
    CHECK(reference.fade_start == 1.31); /* what is played already begins nothing */
    for (int i = 0; i < 5; i++) {
        others[i] = wanted;
    }
    others[0].waveform = HYDRO_SINE;
    others[1].amplitude = 1;
    others[2].offset = 31;
    others[3].frequency = 2.0;
    others[4].phase = 1.0;
    for (int i = 0; i < 5; i++) {
        CHECK(!hydro_same(&wanted, &others[i]) && hydro_same(&others[i], &others[i]));
    }
}

static void test_force_law(void)
{
    const hydro_bench *bench = &CONFIG.bench;
    hydro_real forward = hydro_input_gain(bench, STILL[6], STILL[4], STILL[5], 1);
    hydro_real backward = hydro_input_gain(bench, STILL[6], STILL[4], STILL[5], -1);
    /* lands: supply to a and b to tank forward, a to tank and supply to b backward; one chamber's share of each */
    hydro_real volume_a = hydro_volume_a(bench, STILL[6]), volume_b = hydro_volume_b(bench, STILL[6]);
    hydro_real unit = bench->bulk_modulus * bench->piston_area * bench->valve_gain;
    CHECK(near(forward / (unit * (HYDRO_SQRT(HYDRO_R(12.2e6)) / volume_a
                                  + bench->area_ratio * HYDRO_SQRT(HYDRO_R(6.2e6)) / volume_b)), 1.0));
    CHECK(near(backward / (unit * (HYDRO_SQRT(HYDRO_R(3.8e6)) / volume_a
                                   + bench->area_ratio * HYDRO_SQRT(HYDRO_R(9.8e6)) / volume_b)), 1.0));
    CHECK(hydro_signed_sqrt(4) == 2 && hydro_signed_sqrt(-4) == -2 && hydro_signed_sqrt(0) == 0);
    CHECK(near(hydro_nominal_current(&CONFIG, STILL, 0, 0, -1e4f, 15) * backward, -1e4)); /* g of its own side */
    CHECK(near(hydro_nominal_current(&CONFIG, STILL, 0, 0, 1e4f, 15) * forward, 1e4));
    CHECK(hydro_action(1, 3, 5) == 15 && hydro_action(HYDRO_BUMPLESS, 3, 5) == 3);
    CHECK(near(hydro_integrate(1, 3, 100, 5, 0), 3.1) && near(hydro_integrate(HYDRO_BUMPLESS, 3, 100, 5, 0), 3.5));
    CHECK(hydro_integrate(1, 3, 100, 5, 1) == 3 && hydro_integrate(HYDRO_BUMPLESS, 3, 100, 5, 1) == 3);
    CHECK(near(hydro_integrate(1, 3, 100, 5, -1), 3.1)); /* it may come back from the limit */
}

/* Rates lag by their age; a reading that is none leaves the rate beside it, and is shown. */
static void test_rates(void)
{
    hydro_rates rates;
    hydro_real raw[5] = {10, 20, 30, 40, HYDRO_R(0.05)}, x[HYDRO_MEASURED], none = (hydro_real)number(0x7FC00000u);
    memset(&rates, 0xAA, sizeof rates);
    hydro_rates_reset(&rates, &CONFIG);
    raw[1] = none;
    hydro_differentiate(&rates, raw, x);
    CHECK(x[0] == 10 && x[1] == 0 && hydro_nan(x[2]) && x[3] == 0 && x[4] == 30 && x[5] == 40 && x[7] == 0);
    raw[0] = 15;
    raw[1] = 5;
    raw[4] = HYDRO_R(0.053);
    hydro_differentiate(&rates, raw, x);
    CHECK(near(x[1] / 5000, 0.4) && near(x[3] / 5000, 0.4) && near(x[7], 3.0 * 2.0 / 3.0)); /* 1 - a: 2/5, and 2/3 */
    raw[0] = HYDRO_R(1e9);
    hydro_differentiate(&rates, raw, x);
    CHECK(x[0] == HYDRO_R(1e9) && near(x[1] / 5000, 0.4) && near(x[3] / 5000, 0.24));
    raw[0] = 15;
    hydro_differentiate(&rates, raw, x);
    CHECK(near(x[1] / 5000, 0.24)); /* to the last good reading */
}

/* A command of a waveform that is none, numbers that are none, hosts of both versions, and what DETAILS tell. */
static void test_conversation(void)
{
    static hydro_box box;
    hydro_config hydraulic = CONFIG;
    uint8_t payload[72] = {0}, wire[HYDRO_ENCODED_MAX], out[HYDRO_BURST_MAX];
    const float broken[3] = {number(0x7FC00000u), number(0x7F800000u), 0.001f};
    size_t old, new;
    hydraulic.feedback = 0;
    hydro_box_power_on(&box, &hydraulic, 9);
    CHECK(box.hellos == 0);
    host_command(payload, 0, broken, HYDRO_SMOOTH_STEP + 1, REST);
    hydro_box_bytes(&box, wire, host_frame(1, HYDRO_COMMAND, 5, payload, 40, wire));
    CHECK(box.stream.bad == 1 && !box.has_now);
    host_command(payload, 0, broken, HYDRO_SMOOTH_STEP, REST);
    hydro_box_bytes(&box, wire, host_frame(1, HYDRO_COMMAND, 5, payload, 40, wire));
    CHECK(box.now.broken == 3 && box.now.delta_kp == 0 && box.now.delta_u == HYDRO_R(0.001f));
    (void)hydro_box_tick(&box, STILL, 0.001);
    CHECK(box.guard.refused[0] == 2 && box.guard.refused[1] == 0);
    memset(payload, 0, sizeof payload);
    payload[1] = 1; /* a host of version 1 */
    hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, payload, 72, wire));
    CHECK(box.version == 1 && box.hellos == 1);
    (void)hydro_box_tick(&box, STILL, 0.002);
    old = hydro_box_frames(&box, out);
    payload[1] = 9; /* one of a version to come speaks 2 with this box */
    hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, payload, 72, wire));
    CHECK(box.version == 2 && box.hellos == 2);
    (void)hydro_box_tick(&box, STILL, 0.003);
    new = hydro_box_frames(&box, out);
    CHECK(new >= old + 8 + HYDRO_HEADER + 60 + 4 && new <= HYDRO_BURST_MAX); /* DETAILS, and two more counters */
    CHECK(hydro_unstuff(wire + 1, hydro_encode_details(1, 0, 9, &CONFIG, wire) - 2) == HYDRO_HEADER + 60 + 4);
    CHECK(wire[1 + HYDRO_HEADER + 16] == 1); /* the load force */
    CHECK(hydro_unstuff(out + 1, hydro_encode_details(1, 0, 9, &hydraulic, out) - 2) == HYDRO_HEADER + 60 + 4);
    CHECK(out[1 + HYDRO_HEADER + 16] == 2);
}

/* What no command leads to: a current that is not finite disarms and trips, and the valve rests. */
static void test_a_current_that_cannot_be(void)
{
    static hydro_box box;
    uint8_t payload[40], wire[HYDRO_ENCODED_MAX];
    const float away[4] = {0.0f, 50.0f, 1.0f, 0.0f};
    hydro_box_power_on(&box, &CONFIG, 9);
    host_command(payload, 0, NO_GAINS, HYDRO_HOLD, away);
    hydro_box_bytes(&box, wire, host_frame(1, HYDRO_COMMAND, 1, payload, 40, wire));
    (void)hydro_box_tick(&box, STILL, 0.001);
    host_command(payload, 3, NO_GAINS, HYDRO_HOLD, away);
    hydro_box_bytes(&box, wire, host_frame(1, HYDRO_COMMAND, 2, payload, 40, wire));
    (void)hydro_box_tick(&box, STILL, 0.002);
    CHECK(hydro_box_tick(&box, STILL, 0.05) > 0 && box.sample.flags == HYDRO_ARMED);
    box.guard.delta_kp = (hydro_real)number(0x7F800000u);
    CHECK(hydro_box_tick(&box, STILL, 0.051) == 0 && box.sample.flags == HYDRO_TRIPPED);
    CHECK(box.sample.values[HYDRO_NOMINAL] == 0 && box.sample.values[HYDRO_REFERENCE] == STILL[2]);
}

#endif
