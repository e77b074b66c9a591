/* SPDX-License-Identifier: Apache-2.0 */
/* What a box is configured by: limits, times, and the bench that its force law believes. SI units.
 *
 * `ros2 run hydro_sim export --box box_config.h --bench bench.yaml` writes one as `static const hydro_config`.
 */
#ifndef HYDRO_CONFIG_H
#define HYDRO_CONFIG_H

#include "number.h"

#define HYDRO_CORRECTION_HOLD 3.5e-3 /* s for which a command's correction acts: it was decided for one sample */
#define HYDRO_PERIOD 1e-3 /* s between two samples */
#define HYDRO_MEASURED 8  /* f_h f_h' f_l f_l' p_a p_b x_p x_p' */

typedef struct {
    hydro_real bulk_modulus, piston_area, area_ratio, stroke, supply_pressure, tank_pressure; /* Pa m2 - m Pa Pa */
    hydro_real dead_volume_a, dead_volume_b;                                                  /* m3 */
    hydro_real valve_gain;        /* K_v, m3/s/A/sqrt(Pa) */
    hydro_real valve_current_max; /* A */
    /* A, current that closes the valve, half widths of its overlap below and above; 0: none is leapt over */
    hydro_real closing, overlap_back, overlap_out;
} hydro_bench;

/* A force law: gains, and its shaping a_0 [-], a_1 [s], a_2 [s^2], a_3 [N], a_4 [s^3], C_1, C_2 with limits and fastest
 * changes. Without commands it returns to its base gains and to `safe`, where f_c = f_r.
 */
#define HYDRO_SHAPING 7
#define HYDRO_COEFFICIENTS 5 /* a_0 to a_4, before C_1 and C_2 */

enum { HYDRO_PAPER = 0, HYDRO_COMPENSATED = 1 };

typedef struct {
    hydro_real base_kp, base_ki;                                       /* 1/s, 1/s^2 */
    hydro_real delta_kp_min, delta_kp_max, delta_ki_min, delta_ki_max; /* 1/s, 1/s^2 */
    hydro_real reference_max;                                          /* N, at which f_c is cut off */
    hydro_real safe[HYDRO_SHAPING], low[HYDRO_SHAPING], high[HYDRO_SHAPING], rate[HYDRO_SHAPING]; /* rate: per s */
} hydro_law;

typedef struct {
    hydro_bench bench;
    hydro_law laws[2];                                                      /* HYDRO_PAPER, HYDRO_COMPENSATED */
    hydro_real delta_u_max;                                                 /* A */
    hydro_real load_force_limit;                                            /* N */
    hydro_real gain_floor;                                                  /* N/s/A, smallest g believed */
    hydro_real force_range;                                                 /* N, of the force that is followed */
    hydro_real recovery_margin; /* N that a load force which began beyond its limit may rise at first */
    hydro_real low[HYDRO_MEASURED], high[HYDRO_MEASURED];                   /* what each measured value can be */
    hydro_real force_rate_age, velocity_age;                                /* s, lag of the rates */
    hydro_time hold_timeout, trip_timeout;                                  /* s */
    uint32_t feedback;      /* 2 load force, 0 hydraulic force: index into the measurement */
    uint32_t integral_form; /* 1 paper, 2 bumpless */
    uint8_t name[32];       /* UTF-8, filled with zeros */
    uint8_t digest[12];     /* of the bench file, hexadecimal digits; zeros: not told */
} hydro_config;

#endif
