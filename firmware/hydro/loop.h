/* SPDX-License-Identifier: Apache-2.0 */
/* Optional, of the filter: the whole force loop over one sample, linearized, and its place beside f_r.
 *
 *   q = [f_h  g spool  g spool'  f_l  f_l'  x_p  x_p'  x_p' as the box has it, ...]     in units of `scale`
 *   q_{k+1} = F q_k + G u_k     of a bench file's model        u_k = K q_k     of the force law that the box runs
 *   v = q - q_r                 q_r from f_r, f_r', f_r''
 *
 * The model is two, generated from the bench file (`hydro_model`): the whole one, and the loop's, without dry friction,
 * overlap and gaps, which is linearized by its exact Jacobian. States begin with p_a p_b x_p x_p'. Of the whole model:
 *
 *   measured    p_a  p_b  x_p  x_p'  f_l  f_l'    from the readings
 *   simulated   all other states                  from the measured ones and the current that the valve got; they
 *                                                 forget their initial values as fast as their effects do
 *   observed    p_a or p_b behind a lagging       by the model's sample, corrected by the position and what its
 *               sensor, and that sensor           sensor shows
 *
 * The spool counts by the force rate g(x) that it drives: the law divides by g, and so the loop is nearly the same
 * everywhere. g is the slope of f_h' from the closed valve to where the spool is, on its side. A valve without a lag has
 * the last current for its spool, or the one whose dead time ends. Coordinates behind the eight: of each lagging
 * pressure sensor what it shows and its rate, of a dead time the currents on their way, by the force rate that they will
 * drive. K = du/dx of
 *
 *   u = (f_c' + K_p (f_c - f_l) + I - C_1 h) / (C_2 g)     g = g(x_p, p_a, p_b), h = h(x_p, x_p')
 *
 * in closed form, the law's integral I as it is, and u as it is before the law leaps over the valve's overlap, which
 * the loop's model lacks. hydro_filter.model builds `hydro_loop` from a bench file; filter.md explains it.
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

#ifndef HYDRO_STATES
#define HYDRO_STATES 16 /* of a model, at most; define it, as the next, before for a bench with more */
#endif
#ifndef HYDRO_COORDINATES
#define HYDRO_COORDINATES 8 /* of the loop, at most */
#endif
#define HYDRO_SLOPES (HYDRO_STATES + 6) /* rates of a model, at most */
#define HYDRO_LOOP 8           /* coordinates that every bench has */
#define HYDRO_NONE (-1)        /* index of a state that a bench does not have */
#define HYDRO_INPUT 7          /* column of tangents that is the current's: the box's own velocity moves nothing */
#define HYDRO_CLOSED 1e-9      /* A, where the spool is taken to stand in a sample in which it passes zero */
#define HYDRO_PROBE 0.1        /* m/s, over which the velocity's part of the flows is taken; they are linear in it */
#define HYDRO_SMALLEST_DROP 1e3 /* Pa, no slope of a square root is taken nearer to zero pressure drop */
#define HYDRO_READINGS 5       /* f_h f_l p_a p_b x_p */

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

/* A generated model: y' at `count` states and currents [A]; a sample of 1 ms at a current; that sample's derivatives by
 * y and the current, in rows. */
typedef void hydro_model_rates(
    const hydro_real *k, long count, const hydro_real *y, const hydro_real *u, hydro_real *slopes);
typedef void hydro_model_sample(const hydro_real *k, hydro_real *y, hydro_real u, hydro_real *z);
typedef void hydro_model_jacobian(
    const hydro_real *k, hydro_real *y, hydro_real u, hydro_real *z, hydro_real *dy, hydro_real *dz);

typedef struct {
    hydro_model_rates *rates;
    const hydro_real *k;                            /* its coefficients */
    int states, spool, spool_rate, cell, cell_rate; /* number of states, and the places of some, or HYDRO_NONE */
} hydro_model;

typedef struct {
    int signal, rate, chamber; /* places of what it shows and of its rate in the whole model; 0: p_a, 1: p_b */
    hydro_real age;            /* s, 2 d/w */
} hydro_lagging;

typedef struct {
    hydro_model whole, linear;
    hydro_model_sample *sample;     /* of the whole model */
    const hydro_real *sample_k;     /* its coefficients, of a mass that the forces within it do not accelerate */
    hydro_model_jacobian *jacobian; /* of the loop's model */
    const int *from_whole;          /* place in the whole model of each state of the loop's */
    const hydro_real *rest;         /* the whole model's still bench */
    const hydro_real *forces;       /* N, load at `points` positions [m] from `first` on, rising */
    const hydro_real *scale;        /* of each coordinate */
    const int *kept;                /* places in the loop's model of the coordinates behind the eight */
    hydro_lagging lagging[2];       /* pressure sensors */
    hydro_real observer[3][6];      /* of the pressures behind them: pressure, signal, rate of each in turn */
    int coordinates, points, lagging_count;
    int past, at_valve, on_their_way; /* past currents at the end of a model's states; that at the valve; coordinates */
    int force_shown;                  /* what a lagging load cell of f_h shows */
    bool holds;                       /* whether dry friction, without bristles, can hold the piston */
    hydro_real level;                 /* N, up to which dry friction holds, bristles or not */
    hydro_real first, step;
    hydro_real before, after;         /* A, null shifts before and behind the spool's lag */
    hydro_real delay, spool_age;      /* s, dead time, and 2 d/w of the valve's lag */
    hydro_real lag, inertia;          /* s, s^2: of the load cell, 2 d/w and 1/w^2 */
    hydro_real gain[HYDRO_READINGS], bias[HYDRO_READINGS], allowed[HYDRO_READINGS]; /* allowed: see monitor.h */
    hydro_real area, ratio, mass, dead_a, dead_b, stroke; /* m2 - kg m3 m3 m */
    hydro_real least_gain, least_opening;                 /* N/s/A, A */
    hydro_real bend_max;        /* N/s^2, largest f_r'' that is believed */
    hydro_real creep;           /* m/s, below which the sign of a velocity is noise, where dry friction can hold */
    hydro_real gain_floor;      /* N/s/A, smallest g that the law believes */
    hydro_real velocity_memory; /* a of the box's velocity (differentiation.h) */
    hydro_bench bench;          /* what the force law believes */
} hydro_loop;

/* One sample of the bench, and of the law as it acted: the paper's has f_c = f_r and C_1 = C_2 = 1. */
typedef struct {
    hydro_real x[HYDRO_MEASURED];
    hydro_real nominal, current;          /* A, of the law, and what the valve got */
    hydro_real reference, reference_rate; /* f_r, f_r' */
    hydro_real k_p;                       /* 1/s */
    hydro_real followed, followed_rate;   /* f_c, f_c' */
    hydro_real c_1, c_2;
    bool armed; /* whether the valve follows the law */
} hydro_loop_sample;

/* What x does not show; all zero at first. */
typedef struct {
    hydro_real hidden[HYDRO_STATES];  /* states of the whole model */
    hydro_real opening, opening_rate; /* A, A/s, of the valve */
    hydro_real reference_rate;        /* N/s, of the sample before */
    bool running;
} hydro_memory_of_loop;

/* F and, of each coordinate, G [1/A] and K [A]; F by rows. */
typedef struct {
    hydro_real transition[HYDRO_COORDINATES * HYDRO_COORDINATES], push[HYDRO_COORDINATES], feedback[HYDRO_COORDINATES];
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

/* Add a row of the observer's gains times an error. */
static inline void hydro_correct(const hydro_loop *loop, hydro_real *y, int row, hydro_real error)
{
    for (int j = 0; j < loop->lagging_count; j++) {
        const hydro_lagging *sensor = &loop->lagging[j];
        const hydro_real *gains = &loop->observer[row][3 * j];
        y[sensor->chamber] += gains[0] * error;
        y[sensor->signal] += gains[1] * error;
        y[sensor->rate] += gains[2] * error;
    }
}

/* States of the whole model, f_l and its rate measured only for `cell`. y may be `hidden`. */
static inline void hydro_lift(
    const hydro_loop *loop, const hydro_real *hidden, const hydro_real *x, bool cell, hydro_real *y)
{
    const hydro_real *gain = loop->gain, *bias = loop->bias;
    const hydro_real predicted[3] = {hidden[0], hidden[1], hidden[2]};
    hydro_real shown[2], errors[2];
    int count = loop->lagging_count;
    for (int i = 0; i < loop->whole.states; i++) {
        y[i] = hidden[i];
    }
    y[0] = shown[0] = (x[4] - bias[2]) / gain[2];
    y[1] = shown[1] = (x[5] - bias[3]) / gain[3];
    y[2] = (x[6] - bias[4]) / gain[4];
    y[3] = x[7] / gain[4];
    if (count > 0) {
        for (int i = 0; i < count; i++) {
            y[loop->lagging[i].chamber] = predicted[loop->lagging[i].chamber];
        }
        hydro_correct(loop, y, count, y[2] - predicted[2]);
        for (int i = 0; i < count; i++) {
            errors[i] = shown[loop->lagging[i].chamber] - y[loop->lagging[i].signal];
        }
        for (int i = 0; i < count; i++) {
            hydro_correct(loop, y, i, errors[i]);
        }
    }
    if (cell) {
        y[loop->whole.cell] = (x[2] - bias[1]) / gain[1];
        if (loop->whole.cell_rate != HYDRO_NONE) {
            y[loop->whole.cell_rate] = x[3] / gain[1];
        }
    }
}

/* Set a state's spool, and the currents on their way to it, to the opening [A]; returns the current for it. */
static inline hydro_real hydro_set_opening(
    const hydro_loop *loop, const hydro_model *model, hydro_real *y, hydro_real opening)
{
    hydro_real current = opening - loop->after - loop->before;
    for (int i = model->states - loop->past; i < model->states; i++) {
        y[i] = current;
    }
    if (model->spool != HYDRO_NONE) {
        y[model->spool] = opening - loop->after;
        if (model->spool_rate != HYDRO_NONE) {
            y[model->spool_rate] = HYDRO_R(0);
        }
    }
    return current;
}

/* f_h' [N/s] and y' with the valve held at `opening` [A]. */
static inline hydro_real hydro_held(
    const hydro_loop *loop, const hydro_model *model, hydro_real *y, hydro_real opening, hydro_real *slopes)
{
    hydro_real current = hydro_set_opening(loop, model, y, opening);
    model->rates(model->k, 1, y, &current, slopes);
    return loop->area * (slopes[0] - loop->ratio * slopes[1]);
}

static inline hydro_sensitivity hydro_sensitivity_at(
    const hydro_loop *loop, const hydro_real *state, hydro_real opening)
{
    hydro_real y[HYDRO_STATES], slopes[HYDRO_SLOPES], closed, rate_a, rate_b, held, size;
    hydro_sensitivity made;
    for (int i = 0; i < loop->linear.states; i++) {
        y[i] = state[i];
    }
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

/* Take in the first sample: the spool in equilibrium with the current of now. */
static inline void hydro_settle(const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_loop_sample *seen)
{
    if (memory->running) {
        return;
    }
    for (int i = 0; i < loop->whole.states; i++) {
        memory->hidden[i] = loop->rest[i];
    }
    for (int i = 0; i < loop->lagging_count; i++) {
        int chamber = loop->lagging[i].chamber;
        hydro_real shown = (seen->x[4 + chamber] - loop->bias[2 + chamber]) / loop->gain[2 + chamber];
        memory->hidden[chamber] = memory->hidden[loop->lagging[i].signal] = shown;
    }
    hydro_lift(loop, memory->hidden, seen->x, true, memory->hidden);
    memory->opening = seen->current + loop->before + loop->after;
    memory->opening_rate = HYDRO_R(0);
    (void)hydro_set_opening(loop, &loop->whole, memory->hidden, memory->opening);
    memory->reference_rate = seen->reference_rate;
    memory->running = true;
}

/* On to the next sample: the valve holds the current over this one. */
static inline void hydro_follow(const hydro_loop *loop, hydro_memory_of_loop *memory, const hydro_loop_sample *seen)
{
    const hydro_model *model = &loop->whole;
    hydro_real z[HYDRO_READINGS], opening = memory->opening, arrived = seen->current, *hidden = memory->hidden;
    hydro_lift(loop, hidden, seen->x, false, hidden);
    loop->sample(loop->sample_k, hidden, seen->current, z);
    if (loop->past > 0) {
        arrived = hidden[model->states - loop->past + loop->at_valve];
    }
    memory->opening = (model->spool == HYDRO_NONE ? arrived + loop->before : hidden[model->spool]) + loop->after;
    memory->opening_rate = (memory->opening - opening) / HYDRO_R(HYDRO_PERIOD);
    if (model->spool != HYDRO_NONE && model->spool_rate != HYDRO_NONE) {
        memory->opening_rate = hidden[model->spool_rate];
    }
    memory->reference_rate = seen->reference_rate;
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

/* v of what lagging pressure sensors show and of its rate; `force_rate`: f_h' [N/s] of the reference. */
static inline void hydro_displace_shown(
    const hydro_loop *loop, const hydro_real *y, hydro_real force_rate, const hydro_sensitivity *at, hydro_real *v)
{
    hydro_real total = loop->area * (at->soft_a + loop->ratio * at->soft_b);
    for (int i = 0; i < loop->lagging_count; i++) {
        const hydro_lagging *sensor = &loop->lagging[i];
        hydro_real share = (sensor->chamber == 0 ? at->soft_a : -at->soft_b) / total;
        hydro_real behind = y[sensor->signal] - y[sensor->chamber] + sensor->age * share * force_rate;
        v[HYDRO_LOOP + 2 * i] = share * v[HYDRO_Q_F_H] / loop->gain[0] + behind;
        v[HYDRO_LOOP + 2 * i + 1] = y[sensor->rate] - share * force_rate;
    }
}

/* v of the currents on their way; `closed`: f_h' [N/s] of the closed valve, `wanted`: the spool's reference, its rate. */
static inline void hydro_displace_commands(
    const hydro_loop *loop, const hydro_real *hidden, hydro_real *y, hydro_real closed, const hydro_real wanted[2],
    hydro_real *v)
{
    hydro_real slopes[HYDRO_SLOPES];
    int first = loop->coordinates - loop->on_their_way, begin = loop->whole.states - loop->past;
    for (int i = 0; i < loop->on_their_way; i++) {
        hydro_real opening = hidden[begin + i] + loop->before + loop->after;
        hydro_real driven = hydro_held(loop, &loop->whole, y, opening, slopes) - closed;
        hydro_real ahead = loop->delay - ((hydro_real)i + HYDRO_R(0.5)) * HYDRO_R(HYDRO_PERIOD) + loop->spool_age;
        v[first + i] = driven - wanted[0] - ahead * wanted[1];
    }
}

/* v of a sample at its f_r and f_r'. The present friction is the reference's, so that it displaces nothing. */
static inline void hydro_displace(
    const hydro_loop *loop, const hydro_memory_of_loop *memory, const hydro_loop_sample *seen, hydro_real *v)
{
    const hydro_real *x = seen->x;
    hydro_real reference = seen->reference, reference_rate = seen->reference_rate;
    hydro_real limit = loop->bend_max, y[HYDRO_STATES], state[HYDRO_STATES], slopes[HYDRO_SLOPES];
    hydro_real bend = hydro_clamp((reference_rate - memory->reference_rate) / HYDRO_R(HYDRO_PERIOD), -limit, limit);
    hydro_real spring = (reference - loop->bias[1] + loop->lag * reference_rate + loop->inertia * bend) / loop->gain[1];
    hydro_real spring_rate = (reference_rate + loop->lag * bend) / loop->gain[1], spring_bend = bend / loop->gain[1];
    hydro_real stiffness, position, velocity, closed, driven, dry, pushing, wanted[2];
    hydro_sensitivity at;
    hydro_lift(loop, memory->hidden, x, true, y);
    hydro_chosen(loop, y, state);
    at = hydro_sensitivity_at(loop, state, memory->opening);
    position = hydro_position(loop, spring, &stiffness);
    velocity = spring_rate / stiffness;
    closed = at.still - at.stiffness * y[3];
    driven = hydro_held(loop, &loop->whole, y, memory->opening, slopes) - closed;
    dry = hydro_dry_friction(loop, y, state, slopes);
    pushing = loop->area * (y[0] - loop->ratio * y[1]) - hydro_load(loop, y[2]);
    state[3] = velocity;
    (void)hydro_held(loop, &loop->linear, state, HYDRO_R(0), slopes);
    wanted[0] = spring_rate + at.stiffness * velocity - at.still;
    wanted[1] = (HYDRO_R(1) + at.stiffness / stiffness) * spring_bend;
    v[HYDRO_Q_F_H] = x[0] - loop->bias[0]
                     - loop->gain[0] * (spring + loop->mass * spring_bend / stiffness + pushing
                                        - loop->mass * slopes[3] + dry);
    if (loop->force_shown != HYDRO_NONE) {
        v[HYDRO_Q_F_H] += loop->gain[0] * (loop->area * (y[0] - loop->ratio * y[1]) - y[loop->force_shown]);
    }
    v[HYDRO_Q_SPOOL] = driven - wanted[0];
    v[HYDRO_Q_SPOOL_RATE] = at.gain * memory->opening_rate - wanted[1];
    v[HYDRO_Q_F_L] = x[2] - reference;
    v[HYDRO_Q_F_L_RATE] = x[3] - reference_rate;
    v[HYDRO_Q_X] = y[2] - position;
    v[HYDRO_Q_V] = v[HYDRO_Q_BOX] = y[3] - velocity;
    hydro_displace_shown(loop, y, spring_rate, &at, v);
    hydro_displace_commands(loop, memory->hidden, y, closed, wanted, v);
    for (int i = 0; i < loop->coordinates; i++) {
        v[i] /= loop->scale[i];
    }
}

/* The loop's states a sample after `before`, and their derivatives; an opening near zero is moved to its side of it. */
static inline void hydro_ahead_of(
    const hydro_loop *loop, const hydro_real *before, hydro_real opening, hydro_real side, hydro_real current,
    hydro_real *after, hydro_real *by_state)
{
    const hydro_real least = HYDRO_R(HYDRO_CLOSED), shift = loop->before + loop->after;
    hydro_real z[HYDRO_READINGS], dz[HYDRO_READINGS * (HYDRO_STATES + 1)];
    int n = loop->linear.states, spool = loop->linear.spool;
    for (int i = 0; i < n; i++) {
        after[i] = before[i];
    }
    if (spool == HYDRO_NONE) {
        for (int i = n - loop->past; i < n; i++) {
            after[i] = hydro_abs(after[i] + shift) < least ? side * least - shift : after[i];
        }
        current = hydro_abs(current + shift) < least ? side * least - shift : current;
    } else if (hydro_abs(opening) < least) {
        after[spool] = side * least - loop->after;
    }
    loop->jacobian(loop->linear.k, after, current, z, by_state, dz);
}

/* Tangents of the loop's states for the coordinates, (states + 1) x coordinates; of the current in HYDRO_INPUT. A
 * change of f_h is `share` of the pressures [Pa/N]. */
static inline void hydro_embed(const hydro_loop *loop, const hydro_real share[2], hydro_real gain, hydro_real *tangent)
{
    const hydro_model *model = &loop->linear;
    const hydro_real *scale = loop->scale;
    int width = loop->coordinates, added = width - HYDRO_LOOP;
    for (int i = 0; i < (model->states + 1) * width; i++) {
        tangent[i] = HYDRO_R(0);
    }
    tangent[HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[0];
    tangent[width + HYDRO_Q_F_H] = scale[HYDRO_Q_F_H] * share[1];
    if (model->spool != HYDRO_NONE) {
        tangent[model->spool * width + HYDRO_Q_SPOOL] = scale[HYDRO_Q_SPOOL] / gain;
    }
    if (model->spool_rate != HYDRO_NONE) {
        tangent[model->spool_rate * width + HYDRO_Q_SPOOL_RATE] = scale[HYDRO_Q_SPOOL_RATE] / gain;
    }
    if (model->cell_rate != HYDRO_NONE) {
        tangent[model->cell * width + HYDRO_Q_F_L] = scale[HYDRO_Q_F_L] / loop->gain[1];
        tangent[model->cell_rate * width + HYDRO_Q_F_L_RATE] = scale[HYDRO_Q_F_L_RATE] / loop->gain[1];
    }
    tangent[2 * width + HYDRO_Q_X] = scale[HYDRO_Q_X];
    tangent[3 * width + HYDRO_Q_V] = scale[HYDRO_Q_V];
    for (int i = 0; i < added; i++) {
        hydro_real unit = scale[HYDRO_LOOP + i];
        tangent[loop->kept[i] * width + HYDRO_LOOP + i] = i >= added - loop->on_their_way ? unit / gain : unit;
    }
    tangent[model->states * width + HYDRO_INPUT] = HYDRO_R(1);
}

/* F and G from the derivatives of the loop's states; `gain` and `later` are g before and after the sample. */
static inline void hydro_transition(
    const hydro_loop *loop, const hydro_real *by_state, const hydro_real share[2], hydro_real gain, hydro_real later,
    hydro_linear *linear)
{
    const hydro_model *model = &loop->linear;
    const hydro_real *scale = loop->scale;
    const hydro_real period = HYDRO_R(HYDRO_PERIOD);
    hydro_real tangent[(HYDRO_STATES + 1) * HYDRO_COORDINATES], moved[HYDRO_STATES], unit;
    hydro_real force = loop->gain[0] * loop->area, memory = loop->velocity_memory, *to = linear->transition;
    int n = model->states, width = loop->coordinates, added = width - HYDRO_LOOP, spool = model->spool;
    hydro_embed(loop, share, gain, tangent);
    for (int c = 0; c < width; c++) {
        hydro_real opened, before;
        for (int i = 0; i < n; i++) {
            moved[i] = HYDRO_R(0);
        }
        for (int j = 0; j <= n; j++) {
            hydro_real nudge = tangent[j * width + c];
            if (nudge < HYDRO_R(0) || nudge > HYDRO_R(0)) {
                for (int i = 0; i < n; i++) {
                    moved[i] += by_state[i * (n + 1) + j] * nudge;
                }
            }
        }
        if (spool != HYDRO_NONE) {
            opened = moved[spool];
            before = tangent[spool * width + c];
        } else {
            opened = loop->past == 0 ? tangent[n * width + c] : moved[n - loop->past + loop->at_valve];
            before = c == HYDRO_Q_SPOOL ? scale[HYDRO_Q_SPOOL] / gain : HYDRO_R(0);
        }
        to[HYDRO_Q_F_H * width + c] = force * (moved[0] - loop->ratio * moved[1]) / scale[HYDRO_Q_F_H];
        to[HYDRO_Q_SPOOL * width + c] = later * opened / scale[HYDRO_Q_SPOOL];
        opened = model->spool_rate != HYDRO_NONE ? moved[model->spool_rate] : (opened - before) / period;
        to[HYDRO_Q_SPOOL_RATE * width + c] = later * opened / scale[HYDRO_Q_SPOOL_RATE];
        to[HYDRO_Q_F_L * width + c] = loop->gain[1] * moved[model->cell] / scale[HYDRO_Q_F_L];
        if (model->cell_rate != HYDRO_NONE) {
            unit = moved[model->cell_rate];
        } else { /* an ideal cell shows the load itself, and its rate */
            unit = by_state[model->cell * (n + 1) + 2] / by_state[2 * (n + 1) + 2] * moved[3];
        }
        to[HYDRO_Q_F_L_RATE * width + c] = loop->gain[1] * unit / scale[HYDRO_Q_F_L_RATE];
        to[HYDRO_Q_X * width + c] = moved[2] / scale[HYDRO_Q_X];
        to[HYDRO_Q_V * width + c] = moved[3] / scale[HYDRO_Q_V];
        for (int i = 0; i < added; i++) {
            unit = i >= added - loop->on_their_way ? later : HYDRO_R(1);
            to[(HYDRO_LOOP + i) * width + c] = unit * moved[loop->kept[i]] / scale[HYDRO_LOOP + i];
        }
        to[HYDRO_Q_BOX * width + c] =
            (HYDRO_R(1) - memory) / period * (moved[2] - tangent[2 * width + c]) / scale[HYDRO_Q_BOX];
    }
    for (int i = 0; i < width; i++) {
        linear->push[i] = to[i * width + HYDRO_INPUT];
        to[i * width + HYDRO_INPUT] = HYDRO_R(0);
    }
    to[HYDRO_Q_BOX * width + HYDRO_Q_BOX] = memory; /* the differentiator's */
}

/* du/dx, A per unit of each state, of the force law at its own current [A]. It is the slope of F(x, u) = h + g u at held
 * u over -C_2 g, except along f_l: C_1 h + C_2 g u is F at C_1 x_p' and C_2 u. At the floor of g the law feels no change
 * of it. */
static inline void hydro_law_gradient(
    const hydro_loop *loop, const hydro_loop_sample *seen, hydro_real nominal, hydro_real *out)
{
    const hydro_bench *bench = &loop->bench;
    const hydro_real *x = seen->x;
    hydro_real opening = hydro_before_leap(bench, nominal);
    hydro_lands lands = hydro_open_lands(bench, x[4], x[5], opening);
    hydro_real area = bench->piston_area, ratio = bench->area_ratio, swept = -area * (seen->c_1 * x[7]);
    hydro_real volume_a = hydro_volume_a(bench, x[6]), volume_b = hydro_volume_b(bench, x[6]);
    hydro_real scale = bench->bulk_modulus * area;
    hydro_real gain = seen->c_2 * hydro_input_gain(bench, x[6], x[4], x[5], opening);
    hydro_real opened = gain > loop->gain_floor ? bench->valve_gain * seen->c_2 * opening : HYDRO_R(0);
    hydro_real flow_a = lands.root_a * opened + swept, flow_b = lands.root_b * opened + ratio * swept;
    hydro_real by_position = scale * area
                             * (-flow_a / (volume_a * volume_a) + ratio * ratio * flow_b / (volume_b * volume_b));
    hydro_real by_velocity = -scale * area * (HYDRO_R(1) / volume_a + ratio * ratio / volume_b);
    gain = hydro_max(gain, loop->gain_floor);
    out[0] = out[1] = out[3] = HYDRO_R(0);
    out[2] = -seen->k_p / gain;
    out[4] = -scale * lands.slope_a * opened / volume_a / gain;
    out[5] = -scale * ratio * lands.slope_b * opened / volume_b / gain;
    out[6] = x[6] >= HYDRO_R(0) && x[6] <= bench->stroke ? -by_position / gain : HYDRO_R(0);
    out[7] = -seen->c_1 * by_velocity / gain;
}

/* K [A] at the law's own current [A]; a change of f_h is `share` of the pressures [Pa/N], of which the law feels one
 * behind a lagging sensor as that sensor shows it. */
static inline void hydro_law_slopes(
    const hydro_loop *loop, const hydro_loop_sample *seen, hydro_real nominal, const hydro_real share[2],
    hydro_real *feedback)
{
    hydro_real law[HYDRO_MEASURED], felt[2] = {share[0], share[1]};
    const hydro_real *scale = loop->scale;
    hydro_law_gradient(loop, seen, nominal, law);
    for (int i = 0; i < loop->coordinates; i++) {
        feedback[i] = HYDRO_R(0);
    }
    for (int i = 0; i < loop->lagging_count; i++) {
        int chamber = loop->lagging[i].chamber, column = HYDRO_LOOP + 2 * i;
        feedback[column] = law[4 + chamber] * loop->gain[2 + chamber] * scale[column];
        felt[chamber] = HYDRO_R(0);
    }
    feedback[HYDRO_Q_F_H] = (law[4] * felt[0] + law[5] * felt[1]) * scale[HYDRO_Q_F_H];
    feedback[HYDRO_Q_F_L] = law[2] * scale[HYDRO_Q_F_L];
    feedback[HYDRO_Q_X] = law[6] * scale[HYDRO_Q_X];
    feedback[HYDRO_Q_BOX] = law[7] * scale[HYDRO_Q_BOX];
}

/* F, G, K of a sample: on the side of zero on which the spool stands. g differs on both sides, and a sample with a part
 * of each has the derivatives of neither; one in which the spool passes zero is taken with a closed valve. */
static inline void hydro_linearize(
    const hydro_loop *loop, const hydro_memory_of_loop *memory, const hydro_loop_sample *seen, hydro_linear *linear)
{
    hydro_real y[HYDRO_STATES], before[HYDRO_STATES], after[HYDRO_STATES];
    hydro_real by_state[HYDRO_STATES * (HYDRO_STATES + 1)], share[2], total, later, current;
    hydro_real opening = memory->opening, side = hydro_copysign(HYDRO_R(1), opening);
    hydro_real closed = side * HYDRO_R(HYDRO_CLOSED);
    hydro_sensitivity at;
    hydro_lift(loop, memory->hidden, seen->x, true, y);
    hydro_chosen(loop, y, before);
    at = hydro_sensitivity_at(loop, before, opening);
    total = loop->gain[0] * loop->area * (at.soft_a + loop->ratio * at.soft_b);
    share[0] = at.soft_a / total;
    share[1] = -at.soft_b / total;
    hydro_ahead_of(loop, before, opening, side, seen->current, after, by_state);
    if (loop->linear.spool != HYDRO_NONE && side * (after[loop->linear.spool] + loop->after) < HYDRO_R(0)) {
        current = hydro_set_opening(loop, &loop->linear, before, closed);
        hydro_ahead_of(loop, before, closed, side, current, after, by_state);
    }
    later = hydro_sensitivity_at(loop, after, opening).gain;
    hydro_transition(loop, by_state, share, at.gain, later, linear);
    hydro_law_slopes(loop, seen, hydro_copysign(seen->nominal, side), share, linear->feedback);
}

#endif
