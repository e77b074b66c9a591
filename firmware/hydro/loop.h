/* SPDX-License-Identifier: Apache-2.0 */
/* Optional, of the default filter: the whole force loop over one sample, linearized, and its place beside f_r.
 *
 *   q = [f_h  g spool  g spool'  f_l  f_l'  x_p  x_p'  x_p' as the box has it]      in units of `scale`
 *   q_{k+1} = F q_k + G u_k     of the structured model        u_k = K q_k     of the force law that the box runs
 *   v = q - q_r                 q_r from f_r, f_r', f_r''
 *
 * Spool and bristle are not measured: a memory follows both from the currents and the velocity. In Python:
 * hydro_filter.model.loop_model, displacement, hidden_states.
 */
#ifndef HYDRO_LOOP_H
#define HYDRO_LOOP_H

#include "filter.h"
#include "structured.h"

#define HYDRO_LOOP 8
#define HYDRO_INPUT 7          /* column of nudges that is the current's: the box's own velocity moves nothing */
#define HYDRO_CLOSED 1e-9      /* A, where the spool is taken to stand in a sample in which it passes zero */
#define HYDRO_BEND_MAX 2e5     /* N/s^2, largest f_r'' that is believed */

enum {
    HYDRO_Q_F_H,
    HYDRO_Q_SPOOL,
    HYDRO_Q_SPOOL_RATE,
    HYDRO_Q_F_L,
    HYDRO_Q_F_L_RATE,
    HYDRO_Q_X,
    HYDRO_Q_V,
    HYDRO_Q_BOX
};

typedef struct {
    hydro_model model;
    hydro_bench bench;          /* what the force law believes */
    hydro_real gain_floor;      /* N/s/A */
    hydro_real velocity_memory; /* a of the box's velocity (differentiation.h) */
    hydro_real scale[HYDRO_LOOP];
} hydro_loop;

/* What x does not show; all zero at first. */
typedef struct {
    hydro_real spool, spool_rate, bristle; /* A, A/s, m */
    hydro_real reference_rate;             /* N/s, of the sample before */
    bool running;
} hydro_memory_of_loop;

typedef struct {
    hydro_real transition[HYDRO_LOOP][HYDRO_LOOP], push[HYDRO_LOOP], feedback[HYDRO_LOOP]; /* F, G, K */
} hydro_linear;

/* Level of the dry friction [N] at a velocity [m/s]. */
static inline hydro_real hydro_friction_level(const hydro_model *c, hydro_real velocity)
{
    hydro_real share = velocity / c->stribeck_velocity;
    return c->coulomb + c->stribeck * HYDRO_EXP(-(share * share));
}

/* Dry friction [N] at a velocity and a deflection of the bristle. */
static inline hydro_real hydro_dry_friction(const hydro_model *c, hydro_real velocity, hydro_real bristle)
{
    hydro_real slip = velocity - c->bristle * hydro_abs(velocity) / hydro_friction_level(c, velocity) * bristle;
    hydro_real share = velocity / c->damping_velocity;
    return c->bristle * bristle + c->bristle_damping * HYDRO_EXP(-(share * share)) * slip;
}

/* Take in the first sample: what the current and the velocity of now lead to. */
static inline void hydro_settle(
    const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_real *x, hydro_real current,
    hydro_real reference_rate)
{
    hydro_real sign = x[7] > HYDRO_R(0) ? HYDRO_R(1) : (x[7] < HYDRO_R(0) ? HYDRO_R(-1) : HYDRO_R(0));
    if (!memory->running) {
        memory->spool = current;
        memory->spool_rate = HYDRO_R(0);
        memory->bristle = sign * hydro_friction_level(&loop->model, x[7]) / loop->model.bristle;
        memory->reference_rate = reference_rate;
        memory->running = true;
    }
}

/* On to the next sample, over which the valve holds `current` [A]. */
static inline void hydro_follow(
    const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_real *x, hydro_real current,
    hydro_real reference_rate)
{
    const hydro_model *c = &loop->model;
    hydro_real half = HYDRO_R(0.5 * HYDRO_STEP), w = c->spool_omega;
    hydro_real decay = c->bristle * hydro_abs(x[7]) * half / hydro_friction_level(c, x[7]), kept = HYDRO_EXP(-decay);
    hydro_real filling = decay < HYDRO_R(1e-4) ? HYDRO_R(1) - HYDRO_R(0.5) * decay : (HYDRO_R(1) - kept) / decay;
    for (int i = 0; i < 2 * HYDRO_SUBSTEPS; i++) {
        memory->bristle = memory->bristle * kept + half * x[7] * filling;
    }
    for (int step = 0; step < HYDRO_SUBSTEPS; step++) {
        hydro_real y = memory->spool, rate = memory->spool_rate, moved = HYDRO_R(0), pulled = HYDRO_R(0);
        for (int stage = 0; stage < 4; stage++) {
            hydro_real pull = w * (w * (current - y) - HYDRO_R(2) * c->spool_damping * rate);
            hydro_real weight = HYDRO_R(stage == 0 || stage == 3 ? HYDRO_STEP / 6.0 : HYDRO_STEP / 3.0);
            hydro_real reach = HYDRO_R(stage == 2 ? HYDRO_STEP : 0.5 * HYDRO_STEP);
            moved += weight * rate;
            pulled += weight * pull;
            y = memory->spool + reach * rate;
            rate = memory->spool_rate + reach * pull;
        }
        memory->spool += moved;
        memory->spool_rate += pulled;
    }
    memory->reference_rate = reference_rate;
}

/* g [N/s/A] of the model on the spool's side, and what f_h' loses per velocity [N/m]; s: p_a, p_b, x_p. */
static inline hydro_real hydro_gain_of_model(
    const hydro_model *c, const hydro_real *s, hydro_real spool, hydro_real *stiffness)
{
    hydro_real area = c->area, area_b = c->ratio * c->area, none;
    hydro_real volume_a = c->dead_a + area * s[2], volume_b = c->dead_b + area_b * (c->stroke - s[2]);
    bool forward = spool + c->offset >= HYDRO_R(0);
    hydro_real gain_a = forward ? c->ka_positive : c->ka_negative, gain_b = forward ? c->kb_positive : c->kb_negative;
    hydro_real root_a = hydro_root(forward ? c->supply - s[0] : s[0] - c->tank, &none);
    hydro_real root_b = hydro_root(forward ? s[1] - c->tank : c->supply - s[1], &none);
    hydro_real gain = area * gain_a * root_a / volume_a + area_b * gain_b * root_b / volume_b;
    hydro_real least = HYDRO_R(0.1) * area * gain_a * HYDRO_SQRT(HYDRO_R(0.5) * c->supply) / volume_a;
    *stiffness = c->bulk * (area * area / volume_a + area_b * area_b / volume_b);
    return c->bulk * hydro_max(gain, least); /* a chamber at its limit has no gain */
}

/* v of a sample at f_r [N] and f_r' [N/s]. */
static inline void hydro_displace(
    const hydro_loop *loop, const hydro_memory_of_loop *memory, const hydro_real *x, hydro_real reference,
    hydro_real reference_rate, hydro_real *v)
{
    const hydro_model *c = &loop->model;
    hydro_real limit = HYDRO_R(HYDRO_BEND_MAX);
    hydro_real bend = hydro_clamp((reference_rate - memory->reference_rate) / HYDRO_R(HYDRO_PERIOD), -limit, limit);
    hydro_real lag = HYDRO_R(2) * c->cell_damping / c->cell_omega;
    hydro_real spring =
        (reference - c->bias_l + lag * reference_rate + bend / (c->cell_omega * c->cell_omega)) / c->gain_l;
    hydro_real spring_rate = (reference_rate + lag * bend) / c->gain_l, spring_bend = bend / c->gain_l;
    hydro_real velocity = spring_rate / c->spring;
    hydro_real hydraulic = spring + (c->mass * spring_bend + c->viscous * spring_rate) / c->spring
                           + hydro_dry_friction(c, x[7], memory->bristle);
    hydro_real stiffness, gain = hydro_gain_of_model(c, x + 4, memory->spool, &stiffness);
    v[HYDRO_Q_F_H] = x[0] - c->bias_h - c->gain_h * hydraulic;
    v[HYDRO_Q_SPOOL] = gain * memory->spool - (spring_rate + stiffness * velocity);
    v[HYDRO_Q_SPOOL_RATE] = gain * memory->spool_rate - (HYDRO_R(1) + stiffness / c->spring) * spring_bend;
    v[HYDRO_Q_F_L] = x[2] - reference;
    v[HYDRO_Q_F_L_RATE] = x[3] - reference_rate;
    v[HYDRO_Q_X] = x[6] - c->rest - spring / c->spring;
    v[HYDRO_Q_V] = v[HYDRO_Q_BOX] = x[7] - velocity;
    for (int i = 0; i < HYDRO_LOOP; i++) {
        v[i] /= loop->scale[i];
    }
}

/* The sample from s under a held current, and of one nudge along each coordinate: F but for its last column, and G. */
static inline void hydro_nudge(
    const hydro_loop *loop, hydro_real *s, hydro_real current, hydro_real spool, const hydro_real share[2],
    hydro_linear *linear)
{
    const hydro_model *c = &loop->model;
    const hydro_real *scale = loop->scale;
    hydro_real d[HYDRO_PLANT + 1][HYDRO_DIRECTIONS] = {{HYDRO_R(0)}}, none, moved;
    hydro_real gain = hydro_gain_of_model(c, s, spool, &none), area = c->gain_h * c->area;
    d[0][HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[0];
    d[1][HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[1];
    d[2][HYDRO_Q_X] = scale[HYDRO_Q_X];
    d[3][HYDRO_Q_V] = scale[HYDRO_Q_V];
    d[4][HYDRO_Q_SPOOL] = scale[HYDRO_Q_SPOOL] / gain;
    d[5][HYDRO_Q_SPOOL_RATE] = scale[HYDRO_Q_SPOOL_RATE] / gain;
    d[6][HYDRO_Q_F_L] = scale[HYDRO_Q_F_L] / c->gain_l;
    d[7][HYDRO_Q_F_L_RATE] = scale[HYDRO_Q_F_L_RATE] / c->gain_l;
    d[HYDRO_CURRENT_ROW][HYDRO_INPUT] = HYDRO_R(1);
    hydro_sample_ahead(c, s, current, d);
    gain = hydro_gain_of_model(c, s, spool, &none);
    for (int k = 0; k < HYDRO_LOOP; k++) {
        moved = d[2][k] - (k == HYDRO_Q_X ? scale[HYDRO_Q_X] : HYDRO_R(0));
        linear->transition[HYDRO_Q_F_H][k] = area * (d[0][k] - c->ratio * d[1][k]) / scale[HYDRO_Q_F_H];
        linear->transition[HYDRO_Q_SPOOL][k] = gain * d[4][k] / scale[HYDRO_Q_SPOOL];
        linear->transition[HYDRO_Q_SPOOL_RATE][k] = gain * d[5][k] / scale[HYDRO_Q_SPOOL_RATE];
        linear->transition[HYDRO_Q_F_L][k] = c->gain_l * d[6][k] / scale[HYDRO_Q_F_L];
        linear->transition[HYDRO_Q_F_L_RATE][k] = c->gain_l * d[7][k] / scale[HYDRO_Q_F_L_RATE];
        linear->transition[HYDRO_Q_X][k] = d[2][k] / scale[HYDRO_Q_X];
        linear->transition[HYDRO_Q_V][k] = d[3][k] / scale[HYDRO_Q_V];
        linear->transition[HYDRO_Q_BOX][k] =
            (HYDRO_R(1) - loop->velocity_memory) * moved / HYDRO_R(HYDRO_PERIOD) / scale[HYDRO_Q_BOX];
    }
    for (int i = 0; i < HYDRO_LOOP; i++) {
        linear->push[i] = linear->transition[i][HYDRO_INPUT];
        linear->transition[i][HYDRO_INPUT] = HYDRO_R(0);
    }
    linear->transition[HYDRO_Q_BOX][HYDRO_INPUT] = loop->velocity_memory;
}

/* K [A] of the force law at its own current [A]; a nudge of f_h is `share` of the pressures [Pa/N]. */
static inline void hydro_law_slopes(
    const hydro_loop *loop, const hydro_real *x, hydro_real nominal, hydro_real k_p, const hydro_real share[2],
    hydro_real *feedback)
{
    const hydro_bench *bench = &loop->bench;
    hydro_lands lands = hydro_open_lands(bench, x[4], x[5], nominal);
    hydro_real area = bench->piston_area, ratio = bench->area_ratio, swept = -area * x[7];
    hydro_real volume_a = hydro_volume_a(bench, x[6]), volume_b = hydro_volume_b(bench, x[6]);
    hydro_real scale = bench->bulk_modulus * area, gain = hydro_input_gain(bench, x[6], x[4], x[5], nominal);
    hydro_real felt = gain > loop->gain_floor ? nominal : HYDRO_R(0); /* at the floor the law feels no change of g */
    hydro_real opened = bench->valve_gain * felt;
    hydro_real flow_a = lands.root_a * opened + swept, flow_b = lands.root_b * opened + ratio * swept;
    hydro_real by_position = scale * area
                             * (-flow_a / (volume_a * volume_a) + ratio * ratio * flow_b / (volume_b * volume_b));
    hydro_real by_velocity = -scale * area * (HYDRO_R(1) / volume_a + ratio * ratio / volume_b);
    hydro_real by_a = scale * lands.slope_a * opened / volume_a;
    hydro_real by_b = scale * ratio * lands.slope_b * opened / volume_b;
    bool within = x[6] >= HYDRO_R(0) && x[6] <= bench->stroke;
    gain = hydro_max(gain, loop->gain_floor);
    for (int i = 0; i < HYDRO_LOOP; i++) {
        feedback[i] = HYDRO_R(0);
    }
    feedback[HYDRO_Q_F_H] = -(by_a * share[0] + by_b * share[1]) / gain * loop->scale[HYDRO_Q_F_H];
    feedback[HYDRO_Q_F_L] = -k_p / gain * loop->scale[HYDRO_Q_F_L];
    feedback[HYDRO_Q_X] = within ? -by_position / gain * loop->scale[HYDRO_Q_X] : HYDRO_R(0);
    feedback[HYDRO_Q_BOX] = -by_velocity / gain * loop->scale[HYDRO_Q_BOX];
}

/* F, G, K of a sample: its nominal current, the one that the valve got [A], and K_p [1/s]. */
static inline void hydro_linearize(
    const hydro_loop *loop, const hydro_memory_of_loop *memory, const hydro_real *x, hydro_real nominal,
    hydro_real current, hydro_real k_p, hydro_linear *linear)
{
    const hydro_model *c = &loop->model;
    const hydro_real lifted[HYDRO_MOVING] = {x[4], x[5], x[6], x[7], memory->spool, memory->spool_rate};
    hydro_real s[HYDRO_MOVING], share[2], area_b = c->ratio * c->area, total;
    hydro_real side = memory->spool + c->offset >= HYDRO_R(0) ? HYDRO_R(1) : HYDRO_R(-1);
    share[0] = c->area / (c->dead_a + c->area * x[6]); /* a nudge of f_h is the chambers' by their stiffness */
    share[1] = area_b / (c->dead_b + area_b * (c->stroke - x[6]));
    total = c->gain_h * (c->area * share[0] + area_b * share[1]);
    share[0] = share[0] / total;
    share[1] = -share[1] / total;
    hydro_copy(s, lifted, sizeof s);
    hydro_nudge(loop, s, current, memory->spool, share, linear);
    if (side * (s[4] + c->offset) < HYDRO_R(0)) { /* the spool passes zero: held closed on the side it comes from */
        hydro_copy(s, lifted, sizeof s);
        s[4] = side * HYDRO_R(HYDRO_CLOSED) - c->offset;
        s[5] = HYDRO_R(0);
        hydro_nudge(loop, s, s[4], memory->spool, share, linear);
    }
    hydro_law_slopes(loop, x, side * hydro_abs(nominal), k_p, share, linear->feedback);
}

#endif
