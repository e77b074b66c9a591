/* SPDX-License-Identifier: Apache-2.0 */
/* A whole box: bytes of the line in, one sample each millisecond, bytes out.
 *
 *   line --hydro_box_bytes--> greeting, newest command
 *   measurement --hydro_box_tick--> command taken in, watchdog, faults, arming, reference, force law --> valve current
 *   hydro_box_frames --> HELLO, DETAILS and LAW after power-on and a greeting, STATE
 */
#ifndef HYDRO_BOX_H
#define HYDRO_BOX_H

#include "arming.h"
#include "differentiation.h"
#include "force_law.h"
#include "guard.h"
#include "reference.h"
#include "stream.h"

#define HYDRO_BURST_MAX (4 * HYDRO_FRAME_MAX) /* bytes that hydro_box_frames writes at most */

typedef struct {
    const hydro_config *config;
    hydro_stream stream;
    hydro_guard guard;
    hydro_arming arming;
    hydro_reference reference;
    hydro_sample sample;       /* the last one */
    hydro_law_state acting;    /* its force law */
    hydro_real integral;       /* what the integrator carries: N/s, in the paper's form N s */
    hydro_command now, next;   /* to be taken in at the coming tick, and at the one after */
    bool has_now, has_next;
    bool greeted;              /* a host greeted since the last tick: it disarms, and nothing overtakes that */
    bool greeting;             /* a HELLO is to be sent */
    uint32_t sequence, epoch, hellos;
    uint32_t last_command, confirmed;
    uint32_t taken, stale, greetings; /* commands taken, commands old or repeated, hosts that greeted */
} hydro_box;

static inline void hydro_box_power_on(hydro_box *box, const hydro_config *config, uint32_t epoch)
{
    box->config = config;
    hydro_stream_reset(&box->stream);
    hydro_guard_reset(&box->guard);
    hydro_arming_reset(&box->arming);
    hydro_reference_reset(&box->reference);
    box->acting.law = HYDRO_PAPER;
    box->integral = HYDRO_R(0);
    box->has_now = box->has_next = box->greeted = false;
    box->greeting = true;
    box->sequence = box->hellos = box->last_command = box->confirmed = 0;
    box->epoch = epoch;
    box->taken = box->stale = box->greetings = 0;
}

/* A host greets, of whatever version: a new conversation, which begins with the safe command. */
static inline void hydro_box_greet(hydro_box *box)
{
    static const hydro_command safe = {.reference = {.frequency = 1.0}, .shaping = HYDRO_NEUTRAL};
    box->guard.heard = false;
    box->greeted = box->greeting = box->has_now = true;
    box->has_next = false;
    box->now = safe;
    if (box->hellos == 0) {
        box->hellos = 1; /* an answer, no power-on */
    }
    box->greetings++;
}

static inline void hydro_box_command(hydro_box *box, const hydro_body *body)
{
    hydro_command command;
    if (!hydro_decode_command(body->sequence, body->payload, &command)) {
        box->stream.bad++;
    } else if (!hydro_in_order(&box->guard, command.sequence)) {
        box->stale++;
    } else if (box->greeted) {
        box->next = command;
        box->has_next = true;
    } else {
        box->now = command;
        box->has_now = true;
        box->last_command = command.sequence;
        box->taken++;
    }
}

/* Bytes of the line, as they come. */
static inline void hydro_box_bytes(hydro_box *box, const uint8_t *data, size_t count)
{
    hydro_body body;
    for (size_t i = 0; i < count; i++) {
        if (!hydro_byte(&box->stream, data[i], &body)) {
            continue;
        }
        if (body.kind == HYDRO_COMMAND) {
            hydro_box_command(box, &body);
        } else if (body.payload[2] == 0) {
            hydro_box_greet(box);
        }
    }
}

/* A command becomes what the box does from box time [s] on. */
static inline void hydro_box_take(hydro_box *box, const hydro_command *command, hydro_time time)
{
    hydro_note_command(&box->arming, command->arm, command->filter_fresh, time);
    (void)hydro_admit(&box->guard, box->config, command, &box->reference.wanted);
}

/* The newest command of the line is taken; the one behind a greeting waits for the next sample. */
static inline void hydro_box_receive(hydro_box *box, hydro_time time)
{
    if (box->has_now) {
        hydro_box_take(box, &box->now, time);
    }
    box->confirmed = box->last_command;
    box->has_now = box->has_next;
    box->has_next = box->greeted = false;
    if (box->has_now) {
        box->now = box->next;
        box->last_command = box->now.sequence;
        box->taken++;
    }
}

/* Reference, force law and saturation into `values`; whether the current stands at its limit. */
static inline bool hydro_box_control(hydro_box *box, const hydro_real *measurement, bool held, hydro_time time)
{
    const hydro_config *config = box->config;
    const hydro_law *law = &config->laws[box->acting.law];
    hydro_real *values = box->sample.values;
    hydro_real force = measurement[config->feedback], limit = config->bench.valve_current_max;
    hydro_real error, nominal, unlimited, current;
    hydro_wave wave;
    values[HYDRO_CURRENT] = values[HYDRO_NOMINAL] = values[HYDRO_REFERENCE_RATE] = HYDRO_R(0);
    values[HYDRO_REFERENCE] = box->acting.reference = force;
    box->acting.reference_rate = HYDRO_R(0);
    if (!box->arming.armed) {
        hydro_copy(box->acting.shaping, law->safe, sizeof law->safe);
        return false;
    }
    wave = hydro_advance(&box->reference, time);
    hydro_compensate(&box->acting, law, held ? law->safe : box->guard.shaping, &wave);
    error = box->acting.reference - force;
    nominal = hydro_nominal_current(
        config, measurement, error, hydro_action(config->integral_form, box->integral, values[HYDRO_KI]),
        box->acting.reference_rate, values[HYDRO_KP], box->acting.shaping + HYDRO_COEFFICIENTS);
    if (!hydro_finite(nominal)) { /* nothing that was admitted leads here; the valve must not depend on that */
        box->arming.armed = false;
        box->arming.tripped = true;
        box->acting.reference = force;
        box->acting.reference_rate = HYDRO_R(0);
        hydro_copy(box->acting.shaping, law->safe, sizeof law->safe);
        return false;
    }
    unlimited = held || time - box->arming.received_at > HYDRO_CORRECTION_HOLD ? nominal : nominal + box->guard.delta_u;
    current = hydro_clamp(unlimited, -limit, limit);
    box->integral = hydro_integrate(
        config->integral_form, box->integral, wave.value - force, values[HYDRO_KI], unlimited - current);
    values[HYDRO_CURRENT] = current;
    values[HYDRO_NOMINAL] = nominal;
    values[HYDRO_REFERENCE] = wave.value;
    values[HYDRO_REFERENCE_RATE] = wave.rate;
    return current != unlimited;
}

/* One sample at box time [s]: the valve current [A] to hold until the next, finite and within its limit. */
static inline hydro_real hydro_box_tick(hydro_box *box, const hydro_real *measurement, hydro_time time)
{
    const hydro_config *config = box->config;
    hydro_real *values = box->sample.values;
    const hydro_law *law;
    bool begins, late, held, saturated;
    hydro_box_receive(box, time);
    late = hydro_watchdog(&box->arming, config, time);
    hydro_follow_disarm(&box->arming);
    hydro_watch_sensors(&box->arming, config, measurement, time);
    begins = hydro_follow_arm(&box->arming, config, measurement, time);
    if (begins || !box->arming.arm_wanted) {
        box->acting.law = box->guard.law;
    }
    law = &config->laws[box->acting.law];
    if (begins) {
        hydro_copy(box->acting.shaping, law->safe, sizeof law->safe);
        box->integral = HYDRO_R(0);
        hydro_begin(&box->reference, measurement[config->feedback], time);
    }
    box->sample.time = time;
    box->sample.sequence = box->sequence++;
    hydro_copy(values, measurement, HYDRO_MEASURED * sizeof *values);
    held = late || box->acting.law != box->guard.law; /* the law's safe state */
    values[HYDRO_KP] = held ? law->base_kp : law->base_kp + box->guard.delta_kp;
    values[HYDRO_KI] = held ? law->base_ki : law->base_ki + box->guard.delta_ki;
    saturated = hydro_box_control(box, measurement, held, time);
    box->sample.flags = hydro_flags(&box->arming, late, saturated);
    return values[HYDRO_CURRENT];
}

/* What goes up the line after a tick, at most HYDRO_BURST_MAX bytes; how many. */
static inline size_t hydro_box_frames(hydro_box *box, uint8_t *out)
{
    uint64_t time_us = (uint64_t)(box->sample.time * 1e6 + 0.5);
    size_t count = 0;
    if (box->greeting) {
        count = hydro_encode_hello(box->hellos, time_us, box->config, out);
        count += hydro_encode_details(box->hellos, time_us, box->epoch, box->config, out + count);
        count += hydro_encode_law(box->hellos, time_us, box->config, out + count);
        box->hellos++;
        box->greeting = false;
    }
    return count
           + hydro_encode_state(&box->sample, box->confirmed, box->guard.refused, &box->acting, out + count);
}

#endif
