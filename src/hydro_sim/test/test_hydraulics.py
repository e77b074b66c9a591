# SPDX-License-Identifier: Apache-2.0
"""The equations against closed forms, conservation laws and a second derivation."""

from __future__ import annotations

from dataclasses import replace
from math import copysign, exp, log, pi, sqrt

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.signals import FloatArray
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import Bench
from tests import textbook

STEP = 5e-5


def run(bench: Bench, y: FloatArray, current: float, seconds: float, step: float = STEP) -> npt.NDArray[np.float64]:
    """Physical states every `step`, the first included."""
    constants = bench.constants()[0]
    states = [y.copy()]
    for _ in range(round(seconds / step)):
        textbook.advance(constants, y, current, step, 1)
        states.append(y.copy())
    return np.array(states)


@given(
    pressures=st.tuples(*[st.floats(0.0, 16e6)] * 2),
    position=st.floats(0.0, 0.08),
    velocity=st.floats(-1.0, 1.0),
    current=st.floats(-0.05, 0.05),
)
@settings(max_examples=200, deadline=None)
def test_force_rate_from_the_two_pressure_equations_is_the_papers_h_plus_g_u(
    pressures: tuple[float, float], position: float, velocity: float, current: float
) -> None:
    """The erratum: eq. q14, and eq. q15 with a plus, follow from the two mass balances."""
    bench = Bench.nominal()
    flow_a, flow_b = (bench.valve_gain * copysign(sqrt(abs(drop)), drop) for drop in (
        (bench.supply_pressure - pressures[0], pressures[1]) if current >= 0.0
        else (pressures[0], bench.supply_pressure - pressures[1])))  # fmt: skip
    volume_a = bench.dead_volume_a + bench.piston_area * position
    volume_b = bench.dead_volume_b + bench.area_ratio * bench.piston_area * (bench.stroke - position)
    record = bench.constants()[0]
    rate_a, rate_b = hydraulics.pressure_rates(record, *pressures, position, velocity, current)
    derived = bench.piston_area * rate_a - bench.area_ratio * bench.piston_area * rate_b
    h = hydraulics.velocity_term(record, position, velocity)
    g = hydraulics.input_gain(record, position, *pressures, current)
    assert h + g * current == pytest.approx(derived, rel=1e-9, abs=1e-3)
    stiffness = bench.bulk_modulus * bench.piston_area**2 * (1.0 / volume_a + bench.area_ratio**2 / volume_b)
    assert h == pytest.approx(-stiffness * velocity, rel=1e-9)
    flows = flow_a / volume_a + bench.area_ratio * flow_b / volume_b
    assert g == pytest.approx(bench.bulk_modulus * bench.piston_area * flows, rel=1e-9, abs=1e-3)


def test_energy_is_conserved_with_a_closed_valve_and_no_friction(bench: Bench) -> None:
    """p' = -beta V'/V gives p = p_0 - beta ln(V/V_0): what the oil stores is in closed form."""
    free = replace(bench, viscous_friction=0.0)
    record = free.constants()[0]
    start = hydraulics.rest_state(record)
    start[3] = 0.2
    initial = equations.volumes(bench, start[2])

    def energy(y: FloatArray) -> float:
        pressed = y[2] - free.spring_rest_position
        stored = 0.5 * free.moving_mass * y[3] ** 2 + 0.5 * free.spring_stiffness * pressed**2
        for volume, first, pressure in zip(equations.volumes(bench, y[2]), initial, start[:2], strict=True):
            stored -= pressure * (volume - first) - free.bulk_modulus * (volume * log(volume / first) - volume + first)
        return float(stored)

    states = run(free, start.copy(), 0.0, 0.2)
    assert np.ptp(states[:, 2]) > 1e-4
    np.testing.assert_allclose([energy(y) for y in states], energy(start), rtol=1e-5)


def test_load_cell_amplifier_answers_a_step_as_a_butterworth_filter(bench: Bench) -> None:
    record = bench.constants()[0]
    y = hydraulics.rest_state(record)
    y[2] += 0.005
    y[0] += 100.0 / bench.piston_area
    shown = run(bench, y, 0.0, 0.08)[:, 4]
    assert bench.load_cell_bandwidth is not None
    decay = 2.0 * pi * bench.load_cell_bandwidth * sqrt(0.5)
    times = STEP * np.arange(len(shown))
    expected = 100.0 * (1.0 - np.exp(-decay * times) * (np.cos(decay * times) + np.sin(decay * times)))
    np.testing.assert_allclose(shown, expected, atol=1e-4)
    assert exp(-decay * 0.08) < 1e-3


@pytest.mark.parametrize(("current", "end"), [(0.05, 0.08), (-0.05, 0.0)])
def test_end_stop_catches_the_piston_without_a_bounce(bench: Bench, current: float, end: float) -> None:
    free = replace(bench, spring_stiffness=1.0)
    position = run(free, hydraulics.rest_state(free.constants()[0]), current, 1.0)[:, 2]
    arrival = int(np.argmax((position - 0.04) / (end - 0.04) >= 1.0))
    assert arrival > 0
    assert np.all(np.abs(position[arrival:] - end) < 1e-3)
