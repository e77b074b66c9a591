/* SPDX-License-Identifier: Apache-2.0 */
/* The filter in the shared library of the box, for node, fleet and training: hydro_filter.model.records. The
 * caller gives all memory. Models are generated for one bench file each and are called by their address. */
#define HYDRO_STATES 128     /* hydro_sim.model.plant.STATES_MAX */
#define HYDRO_COORDINATES 80 /* the eight, two lagging sensors, and the longest dead time that a model has room for */
#include "hydro/loop_filter.h"
#include "hydro/monitor.h"

void hydro_c_filter_sizes(size_t sizes[5])
{
    sizes[0] = sizeof(hydro_loop_filter);
    sizes[1] = sizeof(hydro_memory_of_loop);
    sizes[2] = sizeof(hydro_monitor);
    sizes[3] = sizeof(hydro_loop_sample);
    sizes[4] = sizeof(hydro_decision);
}

/* The decision alone: of benches that are simulated, by this model or by others on purpose. */
void hydro_c_filter_decide(
    const hydro_loop_filter *filter, hydro_memory_of_loop *memory, const hydro_loop_sample *sample,
    hydro_decision *made)
{
    *made = hydro_decide_loop(filter, memory, sample);
}

/* The decision, with the monitor, whose allowances are scaled by `limit`. */
void hydro_c_filter_judge(
    const hydro_loop_filter *filter, double limit, hydro_memory_of_loop *memory, hydro_monitor *monitor,
    const hydro_loop_sample *sample, hydro_decision *made)
{
    if (hydro_believable(filter, sample)) {
        hydro_watch(&filter->loop, limit, monitor, memory, sample->x);
    } else {
        hydro_monitor_skip(monitor);
    }
    *made = hydro_decide_loop(filter, memory, sample);
}

/* Whether K_p [1/s] at C_2 = 1 has a certificate, and M there, n x n. */
int hydro_c_filter_metric(const hydro_loop_filter *filter, double k_p, double c_1, double *matrix)
{
    hydro_real gain;
    bool certified = hydro_certified(filter, k_p, c_1, 1.0, &gain);
    hydro_metric(filter, gain, certified, matrix);
    return certified;
}

/* The law's feedback, F, G, v and what else is known of each of `count` samples that follow one another; of n
 * coordinates and m states of the whole model. Every pointer may be NULL. */
void hydro_c_filter_follow(
    const hydro_loop *loop, hydro_memory_of_loop *memory, size_t count, const hydro_loop_sample *samples,
    const uint8_t *linearized, double *transition, double *push, double *feedback, double *displacement,
    double *states, double *opening, double *integral)
{
    size_t n = (size_t)loop->coordinates, m = (size_t)loop->whole.states, row = 0;
    hydro_linear linear;
    hydro_real gain;
    for (size_t k = 0; k < count; k++) {
        const hydro_loop_sample *sample = &samples[k];
        hydro_settle(loop, memory, sample);
        if (transition != NULL && (linearized == NULL || linearized[k])) { /* rows of those that are */
            hydro_linearize(loop, memory, sample, &linear);
            hydro_copy(transition + n * n * row, linear.transition, n * n * sizeof *transition);
            hydro_copy(push + n * row, linear.push, n * sizeof *push);
            hydro_copy(feedback + n * row, linear.feedback, n * sizeof *feedback);
            row++;
        }
        if (displacement != NULL) {
            hydro_displace(loop, memory, sample, displacement + n * k);
        }
        if (states != NULL) {
            hydro_lift(loop, memory->hidden, sample->x, true, states + m * k);
        }
        if (opening != NULL) { /* A, A/s */
            opening[2 * k] = memory->opening;
            opening[2 * k + 1] = memory->opening_rate;
        }
        if (integral != NULL) {
            integral[k] = hydro_integral_term(loop, sample, &gain);
        }
        hydro_follow(loop, memory, sample);
    }
}

/* The monitor over `count` samples that follow one another, and its sums after each, count x 10; NULL: not wanted. */
void hydro_c_filter_watch(
    const hydro_loop *loop, double limit, hydro_memory_of_loop *memory, hydro_monitor *monitor, size_t count,
    const hydro_loop_sample *samples, double *sums)
{
    for (size_t k = 0; k < count; k++) {
        hydro_watch(loop, limit, monitor, memory, samples[k].x);
        hydro_settle(loop, memory, &samples[k]);
        hydro_follow(loop, memory, &samples[k]);
        if (sums != NULL) {
            hydro_copy(sums + 2 * HYDRO_EQUATIONS * k, monitor->sums, sizeof monitor->sums);
        }
    }
}

/* g, stiffness, f_h' at rest, and both softnesses of the loop's model at a state. */
void hydro_c_filter_sensitivity(const hydro_loop *loop, const double *state, double opening, double made[5])
{
    hydro_sensitivity at = hydro_sensitivity_at(loop, state, opening);
    const double numbers[5] = {at.gain, at.stiffness, at.still, at.soft_a, at.soft_b};
    hydro_copy(made, numbers, sizeof numbers);
}

/* du/dx of the force law, 8 numbers, at its own current. */
void hydro_c_filter_gradient(const hydro_loop *loop, const hydro_loop_sample *sample, double *made)
{
    hydro_law_gradient(loop, sample, sample->nominal, made);
}

/* Smallest |du| with a du <= b, low <= du <= high, and its status. */
double hydro_c_closed_form(double a, double b, double low, double high, uint32_t *status)
{
    if (!hydro_finite(a) || !hydro_finite(b) || !hydro_finite(low) || !hydro_finite(high) || low > 0.0 || high < 0.0) {
        *status = HYDRO_NAN;
        return 0.0;
    }
    return hydro_closed_form(a, b, low, high, status);
}
