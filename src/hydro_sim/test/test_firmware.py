# SPDX-License-Identifier: Apache-2.0
"""The firmware as a library: its records, its two ways in, what it sends, and its single precision."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import astuple, replace
from math import inf, nan
from pathlib import Path
from random import Random

import numpy as np
import pytest

from hydro_bridge.serial import protocol
from hydro_bridge.serial.stream import Decoder
from hydro_core.settings import SettingsError
from hydro_core.signals import (
    NEUTRAL_COEFFICIENTS,
    STATE_FIELDS,
    Command,
    Flag,
    FloatArray,
    Law,
    ReferenceSignal,
    Waveform,
)
from hydro_sim.box import firmware
from hydro_sim.box.box import NAME, Box, BoxConfig, box_info, law_state
from hydro_sim.box.firmware import STRUCTURES, Precision
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from tests.box_frames import encode_state
from tests.checks import compiled, ran

FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
BROKEN = (nan, inf, -inf, 1e30, -1e30, 5001.0)
NOMINAL = Bench.nominal()


def drawn_number(random: Random, scale: float) -> float:
    return random.choice(BROKEN) if random.random() < 0.02 else random.gauss(0.0, scale)


def drawn_command(random: Random) -> Command:
    signal = ReferenceSignal(
        waveform=random.choice(tuple(Waveform)), amplitude=abs(drawn_number(random, 200.0)),
        offset=drawn_number(random, 100.0),
        frequency=random.choice((0.3, 2.0, 999.0, 1000.0, 0.0, -1.0, nan, random.uniform(0.1, 20.0))),
        phase=drawn_number(random, 3.0),
    )  # fmt: skip
    return Command(
        arm=random.random() < 0.8, delta_kp=drawn_number(random, 100.0), delta_ki=drawn_number(random, 30.0),
        delta_u=drawn_number(random, 0.02), reference=signal,
        law=random.choice((Law.PAPER, Law.COMPENSATED, Law.COMPENSATED)),
        coefficients=tuple(drawn_number(random, scale) for scale in (1.0, 0.05, 2e-3, 30.0, 1e-5)),  # type: ignore[arg-type]
        velocity_compensation=drawn_number(random, 0.4), valve_gain_scale=drawn_number(random, 2.0),
        corrected_sequence=random.getrandbits(32), filter_fresh=random.random() < 0.5,
    )  # fmt: skip


def streams(seed: int, samples: int) -> Iterator[tuple[Command | None, FloatArray]]:
    """A command of the host, or none, and a measurement for each millisecond."""
    random, command, silent = Random(seed), Command(), 0
    x = np.array([0.0, 0.0, 0.0, 0.0, 3.7e6, 6.2e6, 0.04, 0.0])
    for k in range(samples):
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
        yield (None if silent or random.random() < 0.05 else command), y


def places(kind: np.dtype[np.void], within: str = "") -> Iterator[tuple[str, int]]:
    """Every field by its C name with its offset, those of inner structures and of an array's last one, too."""
    assert kind.fields is not None
    for name, (inner, offset, *_) in kind.fields.items():
        yield within + name, offset
        of, shape_of = inner.subdtype or (inner, ())
        if of.names:
            begin = offset + (shape_of[0] - 1) * of.itemsize if shape_of else offset
            last = f"[{shape_of[0] - 1}]" if shape_of else ""
            yield from ((path, begin + place) for path, place in places(of, f"{within}{name}{last}."))


@pytest.mark.parametrize("precision", STRUCTURES)
def test_the_records_lie_in_memory_as_the_c_compiler_lays_them_out(precision: Precision, tmp_path: Path) -> None:
    expected = [
        (f"hydro_{kind}, {path}", place)
        for kind in ("config", "command", "box")
        for path, place in places(getattr(STRUCTURES[precision], kind))
    ]
    lines = "".join(f'    printf("%zu\\n", offsetof({what}));\n' for what, _ in expected)
    source = tmp_path / "offsets.c"
    source.write_text(f'#include <stdio.h>\n#include "hydro/box.h"\n\nint main(void)\n{{\n{lines}    return 0;\n}}\n')
    words = ("-DHYDRO_SINGLE",) if precision == "single" else ()
    done = ran(compiled(source, tmp_path / "offsets", f"-I{FIRMWARE}", *words), check=True)
    found = map(int, done.stdout.split())
    assert [what for (what, place), at in zip(expected, found, strict=True) if place != at] == []
    assert len(expected) > 150


def test_a_library_that_is_missing_or_of_another_version_is_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(SettingsError, match=r"libhydro_box_double\.so is not built: run `make setup`"):
        firmware.library_path("double")
    (tmp_path / "lib").mkdir()
    (tmp_path / "older.c").write_text("int older = 1;\n")
    compiled(tmp_path / "older.c", tmp_path / "lib" / "libhydro_box_double.so", "-fPIC", "-shared")
    with pytest.raises(SettingsError, match="of another version: run `make setup`"):
        firmware.library.__wrapped__("double")


def single(values: tuple[object, ...]) -> list[object]:
    """Numbers as float32."""
    flat = [one for value in values for one in (value if isinstance(value, tuple) else (value,))]
    return [np.float32(one) if isinstance(one, float) else one for one in flat]


def test_a_greeted_box_tells_what_it_was_configured_with() -> None:
    config, sensors = BoxConfig(integral="paper", feedback="hydraulic"), Sensors(velocity_age=2e-3)
    box = Box(NOMINAL, config, sensors, epoch=7)
    box.feed(protocol.encode_hello(0, 0))
    box.tick(np.zeros(8), 0.25)
    frames: dict[type[protocol.Frame], protocol.Frame] = {
        type(frame): frame for frame in Decoder().feed(b"\0" + box.frames())
    }
    hello, details, law = frames[protocol.Hello], frames[protocol.Details], frames[protocol.LawFrame]
    assert (
        isinstance(hello, protocol.Hello)
        and isinstance(details, protocol.Details)
        and isinstance(law, protocol.LawFrame)
    )
    assert hello.time_us == details.time_us == law.time_us == 250_000
    assert single(astuple(hello.info)) == single(astuple(box_info(NOMINAL, config, NAME)))
    told, margin = details.details, config.position_margin
    assert (told.epoch, told.bench_digest, told.feedback, told.laws) == (7, NOMINAL.digest, "hydraulic", 3)
    assert single(astuple(told)[4:]) == single((
        config.load_force_limit, config.force_range, config.pressure_min, config.pressure_max, -margin,
        NOMINAL.stroke + margin, config.hold_timeout, config.trip_timeout, sensors.force_rate_age, 2e-3,
    ))  # fmt: skip
    assert single(astuple(law.record)) == single(astuple(config.compensated))


def bits(sample: np.void) -> bytes:
    """All of a sample, without what lies between its fields."""
    return struct.pack("<dI14dI", *sample.item())


@pytest.mark.parametrize(("seed", "integral"), [(1, "bumpless"), (2, "bumpless"), (3, "paper")])
def test_a_command_past_the_line_acts_as_by_the_line_and_frames_tell_the_sample(seed: int, integral: str) -> None:
    """Hostile commands and measurements; the frames are the bytes that the Python codec makes of the same sample."""
    config = BoxConfig(integral=integral)  # type: ignore[arg-type]
    line, past = Box(NOMINAL, config), Box(NOMINAL, config)
    moved = cut = 0
    seen: set[int] = set()
    for k, (command, x) in enumerate(streams(seed, 20_000)):
        if command is not None:
            frame = protocol.encode_command(k + 1, 0, command)
            sent = protocol.decode(frame[1:-1])
            assert isinstance(sent, protocol.CommandFrame)
            line.feed(frame)
            past.receive(sent.command, k * 1e-3)
        sample = line.tick(x, k * 1e-3)
        assert bits(sample) == bits(past.tick(x, k * 1e-3)), k
        acting = law_state(line.state[0])
        assert repr(acting) == repr(law_state(past.state[0])), k  # with NaN where a sensor shows it
        _, sequence, *values, flags = sample.item()
        state = encode_state(sequence, 1000 * k, values, flags, int(line.state["confirmed"][0]), line.refused, acting)
        assert line.frames()[-len(state) :] == state, k
        seen.add(flags)
        if flags & Flag.ARMED and acting.law is Law.COMPENSATED:
            moved += acting.coefficients != NEUTRAL_COEFFICIENTS
            cut += abs(acting.compensated_reference) == config.compensated.reference_max
    assert line.refused == past.refused and line.refused[1] > 20
    assert {int(Flag.ARMED), int(Flag.ARMED | Flag.SATURATED)} & seen and len(seen) > 12
    assert moved > 1000 and cut > 10


def drawn_law(random: Random, law: Law) -> Command:
    """One that a guard lets through, and whose reference is never cut off."""
    share, slower = (0.6, 0.25) if law is Law.COMPENSATED else (1.0, 1.0)
    shape = ReferenceSignal(
        waveform=random.choice(tuple(Waveform)), amplitude=share * random.uniform(0.0, 250.0),
        frequency=slower * random.uniform(0.2, 8.0),
    )  # fmt: skip
    command = Command(arm=True, delta_ki=5.0, delta_u=1e-4, reference=shape, filter_fresh=True)
    if law is Law.PAPER:
        return replace(command, delta_kp=45.0)
    shaping = (random.uniform(0.9, 1.1), random.uniform(0.0, 0.03), random.uniform(0.0, 4e-4), -5.0, 2e-6)
    return replace(command, law=law, coefficients=shaping, velocity_compensation=0.3)


@pytest.mark.parametrize("law", Law)
def test_single_precision_stays_within_its_rounding(law: Law) -> None:
    """Both boxes see the bench that the double one moves: each sample's difference is rounding, none is chaos."""
    random, plant, command = Random(5), AnalyticPlant(NOMINAL), Command()
    double, single = Box(NOMINAL), Box(NOMINAL, precision="single")
    x, worst = plant.reset(5), dict.fromkeys((*STATE_FIELDS, "f_c", "f_c'"), 0.0)
    for k in range(20_000):
        if k % 700 == 1:
            command = drawn_law(random, law)
        for box in (double, single):
            box.feed(protocol.encode_command(k + 1, 0, command))
        a, b = double.tick(x, k * 1e-3), single.tick(x, k * 1e-3)
        assert (int(a["flags"]) ^ int(b["flags"])) & ~Flag.SATURATED == 0
        acting, other = law_state(double.state[0]), law_state(single.state[0])
        assert acting.law is other.law is (law if k else Law.PAPER)
        apart = {name: float(a[name]) - float(b[name]) for name in STATE_FIELDS}
        apart["f_c"] = acting.compensated_reference - other.compensated_reference
        apart["f_c'"] = acting.compensated_reference_rate - other.compensated_reference_rate
        worst = {name: max(worst[name], abs(change)) for name, change in apart.items()}
        x = plant.step(float(a["valve_current"]))
    print(worst)
    assert worst["valve_current"] < 1e-7 and worst["reference_force"] < 1e-4
    assert worst["reference_force_rate"] < 1e-2 and worst["f_c"] < 2e-3 and worst["f_c'"] < 2.0
