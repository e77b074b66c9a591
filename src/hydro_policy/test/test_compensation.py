# SPDX-License-Identifier: Apache-2.0
"""The compensated law: its coefficients are found, hold under what spoils a sample, and a session runs it safely."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import NEUTRAL_COEFFICIENTS, Flag, FloatArray, Law
from hydro_policy.compensation.estimator import (
    INITIAL_COEFFICIENTS,
    Compensator,
    CompensatorSettings,
    LoadCell,
)
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation.controllers import Compensated
from hydro_policy.supervision.override import GainOverride
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

TRUE = (1.02, 0.031, 4e-4, -7.0, 4e-6)
BEGUN = tuple(INITIAL_COEFFICIENTS[:5])
ACTIVE = np.array([True])
OMEGA = 2.0 * np.pi
LAW, FIXED = BoxLaw(), (90.0, 15.0)


def times(step: int) -> FloatArray:
    """Of the samples of a policy step [s], shape (1, 10)."""
    return (10 * step + np.arange(10))[np.newaxis] * 1e-3


def polynomial(at: FloatArray, amplitude: float = 200.0) -> tuple[FloatArray, FloatArray]:
    """The f_c = a_0 f + a_1 f' + a_2 f'' + a_3 + a_4 f''' of `TRUE`, and f, a multisine."""
    force, command = np.zeros_like(at), np.full_like(at, TRUE[3])
    for frequency, share in ((0.5, 0.4), (0.87, 0.3), (1.7, 0.3)):
        w = OMEGA * frequency
        sine, cosine = amplitude * share * np.sin(w * at), amplitude * share * np.cos(w * at)
        force += sine
        command += (TRUE[0] - TRUE[2] * w * w) * sine + (TRUE[1] - TRUE[4] * w * w) * w * cosine
    return command, force


def taught(seconds: float) -> Compensator:
    compensator = Compensator(settings=CompensatorSettings(third_weight=1e-5))
    for k in range(round(100 * seconds)):
        compensator.step(*polynomial(times(k)), ACTIVE)
    return compensator


def test_coefficients_of_a_polynomial_are_found() -> None:
    compensator = taught(8.0)
    np.testing.assert_allclose(compensator.coefficients[0], TRUE, rtol=5e-3, atol=1e-6)
    assert compensator.excitation[0] > 0.1 and not compensator.at_bound[0]


def test_noise_in_the_force_does_not_make_a_2_smaller() -> None:
    """4 N of white noise, the mean of 20 estimators: plain least squares leave 0.87 of it."""
    compensator, rng = Compensator(20), np.random.default_rng(3)
    for k in range(800):
        command, force = (np.repeat(signal, 20, axis=0) for signal in polynomial(times(k)))
        compensator.step(command, force + 4.0 * rng.standard_normal(force.shape), np.ones(20, bool))
    found = compensator.coefficients.mean(axis=0) / TRUE
    assert abs(found[1] - 1.0) < 0.01 and abs(found[2] - 1.0) < 0.08


def test_a_box_that_knows_its_overlap_leaps_over_it() -> None:
    """Also where its bench file has a third too much of it."""
    rubbing = {"id": "friction_coulomb", "parameters": {"force": 25.0}}
    overlaps = [{"id": "valve_deadband", "parameters": {"half_width": width}} for width in (6e-4, 8e-4)]
    settings, nominal = EvaluationSettings(frequencies=(0.5, 2.0), steps=True), Bench.nominal()
    cases, gains, rmse = settings.cases, vector_runs.fixed_gains(np.zeros(2), (0.0, 0.0)), []
    for believed in (nominal, *(replace(nominal, effects=(overlap,)) for overlap in overlaps)):
        plants = [AnalyticPlant(replace(nominal, effects=(rubbing, overlaps[0]))) for _ in cases]
        sums = np.zeros(len(cases))
        for step in vector_runs.run(
            VectorBench([believed] * len(cases), plants), cases, gains, settings, 1, Compensator(len(cases))
        ):
            error = step.samples["reference_force"] - step.samples["load_force"]
            sums += np.sum(np.where(step.counted, error, 0.0) ** 2, axis=1)
        rmse.append(np.sqrt(sums))
    assert (rmse[1] < 0.7 * rmse[0]).all() and (rmse[2] < 0.85 * rmse[0]).all()


def test_with_a_cell_the_fit_is_on_the_force_in_front_of_it() -> None:
    """f_c = f_s: what the amplifier adds to f_s must not be compensated."""
    cell = LoadCell(bandwidth=20.0, damping=0.6)
    compensator, plain = Compensator(cell=cell), Compensator()
    for k in range(800):
        specimen, shown = np.zeros((2, 1, 10))
        for frequency in (0.5, 0.87, 1.7):
            phasor, s = 60.0 * np.exp(1j * OMEGA * frequency * times(k)), 1j * frequency / cell.bandwidth
            specimen += phasor.imag
            shown += (phasor / (1.0 + 2.0 * cell.damping * s + s * s)).imag
        compensator.step(specimen, shown, ACTIVE)
        plain.step(specimen, shown, ACTIVE)
    np.testing.assert_allclose(compensator.coefficients[0], NEUTRAL_COEFFICIENTS, atol=2e-3)
    assert abs(compensator.coefficients[0, 2]) < 0.2 * plain.coefficients[0, 2]
    assert plain.coefficients[0, 1] == pytest.approx(2.0 * cell.damping / (OMEGA * cell.bandwidth), rel=0.05)


def missed(compensator: Compensator, added: Callable[[FloatArray, FloatArray], FloatArray]) -> FloatArray:
    """f_c that goes out where it acts, less f + `added`(f, f'), from the sixth second on [N]; f = f_r: 200 N, 1 Hz."""
    found = []
    for k in range(1000):
        at = np.append(times(k), times(k)[0, -1] + 0.01)
        f, rate = 200.0 * np.sin(OMEGA * at), 200.0 * OMEGA * np.cos(OMEGA * at)
        wanted = f + added(f, rate)
        command, force, slope = (each[np.newaxis, :10] for each in (wanted, f, rate))
        compensator.step(command, force, ACTIVE, slope, force)
        found.append(
            compensator.coefficients[0] @ (f[10], rate[10], -(OMEGA**2) * f[10], 1.0, -(OMEGA**2) * rate[10])
            - wanted[10]
        )
    return np.array(found[600:])


def test_what_goes_with_direction_and_force_is_found_and_goes_out_ahead() -> None:
    """f_c = f + b_0 tanh(f' / r) + (b_1 + b_3 f) |f'| + b_2 f f', f = f_r: no smooth polynomial has these terms."""
    settings = CompensatorSettings(valve_weight=1e-5)

    def added(f: FloatArray, rate: FloatArray) -> FloatArray:
        return 6.0 * np.tanh(rate / settings.reversal) + (2e-3 + 2e-5 * f) * np.abs(rate) - 3e-5 * f * rate

    assert np.max(np.abs(missed(Compensator(settings=settings), added))) < 0.3


def test_what_a_load_takes_that_yields_is_found_and_goes_out_ahead() -> None:
    """f_c = f + 0.02 f' until f is 300 N from where it turned: a play of half-width 150 N has the rest."""

    def added(f: FloatArray, rate: FloatArray) -> FloatArray:
        return 0.02 * rate * (np.sign(rate) * f < 100.0)

    plain, known = Compensator(), Compensator()
    plain._constants.weights[9:] = 1e6
    without, left = (np.sqrt(np.mean(missed(each, added) ** 2)) for each in (plain, known))
    assert known._constants.plays[1] == 150.0 and left < 0.5 * without


@pytest.mark.parametrize(
    ("spoilt", "far"),
    [
        pytest.param(lambda f, k: 0.0 * f + polynomial(np.array([8.0]))[1], (1e-5, 2e-6, 1e-7, 1e-3, 3e-8), id="stuck"),
        pytest.param(lambda f, k: f + 100.0 * (-1.0) ** k * (np.arange(10) > 4), 0.0, id="jumping"),
        pytest.param(lambda f, k: 0.01 * f, (5e-3, 2e-4, 1e-4, 1.0, 1e-5), id="out of contact"),
        pytest.param(lambda f, k: np.nan * f, 0.0, id="no number"),
    ],
)
def test_a_load_cell_that_fails_teaches_nothing_nor_does_what_does_not_count(spoilt, far) -> None:
    """Without that, stuck and out of contact move a_0 by 0.2 and a_3 by 50 N."""
    compensator = taught(8.0)
    before = compensator.coefficients.copy()
    for k in range(800, 900):
        command, force = polynomial(times(k), amplitude=300.0)
        compensator.step(command, spoilt(force, k), ACTIVE)
    assert np.all(np.abs(compensator.coefficients - before) <= far)
    before = compensator.coefficients.copy()
    for _ in range(50):
        compensator.step(np.nan * command, 1e6 + force, ACTIVE)
        compensator.step(command, -force, ~ACTIVE)
    np.testing.assert_array_equal(compensator.coefficients, before)


def test_coefficients_stay_within_the_law() -> None:
    compensator, generator = Compensator(count=20), np.random.default_rng(0)
    for _ in range(300):
        signals = 500.0 * generator.standard_normal((2, 20, 10)).cumsum(axis=2)
        found = compensator.step(*signals, np.ones(20, bool))
        assert np.all((found >= LAW.coefficient_min) & (found <= LAW.coefficient_max))


class Heard(OfflineGraph):
    """Keeps what was armed, and which gains were sent, under which law."""

    def __init__(self) -> None:
        super().__init__(AnalyticPlant(Bench.nominal()), Bench.nominal())
        self.armed: list[tuple[bool, int]] = []
        self.gained: list[tuple[int, float]] = []

    @property
    def law(self) -> int:
        return int(self.box.state["acting"]["law"][0])

    def publish_gains(self, delta_kp, delta_ki, step):
        self.gained.append((self.law, delta_kp))
        super().publish_gains(delta_kp, delta_ki, step)

    def sample(self):
        output = super().sample()
        self.armed.append((bool(output["flags"] & Flag.ARMED), self.law))
        return output


@pytest.fixture
def start(compare):
    """Start the compensated law beside others, a second of 1 Hz each."""

    def make(*others, frequencies=(1.0,), **more):
        live = LiveCompensation(LAW)
        more |= {"frequencies": frequencies, "settle": 2.0, "measure": 1.0, "compensation": live}
        return live, *compare(Compensated(live), *others, graph=Heard(), **more)

    return make


def test_the_compensated_law_tracks_far_better_and_the_law_changes_once_while_the_plant_is_disarmed(start) -> None:
    live, graph, session = start(FIXED, frequencies=(1.0, 2.0))
    graph.run(session, 60.0, compensation=live)
    assert session.finished and not session.warnings and all(score.held == 0 for score in session.scores)
    assert [score.controller for score in session.scores] == ["fixed (90, 15)"] * 2 + ["compensated"] * 2
    fixed, compensated = np.reshape([score.rmse for score in session.scores], (2, 2))
    assert (compensated < 0.2 * fixed).all()
    changes = [(before, now) for before, now in pairwise(graph.armed) if before[1] != now[1]]
    assert changes == [((False, Law.PAPER), (False, Law.COMPENSATED))]
    assert graph.guard.counts.laws_refused == 0


def pairs(live: LiveCompensation, steps: range, *, lost: int = -1, flags: int = Flag.ARMED, ahead: int = 0) -> None:
    """Samples of a bench that lags 20 ms behind, both messages of each but of one that is lost; the law's come first.

    `ahead`: samples by which those of the law come earlier.
    """
    for sequence in range(10 * steps.start + 1, 10 * steps.stop + 1):
        t = 1e-3 * sequence
        if sequence != lost:
            live.on_law_state(sequence + ahead, Law.COMPENSATED, 300.0 * math.sin(OMEGA * (t + 1e-3 * ahead)))
        live.on_sample(sequence, 300.0 * math.sin(OMEGA * (t - 0.02)), int(flags))


@pytest.mark.parametrize("ahead", [0, 45, -45])
def test_it_learns_the_lag_from_both_messages_of_each_sample(ahead: int) -> None:
    """As long as the law counts as acting, whichever of the two comes late by so many samples."""
    live = LiveCompensation(LAW)
    pairs(live, range(5, 400), ahead=ahead)
    assert live.acting is Law.COMPENSATED
    assert live.command.coefficients[1] == pytest.approx(0.02, rel=0.1) and live.uncounted_steps <= 1


@pytest.mark.parametrize("flag", [Flag.SATURATED, Flag.WATCHDOG, Flag.TRIPPED, Flag.SENSOR_FAULT, Flag.FILTER_STALE])
def test_coefficients_hold_under_what_spoils_a_sample_and_while_disarmed(flag: Flag) -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(200), lost=1555)
    assert live.uncounted_steps == 1, "a lost message holds one policy step"
    before = live.command
    pairs(live, range(200, 250), flags=Flag.ARMED | flag)
    pairs(live, range(250, 300), flags=0)
    assert live.command == before != LiveCompensation(LAW).command


def test_frozen_coefficients_hold_until_released_also_into_the_next_run() -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(100))
    live.frozen, before = True, live.command
    pairs(live, range(100, 200))
    live.reset()
    assert live.command == before and live.health["frozen"] != "no"
    live.frozen = False
    pairs(live, range(200, 300))
    assert live.command != before
    live.reset()
    assert live.command.coefficients == BEGUN


def test_gains_held_by_a_person_are_those_of_the_law_that_acts_which_does_not_change_meanwhile(start) -> None:
    override = GainOverride()
    live, graph, session = start(FIXED, override=override)
    while not session.scores:
        graph.run(session, 0.01, compensation=live)
    assert graph.armed[-1] == (True, Law.PAPER), "the law is about to change"
    for law, change in ((Law.PAPER, 75.0), (Law.COMPENSATED, 90.0 - LAW.base_kp)):
        while graph.armed[-1] != (True, law):
            graph.run(session, 0.01, compensation=live)
        override.start(*FIXED, 1.0, graph.time)
        graph.gained.clear()
        graph.run(session, 0.9, compensation=live)
        assert set(graph.gained) == {(int(law), change)}
    graph.run(session, 30.0, compensation=live)
    assert session.finished and session.scores[1].controller == "compensated" and not session.scores[1].stopped


def test_a_plant_that_does_not_take_up_the_law_ends_its_runs(start) -> None:
    live, graph, session = start(FIXED)
    graph.guard.set_box_law(None)
    graph.run(session, 60.0, compensation=live)
    assert session.finished and "does not take up" in session.scores[1].stopped
    assert sum(not before[0] and now[0] for before, now in pairwise(graph.armed)) <= 5
