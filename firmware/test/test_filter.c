/* SPDX-License-Identifier: Apache-2.0 */
/* The default filter's last step by numbers: the smallest change that a quadratic asks for, and what counts of noise.
 * Ends with 0, or names the check that fails.
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
}

int main(void)
{
    test_what_can_be_restored();
    test_what_cannot();
    test_what_counts_of_noise();
    return 0;
}
