# SPDX-License-Identifier: Apache-2.0
"""A recording as a page: nothing is lost of what a screen shows, memory is bounded, and what happened is marked."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.dashboard.series import SLOT, STATE_COLUMNS, GrowingThinner, Thinner
from hydro_bridge.ros.topics import GRAPH
from hydro_bridge.signals import STATE_DTYPE, Flag
from hydro_bridge.viewer.runs import ORDERS, list_runs, refresh_index, write_index
from hydro_bridge.viewer.view import main, read_recorded, rendered
from tests import browser
from tests.checks import status_of

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
    """What matters here of a report.json: `hydro_diagnosis.report_json.Location`."""
    location = [{"equation": "motion", "sentence": "friction", "windows": windows}]
    (folder / "report.json").write_text(json.dumps({"location": location}))
    return folder / "report.json"


def test_windows_of_a_diagnosis_are_marked_where_its_report_lies_beside(bag: Path) -> None:
    found = report(bag.parent, {"run": [[2.5, 3.0]], "another": [[1.0, 2.0]]})
    marks = [mark for mark in read_recorded(bag, report=found).marks if mark.kind == "window"]
    assert [(mark.time, mark.text) for mark in marks] == [(pytest.approx(2.5), "motion, for 0.50 s: friction")]
    assert status_of(main, bag, "--no-open") == 0
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


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    folder = tmp_path / "runs"
    for name in ("old & <bold>", "found", "broken", "nothing", "tuesday"):
        (folder / name).mkdir(parents=True)
    events = [{"kind": "episode", "force_rmse": 20.0}, {"kind": "episode", "force_rmse": 12.34},
              {"kind": "exam", "score": 0.4, "best": True}, {"kind": "exam", "score": 0.3, "best": False},
              {"kind": "end", "sentence": "Ended by Ctrl-C."}]  # fmt: skip
    (folder / "old & <bold>" / "run.json").write_text(json.dumps({"events": events}))
    (folder / "old & <bold>" / "tracking.png").write_bytes(b"")
    (folder / "old & <bold>" / "bag").mkdir()
    (folder / "old & <bold>" / "bag" / "metadata.yaml").write_text("")
    report = {"verdict": "partly_explained", "effects": [{"id": "spring_stiffness"}]}
    (folder / "found" / "report.json").write_text(json.dumps(report))
    (folder / "found" / "report.html").write_text("")
    (folder / "broken" / "run.json").write_text("{")
    (folder / "tuesday" / "metadata.yaml").write_text("")
    (folder / "tuesday.html").write_text("")
    for age, name in enumerate(("found", "broken", "tuesday", "old & <bold>")):
        for path in (*(folder / name).iterdir(), folder / name):
            os.utime(path, (1e9 - age, 1e9 - age))
    return folder


def test_each_run_is_told_with_its_summary_the_newest_first(runs: Path) -> None:
    found = {entry.name: entry for entry in list_runs(runs)}
    assert list(found) == ["found", "broken", "tuesday", "old & <bold>"]
    assert found["found"].summary == "partly explained: spring stiffness"
    assert found["found"].pages == ("found/report.html",)
    assert found["old & <bold>"].summary == "2 episodes, the last one with an RMSE of 12.3 N. Ended by Ctrl-C."
    assert found["old & <bold>"].recordings == ("old & <bold>/bag",)
    assert found["tuesday"].kind == "recording"
    assert found["tuesday"].pages == ("tuesday.html",) and not found["tuesday"].recordings
    assert min(found.values(), key=ORDERS["score"]).name == "old & <bold>"
    assert found["old & <bold>"].score == 0.4 and found["broken"].score is None
    assert found["broken"].kind == "training" and not found["broken"].summary


def test_names_are_escaped_and_addresses_lead_to_files(runs: Path) -> None:
    page = write_index(runs).read_text()
    assert "old &amp; &lt;bold&gt;" in page and "<bold>" not in page
    assert 'src="old%20%26%20%3Cbold%3E/tracking.png"' in page


def test_a_page_of_somebody_else_is_left_alone(runs: Path) -> None:
    (runs / "index.html").write_text("the site")
    refresh_index(runs / "found")
    with pytest.raises(FileExistsError, match="another page than one of runs"):
        write_index(runs)
    assert (runs / "index.html").read_text() == "the site"


LAYOUTS = Path(__file__).parents[1] / "layouts"


def fields(topic: str) -> set[str]:
    """Of the topic's message."""
    return set(GRAPH[topic][0].get_fields_and_field_types())


def placed(layout: str | dict[str, Any]) -> list[str]:
    """Panels in a tree of panels."""
    return [layout] if isinstance(layout, str) else placed(layout["first"]) + placed(layout["second"])


def test_what_foxglove_plots_is_in_the_messages_and_each_panel_has_one_place() -> None:
    content = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    assert sorted(placed(content["layout"])) == sorted(content["configById"])
    paths = [path["value"] for panel in content["configById"].values() for path in panel.get("paths", ())]
    assert len(paths) > 10
    for path in paths:
        topic, field = path.rsplit(".", 1)
        assert field in fields(topic), path
    whole = [panel.get("topicPath") or panel.get("topicToRender") for panel in content["configById"].values()]
    assert all(topic in GRAPH for topic in whole if topic)


def test_what_plotjuggler_plots_is_in_the_messages() -> None:
    root = ElementTree.fromstring((LAYOUTS / "plotjuggler.xml").read_bytes())
    curves = [str(curve.get("name")) for curve in root.iter("curve")]
    assert len(curves) > 10
    for curve in curves:
        topic, field = curve.rsplit("/", 1)
        assert field in fields(topic), curve
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.get("count", 0)) == len(str(splitter.get("sizes")).split(";"))


@pytest.mark.skipif(bool(browser.MISSING), reason=browser.MISSING)
def test_in_a_browser_it_opens_from_disk_loads_nothing_and_the_slider_shows_its_time(tmp_path: Path) -> None:
    """30 s: force 100 N + 1 N/s; armed from 10 s on, tripped at 20 s."""
    states = np.zeros(30_000, STATE_DTYPE)
    states["time"] = 1_700_000_000.0 + 1e-3 * np.arange(len(states))
    states["sequence"] = np.arange(len(states))
    states["load_force"] = 100.0 + 1e-3 * np.arange(len(states))
    states["flags"][10_000:20_000] = ARMED
    states["flags"][20_000:] = TRIPPED | int(Flag.FORCE_LIMIT)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_states(states)
    (tmp_path / "bag.html").write_text(rendered(read_recorded(tmp_path / "bag")), encoding="utf-8")
    slide = "const s = document.getElementById('time'); s.value = {}; s.dispatchEvent(new Event('input'))"
    with browser.browser(tmp_path / "profile") as page:
        page.open((tmp_path / "bag.html").as_uri())
        page.wait("document.getElementById('state').textContent == 'disarmed'", 120.0)  # once the data are unpacked
        assert "0.00 s of 30.0" in page.text("at").replace("29.99", "30.0").replace("30.00", "30.0")
        assert not page.driver.get_log("browser")
        loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
        assert all(name.startswith("data:") for name in loaded)
        page.run(slide.format(15.0))
        page.wait("document.getElementById('state').textContent == 'ARMED'")
        force = float(page.run("return document.querySelector('.plot b').textContent"))
        assert force == pytest.approx(115.0, abs=1.0)
        page.run(slide.format(25.0))
        page.wait("document.getElementById('state').textContent == 'TRIPPED'")
