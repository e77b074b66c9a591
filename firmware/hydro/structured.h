/* SPDX-License-Identifier: Apache-2.0 */
/* Optional, of the default filter: the structured model over one sample, and what nudges of its state do to it.
 *
 *   s  p_a  p_b  x_p  x_p'  spool  spool'
 *   d  (9, 8)   rows: s; F and F', the load force behind the amplifier of its load cell; the valve current.
 *               A column is a direction. d' = (ds'/ds) d through each stage
 *
 * Four steps of Runge-Kutta 4 for both. Dry friction is left out: it is a bounded disturbance to the certificate.
 * docs/manual/explanation/physics.md has the equations; hydro_filter.model.tangent is the same in Python.
 */
#ifndef HYDRO_STRUCTURED_H
#define HYDRO_STRUCTURED_H

#include "config.h"

#ifndef HYDRO_EXP /* of the target; the compiler's own else */
#ifdef HYDRO_SINGLE
#define HYDRO_EXP(x) __builtin_expf(x)
#else
#define HYDRO_EXP(x) __builtin_exp(x)
#endif
#endif

#define HYDRO_MOVING 6              /* length of s: the load cell is linear, its own state bends no derivative */
#define HYDRO_PLANT 8               /* rows of d that move */
#define HYDRO_CURRENT_ROW 8         /* of d */
#define HYDRO_DIRECTIONS 8          /* columns of d */
#define HYDRO_SUBSTEPS 4            /* of a sample */
#define HYDRO_STEP (HYDRO_PERIOD / HYDRO_SUBSTEPS)
#define HYDRO_LAMINAR 1e4           /* Pa, below it the root of a pressure drop is rounded off */
#define HYDRO_STOP_STIFFNESS 1e7    /* N/m, of the end stops */
#define HYDRO_STOP_DAMPING 4e3      /* N s/m */

/* Learned constants, in the order of hydro_sim.structured.physics; SI units. */
typedef struct {
    hydro_real bulk, area, ratio, dead_a, dead_b, supply, tank;
    hydro_real ka_positive, ka_negative, kb_positive, kb_negative; /* m3/s/A/sqrt(Pa) */
    hydro_real offset, leak, mass, viscous, spring, rest;
    hydro_real spool_omega, spool_damping, cell_omega, cell_damping;
    hydro_real coulomb, stribeck, stribeck_velocity, bristle, bristle_damping, damping_velocity;
    hydro_real gain_h, bias_h, gain_l, bias_l, stroke;
} hydro_model;

/* Slopes of s' that are not 0 or 1, by row and column: chambers a and b, v velocity, u spool, l load cell. */
typedef struct {
    hydro_real aa, ab, ax, av, au, ba, bb, bx, bv, bu, va, vb, vx, vv, uu, uv, us, lx, ll, lv;
} hydro_slopes;

/* sqrt of a pressure drop [Pa], odd and rounded off at zero; and its slope. */
static inline hydro_real hydro_root(hydro_real drop, hydro_real *slope)
{
    hydro_real square = drop * drop, rounded = square + HYDRO_R(HYDRO_LAMINAR * HYDRO_LAMINAR);
    hydro_real width = HYDRO_SQRT(HYDRO_SQRT(rounded));
    *slope = (HYDRO_R(1) - HYDRO_R(0.5) * square / rounded) / width;
    return drop / width;
}

/* p_a', p_b' and their slopes. */
static inline void hydro_chambers(const hydro_model *c, const hydro_real *s, hydro_real *rate, hydro_slopes *p)
{
    hydro_real area = c->area, area_b = c->ratio * c->area, opening = s[4] + c->offset;
    bool forward = opening >= HYDRO_R(0);
    hydro_real soft_a = c->bulk / (c->dead_a + area * s[2]);
    hydro_real soft_b = c->bulk / (c->dead_b + area_b * (c->stroke - s[2]));
    hydro_real gain_a = forward ? c->ka_positive : c->ka_negative, gain_b = forward ? c->kb_positive : c->kb_negative;
    hydro_real side = forward ? HYDRO_R(-1) : HYDRO_R(1), bend_a, bend_b;
    hydro_real root_a = hydro_root(forward ? c->supply - s[0] : s[0] - c->tank, &bend_a);
    hydro_real root_b = hydro_root(forward ? s[1] - c->tank : c->supply - s[1], &bend_b);
    hydro_real leak = c->leak * (s[0] - s[1]);
    rate[0] = soft_a * (gain_a * opening * root_a - area * s[3] - leak);
    rate[1] = soft_b * (area_b * s[3] - gain_b * opening * root_b + leak);
    p->aa = soft_a * (side * gain_a * opening * bend_a - c->leak);
    p->bb = soft_b * (side * gain_b * opening * bend_b - c->leak);
    p->ab = soft_a * c->leak;
    p->ba = soft_b * c->leak;
    p->ax = -area / c->bulk * soft_a * rate[0];
    p->bx = area_b / c->bulk * soft_b * rate[1];
    p->av = -soft_a * area;
    p->bv = soft_b * area_b;
    p->au = soft_a * gain_a * root_a;
    p->bu = -soft_b * gain_b * root_b;
}

/* s' under a held current [A], and its slopes. */
static inline void hydro_motion(
    const hydro_model *c, const hydro_real *s, hydro_real current, hydro_real *rate, hydro_slopes *p)
{
    hydro_real area_b = c->ratio * c->area, spring = c->spring * (s[2] - c->rest), w = c->spool_omega;
    hydro_real damped = HYDRO_R(2) * c->spool_damping;
    hydro_real into = s[2] < HYDRO_R(0) ? s[2] : hydro_max(s[2] - c->stroke, HYDRO_R(0));
    hydro_real stop = HYDRO_R(HYDRO_STOP_STIFFNESS) * into + HYDRO_R(HYDRO_STOP_DAMPING) * s[3];
    bool presses = (into < HYDRO_R(0) && stop < HYDRO_R(0)) || (into > HYDRO_R(0) && stop > HYDRO_R(0));
    hydro_chambers(c, s, rate, p);
    stop = presses ? stop : HYDRO_R(0);
    rate[2] = s[3];
    rate[3] = (c->area * s[0] - area_b * s[1] - c->viscous * s[3] - spring - stop) / c->mass;
    p->va = c->area / c->mass;
    p->vb = -area_b / c->mass;
    p->vx = -(c->spring + (presses ? HYDRO_R(HYDRO_STOP_STIFFNESS) : HYDRO_R(0))) / c->mass;
    p->vv = -(c->viscous + (presses ? HYDRO_R(HYDRO_STOP_DAMPING) : HYDRO_R(0))) / c->mass;
    rate[4] = s[5];
    rate[5] = w * (w * (current - s[4]) - damped * s[5]);
    p->us = w * w;
    p->uu = -w * w;
    p->uv = -damped * w;
    w = c->cell_omega;
    damped = HYDRO_R(2) * c->cell_damping;
    p->lx = w * w * c->spring;
    p->ll = -w * w;
    p->lv = -damped * w;
}

/* The nudges' rates at `at`: weighted into `total`, and one stage ahead of `d` into `at`. */
static inline void hydro_push(
    const hydro_slopes *p, hydro_real d[][HYDRO_DIRECTIONS], hydro_real weight, hydro_real reach,
    hydro_real total[][HYDRO_DIRECTIONS], hydro_real at[][HYDRO_DIRECTIONS])
{
    for (int k = 0; k < HYDRO_DIRECTIONS; k++) {
        hydro_real a = at[0][k], b = at[1][k], x = at[2][k], v = at[3][k], u = at[4][k];
        const hydro_real m[HYDRO_PLANT] = {
            p->aa * a + p->ab * b + p->ax * x + p->av * v + p->au * u,
            p->ba * a + p->bb * b + p->bx * x + p->bv * v + p->bu * u,
            v,
            p->va * a + p->vb * b + p->vx * x + p->vv * v,
            at[5][k],
            p->uu * u + p->uv * at[5][k] + p->us * d[HYDRO_CURRENT_ROW][k],
            at[7][k],
            p->lx * x + p->ll * at[6][k] + p->lv * at[7][k]};
        for (int i = 0; i < HYDRO_PLANT; i++) {
            total[i][k] += weight * m[i];
            at[i][k] = d[i][k] + reach * m[i];
        }
    }
}

/* Keep s where a bench can be; a nudge of what was cut is none. */
static inline void hydro_bound(const hydro_model *c, hydro_real *s, hydro_real d[][HYDRO_DIRECTIONS])
{
    const hydro_real low[4] = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(-2e-3), HYDRO_R(-5)};
    const hydro_real high[4] = {
        HYDRO_R(2) * c->supply, HYDRO_R(2) * c->supply, c->stroke + HYDRO_R(2e-3), HYDRO_R(5)};
    for (int i = 0; i < 4; i++) {
        hydro_real within = hydro_clamp(s[i], low[i], high[i]);
        for (int k = 0; k < HYDRO_DIRECTIONS && within != s[i]; k++) {
            d[i][k] = HYDRO_R(0);
        }
        s[i] = within;
    }
}

/* One sample of s and of its nudges under a held current [A], in place. */
static inline void hydro_sample_ahead(
    const hydro_model *c, hydro_real *s, hydro_real current, hydro_real d[][HYDRO_DIRECTIONS])
{
    hydro_real rate[HYDRO_MOVING], probe[HYDRO_MOVING], total[HYDRO_MOVING];
    hydro_real at[HYDRO_PLANT][HYDRO_DIRECTIONS], summed[HYDRO_PLANT][HYDRO_DIRECTIONS];
    hydro_slopes p;
    for (int step = 0; step < HYDRO_SUBSTEPS; step++) {
        for (int i = 0; i < HYDRO_MOVING; i++) {
            probe[i] = s[i];
            total[i] = HYDRO_R(0);
        }
        for (int i = 0; i < HYDRO_PLANT; i++) {
            for (int k = 0; k < HYDRO_DIRECTIONS; k++) {
                at[i][k] = d[i][k];
                summed[i][k] = HYDRO_R(0);
            }
        }
        for (int stage = 0; stage < 4; stage++) {
            hydro_real weight = stage == 0 || stage == 3 ? HYDRO_R(1) : HYDRO_R(2);
            hydro_real reach = stage == 2 ? HYDRO_R(HYDRO_STEP) : HYDRO_R(0.5 * HYDRO_STEP);
            hydro_motion(c, probe, current, rate, &p);
            for (int i = 0; i < HYDRO_MOVING; i++) {
                total[i] += weight * rate[i];
                probe[i] = s[i] + reach * rate[i];
            }
            hydro_push(&p, d, weight, reach, summed, at);
        }
        for (int i = 0; i < HYDRO_MOVING; i++) {
            s[i] += HYDRO_R(HYDRO_STEP / 6.0) * total[i];
        }
        for (int i = 0; i < HYDRO_PLANT; i++) {
            for (int k = 0; k < HYDRO_DIRECTIONS; k++) {
                d[i][k] += HYDRO_R(HYDRO_STEP / 6.0) * summed[i][k];
            }
        }
    }
    hydro_bound(c, s, d);
}

#endif
