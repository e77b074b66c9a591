# SPDX-License-Identifier: Apache-2.0
"""The force law's gradient K against central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.model.force_law import gradient
from hydro_sim.box import force_law
from hydro_sim.box.box import BoxConfig
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench

CURRENTS = (-0.04, -0.004, 0.003, 0.05)
SCALE = np.array([300.0, 3770.0, 300.0, 3770.0, 1.5e6, 1.5e6, 0.015, 0.19])
"""Of f_h f_h' f_l f_l' p_a p_b x_p x_p': what each moves by."""


def differences(f: Callable[[FloatArray], FloatArray], at: FloatArray, scale: FloatArray) -> FloatArray:
    """df/dx by central differences of fourth order."""
    columns = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-4 * scale[i]
        near, far = f(at + step) - f(at - step), f(at + 2 * step) - f(at - 2 * step)
        columns.append((8.0 * near - far) / (12.0 * step[i]))
    return np.stack(columns, axis=-1)


class Law:
    """The force law at a state whose nominal current is the wanted one, thanks to the reference's rate."""

    error, integral, gain = 110.0, 12.0, -35.0

    def __init__(self, bench: Bench, gain_floor: float, state: FloatArray, current: float) -> None:
        self.constants, self.gain_floor, self.reference = bench.constants()[0], gain_floor, state[2] + self.error
        h = hydraulics.velocity_term(self.constants, state[6], state[7])
        g = hydraulics.input_gain(self.constants, state[6], state[4], state[5], current)
        driven = max(g, gain_floor) * current
        self.reference_rate = driven + h - self.gain * self.error - self.integral

    def __call__(self, state: FloatArray) -> FloatArray:
        error = self.reference - state[2]
        memory = (error, self.integral, self.reference_rate, self.gain, self.gain_floor)
        return np.array(force_law.nominal_current(self.constants, state, *memory))


@pytest.mark.parametrize("current", CURRENTS)
@pytest.mark.parametrize("share", [0.1, 1.0])
def test_force_law_gradient_is_its_derivative(bench: Bench, states: FloatArray, current: float, share: float) -> None:
    """Where the law believes g, and (share 1) where g lies below what it believes."""
    gain_floor = float(BoxConfig(gain_floor_share=share).constants(bench)["gain_floor"][0])
    floored, exact = 0, np.empty(8)
    for state in states:
        law = Law(bench, gain_floor, state, current)
        assert law(state) == pytest.approx(current, rel=1e-9)
        g = hydraulics.input_gain(law.constants, state[6], state[4], state[5], current)
        if abs(g / gain_floor - 1.0) < 0.01:
            continue  # a kink lies within the difference's reach
        floored += g < gain_floor
        gradient(bench.constants(), state, current, law.gain, gain_floor, exact)
        numeric = differences(law, state, SCALE) * SCALE
        np.testing.assert_allclose(exact * SCALE, numeric, rtol=1e-7, atol=1e-9)
    assert (floored > 20) == (share == 1.0)
