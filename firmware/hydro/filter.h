/* SPDX-License-Identifier: Apache-2.0 */
/* Optional: the contraction filter with the constant metric on the analytic bench, one sample at a time.
 *
 *   a = 2 v' M B,   b = -(2 v' M B (K v) + 2 lambda v' M v),   smallest |du| with a du <= b within the valve's rest
 *
 * v = (f_l - f_r) / scale lies along the load force alone, and no equation of the bench reads the load force: of A
 * nothing is left, of K only -K_p/g, of M one row. docs/manual/explanation/safety.md has the certificate. Give it armed
 * samples; one that is none of a bench gets NAN. `ros2 run hydro_filter export_c` writes HYDRO_FILTER.
 */
#ifndef HYDRO_FILTER_H
#define HYDRO_FILTER_H

#include "force_law.h"

#define HYDRO_LEAST_IMPROVEMENT 0.01 /* share of the violation that a correction at the valve's limit must remove */
#define HYDRO_SMALLEST_DROP 1e3      /* Pa, no slope of a square root is taken nearer to zero pressure drop */

enum { HYDRO_PASS = 0, HYDRO_MODIFIED = 1, HYDRO_RELAXED = 2, HYDRO_INFEASIBLE = 3, HYDRO_NAN = 4 };

typedef struct {
    hydro_bench bench;
    hydro_real gain_floor;             /* N/s/A */
    hydro_real metric[HYDRO_MEASURED]; /* row of M along the load force, on normalized states */
    hydro_real scale[HYDRO_MEASURED];  /* what each state is divided by */
    hydro_real contraction_rate;       /* lambda, 1/s */
    hydro_real noise_floor;            /* N, force errors up to it are none */
} hydro_filter;

typedef struct {
    hydro_real delta_u;       /* A, finite */
    hydro_real before, after; /* M_c without and with it, 1/s; 0 where something was not finite */
    uint32_t status;
} hydro_decision;

/* Roots of both lands' pressure drops, and their slopes by the pressure of the land's own chamber. */
typedef struct {
    hydro_real root_a, root_b, slope_a, slope_b;
} hydro_lands;

static inline hydro_lands hydro_open_lands(
    const hydro_bench *bench, hydro_real pressure_a, hydro_real pressure_b, hydro_real opening)
{
    bool forward = opening >= HYDRO_R(0);
    hydro_real drop_a = forward ? bench->supply_pressure - pressure_a : pressure_a - bench->tank_pressure;
    hydro_real drop_b = forward ? pressure_b - bench->tank_pressure : bench->supply_pressure - pressure_b;
    hydro_real half = forward ? HYDRO_R(-0.5) : HYDRO_R(0.5);
    hydro_lands lands;
    lands.root_a = hydro_signed_sqrt(drop_a);
    lands.root_b = hydro_signed_sqrt(drop_b);
    lands.slope_a = half / HYDRO_SQRT(hydro_max(hydro_abs(drop_a), HYDRO_R(HYDRO_SMALLEST_DROP)));
    lands.slope_b = -half / HYDRO_SQRT(hydro_max(hydro_abs(drop_b), HYDRO_R(HYDRO_SMALLEST_DROP)));
    return lands;
}

/* g = dF/du of f_h' = F(x, u) at a state and a current [A]: all of B that the metric's row of f_l sees. */
static inline hydro_real hydro_input_slope(const hydro_bench *bench, const hydro_real *x, hydro_real current)
{
    hydro_lands lands = hydro_open_lands(bench, x[4], x[5], current);
    hydro_real soft_a = bench->bulk_modulus * (HYDRO_R(1) / hydro_volume_a(bench, x[6]));
    hydro_real soft_b = bench->bulk_modulus * (HYDRO_R(1) / hydro_volume_b(bench, x[6]));
    hydro_real to_a = soft_a * (bench->valve_gain * lands.root_a);
    hydro_real to_b = soft_b * (bench->valve_gain * lands.root_b);
    return bench->piston_area * (to_a + bench->area_ratio * to_b);
}

/* An error [N], zero up to `floor` and untouched from twice that. */
static inline hydro_real hydro_dead_zone(hydro_real error, hydro_real floor)
{
    hydro_real size = hydro_abs(error), share;
    if (size >= HYDRO_R(2) * floor || !(size > HYDRO_R(0))) {
        return error;
    }
    if (size <= floor) {
        return HYDRO_R(0);
    }
    share = size / floor - HYDRO_R(1);
    return error * share * share * (HYDRO_R(3) - HYDRO_R(2) * share);
}

/* The half-line a du <= b. */
static inline void hydro_half_line(
    const hydro_filter *filter, const hydro_real *x, hydro_real nominal, hydro_real reference, hydro_real k_p,
    hydro_real *a, hydro_real *b)
{
    hydro_real limit = filter->bench.valve_current_max;
    hydro_real law = -k_p / hydro_max(hydro_input_gain(&filter->bench, x[6], x[4], x[5], nominal), filter->gain_floor);
    hydro_real v = -hydro_dead_zone(reference - x[2], filter->noise_floor) / filter->scale[2];
    hydro_real feedback = law * (filter->scale[2] * v), weight = filter->metric[0] * v;
    hydro_real slope = hydro_input_slope(&filter->bench, x, hydro_clamp(nominal, -limit, limit));
    hydro_real drift = weight * (slope * feedback) / filter->scale[0];
    *a = HYDRO_R(2) * (weight * slope / filter->scale[0]);
    *b = -(HYDRO_R(2) * drift + HYDRO_R(2) * filter->contraction_rate * (filter->metric[2] * v * v));
}

/* min |du| with a du <= b and low <= du <= high, low <= 0 <= high; never divides by an `a` that vanishes. */
static inline hydro_real hydro_closed_form(
    hydro_real a, hydro_real b, hydro_real low, hydro_real high, uint32_t *status)
{
    hydro_real bound = a > HYDRO_R(0) ? low : high, reach = a * bound;
    *status = HYDRO_PASS;
    if (b >= HYDRO_R(0)) {
        return HYDRO_R(0);
    }
    if (reach <= b) {
        *status = HYDRO_MODIFIED;
        return b / a;
    }
    if (reach > HYDRO_R(HYDRO_LEAST_IMPROVEMENT) * b) {
        *status = HYDRO_INFEASIBLE;
        return HYDRO_R(0);
    }
    *status = HYDRO_RELAXED;
    return bound;
}

/* Whether a chamber has half of its dead volume [m3] at least, `position` [m] from its end. */
static inline bool hydro_has_room(hydro_real area, hydro_real dead, hydro_real position)
{
    return area * position > HYDRO_R(-0.5) * dead;
}

/* Whether a sample can be one of a bench, far beyond what its sensors show: within this nothing overflows. */
static inline bool hydro_conceivable(
    const hydro_bench *bench, const hydro_real *x, hydro_real nominal, hydro_real reference, hydro_real k_p)
{
    static const hydro_real most[HYDRO_MEASURED] = {
        HYDRO_R(1e5), HYDRO_R(1e9), HYDRO_R(1e5), HYDRO_R(1e9), HYDRO_R(1e8), HYDRO_R(1e8), HYDRO_R(1), HYDRO_R(20)};
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        if (!hydro_within(x[i], most[i])) {
            return false;
        }
    }
    return hydro_within(nominal, HYDRO_R(1e4)) && hydro_within(reference, HYDRO_R(1e5))
           && hydro_within(k_p, HYDRO_R(1e4)) && hydro_has_room(bench->piston_area, bench->dead_volume_a, x[6])
           && hydro_has_room(bench->area_ratio * bench->piston_area, bench->dead_volume_b, bench->stroke - x[6]);
}

/* Decide about one sample: its measurement, u_nom [A], f_r [N] and K_p [1/s]. */
static inline hydro_decision hydro_decide(
    const hydro_filter *filter, const hydro_real *x, hydro_real nominal, hydro_real reference, hydro_real k_p)
{
    hydro_decision made = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_NAN};
    hydro_real limit = filter->bench.valve_current_max, applied, change, a, b;
    if (!hydro_conceivable(&filter->bench, x, nominal, reference, k_p)) {
        return made;
    }
    hydro_half_line(filter, x, nominal, reference, k_p, &a, &b);
    if (!hydro_finite(a) || !hydro_finite(b)) {
        return made;
    }
    applied = hydro_clamp(nominal, -limit, limit);
    change = hydro_closed_form(a, b, -limit - applied, limit - applied, &made.status);
    made.before = -b;
    made.after = a * change - b;
    if (change < HYDRO_R(0) || change > HYDRO_R(0)) {
        made.delta_u = change + (applied - nominal); /* sat(u_nom + delta_u) = sat(u_nom) + change */
    }
    return made;
}

#endif
