# SPDX-License-Identifier: Apache-2.0
"""Feedback gain K = du/dx of the force law (paper eq. fl_rl), in closed form.

    u = (f_r' + K_p (f_r - f_l) + I - h) / g        g = g(x_p, p_a, p_b), h = h(x_p, x_p')

    du/df_l  = -K_p / g                  du/dx_p  = -(dh/dx_p + u dg/dx_p) / g
    du/dx_p' = -(dh/dx_p') / g           du/dp_a  = -u (dg/dp_a) / g,  the same for p_b

With F(x, u) = h + g u the right side of eq. q13, dh/dx + u dg/dx is dF/dx at held u, so K = -(dF/dx)/g except along
f_l. As in `hydro_sim.box.force_law`, g is no less than a floor (there dg/dx = 0) and the position is one within the
stroke. The integral I, of either form, is the law's own memory and no function of x: K_i has no place in K, and the
certificate does not see it.

K is that of the law before the valve's limit. Beyond the limit the valve passes none of it on: the remaining authority
of the correction is in the QP's bounds (`filter`, `loop_decision`), not in K.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model.analytic_kernels import force_rate_slopes
from hydro_filter.model.sample import Sample
from hydro_filter.model.state import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from hydro_sim.box.box import BoxConfig
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench
from hydro_sim.model.hydraulics import input_gain


class Controller(Protocol):
    """A differentiable feedback law."""

    def gradient(self, sample: Sample) -> FloatArray:
        """Return K = du/dx [A per unit of each state] at a sample, shape (8,)."""


class ForceLaw:
    """The force law with feedback of the load force, as the box runs it on the nominal bench.

    Parameters
    ----------
    bench
        Bench assumed by the box.
    box
        Settings of the box.

    Raises
    ------
    ValueError
        If the box feeds back another force than that of the certificate.
    """

    def __init__(self, bench: Bench, box: BoxConfig | None = None) -> None:
        box = box or BoxConfig()
        if box.feedback != "load":
            raise ValueError(f"the certificate needs feedback of the load force, not {box.feedback!r}")
        self.constants = bench.constants()
        self.gain_floor = float(box.constants(bench)["gain_floor"][0])

    def gradient(self, sample: Sample) -> FloatArray:
        """See `Controller.gradient`."""
        out = np.empty(STATES)
        gradient(self.constants, sample.state, sample.nominal_current, sample.proportional_gain, self.gain_floor, out)
        return out


@njit
def gradient(constants, state, current, proportional_gain, gain_floor, out):
    """Write K, shape (8,), for the law's own current [A] and gain [1/s]; `constants` of shape (1,)."""
    bench = constants[0]
    gain = input_gain(bench, state[POSITION], state[PRESSURE_A], state[PRESSURE_B], current)
    felt = current if gain > gain_floor else 0.0  # at the floor the law does not depend on changes of g
    gain = max(gain, gain_floor)
    by_position, by_velocity, by_a, by_b = force_rate_slopes(bench, state, felt)
    out[:] = 0.0
    out[LOAD_FORCE] = -proportional_gain / gain
    out[PRESSURE_A] = -by_a / gain
    out[PRESSURE_B] = -by_b / gain
    out[POSITION] = -by_position / gain if 0.0 <= state[POSITION] <= bench.stroke else 0.0
    out[VELOCITY] = -by_velocity / gain
