# SPDX-License-Identifier: Apache-2.0
"""The default filter's decision in C, generated here and compiled, against the compiled Python one."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, Command, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller import header, loop_decision
from hydro_filter.controller.loop_decision import LoopParts
from hydro_filter.controller.loop_filter import loop_parts
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import memories
from hydro_sim.box.box import Box
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests import checks

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
WIDTH = len(STATE_FIELDS)
READ = WIDTH - 1
"""Columns that a decision rests on: all of STATE but integral_gain."""
KINDS = {"double": np.float64, "single": np.float32}
WORDS = {"double": (), "single": ("-DHYDRO_SINGLE",)}
SIGNALS = ("nominal_valve_current", "valve_current", "reference_force", "reference_force_rate", "proportional_gain")
PLACES = [STATE_FIELDS.index(name) for name in SIGNALS]
LOW = np.array([-5e3, -1e8, -5e3, -1e8, -0.5e6, -0.5e6, -5e-3, -10, -0.05, -100, -5e3, -3.2e7, -40, -20])
HIGH = np.array([5e3, 1e8, 5e3, 1e8, 25e6, 25e6, 85e-3, 10, 0.05, 100, 5e3, 3.2e7, 300, 100])
"""What STATE may show of a sound box: ranges of the sensors, of the law and of the gains."""
MOST = np.array([1e5, 1e9, 1e5, 1e9, 1e8, 1e8, 1.0, 20.0, 0.1, 1e4, 1e5, 1e9, 1e4, 1e4])
"""Magnitudes that loop_filter.h still computes with."""
BELIEVED = Bench.nominal()
"""What the force law believes."""


def parts_of(truth: Bench) -> LoopParts:
    """Parts of the shipped metric on a bench file."""
    return loop_parts(ScheduledMetric.load(), truth, BELIEVED)


def uneven() -> Bench:
    """A bench none of whose numbers is 0, 1 or another's equal: what the shipped one leaves out shows."""
    shipped = load_model()
    numbers = [name for name in Bench.quantities() if name != "load_cell_bandwidth"]
    shares = np.linspace(0.85, 1.15, len(numbers))
    changed = {name: share * getattr(shipped, name) for name, share in zip(numbers, shares, strict=True)}
    changed |= {"tank_pressure": 2e5, "stroke": 0.09375, "spring_rest_position": 0.041}
    offset = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    cells = [
        {"id": "load_cell_gain", "cell": "load_force", "parameters": {"ratio": 0.92}},
        {"id": "load_cell_bias", "cell": "load_force", "parameters": {"force": -4.0}},
        {"id": "load_cell_gain", "cell": "hydraulic_force", "parameters": {"ratio": 1.1}},
        {"id": "load_cell_bias", "cell": "hydraulic_force", "parameters": {"force": 7.0}},
    ]
    effects = (offset, *shipped.effects, {**offset, "parameters": {"current": 5e-4}}, *cells)
    return replace(shipped, **changed, effects=effects, learned=None)


def written(folder: Path, truth: Bench) -> Path:
    """`folder` with the generated header."""
    (folder / "filter_config.h").write_text(header.header(parts_of(truth), truth, "A test."))
    return folder


def compiled(folder: Path, precision: str, *words: str) -> Path:
    """The program that decides about samples, with the header of `folder`."""
    program, source = folder / f"replay_{precision}", FIRMWARE / "test" / "replay_filter.c"
    return checks.compiled(source, program, f"-I{FIRMWARE}", f"-I{folder}", *WORDS[precision], *words)


def replay(program: Path, precision: str, rows: FloatArray) -> FloatArray:
    """delta_u, before, after, status of samples in a row: `STATE_FIELDS`, then whether it is armed.

    Raises subprocess.CalledProcessError: a floating-point exception, or a word of a sanitizer.
    """
    given = np.ascontiguousarray(rows, KINDS[precision]).tobytes()
    done = subprocess.run([str(program)], input=given, capture_output=True, check=True, timeout=300)
    return np.frombuffer(done.stdout, KINDS[precision]).reshape(len(rows), 4).astype(np.float64)


def law(row: FloatArray) -> tuple[float, float, float, float]:
    """The paper's law of a row, as `decide` has it."""
    _, _, reference, reference_rate, _ = row[PLACES].tolist()
    return reference, reference_rate, 1.0, 1.0


def decided(parts: LoopParts, rows: FloatArray) -> FloatArray:
    """The same by the compiled Python; what is not finite as 0, as C tells it."""
    memory, space = memories(), loop_decision.workspace(parts)
    made = [
        loop_decision.decide(parts, memory[0], row[:8].copy(), *row[PLACES], law(row), bool(row[WIDTH]), space)
        for row in rows
    ]
    return np.nan_to_num(np.array(made), posinf=0.0, neginf=0.0)


def commands(seed: int, samples: int) -> Iterator[tuple[int, Command]]:
    """References and gains of and beyond the certified range, another every 0.4 s; now and then disarmed."""
    rng = np.random.default_rng(seed)
    for k in range(0, samples, 400):
        signal = ReferenceSignal(
            waveform=Waveform(int(rng.integers(4))), amplitude=rng.uniform(0.0, 250.0), offset=rng.uniform(-60.0, 60.0),
            frequency=rng.uniform(0.2, 8.0), phase=rng.uniform(-3.0, 3.0),
        )  # fmt: skip
        yield k, Command(arm=k % 4000 != 0, delta_kp=rng.uniform(-40.0, 200.0), delta_ki=rng.uniform(-5.0, 25.0),
                         reference=signal, filter_fresh=True)  # fmt: skip


def recorded(parts: LoopParts, seed: int, samples: int) -> FloatArray:
    """Samples of the emulated box on a bench that the filter corrects, a sample late, as the graph does."""
    bench = Bench.nominal()
    box, plant = Box(bench), AnalyticPlant(bench)
    memory, space = memories(), loop_decision.workspace(parts)
    x, rows, wanted, delta_u = plant.reset(seed), [], dict(commands(seed, samples)), 0.0
    for k in range(samples):
        command = wanted.get(k - k % 400, Command())
        box.receive(replace(command, delta_u=float(delta_u)), k * 1e-3)
        sample = box.tick(x, k * 1e-3)
        armed = bool(int(sample["flags"]) & Flag.ARMED)
        row = np.array([float(sample[name]) for name in STATE_FIELDS] + [float(armed)])
        rows.append(row)
        delta_u = loop_decision.decide(parts, memory[0], row[:8].copy(), *row[PLACES], law(row), armed, space)[0]
        x = plant.step(float(sample["valve_current"]))
    return np.array(rows)


def drawn(count: int, seed: int = 4) -> FloatArray:
    """Samples that do not follow one another, over `LOW` to `HIGH`: each number from the ends to a millionth of them.

    Of every seventh one number is not finite, each column and each kind in its turn.
    """
    rng = np.random.default_rng(seed)
    middle, half = 0.5 * (LOW + HIGH), 0.5 * (HIGH - LOW)
    reach = 10.0 ** -rng.uniform(0.0, 6.0, (count, WIDTH))
    rows = middle + half * rng.choice([-1.0, 1.0], (count, WIDTH)) * reach
    for turn, k in enumerate(range(6, count, 7)):
        rows[k, turn % WIDTH] = (math.nan, math.inf, -math.inf)[turn // WIDTH % 3]
    return np.column_stack([rows, rng.random(count) < 0.9])


def hostile(count: int, seed: int, precision: str) -> FloatArray:
    """Samples with any bits, denormals, huge numbers, divisors that vanish, and all up to `MOST`, by quarters."""
    rng = np.random.default_rng(seed)
    kind = KINDS[precision]
    rows = drawn(count, seed).astype(kind)
    values, shape = rows[:, :WIDTH], (count, WIDTH)
    bits = rng.integers(0, 256, (count, WIDTH * kind().itemsize), np.uint8).view(kind)
    most, tiny = np.finfo(kind).max, np.finfo(kind).smallest_subnormal
    special = np.array([0.0, -0.0, tiny, -tiny, most, -most, 1e9, -1e9, -1.0, 1.0, np.inf, -np.inf, np.nan], kind)
    wide = (MOST * rng.choice([-1.0, 1.0], shape) * 10.0 ** -rng.uniform(0.0, 12.0, shape)).astype(kind)
    quarter, some = rng.integers(0, 4, (count, 1)), rng.random(shape) < 0.1
    values[:] = np.where((quarter == 0) & some, bits, values)
    values[:] = np.where((quarter == 1) & some, rng.choice(special, shape), values)
    values[:] = np.where((quarter == 2) & some | (quarter == 3), wide, values)
    return rows  # type: ignore[return-value]


SANITIZE = ("-O0", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")


@pytest.fixture(scope="module")
def parts() -> LoopParts:
    return parts_of(load_model())


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("loop_filter"), load_model())


@pytest.fixture(scope="module")
def programs(generated: Path) -> dict[str, Path]:
    return {precision: compiled(generated, precision, "-O2") for precision in WORDS}


@pytest.fixture(scope="module")
def row(parts: LoopParts) -> FloatArray:
    """A sample that both decide about."""
    return recorded(parts, 1, 600)[-1]


def compare(found: FloatArray, expected: FloatArray, label: str) -> tuple[float, float, float]:
    """Share of other statuses; where it is the same, largest differences of delta_u [A] and of M_c as a share of it."""
    same = found[:, 3] == expected[:, 3]
    worst = float(np.abs(found - expected)[same, 0].max())
    scale = np.maximum(np.abs(expected[:, 1:2]), 1.0)
    measure = float((np.abs(found - expected)[:, 1:3] / scale)[same].max())
    counts = np.bincount(expected[:, 3].astype(int), minlength=5)
    print(f"{label}: delta_u {worst:.2g} A, M_c {measure:.2g} of it, other status {(~same).sum()} of {counts.tolist()}")
    return float((~same).mean()), worst, measure


def test_samples_are_decided_as_in_python_but_for_rounding(
    parts: LoopParts, programs: dict[str, Path], tmp_path: Path
) -> None:
    """On the shipped bench file and on an uneven one."""
    truth, shipped = uneven(), (parts, programs["double"])
    other = parts_of(truth)
    changed = (other, compiled(written(tmp_path, truth), "double", "-O2"))
    trials = {
        "recorded": (*shipped, recorded(parts, 1, 10_000), 1e-14, 0),
        "drawn": (*shipped, drawn(20_000), 1e-12, 500),
        "uneven, recorded": (*changed, recorded(other, 4, 10_000), 1e-12, 0),
        # drawn samples jump through the whole stroke in 1 ms: there 1e-10 of the valve's range is rounding
        "uneven, drawn": (*changed, drawn(20_000, 9), 1e-11, 500),
    }
    for label, (by, program, rows, most, least) in trials.items():
        expected = decided(by, rows)
        differing, worst, measure = compare(replay(program, "double", rows), expected, label)
        assert differing == 0.0 and worst < most and measure < 1e-9, label
        assert {0.0, 1.0} <= set(expected[:, 3]), "there was something to correct"
        assert not least or np.bincount(expected[:, 3].astype(int)).min() > least, "every status is tried"


def test_single_precision_stays_near(parts: LoopParts, programs: dict[str, Path]) -> None:
    rows = recorded(parts, 1, 10_000).astype(np.float32).astype(np.float64)
    other, worst, _ = compare(replay(programs["single"], "single", rows), decided(parts, rows), "single, recorded")
    assert other < 1e-3 and worst < 1e-6


@pytest.mark.parametrize("precision", WORDS)
def test_a_number_that_is_none_or_that_no_bench_shows_gets_no_decision(
    row: FloatArray, programs: dict[str, Path], precision: str
) -> None:
    fresh = replay(programs[precision], precision, np.array([row]))
    for column in range(WIDTH):
        beyond = () if column == READ else (1.01 * MOST[column], -1.01 * MOST[column], 1e30, -1e30)
        for value in (math.nan, math.inf, -math.inf, *beyond):
            spoilt = row.copy()
            spoilt[column] = value
            found = replay(programs[precision], precision, np.array([row, spoilt, row]))
            read = column < READ
            assert found[1].tolist() == [0.0, 0.0, 0.0, 4.0] if read else found[1, 3] != 4.0, column
            assert not read or found[2].tolist() == fresh[0].tolist(), "the memory began again"


@pytest.mark.parametrize("precision", WORDS)
def test_hostile_samples_raise_no_exception_and_no_word_of_a_sanitizer(generated: Path, precision: str) -> None:
    found = replay(compiled(generated, precision, *SANITIZE), precision, hostile(20_000, 1, precision))
    assert np.isfinite(found).all() and set(found[:, 3]) == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert np.all(found[np.isin(found[:, 3], (0.0, 3.0, 4.0)), 0] == 0.0), "no correction where there is none"


def test_it_compiles_for_a_bare_machine(generated: Path) -> None:
    for precision in WORDS:
        compiled(generated, precision, "-O0", "-ffreestanding")
