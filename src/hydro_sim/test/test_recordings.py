# SPDX-License-Identifier: Apache-2.0
"""What is trained on and what validates share no sample; runs do not cross gaps."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.files import bench_file
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import STATE_DTYPE, Flag, StateArray
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import draw
from hydro_sim.files import recordings, weights
from hydro_sim.files.learned_bench import load_model
from hydro_sim.files.pairing import BoxIdentity, MadeFor, header_of, mismatch, read_provenance, with_provenance
from hydro_sim.files.recordings import DataError, Run
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import Quality


def recording(samples: int) -> StateArray:
    states = np.zeros(samples, STATE_DTYPE)
    states["sequence"] = np.arange(samples)
    return states


def span(run: Run) -> tuple[int, int]:
    return run.first, run.first + len(run)


@pytest.mark.parametrize("samples", [4000, 4500, 6500, 7000, 13_000, 20_000, 62_000])
def test_validation_begins_a_second_after_training_ends(samples: int) -> None:
    data = recordings.split({"one": recording(samples)})
    (training,), (validation,) = data.training, data.validation
    assert span(training)[0] == 0 and span(validation)[1] == samples
    assert span(validation)[0] - span(training)[1] == 1000
    assert len(training) >= 2000 and len(validation) >= 1000


def test_a_recording_too_short_to_share_is_refused_in_a_sentence() -> None:
    with pytest.raises(DataError, match=r"3999 samples, too few to hold some back .* one with 4000 samples in a row"):
        recordings.split({"one": recording(3999)})


@pytest.fixture(scope="module")
def recorded():
    return record_offline(profile("default"), draw(24.0, 5), seed=5)


def test_runs_do_not_cross_gaps_or_faults(recorded):
    states = np.delete(recorded.states, [5000, 5001])
    states["flags"][12000] |= np.uint32(Flag.SENSOR_FAULT)
    states["load_force"][15000] = np.nan
    found = recordings.runs("r", states)
    assert [(run.first, len(run)) for run in found] == [
        (0, 5000),
        (5000, 7000),
        (12001, 2999),
        (15001, len(states) - 15001),
    ]


def test_the_law_that_the_box_told_last_counts(tmp_path: Path) -> None:
    told = (BoxLaw(), replace(BoxLaw(base_kp=2800.0), coefficient_min=(0.5, -0.5, 0.0, -8.0)), None)
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


def test_one_reading_far_off_or_a_poor_mean_is_unfit_and_noise_alone_is_not() -> None:
    quality = Quality.of([1.0, 1.0, 1.0, 1.0, 240.0])
    assert quality.over_noise < 3.0 and quality.worst == 240.0
    assert "240 times the noise of piston_position, more than 10" in quality.unfit
    assert "4 times the noise, more than 3" in Quality.of([4.0] * 5).unfit
    assert Quality.of([1.0, 1.0, 1.0, 1.0, 2.4]).unfit == ""


def test_the_filter_refuses_a_file_by_its_worst_reading(tmp_path: Path) -> None:
    bench = Bench.nominal()
    learned = {"bench": bench.digest, **Quality.of([1.0, 1.0, 1.0, 1.0, 240.0]).to_mapping()}
    file = tmp_path / "learnt.yaml"
    file.write_text(yaml.safe_dump(replace(bench, learned=learned).to_mapping()), encoding="utf-8")
    with pytest.raises(ValueError, match="240 times the noise of piston_position"):
        load_model(file)
    learned["worst"] = 2.0
    file.write_text(yaml.safe_dump(replace(bench, learned=learned).to_mapping()), encoding="utf-8")
    assert isinstance(load_model(file), Bench)


BOX = BoxIdentity(digest="a", source="a.yaml", base_gains=(15.0, 5.0), integral="bumpless")


def test_a_digest_is_of_the_numbers_not_of_how_they_are_written(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("# another comment\n" + yaml.safe_dump(bench.to_mapping(), sort_keys=True).replace("80.0", "80"))
    assert Bench.load(path).digest == bench.digest == bench_file.digest(bench_file.read_numbers(path))
    assert replace(bench, spring_stiffness=20000).digest == bench.digest
    assert replace(bench, spring_stiffness=20000.1).digest != bench.digest
    assert replace(bench, load_cell_bandwidth=None).digest != bench.digest


def test_what_was_made_for_this_box_fits_and_each_difference_is_one_sentence() -> None:
    made = MadeFor(box="a", model="m", base_kp=15.0, base_ki=5.0, integral="bumpless")
    assert mismatch("it", made, BOX, "remedy", model="m") == ""
    assert mismatch("it", replace(made, base_kp=None, base_ki=None, integral=""), BOX, "remedy", model="m") == ""
    assert mismatch("it", None, BOX, "remedy") == "it does not say which bench it was made for: remedy"
    for wrong, sentence in (
        (replace(made, box="b"), "it was made for bench b, the box believes a (a.yaml): remedy"),
        (replace(made, model="n"), "it was made for model n, it is to be used with model m: remedy"),
        (replace(made, base_ki=8.0), "it was made for a box with base K_i 8, this one has 5: remedy"),
        (replace(made, integral="paper"), "it was made for the paper integral, the box runs the bumpless one: remedy"),
    ):
        assert mismatch("it", wrong, BOX, "remedy", model="m") == sentence


def test_a_stamp_changes_no_tensor(tmp_path: Path) -> None:
    path, made = tmp_path / "metric.safetensors", MadeFor(box="b", model="m", base_kp=1.0, base_ki=2.0, any_bench=True)
    tensors = {"center": np.arange(3.0), "table": np.eye(2)}
    weights.save(path, tensors, {"structure": "metric"}, MadeFor(box="a"))
    path.write_bytes(with_provenance(path.read_bytes(), made))
    assert read_provenance(path) == made
    after = weights.load(path)[0]
    assert all(np.array_equal(tensors[name], after[name]) for name in after) and after.keys() == tensors.keys()
    path.write_bytes(with_provenance(path.read_bytes(), None))
    assert read_provenance(path) is None
    with pytest.raises(ValueError, match="no readable entry"):
        header_of(b"nonsense")
