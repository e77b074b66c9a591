/* SPDX-License-Identifier: Apache-2.0 */
/* Optional: the filter's decision, one sample at a time.
 *
 *   loop.h --> v, F, G, K --+
 *   table of K_p --> M -----+--> M_c(du) = bent du^2 + 2 slope du + level --> a du <= b --> smallest |du|
 *   the law's integral -----+
 *
 * A correction decided at x_k acts with u_{k+1}. v is therefore first moved to that time, with the known current, and
 * the certificate is of the sample after it; w is the integral's current beyond its allowance:
 *
 *   v_1 = F v_0 + G (K v_0 + w + u_k - u_nom,k)              known: last correction and saturation are in u_k
 *   v_2 = F v_1 + G (K v_1 + w) + G du                       the law goes on unchanged
 *   M_c(du) = (v_2' M v_2 - exp(-2 lambda T) v_1' M v_1) / T <= 0            [1/s]
 *
 * Where the correction closes the loop, gains beyond the certified range, what the law asks for beyond the trajectory
 * of f_r counts as w does. Where the valve has an overlap, within which no current moves anything, du is counted as
 * what of it passes:
 *
 *     what passes            /        o: opening, the current less the one that closes the valve
 *               ____________/         0 for -back <= o <= out, less by the overlap beyond
 *              /   |  0  |
 *             /  -back  out           (Merritt 1967, sections 5-3 to 5-6)
 *
 * docs/manual/explanation/filter.md has the certificate. This is the only implementation: node, fleet and training
 * run it as a library (hydro_filter.c), a box may include it. Samples must follow one another, each once;
 * after a gap begin with a memory of zeros. One that is none of a bench gets NAN, and the memory begins anew.
 * `ros2 run hydro_filter export_c` writes HYDRO_LOOP_FILTER, with the law that it is for (`velocity_compensation`);
 * under another law its correction is that of gains without a certificate.
 *
 * Without monitor.h nothing here sees that the model is no longer the bench's.
 */
#ifndef HYDRO_LOOP_FILTER_H
#define HYDRO_LOOP_FILTER_H

#include "loop.h"
#include "protocol.h"

#define HYDRO_LEAST_IMPROVEMENT 0.01 /* share of the violation that a correction at the valve's limit must remove */
#define HYDRO_SAME 1e-3              /* difference of C_1 that is none: the line has it in single precision */
#define HYDRO_SCALES 1e3             /* most that C_1 can be, and C_2 as well as 1 / C_2 */

enum { HYDRO_PASS = 0, HYDRO_MODIFIED = 1, HYDRO_RELAXED = 2, HYDRO_INFEASIBLE = 3, HYDRO_NAN = 4 };

typedef struct {
    hydro_loop loop;
    const hydro_real *table; /* Cholesky factors by rows, for K_p = low, low + step, ...; the last: all other gains */
    int rows;                /* of the table, without the last */
    hydro_real gain_low, gain_high, gain_step; /* 1/s, the certified range */
    hydro_real floor;                          /* smallest eigenvalue of M */
    hydro_real kept, foreign_kept;             /* exp(-2 lambda T) in the range, and beyond it */
    hydro_real noise_size, foreign_noise_size; /* v'Mv up to which there is nothing but noise */
    hydro_real integral_allowance;             /* N/s that the law's integral may ask for */
    hydro_real velocity_compensation;          /* C_1, at C_2 = 1, that the metric is made for */
    hydro_real closing, back, out;             /* A, of the valve's overlap */
    hydro_loop_sample most;                    /* magnitudes beyond which a sample is none of a bench */
} hydro_loop_filter;

typedef struct {
    hydro_real delta_u;       /* A, finite */
    hydro_real before, after; /* M_c without and with it, 1/s; 0 where something was not finite */
    hydro_real a, b, low, high; /* the problem: a du <= b, low <= du <= high; of the valve's current */
    uint32_t status;
    bool restorable; /* whether any du satisfies the certificate: else a and b are 0 */
} hydro_decision;

/* M_c T as a function of what of du passes [A], v'Mv when the correction acts, and what the law alone gives the valve. */
typedef struct {
    hydro_real bent, slope, level, size, applied;
} hydro_quadratic;

/* A sample of a box and its law. */
static inline hydro_loop_sample hydro_loop_sample_of(
    const hydro_real *values, const hydro_law_state *acting, bool armed)
{
    hydro_loop_sample made = {
        .nominal = values[HYDRO_NOMINAL], .current = values[HYDRO_CURRENT], .reference = values[HYDRO_REFERENCE],
        .reference_rate = values[HYDRO_REFERENCE_RATE], .k_p = values[HYDRO_KP], .followed = acting->reference,
        .followed_rate = acting->reference_rate,
        .c_1 = acting->shaping[HYDRO_COEFFICIENTS], .c_2 = acting->shaping[HYDRO_COEFFICIENTS + 1], .armed = armed};
    hydro_copy(made.x, values, sizeof made.x);
    return made;
}

/* K_p [1/s] at C_2 = 1 of the same loop, and whether it has a certificate: C_1 is the metric's, K_p in its range. */
static inline bool hydro_certified(
    const hydro_loop_filter *filter, hydro_real k_p, hydro_real c_1, hydro_real c_2, hydro_real *gain)
{
    *gain = k_p / c_2;
    return hydro_abs(c_1 - c_2 * filter->velocity_compensation) <= HYDRO_R(HYDRO_SAME) * c_2
           && *gain >= filter->gain_low && *gain <= filter->gain_high;
}

/* M, n x n by rows, at a certified gain [1/s], between the table's factors by straight lines; else that of all others. */
static inline void hydro_metric(const hydro_loop_filter *filter, hydro_real gain, bool certified, hydro_real *matrix)
{
    int n = filter->loop.coordinates, entries = n * (n + 1) / 2, low = certified ? 0 : filter->rows;
    hydro_real factor[HYDRO_COORDINATES * (HYDRO_COORDINATES + 1) / 2], share = HYDRO_R(0);
    const hydro_real *row;
    if (certified && filter->rows > 1) {
        hydro_real place = (gain - filter->gain_low) / filter->gain_step;
        low = (int)place < filter->rows - 2 ? (int)place : filter->rows - 2;
        share = place - (hydro_real)low;
    }
    row = filter->table + low * entries;
    for (int i = 0; i < entries; i++) {
        factor[i] = row[i];
        if (share > HYDRO_R(0)) {
            factor[i] = (HYDRO_R(1) - share) * factor[i] + share * row[entries + i];
        }
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            hydro_real total = HYDRO_R(0);
            for (int k = 0; k <= j; k++) {
                total += factor[i * (i + 1) / 2 + k] * factor[j * (j + 1) / 2 + k];
            }
            matrix[i * n + j] = matrix[j * n + i] = total;
        }
        matrix[i * n + i] += filter->floor;
    }
}

/* One sample of v, shape (n), its currents beside the law's `known` [A]. */
static inline void hydro_ahead(
    int n, const hydro_linear *linear, const hydro_real *v, hydro_real known, hydro_real *next)
{
    for (int i = 0; i < n; i++) {
        known += linear->feedback[i] * v[i];
    }
    for (int i = 0; i < n; i++) {
        next[i] = linear->push[i] * known;
        for (int j = 0; j < n; j++) {
            next[i] += linear->transition[i * n + j] * v[j];
        }
    }
}

/* M_c T: `v` is first moved to where the correction acts, by the current that is `known`, then on as the law goes. */
static inline hydro_quadratic hydro_certify(
    int n, const hydro_linear *linear, const hydro_real *matrix, const hydro_real *v, hydro_real known,
    hydro_real asked, hydro_real kept)
{
    hydro_real next[HYDRO_COORDINATES], after[HYDRO_COORDINATES];
    hydro_quadratic made = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)};
    hydro_ahead(n, linear, v, known, next);
    hydro_ahead(n, linear, next, asked, after);
    for (int i = 0; i < n; i++) {
        hydro_real now = HYDRO_R(0), then = HYDRO_R(0), moved = HYDRO_R(0);
        for (int j = 0; j < n; j++) {
            now += matrix[i * n + j] * next[j];
            then += matrix[i * n + j] * after[j];
            moved += matrix[i * n + j] * linear->push[j];
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

/* I [N/s] of the force law, of either form, from its current; `gain`: C_2 g [N/s/A]. */
static inline hydro_real hydro_integral_term(const hydro_loop *loop, const hydro_loop_sample *seen, hydro_real *gain)
{
    const hydro_bench *bench = &loop->bench;
    hydro_real position = hydro_clamp(seen->x[6], HYDRO_R(0), bench->stroke), driven;
    *gain = seen->c_2 * hydro_input_gain(bench, position, seen->x[4], seen->x[5], seen->nominal);
    *gain = hydro_max(*gain, loop->gain_floor);
    driven = hydro_before_leap(bench, seen->nominal) * *gain + seen->c_1 * hydro_velocity_term(bench, position, seen->x[7]);
    return driven - seen->followed_rate - seen->k_p * (seen->followed - seen->x[2]);
}

/* What the law asks for on the reference's trajectory, at its velocity [m/s], beyond what that needs [N/s]: there the
 * law gives f_c' + K_p (f_c - f_r) - C_1 h, and the bench needs C_2 (f_r' - h). 0 of the paper's law. */
static inline hydro_real hydro_feedforward_excess(
    const hydro_bench *bench, const hydro_loop_sample *seen, hydro_real velocity)
{
    hydro_real moving = hydro_velocity_term(bench, hydro_clamp(seen->x[6], HYDRO_R(0), bench->stroke), velocity);
    hydro_real given = seen->followed_rate + seen->k_p * (seen->followed - seen->reference) - seen->c_1 * moving;
    return given - seen->c_2 * (seen->reference_rate - moving);
}

/* The part of a current [A] that the overlap takes. */
static inline hydro_real hydro_lost(const hydro_loop_filter *filter, hydro_real current)
{
    return hydro_clamp(current - filter->closing, -filter->back, filter->out);
}

/* How much more passes [A] after a change [A] of a current [A]. */
static inline hydro_real hydro_passed_change(
    const hydro_loop_filter *filter, hydro_real current, hydro_real change)
{
    return change - (hydro_lost(filter, current + change) - hydro_lost(filter, current));
}

/* The smallest change [A] of a current [A] after which `passing` [A] more of it passes. */
static inline hydro_real hydro_change_for(const hydro_loop_filter *filter, hydro_real current, hydro_real passing)
{
    hydro_real lost = hydro_lost(filter, current), opening = current - filter->closing, wanted;
    bool none = !(passing < HYDRO_R(0)) && !(passing > HYDRO_R(0));
    if (none || (filter->back <= HYDRO_R(0) && filter->out <= HYDRO_R(0))) {
        return passing;
    }
    wanted = opening - lost + passing;
    if (wanted > HYDRO_R(0)) {
        return wanted + filter->out - opening;
    }
    return wanted < HYDRO_R(0) ? wanted - filter->back - opening : lost - opening;
}

/* M_c T of a sample, with what noise is taken out. Moves the memory on. */
static inline hydro_quadratic hydro_problem(
    const hydro_loop_filter *filter, hydro_memory_of_loop *memory, const hydro_loop_sample *seen)
{
    const hydro_loop *loop = &filter->loop;
    hydro_real matrix[HYDRO_COORDINATES * HYDRO_COORDINATES], v[HYDRO_COORDINATES], gain, law_gain, share;
    hydro_real term = hydro_integral_term(loop, seen, &law_gain), allowance = filter->integral_allowance;
    hydro_real asked = (term - hydro_clamp(term, -allowance, allowance)) / law_gain;
    hydro_real limit = loop->bench.valve_current_max, applied = hydro_clamp(seen->nominal, -limit, limit), known;
    bool certified = hydro_certified(filter, seen->k_p, seen->c_1, seen->c_2, &gain);
    hydro_linear linear;
    hydro_quadratic made;
    hydro_settle(loop, memory, seen);
    hydro_linearize(loop, memory, seen, &linear);
    hydro_displace(loop, memory, seen, v);
    hydro_follow(loop, memory, seen);
    hydro_metric(filter, gain, certified, matrix);
    if (!certified) {
        hydro_real velocity = seen->x[7] - loop->scale[HYDRO_Q_V] * v[HYDRO_Q_V];
        asked += hydro_feedforward_excess(&loop->bench, seen, velocity) / law_gain;
    }
    known = seen->current - hydro_lost(filter, seen->current) - seen->nominal + asked;
    made = hydro_certify(
        loop->coordinates, &linear, matrix, v, known, asked - hydro_lost(filter, applied),
        certified ? filter->kept : filter->foreign_kept);
    share = hydro_counting(made.size, certified ? filter->noise_size : filter->foreign_noise_size);
    made.slope *= share;
    made.level *= share * share;
    made.applied = applied;
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

/* The change [A] of the valve's current and its status, into `made` with the problem. M_c <= 0 holds within an interval
 * of du, of which the problem has the nearer end as a half-line; its smallest solution is that of the interval. */
static inline hydro_real hydro_smallest(
    const hydro_loop_filter *filter, const hydro_quadratic *p, hydro_decision *made)
{
    hydro_real reach = p->slope * p->slope - p->bent * p->level, root, end, change, moved;
    made->a = made->b = HYDRO_R(0);
    made->restorable = true;
    if (p->level > HYDRO_R(0) && reach >= HYDRO_R(0)) { /* the nearer root, in the form that does not cancel */
        root = HYDRO_SQRT(reach);
        end = -p->level / (p->slope + (p->slope < HYDRO_R(0) ? -root : root));
        made->a = end > HYDRO_R(0) ? HYDRO_R(-1) : HYDRO_R(1);
        made->b = made->a * hydro_change_for(filter, p->applied, end);
    }
    if (p->level <= HYDRO_R(0) || reach >= HYDRO_R(0)) {
        return hydro_closed_form(made->a, made->b, made->low, made->high, &made->status);
    }
    made->restorable = false; /* the best there is */
    change = hydro_clamp(hydro_change_for(filter, p->applied, -p->slope / p->bent), made->low, made->high);
    moved = hydro_passed_change(filter, p->applied, change);
    if (-(p->bent * moved + HYDRO_R(2) * p->slope) * moved < HYDRO_R(HYDRO_LEAST_IMPROVEMENT) * p->level) {
        made->status = HYDRO_INFEASIBLE;
        return HYDRO_R(0);
    }
    made->status = HYDRO_RELAXED;
    return change;
}

/* Whether a chamber has half of its dead volume [m3] at least, `position` [m] from its end. */
static inline bool hydro_has_room(hydro_real area, hydro_real dead, hydro_real position)
{
    return area * position > HYDRO_R(-0.5) * dead;
}

/* Whether a sample can be one of a bench, far beyond what its sensors show: within this nothing overflows. */
static inline bool hydro_believable(const hydro_loop_filter *filter, const hydro_loop_sample *seen)
{
    const hydro_loop *loop = &filter->loop;
    const hydro_bench *bench = &loop->bench;
    const hydro_loop_sample *most = &filter->most;
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        if (!hydro_within(seen->x[i], most->x[i])) {
            return false;
        }
    }
    return hydro_within(seen->nominal, most->nominal) && hydro_within(seen->current, most->current)
           && hydro_within(seen->reference, most->reference) && hydro_within(seen->k_p, most->k_p)
           && hydro_within(seen->reference_rate, most->reference_rate)
           && hydro_within(seen->followed, most->followed) && hydro_within(seen->followed_rate, most->followed_rate)
           && hydro_within(seen->c_1, HYDRO_R(HYDRO_SCALES)) && hydro_within(seen->c_2, HYDRO_R(HYDRO_SCALES))
           && seen->c_2 >= HYDRO_R(1 / HYDRO_SCALES)
           && hydro_has_room(bench->piston_area, bench->dead_volume_a, seen->x[6])
           && hydro_has_room(bench->area_ratio * bench->piston_area, bench->dead_volume_b, bench->stroke - seen->x[6])
           && hydro_has_room(loop->area, loop->dead_a, seen->x[6])
           && hydro_has_room(loop->ratio * loop->area, loop->dead_b, loop->stroke - seen->x[6]);
}

/* Decide about one sample; a disarmed one, which gets no correction, too, moves the memory on. */
static inline hydro_decision hydro_decide_loop(
    const hydro_loop_filter *filter, hydro_memory_of_loop *memory, const hydro_loop_sample *seen)
{
    static const hydro_memory_of_loop fresh = {.running = false};
    hydro_decision made = {.status = HYDRO_NAN, .restorable = false};
    hydro_real limit = filter->loop.bench.valve_current_max, change, moved;
    hydro_quadratic p;
    if (!hydro_believable(filter, seen)) {
        *memory = fresh;
        return made;
    }
    p = hydro_problem(filter, memory, seen);
    if (!hydro_finite(p.level) || !hydro_finite(p.slope) || !hydro_finite(p.bent)) {
        made.status = seen->armed ? HYDRO_NAN : HYDRO_PASS;
        return made;
    }
    made.low = -limit - p.applied;
    made.high = limit - p.applied;
    change = hydro_smallest(filter, &p, &made);
    if (!seen->armed) {
        change = HYDRO_R(0);
        made.status = HYDRO_PASS;
    }
    moved = hydro_passed_change(filter, p.applied, change);
    made.before = p.level / HYDRO_R(HYDRO_PERIOD);
    made.after = (p.bent * moved * moved + HYDRO_R(2) * p.slope * moved + p.level) / HYDRO_R(HYDRO_PERIOD);
    if (change < HYDRO_R(0) || change > HYDRO_R(0)) {
        made.delta_u = change + (p.applied - seen->nominal);
    }
    return made;
}

#endif
