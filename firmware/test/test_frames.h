/* SPDX-License-Identifier: Apache-2.0 */
/* The worked examples of docs/manual/reference/protocol.md, byte by byte; tests/test_protocol_page.py holds both
 * together. Included by test_box.c.
 */
#ifndef HYDRO_TEST_FRAMES_H
#define HYDRO_TEST_FRAMES_H

#include "check.h"

static const char HOST_HELLO[] =
    "00 01 02 01 01 01 01 04 40 42 0f 01 01 01 01 03 04 04 01 01 01 01 01 01 01 01 01 01 01 01 01 01 "
    "01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 "
    "01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 05 fe ea 1b df 00 ";
static const char HELLO[] =
    "00 01 03 01 01 01 01 04 80 84 1e 01 01 01 01 10 04 04 01 02 65 78 61 6d 70 6c 65 20 31 2e 30 01 "
    "01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 05 cd cc 4c 3d 01 03 70 41 01 03 a0 40 "
    "01 03 a0 c0 01 03 96 42 01 01 01 01 01 0f 20 41 cd cc cc 3d 6f 12 83 3a 4d d7 be 2f 00 ";
static const char DETAILS[] =
    "00 04 04 04 01 01 01 04 80 84 1e 01 01 01 01 02 07 01 01 0f 30 31 32 33 34 35 36 37 38 39 61 62 "
    "01 03 01 01 01 03 2f 44 04 40 9c 45 24 24 f4 c8 20 bc be 4b 0a d7 a3 bb 7b 14 ae 3d cd cc 4c 3d "
    "cd cc 4c 3e 6f 12 03 3b 6f 12 83 3a 7a 2d 8a 65 00 ";
static const char LAW[] =
    "00 04 04 05 01 01 01 04 80 84 1e 01 01 01 01 02 01 01 01 01 01 03 c8 43 01 03 80 41 04 80 c0 c3 "
    "01 03 80 3f 01 03 20 c1 01 03 a0 41 01 03 80 3e 01 01 01 01 01 01 02 3f 01 03 80 3f 01 03 40 3f "
    "01 03 40 40 01 03 80 3f 01 03 2f 44 01 03 40 3f 01 03 80 bd 01 03 80 ba 01 03 70 c2 01 01 02 b7 "
    "01 03 a0 3f 01 01 02 3e 01 03 80 3b 01 03 70 42 01 01 02 39 01 01 02 3f 01 01 02 3e 01 01 02 3c "
    "01 03 c8 42 01 07 80 39 42 6a f8 21 00 ";
static const char STATE[] =
    "00 05 04 02 02 01 01 04 d0 ef 03 01 01 01 01 01 01 03 c0 3f 01 01 01 01 01 03 10 c0 01 01 01 01 "
    "04 24 74 4a 04 1b b7 4a 01 03 80 3d 01 01 01 01 01 03 80 3c 01 03 80 3c 01 01 02 c0 01 01 01 01 "
    "01 03 70 41 01 04 a0 40 41 01 01 02 03 01 01 02 01 01 01 02 01 01 01 02 01 01 01 01 01 03 20 c0 "
    "01 01 02 41 01 03 80 3f 01 01 02 3d 01 01 02 3b 01 03 80 bf 01 01 02 38 01 03 80 3e 01 07 80 3f "
    "64 86 0c 24 00 ";
static const char COMMAND[] =
    "00 04 04 03 03 01 01 04 f8 4d 0f 01 01 01 01 02 03 01 01 03 01 01 01 01 01 03 20 41 01 01 02 3f "
    "01 04 80 3a 01 01 01 01 01 03 c8 42 01 03 a0 c1 01 01 02 40 01 01 03 3f 01 01 01 01 01 03 80 3f "
    "01 03 80 3d 01 01 02 3b 01 01 02 c0 01 01 02 38 01 03 80 3e 01 07 c0 3f 06 4b 8e 5b 00 ";

static size_t bytes_of(const char *text, uint8_t *out)
{
    size_t count = 0;
    for (; *text != 0; text += 3) {
        out[count++] = (uint8_t)strtoul(text, NULL, 16);
    }
    return count;
}

static bool is_frame(const char *text, const uint8_t *found, size_t count)
{
    uint8_t wanted[HYDRO_ENCODED_MAX];
    return bytes_of(text, wanted) == count && memcmp(wanted, found, count) == 0;
}

static void test_frames_of_the_page(void)
{
    const uint32_t refused[2] = {1, 1};
    uint8_t out[HYDRO_ENCODED_MAX];
    hydro_config config = CONFIG;
    hydro_law *law = &config.laws[HYDRO_PAPER];
    const hydro_law_state acting = {
        HYDRO_COMPENSATED, HYDRO_R(-2.5), 8, {1, HYDRO_R(0.03125), HYDRO_R(0.001953125), -1, HYDRO_R(0x1p-15), HYDRO_R(0.25), 1}};
    hydro_sample sample = {0.258, 258, {0}, HYDRO_ARMED | HYDRO_FILTER_STALE};
    memset(config.name, 0, sizeof config.name);
    memcpy(config.name, "example 1.0", 11);
    law->delta_kp_min = -5;
    law->delta_kp_max = 75;
    law->delta_ki_min = 0;
    law->delta_ki_max = 10;
    CHECK(is_frame(HELLO, out, hydro_encode_hello(1, 2000000, &config, out)));
    CHECK(is_frame(DETAILS, out, hydro_encode_details(1, 2000000, 7, &config, out)));
    CHECK(is_frame(LAW, out, hydro_encode_law(1, 2000000, &config, out)));
    sample.values[0] = HYDRO_R(1.5);
    sample.values[2] = HYDRO_R(-2.25);
    sample.values[4] = HYDRO_R(4e6);
    sample.values[5] = HYDRO_R(6e6);
    sample.values[6] = HYDRO_R(0.0625);
    sample.values[HYDRO_CURRENT] = sample.values[HYDRO_NOMINAL] = HYDRO_R(0.015625);
    sample.values[HYDRO_REFERENCE] = -2;
    sample.values[HYDRO_KP] = 15;
    sample.values[HYDRO_KI] = 5;
    CHECK(is_frame(STATE, out, hydro_encode_state(&sample, 3, refused, &acting, out)));
    CHECK(HYDRO_ENCODED_MAX == 160);
}

static void test_a_command_of_the_page(void)
{
    static hydro_stream stream;
    hydro_command command;
    hydro_body body;
    uint8_t wire[HYDRO_ENCODED_MAX];
    const hydro_signal *reference = &command.reference;
    const hydro_real wanted[HYDRO_SHAPING] = {
        1, HYDRO_R(0.0625), HYDRO_R(0.001953125), -2, HYDRO_R(0x1p-15), HYDRO_R(0.25), HYDRO_R(1.5)};
    hydro_stream_reset(&stream);
    CHECK(feed(&stream, &body, wire, bytes_of(HOST_HELLO, wire)) == 1 && body.kind == HYDRO_HELLO);
    memset(&command, 0xAA, sizeof command);
    CHECK(feed(&stream, &body, wire, bytes_of(COMMAND, wire)) == 1 && body.kind == HYDRO_COMMAND);
    CHECK(hydro_decode_command(body.sequence, body.payload, &command));
    CHECK(command.sequence == 3 && command.corrects == 257 && command.arm && command.filter_fresh);
    CHECK(command.broken == 0 && command.delta_kp == 10 && command.delta_ki == HYDRO_R(0.5));
    CHECK(command.delta_u == HYDRO_R(0.0009765625) && reference->waveform == HYDRO_SINE);
    CHECK(reference->amplitude == 100 && reference->offset == -20 && reference->frequency == 2.0);
    CHECK(reference->phase == 0.5 && reference->start == 0.0 && command.law == HYDRO_COMPENSATED);
    CHECK(memcmp(command.shaping, wanted, sizeof command.shaping) == 0);
}

/* Each number of a COMMAND that is none has its bit, each bit its meaning. */
static void test_parts_of_a_command(void)
{
    static const uint32_t bit[] = {1, 2, 4, 0, 8, 8, 8, 8, 0, 16, 32, 64, 128, 256, 512, 1024};
    const float none = number(0x7FC00000u);
    hydro_command command;
    for (size_t i = 0; i < 16; i++) {
        uint8_t payload[72] = {0};
        if (bit[i] != 0) {
            memcpy(payload + 8 + 4 * i, &none, 4);
        }
        CHECK(hydro_decode_command(1, payload, &command) && command.broken == bit[i]);
    }
    for (uint8_t law = 0; law < 4; law++) {
        uint8_t payload[72] = {0};
        payload[40] = law;
        CHECK(hydro_decode_command(1, payload, &command) == (law < 2) && command.law == law);
    }
    for (uint8_t bits = 0; bits < 8; bits++) {
        uint8_t payload[72] = {bits};
        CHECK(hydro_decode_command(1, payload, &command));
        CHECK(command.arm == ((bits & 1) != 0) && command.filter_fresh == ((bits & 2) != 0));
    }
}

/* A code that leads beyond the end stands for nothing; the longest that does not, for all of it. */
static void test_unstuffing(void)
{
    uint8_t beyond[8] = {4, 1, 2}, whole[8] = {3, 1, 2}, zeros[8] = {1, 1, 2, 9};
    CHECK(hydro_unstuff(beyond, 3) == 0);
    CHECK(hydro_unstuff(whole, 3) == 2 && whole[0] == 1 && whole[1] == 2);
    CHECK(hydro_unstuff(zeros, 4) == 3 && zeros[0] == 0 && zeros[1] == 0 && zeros[2] == 9);
}

#endif
