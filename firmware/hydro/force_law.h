/* SPDX-License-Identifier: Apache-2.0 */
/* The feedback-linearising force law with its integral; docs/manual/explanation/physics.md has h and g. */
#ifndef HYDRO_FORCE_LAW_H
#define HYDRO_FORCE_LAW_H

#include "reference.h"

#define HYDRO_BUMPLESS 2u

/* f_c into `state`, whose shaping comes nearer to the wanted one by one sample; where f_c is cut off, f_c' is 0. f_c
 * jumps with its second and third derivative. */
static inline void hydro_compensate(
    hydro_law_state *state, const hydro_law *law, const hydro_real *wanted, const hydro_wave *wave)
{
    const hydro_real period = HYDRO_R(HYDRO_PERIOD);
    const hydro_real terms[HYDRO_COEFFICIENTS] = {wave->value, wave->rate, wave->second, HYDRO_R(1), wave->third};
    const hydro_real slopes[HYDRO_COEFFICIENTS] = {wave->rate, wave->second, wave->third, HYDRO_R(0), wave->fourth};
    hydro_real value = HYDRO_R(0), rate = HYDRO_R(0);
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        hydro_real step = law->rate[i] * period;
        hydro_real change = hydro_clamp(wanted[i] - state->shaping[i], -step, step);
        state->shaping[i] += change;
        if (i < HYDRO_COEFFICIENTS) {
            value += state->shaping[i] * terms[i];
            rate += state->shaping[i] * slopes[i] + change / period * terms[i];
        }
    }
    state->reference = hydro_clamp(value, -law->reference_max, law->reference_max);
    state->reference_rate = state->reference == value ? rate : HYDRO_R(0);
}

/* sqrt of a pressure drop [Pa], odd. */
static inline hydro_real hydro_signed_sqrt(hydro_real drop)
{
    return drop < HYDRO_R(0) ? -HYDRO_SQRT(-drop) : HYDRO_SQRT(drop);
}

static inline hydro_real hydro_volume_a(const hydro_bench *bench, hydro_real position)
{
    return bench->dead_volume_a + bench->piston_area * position;
}

static inline hydro_real hydro_volume_b(const hydro_bench *bench, hydro_real position)
{
    return bench->dead_volume_b + bench->area_ratio * bench->piston_area * (bench->stroke - position);
}

/* f_h' [N/s] of flows [m3/s] into both chambers and a velocity [m/s]. */
static inline hydro_real hydro_force_rate(
    const hydro_bench *bench, hydro_real position, hydro_real flow_a, hydro_real flow_b, hydro_real velocity)
{
    hydro_real swept = bench->piston_area * velocity;
    hydro_real rate_a = bench->bulk_modulus / hydro_volume_a(bench, position) * (flow_a - swept);
    hydro_real rate_b = bench->bulk_modulus / hydro_volume_b(bench, position) * (flow_b + bench->area_ratio * swept);
    return bench->piston_area * (rate_a - bench->area_ratio * rate_b);
}

/* h [N/s]: what moving does to the hydraulic force. */
static inline hydro_real hydro_velocity_term(const hydro_bench *bench, hydro_real position, hydro_real velocity)
{
    return hydro_force_rate(bench, position, HYDRO_R(0), HYDRO_R(0), velocity);
}

/* g [N/s/A] for currents with the sign of `opening`. */
static inline hydro_real hydro_input_gain(
    const hydro_bench *bench, hydro_real position, hydro_real pressure_a, hydro_real pressure_b, hydro_real opening)
{
    hydro_real drop_a, drop_b, gain_a, gain_b;
    if (opening >= HYDRO_R(0)) {
        drop_a = bench->supply_pressure - pressure_a;
        drop_b = pressure_b - bench->tank_pressure;
    } else {
        drop_a = pressure_a - bench->tank_pressure;
        drop_b = bench->supply_pressure - pressure_b;
    }
    gain_a = bench->valve_gain * hydro_signed_sqrt(drop_a);
    gain_b = bench->valve_gain * hydro_signed_sqrt(drop_b);
    return hydro_force_rate(bench, position, gain_a, -gain_b, HYDRO_R(0));
}

/* Of the largest current: over so much to either side of the closed valve the law leaps over the overlap. */
#define HYDRO_LEAP 2e-3

/* Current [A] that opens a valve with the bench's overlap as `current` [A] opens one without. */
static inline hydro_real hydro_leap(const hydro_bench *bench, hydro_real current)
{
    hydro_real width = HYDRO_R(HYDRO_LEAP) * bench->valve_current_max;
    hydro_real share = hydro_clamp((current - bench->closing) / width, HYDRO_R(-1), HYDRO_R(1));
    return current + share * (share < HYDRO_R(0) ? bench->overlap_back : bench->overlap_out);
}

/* The current [A] of which `hydro_leap` makes `leapt` [A]. */
static inline hydro_real hydro_before_leap(const hydro_bench *bench, hydro_real leapt)
{
    hydro_real overlap = leapt < bench->closing ? bench->overlap_back : bench->overlap_out;
    hydro_real width = HYDRO_R(HYDRO_LEAP) * bench->valve_current_max + overlap;
    return leapt - overlap * hydro_clamp((leapt - bench->closing) / width, HYDRO_R(-1), HYDRO_R(1));
}

/* u_nom [A] before correction and saturation; `action` is I [N/s], `scales` are C_1 and C_2. */
static inline hydro_real hydro_nominal_current(
    const hydro_config *config, const hydro_real *measurement, hydro_real error, hydro_real action,
    hydro_real reference_rate, hydro_real proportional_gain, const hydro_real *scales)
{
    const hydro_bench *bench = &config->bench;
    hydro_real position = hydro_clamp(measurement[6], HYDRO_R(0), bench->stroke);
    hydro_real wanted = reference_rate + proportional_gain * error + action;
    hydro_real driven = wanted - scales[0] * hydro_velocity_term(bench, position, measurement[7]);
    hydro_real gain = scales[1] * hydro_input_gain(bench, position, measurement[4], measurement[5], driven);
    return hydro_leap(bench, driven / hydro_max(gain, config->gain_floor));
}

/* I [N/s] of what the integrator carries. */
static inline hydro_real hydro_action(uint32_t form, hydro_real integral, hydro_real integral_gain)
{
    return form == HYDRO_BUMPLESS ? integral : integral_gain * integral;
}

/* What the integrator carries after one period, e = f_r - f; it stands while K_i e would push a saturated current
 * further out. */
static inline hydro_real hydro_integrate(
    uint32_t form, hydro_real integral, hydro_real error, hydro_real integral_gain, hydro_real beyond)
{
    hydro_real slope = integral_gain * error;
    if (beyond * slope > HYDRO_R(0)) {
        return integral;
    }
    return integral + (form == HYDRO_BUMPLESS ? slope : error) * HYDRO_R(HYDRO_PERIOD);
}

#endif
