# SPDX-License-Identifier: Apache-2.0
"""What an evaluation says of controllers and policies, how fixed gains are searched, and recorded references."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from hydro_bridge.safety.guard import GuardSettings
from hydro_core.settings import SettingsError
from hydro_core.signals import STATE_DTYPE, Flag
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation import report
from hydro_policy.evaluation.gain_search import GridPlan, GridSettings
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task import recorded
from hydro_policy.task.cases import EvaluationSettings, Score, Trace, score
from hydro_policy.task.mdp import BASE_GAINS
from hydro_policy.training_plan import POLICY_NAME, significantly_better
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph


def scored(controller: str, case: str, rmse: float, repeat: int = 0, **more: float) -> Score:
    return Score(controller=controller, case=case, frequency=1.0, repeat=repeat, rmse=rmse, **more)


def test_a_figure_of_a_run_that_was_held_up_is_marked_and_makes_nobody_the_best(compare, tmp_path: Path) -> None:
    _, session = compare((90.0, 15.0), (60.0, 15.0), frequencies=(1.0,))
    whole, held = (controller.name for controller in session.plan.controllers)
    run = scored(held, "1 Hz", 1.0, samples=990, lost=9, held=2)
    session.scores = [scored(whole, "1 Hz", 2.0, samples=990, lost=9), run]
    shown = report.table(session)
    assert [row["1 Hz"] for row in shown.rows] == [2.0, "1.00 *"]
    assert shown.columns["controller"].startswith("*: the machine was held up")
    assert report.best(session) == f"Nobody is named the best: the machine was held up in runs of {held}."
    report.write_json(session, tmp_path / "evaluation.json", {})
    assert [one["spoilt"] for one in json.loads((tmp_path / "evaluation.json").read_text())["runs"]] == [False, True]
    session.scores[1] = replace(run, held=0)
    assert not report.table(session).columns["controller"] and report.best(session).startswith(f"Best: {held}")


def test_an_emulated_plant_tells_the_error_of_the_force_on_the_specimen(tmp_path: Path) -> None:
    ring = load_force.create_ring(tmp_path / "load_force")
    trace = Trace("one", "1 Hz", 1.0, np.zeros(3, STATE_DTYPE))
    trace.states["sequence"], trace.states["load_force"] = (7, 8, load_force.RING_SIZE + 9), 1.0
    for sequence in trace.states["sequence"]:
        load_force.write_force(ring, int(sequence), 3.0)
    found = score(trace, 0, specimen_force=load_force.read_forces(tmp_path / "load_force", trace.states["sequence"]))
    assert (found.rmse, found.true_rmse) == (1.0, 3.0)
    trace.states["sequence"][2] = 9  # not kept any more
    lost = score(trace, 0, specimen_force=load_force.read_forces(tmp_path / "load_force", trace.states["sequence"]))
    assert math.isnan(lost.true_rmse)
    with pytest.raises(OSError, match="/dev/full"):  # where no block can be reserved, at once and by name
        load_force.create_ring(Path("/dev/full"))


@pytest.mark.parametrize(
    ("errors", "best_error", "better"),
    [
        ([0.0, 0.0], 0.0, True),
        ([0.05, 0.05], 0.05, False),
        ([0.03, 0.03], 0.03, True),
        ([0.1, *[0.01] * 8], 0.1, False),
        ([0.03] * 9, 0.03, False),
    ],
)
def test_better_is_better_by_more_than_the_noise(errors: list[float], best_error: float, better: bool) -> None:
    """The best score's own noise counts, and so does how often a run has compared."""
    assert significantly_better(0.9, 1.0, errors, best_error) is better


def test_a_policy_that_came_is_handed_back_unless_another_is_surely_better(train) -> None:
    _, learner, session = train()
    plan, came, fixed = session.plan, learner.propose(), np.array([5.0, 12.0, 20.0, 40.0])
    plan.progress.reference_rmse = fixed.tolist()

    def examined(share: float) -> bool:
        """Two runs of each sine, 4 % below and above this share of the fixed gains' error."""
        plan.propose()
        runs = [(repeat, share * scatter * fixed) for repeat, scatter in enumerate((0.96, 1.04))]
        return plan.add_examination(
            [scored(POLICY_NAME, f"{k}", rmse[k], repeat) for repeat, rmse in runs for k in range(4)]
        )

    assert examined(0.5)
    learner.learner.sac.vectors["actor.parameters"][:] *= 1.1
    learner.learner._recent.append((0, learner.learner.sac.state.copy()))
    learner.status = learner.learner.status
    learnt = learner.propose()
    assert not examined(0.48), "better by less than the scatter"
    np.testing.assert_array_equal(plan.best, came)
    assert plan.progress.best_score == pytest.approx(0.5)
    assert examined(0.3)
    np.testing.assert_array_equal(plan.best, learnt)
    assert np.any(plan.best != came)


def test_grid_on_box_and_plant_ends_before_the_box_trips_and_finds_gains_that_track_well() -> None:
    bench = replace(Bench.nominal(), load_cell_bandwidth=25.0)  # unstable beyond some 100 1/s
    graph = OfflineGraph(AnalyticPlant(bench), bench, guard=GuardSettings(delta_kp_max=285.0, delta_ki_max=95.0))
    evaluation = EvaluationSettings(frequencies=(1.0, 2.0), settle=0.5, measure=1.0)
    plan = GridPlan(GridSettings(kp_min=60.0, ki_values=(15.0,), refinements=1), evaluation, BASE_GAINS)
    session = TrialRunner(plan, PlantSupervisor(graph, True), monitor=SafetyMonitor())
    graph.run(session, 120.0)
    assert session.finished
    tried = plan.search.results
    assert 90.0 < max(kp for kp, _ in tried) < 200.0, "it rose to the edge and not far beyond"
    assert np.mean(tried[plan.search.best] / tried[(60.0, 15.0)]) < 1.0
    assert not any("force_limit" in sentence for sentence in graph.sentences)
    assert not int(graph.box.state["arming"]["faults"][0]) & Flag.FORCE_LIMIT


TIME = np.arange(0.0, 6.0, 0.02)
SHAKE = np.exp(-(((TIME - 3.0) / 1.2) ** 2)) * (np.sin(9.0 * TIME) + 0.6 * np.sin(4.1 * TIME + 1.0))


def playing(file: Path) -> EvaluationSettings:
    return EvaluationSettings(frequencies=(), recorded=(str(file),))


def test_a_recorded_reference_is_read_played_by_the_box_and_sent_in_pieces(compare, tmp_path: Path) -> None:
    text, matrix = tmp_path / "shake.csv", tmp_path / "shake.mat"
    np.savetxt(text, np.stack((TIME, SHAKE), axis=1), delimiter=",", header="time,value", comments="")
    savemat(matrix, {"motion": np.stack((TIME, SHAKE))})
    np.testing.assert_allclose(recorded.read(text), recorded.read(matrix))
    asked = playing(matrix)
    (case,) = asked.cases
    fleet = VectorBench([Bench.nominal()], [AnalyticPlant(Bench.nominal())])
    steps = vector_runs.run(fleet, [case], vector_runs.fixed_gains(np.array((90.0, 15.0))), asked)
    played = np.concatenate([step.samples["reference_force"][0].copy() for step in steps])
    assert asked.duration(case) == pytest.approx(5.4)
    wanted = np.interp(0.001 * np.arange(len(played)), TIME, SHAKE)
    wanted *= 300.0 / np.abs(wanted).max()
    away = np.sqrt(np.mean((played - wanted)[300:] ** 2) / np.mean(wanted**2))
    assert away < 0.15 and np.abs(np.diff(played)).max() < 10.0
    graph, session = compare((90.0, 15.0), frequencies=(), recorded=asked.recorded, settle=2.0, measure=3.0)
    graph.run(session, 30.0)
    assert graph.references[-len(case.segments) - 1 :] == [case.signal, *case.segments]
    (score,), (row,) = session.scores, report.table(session).rows
    assert row["shake"] == f"{score.rmse:.2f}, {100.0 * score.rmse / score.reference_rms:.2f} %"
    assert 0.0 < score.rmse < 0.2 * score.reference_rms and 60.0 < score.reference_rms < 200.0


def test_what_is_no_record_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "square.mat", {"a": np.eye(3)})
    (tmp_path / "short.csv").write_text("0,1\n1,2\n")
    (tmp_path / "words.csv").write_text("hello\n" * 20)
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    (tmp_path / "still.csv").write_text("".join(f"{t},0\n" for t in TIME))
    for name in ("square.mat", "short.csv", "still.csv", "words.csv", "broken.mat", "none.csv"):
        with pytest.raises(SettingsError, match=name) as refused:
            playing(tmp_path / name)
        assert "\n" not in str(refused.value)
