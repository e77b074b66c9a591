/* SPDX-License-Identifier: Apache-2.0 */
/* Optional, beside the filter: whether the model still fits the bench, by its predictions of one sample.
 *
 * Of three consecutive samples the middle one gives the model's state, and the outer two its change. The predicted load
 * is the simulated state of its amplifier. Static friction may have any force up to its level, and nobody knows how
 * bristles are bent at the start: below `creep` the best-fitting force is taken. Behind a lagging sensor, a chamber's
 * error is what the observer corrects of its pressure in a sample. The equations are then independent, and none has the
 * lag of the box's velocity. Their errors, T = 1 ms:
 *
 *   load             f_l - (gain F + bias)        F: the spring's force at x_p, behind the load cell's amplifier     N
 *   motion           m (x_p'' - model's)          x_p'' of three positions                                           N
 *   hydraulic force  f_h - (A p_a - alpha A p_b), with the cell's gain and bias                                      N
 *   chamber a, b     (p_next - p_last) / 2 - T p'                                                                  Pa
 *
 * The test is a two-sided CUSUM (Page, Biometrika 41, 1954) of each error relative to its allowance:
 *
 *   z = error / (allowed + SHARE size), within +-CLIP       up = max(0, up + z - 1)     down = max(0, down - z - 1)
 *
 * A sum above ALARM means that the equation does not hold. A learned model has small lasting errors (friction, leakage,
 * temperature) and large ones for some milliseconds (a spool at its rate limit): the allowance covers the former, the
 * clip the latter. Sensor noise is far below both: in the mean over the 50 samples of an alarm 0.1 N of load, 0.3 N of
 * motion, 0.2 N of hydraulic force, 85 Pa of a chamber. Noise alone therefore raises no alarm. An alarm persists until
 * the equations have held for RETURN samples that excite the bench at least half as much as when it was raised: neither
 * a gap nor a new arming ends it. Measurements: filter.md.
 */
#ifndef HYDRO_MONITOR_H
#define HYDRO_MONITOR_H

#include "loop.h"

#define HYDRO_EQUATIONS 5
#define HYDRO_MONITOR_SHARE 0.05 /* of an equation's terms: the accuracy of learning, sufficient for the certificate */
#define HYDRO_MONITOR_CLIP 5.0
#define HYDRO_ALARM 50.0 /* samples at twice the allowance; a larger error takes fewer, at least 13 */
#define HYDRO_RETURN 3000 /* samples */
#define HYDRO_SETTLING 100 /* samples after a gap until the simulated spool and amplifier have converged */

enum { HYDRO_SEEN_F_H, HYDRO_SEEN_F_L, HYDRO_SEEN_P_A, HYDRO_SEEN_P_B, HYDRO_SEEN_X };

/* All zero at first. */
typedef struct {
    hydro_real last[HYDRO_READINGS], middle[HYDRO_READINGS]; /* readings of the last two samples */
    hydro_real hidden[HYDRO_STATES], opening;                /* of the middle one */
    hydro_real cell;                                         /* what the load cell shows there */
    hydro_real sums[HYDRO_EQUATIONS][2];
    int32_t runs[HYDRO_EQUATIONS][2]; /* for how many samples each is above zero */
    int32_t seen, broken, held; /* broken: 1 + the equation's place; held: samples since then that it was excited */
    hydro_real ratio, effort;   /* how many times what is allowed it was off, and what moved then */
} hydro_monitor;

/* Samples are missing, or these are the first; what was found is kept. */
static inline void hydro_monitor_skip(hydro_monitor *monitor)
{
    monitor->seen = monitor->held = 0;
    for (int i = 0; i < HYDRO_EQUATIONS; i++) {
        for (int side = 0; side < 2; side++) {
            monitor->sums[i][side] = HYDRO_R(0);
            monitor->runs[i][side] = 0;
        }
    }
}

/* Each equation's error at the middle sample, and the size of its terms. */
static inline void hydro_innovations(
    const hydro_loop *loop, const hydro_monitor *monitor, const hydro_real *x, hydro_real *error, hydro_real *size)
{
    const hydro_real *last = monitor->last, *middle = monitor->middle, *gain = loop->gain;
    const hydro_real period = HYDRO_R(HYDRO_PERIOD), opening = monitor->opening;
    hydro_real y[HYDRO_STATES], state[HYDRO_STATES], slopes[HYDRO_SLOPES], measured[HYDRO_MEASURED] = {HYDRO_R(0)};
    hydro_real speed = (x[6] - last[HYDRO_SEEN_X]) / (HYDRO_R(2) * period * gain[4]), rate_a, rate_b, pushed;
    hydro_real bend = (x[6] - HYDRO_R(2) * middle[HYDRO_SEEN_X] + last[HYDRO_SEEN_X]) / (period * period * gain[4]);
    hydro_sensitivity at;
    measured[4] = middle[HYDRO_SEEN_P_A];
    measured[5] = middle[HYDRO_SEEN_P_B];
    measured[6] = middle[HYDRO_SEEN_X];
    hydro_lift(loop, monitor->hidden, measured, false, y);
    y[3] = speed;
    hydro_chosen(loop, y, state);
    at = hydro_sensitivity_at(loop, state, opening);
    (void)hydro_held(loop, &loop->whole, y, opening, slopes);
    rate_a = slopes[0];
    rate_b = slopes[1];
    error[1] = loop->mass * (bend - slopes[3]);
    if (loop->level > HYDRO_R(0) && hydro_abs(speed) < loop->creep) {
        hydro_real whole, level, left;
        y[3] = state[3] = hydro_copysign(loop->creep, speed);
        (void)hydro_held(loop, &loop->whole, y, opening, slopes);
        whole = slopes[3];
        (void)hydro_held(loop, &loop->linear, state, HYDRO_R(0), slopes);
        level = hydro_max(loop->level, loop->mass * hydro_abs(slopes[3] - whole));
        y[3] = state[3] = speed;
        (void)hydro_held(loop, &loop->linear, state, HYDRO_R(0), slopes);
        left = loop->mass * (bend - slopes[3]);
        error[1] = left - hydro_clamp(left, -level, level);
    }
    pushed = loop->area * (y[0] - loop->ratio * y[1]);
    size[1] = hydro_abs(pushed);
    pushed = gain[0] * (loop->force_shown == HYDRO_NONE ? pushed : monitor->hidden[loop->force_shown]);
    error[0] = middle[HYDRO_SEEN_F_L] - gain[1] * monitor->cell - loop->bias[1];
    error[2] = middle[HYDRO_SEEN_F_H] - pushed - loop->bias[0];
    error[3] = HYDRO_R(0.5) * (x[4] - last[HYDRO_SEEN_P_A]) / gain[2] - period * rate_a;
    error[4] = HYDRO_R(0.5) * (x[5] - last[HYDRO_SEEN_P_B]) / gain[3] - period * rate_b;
    for (int i = 0; i < loop->lagging_count; i++) {
        int chamber = loop->lagging[i].chamber;
        error[3 + chamber] = y[chamber] - monitor->hidden[chamber];
    }
    size[0] = hydro_abs(gain[1] * monitor->cell);
    size[2] = hydro_abs(pushed);
    size[3] = period * (hydro_abs(rate_a) + at.soft_a * hydro_abs(speed));
    size[4] = period * (hydro_abs(rate_b) + at.soft_b * hydro_abs(speed));
}

/* Move the sums and the alarm on by the errors. */
static inline void hydro_cusum(
    const hydro_loop *loop, hydro_real limit, hydro_monitor *monitor, const hydro_real *error, const hydro_real *size)
{
    const hydro_real clip = HYDRO_R(HYDRO_MONITOR_CLIP), alarm = HYDRO_R(HYDRO_ALARM);
    hydro_real highest = HYDRO_R(0);
    for (int i = 0; i < HYDRO_EQUATIONS; i++) {
        hydro_real allowed = limit * (loop->allowed[i] + HYDRO_R(HYDRO_MONITOR_SHARE) * size[i]);
        hydro_real z = hydro_clamp(error[i] / allowed, -clip, clip);
        for (int side = 0; side < 2; side++) {
            hydro_real total = monitor->sums[i][side] + (side == 0 ? z : -z) - HYDRO_R(1);
            total = hydro_clamp(total, HYDRO_R(0), HYDRO_R(2) * alarm);
            monitor->sums[i][side] = total;
            monitor->runs[i][side] = total > HYDRO_R(0) ? monitor->runs[i][side] + 1 : 0;
            highest = hydro_max(highest, total);
            if (total > alarm && monitor->broken == 0) {
                monitor->broken = i + 1;
                monitor->held = 0;
                monitor->ratio = HYDRO_R(1) + total / (hydro_real)monitor->runs[i][side];
                monitor->effort = hydro_max(HYDRO_R(0.5) * size[i], limit * loop->allowed[i]);
            }
        }
    }
    if (monitor->broken != 0) {
        bool moved = size[monitor->broken - 1] >= monitor->effort;
        monitor->held = highest > HYDRO_R(0.5) * alarm ? 0 : monitor->held + (moved ? 1 : 0);
        if (monitor->held >= HYDRO_RETURN) {
            monitor->broken = 0;
        }
    }
}

/* Take in a sample, finite, with the filter's memory as it is before its decision; `limit` scales what is allowed.
 * `broken` then says which equation does not hold. */
static inline void hydro_watch(
    const hydro_loop *loop, hydro_real limit, hydro_monitor *monitor, const hydro_memory_of_loop *memory,
    const hydro_real *x)
{
    hydro_real error[HYDRO_EQUATIONS], size[HYDRO_EQUATIONS];
    monitor->cell = monitor->hidden[loop->whole.cell];
    if (loop->whole.spool == HYDRO_NONE) { /* such a valve steps at the middle sample: its mean is taken */
        monitor->opening = HYDRO_R(0.5) * (monitor->opening + memory->opening);
    }
    if (monitor->seen > HYDRO_SETTLING) {
        hydro_innovations(loop, monitor, x, error, size);
        hydro_cusum(loop, limit, monitor, error, size);
    }
    if (monitor->seen <= HYDRO_SETTLING) {
        monitor->seen++;
    }
    for (int i = 0; i < HYDRO_READINGS; i++) {
        monitor->last[i] = monitor->middle[i];
    }
    monitor->middle[HYDRO_SEEN_F_H] = x[0];
    monitor->middle[HYDRO_SEEN_F_L] = x[2];
    monitor->middle[HYDRO_SEEN_P_A] = x[4];
    monitor->middle[HYDRO_SEEN_P_B] = x[5];
    monitor->middle[HYDRO_SEEN_X] = x[6];
    for (int i = 0; i < loop->whole.states; i++) {
        monitor->hidden[i] = memory->hidden[i];
    }
    monitor->opening = memory->opening;
}

#endif
