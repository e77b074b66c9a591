# SPDX-License-Identifier: Apache-2.0
"""Recorded references: read from a file, played by the box as they were recorded, refused where there is no record."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from hydro_core.settings import SettingsError
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task import recorded
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

TIME = np.arange(0.0, 6.0, 0.02)
SHAKE = np.exp(-(((TIME - 3.0) / 1.2) ** 2)) * (np.sin(9.0 * TIME) + 0.6 * np.sin(4.1 * TIME + 1.0))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    savemat(tmp_path / "shake.mat", {"motion": np.stack((TIME, SHAKE))})
    return tmp_path / "shake.mat"


def settings(file: Path) -> EvaluationSettings:
    return EvaluationSettings(frequencies=(), recorded=(str(file),))


def test_the_box_plays_the_record(file: Path) -> None:
    (case,) = settings(file).cases
    fleet = VectorBench([Bench.nominal()], [AnalyticPlant(Bench.nominal())])
    steps = vector_runs.run(fleet, [case], vector_runs.fixed_gains(np.array((90.0, 15.0))), settings(file))
    played = np.concatenate([step.samples["reference_force"][0].copy() for step in steps])
    assert settings(file).duration(case) == pytest.approx(5.4)
    wanted = np.interp(0.001 * np.arange(len(played)), TIME, SHAKE)
    wanted *= 300.0 / np.abs(wanted).max()
    away = np.sqrt(np.mean((played - wanted)[300:] ** 2) / np.mean(wanted**2))
    assert away < 0.15 and np.abs(np.diff(played)).max() < 10.0


def test_a_running_graph_is_sent_the_same_pieces(file: Path) -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    plan = Comparison(settings(file), [FixedGains(90.0, 15.0)])
    session = TrialRunner(plan, PlantSupervisor(graph, True))
    graph.run(session, 30.0)
    (case,), (score,) = settings(file).cases, session.scores
    assert graph.references[-len(case.pieces) - 1 :] == [case.signal, *case.pieces]
    assert (
        report.table(session).rows[0]["shake"] == f"{score.rmse:.2f}, {100.0 * score.rmse / score.reference_rms:.2f} %"
    )
    assert 0.0 < score.rmse < 0.2 * score.reference_rms and 60.0 < score.reference_rms < 200.0


def test_text_with_a_heading_and_matlab_give_the_same_record(tmp_path: Path, file: Path) -> None:
    text = tmp_path / "shake.csv"
    text.write_text("time,value\n" + "".join(f"{t},{v}\n" for t, v in zip(TIME, SHAKE, strict=True)))
    for one, other in zip(recorded.read(text), recorded.read(file), strict=True):
        np.testing.assert_allclose(one, other)


def test_what_is_no_record_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "square.mat", {"a": np.eye(3)})
    (tmp_path / "short.csv").write_text("0,1\n1,2\n")
    (tmp_path / "words.csv").write_text("hello\n" * 20)
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    (tmp_path / "still.csv").write_text("".join(f"{t},0\n" for t in TIME))
    for name in ("square.mat", "short.csv", "still.csv", "words.csv", "broken.mat", "none.csv"):
        with pytest.raises(SettingsError, match=name) as refused:
            settings(tmp_path / name)
        assert "\n" not in str(refused.value)


def test_fast_sines_are_small_enough_for_the_valve() -> None:
    names = [case.name for case in EvaluationSettings(fast=True).cases]
    assert names[-2:] == ["5 Hz, 100 N", "10 Hz, 50 N"]
