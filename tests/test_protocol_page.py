# SPDX-License-Identifier: Apache-2.0
"""The worked byte examples of protocol.md are what the codec makes and reads."""

from __future__ import annotations

import re
from pathlib import Path

from hydro_bridge.serial.protocol import (
    BoxDetails,
    BoxInfo,
    Frame,
    decode,
    encode_command,
    encode_details,
    encode_hello,
    encode_state,
)
from hydro_bridge.signals import Command, Flag, ReferenceSignal, Waveform

PAGE = Path(__file__).resolve().parent.parent / "docs" / "manual" / "reference" / "protocol.md"
INFO = BoxInfo(name="example 1.0", delta_kp_min=-5.0, integral="bumpless")
DETAILS = BoxDetails(
    epoch=7,
    bench_digest="0123456789ab",
    feedback="load",
    load_force_limit=700.0,
    force_range=5000.0,
    pressure_min=-0.5e6,
    pressure_max=25e6,
    position_min=-5e-3,
    position_max=0.085,
    hold_timeout=0.05,
    trip_timeout=0.2,
    force_rate_age=2e-3,
    velocity_age=1e-3,
)
VALUES = (1.5, 0.0, -2.25, 0.0, 4e6, 6e6, 0.0625, 0.0, 0.015625, 0.015625, -2.0, 0.0, 15.0, 5.0)
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=100.0, offset=-20.0, frequency=2.0, phase=0.5)
COMMAND = Command(
    arm=True, delta_kp=10.0, delta_ki=0.5, delta_u=2.0**-10, corrects=257, filter_fresh=True, reference=SINE
)
MADE = [
    encode_hello(0, 1_000_000),
    encode_hello(1, 2_000_000, INFO),
    encode_details(1, 2_000_000, DETAILS),
    encode_state(258, 258_000, VALUES, int(Flag.ARMED | Flag.FILTER_STALE), 3, (0, 1)),
    encode_command(3, 1_003_000, COMMAND, version=2),
]


def examples() -> list[bytes]:
    blocks = re.findall(r"```text\n((?:[0-9a-f]{2}[ \n])+)```", PAGE.read_text(encoding="utf-8"))
    return [bytes.fromhex(block) for block in blocks]


def test_the_codec_makes_the_bytes_of_the_page() -> None:
    assert examples() == MADE


def test_the_codec_reads_the_bytes_of_the_page() -> None:
    frames: list[Frame] = [decode(wire[1:-1]) for wire in examples()]
    assert [type(frame).__name__ for frame in frames] == ["Hello", "Hello", "Details", "State", "CommandFrame"]
    assert frames[3][2] == VALUES and frames[3][5:] == (0, 1)
    assert frames[4][2] == COMMAND
