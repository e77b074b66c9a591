/* SPDX-License-Identifier: Apache-2.0 */
/* Arming, watchdog, guard and limits, line by line and branch by branch. Ends with 0, or names the check that fails. */
#define _GNU_SOURCE
#include <fenv.h>

#include "check.h"
#include "test_law.h"
#include "test_line.h"
#include "test_frames.h"

static hydro_arming arming;
static hydro_guard guard;

/* One sample of the arming alone; returns its flags. */
static uint32_t step(const hydro_real *x, double time)
{
    bool late = hydro_watchdog(&arming, &CONFIG, time);
    hydro_follow_disarm(&arming);
    hydro_watch_sensors(&arming, &CONFIG, x, time);
    (void)hydro_follow_arm(&arming, &CONFIG, x, time);
    return hydro_flags(&arming, late, false);
}

static void begin(void)
{
    memset(&arming, 0xAA, sizeof arming); /* nothing may lean on memory that happens to be zero */
    hydro_arming_reset(&arming);
}

static void armed_at(double time)
{
    begin();
    hydro_note_command(&arming, false, false, time - 1e-3);
    (void)step(STILL, time - 1e-3);
    hydro_note_command(&arming, true, true, time);
    CHECK(step(STILL, time) == HYDRO_ARMED);
}

static void test_power_on(void)
{
    begin();
    CHECK(!arming.arm_wanted && !arming.disarm_seen && !arming.armed && !arming.tripped && !arming.filter_fresh);
    CHECK(arming.faults == 0 && arming.excess == 0 && arming.received_at == HYDRO_NEVER);
    CHECK(arming.armed_at == HYDRO_NEVER);
    /* before the first command: late, stale, and neither armed nor tripped */
    CHECK(step(STILL, 0.0) == (HYDRO_WATCHDOG | HYDRO_FILTER_STALE));
    CHECK(step(STILL, 10.0) == (HYDRO_WATCHDOG | HYDRO_FILTER_STALE));
}

static void test_arming_needs_a_disarm_first(void)
{
    begin();
    hydro_note_command(&arming, true, true, 0.0);
    CHECK(hydro_follow_arm(&arming, &CONFIG, STILL, 0.0)); /* begins, and trips */
    CHECK(!arming.armed && arming.tripped);
    CHECK(step(STILL, 0.001) == HYDRO_TRIPPED);
    hydro_note_command(&arming, false, true, 0.002);
    CHECK(step(STILL, 0.002) == 0);
    hydro_note_command(&arming, true, true, 0.003);
    CHECK(hydro_follow_arm(&arming, &CONFIG, STILL, 0.003) && arming.armed && !arming.tripped);
    CHECK(!arming.disarm_seen && arming.armed_at == 0.003 && arming.excess == 0);
    CHECK(!hydro_follow_arm(&arming, &CONFIG, STILL, 0.004) && arming.armed_at == 0.003); /* once */
    hydro_note_command(&arming, false, true, 0.005);
    CHECK(step(STILL, 0.005) == 0);
    CHECK(!hydro_follow_arm(&arming, &CONFIG, STILL, 0.006));
}

static void test_watchdog_to_the_millisecond(void)
{
    armed_at(1.0);
    CHECK(step(STILL, 1.0 + 0.0499) == HYDRO_ARMED);
    arming.received_at = 0.0;
    CHECK(!hydro_watchdog(&arming, &CONFIG, 0.05)); /* not yet: the limit itself is in time */
    CHECK(hydro_watchdog(&arming, &CONFIG, 0.051));
    armed_at(1.0);
    CHECK(step(STILL, 1.051) == (HYDRO_ARMED | HYDRO_WATCHDOG | HYDRO_FILTER_STALE));
    arming.received_at = 0.0;
    CHECK(hydro_watchdog(&arming, &CONFIG, 0.2) && !arming.tripped && arming.arm_wanted);
    CHECK(step(STILL, 0.2001) == (HYDRO_TRIPPED | HYDRO_WATCHDOG | HYDRO_FILTER_STALE));
    CHECK(!arming.arm_wanted && !arming.disarm_seen);
    /* commands that come back with the arm bit set do not arm; a disarm clears, and then they do */
    hydro_note_command(&arming, true, true, 0.3);
    CHECK(step(STILL, 0.3) == HYDRO_TRIPPED);
    hydro_note_command(&arming, false, true, 0.301);
    CHECK(step(STILL, 0.301) == 0);
    /* silence after a disarm: not tripped, but the disarm is forgotten */
    CHECK(step(STILL, 0.6) == (HYDRO_WATCHDOG | HYDRO_FILTER_STALE));
    hydro_note_command(&arming, true, true, 0.601);
    CHECK(step(STILL, 0.601) == HYDRO_TRIPPED);
    (void)step(STILL, 0.9); /* silence while tripped leaves it tripped */
    CHECK(arming.tripped);
}

static void test_filter_fresh(void)
{
    armed_at(1.0);
    hydro_note_command(&arming, true, false, 1.001);
    CHECK(step(STILL, 1.001) == (HYDRO_ARMED | HYDRO_FILTER_STALE));
    hydro_note_command(&arming, true, true, 1.002);
    CHECK(step(STILL, 1.002) == HYDRO_ARMED);
    CHECK(hydro_flags(&arming, false, true) == (HYDRO_ARMED | HYDRO_SATURATED));
}

static void test_sensors(void)
{
    const uint32_t wild[3] = {0x7FC00000u, 0x7F800000u, 0xFF800000u};
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        for (int kind = 0; kind < 7; kind++) {
            hydro_real x[HYDRO_MEASURED];
            bool fault = kind < 5;
            memcpy(x, STILL, sizeof x);
            if (kind < 3) {
                fedisableexcept(FE_ALL_EXCEPT);
                x[i] = number(wild[kind]);
                feclearexcept(FE_ALL_EXCEPT);
                feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
            } else if (kind == 3 || kind == 5) {
                x[i] = CONFIG.high[i];
            } else {
                x[i] = CONFIG.low[i];
            }
            if (kind == 3 || kind == 4) {
                x[i] *= HYDRO_R(1.001);
            }
            begin();
            hydro_note_command(&arming, false, true, 1.0);
            CHECK(step(x, 1.0) == (fault ? HYDRO_SENSOR_FAULT | HYDRO_TRIPPED : 0u));
            CHECK(step(STILL, 1.001) == 0); /* gone, and a disarm was seen: clean */
            armed_at(2.0);
            hydro_note_command(&arming, true, true, 2.001);
            uint32_t flags = step(x, 2.001);
            CHECK(((flags & HYDRO_SENSOR_FAULT) != 0) == fault);
            CHECK(((flags & HYDRO_FORCE_LIMIT) != 0) == (i == 2 && kind != 0));
            CHECK(((flags & HYDRO_TRIPPED) != 0) == (fault || i == 2));
            CHECK(((flags & HYDRO_ARMED) == 0) == ((flags & HYDRO_TRIPPED) != 0));
            CHECK(step(STILL, 2.002) == flags); /* the causes stay until the disarm */
        }
    }
}

static void test_force_limit(void)
{
    hydro_real x[HYDRO_MEASURED];
    memcpy(x, STILL, sizeof x);
    x[2] = 800;
    begin(); /* disarmed: no limit */
    hydro_note_command(&arming, false, true, 0.999);
    CHECK(step(x, 0.999) == 0);
    hydro_note_command(&arming, true, true, 1.0);
    CHECK(step(x, 1.0) == HYDRO_ARMED);
    CHECK(arming.excess == HYDRO_R(800 - 700) + CONFIG.recovery_margin);
    x[2] = 819;
    arming.received_at = 1.001;
    CHECK(step(x, 1.001) == HYDRO_ARMED); /* may rise by 20 N at first */
    x[2] = HYDRO_R(759.9);
    arming.received_at = 1.5;
    CHECK(step(x, 1.5) == HYDRO_ARMED); /* half of the excess is left after half a second */
    x[2] = HYDRO_R(-760.1);
    CHECK(step(x, 1.5) == (HYDRO_FORCE_LIMIT | HYDRO_TRIPPED));
    CHECK(hydro_allowance(&arming, 2.0) == 0 && hydro_allowance(&arming, 5.0) == 0);
    CHECK(hydro_allowance(&arming, 1.25) == HYDRO_R(90));
    armed_at(3.0);
    x[2] = 700; /* the limit itself is allowed */
    CHECK(step(x, 3.0) == HYDRO_ARMED);
    x[2] = HYDRO_R(700.01);
    CHECK(step(x, 3.0) == (HYDRO_FORCE_LIMIT | HYDRO_TRIPPED));
    begin();
    x[2] = -700; /* begins at the limit: nothing beyond it */
    hydro_note_command(&arming, false, true, 0.0);
    (void)step(x, 0.0);
    hydro_note_command(&arming, true, true, 0.001);
    CHECK(step(x, 0.001) == HYDRO_ARMED && arming.excess == 0);
    hydro_note_command(&arming, false, true, 0.002);
    x[2] = HYDRO_R(700.5); /* half a newton beyond it is beyond it */
    (void)step(x, 0.002);
    hydro_note_command(&arming, true, true, 0.003);
    CHECK(step(x, 0.003) == HYDRO_ARMED && arming.excess == HYDRO_R(20.5));
    x[2] = 800;
    CHECK(step(x, 0.004) == (HYDRO_FORCE_LIMIT | HYDRO_TRIPPED));
    x[4] = HYDRO_R(-1e6); /* a second cause joins the first */
    CHECK(step(x, 0.005) == (HYDRO_FORCE_LIMIT | HYDRO_SENSOR_FAULT | HYDRO_TRIPPED));
    CHECK(!hydro_follow_arm(&arming, &CONFIG, x, 0.006)); /* tripped: begins nothing */
}

static void test_order(void)
{
    memset(&guard, 0xAA, sizeof guard);
    hydro_guard_reset(&guard);
    CHECK(guard.refused[0] == 0 && guard.refused[1] == 0 && guard.newest == 0);
    CHECK(guard.delta_kp == 0 && guard.delta_ki == 0 && guard.delta_u == 0);
    CHECK(hydro_in_order(&guard, 0xFFFFFFF0u)); /* any first one */
    CHECK(!hydro_in_order(&guard, 0xFFFFFFF0u) && !hydro_in_order(&guard, 0xFFFFFFEFu));
    CHECK(hydro_in_order(&guard, 3)); /* wraps */
    CHECK(!hydro_in_order(&guard, 0xFFFFFFFFu));
    CHECK(!hydro_in_order(&guard, 3u + 0x80000000u));
    CHECK(hydro_in_order(&guard, 3u + 0x7FFFFFFFu) && guard.newest == 3u + 0x7FFFFFFFu);
    guard.heard = false;
    CHECK(hydro_in_order(&guard, 1) && guard.heard);
}

static hydro_command command(hydro_real kp, hydro_real ki, hydro_real u, uint32_t broken)
{
    hydro_command made = {.broken = broken, .delta_kp = kp, .delta_ki = ki, .delta_u = u, .shaping = HYDRO_NEUTRAL};
    made.reference.frequency = 2.0;
    return made;
}

static void test_clamps(void)
{
    hydro_signal wanted = {0};
    hydro_command in = command(-55, 95, HYDRO_R(-0.1), 0);
    hydro_guard_reset(&guard);
    CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted));
    CHECK(guard.delta_kp == -55 && guard.delta_ki == 95 && guard.delta_u == HYDRO_R(-0.1) && guard.refused[0] == 0);
    in = command(-56, 96, HYDRO_R(0.11), 0);
    CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted));
    CHECK(guard.delta_kp == -55 && guard.delta_ki == 95 && guard.delta_u == HYDRO_R(0.1) && guard.refused[0] == 3);
    in = command(286, -26, HYDRO_R(-0.11), 0);
    CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted));
    CHECK(guard.delta_kp == 285 && guard.delta_ki == -25 && guard.delta_u == HYDRO_R(-0.1) && guard.refused[0] == 6);
    for (uint32_t bit = 1; bit < 8; bit <<= 1) {
        in = command(10, 10, HYDRO_R(0.01), bit);
        hydro_guard_reset(&guard);
        CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted) && guard.refused[0] == 1 && guard.refused[1] == 0);
        CHECK(guard.delta_kp == (bit == 1 ? 0 : 10) && guard.delta_ki == (bit == 2 ? 0 : 10));
        CHECK(guard.delta_u == (bit == 4 ? HYDRO_R(0) : HYDRO_R(0.01)));
    }
}

/* Coefficients and scales within the limits of the command's law; one that is none becomes the safe one. */
static void test_clamps_of_the_shaping(void)
{
    const hydro_law *law = &CONFIG.laws[HYDRO_COMPENSATED];
    hydro_signal wanted = {0};
    hydro_command in = command(-385, 20, 0, 0);
    in.law = HYDRO_COMPENSATED;
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        for (int kind = 0; kind < 5; kind++) {
            const hydro_real given[5] = {law->low[i], law->high[i], law->low[i] - 1, law->high[i] + 1, 0};
            const hydro_real taken[5] = {law->low[i], law->high[i], law->low[i], law->high[i], law->safe[i]};
            hydro_guard_reset(&guard);
            CHECK(guard.law == HYDRO_PAPER);
            in.broken = kind == 4 ? 16u << i : 0;
            hydro_copy(in.shaping, law->safe, sizeof in.shaping);
            in.shaping[i] = given[kind];
            CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted) && guard.law == HYDRO_COMPENSATED);
            CHECK(guard.delta_kp == -385 && guard.delta_ki == 20);
            CHECK(guard.refused[0] == (kind < 2 ? 0u : 1u) && guard.shaping[i] == taken[kind]);
        }
    }
}

static void test_references(void)
{
    hydro_signal wanted = {0};
    hydro_command in = command(0, 0, 0, 8);
    hydro_guard_reset(&guard);
    wanted.offset = 7;
    CHECK(!hydro_admit(&guard, &CONFIG, &in, &wanted) && wanted.offset == 7);
    CHECK(guard.refused[0] == 1 && guard.refused[1] == 1);
    in = command(0, 0, 0, 0);
    in.reference.amplitude = HYDRO_R(-0.5);
    CHECK(!hydro_admit(&guard, &CONFIG, &in, &wanted) && wanted.offset == 7 && guard.refused[1] == 2);
    in.reference.amplitude = 0;
    in.reference.offset = 5000; /* a hold: its frequency becomes 1, whatever it was */
    CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted) && wanted.offset == 5000 && wanted.frequency == 1.0);
    in.reference.amplitude = 1;
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.offset = -4999;
    CHECK(hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.offset = -5000;
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.offset = HYDRO_R(3e38); /* the sum of both would overflow a float */
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.amplitude = HYDRO_R(3e38);
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.amplitude = 1;
    in.reference.offset = 0;
    in.reference.amplitude = CONFIG.force_range;
    CHECK(hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.amplitude = 1;
    in.reference.offset = 0;
    in.reference.frequency = -1;
    CHECK(hydro_playable(&in.reference, CONFIG.force_range)); /* still a hold */
    in.reference.waveform = HYDRO_SINE;
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.frequency = 0;
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.frequency = 1e-3;
    CHECK(hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.frequency = 1000;
    CHECK(!hydro_playable(&in.reference, CONFIG.force_range));
    in.reference.frequency = 999.9;
    in.reference.amplitude = 100;
    CHECK(hydro_admit(&guard, &CONFIG, &in, &wanted));
    CHECK(wanted.waveform == HYDRO_SINE && wanted.frequency == 999.9 && wanted.amplitude == 100 && wanted.offset == 0);
}

/* The whole box: what a tick does with the command, and that the current is 0 unless it is armed. */
static void test_box(void)
{
    static hydro_box box;
    const float gains[3] = {10.0f, 1.0f, 0.001f}, shape[4] = {100.0f, 50.0f, 1.0f, 0.0f};
    const float strong[3] = {0.0f, 0.0f, 0.1f};
    uint8_t payload[72] = {0}, wire[HYDRO_ENCODED_MAX], out[HYDRO_BURST_MAX];
    memset(&box, 0xAA, sizeof box);
    hydro_box_power_on(&box, &CONFIG, 9);
    CHECK(hydro_box_tick(&box, STILL, 0.0) == 0 && box.sample.sequence == 0);
    CHECK(hydro_box_frames(&box, out) == GREETING + 133);
    CHECK(hydro_box_frames(&box, out) == 133);
    host_command(payload, 0, gains, HYDRO_SINE, shape);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 5, payload, 72, wire));
    CHECK(hydro_box_tick(&box, STILL, 0.001) == 0 && box.sample.values[HYDRO_KP] == 25 && box.confirmed == 5);
    CHECK(box.sample.values[HYDRO_REFERENCE] == 0 && box.sample.flags == HYDRO_FILTER_STALE);
    host_command(payload, 3, gains, HYDRO_SINE, shape);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 6, payload, 72, wire));
    CHECK(hydro_box_tick(&box, STILL, 0.002) == HYDRO_R(0.001f) && box.sample.flags == HYDRO_ARMED);
    CHECK(box.sample.values[HYDRO_NOMINAL] == 0 && box.sample.values[HYDRO_REFERENCE_RATE] == 0);
    for (int k = 3; k < 53; k++) {
        (void)hydro_box_tick(&box, STILL, k * 1e-3);
        hydro_real more = box.sample.values[HYDRO_CURRENT] - box.sample.values[HYDRO_NOMINAL];
        CHECK(k <= 5 ? more > HYDRO_R(0.0009) : more == 0); /* the correction acts for three samples, the gains go on */
        CHECK(box.sample.values[HYDRO_KI] == 6);
    }
    (void)hydro_box_tick(&box, STILL, 0.0531); /* late: base gains, no correction, the integral goes on */
    CHECK(box.sample.values[HYDRO_KP] == 15 && box.sample.values[HYDRO_KI] == 5 && box.integral > 0);
    CHECK(box.sample.values[HYDRO_CURRENT] == box.sample.values[HYDRO_NOMINAL]);
    host_command(payload, 3, strong, HYDRO_SINE, shape);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 7, payload, 72, wire));
    CHECK(hydro_box_tick(&box, STILL, 0.0541) == CONFIG.bench.valve_current_max);
    CHECK((box.sample.flags & HYDRO_SATURATED) != 0);
    hydro_real held = box.integral; /* anti-windup: it stands while it would push further out */
    (void)hydro_box_tick(&box, STILL, 0.0551);
    CHECK(box.integral == held && held > 0);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 7, payload, 72, wire)); /* again: refused */
    CHECK(box.stale == 1 && !box.has_now);
    memset(payload, 0, sizeof payload); /* a greeting disarms; what comes behind it waits a sample */
    payload[0] = 1;
    payload[1] = 2;
    hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, payload, 72, wire));
    host_command(payload, 1, gains, HYDRO_HOLD, shape);
    hydro_box_bytes(&box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, 1, payload, 72, wire));
    CHECK(hydro_box_tick(&box, STILL, 0.056) == 0 && box.sample.flags == HYDRO_FILTER_STALE);
    CHECK(hydro_box_frames(&box, out) == GREETING + 133 && box.confirmed == 7);
    CHECK(hydro_box_tick(&box, STILL, 0.057) == HYDRO_R(0.001f) && box.confirmed == 1 && box.integral == 0);
    payload[2] = 1; /* the HELLO of a box is none of a host */
    hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, payload, 72, wire));
    CHECK(box.greetings == 1);
}

/* A COMMAND at a sample, after which it is ticked. */
static void follow(hydro_box *box, uint32_t sequence, bool arm, uint32_t law, const float shaping[HYDRO_SHAPING])
{
    const float gains[3] = {-300.0f, 4.0f, 0.001f}, shape[4] = {0.0f, 600.0f, 1.0f, 0.0f};
    uint8_t payload[72] = {0}, wire[HYDRO_ENCODED_MAX];
    host_command(payload, arm ? 3 : 2, gains, HYDRO_HOLD, shape);
    hydro_write32(payload + 40, law);
    memcpy(payload + 44, shaping, 28);
    hydro_box_bytes(box, wire, host_frame(HYDRO_VERSION, HYDRO_COMMAND, sequence, payload, 72, wire));
    (void)hydro_box_tick(box, STILL, sequence * 1e-3);
}

/* Taken up at arming; while armed a command for another law, or none, leaves its safe state, reached step by step. */
static void test_the_compensated_law(void)
{
    static hydro_box box;
    static const float asked[HYDRO_SHAPING] = {1.125f, 0.0625f, 0.0f, 16.0f, 0.0f, 0.5f, 2.0f};
    const hydro_law *law = &CONFIG.laws[HYDRO_COMPENSATED], *paper = &CONFIG.laws[HYDRO_PAPER];
    hydro_real x[HYDRO_MEASURED], before;
    uint32_t k;
    memset(&box, 0xAA, sizeof box);
    memcpy(x, STILL, sizeof x);
    x[4] = -1e7f;
    hydro_box_power_on(&box, &CONFIG, 9);
    box.guard.law = HYDRO_COMPENSATED;
    hydro_note_command(&box.arming, true, true, 0.0);
    (void)hydro_box_tick(&box, x, 0.0); /* a fault before it could arm: the law is not taken up */
    CHECK(box.acting.law == HYDRO_PAPER && memcmp(box.acting.shaping, paper->safe, sizeof paper->safe) == 0);
    hydro_box_power_on(&box, &CONFIG, 9);
    follow(&box, 1, false, HYDRO_PAPER, asked);
    CHECK(box.acting.law == HYDRO_PAPER && box.acting.reference == STILL[2] && box.acting.reference_rate == 0);
    follow(&box, 2, true, HYDRO_COMPENSATED, asked);
    CHECK(box.acting.law == HYDRO_COMPENSATED && box.sample.values[HYDRO_KP] == 100);
    CHECK(box.sample.values[HYDRO_KI] == 20 && near(box.acting.shaping[0], 1.0005)); /* begins at its safe state */
    CHECK(near(box.acting.shaping[5], 0.251) && near(box.acting.shaping[6], 1.002));
    for (k = 3; k < 700; k++) {
        follow(&box, k, true, HYDRO_COMPENSATED, asked);
    }
    CHECK(box.acting.shaping[0] == HYDRO_R(1.125) && box.acting.shaping[5] == HYDRO_R(0.5));
    CHECK(near(box.acting.reference / 1000, 0.691) && box.sample.values[HYDRO_REFERENCE] == 600);
    before = box.integral;
    follow(&box, k++, true, HYDRO_COMPENSATED, asked);
    CHECK(near(box.sample.values[HYDRO_NOMINAL] * hydro_input_gain(&CONFIG.bench, STILL[6], STILL[4], STILL[5], 1) * 2
               / (100 * 691 + before), 1.0));
    follow(&box, k++, true, HYDRO_PAPER, asked); /* for another law: the safe state, one step nearer */
    CHECK(box.acting.law == HYDRO_COMPENSATED && box.sample.values[HYDRO_KP] == 400);
    CHECK(box.sample.values[HYDRO_KI] == 16 && near(box.acting.shaping[0], 1.1245));
    CHECK(box.sample.values[HYDRO_CURRENT] == box.sample.values[HYDRO_NOMINAL]); /* and no correction */
    follow(&box, k, true, HYDRO_COMPENSATED, asked);
    CHECK(box.sample.values[HYDRO_KP] == 100 && box.acting.shaping[0] == HYDRO_R(1.125));
    for (int late = 1; late < 190; late++) { /* no commands: from the 51st on the safe state, step by step */
        (void)hydro_box_tick(&box, STILL, (k + (uint32_t)late) * 1e-3 + 1e-4);
        CHECK(box.sample.values[HYDRO_KP] == (late < 50 ? 100 : 400));
        CHECK(near(box.acting.shaping[0], 1.125 - (late < 50 ? 0.0 : 0.0005 * (late - 49))));
    }
    follow(&box, k + 190, false, HYDRO_PAPER, asked);
    CHECK(box.acting.law == HYDRO_PAPER && memcmp(box.acting.shaping, paper->safe, sizeof paper->safe) == 0);
    follow(&box, k + 191, false, HYDRO_COMPENSATED, asked); /* while disarmed the law is the one that is asked for */
    CHECK(box.acting.law == HYDRO_COMPENSATED && memcmp(box.acting.shaping, law->safe, sizeof law->safe) == 0);
}

int main(void)
{
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    test_power_on();
    test_arming_needs_a_disarm_first();
    test_watchdog_to_the_millisecond();
    test_filter_fresh();
    test_sensors();
    test_force_limit();
    test_order();
    test_clamps();
    test_clamps_of_the_shaping();
    test_references();
    test_box();
    test_stream();
    test_lengths();
    test_numbers();
    test_waveforms();
    test_references_of_the_page();
    test_derivatives();
    test_reset_of_references();
    test_fades();
    test_force_law();
    test_leap();
    test_currents_of_the_page();
    test_compensation();
    test_rates();
    test_frames_of_the_page();
    test_a_command_of_the_page();
    test_parts_of_a_command();
    test_unstuffing();
    test_conversation();
    test_a_box_begins_anew();
    test_what_waits();
    test_an_armed_sample();
    test_a_current_that_cannot_be();
    test_the_compensated_law();
    return 0;
}
