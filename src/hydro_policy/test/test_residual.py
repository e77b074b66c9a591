# SPDX-License-Identifier: Apache-2.0
"""The learned residual: better than the law on benches it has not seen, the law itself where it is off or useless."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import SAMPLES_PER_STEP, Flag, FloatArray, Law, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.compensation.residual import PAUSE_STEPS_MAX, RESIDUAL_MAX, Network, PeriodDetector, Residual
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation.controllers import Compensated
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import BASE_GAINS
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

BENCH = Bench.nominal()
RUBBING = {"id": "friction_coulomb", "parameters": {"force": 25.0}}
OVERLAP = {"id": "valve_deadband", "parameters": {"half_width": 4e-4}}
BENCHES = [replace(BENCH, effects=effects) for effects in ((RUBBING,), (OVERLAP,), (RUBBING, OVERLAP))]
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=240.0, frequency=0.9)
MULTISINE = ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=260.0, frequency=0.45)
LAW = np.array([[1.0, 0.02, 5e-4, 0.0]])


def run(residual: Residual | None, seconds: float = 7.0) -> tuple[FloatArray, FloatArray]:
    """Error [N] of each bench with sine and multisine, shape (6, samples), and w [N], shape (6, steps)."""
    fleet = VectorBench([BENCH] * 6, [AnalyticPlant(bench) for bench in BENCHES for _ in range(2)])
    cases, gains = [Case("", SINE), Case("", MULTISINE)] * 3, vector_runs.fixed_gains(np.array(BASE_GAINS))
    steps = vector_runs.run(fleet, cases, gains, EvaluationSettings(measure=5.0), 7, Compensator(6), residual)
    errors, values = [], []
    for step in islice(steps, round(100 * seconds)):
        errors.append(step.samples["reference_force"] - step.samples["load_force"])
        values.append(np.zeros(6) if residual is None else residual.value.copy())
    return np.concatenate(errors, axis=1), np.stack(values, axis=1)


def rmse(error: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(error[:, 2500:] ** 2, axis=1))


@cache
def law_alone() -> FloatArray:
    return rmse(run(None)[0])


def predicting(factor: float) -> Network:
    """A network that predicts so many times what the shipped one does."""
    shipped = Network.load()
    *hidden, (weight, bias) = shipped.layers
    return replace(shipped, layers=(*hidden, (factor * weight, factor * bias)))


def test_period_of_what_repeats_is_found_and_none_of_what_does_not() -> None:
    time = np.arange(0.0, 9.0, 0.01)
    pulses = np.where(time % 1.7 < 0.4, 50.0, 0.0)
    sine, drifting = 300.0 * np.sin(2.0 * np.pi * 1.3 * time), np.sin(time) + np.sin(np.sqrt(3.0) * time)
    shifted = np.where(time < 7.0, sine, 300.0 * np.sin(2.0 * np.pi * 0.8 * time))
    references, period = np.stack((sine, pulses, drifting, np.full_like(time, 40.0), shifted)), PeriodDetector(5)
    for step, now in enumerate(references.T):
        period.step(now, np.full(5, step + 1))
        if step == 650:
            np.testing.assert_allclose(period.steps, (100.0 / 1.3, 170.0, 0.0, 0.0, 100.0 / 1.3), atol=0.05)
            assert (period.confidence[[0, 1, 4]] > 0.98).all()
        if step == 710:
            assert period.confidence[4] == 0.0, "another sine has been there for 0.1 s"


@pytest.mark.slow
def test_error_falls_on_benches_and_references_that_were_not_trained_on() -> None:
    error, added = run(Residual(6, Network.load()))
    ratio = rmse(error) / law_alone()
    assert np.median(ratio) < 0.92 and ratio.max() < 1.1, "it was trained on a law that left more"
    assert np.abs(added).max() <= RESIDUAL_MAX and not added[:, :60].any(), "it acts within its bounds, and not at once"


@pytest.mark.slow
def test_authority_of_a_network_that_harms_shrinks_to_little() -> None:
    wrong = Residual(6, predicting(-1.0))
    error, _ = run(wrong)
    assert (wrong.authority[1::2] < 0.1).all(), "multisines; for sines, what was needed a period ago takes its place"
    assert (rmse(error) < 1.2 * law_alone()).all()


def test_without_a_network_the_law_is_the_law() -> None:
    (alone, _), (both, added) = run(None, 1.5), run(Residual(6), 1.5)
    np.testing.assert_array_equal(alone, both)
    assert not added.any()


@pytest.mark.slow
def test_session_runs_the_law_with_and_without_it_as_two_controllers(compare) -> None:
    live = LiveCompensation(BoxLaw(), network=Network.load())
    controllers, graph = (
        (Compensated(live), Compensated(live, learned=True)),
        OfflineGraph(AnalyticPlant(BENCHES[2]), BENCH),
    )
    _, session = compare(*controllers, graph=graph, frequencies=(0.7,), settle=4.0, measure=3.0, compensation=live)
    graph.run(session, 60.0, compensation=live)
    assert session.finished and not session.warnings
    assert [score.controller for score in session.scores] == ["compensated", "compensated, learned residual"]
    alone, both = (score.rmse for score in session.scores)
    assert both < 0.9 * alone and isinstance(live.health["learned residual [N]"], float)
    live.frozen, before = True, live.command.coefficients
    for sequence in range(900_001, 900_200):
        live.on_law_state(sequence, int(Law.COMPENSATED), 10.0)
        live.on_sample(sequence, 10.0, int(Flag.ARMED), reference=11.0)
    assert live.command.coefficients[:3] == before[:3] and live.health["learned residual [N]"] == 0.0


def test_samples_that_do_not_count_take_it_away_at_once_and_it_comes_back_slowly() -> None:
    residual, counted = Residual(1, Network.load()), np.ones(1, bool)

    def step(number: int, counted: np.ndarray) -> float:
        phase = 2.0 * np.pi * 1e-3 * (SAMPLES_PER_STEP * number + np.arange(SAMPLES_PER_STEP))[np.newaxis]
        reference, rate = 200.0 * np.sin(phase), 400.0 * np.pi * np.cos(phase)
        return abs(float(residual.step(reference, rate, reference - 3.0 * np.sign(rate), LAW, counted)[0]))

    before = max([step(number, counted) for number in range(200)][150:])
    assert before > 1.0
    assert step(200, ~counted) == 0.0
    assert step(201, counted) < 0.1 * before < max(step(n, counted) for n in range(202, 300))


def test_nothing_that_is_no_number_gets_out() -> None:
    residual, rng, counted = Residual(1, predicting(np.nan)), np.random.default_rng(0), np.ones(1, bool)
    for step in range(200):
        samples = rng.normal(size=(3, 1, SAMPLES_PER_STEP)) * 100.0
        if step == 100:
            samples[2, 0, 3] = np.nan
        value = residual.step(*samples, LAW, counted)
        assert np.isfinite(residual.inputs).all() and value.tolist() == [0.0]
    assert residual.age[0] == 200, "a sample that is no number makes it pause"
    for _ in range(PAUSE_STEPS_MAX + 1):
        assert not residual.step(*np.zeros((3, 1, SAMPLES_PER_STEP)), np.zeros((1, 4)), ~counted).any()
    assert residual.age[0] == 0, "it begins again after a long one"
