/* SPDX-License-Identifier: Apache-2.0 */
/* Hostile bytes and measurements to the whole box: hostile [bytes] [seed].
 *
 * Noise, frames with random content and a check sum that holds, and such frames damaged. With each millisecond a
 * measurement of any bits. What must hold, or the program ends with 1: no floating-point exception, no sanitizer's
 * word, a current that is finite, within its limit, and 0 unless the box is armed; flags that are known.
 */
#define _GNU_SOURCE
#include <fenv.h>

#include "check.h"

static uint64_t state;

static uint32_t draw(void) /* splitmix64 */
{
    uint64_t z = (state += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return (uint32_t)(z >> 32);
}

/* A measurement: mostly what a bench shows, at times any bits. */
static void measure(hydro_real *x)
{
    memcpy(x, STILL, sizeof STILL);
    x[0] = x[2] = (hydro_real)(draw() % 1200) - HYDRO_R(600);
    x[3] = (hydro_real)(draw() % 100000) - HYDRO_R(50000);
    x[4] = (hydro_real)(draw() % 25000000);
    x[5] = (hydro_real)(draw() % 25000000);
    x[6] = (hydro_real)(draw() % 80) * HYDRO_R(1e-3);
    x[7] = (hydro_real)(draw() % 100) * HYDRO_R(1e-2);
    if (draw() % 64 == 0) {
        hydro_pattern bits = ((hydro_pattern)draw() << (8 * (sizeof bits - 4))) | draw();
        memcpy(x + draw() % HYDRO_MEASURED, &bits, sizeof bits);
    }
}

static size_t hostile(uint8_t *out, uint32_t *sequence)
{
    static const float special[8] = {0.0f, -0.0f, 1e-40f, -1.0f, 3.4e38f, 1000.0f, 700.0f, 5000.0f};
    uint8_t payload[100] = {0};
    size_t count;
    uint32_t version, kind = draw() % 8;
    if (kind == 0) { /* noise */
        count = draw() % 200;
        for (size_t i = 0; i < count; i++) {
            out[i] = (uint8_t)draw();
        }
        return count;
    }
    if (kind == 1 && draw() % 16 == 0) { /* a greeting */
        payload[1] = (uint8_t)draw();
        return host_frame(0, HYDRO_HELLO, draw(), payload, 72, out);
    }
    hydro_write32(payload, kind < 6 ? 3u : draw());
    for (int i = 2; i < 18; i++) {
        uint32_t bits = draw();
        if (bits % 4 != 0) {
            memcpy(&bits, special + draw() % 8, 4);
        }
        hydro_write32(payload + 4 * i, i == 5 ? draw() % 5 : i == 10 ? draw() % 9 / 4 : bits);
    }
    *sequence += draw() % 16 == 0 ? draw() : 1;
    version = kind == 2 ? draw() : HYDRO_VERSION;
    count = host_frame((uint8_t)version, (uint8_t)(kind == 3 ? draw() : HYDRO_COMMAND), *sequence, payload,
                       kind == 4 ? draw() % 100 : 72, out);
    if (kind == 5) {
        out[draw() % count] = (uint8_t)draw();
    }
    return count;
}

int main(int argc, char **argv)
{
    static hydro_box box;
    static hydro_rates rates;
    unsigned long wanted = argc > 1 ? strtoul(argv[1], NULL, 10) : 1000000, given = 0;
    hydro_real x[HYDRO_MEASURED], shown[HYDRO_MEASURED] = {0};
    uint8_t data[HYDRO_ENCODED_MAX + 100], out[HYDRO_BURST_MAX];
    uint32_t sequence = 0, seen = 0, ticks = 0, armed = 0, compensated = 0;
    state = argc > 2 ? strtoul(argv[2], NULL, 10) : 1;
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    hydro_box_power_on(&box, &CONFIG, 1);
    hydro_rates_reset(&rates, &CONFIG);
    while (given < wanted) {
        size_t count = hostile(data, &sequence);
        given += count;
        hydro_box_bytes(&box, data, count);
        measure(x);
        const hydro_real raw[5] = {x[0], x[2], x[4], x[5], x[6]};
        hydro_differentiate(&rates, raw, shown);
        hydro_real current = hydro_box_tick(&box, ticks % 3 == 0 ? shown : x, ticks * HYDRO_PERIOD);
        ticks += draw() % 256 == 0 ? 1 + draw() % 300 : 1;
        CHECK(hydro_finite(current) && hydro_abs(current) <= CONFIG.bench.valve_current_max);
        CHECK((box.sample.flags & HYDRO_ARMED) != 0 || current == 0);
        CHECK(box.sample.flags < 128 && box.acting.law <= HYDRO_COMPENSATED);
        const hydro_law *law = &CONFIG.laws[box.acting.law];
        for (int i = 0; i < HYDRO_SHAPING; i++) {
            CHECK(box.acting.shaping[i] >= law->low[i] && box.acting.shaping[i] <= law->high[i]);
        }
        CHECK((box.sample.flags & HYDRO_ARMED) == 0 || hydro_within(box.acting.reference, law->reference_max));
        compensated += (box.sample.flags & HYDRO_ARMED) != 0 && box.acting.law == HYDRO_COMPENSATED;
        CHECK(hydro_box_frames(&box, out) <= HYDRO_BURST_MAX);
        seen |= box.sample.flags;
        armed += box.sample.flags & HYDRO_ARMED;
    }
    CHECK(armed > 0 && compensated > 0 && (seen == 127 || wanted < 1000000));
    printf("%lu bytes, %u samples, %u of them armed; frames %u, bad %u, foreign %u, unknown %u; taken %u, old %u, "
           "greetings %u\n", given, (unsigned)box.sequence, (unsigned)armed, (unsigned)box.stream.frames,
           (unsigned)box.stream.bad, (unsigned)box.stream.foreign, (unsigned)box.stream.unknown, (unsigned)box.taken,
           (unsigned)box.stale, (unsigned)box.greetings);
    return 0;
}
