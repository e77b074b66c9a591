/* SPDX-License-Identifier: Apache-2.0 */
/* The filter's first and last steps by numbers: which samples are believed, what counts of noise, what M_c is, and the
 * smallest change that it asks for, across an overlap too. Ends with 0, or names the check that fails.
 */
#include "check.h"

#include "../hydro/loop_filter.h"

static uint32_t status;
static hydro_loop_filter filter; /* without an overlap, and with a table of no rows */

static hydro_real smallest(double bent, double slope, double level)
{
    const hydro_quadratic problem = {HYDRO_R(bent), HYDRO_R(slope), HYDRO_R(level), HYDRO_R(0), HYDRO_R(0)};
    hydro_decision made = {.low = HYDRO_R(-0.5), .high = HYDRO_R(0.75)};
    hydro_real change = hydro_smallest(&filter, &problem, &made);
    status = made.status;
    return change;
}

static uint32_t seed = 1;

/* A number from -size to size. */
static hydro_real drawn(double size)
{
    seed = seed * 1664525u + 1013904223u;
    return HYDRO_R(size * ((double)(seed >> 8) / 8388608.0 - 1.0));
}

static bool near(hydro_real found, double wanted)
{
    return hydro_abs(found - HYDRO_R(wanted)) < HYDRO_R(1e-6);
}

static void test_what_can_be_restored(void)
{
    CHECK(smallest(1, -5, 0) == 0 && status == HYDRO_PASS);
    CHECK(smallest(1, -5, -1) == 0 && status == HYDRO_PASS);
    CHECK(near(smallest(4, -2, 0.75), 0.25) && status == HYDRO_MODIFIED); /* roots 0.25 and 0.75 */
    CHECK(near(smallest(4, 2, 0.75), -0.25) && status == HYDRO_MODIFIED);
    CHECK(smallest(4, -2, 1) == HYDRO_R(0.5) && status == HYDRO_MODIFIED); /* both roots are one */
    CHECK(smallest(1, -4, 15) == HYDRO_R(0.75) && status == HYDRO_RELAXED); /* roots 3 and 5, beyond the valve */
    CHECK(smallest(1, 4, 15) == HYDRO_R(-0.5) && status == HYDRO_RELAXED);
}

static void test_what_cannot(void)
{
    CHECK(smallest(4, -1, 1) == HYDRO_R(0.25) && status == HYDRO_RELAXED); /* no root: the lowest point */
    CHECK(smallest(4, 1, 1) == HYDRO_R(-0.25) && status == HYDRO_RELAXED);
    CHECK(smallest(1, -2, 5) == HYDRO_R(0.75) && status == HYDRO_RELAXED); /* which lies beyond the valve */
    CHECK(smallest(1, 0, 1) == 0 && status == HYDRO_INFEASIBLE);
    CHECK(smallest(10, -1, 10.5) == 0 && status == HYDRO_INFEASIBLE); /* takes 0.1 of 10.5 away: too little */
#ifndef HYDRO_SINGLE
    CHECK(near(smallest(10, -1, 10), 0.1) && status == HYDRO_RELAXED); /* just enough */
#endif
}

static void test_what_counts_of_noise(void)
{
    CHECK(hydro_counting(HYDRO_R(0.5), 1) == 0 && hydro_counting(1, 1) == 0);
    CHECK(hydro_counting(HYDRO_R(1.5), 1) == HYDRO_R(0.5) && near(hydro_counting(HYDRO_R(1.25), 1), 0.15625));
    CHECK(hydro_counting(2, 1) == 1 && hydro_counting(50, 1) == 1 && hydro_counting(1, 0) == 1);
    CHECK(hydro_counting(0, 0) == 0);
}

/* What moves v twice, by a sample each, in plain sums. */
static void test_the_quadratic_is_two_samples_moved_on(void)
{
    enum { N = HYDRO_LOOP };
    for (int turn = 0; turn < 20; turn++) {
        hydro_linear linear;
        hydro_real root[N][N], matrix[N * N], v[N], moved[N], last[N], known = drawn(1), asked = drawn(1);
        hydro_real kept = HYDRO_R(0.9), change = drawn(2), wanted = 0, size = 0, drive = known;
        hydro_quadratic p;
        for (int i = 0; i < N; i++) {
            linear.push[i] = drawn(1);
            linear.feedback[i] = drawn(1);
            v[i] = drawn(1);
            for (int j = 0; j < N; j++) {
                linear.transition[i * N + j] = drawn(1);
                root[i][j] = drawn(1);
            }
        }
        for (int i = 0; i < N * N; i++) {
            matrix[i] = 0;
            for (int k = 0; k < N; k++) {
                matrix[i] += root[i / N][k] * root[i % N][k];
            }
        }
        p = hydro_certify(N, &linear, matrix, v, known, asked, kept);
        for (int i = 0; i < N; i++) {
            drive += linear.feedback[i] * v[i];
        }
        for (int i = 0; i < N; i++) {
            moved[i] = linear.push[i] * drive;
            for (int j = 0; j < N; j++) {
                moved[i] += linear.transition[i * N + j] * v[j];
            }
        }
        drive = asked + change;
        for (int i = 0; i < N; i++) {
            drive += linear.feedback[i] * moved[i];
        }
        for (int i = 0; i < N; i++) {
            last[i] = linear.push[i] * drive;
            for (int j = 0; j < N; j++) {
                last[i] += linear.transition[i * N + j] * moved[j];
            }
        }
        for (int i = 0; i < N * N; i++) {
            wanted += matrix[i] * last[i / N] * last[i % N];
            size += matrix[i] * moved[i / N] * moved[i % N];
        }
        wanted -= kept * size;
        CHECK(hydro_abs(p.size - size) < HYDRO_R(1e-4) * size);
        CHECK(hydro_abs(p.bent * change * change + 2 * p.slope * change + p.level - wanted) < HYDRO_R(1e-4) * size);
    }
}

static void test_the_change_is_the_smallest_after_which_that_much_more_passes(void)
{
    for (int turn = 0; turn < 2000; turn++) {
        hydro_real current = drawn(3), passing = drawn(2), change;
        filter.closing = drawn(1);
        filter.back = hydro_abs(drawn(1));
        filter.out = hydro_abs(drawn(1));
        change = hydro_change_for(&filter, current, passing);
        CHECK(near(hydro_passed_change(&filter, current, change), (double)passing));
        CHECK(hydro_abs(hydro_passed_change(&filter, current, HYDRO_R(0.99) * change)) < hydro_abs(passing));
        CHECK(change * passing > 0);
        CHECK(hydro_change_for(&filter, current, 0) == 0);
    }
    filter.closing = filter.back = filter.out = 0;
}

/* Against a search over all changes, the law's current within, at the edge of and beyond an overlap. */
static void test_the_correction_is_the_smallest_across_an_overlap(void)
{
    int leaps = 0;
    filter.back = HYDRO_R(0.125);
    filter.out = HYDRO_R(0.25);
    for (int turn = 0; turn < 300; turn++) {
        hydro_real slope = drawn(2), level = HYDRO_R(0.9) * slope * slope * hydro_abs(drawn(1)), nearest = 9, change;
        hydro_quadratic p = {HYDRO_R(1), slope, level, HYDRO_R(0), drawn(0.5)};
        hydro_decision made = {.low = -1 - p.applied, .high = 1 - p.applied};
        change = hydro_smallest(&filter, &p, &made);
        for (int k = -3000; k <= 3000; k++) {
            hydro_real one = HYDRO_R(k) / 2000, moved = hydro_passed_change(&filter, p.applied, one);
            bool holds = moved * moved + 2 * slope * moved + level <= 0;
            if (holds && one >= made.low && one <= made.high && hydro_abs(one) < hydro_abs(nearest)) {
                nearest = one;
            }
        }
        CHECK(nearest == 9 || made.status == HYDRO_MODIFIED || made.status == HYDRO_PASS);
        if (made.status == HYDRO_MODIFIED) {
            CHECK(hydro_abs(hydro_abs(change) - hydro_abs(nearest)) < HYDRO_R(1e-3));
            leaps += hydro_abs(change) > HYDRO_R(0.375);
        }
    }
    CHECK(leaps > 20);
    filter.back = filter.out = 0;
}

static void test_gains_are_certified_by_the_loop_that_they_make(void)
{
    hydro_real gain;
    filter.velocity_compensation = HYDRO_R(0.3);
    filter.gain_low = 10;
    filter.gain_high = 210;
    CHECK(hydro_certified(&filter, 200, HYDRO_R(0.3), 1, &gain) && gain == 200);
    CHECK(hydro_certified(&filter, 200, HYDRO_R(0.6), 2, &gain) && gain == 100); /* C_2 = 2 halves K_p and C_1 */
    CHECK(!hydro_certified(&filter, 200, HYDRO_R(0.31), 1, &gain));
    CHECK(!hydro_certified(&filter, 220, HYDRO_R(0.3), 1, &gain) && !hydro_certified(&filter, 9, HYDRO_R(0.3), 1, &gain));
}

static void test_on_the_trajectory_of_the_reference_the_papers_law_asks_for_nothing_else(void)
{
    hydro_loop_sample seen = {.reference = 120, .reference_rate = 900, .k_p = 90, .followed = 120,
                              .followed_rate = 900, .c_1 = 1, .c_2 = 1};
    const hydro_real velocity = HYDRO_R(0.07);
    hydro_real moving, excess;
    seen.x[6] = HYDRO_R(0.04);
    CHECK(hydro_feedforward_excess(&CONFIG.bench, &seen, velocity) == 0);
    seen.c_1 = 0;
    moving = hydro_feedforward_excess(&CONFIG.bench, &seen, velocity);
    CHECK(moving < -1e4); /* a piston that moves out lowers f_h */
    seen.c_1 = HYDRO_R(0.3);
    seen.followed = 121;
    seen.followed_rate = 950;
    excess = hydro_feedforward_excess(&CONFIG.bench, &seen, velocity);
    CHECK(hydro_abs(excess - (HYDRO_R(0.7) * moving + 140)) < HYDRO_R(1e-5) * hydro_abs(moving));
}

/* Whether a sample is believed that is quiet but for one column; by a bench with more oil than its model. */
static bool believed(int column, double value)
{
    hydro_loop_sample seen = {.c_1 = 1, .c_2 = 1};
    hydro_loop *loop = &filter.loop;
    loop->bench.piston_area = loop->area = HYDRO_R(2e-3);
    loop->bench.area_ratio = loop->ratio = HYDRO_R(0.5);
    loop->bench.stroke = loop->stroke = HYDRO_R(0.08);
    loop->bench.dead_volume_a = loop->bench.dead_volume_b = HYDRO_R(1);
    loop->dead_a = HYDRO_R(4e-5); /* half of it is 10 mm of the piston */
    loop->dead_b = HYDRO_R(4e-5); /* and 20 mm of the rod's side */
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        filter.most.x[i] = 1;
    }
    filter.most.current = HYDRO_R(0.08);
    filter.most.nominal = filter.most.reference = filter.most.k_p = filter.most.followed = filter.most.followed_rate = 1;
    filter.most.reference_rate = HYDRO_R(1e9);
    seen.x[6] = HYDRO_R(0.04);
    if (column < HYDRO_MEASURED) {
        seen.x[column] = HYDRO_R(value);
    } else if (column == HYDRO_CURRENT) {
        seen.current = HYDRO_R(value);
    } else {
        seen.reference_rate = HYDRO_R(value);
    }
    return hydro_believable(&filter, &seen);
}

static void test_what_is_believed(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        CHECK(believed(HYDRO_CURRENT, sign * 0.079) && !believed(HYDRO_CURRENT, sign * 0.081));
        CHECK(believed(HYDRO_REFERENCE_RATE, sign * 0.9e9) && !believed(HYDRO_REFERENCE_RATE, sign * 1.1e9));
    }
    CHECK(believed(6, -0.0099) && !believed(6, -0.0101));
    CHECK(believed(6, 0.0999) && !believed(6, 0.1001));
}

static void test_a_sample_of_a_box_has_the_law_that_acts(void)
{
    const hydro_law_state acting = {.reference = 3, .reference_rate = 4, .shaping = {0, 0, 0, 0, 0, 5, 6}};
    hydro_real values[HYDRO_STATE_REALS];
    hydro_loop_sample seen;
    for (int i = 0; i < HYDRO_STATE_REALS; i++) {
        values[i] = HYDRO_R(i);
    }
    seen = hydro_loop_sample_of(values, &acting, true);
    CHECK(seen.x[7] == 7 && seen.current == 8 && seen.nominal == 9 && seen.reference == 10);
    CHECK(seen.reference_rate == 11 && seen.k_p == 12 && seen.followed == 3 && seen.followed_rate == 4);
    CHECK(seen.c_1 == 5 && seen.c_2 == 6 && seen.armed);
}

int main(void)
{
    test_what_can_be_restored();
    test_what_cannot();
    test_what_counts_of_noise();
    test_the_quadratic_is_two_samples_moved_on();
    test_the_change_is_the_smallest_after_which_that_much_more_passes();
    test_the_correction_is_the_smallest_across_an_overlap();
    test_gains_are_certified_by_the_loop_that_they_make();
    test_on_the_trajectory_of_the_reference_the_papers_law_asks_for_nothing_else();
    test_what_is_believed();
    test_a_sample_of_a_box_has_the_law_that_acts();
    return 0;
}
