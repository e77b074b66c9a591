# SPDX-License-Identifier: Apache-2.0
"""What is trained on and what validates share no sample; what a bench file names is learnt from recordings of it."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.files import bench_digest
from hydro_core.signals import STATE_DTYPE, Flag, StateArray
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile, truth_from_mapping
from hydro_sim.excitation import draw_schedule
from hydro_sim.files import recordings
from hydro_sim.files.learned_bench import load_model
from hydro_sim.files.pairing import BoxIdentity, Provenance, mismatch
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import bench_learning, learn, validate
from hydro_sim.identification.bench_states import Sensitivities, StateEstimator, estimate_noise
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.quality import Quality
from tests.checks import status_of


def recording(samples: int) -> StateArray:
    states = np.zeros(samples, STATE_DTYPE)
    states["sequence"] = np.arange(samples)
    return states


@pytest.mark.parametrize("samples", [4000, 4500, 6500, 7000, 13_000, 20_000, 62_000])
def test_validation_begins_a_second_after_training_ends(samples: int) -> None:
    data = recordings.split({"one": recording(samples)})
    (training,), (validation,) = data.training, data.validation
    assert training.first == 0 and validation.first + len(validation) == samples
    assert validation.first - len(training) == 1000
    assert len(training) >= 2000 and len(validation) >= 1000


def test_a_recording_too_short_to_share_is_refused_in_a_sentence() -> None:
    with pytest.raises(DataError, match=r"3999 samples: .* one with 4000 in a row"):
        recordings.split({"one": recording(3999)})


def test_runs_do_not_cross_gaps_or_faults():
    states = np.delete(recording(24_000), [5000, 5001])
    states["flags"][12000] |= np.uint32(Flag.SENSOR_FAULT)
    states["load_force"][15000] = np.nan
    found = recordings.split_runs("r", states)
    assert [(run.first, len(run)) for run in found] == [(0, 5000), (5000, 7000), (12001, 2999), (15001, 8997)]


def test_the_law_that_the_box_told_last_counts(tmp_path: Path) -> None:
    told = (BoxLaw(), replace(BoxLaw(base_kp=2800.0), coefficient_min=(0.5, -0.5, 0.0, -8.0, 0.0)), None)
    for count in (1, 2, 3):
        with BagWriter(tmp_path / str(count)) as writer:
            writer.add_topic(recordings.LAW_TOPIC, "hydro_msgs/msg/BoxLaw")
            for second, law in enumerate(told[:count]):
                head = b"\0\1\0\0" + np.array([second, 0, 1], "<u4").tobytes()
                numbers = np.hstack(astuple(law or BoxLaw())).astype("<f8").tobytes()
                writer.write(recordings.LAW_TOPIC, head + bytes((0, law is not None, 0, 0)) + numbers, second * 10**9)
        assert recordings.box_law(tmp_path / str(count)) == told[count - 1]
    with pytest.raises(RecordingError, match="no messages on /hydro/box_law"):
        BagWriter(tmp_path / "none").close()
        recordings.box_law(tmp_path / "none")


def test_the_filter_refuses_a_file_by_its_worst_reading(tmp_path: Path) -> None:
    bench = Bench.nominal()
    for worst in (2.0, 240.0):
        learned = {"bench": bench.digest, **Quality.of([1.0, 1.0, 1.0, 1.0, worst]).to_mapping()}
        (tmp_path / f"{worst:g}.yaml").write_text(yaml.safe_dump(replace(bench, learned=learned).to_mapping()))
    assert isinstance(load_model(tmp_path / "2.yaml"), Bench)
    with pytest.raises(ValueError, match="240 times the noise of piston_position"):
        load_model(tmp_path / "240.yaml")


def test_a_digest_is_of_the_numbers_not_of_how_they_are_written(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("# another comment\n" + yaml.safe_dump(bench.to_mapping(), sort_keys=True).replace("80.0", "80"))
    assert Bench.load(path).digest == bench.digest == bench_digest.digest(bench_digest.read_parameters(path))
    assert replace(bench, spring_stiffness=20000).digest == bench.digest
    assert replace(bench, spring_stiffness=20000.1).digest != bench.digest
    assert replace(bench, load_cell_bandwidth=None).digest != bench.digest


def test_what_was_made_for_another_integral_does_not_fit_and_what_is_not_known_does() -> None:
    box = BoxIdentity(digest="a", source="a.yaml", base_gains=(15.0, 5.0), integral="bumpless")
    made = Provenance(box="a", model="m", base_kp=15.0, base_ki=5.0, integral="bumpless")
    unknown, other = replace(made, base_kp=None, base_ki=None, integral=""), replace(made, integral="paper")
    fitting, unsaid, foreign = (mismatch("it", one, box, "remedy", model="m") for one in (made, unknown, other))
    assert fitting == unsaid == "" and "made for the paper integral" in foreign


TRUTH = {
    "profile": "nominal", "bench": {"spring_stiffness": 32000.0}, "effects": {"valve_deadband": {"half_width": 3e-4}},
}  # fmt: skip
SPRING = {"id": "spring_stiffness", "parameters": {"ratio": 1.0}}
DEADBAND = {"id": "valve_deadband", "parameters": {"half_width": 5e-5}}
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 0.0}}


@pytest.fixture(scope="module")
def states() -> StateArray:
    return record_offline(truth_from_mapping(TRUTH), draw_schedule(20.0, 3), seed=3).states


@pytest.fixture(scope="module")
def data(states: StateArray) -> recordings.Data:
    return recordings.split({"one": states})


@pytest.mark.study
def test_deadband_spring_and_a_closure_that_is_not_there_are_found(data: recordings.Data) -> None:
    bench = replace(Bench.nominal(), effects=(SPRING, DEADBAND), closures=(DRAG,))
    result = bench_learning.learn(bench, data, count=60)
    ratio, half_width, drag = result.parameters
    assert ratio.value == pytest.approx(1.6, rel=2e-3) and ratio.informed
    assert half_width.value == pytest.approx(3e-4, rel=5e-3) and half_width.low < 3.01e-4 and half_width.high > 2.99e-4
    assert drag.low < 30.0 and drag.high > -30.0
    assert result.quality.over_noise < 1.2
    assert result.bench.effects[0]["parameters"]["ratio"] == pytest.approx(ratio.value, rel=1e-6)
    assert result.bench.closures[0]["form"] == "quadratic drag" and "id" not in result.bench.closures[0]
    assert result.with_quality().rejection_reason == ""


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
    assert "more than 3" in found.rejection_reason and (tmp_path / "table.json").exists()
    assert replace(found, viscous_friction=61.0).rejection_reason == ""
    assert bench_digest.digest(yaml.safe_load((tmp_path / "out.yaml").read_text())) == found.digest
    assert replace(found, learned=None).digest == found.digest


@pytest.mark.study
def test_the_usual_effects_are_learnt_where_a_file_names_none() -> None:
    """The default truth from the bare bench file, in a minute: predictions are at the noise, numbers are its own."""
    states = record_offline(truth_from_mapping({"profile": "default"}), draw_schedule(60.0, 11), seed=11).states
    result = bench_learning.learn(Bench.nominal(), recordings.split({"one": states}))
    found = {one.name: one.value for one in result.parameters}
    assert found["spring_stiffness.ratio"] == pytest.approx(1.0, abs=2e-3)
    assert found["friction_coulomb.force"] == pytest.approx(12.0, rel=0.02)
    assert found["leakage_internal.coefficient"] == pytest.approx(1e-13, rel=0.01, abs=0.0)
    assert found["valve_lag.bandwidth"] == pytest.approx(110.0, rel=0.03)
    assert found["sensor_lag sensor=load_force.bandwidth"] == pytest.approx(25.0, rel=0.02)
    assert result.quality.over_noise < 1.1 and result.quality.rejection_reason == ""


def test_the_shipped_bench_predicts_a_held_out_recording_to_its_noise() -> None:
    states = record_offline(profile("default"), draw_schedule(12.0, 977), seed=977).states
    left, noise = validate.prediction_errors(load_model(), recordings.split_runs("held out", states))
    assert Quality.of((left / noise).tolist()).over_noise < 1.2


def test_estimates_look_only_back(data: recordings.Data) -> None:
    run, model = data.validation[0], BenchModel(load_model())
    estimator = StateEstimator(Sensitivities(model), model.values, estimate_noise([run]), 1.0)
    assert np.array_equal(estimator.states(run)[:2500], estimator.states(run.slice(0, 2500)))
