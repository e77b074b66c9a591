# SPDX-License-Identifier: Apache-2.0
"""What is trained on and what validates share no sample; runs do not cross gaps."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import STATE_DTYPE, Flag, StateArray
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import drawn as schedule
from hydro_sim.files import recordings
from hydro_sim.files.recordings import DataError, Run


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
    return record_offline(profile("default"), schedule.draw(24.0, 5), seed=5)


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
