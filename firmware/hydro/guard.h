/* SPDX-License-Identifier: Apache-2.0 */
/* What is let in: values clamped, references that can be played, commands in order. Nothing is believed of the host. */
#ifndef HYDRO_GUARD_H
#define HYDRO_GUARD_H

#include "protocol.h"

typedef struct {
    uint32_t law;                           /* that is asked for */
    hydro_real delta_kp, delta_ki, delta_u; /* 1/s, 1/s^2, A: within its limits */
    hydro_real shaping[HYDRO_SHAPING];      /* within its limits; of no meaning before the first command */
    uint32_t refused[2];                    /* values, and references, since power-on */
    bool heard;                             /* a command of this conversation was taken */
    uint32_t newest;                        /* its sequence */
} hydro_guard;

static inline void hydro_guard_reset(hydro_guard *guard)
{
    guard->law = HYDRO_PAPER;
    guard->delta_kp = guard->delta_ki = guard->delta_u = HYDRO_R(0);
    guard->refused[0] = guard->refused[1] = 0;
    guard->heard = false;
    guard->newest = 0;
}

/* Whether a sequence number is newer than all before, by half of the circle of 2^32; taken if it is. */
static inline bool hydro_in_order(hydro_guard *guard, uint32_t sequence)
{
    uint32_t ahead = sequence - guard->newest;
    if (guard->heard && (ahead == 0 || ahead >= 0x80000000u)) {
        return false;
    }
    guard->heard = true;
    guard->newest = sequence;
    return true;
}

/* A value within its limits; clamped, or the safe one where it is not finite: either is counted. */
static inline hydro_real hydro_admitted(
    hydro_guard *guard, hydro_real value, bool broken, hydro_real safe, hydro_real low, hydro_real high)
{
    hydro_real within = broken ? safe : hydro_clamp(value, low, high);
    if (broken || within != value) {
        guard->refused[0]++;
    }
    return within;
}

/* Whether the box can play a finite reference: within its load cell, and slower than its samples. */
static inline bool hydro_playable(const hydro_signal *signal, hydro_real force_range)
{
    hydro_real offset = hydro_abs(signal->offset);
    if (signal->amplitude < HYDRO_R(0) || signal->amplitude > force_range || offset > force_range
        || signal->amplitude + offset > force_range) { /* each by itself first: the sum of two may overflow */
        return false;
    }
    return signal->waveform == HYDRO_HOLD || (signal->frequency > 0.0 && signal->frequency < 1.0 / HYDRO_PERIOD);
}

/* Take the values of a command; whether its reference, too, was taken into `wanted`. */
static inline bool hydro_admit(
    hydro_guard *guard, const hydro_config *config, const hydro_command *command, hydro_signal *wanted)
{
    uint32_t broken = command->broken;
    const hydro_law *law = &config->laws[command->law];
    guard->law = command->law;
    guard->delta_kp = hydro_admitted(
        guard, command->delta_kp, (broken & 1u) != 0, HYDRO_R(0), law->delta_kp_min, law->delta_kp_max);
    guard->delta_ki = hydro_admitted(
        guard, command->delta_ki, (broken & 2u) != 0, HYDRO_R(0), law->delta_ki_min, law->delta_ki_max);
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        guard->shaping[i] = hydro_admitted(
            guard, command->shaping[i], (broken & 16u << i) != 0, law->safe[i], law->low[i], law->high[i]);
    }
    guard->delta_u = hydro_admitted(
        guard, command->delta_u, (broken & 4u) != 0, HYDRO_R(0), -config->delta_u_max, config->delta_u_max);
    if ((broken & 8u) != 0 || !hydro_playable(&command->reference, config->force_range)) {
        guard->refused[0]++;
        guard->refused[1]++;
        return false;
    }
    *wanted = command->reference;
    if (wanted->waveform == HYDRO_HOLD) {
        wanted->frequency = 1.0; /* a hold has none, whatever was sent */
    }
    return true;
}

#endif
