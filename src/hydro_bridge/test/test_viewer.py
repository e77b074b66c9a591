# SPDX-License-Identifier: Apache-2.0
"""A recording as a page: nothing is lost of what a screen shows, memory is bounded, and what happened is marked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hydro_bridge.bags.cdr import STATE_TYPE, encode_states
from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.bags.schema import definition
from hydro_bridge.dashboard.series import LAW_TYPE, STATE_COLUMNS
from hydro_bridge.signals import Flag
from hydro_bridge.viewer.growing import JUMP, GrowingThinner
from hydro_bridge.viewer.marks import MARKS, Mark, Marks
from hydro_bridge.viewer.page import rendered
from hydro_bridge.viewer.recorded import read_recorded, within
from hydro_bridge.viewer.sample_clock import SampleClock
from hydro_bridge.viewer.view import main

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


def training(time: float, **said: float) -> dict[str, float]:
    """A TrainingStatus."""
    return {"time": time, "phase": 1, "episode": 0, "force_rmse": 12.34, "episode_return": -5.0, "learner_alive": True,
            **said}  # fmt: skip


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


def test_a_slot_without_samples_stays_empty_and_an_unbelievable_stamp_is_left_out() -> None:
    thinner = GrowingThinner(1, 0.0, limit=1024)
    thinner.add(np.array([0.001, 0.051]), np.array([[1.0], [2.0]]))
    thinner.add(np.array([-1.0, 2 * JUMP]), np.array([[9.0], [9.0]]))
    slots = thinner.values(0.0)[:, 0, 1]
    assert slots[0] == 1.0 and slots[5] == 2.0 and np.isnan(slots[1:5]).all() and len(slots) == 6
    assert thinner.left_out == 2


def test_what_the_flags_tell_is_marked_at_its_sample(bag: Path, states) -> None:
    found = read_recorded(bag)
    assert [(mark.kind, mark.text) for mark in found.marks] == [("armed", "armed"), ("trip", "tripped: force limit")]
    assert [mark.time for mark in found.marks] == pytest.approx([1.0, 3.0], abs=1e-3)
    force = [column.name for column in STATE_COLUMNS].index("force")
    table = found.values[0][:, force]
    assert table[:, 1].max() == pytest.approx(states["load_force"].max(), rel=1e-6)
    assert table[:, 0].min() == pytest.approx(states["load_force"].min(), rel=1e-6)
    assert any("episodes" in note for note in found.notes), "it says what it lacks"


def test_a_part_of_it_counts_from_the_begin_of_the_part(bag: Path) -> None:
    found = read_recorded(bag, (2.0, 3.5))
    assert found.seconds == pytest.approx(1.5, abs=2e-3)
    assert [mark.kind for mark in found.marks] == ["armed", "trip"]
    assert found.marks[0].text == "armed already when the recording begins"
    assert found.marks[1].time == pytest.approx(1.0, abs=2e-3)
    with pytest.raises(RecordingError, match="no samples from 60"):
        read_recorded(bag, (60.0, 70.0))


def test_episodes_examinations_rollbacks_and_overrides_are_marked_once_each() -> None:
    marks = Marks()
    for n, said in enumerate([{}, {"episode": 1}, {"episode": 1, "phase": 2}, {"episode": 1, "learner_alive": False}]):
        marks.training(training(float(n), **said))
    quiet = {"rollbacks": "0", "override": "no", "examination": "none yet"}
    for n, said in enumerate([{}, {}, {"rollbacks": "1"}, {"override": "K_p 60"}, {}]):
        marks.diagnostics(10.0 + n, "trainer", {**quiet, **said})
    marks.diagnostics(20.0, "filter", {"rollbacks": "7"})
    told = [(mark.time, mark.kind) for mark in marks.sorted()]
    assert told[:4] == [(1.0, "episode"), (2.0, "examination"), (3.0, "examination"), (3.0, "learner")]
    assert (12.0, "rollback") in told and [time for time, kind in told if kind == "override"] == [13.0, 14.0]
    assert marks.sorted()[0].text == "episode 1; the last one: RMSE 12.3 N, return -5"


def test_weights_are_marked_where_they_change_after_a_second_of_rest_with_how_often_they_did() -> None:
    steps = np.zeros(1200, [("time", "f8"), ("weights", "u8")])
    steps["time"] = 100.0 + 0.01 * np.arange(1200)
    steps["time"][900:] += 20.0  # an examination: no steps
    steps["weights"][:300] = 0xA
    steps["weights"][300:] = 0x100 + np.arange(900) // 2  # learning changes them 50 times a second
    marks = Marks()
    for part in np.split(steps, [0, 137, 300, 301, 900]):
        marks.steps(part)
    assert [(mark.time, mark.text) for mark in marks.sorted()] == [
        (100.0, "weights 00000000000a, the first to act"),
        (103.0, "weights 000000000100, 1 change since the mark before"),
        (129.0, "weights 00000000022c, 300 changes since the mark before"),
    ]


def test_calls_are_marked_with_their_answer_and_of_the_log_only_warnings(tmp_path: Path, states) -> None:
    begin = float(states["time"][0])
    said = [(20, "bridge.calls", "somebody: armed"), (20, "bridge", "guard"), (30, "filter", "it does not fit")]
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(states)
        writer.add_topic("/rosout", LOG_TYPE)
        for n, (level, name, sentence) in enumerate(said):
            sec, nanosec = divmod(round((begin + 2.0 + n) * 1e9), 10**9)
            message = LOG(STAMP(sec, nanosec), level, name, sentence, "", "", 0)
            writer.write("/rosout", bytes(STORE.serialize_cdr(message, LOG_TYPE)), sec * 10**9 + nanosec)
    marks = [mark for mark in read_recorded(tmp_path / "run").marks if mark.kind in ("call", "log")]
    assert [(mark.kind, mark.text) for mark in marks] == [
        ("call", "bridge was asked: somebody: armed"),
        ("log", "filter: it does not fit"),
    ]
    assert [mark.time for mark in marks] == pytest.approx([2.0, 4.0], abs=1e-3)


def test_the_compensated_law_is_shown_where_it_acted(tmp_path: Path, states) -> None:
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition(LAW_TYPE).text, LAW_TYPE))
    message, header = types.types[LAW_TYPE], types.types["std_msgs/msg/Header"]
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(states)
        writer.add_topic("/hydro/law_state", LAW_TYPE)
        for k in range(2000, 3000):
            stamp = round(float(states["time"][k]) * 1e9)
            told = header(types.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "")
            acting = message(told, int(states["sequence"][k]), 1, 250.0, 0.0, 1.0, 0.03, 4e-4, -2.0, 0.3, 1.0)
            writer.write("/hydro/law_state", bytes(types.serialize_cdr(acting, LAW_TYPE)), stamp)
    laws = read_recorded(tmp_path / "run").values[2]
    assert np.isnan(laws[:199]).all() and len(laws) == 300
    assert laws[250, :, 1] == pytest.approx([250.0, 100.0, 30.0, 40.0, -2.0])
    assert rendered(read_recorded(tmp_path / "run")).count('id="laws"') == 1


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


def test_a_report_is_matched_by_the_first_sample_and_not_by_the_folder(bag: Path, states) -> None:
    found = report(bag.parent, {"another name": [[2.5, 3.0]], "run": [[1.0, 2.0]]})
    begin = float(states["time"][0])
    content = json.loads(found.read_text())
    content["recordings"] = [{"name": "another name", "begin": begin}, {"name": "run", "begin": begin - 3600.0}]
    found.write_text(json.dumps(content))
    marks = [mark for mark in read_recorded(bag, report=found).marks if mark.kind == "window"]
    assert [mark.time for mark in marks] == [pytest.approx(2.5)]


@pytest.mark.parametrize(
    ("recordings", "marked"),
    [
        ([("another name", 0.0), ("run", 0.0)], [1.0]),  # they begin alike: the name decides
        ([("run", 0.0), ("run", -60.0)], []),  # one name, two recordings: whose the windows are is open
    ],
)
def test_windows_that_may_be_another_recordings_are_not_marked(
    bag: Path, states, recordings: list[tuple[str, float]], marked: list[float]
) -> None:
    found = report(bag.parent, {"another name": [[2.5, 3.0]], "run": [[1.0, 2.0]]})
    begin = float(states["time"][0])
    told = [{"name": name, "begin": begin + since} for name, since in recordings]
    found.write_text(json.dumps(json.loads(found.read_text()) | {"recordings": told}))
    marks = [mark.time for mark in read_recorded(bag, report=found).marks if mark.kind == "window"]
    assert marks == pytest.approx(marked)


def test_a_clock_in_real_time_leaves_stamps_as_they_are_however_long_no_sample_comes() -> None:
    clock = SampleClock()
    clock.see(np.array([1000, 1001], np.int64) * 10**9, np.array([1000.0, 1001.5]))  # a burst: half again as fast
    assert clock.at(1060.0, 1060.01) == 1060.0


def test_a_clock_off_real_time_moves_what_the_wall_clock_has_stamped() -> None:
    clock = SampleClock()
    clock.see(np.array([1000, 1001], np.int64) * 10**9, np.array([0.0, 10.0]))
    assert clock.at([1002.0, 25.0], [1002.0, 1002.0]) == pytest.approx([20.0, 25.0])


def test_words_of_a_simulation_off_real_time_stand_where_its_samples_were(tmp_path: Path, states) -> None:
    """Ten times real time: 5 s of samples are logged within half a second, an hour after their stamps."""
    begin = float(states["time"][0])
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/hydro/state", STATE_TYPE)
        writer.add_topic("/rosout", LOG_TYPE)
        for n, row in enumerate(encode_states(states)):
            logged = round((begin + 3600.0 + 1e-4 * n) * 1e9)
            writer.write("/hydro/state", row.tobytes(), logged)
            if n == 3000:
                sec, nanosec = divmod(logged, 10**9)
                word = LOG(STAMP(sec, nanosec), 30, "sim", "look", "", "", 0)
                writer.write("/rosout", bytes(STORE.serialize_cdr(word, LOG_TYPE)), logged)
    assert [mark.time for mark in read_recorded(tmp_path / "run").marks if mark.kind == "log"] == [
        pytest.approx(3.0, abs=0.01)
    ]


@pytest.mark.parametrize("content", ["{", "[]", '{"location": [{"windows": {"run": [[1]]}}]}'])
def test_what_is_no_report_is_refused_in_a_sentence(bag: Path, content: str) -> None:
    (bag.parent / "report.json").write_text(content)
    with pytest.raises(RecordingError, match="is no report of a diagnosis"):
        read_recorded(bag, report=bag.parent / "report.json")


def test_a_diagnosis_that_found_nothing_marks_nothing(bag: Path) -> None:
    (bag.parent / "report.json").write_text('{"location": []}')
    assert [mark.kind for mark in read_recorded(bag, report=bag.parent / "report.json").marks] == ["armed", "trip"]


def test_marks_are_bounded(make_states) -> None:
    marks, flicker = Marks(), make_states(MARKS + 100)
    flicker["flags"] = np.arange(len(flicker)) % 2 * ARMED
    marks.states(flicker)
    assert len(marks.sorted()) == MARKS
    assert marks.dropped == 99


def test_the_page_loads_nothing_and_escapes_what_the_recording_says(bag: Path) -> None:
    page = rendered(read_recorded(bag))
    assert "sha256:&lt;1&gt;" in page and "<1>" not in page
    assert 'src="http' not in page and 'href="http' not in page
    assert "default-src &#39;none&#39;" in page


def test_a_recording_without_samples_of_a_bench_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run"):
        pass
    with pytest.raises(RecordingError, match="no samples on /hydro/state to show; there is nothing"):
        read_recorded(tmp_path / "run")


def test_a_topic_of_another_type_is_left_out_and_said(bag: Path, tmp_path: Path, states) -> None:
    with BagWriter(tmp_path / "other") as writer:
        writer.write_states(states[:100])
        writer.write_states(states[:100], "/hydro/training")
        writer.write_states(states[:100], "/hydro/authority")
    notes = read_recorded(tmp_path / "other").notes
    assert sum("of another version or type" in note for note in notes) == 2


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Exit status of the command."""
    monkeypatch.setattr("sys.argv", ["view", *words, "--no-open"])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_the_page_stands_beside_the_recording(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, str(bag)) == 0
    assert "tripped: force limit" in (bag.parent / "run.html").read_text()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--from", "3", "--to", "2"], "the end must come behind the begin"),
        (["--from", "soon"], "seconds from the first sample"),
        (["--from", "60"], "no samples from 60"),
    ],
)
def test_what_makes_no_page_is_refused_and_leaves_nothing(
    bag: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    assert run(monkeypatch, str(bag), *words) == 2
    assert sentence in capsys.readouterr().err
    assert not (bag.parent / "run.html").exists()


def test_a_part_begins_with_who_commanded_then() -> None:
    marks = [Mark(1.0, "authority", "a"), Mark(2.0, "trip", "b"), Mark(3.0, "authority", "c"), Mark(6.0, "trip", "d")]
    part = within(marks, 2.5, 1.0)
    assert [(mark.time, mark.text) for mark in part] == [(0.0, "a"), (0.5, "c")]
