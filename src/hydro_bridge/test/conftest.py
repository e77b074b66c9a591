# SPDX-License-Identifier: Apache-2.0
"""What several tests need: states with known content, a box at the other end of a pseudo-terminal."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.serial import protocol
from hydro_bridge.serial.protocol import BoxDetails, BoxInfo, BoxLaw, CommandFrame, LawState
from hydro_bridge.serial.stream import Decoder
from hydro_core.signals import STATE_DTYPE, STATE_FIELDS, Flag, Law, StateArray
from tests.box_frames import encode_details, encode_law, encode_state
from tests.frames import altered


@pytest.fixture
def make_states() -> Callable[..., StateArray]:
    def make(count: int, first: int = 0) -> StateArray:
        random = np.random.default_rng(0)
        states = np.zeros(count, STATE_DTYPE)
        states["time"] = 1.7e9 + (first + np.arange(count)) * 1e-3
        states["sequence"] = (first + np.arange(count, dtype=np.int64)) & 0xFFFFFFFF
        for name in STATE_FIELDS:
            states[name] = random.standard_normal(count)
        states["flags"] = random.integers(0, 256, count)
        return states

    return make


class Cable:
    """A pseudo-terminal behind a path that stays the same when it is plugged out and in, as udev's names do."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug_in()

    def plug_in(self) -> None:
        self.box, other = os.openpty()
        tty.setraw(other)
        self.path.symlink_to(os.ttyname(other))
        os.close(other)
        os.set_blocking(self.box, False)

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        box, self.box = self.box, -1  # first: what is opened next may get the same number, and nobody shall write there
        if box >= 0:
            os.close(box)


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "ttyBOX")
    yield made
    made.unplug()


SMALL, PLAIN = BoxInfo(name="small box"), BoxDetails(epoch=1)
ACTING = LawState(Law.COMPENSATED, 0.5, 0.25, (1.0, 0.03125, 0.0, 0.0, 0.0), 0.25, 1.0)


@dataclass
class SmallBox:
    """Speaks the protocol at 1 kHz: answers greetings, arms when told to. By default it runs the paper's law only."""

    cable: Cable
    info: BoxInfo = SMALL
    details: BoxDetails | None = PLAIN
    law: BoxLaw | None = None
    law_state: LawState = ACTING
    version: int = protocol.VERSION
    obeys: bool = True
    sequence: int = 0
    flags: int = 0
    refused: tuple[int, int] = (0, 0)
    commands: list[CommandFrame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.running = True
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        decoder, due = Decoder(), time.monotonic()
        while self.running:
            with suppress(OSError):
                for frame in decoder.feed(self._read()):
                    self._take(frame)
                last = self.commands[-1].sequence if self.commands else 0
                told = (self.flags, last, self.refused, self.law_state)
                state = encode_state(self.sequence, 1000 * self.sequence, [0.5] * 14, *told)
                self._write(altered(state, {0: self.version}))
            self.sequence += 1
            now = time.monotonic()
            due = max(due + 1e-3, now - 5e-3)  # after a hold-up no burst: the line holds some 25 samples
            time.sleep(max(0.0, due - now))

    def _write(self, frame: bytes) -> None:
        """All of it; what nobody reads for 50 ms is dropped."""
        end = time.monotonic() + 0.05
        while frame and time.monotonic() < end:
            try:
                frame = frame[os.write(self.cable.box, frame) :]
            except BlockingIOError:
                time.sleep(1e-3)

    def _read(self) -> bytes:
        with suppress(BlockingIOError):
            return os.read(self.cable.box, 4096)
        return b""

    def _take(self, frame: protocol.Frame) -> None:
        if isinstance(frame, protocol.Hello):
            details = encode_details(1, 0, self.details) if self.details else b""
            law = encode_law(1, 0, self.law) if self.law else b""
            hello = altered(protocol.encode_hello(1, 0, self.info), {14: self.version, 15: self.version})
            os.write(self.cable.box, hello + details + law)
        elif isinstance(frame, CommandFrame):
            self.commands.append(frame)
            if self.obeys:
                self.flags = Flag.ARMED if frame.command.arm else 0

    def stop(self) -> None:
        self.running = False
        self.thread.join()


@pytest.fixture
def small_box(cable: Cable) -> Iterator[Callable[..., SmallBox]]:
    made: list[SmallBox] = []

    def make(**options: object) -> SmallBox:
        made.append(SmallBox(cable, **options))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for box in made:
        box.stop()
