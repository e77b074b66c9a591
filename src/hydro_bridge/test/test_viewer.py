# SPDX-License-Identifier: Apache-2.0
"""A recording as a page: nothing is lost of what a screen shows, memory is bounded, and what happened is marked."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import Log

from hydro_bridge.bags.recording import BagWriter, RecordingError
from hydro_bridge.pages.marks import MarkCollector
from hydro_bridge.pages.runs import list_runs, refresh_index, write_index
from hydro_bridge.pages.series import BIN_WIDTH, SERIES_COLUMNS, LiveSeries, RecordedSeries
from hydro_bridge.pages.view import RecordingPage, main, render_page
from hydro_bridge.ros.topics import RECORDED_TOPICS
from hydro_core.signals import Flag, StateArray
from hydro_msgs.msg import Authority, TrainingStatus
from tests import browser
from tests.checks import status_of

ARMED, TRIPPED = int(Flag.ARMED), int(Flag.TRIPPED)


@pytest.fixture
def states(make_states):
    """5 s: force 100 N + 1 N/s; armed from 1 s on, tripped by the force limit at 3 s, disarmed by hand at 4 s."""
    made = make_states(5000)
    made["load_force"] = 100.0 + 1e-3 * np.arange(5000)
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
    thinner = RecordedSeries(1, 100.0, limit=64)
    for second in range(50):
        values = np.zeros((1000, 1))
        values[500] = float(second)
        thinner.add(100.0 + second + 1e-3 * np.arange(1000), values)
    bins = thinner.values(0.0)
    assert thinner.bin_width == pytest.approx(1.28), "7 times twice 10 ms: 50 s in 64 bins"
    assert len(bins) == 40
    assert all(bins[int((second + 0.5) / thinner.bin_width), 0, 1] >= second for second in range(50))
    assert (bins[:, 0, 0] == 0.0).all()


def test_flags_and_windows_of_a_diagnosis_beside_it_are_marked_on_a_page_that_loads_nothing(bag, states) -> None:
    windows = {"run": [[2.5, 3.0]], "another": [[1.0, 2.0]]}
    location = [{"equation": "motion", "sentence": "friction", "windows": windows}]
    report = bag.parent / "report.json"
    report.write_text(json.dumps({"location": location, "recordings": [{"name": "run", "begin": states["time"][0]}]}))
    found = RecordingPage(bag, report=report)
    told = ["armed", "motion, for 0.50 s: friction", "tripped: force limit"]
    assert [mark.text for mark in found.marks] == told
    assert [mark.time for mark in found.marks] == pytest.approx([1.0, 2.5, 3.0], abs=1e-3)
    force = found.values[0][:, [column.name for column in SERIES_COLUMNS[0]].index("force")]
    assert force[:, 1].max() == pytest.approx(states["load_force"].max(), rel=1e-6)
    assert force[:, 0].min() == pytest.approx(states["load_force"].min(), rel=1e-6)
    assert found.begin.startswith("2023-11-14 22:13:20") and not found.notes
    assert status_of(main, bag, "--no-open") == 0
    page = (bag.parent / "run.html").read_text()
    assert all(text in page for text in told)
    assert "sha256:&lt;1&gt;" in page and "<1>" not in page
    assert 'src="http' not in page and 'href="http' not in page and "default-src 'none'" in page


def test_messages_of_nodes_are_marked_and_a_part_begins_with_holder_and_weights_of_then() -> None:
    found = MarkCollector()
    found.add_message("/hydro/authority", 1.0, Authority(holder="trainer"))
    found.add_steps(np.array([1.0, 1.1, 3.0, 3.5]), np.array([5, 5, 6, 7]))
    for n, (phase, episode, alive) in enumerate(((1, 1, True), (2, 1, True), (1, 2, True), (1, 2, False))):
        done = TrainingStatus(phase=phase, episode=episode, force_rmse=8.0, episode_return=-3.0, learner_alive=alive)
        found.add_message("/hydro/training", 4.0 + n, done)
    for n, said in enumerate(("no", "K_p 60", "no")):
        values = [KeyValue(key="override", value=said), KeyValue(key="rollbacks", value="0")]
        status = [DiagnosticStatus(name="trainer", values=values), DiagnosticStatus(name="sim", values=values)]
        found.add_message("/diagnostics", 8.0 + n, DiagnosticArray(status=status))
    for level, name in ((20, "trainer"), (30, "trainer"), (20, "sim.calls")):
        found.add_message("/rosout", 11.0, Log(level=level, name=name, msg="arm"))
    assert [(mark.time, mark.kind, mark.text) for mark in found.crop(2.0, 10.0)] == [
        (0.0, "authority", "commanded by trainer"), (0.0, "weights", "weights 000000000005, the first to act"),
        (1.0, "weights", "weights 000000000006"), (3.0, "examination", "evaluating"),
        (4.0, "examination", "examination ends, training"),
        (4.0, "episode", "episode 2; the last one: RMSE 8.0 N, return -3"), (5.0, "learner", "the learner is down"),
        (7.0, "override", "gains by hand: K_p 60"), (8.0, "override", "gains given back"),
        (9.0, "log", "trainer: arm"), (9.0, "call", "sim was asked: arm"),
    ]  # fmt: skip


def test_a_clock_that_was_set_halves_no_page(tmp_path: Path, states: StateArray) -> None:
    whole = len(states) * 1e-3
    states["time"][:3] = 0.0
    states["time"][len(states) // 2 :] -= 3600.0
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(states)
    found = RecordingPage(tmp_path / "run")
    assert found.seconds == pytest.approx(whole, abs=0.01)
    assert len(found.values[0]) == pytest.approx(whole / found.bin_width, abs=2)
    told = [note for note in found.notes if "the clock was set by" in note]
    assert len(told) == 2 and any("by -3600 s" in note or "by -3599.999 s" in note for note in told)


def test_a_recording_without_samples_of_a_bench_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run"):
        pass
    with pytest.raises(RecordingError, match="no messages on /hydro/state; there is nothing"):
        RecordingPage(tmp_path / "run")


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=20))
def test_least_and_greatest_of_each_bin_however_samples_come_in(parts: list[int]) -> None:
    count = sum(parts)
    times = 1_000_000 * BIN_WIDTH + 1e-3 * (np.arange(count) + 0.5)
    values = np.random.default_rng(count).standard_normal((count, 2))
    thinner, begin, taken = LiveSeries(2), 0, []
    for part in parts:
        thinner.add(times[begin : begin + part], values[begin : begin + part])
        begin += part
        taken.append(thinner.poll()[1])
    got = np.concatenate(taken)
    closed = (count - 1) // 10
    blocks = values[: 10 * closed].reshape(closed, 10, 2)
    np.testing.assert_allclose(got[..., 0], blocks.min(axis=1), rtol=1e-6)
    np.testing.assert_allclose(got[..., 1], blocks.max(axis=1), rtol=1e-6)


def test_runs_are_told_newest_first_with_names_escaped_and_a_foreign_page_is_left_alone(tmp_path: Path) -> None:
    folder, old = tmp_path / "runs", "old & <bold>"
    events = [{"kind": "episode", "force_rmse": 12.34}, {"kind": "end", "sentence": "Ended by Ctrl-C."}]
    events += [{"kind": "exam", "score": 0.4, "best": True}, {"kind": "exam", "score": 0.3, "best": False}]
    report = {"verdict": "partly_explained", "effects": [{"id": "spring_stiffness"}]}
    files = {
        "found/report.json": json.dumps(report), "found/report.html": "", "broken/run.json": "{",
        "tuesday/metadata.yaml": "", "tuesday.html": "", f"{old}/run.json": json.dumps({"events": events}),
        f"{old}/tracking.png": "", f"{old}/bag/metadata.yaml": "", "nothing/else": "",
    }  # fmt: skip
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    for age, name in enumerate(("found", "broken", "tuesday", old)):
        for path in (*(folder / name).iterdir(), folder / name):
            os.utime(path, (1e9 - age, 1e9 - age))
    found = {entry.name: entry for entry in list_runs(folder)}
    kinds = {"found": "diagnosis", "broken": "training", "tuesday": "recording", old: "training"}
    assert [(name, entry.kind) for name, entry in found.items()] == list(kinds.items())
    assert found["found"].summary == "partly explained: spring stiffness" and not found["broken"].summary
    assert found[old].summary == "1 episode, the last one with an RMSE of 12.3 N. Ended by Ctrl-C."
    assert found[old].recordings == (f"{old}/bag",) and found[old].score == 0.4
    assert found["tuesday"].pages == ("tuesday.html",) and not found["tuesday"].recordings
    page = write_index(folder).read_text()
    assert "old &amp; &lt;bold&gt;" in page and "<bold>" not in page
    assert 'src="old%20%26%20%3Cbold%3E/tracking.png"' in page
    (folder / "index.html").write_text("the site")
    refresh_index(folder / "found")
    with pytest.raises(FileExistsError, match="another page than one of runs"):
        write_index(folder)
    assert (folder / "index.html").read_text() == "the site"


def test_what_the_layouts_of_foxglove_and_plotjuggler_plot_is_in_the_messages() -> None:
    layouts = Path(__file__).parents[1] / "layouts"
    panels = json.loads((layouts / "foxglove.json").read_text(encoding="utf-8"))["configById"].values()
    plotted = [path["value"].rsplit(".", 1) for panel in panels for path in panel.get("paths", ())]
    curves = ElementTree.fromstring((layouts / "plotjuggler.xml").read_bytes()).iter("curve")
    plotted += [str(curve.get("name")).rsplit("/", 1) for curve in curves]
    assert len(plotted) > 20
    for topic, field in plotted:
        assert field in RECORDED_TOPICS[topic][0].get_fields_and_field_types(), f"{topic}: {field}"


@pytest.mark.skipif(bool(browser.MISSING), reason=browser.MISSING)
def test_in_a_browser_it_opens_from_disk_loads_nothing_and_the_slider_shows_its_time(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "bag.html").write_text(render_page(RecordingPage(bag)), encoding="utf-8")
    slide = "const s = document.getElementById('time'); s.value = {}; s.dispatchEvent(new Event('input'))"
    with browser.browser(tmp_path / "profile") as page:
        page.open((tmp_path / "bag.html").as_uri())
        page.wait("document.getElementById('state').textContent == 'disarmed'", 120.0)  # once the data are unpacked
        assert "0.00 s of 5.00 s" in page.text("at")
        assert not page.driver.get_log("browser")
        loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
        assert all(name.startswith("data:") for name in loaded)
        page.run(slide.format(2.0))
        page.wait("document.getElementById('state').textContent == 'ARMED'")
        force = float(page.run("return document.querySelector('.plot b').textContent"))
        assert force == pytest.approx(102.0, abs=1.0)
        page.run(slide.format(3.5))
        page.wait("document.getElementById('state').textContent == 'TRIPPED'")
