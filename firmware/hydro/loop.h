/* SPDX-License-Identifier: Apache-2.0 */
/* Optional, of the default filter: the whole force loop over one sample, linearized, and its place beside f_r.
 *
 *   q = [f_h  g spool  g spool'  f_l  f_l'  x_p  x_p'  x_p' as the box has it]      in units of `scale`
 *   q_{k+1} = F q_k + G u_k     of a bench file's model        u_k = K q_k     of the force law that the box runs
 *   v = q - q_r                 q_r from f_r, f_r', f_r''
 *
 * The model is two, generated from the bench file (`hydro_model`): the whole one, and the loop's, without dry friction,
 * which is linearized. States begin with p_a p_b x_p x_p'. What no sensor shows is simulated by the whole one, from the
 * currents and what is measured. In Python: hydro_filter.model.observer, displacement, linearization.
 */
#ifndef HYDRO_LOOP_H
#define HYDRO_LOOP_H

#include "force_law.h"

#ifndef HYDRO_EXP /* of the target; the compiler's own else */
#ifdef HYDRO_SINGLE
#define HYDRO_EXP(x) __builtin_expf(x)
#else
#define HYDRO_EXP(x) __builtin_exp(x)
#endif
#endif

#define HYDRO_LOOP 8
#define HYDRO_INPUT 7          /* column of tangents that is the current's: the box's own velocity moves nothing */
#define HYDRO_CLOSED 1e-9      /* A, where the spool is taken to stand in a sample in which it passes zero */
#define HYDRO_PROBE 0.1        /* m/s, over which the velocity's part of the flows is taken; they are linear in it */
#define HYDRO_SMALLEST_DROP 1e3 /* Pa, no slope of a square root is taken nearer to zero pressure drop */
#define HYDRO_STATES 16        /* of a model, at most */
#define HYDRO_READINGS 5

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

/* A generated model: y' and a sample of 1 ms at a current [A], or that sample's derivatives by y and the current. */
typedef void hydro_model_rates(
    const hydro_real *k, const hydro_real *y, hydro_real u, hydro_real share, hydro_real *restrict out);
typedef void hydro_model_sample(const hydro_real *k, hydro_real *y, hydro_real u, hydro_real *z);
typedef void hydro_model_jacobian(
    const hydro_real *k, hydro_real *y, hydro_real u, hydro_real *z, hydro_real *dy, hydro_real *dz);

typedef struct {
    hydro_model_rates *rates;
    const hydro_real *k;                           /* its coefficients */
    int states, spool, spool_rate, cell, cell_rate; /* number of states, and the places of some */
} hydro_model;

typedef struct {
    hydro_model whole, linear;
    hydro_model_sample *sample;     /* of the whole model */
    const hydro_real *sample_k;     /* its coefficients, of a mass that the forces within it do not accelerate */
    hydro_model_jacobian *jacobian; /* of the loop's model */
    const int *from_whole;          /* place in the whole model of each state of the loop's */
    const hydro_real *rest;     /* the whole model's still bench */
    const hydro_real *forces;   /* N, load at `points` positions [m] from `first` on, rising */
    int points;
    hydro_real first, step;
    bool holds;                                   /* whether dry friction can hold the piston */
    hydro_real before, after;                     /* A, null shifts before and behind the spool's lag */
    hydro_real lag, inertia;                      /* s, s^2: of the load cell, 2 d/w and 1/w^2 */
    hydro_real gain[HYDRO_READINGS], bias[HYDRO_READINGS]; /* of f_h f_l p_a p_b x_p */
    hydro_real area, ratio, mass, dead_a, dead_b, stroke; /* m2 - kg m3 m3 m */
    hydro_real least_gain, least_opening;         /* N/s/A, A */
    hydro_real bend_max; /* N/s^2, largest f_r'' that is believed */
    hydro_real creep;    /* m/s, below which the sign of a velocity is noise, where dry friction can hold */
    hydro_bench bench;          /* what the force law believes */
    hydro_real gain_floor;      /* N/s/A */
    hydro_real velocity_memory; /* a of the box's velocity (differentiation.h) */
    hydro_real scale[HYDRO_LOOP];
} hydro_loop;

/* What x does not show; all zero at first. */
typedef struct {
    hydro_real hidden[HYDRO_STATES]; /* states of the whole model */
    hydro_real reference_rate;       /* N/s, of the sample before */
    bool running;
} hydro_memory_of_loop;

typedef struct {
    hydro_real transition[HYDRO_LOOP][HYDRO_LOOP], push[HYDRO_LOOP], feedback[HYDRO_LOOP]; /* F, G, K */
} hydro_linear;

/* g [N/s/A] on the opening's side, what f_h' loses per velocity [N/m], f_h' of the closed valve at rest [N/s], and how
 * fast a velocity lowers p_a and raises p_b [Pa/m].
 */
typedef struct {
    hydro_real gain, stiffness, still, soft_a, soft_b;
} hydro_sensitivity;

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

/* The size of x with the sign of y. */
static inline hydro_real hydro_copysign(hydro_real x, hydro_real y)
{
    hydro_pattern bits = (hydro_pattern_of(x) & ~HYDRO_SIGN) | (hydro_pattern_of(y) & HYDRO_SIGN);
    hydro_copy(&x, &bits, sizeof x);
    return x;
}

/* States of the whole model: measured where there is a sensor, f_l and its rate only for `cell`. */
static inline void hydro_lift(
    const hydro_loop *loop, const hydro_real *hidden, const hydro_real *x, bool cell, hydro_real *y)
{
    const hydro_real *gain = loop->gain, *bias = loop->bias;
    for (int i = 0; i < loop->whole.states; i++) {
        y[i] = hidden[i];
    }
    y[0] = (x[4] - bias[2]) / gain[2];
    y[1] = (x[5] - bias[3]) / gain[3];
    y[2] = (x[6] - bias[4]) / gain[4];
    y[3] = x[7] / gain[4];
    if (cell) {
        y[loop->whole.cell] = (x[2] - bias[1]) / gain[1];
        y[loop->whole.cell_rate] = x[3] / gain[1];
    }
}

/* f_h' [N/s] and y' with the valve held at `opening` [A]. */
static inline hydro_real hydro_held(
    const hydro_loop *loop, const hydro_model *model, hydro_real *y, hydro_real opening, hydro_real *slopes)
{
    y[model->spool] = opening - loop->after;
    y[model->spool_rate] = HYDRO_R(0);
    model->rates(model->k, y, opening - loop->after - loop->before, HYDRO_R(0.5), slopes);
    return loop->area * (slopes[0] - loop->ratio * slopes[1]);
}

static inline hydro_sensitivity hydro_sensitivity_at(
    const hydro_loop *loop, const hydro_real *state, hydro_real opening)
{
    hydro_real y[HYDRO_STATES], slopes[2 * HYDRO_STATES], closed, rate_a, rate_b, held, size;
    hydro_sensitivity made;
    hydro_copy(y, state, sizeof y);
    closed = hydro_held(loop, &loop->linear, y, HYDRO_R(0), slopes);
    rate_a = slopes[0];
    rate_b = slopes[1];
    y[3] += HYDRO_R(HYDRO_PROBE);
    (void)hydro_held(loop, &loop->linear, y, HYDRO_R(0), slopes);
    made.soft_a = (rate_a - slopes[0]) / HYDRO_R(HYDRO_PROBE);
    made.soft_b = (slopes[1] - rate_b) / HYDRO_R(HYDRO_PROBE);
    y[3] -= HYDRO_R(HYDRO_PROBE);
    size = hydro_copysign(hydro_max(hydro_abs(opening), loop->least_opening), opening);
    held = hydro_held(loop, &loop->linear, y, size, slopes);
    made.gain = hydro_max((held - closed) / size, loop->least_gain);
    made.stiffness = loop->area * (made.soft_a + loop->ratio * made.soft_b);
    made.still = closed + made.stiffness * y[3];
    return made;
}

/* Take in the first sample: what the current of now leads to. */
static inline void hydro_settle(
    const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_real *x, hydro_real current,
    hydro_real reference_rate)
{
    if (!memory->running) {
        hydro_lift(loop, loop->rest, x, true, memory->hidden);
        memory->hidden[loop->whole.spool] = current + loop->before;
        memory->hidden[loop->whole.spool_rate] = HYDRO_R(0);
        memory->reference_rate = reference_rate;
        memory->running = true;
    }
}

/* On to the next sample, over which the valve holds `current` [A]. */
static inline void hydro_follow(
    const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_real *x, hydro_real current,
    hydro_real reference_rate)
{
    hydro_real z[HYDRO_READINGS];
    hydro_lift(loop, memory->hidden, x, false, memory->hidden);
    loop->sample(loop->sample_k, memory->hidden, current, z);
    memory->reference_rate = reference_rate;
}

/* Load [N] at a position [m]. */
static inline hydro_real hydro_load(const hydro_loop *loop, hydro_real position)
{
    hydro_real place = hydro_clamp((position - loop->first) / loop->step, HYDRO_R(0), (hydro_real)(loop->points - 2));
    int i = (int)place;
    hydro_real slope = (loop->forces[i + 1] - loop->forces[i]) / loop->step;
    return loop->forces[i] + slope * (position - loop->first - (hydro_real)i * loop->step);
}

/* Position [m] at which the load is a force [N], and its stiffness there [N/m]. */
static inline hydro_real hydro_position(const hydro_loop *loop, hydro_real force, hydro_real *stiffness)
{
    int low = 0, high = loop->points - 2;
    while (low < high) {
        int middle = (low + high + 1) / 2;
        if (loop->forces[middle] < force) {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    *stiffness = (loop->forces[low + 1] - loop->forces[low]) / loop->step;
    return loop->first + (hydro_real)low * loop->step + (force - loop->forces[low]) / *stiffness;
}

/* Dry friction [N] against the motion: what the loop's model leaves out. y and `state` are as they were afterwards. */
static inline hydro_real hydro_dry_friction(
    const hydro_loop *loop, hydro_real *y, hydro_real *state, hydro_real *slopes)
{
    hydro_real measured = y[3], share = HYDRO_R(1), creep = loop->creep, whole;
    if (loop->holds && hydro_abs(measured) < creep) {
        share = hydro_abs(measured) / creep;
        y[3] = state[3] = hydro_copysign(creep, measured);
    }
    (void)hydro_held(loop, &loop->whole, y, HYDRO_R(0), slopes);
    whole = slopes[3];
    (void)hydro_held(loop, &loop->linear, state, HYDRO_R(0), slopes);
    y[3] = state[3] = measured;
    return share * loop->mass * (slopes[3] - whole);
}

/* The loop's states of the whole model's. */
static inline void hydro_chosen(const hydro_loop *loop, const hydro_real *y, hydro_real *state)
{
    for (int i = 0; i < loop->linear.states; i++) {
        state[i] = y[loop->from_whole[i]];
    }
}

/* v of a sample at f_r [N] and f_r' [N/s]. */
static inline void hydro_displace(
    const hydro_loop *loop, const hydro_memory_of_loop *memory, const hydro_real *x, hydro_real reference,
    hydro_real reference_rate, hydro_real *v)
{
    hydro_real limit = loop->bend_max, y[HYDRO_STATES] = {HYDRO_R(0)}, state[HYDRO_STATES] = {HYDRO_R(0)};
    hydro_real bend = hydro_clamp((reference_rate - memory->reference_rate) / HYDRO_R(HYDRO_PERIOD), -limit, limit);
    hydro_real opening = memory->hidden[loop->whole.spool] + loop->after, slopes[2 * HYDRO_STATES];
    hydro_real turned = memory->hidden[loop->whole.spool_rate], stiffness, position, velocity, driven, dry, pushing;
    hydro_real spring = (reference - loop->bias[1] + loop->lag * reference_rate + loop->inertia * bend) / loop->gain[1];
    hydro_real spring_rate = (reference_rate + loop->lag * bend) / loop->gain[1], spring_bend = bend / loop->gain[1];
    hydro_sensitivity at;
    hydro_lift(loop, memory->hidden, x, true, y);
    hydro_chosen(loop, y, state);
    at = hydro_sensitivity_at(loop, state, opening);
    position = hydro_position(loop, spring, &stiffness);
    velocity = spring_rate / stiffness;
    driven = hydro_held(loop, &loop->whole, y, opening, slopes) - (at.still - at.stiffness * y[3]);
    dry = hydro_dry_friction(loop, y, state, slopes);
    pushing = loop->area * (y[0] - loop->ratio * y[1]) - hydro_load(loop, y[2]);
    state[3] = velocity;
    (void)hydro_held(loop, &loop->linear, state, HYDRO_R(0), slopes);
    v[HYDRO_Q_F_H] = x[0] - loop->bias[0]
                     - loop->gain[0] * (spring + loop->mass * spring_bend / stiffness + pushing
                                        - loop->mass * slopes[3] + dry);
    v[HYDRO_Q_SPOOL] = driven - (spring_rate + at.stiffness * velocity - at.still);
    v[HYDRO_Q_SPOOL_RATE] = at.gain * turned - (HYDRO_R(1) + at.stiffness / stiffness) * spring_bend;
    v[HYDRO_Q_F_L] = x[2] - reference;
    v[HYDRO_Q_F_L_RATE] = x[3] - reference_rate;
    v[HYDRO_Q_X] = y[2] - position;
    v[HYDRO_Q_V] = v[HYDRO_Q_BOX] = y[3] - velocity;
    for (int i = 0; i < HYDRO_LOOP; i++) {
        v[i] /= loop->scale[i];
    }
}

/* The loop's states a sample after `before`, and their derivatives; an opening near zero is moved to its side of it. */
static inline void hydro_ahead_of(
    const hydro_loop *loop, const hydro_real *before, hydro_real opening, hydro_real side, hydro_real current,
    hydro_real *after, hydro_real *by_state)
{
    hydro_real z[HYDRO_READINGS], dz[HYDRO_READINGS * (HYDRO_STATES + 1)];
    hydro_copy(after, before, HYDRO_STATES * sizeof *after);
    if (hydro_abs(opening) < HYDRO_R(HYDRO_CLOSED)) {
        after[loop->linear.spool] = side * HYDRO_R(HYDRO_CLOSED) - loop->after;
    }
    loop->jacobian(loop->linear.k, after, current, z, by_state, dz);
}

/* F and G from the derivatives of the loop's states; a change of f_h is `share` of the pressures [Pa/N]. */
static inline void hydro_transition(
    const hydro_loop *loop, const hydro_real *by_state, const hydro_real share[2], hydro_real gain, hydro_real later,
    hydro_linear *linear)
{
    const hydro_model *model = &loop->linear;
    const hydro_real *scale = loop->scale;
    hydro_real tangent[HYDRO_STATES + 1][HYDRO_LOOP] = {{HYDRO_R(0)}}, moved[HYDRO_STATES];
    hydro_real force = loop->gain[0] * loop->area, memory = loop->velocity_memory;
    int n = model->states;
    tangent[0][HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[0];
    tangent[1][HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[1];
    tangent[model->spool][HYDRO_Q_SPOOL] = scale[HYDRO_Q_SPOOL] / gain;
    tangent[model->spool_rate][HYDRO_Q_SPOOL_RATE] = scale[HYDRO_Q_SPOOL_RATE] / gain;
    tangent[model->cell][HYDRO_Q_F_L] = scale[HYDRO_Q_F_L] / loop->gain[1];
    tangent[model->cell_rate][HYDRO_Q_F_L_RATE] = scale[HYDRO_Q_F_L_RATE] / loop->gain[1];
    tangent[2][HYDRO_Q_X] = scale[HYDRO_Q_X];
    tangent[3][HYDRO_Q_V] = scale[HYDRO_Q_V];
    tangent[n][HYDRO_INPUT] = HYDRO_R(1);
    for (int c = 0; c < HYDRO_LOOP; c++) {
        for (int i = 0; i < n; i++) {
            moved[i] = HYDRO_R(0);
            for (int j = 0; j <= n; j++) {
                moved[i] += by_state[i * (n + 1) + j] * tangent[j][c];
            }
        }
        linear->transition[HYDRO_Q_F_H][c] = force * (moved[0] - loop->ratio * moved[1]) / scale[HYDRO_Q_F_H];
        linear->transition[HYDRO_Q_SPOOL][c] = later * moved[model->spool] / scale[HYDRO_Q_SPOOL];
        linear->transition[HYDRO_Q_SPOOL_RATE][c] = later * moved[model->spool_rate] / scale[HYDRO_Q_SPOOL_RATE];
        linear->transition[HYDRO_Q_F_L][c] = loop->gain[1] * moved[model->cell] / scale[HYDRO_Q_F_L];
        linear->transition[HYDRO_Q_F_L_RATE][c] = loop->gain[1] * moved[model->cell_rate] / scale[HYDRO_Q_F_L_RATE];
        linear->transition[HYDRO_Q_X][c] = moved[2] / scale[HYDRO_Q_X];
        linear->transition[HYDRO_Q_V][c] = moved[3] / scale[HYDRO_Q_V];
        linear->transition[HYDRO_Q_BOX][c] =
            (HYDRO_R(1) - memory) / HYDRO_R(HYDRO_PERIOD) * (moved[2] - tangent[2][c]) / scale[HYDRO_Q_BOX];
    }
    for (int i = 0; i < HYDRO_LOOP; i++) {
        linear->push[i] = linear->transition[i][HYDRO_INPUT];
        linear->transition[i][HYDRO_INPUT] = HYDRO_R(0);
    }
    linear->transition[HYDRO_Q_BOX][HYDRO_INPUT] = memory;
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
    hydro_real y[HYDRO_STATES] = {HYDRO_R(0)}, before[HYDRO_STATES] = {HYDRO_R(0)}, after[HYDRO_STATES];
    hydro_real by_state[HYDRO_STATES * (HYDRO_STATES + 1)], share[2], total, later, closed;
    hydro_real opening = memory->hidden[loop->whole.spool] + loop->after;
    hydro_real side = hydro_copysign(HYDRO_R(1), opening);
    hydro_sensitivity at;
    hydro_lift(loop, memory->hidden, x, true, y);
    hydro_chosen(loop, y, before);
    at = hydro_sensitivity_at(loop, before, opening);
    total = loop->gain[0] * loop->area * (at.soft_a + loop->ratio * at.soft_b);
    share[0] = at.soft_a / total;
    share[1] = -at.soft_b / total;
    hydro_ahead_of(loop, before, opening, side, current, after, by_state);
    if (side * (after[loop->linear.spool] + loop->after) < HYDRO_R(0)) { /* passes zero: held on its side of it */
        closed = side * HYDRO_R(HYDRO_CLOSED);
        before[loop->linear.spool] = closed - loop->after;
        before[loop->linear.spool_rate] = HYDRO_R(0);
        hydro_ahead_of(loop, before, closed, side, closed - loop->after - loop->before, after, by_state);
    }
    later = hydro_sensitivity_at(loop, after, opening).gain;
    hydro_transition(loop, by_state, share, at.gain, later, linear);
    hydro_law_slopes(loop, x, hydro_copysign(nominal, side), k_p, share, linear->feedback);
}

#endif
