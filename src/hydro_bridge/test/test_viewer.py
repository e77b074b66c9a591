# SPDX-License-Identifier: Apache-2.0
"""A recording as a page: nothing is lost of what a screen shows, memory is bounded, and what happened is marked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.dashboard.series import STATE_COLUMNS
from hydro_bridge.dashboard.thinning import SLOT, GrowingThinner, Thinner
from hydro_bridge.signals import Flag
from hydro_bridge.viewer.recorded import read_recorded
from hydro_bridge.viewer.view import main, rendered

STORE = get_typestore(Stores.ROS2_JAZZY)
LOG_TYPE = "rcl_interfaces/msg/Log"
LOG, STAMP = STORE.types[LOG_TYPE], STORE.types["builtin_interfaces/msg/Time"]
ARMED, TRIPPED = int(Flag.ARMED), int(Flag.TRIPPED)


@pytest.fixture
def states(make_states):
    """5 s: armed from 1 s on, tripped by the force limit at 3 s, disarmed by hand at 4 s."""
    made = make_states(5000)
    made["flags"] = 0
    made["flags"][1000:3000] = ARMED
    made["flags"][3000:4000] = TRIPPED | int(Flag.FORCE_LIMIT)
    return made


@pytest.fixture
def bag(tmp_path: Path, states) -> Path:
    folder = tmp_path / "run"
    with BagWriter(folder, metadata={"weights": "sha256:<1>"}) as writer:
        writer.write_states(states)
    return folder


def test_a_pulse_of_one_sample_stays_at_every_length_and_memory_does_not_grow() -> None:
    thinner = GrowingThinner(1, 100.0, limit=64)
    for second in range(50):
        times = 100.0 + second + 1e-3 * np.arange(1000)
        values = np.zeros((1000, 1))
        values[500] = float(second)
        thinner.add(times, values)
    slots = thinner.values(0.0)
    assert thinner.slot == pytest.approx(1.28), "7 times twice 10 ms: 50 s in 64 slots"
    assert len(slots) == 40
    peaks = [slots[int((second + 0.5) / thinner.slot), 0, 1] for second in range(0, 50, 2)]
    assert all(peak >= second for peak, second in zip(peaks, range(0, 50, 2), strict=True))
    assert (slots[:, 0, 0] == 0.0).all()


def test_what_the_flags_tell_is_marked_at_its_sample(bag: Path, states) -> None:
    found = read_recorded(bag)
    assert [(mark.kind, mark.text) for mark in found.marks] == [("armed", "armed"), ("trip", "tripped: force limit")]
    assert [mark.time for mark in found.marks] == pytest.approx([1.0, 3.0], abs=1e-3)
    force = [column.name for column in STATE_COLUMNS].index("force")
    table = found.values[0][:, force]
    assert table[:, 1].max() == pytest.approx(states["load_force"].max(), rel=1e-6)
    assert table[:, 0].min() == pytest.approx(states["load_force"].min(), rel=1e-6)
    assert any("episodes" in note for note in found.notes), "it says what it lacks"


def report(folder: Path, windows: dict[str, list[list[float]]]) -> Path:
    """What matters here of a report.json: `hydro_diagnosis.findings.Location`."""
    location = [{"equation": "motion", "sentence": "friction", "windows": windows}]
    (folder / "report.json").write_text(json.dumps({"location": location}))
    return folder / "report.json"


def test_windows_of_a_diagnosis_are_marked_where_its_report_lies_beside(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = report(bag.parent, {"run": [[2.5, 3.0]], "another": [[1.0, 2.0]]})
    marks = [mark for mark in read_recorded(bag, report=found).marks if mark.kind == "window"]
    assert [(mark.time, mark.text) for mark in marks] == [(pytest.approx(2.5), "motion, for 0.50 s: friction")]
    assert run(monkeypatch, str(bag)) == 0
    assert "motion, for 0.50 s: friction" in (bag.parent / "run.html").read_text()


def test_the_page_loads_nothing_and_escapes_what_the_recording_says(bag: Path) -> None:
    page = rendered(read_recorded(bag))
    assert "sha256:&lt;1&gt;" in page and "<1>" not in page
    assert 'src="http' not in page and 'href="http' not in page
    assert "default-src &#39;none&#39;" in page


def test_a_recording_without_samples_of_a_bench_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run"):
        pass
    with pytest.raises(RecordingError, match="no messages on /hydro/state; there is nothing"):
        read_recorded(tmp_path / "run")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next((tmp_path / "run").glob("*.mcap")).read_bytes()[:40])
    with pytest.raises(RecordingError, match="it was cut off before the end of its first block"):
        read_recorded(cut)


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Exit status of the command."""
    monkeypatch.setattr("sys.argv", ["view", *words, "--no-open"])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


START = 1_000_000 * SLOT


def samples(count: int, start: float = START) -> tuple[np.ndarray, np.ndarray]:
    times = start + 1e-3 * (np.arange(count) + 0.5)
    return times, np.random.default_rng(count).standard_normal((count, 2))


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=20))
def test_least_and_greatest_of_each_slot_however_samples_come_in(parts: list[int]) -> None:
    count = sum(parts)
    times, values = samples(count)
    thinner, begin, taken = Thinner(2), 0, []
    for part in parts:
        thinner.add(times[begin : begin + part], values[begin : begin + part])
        begin += part
        taken.append(thinner.take().values)
    got = np.concatenate(taken)
    closed = (count - 1) // 10
    blocks = values[: 10 * closed].reshape(closed, 10, 2)
    np.testing.assert_allclose(got[..., 0], blocks.min(axis=1), rtol=1e-6)
    np.testing.assert_allclose(got[..., 1], blocks.max(axis=1), rtol=1e-6)


def test_a_clock_that_was_set_begins_the_series_anew_and_old_samples_are_left_out() -> None:
    thinner = Thinner(2)
    times, values = samples(100)
    thinner.add(times, values)
    thinner.add(times[:20], 100.0 + values[:20])
    assert thinner.take().values.max() < 50.0
    thinner.add(times - 3600.0, values)
    assert thinner.take().first == round(START / SLOT) - 360_000
