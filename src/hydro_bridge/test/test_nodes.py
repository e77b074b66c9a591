# SPDX-License-Identifier: Apache-2.0
"""The executables as users start them, in a running graph."""

from __future__ import annotations

import io
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from rosbags.rosbag2 import Reader

from hydro_bridge.bags.recording import read_bag, read_messages
from hydro_bridge.ros.topics import BOX, DIAGNOSTICS, GAINS, RECORDED_TOPICS, STATE, create_subscription
from hydro_bridge.serial.protocol import BoxInfo as BoxFrame
from hydro_core.files import bench_digest
from hydro_core.signals import Flag
from hydro_msgs.msg import BoxInfo, Gains
from hydro_msgs.srv import Claim
from tests.checks import wait
from tests.graph_probe import Probe

pytestmark = pytest.mark.graph


@pytest.fixture
def probe() -> Iterator[Probe]:
    made = Probe()
    yield made
    made.close()


@pytest.fixture
def bridge(cable, small_box, probe, start):
    """Start a box and a bridge, and wait for samples: both, what it logs, and what it says on /diagnostics.

    Its box is a thread of this process, which other tests hold up: a line that is silent for that long stays open.
    """

    def begin(*words, **box):
        it = SimpleNamespace(box=small_box(**box), output=io.StringIO(), told=[])
        listen = lambda array: it.told.extend(status for status in array.status if status.name == "bridge")  # noqa: E731
        create_subscription(probe.node, DIAGNOSTICS, listen)
        patient = ("--ros-args", "-p", "silence_max:=30.0")
        it.process = start("hydro_bridge bridge", "--port", cable.path, *patient, *words, output=it.output)
        probe.wait(lambda: len(probe.states) > 20)
        return it

    return begin


@pytest.fixture
def steered(bridge, probe):
    """A bridge that is armed."""
    it = bridge("-p", "guard.gains_timeout:=2.0")
    it.armed = lambda: bool(it.box.flags & Flag.ARMED)
    it.command = lambda: it.box.commands[-1].command
    probe.take()
    probe.arm(True)
    return it


def boxes_heard(probe: Probe) -> list[BoxInfo]:
    """What comes on /hydro/box from now on, the latched one first."""
    heard: list[BoxInfo] = []
    create_subscription(probe.node, BOX, heard.append)
    return heard


def shipped_digest() -> str:
    return bench_digest.digest(bench_digest.read_parameters(bench_digest.shipped_bench_file()))


def test_gains_from_two_nodes_are_an_error_and_nothing_is_armed(bridge, probe):
    it = bridge()
    probe.take()
    rival = probe.node.create_publisher(Gains, GAINS, RECORDED_TOPICS[GAINS][1])
    probe.wait(lambda: it.told and "2 nodes publish /hydro/gains (probe, probe)" in it.told[-1].message)
    assert it.told[-1].level == DiagnosticStatus.ERROR
    refused = [probe.ask(True) for _ in range(3)][-1]
    assert not refused.success and "end all but one" in refused.message
    probe.wait(lambda: refused.message in it.output.getvalue())
    assert it.output.getvalue().count(refused.message) == 1, "told once, however often it is asked for"
    probe.node.destroy_publisher(rival)
    probe.wait(lambda: probe.ask(True).success)


def test_a_plant_is_armed_by_name_and_given_back(steered, probe):
    def claim(act: int, **words) -> Claim.Response:
        answer = probe.arming.call_async(Claim.Request(act=act, **words))
        probe.wait(answer.done)
        return answer.result()

    refused = claim(Claim.Request.ARM, name="person", whom="evaluate")
    assert not refused.success and refused.message == "probe commands this plant, not evaluate"
    assert claim(Claim.Request.ARM, name="person", whom="probe").success
    probe.commands = False
    answer = probe.commander.release()
    probe.wait(answer.done)
    assert answer.result().message == "disarmed, given back" and not steered.armed()
    taken = claim(Claim.Request.TAKE, name="collect")
    assert taken.success and taken.epoch


def test_who_succeeds_a_holder_that_has_fallen_silent_finds_the_plant_disarmed(steered, probe):
    other = Probe()
    try:
        other.take()  # nobody spins the first one meanwhile
        assert not steered.armed() and not steered.command().arm
    finally:
        other.close()


def test_arm_arms_and_says_what_the_plant_answered(cable, bridge, probe, start):
    output = io.StringIO()
    alone = start("hydro_bridge arm", "--timeout", "0.5")
    assert alone.process.wait(60.0) == 2 and "no plant runs here" in alone.last_line
    box = bridge().box
    # again: a box that a busy machine holds up does not confirm in time
    probe.wait(lambda: start("hydro_bridge arm", output=output).process.wait(60.0) == 0, 120.0)
    assert box.flags & Flag.ARMED
    probe.wait(lambda: "armed" in output.getvalue())
    probe.wait(lambda: start("hydro_bridge arm", "--off").process.wait(60.0) == 0, 120.0)
    assert not box.flags & Flag.ARMED
    cable.unplug()
    probe.wait(lambda: not probe.ask(True).success)  # once the bridge has noticed
    refused = start("hydro_bridge arm")
    assert refused.process.wait(60.0) == 2 and "the plant refuses: " in refused.last_line


def test_bridge_disarms_the_box_when_it_is_ended(steered, probe):
    process = steered.process.process
    process.send_signal(signal.SIGHUP)
    probe.wait(lambda: not steered.command().arm)  # it looks for signals five times a second
    assert process.wait(10.0) == 0


def test_bridge_says_what_the_box_is_and_a_recording_of_it_says_so_again(bridge, probe, start, tmp_path):
    it = bridge(info=BoxFrame(name="small box 3", base_kp=30.0, base_ki=8.0))
    heard = boxes_heard(probe)  # later than it was said
    probe.wait(lambda: heard)
    said = heard[0]
    assert (said.plant, said.firmware, said.base_kp, said.base_ki) == ("bridge", "small box 3", 30.0, 8.0)
    assert said.bench_digest == shipped_digest()
    assert yaml.safe_load(said.bench)["valve_current_max"] == 0.05
    recorder = start("hydro_bridge recorder", "--out", tmp_path / "run")
    probe.wait(lambda: probe.node.count_subscribers(BOX) == 2)
    probe.spin(2.0)
    assert recorder.stop() == 0 and it.process.stop() == 0
    heard.clear()
    start("hydro_bridge replayer", tmp_path / "run", "--loop")
    probe.wait(lambda: heard)
    ((_, recorded),) = read_messages(tmp_path / "run", BOX)
    for box in (recorded, heard[0]):
        assert (box.bench_digest, box.base_kp) == (said.bench_digest, 30.0)


def test_a_box_that_differs_from_its_bench_file_is_told_with_both_numbers(bridge, probe):
    it = bridge(info=BoxFrame(name="other box", valve_current_max=0.08))
    probe.wait(lambda: "its valve_current_max is 0.08 A, the bench file says 0.05 A" in it.output.getvalue())
    heard = boxes_heard(probe)
    probe.wait(lambda: heard)
    assert heard[0].bench_digest not in ("", shipped_digest())


@pytest.mark.realtime
def test_recorder_keeps_every_sample_and_ends_cleanly(bridge, probe, start, tmp_path):
    bridge("--", "--realtime")
    attached = tmp_path / "bench.yaml"
    attached.write_text("stroke: 0.08\n")
    words = ("--out", tmp_path / "run", "--metadata", "seed=3", "--attach", attached, "--realtime")
    recorder = start("hydro_bridge recorder", *words)
    probe.wait(lambda: probe.node.count_subscribers(STATE) == 2)
    probe.spin(3.0)
    assert recorder.stop() == 0
    recording = read_bag(tmp_path / "run")
    assert len(recording.state) > 1000 and recording.notes == ()
    assert (np.diff(recording.state["sequence"].astype(int)) == 1).all()
    assert recording.metadata["hydro"]["seed"] == "3" and recording.metadata["hydro"]["code_version"]
    assert recording.attachments == {"bench.yaml": b"stroke: 0.08\n"}
    assert "/diagnostics" in recording.topics
    with Reader(tmp_path / "run") as reader:
        assert sum(1 for _ in reader.messages()) >= len(recording.state)


def test_a_full_disk_ends_the_recording_as_a_failure_and_leaves_what_was_written(bridge, probe, start, tmp_path):
    bridge()
    file, output = tmp_path / "run/run_0.mcap", io.StringIO()
    recorder = start("hydro_bridge recorder", "--out", tmp_path / "run", output=output)
    probe.wait(lambda: file.exists() and file.stat().st_size > 20_000)
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (file.stat().st_size + 20_000,) * 2)
    probe.wait(lambda: not recorder.running)
    assert recorder.process.wait() == 1, "not 2: that is for a command line that cannot be used"
    recorder.stop()
    assert "recording stopped: File too large" in output.getvalue() and "Traceback" not in output.getvalue()
    recording = read_bag(tmp_path / "run")
    assert len(recording.state) > 100 and "was not finished" in recording.notes[0]


def test_companions_die_with_their_parent_even_if_it_is_killed(tmp_path):
    code = (
        "import sys, time; from hydro_bridge.ros.companion import Companion; "
        f"c = Companion('hydro_bridge', 'recorder', ['--out', {str(tmp_path / 'run')!r}]); "
        "print(c.process.pid, flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        wait((tmp_path / "run/metadata.yaml").exists, 20.0)
        parent.kill()

    def ended() -> bool:
        with suppress(psutil.NoSuchProcess):
            return child.status() == psutil.STATUS_ZOMBIE
        return True

    wait(ended, 20.0)
