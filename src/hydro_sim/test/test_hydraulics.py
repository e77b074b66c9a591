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

STEP = 5e-5


def run(bench: Bench, y: FloatArray, current: float, seconds: float, step: float = STEP) -> npt.NDArray[np.float64]:
    """Physical states every `step`, the first included."""
    constants = bench.constants()[0]
    states = [y.copy()]
    for _ in range(round(seconds / step)):
        hydraulics.advance(constants, y, current, step, 1)
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


def test_a_closed_valve_holds_the_still_bench(bench: Bench) -> None:
    start = hydraulics.rest_state(bench.constants()[0])
    states = run(bench, start.copy(), 0.0, 0.1)
    np.testing.assert_allclose(states[-1], start, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("current", "pressures"), [(0.01, (16e6, 0.0)), (-0.01, (0.0, 16e6))])
def test_stalled_piston_stands_where_the_spring_balances_the_supply(
    ideal: Bench, current: float, pressures: tuple[float, float]
) -> None:
    stiff = replace(ideal, spring_stiffness=2e5, viscous_friction=2000.0)
    last = run(stiff, hydraulics.rest_state(stiff.constants()[0]), current, 3.0)[-1]
    force = stiff.piston_area * (pressures[0] - stiff.area_ratio * pressures[1])
    np.testing.assert_allclose(last[:2], pressures, atol=1e3)
    assert last[2] == pytest.approx(0.04 + force / 2e5, abs=1e-6)
    assert last[4] == pytest.approx(force, abs=0.5)


@pytest.mark.parametrize("current", [0.004, -0.004])
def test_free_piston_moves_steadily_at_the_closed_form_speed(ideal: Bench, current: float) -> None:
    """Without load p_a = alpha p_b, and the flows that both lands pass at speed v share the supply 1 : alpha^3."""
    free = replace(ideal, viscous_friction=0.0)
    shared = free.supply_pressure / (1.0 + free.area_ratio**3)
    pressure_b = free.area_ratio**2 * shared if current > 0.0 else shared
    pressure_a = free.area_ratio * pressure_b
    drop = free.supply_pressure - pressure_a if current > 0.0 else pressure_a
    speed = free.valve_gain * current * sqrt(drop) / free.piston_area
    y = np.array([pressure_a, pressure_b, free.spring_rest_position, speed, 0.0, 0.0])
    slopes = np.empty(6)
    hydraulics.rates(free.constants()[0], y, current, slopes)
    np.testing.assert_allclose(slopes[:4], [0.0, 0.0, speed, 0.0], atol=1e-3)


def test_oil_that_flows_in_is_displaced_or_compressed(bench: Bench) -> None:
    record = bench.constants()[0]
    states = run(bench, hydraulics.rest_state(record), 2e-3, 0.1, step=1e-5)
    flows = np.array([hydraulics.chamber_flows(record, y[0], y[1], 2e-3) for y in states])
    oil = np.array([equations.volumes(bench, y[2]) for y in states])
    inflow = np.trapezoid(flows, dx=1e-5, axis=0)
    compressed = np.array([np.trapezoid(oil[:, i] / bench.bulk_modulus, states[:, i]) for i in (0, 1)])
    np.testing.assert_allclose(oil[-1] - oil[0] + compressed, inflow, rtol=1e-6)


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


def test_mass_on_oil_rings_at_the_closed_form_frequency(bench: Bench) -> None:
    record = bench.constants()[0]
    start = hydraulics.rest_state(record)
    start[3] = 1e-3
    velocity = run(bench, start, 0.0, 0.2)[:, 3]
    crossings = np.flatnonzero(np.diff(np.signbit(velocity)))
    rung = (len(crossings) - 1) / (2.0 * STEP * (crossings[-1] - crossings[0]))
    stiffness = bench.spring_stiffness - hydraulics.velocity_term(record, 0.04, 1.0)
    damping = bench.viscous_friction / (2.0 * bench.moving_mass)
    expected = sqrt(stiffness / bench.moving_mass - damping**2) / (2.0 * pi)
    assert expected == pytest.approx(90.0, abs=2.0)
    assert rung == pytest.approx(expected, rel=5e-3)


def test_integration_is_of_fourth_order(bench: Bench) -> None:
    def end(steps: int) -> FloatArray:
        y = hydraulics.rest_state(bench.constants()[0])
        y[3] = 0.05
        hydraulics.advance(bench.constants()[0], y, 5e-3, 0.02, steps)
        return y

    exact = end(12800)
    errors = [abs((end(steps) - exact) / exact)[2] for steps in (100, 200, 400)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.2)


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


def test_pressures_do_not_fall_below_zero(bench: Bench) -> None:
    y = hydraulics.rest_state(bench.constants()[0])
    y[3] = 3.0
    states = run(bench, y, 0.0, 0.1)
    assert states[:, :2].min() == 0.0
    assert np.all(np.isfinite(states))
