/* SPDX-License-Identifier: Apache-2.0 */
/* References, the force law and the rates of the readings, by numbers. Included by test_box.c. */
#ifndef HYDRO_TEST_LAW_H
#define HYDRO_TEST_LAW_H

#include "check.h"

static bool near(hydro_real found, double wanted)
{
    return hydro_abs(found - HYDRO_R(wanted)) < HYDRO_R(1e-4);
}

static const hydro_real WHOLE[2] = {1, 1}, SCALED[2] = {HYDRO_R(0.25), 2};

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
    CHECK(hydro_play(&signal, 1.25).rate == 0 && hydro_play(&signal, 1.4).value == 12); /* behind the edge */
}

/* The numbers that protocol.md gives for trying a generator: rows at 0, 100, and 300 ms. */
static void test_references_of_the_page(void)
{
    static const double wanted[3][3][2] = {
        {{12.5, 0}, {23.89914, 296.62281}, {-110.36935, -538.06679}},
        {{12.5, 0}, {11.95197, -26.19803}, {-49.56108, -361.50369}},
        {{12.5, 0}, {24.19753, 345.67901}, {-120, 0}}};
    static const double times[3] = {0.0, 0.1, 0.3};
    hydro_reference reference;
    for (uint32_t form = HYDRO_SINE; form <= HYDRO_SMOOTH_STEP; form++) {
        const hydro_signal signal = {form, 100, -20, 2.0, 0.5, 0.0};
        hydro_reference_reset(&reference);
        reference.wanted = reference.leaving = signal; /* what came before is forgotten */
        hydro_begin(&reference, HYDRO_R(12.5), 3.0);
        for (int i = 0; i < 3; i++) {
            hydro_wave wave = hydro_advance(&reference, 3.0 + times[i]);
            CHECK(near((wave.value - HYDRO_R(wanted[form - 1][i][0])) / 10, 0.0));
            CHECK(near((wave.rate - HYDRO_R(wanted[form - 1][i][1])) / 100, 0.0));
        }
    }
}

/* The derivatives of a signal and of a fade between two that move are those of its value, by differences. */
static void derivatives(hydro_wave before, hydro_wave now, hydro_wave behind, double rate, double second, double third, double fourth)
{
    hydro_real width = HYDRO_R(2e-3);
    CHECK(hydro_abs((behind.value - before.value) / width - now.rate) < HYDRO_R(rate));
    CHECK(hydro_abs((behind.rate - before.rate) / width - now.second) < HYDRO_R(second));
    CHECK(hydro_abs((behind.second - before.second) / width - now.third) < HYDRO_R(third));
    CHECK(hydro_abs((behind.third - before.third) / width - now.fourth) < HYDRO_R(fourth));
}

static void test_derivatives(void)
{
    const hydro_signal one = {HYDRO_SINE, 100, -20, 2.0, 0.5, 0.0}, other = {HYDRO_SINE, 50, 30, 3.0, -1.0, 0.0};
    hydro_reference reference;
    hydro_reference_reset(&reference);
    reference.wanted = one;
    hydro_begin(&reference, 0, 0.0);
    reference.wanted = other;
    (void)hydro_advance(&reference, 0.3);
    CHECK(reference.fade_start == 0.3); /* the fade's end itself is its end */
    for (double time = 0.32; time < 0.6; time += 0.02) {
        derivatives(hydro_advance(&reference, time - 1e-3), hydro_advance(&reference, time),
                    hydro_advance(&reference, time + 1e-3), 1.5, 60, 3000, 200000);
    }
    for (int end = 0; end < 2; end++) { /* no derivative up to the third jumps at either end */
        hydro_wave inside = hydro_advance(&reference, end == 0 ? 0.3 : 0.6 - 1e-9);
        hydro_wave outside = end == 0 ? hydro_play(&one, 0.3) : hydro_advance(&reference, 0.6);
        CHECK(near((inside.second - outside.second) / 1000, 0) && near((inside.third - outside.third) / 10000, 0));
    }
    for (uint32_t form = HYDRO_HOLD; form <= HYDRO_SMOOTH_STEP; form++) {
        const hydro_signal signal = {form, 100, -20, 2.0, 0.5, 0.0};
        for (double time = 0.055; time < 0.5; time += 0.01) { /* no kink within a millisecond of these */
            derivatives(hydro_play(&signal, time - 1e-3), hydro_play(&signal, time), hydro_play(&signal, time + 1e-3),
                        12, 1200, 70000, 5e6);
        }
    }
}

static void test_reset_of_references(void)
{
    const hydro_signal still = {HYDRO_HOLD, 0, 0, 1.0, 0.0, 0.0};
    hydro_reference reference;
    memset(&reference, 0xAA, sizeof reference);
    hydro_reference_reset(&reference);
    CHECK(hydro_same(&reference.wanted, &still) && hydro_same(&reference.leaving, &still));
    CHECK(hydro_same(&reference.coming, &still) && reference.fade_start == 0.0);
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
    CHECK(near(hydro_advance(&reference, 1.15).value, 0.0) && near(hydro_advance(&reference, 1.15).rate / 100, 4.375));
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
    CHECK(hydro_signed_sqrt(HYDRO_R(0.25)) == HYDRO_R(0.5) && HYDRO_BUMPLESS == 2);
    CHECK(near(hydro_volume_a(bench, HYDRO_R(0.05)) * HYDRO_R(1e6), 210.0));
    CHECK(near(hydro_volume_b(bench, HYDRO_R(0.05)) * HYDRO_R(1e6) / 100, 2.03654));
    CHECK(hydro_input_gain(bench, STILL[6], STILL[4], STILL[5], 0) == forward); /* 0 is forward */
    CHECK(hydro_input_gain(bench, STILL[6], STILL[4], STILL[5], HYDRO_R(0.5)) == forward);
    CHECK(near(hydro_nominal_current(&CONFIG, STILL, 0, 0, -1e4f, 15, WHOLE) * backward, -1e4)); /* g of its own side */
    CHECK(near(hydro_nominal_current(&CONFIG, STILL, 0, 0, 1e4f, 15, WHOLE) * forward, 1e4));
    CHECK(hydro_action(1, 3, 5) == 15 && hydro_action(HYDRO_BUMPLESS, 3, 5) == 3);
    CHECK(near(hydro_integrate(1, 3, 100, 5, 0), 3.1) && near(hydro_integrate(HYDRO_BUMPLESS, 3, 100, 5, 0), 3.5));
    CHECK(hydro_integrate(1, 3, 100, 5, 1) == 3 && hydro_integrate(HYDRO_BUMPLESS, 3, 100, 5, 1) == 3);
    CHECK(near(hydro_integrate(1, 3, 100, 5, -1), 3.1)); /* it may come back from the limit */
    CHECK(hydro_integrate(HYDRO_BUMPLESS, 3, 100, 5, HYDRO_R(1e-4)) == 3);
}

/* Beyond a hundred microampere of the closed valve the whole half width of its side is added; the inverse takes it off. */
static void test_leap(void)
{
    hydro_config config = CONFIG;
    hydro_bench *bench = &config.bench;
    hydro_real law = hydro_nominal_current(&config, STILL, 0, 0, 1e4f, 15, WHOLE), leapt;
    CHECK(hydro_leap(bench, law) == law && hydro_before_leap(bench, law) == law); /* no overlap is known */
    bench->valve_current_max = HYDRO_R(0.05);
    bench->closing = HYDRO_R(1e-3);
    bench->overlap_back = HYDRO_R(2e-4);
    bench->overlap_out = HYDRO_R(6e-4);
    CHECK(near(hydro_leap(bench, HYDRO_R(0.01)) * 1000, 10.6) && near(hydro_leap(bench, 0) * 1000, -0.2));
    CHECK(near(hydro_leap(bench, HYDRO_R(1.05e-3)) * 1000, 1.35) && near(hydro_leap(bench, HYDRO_R(0.98e-3)) * 1000, 0.94));
    CHECK(near(hydro_leap(bench, HYDRO_R(1e-3)) * 1000, 1));
    for (int i = -20; i <= 20; i++) {
        hydro_real current = HYDRO_R(1e-3) + HYDRO_R(2.1e-5) * (hydro_real)i;
        CHECK(near((hydro_before_leap(bench, hydro_leap(bench, current)) - current) * 1000, 0));
    }
    leapt = hydro_nominal_current(&config, STILL, 0, 0, 1e7f, 15, WHOLE);
    CHECK(near((leapt - HYDRO_R(6e-4)) / law, 1000));
}

/* The currents that protocol.md gives for trying a law, and one beside a tank that is not at 0 Pa. */
static void test_currents_of_the_page(void)
{
    hydro_config config = CONFIG;
    const hydro_real x[HYDRO_MEASURED] = {
        0, 0, HYDRO_R(-2.25), 0, HYDRO_R(4e6), HYDRO_R(6e6), HYDRO_R(0.0625), HYDRO_R(0.01)};
    hydro_real back[HYDRO_MEASURED], error = HYDRO_R(0.25);
    memcpy(back, x, sizeof back);
    back[7] = HYDRO_R(-0.01);
    config.bench.valve_gain = HYDRO_R(1.67e-4 / 0.05) / HYDRO_SQRT(HYDRO_R(3.5e6));
    config.gain_floor = HYDRO_R(1.173882e6);
    CHECK(near(hydro_nominal_current(&config, x, error, 2, 100, 15, WHOLE) * 1000, 0.3187407));
    CHECK(near(hydro_nominal_current(&config, back, error, 2, -100, 15, WHOLE) * 1000, -0.3972830));
    CHECK(near(hydro_nominal_current(&config, x, error, 2, 100, 15, SCALED) * 1000, 0.0433425));
    config.bench.tank_pressure = HYDRO_R(1e6); /* 5 MPa over b's land, 3 MPa over a's */
    CHECK(near(hydro_input_gain(&config.bench, x[6], x[4], x[5], 1) * HYDRO_R(1e-7), 1.1023128));
    CHECK(near(hydro_input_gain(&config.bench, x[6], x[4], x[5], -1) * HYDRO_R(1e-7), 0.8458449));
}

/* f_c and f_c' of given derivatives; each step towards what is wanted within its bound; the cut. */
static void test_compensation(void)
{
    const hydro_law *law = &CONFIG.laws[HYDRO_COMPENSATED];
    const hydro_wave wave = {100, -2000, 8000, 160000, -1600000};
    const hydro_real far[HYDRO_SHAPING] = {0, 1, -1, 1000, -1, 1, -1};
    hydro_law_state state = {
        HYDRO_COMPENSATED, 0, 0, {1, HYDRO_R(0.0625), HYDRO_R(0.001953125), 3, HYDRO_R(0.00006103515625), HYDRO_R(0.25), 1}};
    hydro_real first[HYDRO_SHAPING];
    memcpy(first, state.shaping, sizeof first);
    hydro_compensate(&state, law, first, &wave); /* at rest */
    CHECK(near(state.reference / 100, (100 - 125 + 15.625 + 3 + 9.765625) / 100));
    CHECK(near(state.reference_rate / 1000, (-2000 + 500 + 312.5 - 97.65625) / 1000));
    CHECK(memcmp(first, state.shaping, sizeof first) == 0);
    hydro_compensate(&state, law, far, &wave);
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        hydro_real step = law->rate[i] * HYDRO_R(1e-3) * HYDRO_R(i % 2 == 0 ? -1 : 1);
        CHECK(near((state.shaping[i] - first[i] - step) / law->rate[i], 0.0));
    }
    /* a' f: -0.5 * 100, 0.125 * -2000, -0.0078125 * 8000, 100, -2^-12 * 160000; beside a f' of what acts now */
    CHECK(near(state.reference_rate / 1000,
               (-1999 + 501 + 311.25 - 97.265625 - 50 - 250 - 62.5 + 100 - 39.0625) / 1000));
    state.shaping[3] = 60;
    for (int side = -1; side < 2; side += 2) { /* -690 and 690 beside 60: cut on one side */
        const hydro_wave high = {HYDRO_R(690 * side), 2000, 0, 0, 0};
        hydro_real still[HYDRO_SHAPING] = HYDRO_NEUTRAL;
        still[3] = 60;
        memcpy(state.shaping, still, sizeof still);
        hydro_compensate(&state, law, still, &high);
        CHECK(state.reference == (side < 0 ? -630 : 700) && state.reference_rate == (side < 0 ? 2000 : 0));
        still[3] = HYDRO_R(10 * side); /* the limit itself is not beyond it */
        memcpy(state.shaping, still, sizeof still);
        hydro_compensate(&state, law, still, &high);
        CHECK(state.reference == 700 * side && state.reference_rate == 2000);
        still[3] = HYDRO_R(20 * side);
        memcpy(state.shaping, still, sizeof still);
        hydro_compensate(&state, law, still, &high);
        CHECK(state.reference == 700 * side && state.reference_rate == 0);
    }
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
    rates.begun = true;
    hydro_rates_reset(&rates, &CONFIG);
    hydro_differentiate(&rates, raw, x);
    CHECK(x[1] == 0 && x[3] == 0 && x[7] == 0); /* begins anew */
}

#endif
