# SPDX-License-Identifier: Apache-2.0
"""The table of an evaluation says what each controller may ask for, and which is the best."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import STATE_DTYPE, Flag
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.gain_search import GridPlan, GridSearch, GridSettings
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sac.sac import Losses, Sac, actor_parameters, dump
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task.cases import EvaluationSettings, Score, Trace, score
from hydro_policy.task.mdp import ACTIONS, BASE, OBSERVATIONS
from hydro_policy.training_plan import EXAMINED, TrainingPlan, significantly_better
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph


def test_the_best_is_told_with_its_distance() -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    plan = Comparison(EvaluationSettings(frequencies=(1.0, 2.0)), [FixedGains(90.0, 15.0)])
    session = TrialRunner(plan, PlantSupervisor(graph, True))
    for name, errors in {"good": (1.0, 2.0), "next": (4.0, 4.0), "stopped": (0.1, math.nan)}.items():
        for case, rmse in zip(("1 Hz", "2 Hz"), errors, strict=True):
            session.scores.append(Score(controller=name, case=case, frequency=1.0, repeat=0, rmse=rmse))
    assert report.best(session) == "Best: good, with 0.25 to 0.50 times the error of the next, next."
    felt = {"good": 9.0, "next": 3.0, "stopped": 1.0}
    session.scores = [replace(one, true_rmse=felt[one.controller] + 0.0 * one.rmse) for one in session.scores]
    assert report.best(session).startswith("Best: good"), "the measured force is what is controlled"
    session.compensation = LiveCompensation(BoxLaw(), cell=LoadCell(bandwidth=25.0))
    assert report.best(session) == (
        "Best: next, with 0.33 to 0.33 times the error of the next, good, as the specimen feels it."
    )
    del session.scores[2:4]
    assert report.best(session) == ""


def test_a_figure_of_a_run_that_was_held_up_is_marked_and_makes_nobody_the_best(tmp_path: Path) -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    plan = Comparison(EvaluationSettings(frequencies=(1.0,)), [FixedGains(90.0, 15.0), FixedGains(60.0, 15.0)])
    session = TrialRunner(plan, PlantSupervisor(graph, True))
    whole, held = (controller.name for controller in plan.controllers)
    run = Score(controller=whole, case="1 Hz", frequency=1.0, repeat=0, rmse=2.0, samples=990, lost=9)
    session.scores = [run, replace(run, controller=held, rmse=1.0, lost=9, held=2)]
    shown = report.table(session)
    assert [row["1 Hz"] for row in shown.rows] == [2.0, "1.00 *"] and shown.columns["controller"].startswith(
        "*: in more"
    )
    assert report.best(session) == f"Nobody is named the best: the machine was held up in runs of {held}."
    report.write_json(session, tmp_path / "evaluation.json", {})
    assert [one["spoilt"] for one in json.loads((tmp_path / "evaluation.json").read_text())["runs"]] == [False, True]
    session.scores[1] = replace(session.scores[1], held=0)
    assert not report.table(session).columns["controller"] and report.best(session).startswith(f"Best: {held}")


def test_an_emulated_plant_tells_the_error_of_the_force_on_the_specimen(tmp_path: Path) -> None:
    ring = load_force.create_ring(tmp_path / "load_force")
    trace = Trace("one", "1 Hz", 1.0, np.zeros(3, STATE_DTYPE))
    trace.states["sequence"], trace.states["load_force"] = (7, 8, load_force.RING_SIZE + 9), 1.0
    for sequence in trace.states["sequence"]:
        load_force.write_force(ring, int(sequence), 3.0)
    found = score(trace, 0, felt=load_force.read_forces(tmp_path / "load_force", trace.states["sequence"]))
    assert (found.rmse, found.true_rmse) == (1.0, 3.0)
    trace.states["sequence"][2] = 9  # not kept any more
    lost = score(trace, 0, felt=load_force.read_forces(tmp_path / "load_force", trace.states["sequence"]))
    assert math.isnan(lost.true_rmse)


CASES = ("0.5 Hz", "1 Hz", "1.5 Hz", "2 Hz")
FIXED = np.array([5.0, 12.0, 20.0, 40.0])


def scores(runs: np.ndarray) -> list[Score]:
    """Of runs, N, shape (repeats, cases)."""
    return [
        Score(controller=EXAMINED, case=case, frequency=1.0, repeat=repeat, rmse=float(value))
        for repeat, row in enumerate(runs)
        for case, value in zip(CASES, row, strict=True)
    ]


class Learner:
    """Gives one state after another."""

    entropy_coefficient, updates, losses = 0.0, 0, Losses()
    replay = new_weights = wake = None

    def __init__(self) -> None:
        self.states: list[bytes] = []
        self.learn()

    def learn(self) -> None:
        """Another state."""
        settings = replace(TrainingSettings().sac, seed=len(self.states))
        self.states.append(dump(Sac(OBSERVATIONS, ACTIONS, settings)))

    def snapshot(self, *, exact: bool = False) -> bytes:
        return self.states[-1]

    def save_policy(self, good: bytes) -> None:
        pass


@pytest.mark.parametrize(
    ("score", "errors", "best_error", "better"),
    [
        (0.9, [0.0, 0.0], 0.0, True),
        (0.9, [0.05, 0.05], 0.05, False),
        (0.9, [0.03, 0.03], 0.03, True),
        (0.9, [0.1, *[0.01] * 8], 0.1, False),
        (0.9, [0.03] * 9, 0.03, False),
    ],
)
def test_better_is_better_by_more_than_the_noise(
    score: float, errors: list[float], best_error: float, better: bool
) -> None:
    """The best score's own noise counts, and so does how often a run has compared."""
    assert significantly_better(score, 1.0, errors, best_error) is better


def test_a_policy_that_came_is_handed_back_unless_another_is_surely_better() -> None:
    learner = Learner()
    state = TrainingPlan(TrainingSettings(), learner, None)  # type: ignore[arg-type]
    state.progress.reference_rmse = FIXED.tolist()
    came = actor_parameters(learner.states[0])

    def examined(share: float, scatter: float) -> bool:
        state.propose()
        return state.add_exam(scores(share * FIXED * np.array([[1.0 - scatter], [1.0 + scatter]])))

    assert examined(0.5, 0.04)
    learner.learn()
    assert not examined(0.48, 0.04), "better by less than the scatter"
    np.testing.assert_array_equal(state.best, came)
    assert state.progress.best_score == pytest.approx(0.5)
    assert examined(0.3, 0.04)
    np.testing.assert_array_equal(state.best, actor_parameters(learner.states[1]))
    assert np.any(state.best != came)


def test_an_interrupted_comparison_makes_only_the_trials_that_are_missing(tmp_path: Path) -> None:
    asked = EvaluationSettings(frequencies=(1.0, 2.0), settle=0.5, measure=0.5)
    gains = [FixedGains(90.0, 15.0), FixedGains(300.0, 15.0)]  # the guard passes no such gains: stopped

    def session() -> tuple[OfflineGraph, TrialRunner[Comparison]]:
        graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
        return graph, TrialRunner(Comparison(asked, gains), PlantSupervisor(graph, True), record=record)

    record = RunRecord(tmp_path / "run.json")
    graph, first = session()
    graph.run(first, 4.6)
    assert 2 <= len(first.scores) < len(first.plan)
    record.add("end", complete=False)
    record.flush()
    record = RunRecord(tmp_path / "run.json")
    graph, resumed = session()
    assert list(map(repr, resumed.scores)) == list(map(repr, first.scores)), "not a number is lost, nor a NaN"
    made = len(graph.gains_published)
    graph.run(resumed, 20.0)
    assert resumed.finished and made == 0 and len(resumed.scores) == len(resumed.plan)
    assert [score.run for score in resumed.scores] == [trial.empty_score().run for trial in resumed.plan.trials]
    assert len(resumed.traces) < len(resumed.plan)
    for last in ({"kind": "end", "complete": True}, {"kind": "episode"}):  # compared, or another policy
        record.events.append(last)
        assert not record.unfinished("trial")
        record.events.pop()


LIMIT = 127.0


def landscape(kp: float, ki: float) -> list[float]:
    """Best near (113, 22); unstable beyond `LIMIT`."""
    if kp > LIMIT:
        return [float("inf"), float("inf")]  # what a session tells of a pair that was stopped
    bowl = 1.0 + ((kp - 113.0) / 60.0) ** 2 + ((ki - 22.0) / 40.0) ** 2
    return [5.0 * bowl, 40.0 * bowl]


def test_search_finds_the_best_pair_and_never_climbs_beyond_the_first_that_is_stopped() -> None:
    search = GridSearch(GridSettings())
    while (pair := search.next()) is not None:
        search.tell(pair, landscape(*pair))
    assert abs(search.best[0] - 113.0) <= 7.5 and abs(search.best[1] - 22.0) <= 7.5
    assert max(kp for kp, _ in search.tried) <= LIMIT + GridSettings().kp_step
    assert [kp for kp, _ in search.tried if kp > LIMIT] == [150.0, 135.0, 127.5], "each below those stopped before"
    assert len(search.tried) < 30
    assert np.isinf(search.scores[(150.0, 15.0)])
    assert search.any_completed


def test_grid_on_box_and_plant_ends_before_the_box_trips_and_finds_gains_that_track_well() -> None:
    bench = replace(Bench.nominal(), load_cell_bandwidth=25.0)  # unstable beyond some 100 1/s
    graph = OfflineGraph(AnalyticPlant(bench), bench, guard=GuardSettings(delta_kp_max=285.0, delta_ki_max=95.0))
    evaluation = EvaluationSettings(frequencies=(1.0, 2.0), settle=0.5, measure=1.0)
    settings = GridSettings(kp_min=60.0, ki_values=(15.0,), refinements=1)
    plan = GridPlan(settings, evaluation, BASE)
    session = TrialRunner(plan, PlantSupervisor(graph, True), monitor=SafetyMonitor())
    graph.run(session, 120.0)
    assert session.finished
    tried = plan.search.tried
    assert 90.0 < max(kp for kp, _ in tried) < 200.0, "it rose to the edge and not far beyond"
    best = tried[plan.search.best]
    assert np.mean(best / tried[(60.0, 15.0)]) < 1.0
    assert not any("force_limit" in sentence for sentence in graph.sentences)
    assert not int(graph.box.state["arming"]["faults"][0]) & Flag.FORCE_LIMIT
