/* SPDX-License-Identifier: Apache-2.0 */
/* The default filter's first and last step by numbers: which samples are believed, what counts of noise, and the
 * smallest change that a quadratic asks for. Ends with 0, or names the check that fails.
 */
#include "check.h"

#include "../hydro/loop_filter.h"

static uint32_t status;

static hydro_real smallest(double bent, double slope, double level)
{
    const hydro_quadratic problem = {HYDRO_R(bent), HYDRO_R(slope), HYDRO_R(level), HYDRO_R(0)};
    return hydro_smallest(&problem, HYDRO_R(-0.5), HYDRO_R(0.75), &status);
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

/* Whether a sample is believed that is quiet but for one column; by a bench with more oil than its model. */
static bool believed(int column, double value)
{
    hydro_loop loop = {0};
    hydro_real values[HYDRO_STATE_REALS] = {0};
    loop.bench.valve_current_max = HYDRO_R(0.04);
    loop.bench.piston_area = loop.area = HYDRO_R(2e-3);
    loop.bench.area_ratio = loop.ratio = HYDRO_R(0.5);
    loop.bench.stroke = loop.stroke = HYDRO_R(0.08);
    loop.bench.dead_volume_a = loop.bench.dead_volume_b = HYDRO_R(1);
    loop.dead_a = HYDRO_R(4e-5); /* half of it is 10 mm of the piston */
    loop.dead_b = HYDRO_R(4e-5); /* and 20 mm of the rod's side */
    values[6] = HYDRO_R(0.04);
    values[column] = HYDRO_R(value);
    return hydro_believable(&loop, values);
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

int main(void)
{
    test_what_can_be_restored();
    test_what_cannot();
    test_what_counts_of_noise();
    test_what_is_believed();
    return 0;
}
