# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import NEUTRAL, CorrectionStatus, Flag, FloatArray, Law
from hydro_filter.controller.loop_filter import Result
from hydro_policy.compensation.estimator import BOX_SHARE, START, STEP, Compensator, CompensatorSettings, LoadCell
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.controllers import Compensated, FixedGains
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import MISMATCH, PlantSupervisor
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

TRUE = (1.02, 0.031, 4e-4, -7.0)
SHARED = (1.0, 1.0, BOX_SHARE, 1.0)
BEGUN = tuple(START[:4] * SHARED)
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


def taught(compensator: Compensator, seconds: float) -> None:
    for k in range(round(seconds / STEP)):
        command, force = polynomial((10 * k + np.arange(10)) * 1e-3)
        compensator.step(command[np.newaxis], force[np.newaxis], ACTIVE)


def test_coefficients_of_a_polynomial_are_found() -> None:
    compensator = Compensator()
    taught(compensator, 8.0)
    np.testing.assert_allclose(compensator.coefficients[0], np.multiply(TRUE, SHARED), rtol=5e-3, atol=1e-6)
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
    assert abs(compensator.coefficients[0, 2]) < 0.2 * plain.coefficients[0, 2]
    assert plain.coefficients[0, 1] == pytest.approx(2.0 * cell.damping / (2.0 * np.pi * cell.bandwidth), rel=0.05)


OMEGA = 2.0 * np.pi


def sine(times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """f = f_r and f' of 200 N at 1 Hz."""
    return 200.0 * np.sin(OMEGA * times), 200.0 * OMEGA * np.cos(OMEGA * times)


def missed(compensator: Compensator, added: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """f_c that goes out, less f + `added` of a sine, where it acts, from the sixth second on [N], shape (n,)."""
    found = []
    for k in range(1000):
        times = (10 * k + np.arange(10)) * 1e-3
        force, rate = sine(times)
        compensator.step((force + added(times))[np.newaxis], force[np.newaxis], ACTIVE, rate[np.newaxis],
                         force[np.newaxis])  # fmt: skip
        ahead = times[-1:] + 0.01
        (value,), (slope,) = sine(ahead)
        terms = np.array((value, slope, -(OMEGA**2) * value, 1.0))
        found.append(compensator.coefficients[0] @ terms - value - added(ahead)[0])
    return np.array(found[600:])


def test_what_goes_with_direction_and_force_is_found_and_goes_out_ahead() -> None:
    """f_c = f + b_0 tanh(f' / r) + (b_1 + b_3 f) |f'| + b_2 f f', f = f_r: no smooth polynomial has these terms."""
    compensator = Compensator(settings=CompensatorSettings(valve_weight=1e-5))

    def added(times: FloatArray) -> FloatArray:
        force, rate = sine(times)
        valve = 6.0 * np.tanh(rate / compensator.settings.reversal) + (2e-3 + 2e-5 * force) * np.abs(rate)
        return np.asarray(valve - 3e-5 * force * rate)

    assert np.max(np.abs(missed(compensator, added))) < 0.3


def test_what_a_load_takes_that_yields_is_found_and_goes_out_ahead() -> None:
    """f_c = f + 0.02 f' until f is 300 N from where it turned: a play of half-width 150 N has the rest."""

    def added(times: FloatArray) -> FloatArray:
        force, rate = sine(times)
        return np.asarray(0.02 * rate * (np.sign(rate) * force < 100.0))

    plain, known = Compensator(), Compensator()
    plain._constants.weights[8:] = 1e6
    without, left = (np.sqrt(np.mean(missed(each, added) ** 2)) for each in (plain, known))
    assert known._constants.plays[1] == 150.0
    assert left < 0.5 * without


def test_what_the_box_is_not_told_of_a_2_goes_out_ahead_within_a_3() -> None:
    compensator, w = Compensator(), 2.0 * np.pi * 1.5
    for k in range(800):
        times = (10 * k + np.arange(10)) * 1e-3
        command, force = polynomial(times)
        rate = 100.0 * w * np.cos(w * times)
        compensator.step(command[np.newaxis], force[np.newaxis], ACTIVE, rate[np.newaxis])
        second = -100.0 * w * w * np.sin(w * (times[-1] + 0.01))
        if k > 600:
            rest = (1.0 - BOX_SHARE) * TRUE[2] * second
            np.testing.assert_allclose(compensator.coefficients[0, 3], TRUE[3] + rest, atol=0.15)


def test_what_does_not_count_holds() -> None:
    compensator = Compensator()
    taught(compensator, 6.0)
    before = compensator.coefficients.copy()
    wild = np.full((1, 10), np.nan), np.full((1, 10), 1e6)
    for _ in range(50):
        compensator.step(*wild, ACTIVE)
        compensator.step(wild[1], -wild[1], ~ACTIVE)
    np.testing.assert_array_equal(compensator.coefficients, before)
    compensator.reset()
    np.testing.assert_array_equal(compensator.coefficients, [BEGUN])


@pytest.mark.parametrize(
    ("fault", "far"),
    [("stuck", (1e-5, 1e-6, 1e-7, 1e-3)), ("jumping", 0.0), ("out of contact", (5e-3, 2e-4, 1e-4, 1.0))],
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


LAW = BoxLaw()


class Heard(OfflineGraph):
    """Keeps what was armed, and which gains were sent, under which law."""

    def __init__(self) -> None:
        super().__init__(AnalyticPlant(Bench.nominal()), Bench.nominal())
        self.armed: list[tuple[bool, int]] = []
        self.gained: list[tuple[int, float]] = []

    def gains(self, delta_kp, delta_ki, step):
        self.gained.append((int(self.box.state["acting"]["law"][0]), delta_kp))
        super().gains(delta_kp, delta_ki, step)

    def sample(self):
        output = super().sample()
        self.armed.append((bool(output["flags"] & Flag.ARMED), int(self.box.state["acting"]["law"][0])))
        return output


def started(
    graph: Heard, live: LiveCompensation, *frequencies: float, override: GainOverride | None = None
) -> TrialRunner[Comparison]:
    """The compensated law beside (90, 15), a second each."""
    settings = EvaluationSettings(frequencies=frequencies, measure=1.0)
    controllers, plant = [Compensated(live), FixedGains(90.0, 15.0)], PlantSupervisor(graph, True, override=override)
    return TrialRunner(Comparison(settings, controllers), plant, compensation=live)


def test_the_compensated_law_tracks_far_better_and_the_law_changes_once_while_the_plant_is_disarmed() -> None:
    graph, live = Heard(), LiveCompensation(LAW)
    session = started(graph, live, 1.0, 2.0)
    graph.run(session, 60.0, compensation=live)
    assert session.finished and not session.warnings
    rmse = {(score.controller, score.frequency): score.rmse for score in session.scores}
    print(rmse)
    for frequency in (1.0, 2.0):
        assert rmse["compensated", frequency] < 0.2 * rmse["fixed (90, 15)", frequency]
    assert all(score.held == 0 for score in session.scores)
    changes = [(before, now) for before, now in pairwise(graph.armed) if before[1] != now[1]]
    assert changes == [((False, Law.PAPER), (False, Law.COMPENSATED))]
    assert graph.guard.counts.laws_refused == 0
    assert [score.controller for score in session.scores] == 2 * ["fixed (90, 15)"] + 2 * ["compensated"]


def pairs(
    live: LiveCompensation, steps: range, *, lost: int = -1, flags: int = int(Flag.ARMED), ahead: int = 0
) -> None:
    """Samples of a bench that lags 20 ms behind, both messages of each but of one that is lost; the law's come first.

    `ahead`: samples by which those of the law come earlier.
    """
    for sequence in range(10 * steps.start + 1, 10 * steps.stop + 1):
        t = 1e-3 * sequence
        if sequence != lost:
            of_law = 300.0 * math.sin(2.0 * math.pi * (t + 1e-3 * ahead))
            live.on_law_state(sequence + ahead, Law.COMPENSATED, of_law)
        live.on_sample(sequence, 300.0 * math.sin(2.0 * math.pi * (t - 0.02)), flags)


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
    pairs(live, range(200))
    before = live.command
    pairs(live, range(200, 250), flags=int(Flag.ARMED | flag))
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


def test_gains_held_by_a_person_are_those_of_the_law_that_acts() -> None:
    """A person holds (90, 15) from before the law changes until 2 s after."""
    override, live, graph = GainOverride(), LiveCompensation(LAW), Heard()
    session = started(graph, live, 1.0, override=override)
    while not session.scores:
        graph.run(session, 0.01, compensation=live)
    assert graph.armed[-1] == (True, Law.PAPER), "the law is about to change"
    override.hold(90.0, 15.0, 2.0, graph.time)
    graph.gained.clear()
    graph.run(session, 1.5, compensation=live)
    assert graph.gained and set(graph.gained) <= {(int(Law.PAPER), 75.0), (int(Law.COMPENSATED), 90.0 - LAW.base_kp)}
    graph.run(session, 30.0, compensation=live)
    assert session.finished and session.scores[1].controller == "compensated" and not session.scores[1].stopped


def test_under_mismatch_the_law_s_base_gains_hold_and_its_run_begins_again() -> None:
    live, graph = LiveCompensation(LAW), Heard()
    settings = EvaluationSettings(frequencies=(1.0,), measure=1.0)
    session = TrialRunner(Comparison(settings, [Compensated(live)]), PlantSupervisor(graph, True), compensation=live)
    graph.run(session, 2.5, compensation=live)
    assert graph.armed[-1] == (True, Law.COMPENSATED)
    fits, graph.answer = graph.answer, Result(0.0, math.nan, math.nan, CorrectionStatus.MISMATCH)
    graph.gained.clear()
    graph.run(session, 2.0, compensation=live)
    assert set(graph.gained) == {(int(Law.COMPENSATED), 0.0)} and not session.scores
    assert session.watch.summary == "armed, waiting for a filter that fits" and MISMATCH in graph.sentences
    graph.answer = fits
    graph.run(session, 1.0, compensation=live)
    assert not session.scores, "from its beginning"
    graph.run(session, 10.0, compensation=live)
    (score,) = session.scores
    assert not score.stopped and score.held == 0 and not session.warnings


def test_a_plant_that_does_not_take_up_the_law_ends_its_runs() -> None:
    live, graph = LiveCompensation(LAW), Heard()
    graph.guard.set_box_law(None)
    session = started(graph, live, 1.0)
    graph.run(session, 60.0, compensation=live)
    assert session.finished and "does not take up" in session.scores[1].stopped
    assert sum(not before[0] and now[0] for before, now in pairwise(graph.armed)) <= 5


def test_a_lost_message_holds_one_policy_step() -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(300), lost=1555)
    assert live.uncounted_steps == 1
