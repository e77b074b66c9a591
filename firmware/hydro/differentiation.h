/* SPDX-License-Identifier: Apache-2.0 */
/* From five readings to the measurement: rates of the forces and of the position.
 *
 * r_k = a r_{k-1} + (1 - a) (z_k - z_{k-1}) / T lags by T/2 + T a/(1 - a) at low frequency: its age.
 */
#ifndef HYDRO_DIFFERENTIATION_H
#define HYDRO_DIFFERENTIATION_H

#include "config.h"

typedef struct {
    bool begun;
    hydro_real last[3];                          /* f_h, f_l, x_p one sample before */
    hydro_real force_memory, velocity_memory;    /* a */
} hydro_rates;

static inline hydro_real hydro_memory(hydro_real age)
{
    hydro_real samples = age / HYDRO_R(HYDRO_PERIOD);
    return (samples - HYDRO_R(0.5)) / (samples + HYDRO_R(0.5));
}

static inline void hydro_rates_reset(hydro_rates *rates, const hydro_config *config)
{
    rates->begun = false;
    rates->force_memory = hydro_memory(config->force_rate_age);
    rates->velocity_memory = hydro_memory(config->velocity_age);
}

static inline hydro_real hydro_rate(hydro_real memory, hydro_real rate, hydro_real now, hydro_real before)
{
    return memory * rate + (HYDRO_R(1) - memory) * (now - before) / HYDRO_R(HYDRO_PERIOD);
}

/* Readings f_h, f_l, p_a, p_b, x_p into the measurement, which is also the memory of its rates. A reading that is not
 * finite, or so large that no sensor gives it, leaves the rate beside it as it was: the box trips on the reading. */
static inline void hydro_differentiate(hydro_rates *rates, const hydro_real *raw, hydro_real *measurement)
{
    static const int source[3] = {0, 1, 4}, value[3] = {0, 2, 6};
    for (int i = 0; i < 3; i++) {
        hydro_real now = raw[source[i]];
        bool sound = hydro_finite(now) && hydro_abs(now) < HYDRO_R(1e9);
        measurement[value[i]] = now;
        if (!rates->begun) {
            measurement[value[i] + 1] = HYDRO_R(0);
            rates->last[i] = sound ? now : HYDRO_R(0);
        } else if (sound) {
            measurement[value[i] + 1] = hydro_rate(
                i < 2 ? rates->force_memory : rates->velocity_memory, measurement[value[i] + 1], now, rates->last[i]);
            rates->last[i] = now;
        }
    }
    measurement[4] = raw[2];
    measurement[5] = raw[3];
    rates->begun = true;
}

#endif
