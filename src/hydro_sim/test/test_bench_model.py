# SPDX-License-Identifier: Apache-2.0
"""The bench's model and the force law against closed forms, conservation laws, second derivations and differences."""

from __future__ import annotations

from dataclasses import replace
from math import copysign, log, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from hydro_core.signals import FloatArray, ReferenceSignal, Waveform
from hydro_sim.identification.bench_states import Sensitivities
from hydro_sim.model import equations, hydraulics, sensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Sensors
from hydro_sim.simulation.offline import Schedule, simulate


def oil_stiffness(bench: Bench, position: float) -> float:
    """N/m, of both chambers along the piston."""
    small = bench.area_ratio * bench.piston_area
    volumes = (
        bench.dead_volume_a + bench.piston_area * position,
        bench.dead_volume_b + small * (bench.stroke - position),
    )
    return bench.bulk_modulus * (bench.piston_area**2 / volumes[0] + small**2 / volumes[1])


@pytest.mark.parametrize("frequency", [0.5, 1.0, 1.5, 2.0])
def test_tracking_error_is_what_the_age_of_the_velocity_predicts(bench: Bench, frequency: float) -> None:
    """A velocity that is `age` late leaves h(v) - h(v late) uncancelled; to first order that alone makes the error.

    In the frequency domain, with the load m s^2 + b s + k_s and oil stiffness c: e = f_r - f_l,
    s f_h = s f_r + K_p e + K_i e/s - c s x (1 - exp(-s age)); one more half sample, because the current is held.
    """
    ideal = replace(bench, load_cell_bandwidth=None)
    sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=frequency)
    schedule = Schedule(reference=sine, gains=(90.0, 15.0), seconds=6.0)
    run = simulate(AnalyticPlant(ideal, noise=0.0), ideal, schedule)[-4000:]
    error = run["reference_force"] - run["load_force"]
    s = 2j * np.pi * frequency
    oil = oil_stiffness(ideal, 0.04)
    late = 1.0 - np.exp(-s * 1.5e-3)
    load = (ideal.moving_mass * s**2 + ideal.viscous_friction * s + ideal.spring_stiffness) / ideal.spring_stiffness
    left = s * load + s * oil / ideal.spring_stiffness * late
    response = (left - s) / (left + 90.0 + 15.0 / s)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(300.0 / np.sqrt(2.0) * abs(response), rel=0.05)


@pytest.mark.parametrize("age", [5e-4, 1e-3, 2e-3])
def test_a_velocity_is_as_old_as_its_setting_says(age: float) -> None:
    times, acceleration = 1e-3 * np.arange(400), 3.0
    constants, last, x = Sensors(velocity_age=age).constants(0.0), np.zeros(1, CONDITIONING_DTYPE), np.zeros(8)
    raw, velocity = np.zeros(5), [0.0]
    sensors.reset_conditioning(last[0], raw, x)
    for position in 0.5 * acceleration * times[1:] ** 2:
        raw[4] = position
        sensors.condition_readings(constants[0], last[0], raw, x)
        velocity.append(x[7])
    np.testing.assert_allclose(velocity[100:], acceleration * (times[100:] - age), rtol=1e-9)


def test_readings_have_the_stated_noise_and_steps(bench: Bench) -> None:
    plant = AnalyticPlant(bench)
    samples = np.array([plant.reset(seed) for seed in range(2000)])
    assert samples.std(axis=0)[[0, 2, 4, 5]] == pytest.approx([0.6, 0.6, 6e3, 6e3], rel=0.05)
    steps = samples[:, 6] / 1e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def run(bench: Bench, current: float, samples: int, **moved: float) -> FloatArray:
    """Physical states of a bench, shape (samples + 1, 6), from rest but for states that are moved by so much."""
    model = BenchModel(bench)
    k, y, _ = model.begin(model.values)
    y += [moved.get(state.name, 0.0) for state in model.states]
    states = [y.copy()]
    for _ in range(samples):
        model.sample(k, y, current)
        states.append(y.copy())
    return np.array(states)


@given(
    pressures=st.tuples(*[st.floats(0.0, 16e6)] * 2), position=st.floats(0.0, 0.08), velocity=st.floats(-1.0, 1.0),
    current=st.floats(-0.05, 0.05),
)  # fmt: skip
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
    h = -oil_stiffness(bench, position) * velocity
    g = hydraulics.input_gain(record, position, *pressures, current)
    assert h + g * current == pytest.approx(derived, rel=1e-9, abs=1e-3)
    flows = flow_a / volume_a + bench.area_ratio * flow_b / volume_b
    assert g == pytest.approx(bench.bulk_modulus * bench.piston_area * flows, rel=1e-9, abs=1e-3)


def test_energy_is_conserved_with_a_closed_valve_and_no_friction(bench: Bench) -> None:
    """p' = -beta V'/V gives p = p_0 - beta ln(V/V_0): what the oil stores is in closed form."""
    free = replace(bench, viscous_friction=0.0)
    states = run(free, 0.0, 200, piston_velocity=0.2)
    start = states[0]
    initial = equations.volumes(bench, start[2])

    def energy(y: FloatArray) -> float:
        pressed = y[2] - free.spring_rest_position
        stored = 0.5 * free.moving_mass * y[3] ** 2 + 0.5 * free.spring_stiffness * pressed**2
        for volume, first, pressure in zip(equations.volumes(bench, y[2]), initial, start[:2], strict=True):
            stored -= pressure * (volume - first) - free.bulk_modulus * (volume * log(volume / first) - volume + first)
        return float(stored)

    assert np.ptp(states[:, 2]) > 1e-4
    np.testing.assert_allclose([energy(y) for y in states], energy(start), rtol=1e-5)


@pytest.mark.parametrize(("current", "end"), [(0.05, 0.08), (-0.05, 0.0)])
def test_end_stop_catches_the_piston_without_a_bounce(bench: Bench, current: float, end: float) -> None:
    position = run(replace(bench, spring_stiffness=1.0), current, 1000)[:, 2]
    arrival = int(np.argmax((position - 0.04) / (end - 0.04) >= 1.0))
    assert arrival > 0
    assert np.all(np.abs(position[arrival:] - end) < 1e-3)


def effect(name: str, **parameters: float) -> dict[str, Any]:
    identifier, *options = name.split()
    return {"id": identifier, **dict(option.split("=") for option in options), "parameters": parameters}


BRISTLES = (
    effect("transport_delay", time=1.33e-3), effect("valve_lag", bandwidth=90.0, damping=0.7),
    effect("valve_offset", current=1e-4), effect("valve_deadband form=soft", half_width=2e-4, softness=5e-5),
    effect("valve_null_leakage form=gaussian", coefficient=3e-10, width=5e-4), effect("friction_coulomb", force=12.0),
    effect("friction_presliding", stiffness=3e5), effect("supply_droop", resistance=5e9, time_constant=0.02),
    effect("leakage_internal", coefficient=1e-12), effect("spring_stiffness", ratio=1.3),
    effect("sensor_lag sensor=load_force", bandwidth=25.0, damping=0.55),
)  # fmt: skip
HELD = (
    effect("friction_coulomb", force=20.0), effect("friction_stribeck", breakaway_force=8.0, velocity=0.01),
    effect("backlash form=play", width=5e-4), effect("spring_hardening", coefficient=5e6),
    effect("moving_mass", mass=0.3), effect("load_cell_gain cell=load_force", ratio=1.02),
    effect("entrained_air", volume_fraction=0.01), effect("valve_gain_asymmetry", ratio=0.9),
)  # fmt: skip
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 120.0}}
BENCHES = {
    "bristles": replace(Bench.nominal(), effects=BRISTLES),
    "held": replace(Bench.nominal(), effects=HELD, closures=(DRAG,)),
}


def wave(samples: int) -> FloatArray:
    time = 1e-3 * np.arange(samples)
    return np.asarray(4e-3 * np.sin(2 * np.pi * 3 * time) + 2e-3 * np.sin(2 * np.pi * 17 * time))


@pytest.mark.parametrize("name", BENCHES)
def test_jacobian_of_a_sample_is_that_of_differences(name: str) -> None:
    model = BenchModel(BENCHES[name])
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, wave(137))
    _, dy, dz = model.jacobian(k, y.copy(), 3e-3)
    scales = np.array([state.scale for state in model.states] + [1e-2])
    for j, scale in enumerate(scales):
        ends = []
        for step in (1e-5 * scale, -1e-5 * scale):
            moved = np.append(y, 3e-3)
            moved[j] += step
            after = moved[:-1].copy()
            ends.append((after, model.sample(k, after, float(moved[-1]))))
        by_difference = [(up - down) / (2e-5 * scale) for up, down in zip(*ends, strict=True)]
        np.testing.assert_allclose(dy[:, j] * scale / scales[:-1], by_difference[0] * scale / scales[:-1], atol=2e-6)
        np.testing.assert_allclose(dz[:, j] * scale, by_difference[1] * scale, rtol=1e-5, atol=1e-3)


def test_underlap_halves_the_supply_at_null_and_doubles_the_gain(bench: Bench) -> None:
    """Of equal orifices in series each takes half; what one edge opens more, the other of its chamber opens less."""
    width, half, current = 2e-3, bench.supply_pressure / 2.0, 1e-4
    held = replace(bench, moving_mass=1e7, effects=(effect("valve_underlap", half_width=width),))
    model = BenchModel(held)
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, np.zeros(2000))
    np.testing.assert_allclose(y[:2], half, rtol=3e-3)  # the mass hardly moves
    before = y[:2].copy()
    model.sample(k, y, current)
    gain = bench.valve_nominal_flow / (bench.valve_nominal_current * sqrt(bench.valve_nominal_pressure_drop / 2.0))
    flow = 2.0 * gain * current * sqrt(half)
    stiff = [bench.bulk_modulus / volume for volume in equations.volumes(bench, bench.spring_rest_position)]
    np.testing.assert_allclose(y[:2] - before, 1e-3 * flow * np.array([stiff[0], -stiff[1]]), rtol=1e-2)


def test_an_edge_of_its_own_sets_the_pressure_of_its_chamber_at_null(bench: Bench) -> None:
    """Two orifices in series: w sqrt(p_s - p) = r (w - o) sqrt(p), with the tank's edge of share r and overlap o."""
    width, share, overlap = 2e-3, 0.7, 5e-4
    late = effect("valve_edge edge=at", overlap=overlap, ratio=1.0)
    edges = late, effect("valve_edge edge=bt", overlap=0.0, ratio=share)
    held = replace(bench, moving_mass=1e7, effects=(effect("valve_underlap", half_width=width), *edges))
    model = BenchModel(held)
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, np.zeros(2000))
    expected = [bench.supply_pressure / (1.0 + one * one) for one in (1.0 - overlap / width, share)]
    np.testing.assert_allclose(y[:2], expected, rtol=3e-3)


def test_return_line_settles_where_its_drop_is_that_of_what_bleeds(bench: Bench) -> None:
    """All four edges open by w: q_t = 2 K w sqrt((p_s - p_r) / 2) and p_r = R q_t, a quadratic equation."""
    width, resistance = 2e-3, 2e11
    gain = bench.valve_nominal_flow / (bench.valve_nominal_current * sqrt(bench.valve_nominal_pressure_drop / 2.0))
    line = effect("return_line", resistance=resistance, time_constant=0.02)
    held = replace(bench, moving_mass=1e7, effects=(effect("valve_underlap", half_width=width), line))
    model = BenchModel(held)
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, np.zeros(2000))
    push = 2.0 * (gain * width * resistance) ** 2
    risen = 0.5 * (sqrt(push * push + 4.0 * push * bench.supply_pressure) - push)
    assert resistance * y[6] == pytest.approx(risen, rel=3e-3)
    np.testing.assert_allclose(y[:2], (bench.supply_pressure + risen) / 2.0, rtol=3e-3)


def test_pump_and_return_orifice_settle_where_what_bleeds_is_what_they_give_and_pass(bench: Bench) -> None:
    """All four edges open by w: q = 2 K w sqrt((p_s - p_r) / 2) = Q - c p_s, and p_r = (q / K_r)^2."""
    width, limit, leak, outlet = 1e-3, 8e-6, 1e-13, 2e-8
    gain = bench.valve_nominal_flow / (bench.valve_nominal_current * sqrt(bench.valve_nominal_pressure_drop / 2.0))
    pump = effect("supply_pump", flow_limit=limit, relief_pressure=16e6, volume=2e-4, leakage=leak)
    line = effect("return_line form=orifice", orifice=outlet, time_constant=0.02)
    held = replace(bench, moving_mass=1e7, effects=(effect("valve_underlap", half_width=width), pump, line))
    model = BenchModel(held)
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, np.zeros(6000))
    supply, returned = 16e6 - y[6], y[7]
    flow = 2.0 * gain * width * sqrt((supply - returned) / 2.0)
    assert supply < 15e6 and flow == pytest.approx(limit - leak * supply, rel=3e-3)
    assert returned == pytest.approx((flow / outlet) ** 2, rel=1e-2)


@pytest.mark.parametrize("damping", [0.2, 1.0, 3.0])
def test_lags_are_exponentials_of_their_matrix(damping: float) -> None:
    lag = effect("valve_lag", bandwidth=300.0, damping=damping)
    model = BenchModel(replace(Bench.nominal(), effects=(lag,)))
    k, y, _ = model.begin(model.values)
    y[6:8] = 2e-3, 0.5
    model.sample(k, y, 1e-3)
    omega = 2.0 * np.pi * 300.0
    system = np.array([[0.0, 1.0], [-omega * omega, -2.0 * damping * omega]])
    expected = expm(1e-3 * system) @ np.array([2e-3 - 1e-3, 0.5]) + np.array([1e-3, 0.0])
    np.testing.assert_allclose(y[6:8], expected, rtol=1e-9, atol=1e-12)


def test_a_mass_that_is_held_has_no_derivative_of_its_place_by_a_small_force() -> None:
    """Derivatives are those of the side that the step is on: what holds, holds whatever changes a little."""
    model = BenchModel(replace(Bench.nominal(), effects=(effect("friction_coulomb", force=50.0),)))
    k, y, _ = model.begin(model.values)
    _, dy, _ = model.jacobian(k, y, 0.0)
    assert y[3] == 0.0 and (dy[3] == 0.0).all() and dy[2, 0] == 0.0 and dy[2, 2] == 1.0


@pytest.mark.parametrize("spoil", ["current", "state"])
def test_what_is_not_finite_stays_so_whatever_the_equations_limit(spoil: str) -> None:
    model = BenchModel(Bench.nominal())
    k, y, _ = model.begin(model.values)
    if spoil == "state":
        y[2] = np.nan
    assert np.isnan(model.sample(k, y, np.nan if spoil == "current" else 1e-3)).all() and np.isnan(y).all()


@pytest.mark.parametrize("period", [1e-3, 1.25e-3])
def test_hidden_states_follow_a_record_and_windows_start_from_them(period: float) -> None:
    late = effect("transport_delay", time=2.6e-3), effect("valve_lag", bandwidth=80.0, damping=0.7)
    model = BenchModel(replace(Bench.nominal(), effects=(*late, *HELD)), period=period)
    k, y, z = model.begin(model.values)
    current, states, readings = wave(120), [], []
    for now in current:
        states.append(y.copy())
        readings.append(z)
        z = model.sample(k, y, float(now))
    followed = model.hidden_states(k, states[0].copy(), current, np.array(states)[:, :4].copy())
    np.testing.assert_array_equal(followed, states)
    begins = np.array([30, 70])
    np.testing.assert_array_equal(model.windows(k, followed[begins], current, begins, 50)[0], readings[30:80])
    with pytest.raises(ValueError, match="beyond the currents"):
        model.windows(k, followed[begins], current, begins, 51)


NOISE: FloatArray = np.array([0.6, 0.6, 6e3, 6e3, 3e-7])


@pytest.mark.parametrize("name", BENCHES)
def test_sensitivities_are_those_of_differences(name: str) -> None:
    """By every parameter of every effect and closure, by the bench's numbers, and by the start, over 70 samples."""
    model = BenchModel(BENCHES[name], substeps=10)
    exact = Sensitivities(model)
    k, dk = exact.coefficients(model.values)
    np.testing.assert_array_equal(k, model.begin(model.values)[0])
    _, start, _ = model.begin(model.values)
    model.rollout(k, start, wave(137))
    current = wave(207)[137:].copy()
    sizes = np.maximum(np.abs(model.values), [1e-3 * one.scale for one in model.parameters])
    scales = np.array([state.scale for state in model.states])[: exact.estimated]
    z, dz, end = exact.window(k, start, current, np.diag(scales), dk * sizes)
    last = start.copy()
    np.testing.assert_allclose(z, model.rollout(k, last, current), rtol=1e-9)
    np.testing.assert_allclose(end, last, rtol=1e-9, atol=1e-12)
    step = 1e-6
    for j in range(dz.shape[2]):
        ends = []
        for side in (step, -step):
            theta, y = model.values.copy(), start.copy()
            if j < exact.estimated:
                y[j] += side * scales[j]
            else:
                theta[j - exact.estimated] += side * sizes[j - exact.estimated]
            ends.append(model.rollout(model.begin(theta)[0], y, current) / NOISE)
        difference = (ends[0] - ends[1]) / (2.0 * step)
        allowed = 1e-3 * np.max(np.abs(difference)) + 2e-3
        assert np.max(np.abs(dz[:, :, j] / NOISE - difference)) < allowed, (j, np.max(np.abs(difference)))
