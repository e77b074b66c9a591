/* SPDX-License-Identifier: Apache-2.0 */
/* What a sample costs on this core: a line "kind counts current f_c M_c" each sample, hexadecimal, the three as bits of a
 * float. A COMMAND comes in and a STATE goes out with each; with `greeting` HELLO in, and HELLO, DETAILS,
 * LAW, STATE out; `filter` is the multisine of the paper's law, its decision and the monitor besides.
 *
 * QEMU counts by -icount shift=3: each instruction is 8 ns of SysTick's time, 168 / 125 of its counts. Elsewhere
 * (-DHYDRO_LIBRARY) the same program writes the samples of a processor of x86-64, without instructions.
 */
#ifdef HYDRO_LIBRARY
#include <stdio.h>
#endif

#include "box_config.h"
#include "filter_config.h"
#include "hydro/box.h"
#include "hydro/monitor.h"

#ifndef HYDRO_LIBRARY
#include "startup.h"
#endif

enum { DISARMED, GREETING, MULTISINE, COMPENSATED, FADE, FILTER, KINDS };

static const char *const names[KINDS] = {"disarmed", "greeting", "multisine", "compensated", "fade", "filter"};
static hydro_box box;
static hydro_memory_of_loop memory;
static hydro_monitor monitor;
static hydro_decision decision;

static void put(char character)
{
#ifdef HYDRO_LIBRARY
    (void)putchar(character);
#else
    USART1->DR = (uint8_t)character;
#endif
}

static void write_number(uint32_t value)
{
    put(' ');
    for (int i = 28; i >= 0; i -= 4) {
        put("0123456789abcdef"[value >> i & 15u]);
    }
}

static uint32_t count_now(void)
{
#ifdef HYDRO_LIBRARY
    return 0;
#else
    return SYST_CVR;
#endif
}

/* A number from -1 to 1 that goes to and fro, exact in both places. */
static hydro_real sway(uint32_t k, uint32_t period)
{
    int32_t at = (int32_t)(k % (4 * period)) - (int32_t)(2 * period);
    return (hydro_real)((at < 0 ? -at : at) - (int32_t)period) / (hydro_real)period;
}

static size_t frame(uint32_t kind, uint32_t k, uint8_t *wire)
{
    static const float ends[HYDRO_SHAPING] = {1.0f, 0.03125f, 0.001f, 1.0f, 1e-5f, 0.25f, 1.0f};
    static const float gains[3] = {10.0f, 1.0f, 0.001f};
    static const float neutral[HYDRO_SHAPING] = HYDRO_NEUTRAL;
    float shape[4] = {100.0f, kind == FADE ? (float)(k / 300 % 2) : 0.0f, 1.1f, 0.3f};
    bool own = kind == COMPENSATED || kind == FADE, greets = kind == GREETING;
    uint8_t body[HYDRO_ENCODED_MAX] = {0};
    hydro_head(body, greets ? 0 : HYDRO_VERSION, greets ? HYDRO_HELLO : HYDRO_COMMAND, k + 1, 0);
    if (greets) {
        body[HYDRO_HEADER] = 1;
        body[HYDRO_HEADER + 1] = 3;
    } else {
        hydro_write32(body + HYDRO_HEADER, kind == DISARMED || k == 0 ? 0u : 3u);
        hydro_copy(body + HYDRO_HEADER + 8, gains, sizeof gains);
        hydro_write32(body + HYDRO_HEADER + 20, HYDRO_MULTISINE);
        hydro_copy(body + HYDRO_HEADER + 24, shape, sizeof shape);
        body[HYDRO_HEADER + 40] = own ? HYDRO_COMPENSATED : HYDRO_PAPER;
        hydro_copy(body + HYDRO_HEADER + 44, own ? ends : neutral, sizeof ends);
    }
    return hydro_wrap(body, HYDRO_HEADER + 72, wire);
}

static void decide(void)
{
    hydro_loop_sample seen = hydro_loop_sample_of(box.sample.values, &box.acting, box.arming.armed);
    if (hydro_believable(&HYDRO_LOOP_FILTER, &seen)) {
        hydro_watch(&HYDRO_LOOP_FILTER.loop, HYDRO_R(1), &monitor, &memory, seen.x);
    } else {
        hydro_monitor_skip(&monitor);
    }
    decision = hydro_decide_loop(&HYDRO_LOOP_FILTER, &memory, &seen);
}

static void run(uint32_t kind, uint32_t samples)
{
    static hydro_rates rates;
    static hydro_real measurement[HYDRO_MEASURED];
    uint8_t wire[HYDRO_ENCODED_MAX], out[HYDRO_BURST_MAX];
    hydro_box_power_on(&box, &HYDRO_BOX_CONFIG, 1);
    hydro_rates_reset(&rates, &HYDRO_BOX_CONFIG);
    for (uint32_t k = 0; k < samples; k++) {
        hydro_real force = HYDRO_R(80) * sway(k, 125);
        hydro_real raw[5] = {
            force + 5, force, HYDRO_R(6e6) + HYDRO_R(3e5) * sway(k, 125), HYDRO_R(9.8e6) - HYDRO_R(4e5) * sway(k, 125),
            HYDRO_R(0.04) + HYDRO_R(0.004) * sway(k, 250)};
        size_t count = frame(kind, k, wire);
        uint32_t begin = count_now(), spent;
        hydro_box_bytes(&box, wire, count);
        hydro_differentiate(&rates, raw, measurement);
        (void)hydro_box_tick(&box, measurement, k * HYDRO_PERIOD);
        (void)hydro_box_frames(&box, out);
        if (kind == FILTER) {
            decide();
        }
        spent = (begin - count_now()) & 0xFFFFFFu;
        for (const char *letter = names[kind]; *letter != 0; letter++) {
            put(*letter);
        }
        write_number(spent);
        write_number(hydro_bits(box.sample.values[HYDRO_CURRENT]));
        write_number(hydro_bits(box.acting.reference));
        write_number(hydro_bits(decision.before));
        put('\n');
    }
}

int main(void)
{
#ifndef HYDRO_LIBRARY
    SYST_RVR = 0xFFFFFFu;
    SYST_CSR = 5; /* the core's clock, no interrupt */
#endif
    for (uint32_t kind = 0; kind < KINDS; kind++) {
        run(kind, 1000);
    }
    put('.');
    put('\n');
#ifdef HYDRO_LIBRARY
    return 0;
#else
    for (;;) {
        __asm volatile("wfi");
    }
#endif
}

#ifndef HYDRO_LIBRARY
typedef void (*board_vector)(void);

__attribute__((section(".vectors"), used)) static const board_vector vectors[16] = {
    [0] = (board_vector)_stack_end, [1] = board_reset, [2 ... 15] = board_unexpected};
#endif
