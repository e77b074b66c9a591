/* SPDX-License-Identifier: Apache-2.0 */
/* Optional: the filter's decision, one sample at a time.
 *
 *   loop.h --> v, F, G, K --+
 *   table of K_p --> M -----+--> M_c(du) = bent du^2 + 2 slope du + level --> a du <= b --> smallest |du|
 *   the law's integral -----+
 *
 * docs/manual/explanation/safety.md has the certificate; hydro_filter.controller.loop_decision is the same in Python.
 * Samples must follow one another, each once; after a gap begin with a memory of zeros. One that is none of a bench gets
 * NAN, and the memory begins anew. A correction acts one sample after its own. `ros2 run hydro_filter export_c`
 * writes HYDRO_LOOP_FILTER.
 *
 * It knows the paper's law alone: under the compensated one (HYDRO_COMPENSATED) apply no correction, and begin with a
 * memory of zeros behind it.
 *
 * Nothing here sees that the model is no longer the bench's. The graph's filter does (MISMATCH): let it run beside, and
 * apply no correction of this one while the newest command has filter_fresh 0.
 */
#ifndef HYDRO_LOOP_FILTER_H
#define HYDRO_LOOP_FILTER_H

#include "loop.h"
#include "protocol.h"

#define HYDRO_LEAST_IMPROVEMENT 0.01 /* share of the violation that a correction at the valve's limit must remove */
#define HYDRO_FACTOR (HYDRO_LOOP * (HYDRO_LOOP + 1) / 2) /* entries of a Cholesky factor, row by row */

enum { HYDRO_PASS = 0, HYDRO_MODIFIED = 1, HYDRO_RELAXED = 2, HYDRO_INFEASIBLE = 3, HYDRO_NAN = 4 };

typedef struct {
    hydro_loop loop;
    const hydro_real (*table)[HYDRO_FACTOR]; /* factors for K_p = low, low + step, ...; the last: all other gains */
    int rows;                                /* of the table, without the last */
    hydro_real gain_low, gain_high, gain_step; /* 1/s, the certified range */
    hydro_real floor;                        /* smallest eigenvalue of M */
    hydro_real kept, foreign_kept;           /* exp(-2 lambda T) in the range, and beyond it */
    hydro_real noise_size, foreign_noise_size; /* v'Mv up to which there is nothing but noise */
    hydro_real integral_allowance;           /* N/s that the law's integral may ask for */
} hydro_loop_filter;

typedef struct {
    hydro_real delta_u;       /* A, finite */
    hydro_real before, after; /* M_c without and with it, 1/s; 0 where something was not finite */
    uint32_t status;
} hydro_decision;

/* M_c T as a function of du [A], and v'Mv when the correction acts. */
typedef struct {
    hydro_real bent, slope, level, size;
} hydro_quadratic;

/* M at a gain K_p [1/s], between the table's factors by straight lines. */
static inline void hydro_metric(
    const hydro_loop_filter *filter, hydro_real k_p, bool foreign, hydro_real matrix[HYDRO_LOOP][HYDRO_LOOP])
{
    hydro_real factor[HYDRO_FACTOR], place = HYDRO_R(0), share;
    int low = foreign ? filter->rows : 0;
    if (!foreign && filter->rows > 1) {
        place = (k_p - filter->gain_low) / filter->gain_step;
        low = (int)place < filter->rows - 2 ? (int)place : filter->rows - 2;
    }
    share = foreign ? HYDRO_R(0) : place - (hydro_real)low;
    for (int i = 0; i < HYDRO_FACTOR; i++) {
        factor[i] = filter->table[low][i];
        if (share > HYDRO_R(0)) {
            factor[i] = (HYDRO_R(1) - share) * factor[i] + share * filter->table[low + 1][i];
        }
    }
    for (int i = 0; i < HYDRO_LOOP; i++) {
        for (int j = 0; j <= i; j++) {
            matrix[i][j] = HYDRO_R(0);
            for (int k = 0; k <= j; k++) {
                matrix[i][j] += factor[i * (i + 1) / 2 + k] * factor[j * (j + 1) / 2 + k];
            }
            matrix[j][i] = matrix[i][j];
        }
        matrix[i][i] += filter->floor;
    }
}

/* One sample of v, its currents beside the law's `known` [A]. */
static inline void hydro_ahead(const hydro_linear *linear, const hydro_real *v, hydro_real known, hydro_real *next)
{
    for (int i = 0; i < HYDRO_LOOP; i++) {
        known += linear->feedback[i] * v[i];
    }
    for (int i = 0; i < HYDRO_LOOP; i++) {
        next[i] = linear->push[i] * known;
        for (int j = 0; j < HYDRO_LOOP; j++) {
            next[i] += linear->transition[i][j] * v[j];
        }
    }
}

/* M_c T: `v` is first moved to where the correction acts, by the current that is `known`, then on as the law goes. */
static inline hydro_quadratic hydro_certify(
    const hydro_linear *linear, hydro_real matrix[HYDRO_LOOP][HYDRO_LOOP], const hydro_real *v, hydro_real known,
    hydro_real asked, hydro_real kept)
{
    hydro_real next[HYDRO_LOOP], after[HYDRO_LOOP];
    hydro_quadratic made = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)};
    hydro_ahead(linear, v, known, next);
    hydro_ahead(linear, next, asked, after);
    for (int i = 0; i < HYDRO_LOOP; i++) {
        hydro_real now = HYDRO_R(0), then = HYDRO_R(0), moved = HYDRO_R(0);
        for (int j = 0; j < HYDRO_LOOP; j++) {
            now += matrix[i][j] * next[j];
            then += matrix[i][j] * after[j];
            moved += matrix[i][j] * linear->push[j];
        }
        made.size += next[i] * now;
        made.level += after[i] * then;
        made.slope += linear->push[i] * then;
        made.bent += linear->push[i] * moved;
    }
    made.level -= kept * made.size;
    return made;
}

/* Share, 0 to 1, of a displacement of this size that counts: none up to `floor`, all from twice that. */
static inline hydro_real hydro_counting(hydro_real size, hydro_real floor)
{
    hydro_real share;
    if (size <= floor) {
        return HYDRO_R(0);
    }
    share = size < HYDRO_R(2) * floor ? size / floor - HYDRO_R(1) : HYDRO_R(1);
    return share * share * (HYDRO_R(3) - HYDRO_R(2) * share);
}

/* What of the law's integral I is beyond what it is there for, as a current [A]. */
static inline hydro_real hydro_asked(const hydro_loop_filter *filter, const hydro_real *values)
{
    const hydro_bench *bench = &filter->loop.bench;
    hydro_real position = hydro_clamp(values[6], HYDRO_R(0), bench->stroke), nominal = values[HYDRO_NOMINAL];
    hydro_real gain = hydro_max(
        hydro_input_gain(bench, position, values[4], values[5], nominal), filter->loop.gain_floor);
    hydro_real driven = nominal * gain + hydro_velocity_term(bench, position, values[7]);
    hydro_real term = driven - values[HYDRO_REFERENCE_RATE] - values[HYDRO_KP] * (values[HYDRO_REFERENCE] - values[2]);
    return (term - hydro_clamp(term, -filter->integral_allowance, filter->integral_allowance)) / gain;
}

/* M_c T of a sample, with what noise is taken out. Moves the memory on. */
static inline hydro_quadratic hydro_problem(
    const hydro_loop_filter *filter, hydro_memory_of_loop *memory, const hydro_real *values)
{
    const hydro_loop *loop = &filter->loop;
    hydro_real matrix[HYDRO_LOOP][HYDRO_LOOP], v[HYDRO_LOOP], k_p = values[HYDRO_KP], share;
    hydro_real nominal = values[HYDRO_NOMINAL], current = values[HYDRO_CURRENT], rate = values[HYDRO_REFERENCE_RATE];
    hydro_real asked = hydro_asked(filter, values);
    bool foreign = k_p < filter->gain_low || k_p > filter->gain_high;
    hydro_linear linear;
    hydro_quadratic made;
    hydro_settle(loop, memory, values, current, rate);
    hydro_linearize(loop, memory, values, nominal, current, k_p, &linear);
    hydro_displace(loop, memory, values, values[HYDRO_REFERENCE], rate, v);
    hydro_follow(loop, memory, values, current, rate);
    hydro_metric(filter, k_p, foreign, matrix);
    made = hydro_certify(
        &linear, matrix, v, current - nominal + asked, asked, foreign ? filter->foreign_kept : filter->kept);
    share = hydro_counting(made.size, foreign ? filter->foreign_noise_size : filter->noise_size);
    made.slope *= share;
    made.level *= share * share;
    return made;
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

/* The change [A] within [low, high] of the valve's current, low <= 0 <= high, and the status. */
static inline hydro_real hydro_smallest(
    const hydro_quadratic *p, hydro_real low, hydro_real high, uint32_t *status)
{
    hydro_real reach = p->slope * p->slope - p->bent * p->level, root, end, change;
    if (p->level <= HYDRO_R(0)) {
        *status = HYDRO_PASS;
        return HYDRO_R(0);
    }
    if (reach >= HYDRO_R(0)) { /* the nearer root, in the form that does not cancel */
        root = HYDRO_SQRT(reach);
        end = -p->level / (p->slope + (p->slope < HYDRO_R(0) ? -root : root));
        return end > HYDRO_R(0) ? hydro_closed_form(HYDRO_R(-1), -end, low, high, status)
                                : hydro_closed_form(HYDRO_R(1), end, low, high, status);
    }
    change = hydro_clamp(-p->slope / p->bent, low, high); /* none restores it: the best there is */
    if (-(p->bent * change + HYDRO_R(2) * p->slope) * change < HYDRO_R(HYDRO_LEAST_IMPROVEMENT) * p->level) {
        *status = HYDRO_INFEASIBLE;
        return HYDRO_R(0);
    }
    *status = HYDRO_RELAXED;
    return change;
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

/* Whether a sample can be one of a bench: `hydro_conceivable`, also by the model. */
static inline bool hydro_believable(const hydro_loop *loop, const hydro_real *values)
{
    return hydro_conceivable(&loop->bench, values, values[HYDRO_NOMINAL], values[HYDRO_REFERENCE], values[HYDRO_KP])
           && hydro_within(values[HYDRO_CURRENT], HYDRO_R(2) * loop->bench.valve_current_max)
           && hydro_within(values[HYDRO_REFERENCE_RATE], HYDRO_R(1e9))
           && hydro_has_room(loop->area, loop->dead_a, values[6])
           && hydro_has_room(loop->ratio * loop->area, loop->dead_b, loop->stroke - values[6]);
}

/* Decide about one sample, `values` of a hydro_sample; a disarmed one, too, moves the memory on. */
static inline hydro_decision hydro_decide_loop(
    const hydro_loop_filter *filter, hydro_memory_of_loop *memory, const hydro_real *values, bool armed)
{
    static const hydro_memory_of_loop fresh = {.running = false};
    hydro_decision made = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_NAN};
    hydro_real limit = filter->loop.bench.valve_current_max, nominal = values[HYDRO_NOMINAL], applied, change;
    hydro_quadratic p;
    if (!hydro_believable(&filter->loop, values)) {
        *memory = fresh;
        return made;
    }
    p = hydro_problem(filter, memory, values);
    made.status = HYDRO_PASS;
    if (!armed) {
        return made;
    }
    if (!hydro_finite(p.level) || !hydro_finite(p.slope) || !hydro_finite(p.bent)) {
        made.status = HYDRO_NAN;
        return made;
    }
    applied = hydro_clamp(nominal, -limit, limit);
    change = hydro_smallest(&p, -limit - applied, limit - applied, &made.status);
    made.before = p.level / HYDRO_R(HYDRO_PERIOD);
    made.after = (p.bent * change * change + HYDRO_R(2) * p.slope * change + p.level) / HYDRO_R(HYDRO_PERIOD);
    if (change < HYDRO_R(0) || change > HYDRO_R(0)) {
        made.delta_u = change + (applied - nominal);
    }
    return made;
}

#endif
