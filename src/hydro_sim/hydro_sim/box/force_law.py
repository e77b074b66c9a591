# SPDX-License-Identifier: Apache-2.0
"""The feedback-linearising force law (paper eq. q24, with the policy's gains eq. fl_rl), and its compensated form.

    u_nom = ( f_c' + K_p e_c + I  -  C_1 h(x_p, x_p') ) / ( C_2 g(x_p, p_a, p_b, sign u) )        e_c = f_c - f
    f_c   = a_0 f_r + a_1 f_r' + a_2 f_r'' + a_3                                                  f_c' with a', too

    PAPER           f_c = f_r, C_1 = C_2 = 1
    COMPENSATED     a follows the measured force (`hydro_policy.compensation`); C_1 is below 1, since full compensation
                    of the velocity is the unstable side where the valve has more gain than believed

The integral has two forms:

    bumpless    I = int K_i e_c dt     the integrator carries a force rate: a new K_i changes its slope, not its value
    paper       I = K_i int e_c dt     the integrator carries int e_c dt: a new K_i is a step of u_nom

Both are the same for a constant K_i (docs/decisions/0031-bumpless-integral.md). On the nominal bench with perfect
sensors e' = -K_p e - I (eq. q25). g is positive, so u has the sign of the numerator and the branch of g needs no
iteration.
"""

from __future__ import annotations

from hydro_bridge.serial.protocol import INTEGRAL_FORMS
from hydro_sim.jit import njit
from hydro_sim.model import hydraulics

BUMPLESS = INTEGRAL_FORMS.index("bumpless")
"""Number of the bumpless form; any other is the paper's."""


@njit
def nominal_current(
    bench, measurement, error, integral_action, reference_rate, proportional_gain, gain_floor,
    velocity_compensation=1.0, valve_gain_scale=1.0,
):  # fmt: skip
    """u_nom [A] before correction and saturation.

    Parameters
    ----------
    bench
        Record of `BENCH_DTYPE`: what the box believes.
    measurement
        x, shape (8,), finite.
    error
        e_c = f_c - feedback [N].
    integral_action
        I [N/s] of `integral_action`.
    reference_rate
        f_c' [N/s].
    proportional_gain
        K_p + delta K_p [1/s].
    gain_floor
        Smallest g that is believed [N/s/A], above zero: near a chamber's limits g vanishes and the law would call for
        any current.
    velocity_compensation, valve_gain_scale
        C_1, C_2.
    """
    position = min(max(measurement[6], 0.0), bench.stroke)
    wanted_rate = reference_rate + proportional_gain * error + integral_action
    driven_rate = wanted_rate - velocity_compensation * hydraulics.velocity_term(bench, position, measurement[7])
    gain = valve_gain_scale * hydraulics.input_gain(bench, position, measurement[4], measurement[5], driven_rate)
    return driven_rate / max(gain, gain_floor)


@njit
def integral_action(form, integral, integral_gain):
    """Integral action I [N/s]: the integrator's state or, in the paper's form, K_i [1/s^2] times it [N s]."""
    return integral if form == BUMPLESS else integral_gain * integral


@njit
def integrate(form, integral, error, integral_gain, unlimited_current, current, period):
    """The integrator's state after one period [s], in N/s, or N s in the paper's form.

    It stands still while K_i e would push a saturated current further out; with a negative K_i that is an error of the
    other sign.
    """
    slope = integral_gain * error
    if (unlimited_current - current) * slope > 0.0:
        return integral
    return integral + (slope if form == BUMPLESS else error) * period
