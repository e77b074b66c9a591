# SPDX-License-Identifier: Apache-2.0
"""What a bench file names is learnt from recordings of a bench that has it; where it lacks some, it says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.files import bench_file
from hydro_bridge.signals import StateArray
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import draw
from hydro_sim.files import recordings
from hydro_sim.identification import bench_learning, learn, validate
from hydro_sim.identification.bench_states import noise_of
from hydro_sim.identification.validate import BenchPrediction
from hydro_sim.model.bench import Bench
from tests.checks import status_of

TRUTH = {
    "profile": "nominal", "bench": {"spring_stiffness": 32000.0}, "effects": {"valve_deadband": {"half_width": 3e-4}},
}  # fmt: skip
SPRING = {"id": "spring_stiffness", "parameters": {"ratio": 1.0}}
DEADBAND = {"id": "valve_deadband", "parameters": {"half_width": 5e-5}}
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 0.0}}


@pytest.fixture(scope="module")
def states() -> StateArray:
    return record_offline(truth_from_mapping(TRUTH), draw(20.0, 3), seed=3).states


@pytest.fixture(scope="module")
def data(states: StateArray) -> recordings.Data:
    return recordings.split({"one": states})


def test_deadband_spring_and_a_closure_that_is_not_there_are_found(data: recordings.Data) -> None:
    bench = replace(Bench.nominal(), effects=(SPRING, DEADBAND), closures=(DRAG,))
    result = bench_learning.learn(bench, data, count=60)
    ratio, half_width, drag = result.parameters
    assert ratio.value == pytest.approx(1.6, rel=2e-3) and ratio.seen
    assert half_width.value == pytest.approx(3e-4, rel=5e-3) and half_width.low < 3.01e-4 and half_width.high > 2.99e-4
    assert drag.low < 30.0 and drag.high > -30.0
    assert result.quality.over_noise < 1.2
    assert result.bench.effects[0]["parameters"]["ratio"] == pytest.approx(ratio.value, rel=1e-6)
    assert result.bench.closures[0]["form"] == "quadratic drag" and "id" not in result.bench.closures[0]
    assert result.file().unfit == ""


def test_a_bench_file_that_lacks_what_the_bench_has_is_said_to_be_unfit(
    states: StateArray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command, from a recording to the file: it is written, and says itself that nothing may rely on it."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_states(states)
    mapping = replace(Bench.nominal(), effects=(DEADBAND,)).to_mapping()
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(mapping))
    words = ["--windows", 20, "--out", tmp_path / "out.yaml", "--json", tmp_path / "table.json"]
    assert status_of(learn.main, tmp_path / "bag", "--bench", tmp_path / "bench.yaml", *words) == 0
    assert "NOT fit for the filter" in capsys.readouterr().out
    assert status_of(validate.main, tmp_path / "bag", "--model", tmp_path / "out.yaml") == 0
    printed = capsys.readouterr().out
    assert "NOT fit for the filter" in printed.splitlines()[-1] and "load_force" in printed
    found = Bench.load(tmp_path / "out.yaml")
    assert "more than 3" in found.unfit and (tmp_path / "table.json").exists()
    assert replace(found, viscous_friction=61.0).unfit == ""
    assert bench_file.digest(yaml.safe_load((tmp_path / "out.yaml").read_text())) == found.digest
    assert replace(found, learned=None).digest == found.digest


@pytest.mark.study
def test_the_usual_effects_are_learnt_where_a_file_names_none() -> None:
    """The default truth from the bare bench file, in a minute: predictions are at the noise, numbers are its own."""
    states = record_offline(truth_from_mapping({"profile": "default"}), draw(60.0, 11), seed=11).states
    result = bench_learning.learn(Bench.nominal(), recordings.split({"one": states}))
    found = {one.name: one.value for one in result.parameters}
    assert found["spring_stiffness.ratio"] == pytest.approx(1.0, abs=2e-3)
    assert found["friction_coulomb.force"] == pytest.approx(12.0, rel=0.02)
    assert found["leakage_internal.coefficient"] == pytest.approx(1e-13, rel=0.01)
    assert found["valve_lag.bandwidth"] == pytest.approx(110.0, rel=0.03)
    assert found["sensor_lag sensor=load_force.bandwidth"] == pytest.approx(25.0, rel=0.02)
    assert result.quality.over_noise < 1.1 and result.quality.unfit == ""


def test_a_bench_file_predicts_what_the_box_makes_of_its_readings(data: recordings.Data) -> None:
    """On the truth itself: rates and readings of a prediction are off by little more than noise, the position by um."""
    effects = (
        {"id": "spring_stiffness", "parameters": {"ratio": 1.6}},
        {"id": "valve_deadband", "parameters": {"half_width": 3e-4}},
    )
    predictor = BenchPrediction(replace(Bench.nominal(), effects=effects), data.validation)
    run = data.validation[0]
    starts = np.arange(700, len(run) - 71, 100)
    predicted = predictor.predict(predictor.estimate(run)[starts], run.u[starts[:, None] + np.arange(70)])
    error = predicted - run.x[starts[:, None] + np.arange(1, 71)]
    noise = noise_of([run])
    rates = 0.4 * np.sqrt(2.0) * noise[:2] / 1e-3  # the differentiator takes two fifths of each difference
    left = np.sqrt(np.mean(error**2, axis=(0, 1)))
    assert (left[[0, 2, 4, 5]] < 1.3 * noise[:4]).all() and left[6] < 3e-6 and predictor.quality.unfit == ""
    assert (left[[1, 3]] < 2.0 * rates).all()
