# SPDX-License-Identifier: Apache-2.0
"""The box in C against the compiled Python box: the same bytes and measurements in, the same samples out."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from math import inf, nan
from random import Random
from typing import Any

import numpy as np
import pytest

from hydro_bridge.serial.protocol import (
    VERSION,
    encode_command,
    encode_hello,
)
from hydro_bridge.signals import NEUTRAL, STATE_FIELDS, Command, Flag, FloatArray, Law, ReferenceSignal, Waveform
from hydro_sim.box.box import Box, BoxConfig, box_details, box_info, law_state
from hydro_sim.box.firmware import Firmware
from hydro_sim.box.header import NAME
from hydro_sim.emulator.line.faults import LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors

BROKEN = (nan, inf, -inf, 1e30, -1e30, 5001.0)


def drawn_number(random: Random, scale: float) -> float:
    return random.choice(BROKEN) if random.random() < 0.02 else random.gauss(0.0, scale)


def drawn_command(random: Random) -> Command:
    signal = ReferenceSignal(
        waveform=random.choice(tuple(Waveform)),
        amplitude=abs(drawn_number(random, 200.0)),
        offset=drawn_number(random, 100.0),
        frequency=random.choice((0.3, 2.0, 999.0, 1000.0, 0.0, -1.0, nan, random.uniform(0.1, 20.0))),
        phase=drawn_number(random, 3.0),
    )
    scales = (1.0, 0.05, 2e-3, 30.0)
    return Command(
        arm=random.random() < 0.8,
        delta_kp=drawn_number(random, 100.0),
        delta_ki=drawn_number(random, 30.0),
        delta_u=drawn_number(random, 0.02),
        reference=signal,
        law=random.choice((Law.PAPER, Law.COMPENSATED, Law.COMPENSATED)),
        coefficients=tuple(drawn_number(random, scale) for scale in scales),  # type: ignore[arg-type]
        velocity_compensation=drawn_number(random, 0.4),
        valve_gain_scale=drawn_number(random, 2.0),
        corrects=random.getrandbits(32),
        filter_fresh=random.random() < 0.5,
    )


def drawn_bytes(random: Random, sequence: int, command: Command) -> bytes:
    """What a host sends in one millisecond: mostly the command, at times nothing, a greeting, garbage, old frames."""
    frame = encode_command(sequence, 0, command, random.choice((1, 2, *[VERSION] * 30)))
    draw = random.random()
    if draw < 0.9:
        return frame
    if draw < 0.92:
        return encode_hello(sequence, 0) + frame * random.randint(0, 2)
    if draw < 0.94:
        return frame + encode_hello(sequence, 0)
    if draw < 0.96:
        return random.randbytes(random.randint(1, 400)) + frame
    if draw < 0.98:
        return encode_command(sequence - random.choice((0, 1, 5, 2**31)), 0, command) + frame[: random.randint(1, 60)]
    return b""


def streams(seed: int, samples: int) -> Iterator[tuple[bytes, FloatArray]]:
    """Bytes of the host and a measurement for each millisecond."""
    random, sequence, command, silent = Random(seed), 0, Command(), 0
    x = np.array([0.0, 0.0, 0.0, 0.0, 3.7e6, 6.2e6, 0.04, 0.0])
    for k in range(samples):
        sequence = (sequence + 1) & 0xFFFFFFFF
        if random.random() < 0.01:
            command = drawn_command(random)
        elif random.random() < 0.002:
            command = replace(command, law=Law(1 - command.law))
        if random.random() < 0.001:
            silent = random.randint(1, 400)
        silent = max(0, silent - 1)
        wave = np.sin(k * np.array([2e-3, 3e-3, 5e-3, 7e-3, 1e-3, 2e-3, 4e-3, 9e-3]))
        y = x + wave * np.array([300.0, 4e3, 300.0, 4e3, 3e6, 5e6, 0.03, 0.2])
        if random.random() < 0.002:
            y[random.randrange(8)] = random.choice((*BROKEN, 720.0, -750.0))
        yield (b"" if silent else drawn_bytes(random, sequence, command)), y


def pair(line: Any, integral: str = "bumpless") -> tuple[Box, BoxLink, Firmware]:
    """The Python box on a line, and the box in C, alike."""
    bench, config = Bench.nominal(), BoxConfig(integral=integral)  # type: ignore[arg-type]
    box = Box(bench, config)
    details = box_details(bench, config, Sensors(), epoch=7)
    told = (lambda: box.refused, config.compensated, lambda: law_state(box.state[0]))
    link = BoxLink(line, box_info(bench, config, NAME), LinkFaults(), 0, details, *told)
    return box, link, Firmware(bench, config, epoch=7)


def bits(sample: np.void) -> bytes:
    """All of a sample, without what lies between its fields."""
    return struct.pack("<dI14dI", *sample.item())


@pytest.mark.parametrize(("seed", "integral"), [(1, "bumpless"), (2, "bumpless"), (3, "paper")])
def test_samples_and_bytes_are_those_of_the_python_box_to_the_bit(memory: Any, seed: int, integral: str) -> None:
    box, link, firmware = pair(memory, integral)
    config = box.config.compensated
    seen: set[int] = set()
    moved = held = cut = 0
    for k, (data, x) in enumerate(streams(seed, 20_000)):
        memory.down += data
        command = link.poll(k * 1e-3)
        if command is not None:
            box.receive(command, k * 1e-3)
        firmware.take(data)
        expected, found = box.tick(x, k * 1e-3), firmware.tick(x, k * 1e-3)[0]
        assert bits(found) == bits(expected), k
        acting = law_state(box.state[0])
        assert repr(firmware.law_state()) == repr(acting), k  # with NaN where a sensor shows it
        if int(expected["flags"]) & Flag.ARMED and acting.law is Law.COMPENSATED:
            moved += acting.coefficients != NEUTRAL
            held += int(box.state["law_wanted"][0]) != Law.COMPENSATED
            cut += abs(acting.compensated_reference) == config.reference_max and not acting.compensated_reference_rate
        link.send(expected, k * 1e-3)
        assert firmware.frames() == memory.up, k
        memory.up = b""
        seen.add(int(expected["flags"]))
    counts = firmware.counts()
    assert (counts["refused"], counts["refused_references"]) == box.refused
    assert (counts["taken"], counts["stale"], counts["greetings"]) == (
        link.report.commands, link.report.refused, link.report.hellos,
    )  # fmt: skip
    assert {int(Flag.ARMED), int(Flag.ARMED | Flag.SATURATED)} & seen and len(seen) > 12
    assert moved > 2000 and held > 200 and cut > 20


def calm(seed: int, samples: int, law: Law) -> Iterator[tuple[bytes, FloatArray]]:
    """Commands that a guard lets through, every millisecond, and a bench that is where it was believed."""
    random, command, bench = Random(seed), Command(), Bench.nominal()
    plant = AnalyticPlant(bench)
    x = plant.reset(seed)
    for k in range(samples):
        if k % 700 == 1:
            shape = Segment(
                seconds=1.0, waveform=random.choice(("hold", "sine", "multisine", "smooth_step")),
                amplitude=random.uniform(0.0, 250.0), frequency=random.uniform(0.2, 8.0), kp=60.0, ki=10.0,
            ).signal  # fmt: skip
            command = Command(arm=True, delta_kp=45.0, delta_ki=5.0, delta_u=1e-4, reference=shape, filter_fresh=True)
            if law is Law.COMPENSATED:
                shaping = (random.uniform(0.9, 1.1), random.uniform(0.0, 0.03), random.uniform(0.0, 4e-4), -5.0)
                slow = replace(
                    shape, amplitude=0.6 * shape.amplitude, frequency=0.25 * shape.frequency
                )  # never cut off
                command = replace(command, law=law, delta_kp=0.0, reference=slow, coefficients=shaping)
                command = replace(command, velocity_compensation=0.3)
        current = yield encode_command(k + 1, 0, command, VERSION), x
        x = plant.step(current)


@pytest.mark.parametrize("law", Law)
def test_single_precision_stays_within_its_rounding(law: Law) -> None:
    """Both boxes see the bench that the double one moves: each sample's difference is rounding, none is chaos."""
    bench = Bench.nominal()
    double, single = Firmware(bench), Firmware(bench, precision="single")
    source, worst = calm(5, 20_000, law), dict.fromkeys((*STATE_FIELDS, "f_c", "f_c'"), 0.0)
    data, x = next(source)
    for k in range(20_000 - 1):
        for box in (double, single):
            box.take(data)
        a, b = double.tick(x, k * 1e-3)[0], single.tick(x, k * 1e-3)[0]
        assert (int(a["flags"]) ^ int(b["flags"])) & ~Flag.SATURATED == 0
        for name in STATE_FIELDS:
            worst[name] = max(worst[name], abs(float(a[name]) - float(b[name])))
        acting, other = double.law_state(), single.law_state()
        assert acting.law is other.law is (law if k else Law.PAPER)
        worst["f_c"] = max(worst["f_c"], abs(acting.compensated_reference - other.compensated_reference))
        worst["f_c'"] = max(worst["f_c'"], abs(acting.compensated_reference_rate - other.compensated_reference_rate))
        data, x = source.send(float(a["valve_current"]))  # type: ignore[attr-defined]
    print(worst)
    assert worst["valve_current"] < 1e-7 and worst["reference_force"] < 1e-4
    assert worst["reference_force_rate"] < 1e-2 and worst["f_c"] < 2e-3 and worst["f_c'"] < 2.0
