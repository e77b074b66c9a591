/* SPDX-License-Identifier: Apache-2.0 */
/* What the tests of the firmware share: a configuration, and a check that ends the program. */
#ifndef HYDRO_TEST_CHECK_H
#define HYDRO_TEST_CHECK_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../hydro/box.h"

#define CHECK(condition)                                                           \
    do {                                                                           \
        if (!(condition)) {                                                        \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);        \
            exit(1);                                                               \
        }                                                                          \
    } while (0)

static const hydro_config CONFIG = {
    .bench = {1.34e9f, 2e-4f, 0.609f, 0.08f, 16e6f, 0.0f, 2e-4f, 2e-4f, 1.785e-6f, 0.05f},
    .laws = {{15, 5, -55, 285, -25, 95, HYDRO_R(1e30), HYDRO_NEUTRAL, HYDRO_NEUTRAL, HYDRO_NEUTRAL, {1, 1, 1, 1, 1, 1, 1}},
             {400, 16, -385, 1, -10, 20, 700, {1, 0, 0, 0, 0, 0.25f, 1},
              {0.75f, -0.0625f, -0.0009765625f, -60, -0x1p-17f, 0, 0.75f}, {1.25f, 0.125f, 0.00390625f, 60, 0x1p-13f, 0.5f, 3},
              {0.5f, 0.125f, 0.0078125f, 100, 0x1p-12f, 1, 2}}},
    .delta_u_max = HYDRO_R(0.1), .load_force_limit = 700, .gain_floor = 100000, .force_range = 5000,
    .recovery_margin = 20,
    .low = {-5000, HYDRO_R(-1e8), -5000, HYDRO_R(-1e8), HYDRO_R(-0.5e6), HYDRO_R(-0.5e6), HYDRO_R(-5e-3), -10},
    .high = {5000, HYDRO_R(1e8), 5000, HYDRO_R(1e8), HYDRO_R(25e6), HYDRO_R(25e6), HYDRO_R(0.085), 10},
    .force_rate_age = HYDRO_R(2e-3), .velocity_age = HYDRO_R(1e-3), .hold_timeout = 0.05, .trip_timeout = 0.2,
    .feedback = 2, .integral_form = 2, .name = "test", .digest = "0123456789ab"};

static const hydro_real STILL[HYDRO_MEASURED] = {0, 0, 0, 0, HYDRO_R(3.8e6), HYDRO_R(6.2e6), HYDRO_R(0.04), 0};

/* A frame of a host around a payload, into `out`; how many bytes. */
static inline size_t host_frame(
    uint8_t version, uint8_t kind, uint32_t sequence, const uint8_t *payload, size_t count, uint8_t *out)
{
    uint8_t body[HYDRO_ENCODED_MAX];
    hydro_head(body, version, kind, sequence, 0);
    memcpy(body + HYDRO_HEADER, payload, count);
    return hydro_wrap(body, HYDRO_HEADER + count, out);
}

static inline float number(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

/* The payload of a COMMAND for the paper's law. */
static inline void host_command(uint8_t payload[72], uint32_t bits, const float values[3], uint32_t waveform,
                                const float shape[4])
{
    const float neutral[HYDRO_SHAPING] = HYDRO_NEUTRAL;
    memset(payload, 0, 72);
    memcpy(payload + 44, neutral, sizeof neutral);
    hydro_write32(payload, bits);
    hydro_write32(payload + 4, 0);
    memcpy(payload + 8, values, 12);
    hydro_write32(payload + 20, waveform);
    memcpy(payload + 24, shape, 16);
}

#endif
