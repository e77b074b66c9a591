# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_sim import force_law, hydraulics
from hydro_sim.bench import Bench
from hydro_sim.offline import Schedule, simulate
from hydro_sim.plant import AnalyticPlant


@given(
    error=st.floats(-500.0, 500.0),
    integral=st.floats(-50.0, 50.0),
    rate=st.floats(-4000.0, 4000.0),
    pressures=st.tuples(*[st.floats(3e6, 14e6)] * 2),
    velocity=st.floats(-0.3, 0.3),
    gains=st.tuples(st.floats(-40.0, 300.0), st.floats(0.0, 20.0)),
)
@settings(max_examples=200, deadline=None)
def test_put_into_the_model_the_law_gives_the_wanted_force_rate(
    error: float,
    integral: float,
    rate: float,
    pressures: tuple[float, float],
    velocity: float,
    gains: tuple[float, float],
) -> None:
    record = Bench.nominal().constants()[0]
    x = np.array([0.0, 0.0, 0.0, 0.0, *pressures, 0.03, velocity])
    u = force_law.nominal_current(record, x, error, integral, rate, *gains, 1.0)
    h = hydraulics.velocity_term(record, 0.03, velocity)
    g = hydraulics.input_gain(record, 0.03, *pressures, u)
    wanted = rate + gains[0] * error + gains[1] * integral
    assert h + g * u == pytest.approx(wanted, rel=1e-9, abs=1e-6)


def test_error_dies_out_as_equation_q25_says(bench: Bench) -> None:
    """Fed with the true state at 100 kHz, on the hydraulic force: e' = -K_p e - K_i int e, from e = 50 N."""
    record, step, k_p, k_i = bench.constants()[0], 1e-5, 30.0, 200.0
    y, integral, errors = hydraulics.rest_state(record), 0.0, []
    for _ in range(20000):
        x = np.array([0.0, 0.0, 0.0, 0.0, y[0], y[1], y[2], y[3]])
        error = 50.0 - hydraulics.hydraulic_force(record, y[0], y[1])
        errors.append(error)
        u = force_law.nominal_current(record, x, error, integral, 0.0, k_p, k_i, 1.0)
        integral = force_law.integrate(integral, error, k_i, u, u, step)
        hydraulics.advance(record, y, u, step, 1)
    times = step * np.arange(20000)
    slow, fast = np.roots([1.0, k_p, k_i])[::-1]
    expected = 50.0 * (fast * np.exp(fast * times) - slow * np.exp(slow * times)) / (fast - slow)
    np.testing.assert_allclose(errors, expected, atol=0.2)


@pytest.mark.parametrize("frequency", [0.5, 1.0, 1.5, 2.0])
def test_tracking_error_is_what_the_age_of_the_velocity_predicts(ideal: Bench, frequency: float) -> None:
    """A velocity that is `age` late leaves h(v) - h(v late) uncancelled; to first order that alone makes the error.

    In the frequency domain, with the load m s^2 + b s + k_s and oil stiffness c: e = f_r - f_l,
    s f_h = s f_r + K_p e + K_i e/s - c s x (1 - exp(-s age)); one more half sample, because the current is held.
    """
    run = simulate(
        AnalyticPlant(ideal, noise=0.0),
        ideal,
        Schedule(
            reference=ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=frequency),
            gains=(90.0, 15.0),
            seconds=6.0,
        ),
    )[-4000:]
    error = run["reference_force"] - run["load_force"]
    s = 2j * np.pi * frequency
    oil = -hydraulics.velocity_term(ideal.constants()[0], 0.04, 1.0)
    late = 1.0 - np.exp(-s * 1.5e-3)
    load = (ideal.moving_mass * s**2 + ideal.viscous_friction * s + ideal.spring_stiffness) / ideal.spring_stiffness
    left = s * load + s * oil / ideal.spring_stiffness * late
    response = (left - s) / (left + 90.0 + 15.0 / s)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(300.0 / np.sqrt(2.0) * abs(response), rel=0.05)


def test_a_vanishing_gain_is_not_believed(bench: Bench) -> None:
    record = bench.constants()[0]
    x = np.array([0.0, 0.0, 0.0, 0.0, 16e6, 0.0, 0.04, 0.0])
    assert hydraulics.input_gain(record, 0.04, 16e6, 0.0, 1.0) == 0.0
    assert force_law.nominal_current(record, x, 100.0, 0.0, 0.0, 90.0, 15.0, 1e6) == pytest.approx(9e-3)


def test_integral_stands_still_only_while_it_would_saturate_further() -> None:
    assert force_law.integrate(1.0, 10.0, 15.0, 0.07, 0.05, 1e-3) == 1.0
    assert force_law.integrate(1.0, -10.0, 15.0, 0.07, 0.05, 1e-3) == pytest.approx(0.99)
    assert force_law.integrate(1.0, -10.0, 15.0, -0.07, -0.05, 1e-3) == 1.0
    assert force_law.integrate(1.0, 10.0, 15.0, 0.02, 0.02, 1e-3) == pytest.approx(1.01)
