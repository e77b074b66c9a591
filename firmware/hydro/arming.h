/* SPDX-License-Identifier: Apache-2.0 */
/* Arming, watchdog, trips and filter_fresh.
 *
 *              arm, after a disarm was seen               fault, or 200 ms without commands
 *   disarmed --------------------------------> armed ----------------------------------------> tripped
 *       ^  ^------------- disarm ----------------'                                                |
 *       '-------------------------------------- disarm -------------------------------------------'
 */
#ifndef HYDRO_ARMING_H
#define HYDRO_ARMING_H

#include "protocol.h"

#define HYDRO_RECOVERY 1.0         /* s within which a load force that began beyond its limit must come back */
#define HYDRO_NEVER (-1e300)       /* s: longer ago than anything */

typedef struct {
    bool arm_wanted, disarm_seen, armed, tripped, filter_fresh;
    uint32_t faults;                 /* flags of what tripped it */
    hydro_time received_at, armed_at; /* s */
    hydro_real excess;               /* N beyond its limit that the load force had at arming */
} hydro_arming;

static inline void hydro_arming_reset(hydro_arming *arming)
{
    arming->arm_wanted = arming->disarm_seen = arming->armed = arming->tripped = arming->filter_fresh = false;
    arming->faults = 0;
    arming->received_at = arming->armed_at = HYDRO_NEVER;
    arming->excess = HYDRO_R(0);
}

/* A command came at box time [s]. */
static inline void hydro_note_command(hydro_arming *arming, bool arm, bool filter_fresh, hydro_time time)
{
    arming->received_at = time;
    arming->arm_wanted = arm;
    if (!arm) {
        arming->disarm_seen = true;
    }
    arming->filter_fresh = filter_fresh;
}

/* Whether commands are late; if they are gone for good, the box trips and wants to see a disarm. */
static inline bool hydro_watchdog(hydro_arming *arming, const hydro_config *config, hydro_time time)
{
    hydro_time age = time - arming->received_at;
    if (age > config->trip_timeout) {
        arming->tripped = arming->tripped || arming->armed;
        arming->arm_wanted = arming->disarm_seen = false;
    }
    return age > config->hold_timeout;
}

/* A disarm that was seen ends a trip and forgets its causes; if one is still there, it is found again. */
static inline void hydro_follow_disarm(hydro_arming *arming)
{
    if (!arming->arm_wanted) {
        arming->armed = false;
        if (arming->disarm_seen) {
            arming->tripped = false;
            arming->faults = 0;
        }
    }
}

/* How far [N] the force may stand beyond its limit: as far as at arming, falling to zero within a second. */
static inline hydro_real hydro_allowance(const hydro_arming *arming, hydro_time time)
{
    hydro_time left = 1.0 - (time - arming->armed_at) / HYDRO_RECOVERY;
    return arming->excess * (hydro_real)(left > 0.0 ? left : 0.0);
}

/* Trip on what cannot be or must not be; the causes stay until the disarm. */
static inline void hydro_watch_sensors(
    hydro_arming *arming, const hydro_config *config, const hydro_real *measurement, hydro_time time)
{
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        if (!hydro_finite(measurement[i]) || measurement[i] < config->low[i] || measurement[i] > config->high[i]) {
            arming->faults |= HYDRO_SENSOR_FAULT;
        }
    }
    if (arming->armed && !hydro_nan(measurement[2])
        && hydro_abs(measurement[2]) > config->load_force_limit + hydro_allowance(arming, time)) {
        arming->faults |= HYDRO_FORCE_LIMIT;
    }
    if (arming->faults != 0) {
        arming->tripped = true;
    }
}

/* Arm if the diagram allows it; true if the box was asked to and begins anew. */
static inline bool hydro_follow_arm(
    hydro_arming *arming, const hydro_config *config, const hydro_real *measurement, hydro_time time)
{
    hydro_real beyond;
    if (arming->tripped) {
        arming->armed = false;
        return false;
    }
    if (!arming->arm_wanted || arming->armed) {
        return false;
    }
    arming->armed = arming->disarm_seen;
    arming->tripped = !arming->disarm_seen;
    arming->disarm_seen = false;
    beyond = hydro_abs(measurement[2]) - config->load_force_limit;
    arming->armed_at = time;
    arming->excess = beyond > HYDRO_R(0) ? beyond + config->recovery_margin : HYDRO_R(0);
    return true;
}

/* Flags of a sample. */
static inline uint32_t hydro_flags(const hydro_arming *arming, bool late, bool saturated)
{
    return arming->faults | (arming->armed ? HYDRO_ARMED : 0u) | (saturated ? HYDRO_SATURATED : 0u)
           | (late ? HYDRO_WATCHDOG : 0u) | (arming->tripped ? HYDRO_TRIPPED : 0u)
           | (late || !arming->filter_fresh ? HYDRO_FILTER_STALE : 0u);
}

#endif
