# SPDX-License-Identifier: Apache-2.0
"""The worked byte examples of protocol.md are what the codec makes and reads."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import Any
from zlib import crc32

import pytest
from cobs import cobs

from hydro_bridge.safety.guard_settings import GuardSettings
from hydro_bridge.serial import protocol
from hydro_core.signals import Command, Flag, Law, ReferenceSignal, Waveform
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from tests.box_frames import encode_details, encode_law, encode_state

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "manual" / "reference" / "protocol.md").read_text(encoding="utf-8")
BENCH, BOX = Bench.nominal(), BoxConfig()
INFO = protocol.BoxInfo(name="example 1.0", delta_kp_min=-5.0, integral="bumpless")
DETAILS = protocol.BoxDetails(
    epoch=7, bench_digest="0123456789ab", feedback="load", laws=3, load_force_limit=700.0, force_range=5000.0,
    pressure_min=-0.5e6, pressure_max=25e6, position_min=-5e-3, position_max=0.085, hold_timeout=0.05, trip_timeout=0.2,
    force_rate_age=2e-3, velocity_age=1e-3,
)  # fmt: skip
LAW = protocol.BoxLaw(
    base_ki=16.0, delta_kp_max=1.0, delta_ki_max=20.0, velocity_compensation=0.25, valve_gain_scale_min=0.75,
    coefficient_min=(0.75, -0.0625, -(2.0**-10), -60.0, -(2.0**-17)),
    coefficient_max=(1.25, 0.125, 2.0**-8, 60.0, 2.0**-13), coefficient_rate=(0.5, 0.125, 2.0**-7, 100.0, 2.0**-12),
)  # fmt: skip
VALUES = (1.5, 0.0, -2.25, 0.0, 4e6, 6e6, 0.0625, 0.0, 0.015625, 0.015625, -2.0, 0.0, 15.0, 5.0)
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=100.0, offset=-20.0, frequency=2.0, phase=0.5)
COMPENSATED = Command(
    arm=True, delta_kp=10.0, delta_ki=0.5, delta_u=2.0**-10, corrected_sequence=257, filter_fresh=True, reference=SINE,
    law=Law.COMPENSATED, coefficients=(1.0, 0.0625, 2.0**-9, -2.0, 2.0**-15), velocity_compensation=0.25,
    valve_gain_scale=1.5,
)  # fmt: skip
ACTING = protocol.LawState(Law.COMPENSATED, -2.5, 8.0, (1.0, 0.03125, 2.0**-9, -1.0, 2.0**-15), 0.25, 1.0)
MADE = [
    protocol.encode_hello(0, 1_000_000),
    protocol.encode_hello(1, 2_000_000, INFO),
    encode_details(1, 2_000_000, DETAILS),
    encode_law(1, 2_000_000, LAW),
    encode_state(258, 258_000, VALUES, int(Flag.ARMED | Flag.FILTER_STALE), 3, (1, 1), ACTING),
    protocol.encode_command(3, 1_003_000, COMPENSATED),
]


def examples() -> list[bytes]:
    blocks = re.findall(r"```text\n((?:[0-9a-f]{2}[ \n])+)```", PAGE)
    return [bytes.fromhex(block) for block in blocks]


def test_the_codec_makes_and_reads_the_bytes_of_the_page() -> None:
    assert examples() == MADE
    frames: list[protocol.Frame] = [protocol.decode(wire[1:-1]) for wire in examples()]
    kinds = ["Hello", "Hello", "Details", "LawFrame", "State", "CommandFrame"]
    assert [type(frame).__name__ for frame in frames] == kinds
    assert frames[4][2] == VALUES and frames[4][5:] == (1, 1, ACTING)
    assert (frames[3][3], frames[5][2]) == (LAW, COMPENSATED)
    assert encode_details(1, 2_000_000, frames[2][2]) == MADE[2], "numbers of float32 are those that were sent"


def test_the_firmware_is_tried_with_the_bytes_of_the_page() -> None:
    header = (ROOT / "firmware" / "test" / "test_frames.h").read_text(encoding="utf-8")
    texts = re.findall(r"=((?:\s+\"[0-9a-f ]+\")+);", header)
    assert [bytes.fromhex(re.sub(r"\W", "", text)) for text in texts] == examples()


def test_the_algorithms_of_the_page_are_those_of_the_libraries() -> None:
    page: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, page)
    random = Random(6)
    assert page["crc32"](b"123456789") == 0xCBF43926
    for length in [*range(250), 254, 300, 600]:
        body = bytes(random.choice((0, 1, 255, random.randrange(256))) for _ in range(length))
        assert page["crc32"](body) == crc32(body)
        assert page["unstuff"](cobs.encode(body)) == body
        if length < 254:
            assert page["stuff"](body) == cobs.encode(body)
    for broken in (b"\x05ab", b"\x00", b"\x02a\x00"):
        assert page["unstuff"](broken) is None


def stated(sentence: str) -> list[float]:
    """Numbers of the one line that matches, # for each; ... for anything."""
    pattern = re.escape(sentence).replace(r"\#", r"(\S+)").replace(r"\.\.\.", ".*?")
    (found,) = re.findall(pattern, " ".join(PAGE.split()))
    return [float(number) for number in found]


def test_the_ranges_of_the_page_are_those_of_the_box() -> None:
    record = BOX.constants(BENCH)[0]
    force, low, high, near, far, rate, velocity = stated(
        "force_range (# N). Pressures: # to # MPa. Position: ..., # to # mm. Rates of the forces: +- # N/s; "
        "rate of the position: +- # m/s"
    )
    wanted = [force, rate, force, rate, high * 1e6, high * 1e6, far * 1e-3, velocity]
    assert record["high"] == pytest.approx(wanted)
    assert record["low"] == pytest.approx([-force, -rate, -force, -rate, low * 1e6, low * 1e6, near * 1e-3, -velocity])


def test_the_digest_is_that_of_the_line_that_the_page_describes() -> None:
    numbers = {key: value for key, value in BENCH.to_mapping().items() if isinstance(value, float)}
    line = "{" + ", ".join(f'"{key}": {numbers[key]!r}' for key in sorted(numbers)) + "}"
    said = r"`(\{[^`]*), \.\.\., ([^`]*\})`.* nominal bench has (\w{12})\."
    ((begin, end, digest),) = re.findall(said, PAGE, re.DOTALL)
    assert line.startswith(begin) and line.endswith(end)
    assert sha256(line.encode()).hexdigest()[:12] == digest == BENCH.digest


def test_the_numbers_of_the_nominal_box_are_its_settings() -> None:
    law, guard = BOX.compensated, GuardSettings()
    acts, recovery = (
        float(re.findall(rf"#define {name} (\S+)", (ROOT / "firmware" / "hydro" / header).read_text())[0])
        for name, header in (("HYDRO_CORRECTION_HOLD", "config.h"), ("HYDRO_RECOVERY", "arming.h"))
    )
    scales = law.velocity_compensation, law.velocity_compensation_min, law.velocity_compensation_max
    gains = law.valve_gain_scale, law.valve_gain_scale_min, law.valve_gain_scale_max
    changes = law.delta_kp_min, law.delta_kp_max, law.delta_ki_min, law.delta_ki_max
    for sentence, *values in (
        ("| delta_kp | # to # ", BOX.delta_kp_min, BOX.delta_kp_max),
        ("| delta_ki | # to # ", BOX.delta_ki_min, BOX.delta_ki_max),
        ("| base_kp, base_ki | # 1/s, # 1/s^2", BOX.base_kp, BOX.base_ki),
        ("law: base_kp, base_ki | # 1/s, # 1/s^2", law.base_kp, law.base_ki),
        ("law: delta_kp, delta_ki | # to # 1/s, # to # 1/s", *changes),
        (
            "limit of f_c | # 1/s, #, # s, # N/s, # s^2, # 1/s; # N",
            *law.coefficient_rate,
            law.scale_rate,
            law.reference_max,
        ),
        ("| compensated law: C_1, C_2 | # (# to #), # (# to #)", *scales, *gains),
        ("valve_current_max | # A, # A", BOX.delta_u_max, BENCH.valve_current_max),
        ("force_range | # N, # N", BOX.load_force_limit, BOX.force_range),
        ("TRIPPED | # ms, # ms", 1000 * BOX.hold_timeout, 1000 * BOX.trip_timeout),
        ("acts; ... | # ms; # N, # s", 1000 * acts, BOX.recovery_margin, recovery),
        ("by default 0 to # 1/s, 0 to # 1/s^2, # A", guard.delta_kp_max, guard.delta_ki_max, guard.delta_u_max),
    ):
        assert stated(sentence) == values, sentence
