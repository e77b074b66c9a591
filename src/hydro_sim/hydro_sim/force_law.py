# SPDX-License-Identifier: Apache-2.0
"""The feedback-linearising force law (paper eq. q24, with the policy's gains eq. fl_rl).

    u_nom = ( f_r' + K_p e + K_i int e dt  -  h(x_p, x_p') ) / g(x_p, p_a, p_b, sign u)

On the nominal bench with perfect sensors e' = -K_p e - K_i int e dt (eq. q25). g is positive, so u has the sign of the
numerator and the branch of g needs no iteration.
"""

from __future__ import annotations

from numba import njit

from hydro_sim import hydraulics


@njit(cache=True)
def nominal_current(bench, measurement, error, integral, reference_rate, proportional_gain, integral_gain, gain_floor):
    """u_nom [A] before correction and saturation.

    Parameters
    ----------
    bench
        Record of `BENCH_DTYPE`: what the box believes.
    measurement
        x, shape (8,), finite.
    error, integral
        e = f_r - feedback [N], and its integral [N s].
    reference_rate
        f_r' [N/s].
    proportional_gain, integral_gain
        K_p + delta K_p [1/s], K_i + delta K_i [1/s^2].
    gain_floor
        Smallest g that is believed [N/s/A], above zero: near a chamber's limits g vanishes and the law would call for
        any current.
    """
    position = min(max(measurement[6], 0.0), bench.stroke)
    wanted_rate = reference_rate + proportional_gain * error + integral_gain * integral
    driven_rate = wanted_rate - hydraulics.velocity_term(bench, position, measurement[7])
    gain = hydraulics.input_gain(bench, position, measurement[4], measurement[5], driven_rate)
    return driven_rate / max(gain, gain_floor)


@njit(cache=True)
def integrate(integral, error, integral_gain, unlimited_current, current, period):
    """The integral [N s] after one period [s]; it stands still while it would push a saturated current further out."""
    excess = unlimited_current - current
    if excess * integral_gain * error > 0.0:
        return integral
    return integral + error * period
