# SPDX-License-Identifier: Apache-2.0
"""A, B and K against central differences, and the dynamics against the simulation's equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.model import analytic_kernels
from hydro_filter.model.dynamics import AnalyticDynamics
from hydro_filter.model.force_law import ForceLaw
from hydro_filter.model.sample import Sample
from hydro_filter.model.state import STATES, state_scale
from hydro_sim.box import force_law
from hydro_sim.box.box import BoxConfig
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import Bench

CURRENTS = (-0.04, -0.004, 0.003, 0.05)


def differences(f: Callable[[FloatArray], FloatArray], at: FloatArray, scale: FloatArray) -> FloatArray:
    """df/dx by central differences of fourth order."""
    columns = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-4 * scale[i]
        near, far = f(at + step) - f(at - step), f(at + 2 * step) - f(at - 2 * step)
        columns.append((8.0 * near - far) / (12.0 * step[i]))
    return np.stack(columns, axis=-1)


def input_differences(bench: Bench, state: FloatArray, current: float) -> FloatArray:
    return differences(lambda u: rate(bench, state, u[0]), np.array([current]), np.array([1.0]))[:, 0]


def state_differences(bench: Bench, state: FloatArray, current: float) -> FloatArray:
    return differences(lambda x: rate(bench, x, current), state, state_scale(bench))


def rate(bench: Bench, state: FloatArray, current: float) -> FloatArray:
    out = np.empty(STATES)
    analytic_kernels.state_rate(bench.constants(), state, current, out)
    return out


@pytest.mark.parametrize("current", CURRENTS)
def test_state_matrix_is_the_derivative_of_the_dynamics(bench: Bench, states: FloatArray, current: float) -> None:
    scale = state_scale(bench)
    for state in states:
        exact = AnalyticDynamics(bench).linearize(state, current).state_matrix
        numeric = state_differences(bench, state, current)
        normalized = (exact - numeric) * scale / scale[:, np.newaxis]
        assert np.abs(normalized).max() <= 1e-8 * np.abs(exact * scale / scale[:, np.newaxis]).max()


@pytest.mark.parametrize("current", CURRENTS)
def test_input_vector_is_the_derivative_of_the_dynamics(bench: Bench, states: FloatArray, current: float) -> None:
    for state in states:
        exact = AnalyticDynamics(bench).linearize(state, current).input_vector
        numeric = input_differences(bench, state, current)
        np.testing.assert_allclose(exact / state_scale(bench), numeric / state_scale(bench), rtol=1e-8, atol=1e-6)


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
    exact_law = ForceLaw(bench, BoxConfig(gain_floor_share=share))
    floored = 0
    for state in states:
        law = Law(bench, exact_law.gain_floor, state, current)
        assert law(state) == pytest.approx(current, rel=1e-9)
        g = hydraulics.input_gain(law.constants, state[6], state[4], state[5], current)
        if abs(g / exact_law.gain_floor - 1.0) < 0.01:
            continue  # a kink lies within the difference's reach
        floored += g < exact_law.gain_floor
        sample = Sample(state, current, law.reference, law.gain)
        exact = exact_law.gradient(sample) * state_scale(bench)
        numeric = differences(law, state, state_scale(bench)) * state_scale(bench)
        np.testing.assert_allclose(exact, numeric, rtol=1e-7, atol=1e-9)
    assert (floored > 20) == (share == 1.0)


@pytest.mark.parametrize("current", CURRENTS)
def test_dynamics_agree_with_the_simulated_plant(bench: Bench, states: FloatArray, current: float) -> None:
    """On consistent states the eight rows are the time derivatives of what the simulation integrates."""
    constants = bench.constants()[0]

    def measured(y: FloatArray) -> FloatArray:
        force, load = equations.hydraulic_force(bench, y[0], y[1]), equations.spring_force(bench, y[2])
        h = hydraulics.velocity_term(constants, y[2], y[3])
        force_rate = h + hydraulics.input_gain(constants, y[2], y[0], y[1], current) * current
        return np.array([force, force_rate, load, bench.spring_stiffness * y[3], *y[:4]])

    for state in states:
        physical = np.array([*state[4:8], 0.0, 0.0])
        flow = np.empty(hydraulics.STATES)
        hydraulics.rates(constants, physical, current, flow)
        step = 1e-7  # s, along the flow
        numeric = (measured(physical + step * flow) - measured(physical - step * flow)) / (2.0 * step)
        scale = state_scale(bench)
        error = (rate(bench, measured(physical), current) - numeric) / scale
        assert np.abs(error).max() <= 1e-5 * np.abs(numeric / scale).max()
