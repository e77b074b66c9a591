# SPDX-License-Identifier: Apache-2.0
"""The learned residual: better than the law on benches it has not seen, the law itself where it is off or useless."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import SAMPLES_PER_STEP, Flag, FloatArray, Law, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import ADAPTS, Compensator
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.compensation.residual import INPUTS, RESIDUAL_MAX, Network, Residual
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation.controllers import Compensated
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

BENCH = Bench.nominal()
RUBBING = {"id": "friction_coulomb", "parameters": {"force": 25.0}}
OVERLAP = {"id": "valve_deadband", "parameters": {"half_width": 4e-4}}
BENCHES = [replace(BENCH, effects=effects) for effects in ((RUBBING,), (OVERLAP,), (RUBBING, OVERLAP))]
SIGNALS = [
    ReferenceSignal(waveform=waveform, amplitude=amplitude, frequency=frequency)
    for waveform, amplitude, frequency in ((Waveform.SINE, 240.0, 0.9), (Waveform.MULTISINE, 260.0, 0.45))
]


def run(residual: Residual | None, seconds: float = 7.0) -> tuple[FloatArray, FloatArray]:
    """Error [N] of each bench with each reference, shape (6, samples), and what was added to a_3, shape (6, steps)."""
    pairs = [(bench, signal) for bench in BENCHES for signal in SIGNALS]
    fleet = VectorBench([BENCH] * len(pairs), [AnalyticPlant(bench) for bench, _ in pairs])
    for row, (_, signal) in enumerate(pairs):
        fleet.begin(row, signal, 7 + row, law=Law.COMPENSATED)
    estimator, law, added, errors, all_added = Compensator(len(pairs)), BoxLaw(), np.zeros(len(pairs)), [], []
    for _ in range(round(100 * seconds)):
        commanded = estimator.coefficients.copy()
        commanded[:, 3] += added
        assert (commanded[:, 3] <= law.coefficient_max[3]).all()
        samples = fleet.step(np.zeros((len(pairs), 2)), commanded)
        reference, force = samples["reference_force"], samples["load_force"]
        active = np.all(samples["flags"] & ADAPTS == Flag.ARMED, axis=1)
        hidden = (0.0, 0.0) if residual is None else residual.hidden(added)
        a = estimator.step(fleet.compensated - hidden[0], force - hidden[1], active, samples["reference_force_rate"])
        if residual is not None:
            added = residual.step(reference, samples["reference_force_rate"], force, a, estimator.counted)
        errors.append(reference - force)
        all_added.append(added)
    return np.concatenate(errors, axis=1), np.stack(all_added, axis=1)


def rmse(error: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(error[:, 2500:] ** 2, axis=1)))


@pytest.mark.slow
def test_error_falls_on_benches_and_references_that_were_not_trained_on() -> None:
    alone, _ = run(None)
    both, added = run(Residual(6, Network.load()))
    ratio = rmse(both) / rmse(alone)
    assert np.median(ratio) < 0.85 and ratio.max() < 1.1
    assert np.abs(added).max() <= RESIDUAL_MAX and not added[:, :60].any(), "it acts within its bounds, and not at once"


def test_without_a_network_the_law_is_the_law() -> None:
    alone, _ = run(None, 1.5)
    both, added = run(Residual(6), 1.5)
    np.testing.assert_array_equal(alone, both)
    assert not added.any()


@pytest.mark.slow
def test_session_runs_the_law_with_and_without_it_as_two_controllers() -> None:
    graph = OfflineGraph(AnalyticPlant(BENCHES[2]), BENCH)
    live = LiveCompensation(BoxLaw(), network=Network.load())
    controllers = [Compensated(live), Compensated(live, learned=True)]
    session = EvaluationSession(
        EvaluationSettings(frequencies=(0.7,), settle=4.0), controllers, graph, compensation=live
    )
    graph.run(session, 60.0, compensation=live)
    assert session.finished and not session.warnings
    alone, both = (score.rmse for score in session.scores)
    assert [score.controller for score in session.scores] == ["compensated", "compensated, learned residual"]
    assert both < 0.9 * alone
    assert isinstance(live.health["learned residual [N]"], float) and live.learned
    live.frozen = True
    before = live.command.coefficients
    for sequence in range(1, 200):
        live.on_law_state(900_000 + sequence, int(Law.COMPENSATED), 10.0)
        live.on_sample(900_000 + sequence, 10.0, int(Flag.ARMED), reference=11.0)
    assert live.command.coefficients[:3] == before[:3] and live.health["learned residual [N]"] == 0.0


class Wrong(Network):
    """Predicts the opposite, or nothing that is a number."""

    factor = -1.0

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """See `Network`."""
        return self.factor * super().__call__(inputs)


@pytest.mark.slow
def test_authority_of_a_network_that_harms_shrinks_to_little() -> None:
    shipped = Network.load()
    wrong = Residual(6, Wrong(shipped.mean, shipped.spread, shipped.layers))
    alone, _ = run(None)
    both, _ = run(wrong)
    assert (wrong.authority < 0.1).all()
    assert (rmse(both) < 1.2 * rmse(alone)).all()


def test_nothing_that_is_no_number_gets_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Wrong, "factor", np.nan)
    shipped = Network.load()
    residual = Residual(1, Wrong(shipped.mean, shipped.spread, shipped.layers))
    rng, counted = np.random.default_rng(0), np.ones(1, bool)
    for step in range(200):
        samples = rng.normal(size=(3, 1, SAMPLES_PER_STEP)) * 100.0
        if step == 100:
            samples[2, 0, 3] = np.nan
        value = residual.step(*samples, np.array([[1.0, 0.02, 5e-4, 0.0]]), counted)
        assert np.isfinite(value).all() and np.isfinite(residual.inputs).all() and not value.any()
        assert residual.inputs.shape == (1, INPUTS)
    assert residual.age[0] == 99, "a sample that is no number begins it anew"
