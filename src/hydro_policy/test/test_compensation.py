# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import NEUTRAL, FloatArray
from hydro_policy.compensation.estimator import STEP, Compensator, CompensatorSettings, LoadCell

TRUE = (1.02, 0.031, 4e-4, -7.0)
ACTIVE = np.array([True])


def polynomial(times: FloatArray, amplitude: float = 200.0) -> tuple[FloatArray, FloatArray]:
    """A multisine f, and the f_c = a_0 f + a_1 f' + a_2 f'' + a_3 of `TRUE`."""
    force, command = np.zeros_like(times), np.full_like(times, TRUE[3])
    for frequency, share in ((0.5, 0.4), (0.87, 0.3), (1.7, 0.3)):
        w = 2.0 * np.pi * frequency
        sine, cosine = amplitude * share * np.sin(w * times), amplitude * share * np.cos(w * times)
        force += sine
        command += (TRUE[0] - TRUE[2] * w * w) * sine + TRUE[1] * w * cosine
    return command, force


def taught(compensator: Compensator, seconds: float, start: float = 0.0) -> None:
    for k in range(round(seconds / STEP)):
        command, force = polynomial(start + (10 * k + np.arange(10)) * 1e-3)
        compensator.step(command[np.newaxis], force[np.newaxis], ACTIVE)


def test_coefficients_of_a_polynomial_are_found() -> None:
    compensator = Compensator()
    taught(compensator, 8.0)
    np.testing.assert_allclose(compensator.coefficients[0], TRUE, rtol=5e-3, atol=1e-6)
    assert compensator.excitation[0] > 0.1 and not compensator.at_bound[0]


def test_with_a_cell_the_fit_is_on_the_force_in_front_of_it() -> None:
    """f_c = f_s: what the amplifier adds to f_s must not be compensated."""
    cell = LoadCell(bandwidth=20.0, damping=0.6)
    compensator, plain = Compensator(cell=cell), Compensator()
    for k in range(800):
        times = (10 * k + np.arange(10)) * 1e-3
        specimen, shown = np.zeros(10), np.zeros(10)
        for frequency in (0.5, 0.87, 1.7):
            phasor = 60.0 * np.exp(2j * np.pi * frequency * times)
            s = 2j * np.pi * frequency / (2.0 * np.pi * cell.bandwidth)
            specimen += phasor.imag
            shown += (phasor / (1.0 + 2.0 * cell.damping * s + s * s)).imag
        for one in (compensator, plain):
            one.step(specimen[np.newaxis], shown[np.newaxis], ACTIVE)
    np.testing.assert_allclose(compensator.coefficients[0], NEUTRAL, atol=2e-3)
    assert plain.coefficients[0, 1] == pytest.approx(2.0 * cell.damping / (2.0 * np.pi * cell.bandwidth), rel=0.05)


def test_what_the_valve_wants_where_the_force_turns_is_found_and_goes_out_ahead_of_it() -> None:
    """f_c = f + b_0 tanh(f' / r) + b_1 |f'|, f = f_r: no smooth polynomial has either."""
    compensator = Compensator(settings=CompensatorSettings(valve_weight=1e-5))
    overlap, direction, w = 6.0, 2e-3, 2.0 * np.pi
    for k in range(800):
        times = (10 * k + np.arange(10)) * 1e-3
        force, rate = 200.0 * np.sin(w * times), 200.0 * w * np.cos(w * times)
        valve = overlap * np.tanh(rate / compensator.settings.reversal) + direction * np.abs(rate)
        compensator.step((force + valve)[np.newaxis], force[np.newaxis], ACTIVE, rate[np.newaxis])
        coming = 200.0 * w * np.cos(w * (times[-1] + 0.01))
        expected = overlap * np.tanh(coming / compensator.settings.reversal) + direction * np.abs(coming)
        if k > 600:
            np.testing.assert_allclose(compensator.coefficients[0], [1.0, 0.0, 0.0, expected], rtol=0.01, atol=0.15)


def test_what_does_not_count_holds() -> None:
    compensator = Compensator(count=2)
    for k in range(600):
        command, force = (np.tile(signal, (2, 1)) for signal in polynomial((10 * k + np.arange(10)) * 1e-3))
        compensator.step(command, force, np.array([True, True]))
    before = compensator.coefficients.copy()
    wild = np.full((2, 10), np.nan), np.full((2, 10), 1e6)
    for _ in range(50):
        compensator.step(*wild, np.array([True, True]))
        compensator.step(wild[1], -wild[1], np.array([False, False]))
    np.testing.assert_array_equal(compensator.coefficients, before)
    compensator.frozen[0] = True
    for k in range(100):
        signals = (signal[np.newaxis].repeat(2, 0) for signal in polynomial((10 * k + np.arange(10)) * 1e-3, 300.0))
        compensator.step(*signals, np.array([True, True]))
    assert np.array_equal(compensator.coefficients[0], before[0])
    assert not np.array_equal(compensator.coefficients[1], before[1])
    compensator.reset()
    np.testing.assert_array_equal(compensator.coefficients, np.tile(NEUTRAL, (2, 1)))


@pytest.mark.parametrize(
    ("fault", "far"),
    [("stuck", (1e-5, 1e-6, 1e-7, 1e-4)), ("jumping", 0.0), ("out of contact", (5e-3, 2e-4, 1e-4, 1.0))],
)
def test_a_load_cell_that_fails_teaches_nothing(fault: str, far: float | tuple[float, ...]) -> None:
    """Without that, stuck and out of contact move a_0 by 0.2 and a_3 by 50 N."""
    compensator = Compensator()
    taught(compensator, 8.0)
    before = compensator.coefficients.copy()
    for k in range(100):
        command, force = polynomial(8.0 + (10 * k + np.arange(10)) * 1e-3, amplitude=300.0)
        if fault == "stuck":
            force = np.full(10, polynomial(np.array([8.0]))[1][0])
        elif fault == "jumping":
            force[5:] += 100.0 * (-1.0) ** k
        else:
            force *= 0.01
        compensator.step(command[np.newaxis], force[np.newaxis], ACTIVE)
    assert np.all(np.abs(compensator.coefficients - before) <= far)


def test_coefficients_stay_within_the_law() -> None:
    law, generator = BoxLaw(), np.random.default_rng(0)
    compensator = Compensator(count=20)
    for _ in range(300):
        signals = 500.0 * generator.standard_normal((2, 20, 10)).cumsum(axis=2)
        compensator.step(*signals, np.ones(20, bool))
        assert np.all(compensator.coefficients >= law.coefficient_min)
        assert np.all(compensator.coefficients <= law.coefficient_max)
    assert compensator.at_bound.dtype == bool
