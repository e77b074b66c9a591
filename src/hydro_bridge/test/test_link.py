# SPDX-License-Identifier: Apache-2.0
"""The bridge's state machine against a small box at the other end of a pseudo-terminal."""

from __future__ import annotations

import os
import random
import threading
import time
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import pytest

from hydro_bridge.link.link import Link, LinkState
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.serial.protocol import BoxDetails, BoxInfo, BoxLaw, LawState
from hydro_core.settings import SettingsError
from hydro_core.signals import Command, CorrectionStatus, Flag, Law
from tests.box_frames import encode_details
from tests.checks import wait

DETAILS = BoxDetails(epoch=5, bench_digest="0123456789ab", load_force_limit=700.0, force_range=900.0)
PAPER_LAW_ALONE = "only the paper's force law can be run: the box offers no other"


class Bench:
    """A link in its thread, a box, and what came: sequence, stamp [ns] and law of each state, and the log."""

    def __init__(self, cable, box) -> None:
        self.cable, self.box = cable, box
        self.log: list[str] = []
        self.states: list[tuple[int, int, LawState]] = []
        settings = PortSettings(path=str(cable.path), silence_max=0.3, backoff_first=0.02, backoff_max=0.1)
        self.link = Link(Port(settings), CommandGuard(), self._on_state, self.log.append)
        self.thread = threading.Thread(target=self.link.run, daemon=True)
        self.thread.start()

    def _on_state(self, state, stamp_ns: int, flags: int) -> None:
        self.states.append((state.sequence, stamp_ns, state.law_state))

    def said(self, words: str) -> int:
        return sum(words in sentence for sentence in self.log)


@pytest.fixture
def bench(cable, small_box):
    made: list[Bench] = []

    def make(connects: bool = True, boxed: bool = True, **box: object) -> Bench:
        made.append(it := Bench(cable, small_box(**box) if boxed else None))
        if connects:
            wait(lambda: it.link.state is LinkState.CONNECTED and len(it.states) > 20)
        return it

    yield make
    for it in made:
        it.link.stop()
        it.thread.join(30.0)
        assert not it.thread.is_alive()


def test_each_state_comes_once_in_order_with_ascending_stamps(bench):
    it = bench()
    wait(lambda: len(it.states) > 200)
    sequences, stamps, _ = zip(*list(it.states), strict=True)
    assert list(sequences) == list(range(sequences[0], sequences[0] + len(sequences)))
    assert all(a < b for a, b in pairwise(stamps))
    assert abs(stamps[-1] - time.time_ns()) < 1e9
    assert it.log == [f"connected to small box on {it.cable.path}; disarmed", PAPER_LAW_ALONE]


def test_a_correction_goes_down_at_once_and_its_turnaround_is_measured(bench):
    it, corrected = bench(), []

    def corrects() -> bool:
        """Once, unless a thread is away for the 20 ms after which a correction is too old, or the line opens anew."""
        corrected.append(it.states[-1][0])
        with it.link.lock:
            it.link.guard.set_correction(0.015625, CorrectionStatus.MODIFIED, corrected[-1], time.monotonic())
        it.link.send(corrected[-1])
        time.sleep(0.05)
        return any(frame.command.delta_u == 0.015625 for frame in it.box.commands)

    wait(corrects, 60.0)
    frame = next(frame for frame in it.box.commands if frame.command.delta_u == 0.015625)
    assert frame.command.corrected_sequence in corrected and frame.command.filter_fresh
    assert 1 <= it.link.statistics.turnaround.count <= len(corrected)
    wait(lambda: it.link.statistics.round_trip.count > 0)


def test_a_box_that_does_not_confirm_is_not_left_armed_and_a_tripped_one_not_armed_before_it_was_disarmed(bench):
    it = bench(obeys=False)
    assert "did not confirm within 0.1 s" in it.link.arm(True, timeout=0.1)
    assert not it.link.guard.armed
    it.box.flags = Flag.TRIPPED | Flag.FORCE_LIMIT
    wait(lambda: it.link.flags & Flag.TRIPPED)
    assert it.link.arm(True) == "the box has tripped (TRIPPED, FORCE_LIMIT, FILTER_STALE): disarm it, then arm it"


def test_a_box_that_goes_while_it_is_to_be_armed_is_not_said_to_be_armed(bench):
    it, said = bench(obeys=False), []
    arming = threading.Thread(target=lambda: said.append(it.link.arm(True, timeout=5.0)))
    with it.link._flags_condition:  # held: the arming thread has asked, and waits to hear
        arming.start()
        wait(lambda: it.link.guard.armed)
        it.cable.unplug()
        wait(lambda: it.link.state is LinkState.CLOSED)
    arming.join(30.0)
    assert said == ["the box has gone while it was to be armed: it is not armed"]
    assert it.link.arm(False) == ""


def test_stamps_follow_a_step_of_the_hosts_clock_at_once_and_it_is_said(bench):
    it, shift = bench(), [0]
    clock = it.link.host_clock
    read = clock._read
    clock._read = lambda: None if (offset := read()) is None else offset + shift[0]
    for step in (100_000_000, -100_000_000):
        told, (first, before, _) = len(it.log), it.states[-1]
        shift[0] += step
        wait(lambda told=told: len(it.log) > told)
        count = len(it.states)
        wait(lambda count=count: len(it.states) > count)
        last, after, _ = it.states[-1]
        passed = 1_000_000 * (last - first)
        assert abs(after - before - passed - step) < 0.05 * passed + 2e6, "the box's time, slewed by at most 5 %"
        assert f"was set by {1e-9 * step:+.3f} s" in it.log[-1]


def test_unplugged_and_replugged_it_reconnects_disarmed_and_can_be_armed_anew(bench):
    it = bench()
    assert it.link.arm(True) == "" and it.box.flags & it.link.flags & Flag.ARMED
    assert it.link.arm(False) == "" and not it.box.flags & Flag.ARMED
    assert it.link.arm(True) == ""
    it.cable.unplug()
    wait(lambda: it.link.state is LinkState.CLOSED)
    assert "there is no box" in it.link.arm(True)
    turns = it.box.sequence
    wait(lambda: it.box.sequence > turns + 1)  # what the box has read before is taken
    it.box.commands.clear()
    it.cable.plug_in()
    wait(lambda: it.link.state is LinkState.CONNECTED and len(it.box.commands) > 20)
    assert not any(frame.command.arm for frame in it.box.commands)
    assert it.link.statistics.reconnects == 1
    assert it.link.arm(True) == ""


def test_neither_silence_nor_bytes_without_frames_keep_a_line_alive_and_nothing_is_armed_on_them(bench, monkeypatch):
    it = bench()
    assert it.link.arm(True) == ""
    noise, write, begun = random.Random(1), it.box._write, len(it.states)
    monkeypatch.setattr(it.box, "_write", lambda frame: write(noise.randbytes(max(1, len(frame) // 8))))  # another rate
    wait(lambda: it.link.no_sample_message != "" or it.link.state is not LinkState.CONNECTED)
    assert it.link.arm(True) != "", "what was heard before is no answer"
    wait(lambda: it.link.state is not LinkState.CONNECTED)
    assert not it.link.guard.armed and not it.link.flags & Flag.ARMED
    assert len(it.states) - begun < 50
    wait(lambda: it.said("bytes came and no frame in them"))
    monkeypatch.undo()
    wait(lambda: it.link.state is LinkState.CONNECTED and it.link.statistics.reconnects == 1)
    assert not it.link.guard.armed
    wait(lambda: it.link.arm(True) == "")
    it.box.stop()
    wait(lambda: it.link.state is not LinkState.CONNECTED)
    assert not it.link.guard.armed and it.said("no byte came for 0.3 s")


def test_a_restarted_box_is_disarmed_and_followed_from_its_new_count(bench):
    it = bench(sequence=100_000, details=DETAILS)
    assert it.link.arm(True) == ""
    it.box.sequence = 0
    wait(lambda: it.link.counts.restarts == 1)
    wait(lambda: it.states[-1][0] < 100_000 and len(it.states) > 50)
    assert not it.link.guard.armed and it.link.counts.lost < 1000
    assert it.link.arm(True) == ""
    it.box.stop()  # two threads on one line would mix their frames
    it.box._write(encode_details(1, 0, replace(DETAILS, epoch=6)))
    wait(lambda: it.said("the box was restarted") == 2)
    assert not it.link.guard.armed


@pytest.mark.parametrize(
    ("box", "told"),
    [
        ({"version": 3}, "older protocol than version 4, and no command is sent: rebuild its firmware"),
        ({"version": 5}, "newer protocol than version 4, and no command is sent: update hydro"),
        ({"details": None}, "no DETAILS behind its HELLO: no command is sent"),
        ({"details": replace(DETAILS, laws=3)}, "no LAW behind its DETAILS: no command is sent"),
    ],
)
def test_a_box_of_another_protocol_or_that_leaves_out_a_frame_is_told_of_and_never_commanded(bench, box, told):
    it = bench(connects=False, **box)
    wait(lambda: it.said(told))
    time.sleep(0.5)  # for a second sentence, or a command
    assert len(it.log) == 1, "told once"
    assert it.box.commands == [] and it.states == []


def test_a_box_is_followed_once_its_details_came_and_its_limits_narrow_the_guard(bench):
    it = bench(details=DETAILS, info=BoxInfo(delta_kp_max=10.0, delta_u_max=0.015625))
    assert (it.link.guard.settings.delta_kp_max, it.link.guard.settings.delta_u_max) == (10.0, 0.015625)
    assert it.link.details.epoch == 5 and it.link.refused == (0, 0)
    assert it.said("refuses references beyond 900 N") and it.said("trips beyond a load force of 700 N")
    assert it.link.arm(True) == ""
    it.box.refused = (3, 1)
    wait(lambda: it.link.refused == (3, 1))
    wait(lambda: it.said("refused a reference"))


@pytest.mark.parametrize("law", [None, BoxLaw(base_kp=250.0, coefficient_max=(1.25, 0.125, 0.5, 64.0, 0.25))])
def test_a_compensated_command_goes_out_as_it_is_only_to_a_box_that_offers_that_law(bench, law):
    """Elsewhere its changes would be added to the paper's gains: the safe command goes out instead."""
    it = bench(details=replace(DETAILS, laws=3 if law else 1), law=law)
    assert it.said(PAPER_LAW_ALONE) == (law is None) and it.states[-1][2] == it.box.law_state
    if law:
        assert (it.link.law.base_kp, it.link.law.coefficient_max) == (law.base_kp, law.coefficient_max)
    wanted = Command(
        arm=True, delta_kp=-50.0, delta_u=0.125, law=Law.COMPENSATED, coefficients=(1.0, 0.0625, 0.0, 2.0, 0.0),
        velocity_compensation=0.25, filter_fresh=True,
    )  # fmt: skip
    it.link.guard.command = lambda now: wanted
    sent = it.link._sequence  # earlier commands may still lie in the line
    wait(lambda: it.box.commands[-1].sequence > sent + 1)
    assert it.box.commands[-1].command == (wanted if law else Command())


def test_a_line_too_slow_for_a_sample_each_millisecond_is_refused():
    with pytest.raises(SettingsError, match=r"baud must be a whole number within .* not 921600"):
        PortSettings(baud=921600)


@pytest.fixture
def port(cable):
    made = Port(PortSettings(path=str(cable.path)))
    made.open()
    yield made
    made.close()


def test_the_port_is_opened_exclusively_and_unplugging_is_noticed_by_reading_and_by_writing(cable, port):
    with pytest.raises(PortLostError, match="in use by another program"):
        Port(port.settings).open()
    cable.unplug()
    for use in (lambda: port.read(1.0), lambda: port.write(b"x")):
        with pytest.raises(PortLostError, match="unplugged"):
            use()


def test_a_box_that_does_not_read_never_blocks_a_write_and_frames_stay_whole(cable, port):
    began = time.monotonic()
    frames = [b"<%06d>" % n for n in range(20_000)]
    written = [frame for frame in frames if port.write(frame)]
    assert time.monotonic() - began < 5.0
    assert port.dropped_writes == len(frames) - len(written) > 0
    received = b""
    with suppress(BlockingIOError):
        while True:
            received += os.read(cable.box, 65536)
            time.sleep(0.001)
    assert received == b"".join(written)[: len(received)]
