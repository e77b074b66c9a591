# SPDX-License-Identifier: Apache-2.0
"""The filter that `export_c` writes for a box, compiled, against the filter of the graph: the same decision in C."""

from __future__ import annotations

import math
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_bridge.serial.protocol import LawState
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
from hydro_filter.controller import header
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, filter_record
from hydro_filter.metric import MetricDesign, ScheduledMetric, Thresholds
from hydro_filter.model.loop import make_loop
from hydro_filter.model.sample import Sample
from hydro_sim.box.box import Box
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests import checks

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
WIDTH = len(STATE_FIELDS)
"""Columns that a decision rests on: all of STATE but integral_gain."""
KINDS = {"double": np.float64, "single": np.float32}
WORDS = {"double": (), "single": ("-DHYDRO_SINGLE",)}
SANITIZE = ("-O0", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
SIGNALS = ("nominal_valve_current", "valve_current", "reference_force", "reference_force_rate", "proportional_gain")
PLACES = [STATE_FIELDS.index(name) for name in SIGNALS]
LOW = np.array([-5e3, -1e8, -5e3, -1e8, -0.5e6, -0.5e6, -5e-3, -10, -0.05, -100, -5e3, -3.2e7, -40, -20])
HIGH = np.array([5e3, 1e8, 5e3, 1e8, 25e6, 25e6, 85e-3, 10, 0.05, 100, 5e3, 3.2e7, 300, 100])
"""What STATE may show of a sound box: ranges of the sensors, of the law and of the gains."""
MOST = np.array([1e5, 1e9, 1e5, 1e9, 1e8, 1e8, 1.0, 20.0, 0.1, 1e4, 1e5, 1e9, 1e4, 1e4])
"""Magnitudes that loop_filter.h still computes with."""
BELIEVED = Bench.nominal()
"""What the force law believes."""
SHIPPED = ScheduledMetric.load(), load_model()


def uneven() -> tuple[ScheduledMetric, Bench]:
    """A bench none of whose numbers is 0, 1 or another's equal: what the shipped one leaves out shows.

    Its metric is that of this bench at rest, with noise that does not count for nothing.
    """
    shipped = load_model()
    numbers = [name for name in Bench.quantities() if name != "load_cell_bandwidth"]
    shares = np.linspace(0.85, 1.15, len(numbers))
    changed = {name: share * getattr(shipped, name) for name, share in zip(numbers, shares, strict=True)}
    changed |= {"tank_pressure": 2e5, "stroke": 0.09375, "spring_rest_position": 0.041}

    def effect(kind: str, place: dict[str, str] | None = None, **parameters: float) -> dict[str, Any]:
        return {"id": kind, **(place or {}), "parameters": parameters}

    load, hydraulic = {"cell": "load_force"}, {"cell": "hydraulic_force"}
    effects = (
        effect("transport_delay", time=1e-3),
        effect("valve_offset", current=1e-3),
        *shipped.effects,
        effect("valve_deadband", {"form": "lopsided"}, half_width=4e-4, half_width_negative=2e-4),
        effect("valve_offset", current=5e-4),
        effect("load_cell_gain", load, ratio=0.92),
        effect("load_cell_bias", load, force=-4.0),
        effect("load_cell_gain", hydraulic, ratio=1.1),
        effect("load_cell_bias", hydraulic, force=7.0),
        effect("sensor_lag", {"sensor": "pressure_a"}, bandwidth=80.0, damping=0.7),
        effect("sensor_lag", {"sensor": "pressure_b"}, bandwidth=200.0, damping=0.7),
        effect("sensor_lag", {"sensor": "hydraulic_force"}, bandwidth=60.0, damping=0.7),
    )
    truth = replace(shipped, **changed, effects=effects, learned=None)
    design = MetricDesign(gain_low=20.0, gain_high=60.0, velocity_compensation=0.3)
    metric = ScheduledMetric.from_design(make_loop(truth, BELIEVED), design)
    return replace(metric, thresholds=Thresholds(noise_size=1e-3, foreign_noise_size=1e-3)), truth


def compiled(folder: Path, metric: ScheduledMetric, truth: Bench, precision: str, *words: str) -> Path:
    """The program that decides about samples by this metric, as compiled for a bare machine."""
    record, loop = filter_record(metric, truth, BELIEVED), make_loop(truth, BELIEVED)
    (folder / "filter_config.h").write_text(header.render_header(record, loop, metric.table, "A test."))
    program, source = folder / f"replay_{precision}", FIRMWARE / "test" / "replay_filter.c"
    places = (f"-I{FIRMWARE}", f"-I{folder}", "-ffreestanding")
    return checks.compiled(source, program, *places, *WORDS[precision], *(words or ("-O1",)))


def replay(program: Path, precision: str, rows: FloatArray, law: FloatArray | None = None) -> FloatArray:
    """delta_u, before, after, status, broken equation of samples in a row: `STATE_FIELDS`, then whether it is armed.

    `law`: f_c, f_c', C_1, C_2 of each; the paper's if absent. Raises subprocess.CalledProcessError: a floating-point
    exception, or a word of a sanitizer.
    """
    given = np.ascontiguousarray(seen(rows, law), KINDS[precision]).tobytes()
    done = subprocess.run([str(program)], input=given, capture_output=True, check=True, timeout=300)
    return np.frombuffer(done.stdout, KINDS[precision]).reshape(len(rows), 5).astype(np.float64)


def seen(rows: FloatArray, law: FloatArray | None) -> FloatArray:
    """Columns of hydro_loop_sample."""
    ones = np.ones((len(rows), 2), rows.dtype)
    law = np.column_stack([rows[:, PLACES[2:4]], ones]) if law is None else law
    return np.column_stack([rows[:, :8], rows[:, PLACES], law, rows[:, WIDTH]])


def decided(metric: ScheduledMetric, truth: Bench, rows: FloatArray, law: FloatArray | None = None) -> FloatArray:
    """The same by the filter of the graph."""
    made, out = LoopFilter(filter_record(metric, truth, BELIEVED)), np.empty((len(rows), 5))
    for k, row in enumerate(seen(rows, law)):
        nominal, current, reference, rate, gain, f_c, f_c_rate, c_1, c_2, armed = row[8:].tolist()
        acting = LawState(Law.COMPENSATED, f_c, f_c_rate, NEUTRAL_COEFFICIENTS, c_1, c_2) if law is not None else None
        made.correct(Sample(row[:8], nominal, reference, gain, current, rate, armed > 0.0, acting))
        delta_u, before, after, *_, status, _ = made.decision.item()
        out[k] = delta_u, before, after, status, made.monitor["broken"][0]
    return out


def recorded(metric: ScheduledMetric, truth: Bench, seed: int, samples: int) -> FloatArray:
    """Samples of the emulated box on a bench that the filter corrects, a sample late, as the graph does.

    References and gains are of and beyond the certified range, others every 0.4 s; now and then it is disarmed.
    """
    bench, rng = Bench.nominal(), np.random.default_rng(seed)
    patient = LoopFilterSettings(innovation_limit=10.0)  # the bench is not quite the model
    box, plant, made = Box(bench), AnalyticPlant(bench), LoopFilter(filter_record(metric, truth, BELIEVED), patient)
    x, rows, delta_u = plant.reset(seed), [], 0.0
    for k in range(samples):
        if k % 400 == 0:
            signal = ReferenceSignal(
                waveform=Waveform(int(rng.integers(4))), amplitude=rng.uniform(0.0, 250.0),
                offset=rng.uniform(-60.0, 60.0), frequency=rng.uniform(0.2, 8.0), phase=rng.uniform(-3.0, 3.0),
            )  # fmt: skip
            gains = {"delta_kp": rng.uniform(-40.0, 200.0), "delta_ki": rng.uniform(-5.0, 25.0)}
            command = Command(arm=k % 4000 != 0, **gains, reference=signal, filter_fresh=True)
        box.receive(replace(command, delta_u=delta_u), k * 1e-3)
        sample = box.tick(x, k * 1e-3)
        armed = bool(int(sample["flags"]) & Flag.ARMED)
        rows.append(np.array([float(sample[name]) for name in STATE_FIELDS] + [float(armed)]))
        delta_u = made.correct(Sample.from_record(sample)).delta_u
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


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("loop_filter")
    return {precision: compiled(folder, *SHIPPED, precision) for precision in WORDS}


@pytest.fixture(scope="module")
def shipped_run() -> FloatArray:
    """Samples of the bench that the shipped filter corrects."""
    return recorded(*SHIPPED, 1, 5000)


def compare(found: FloatArray, expected: FloatArray, label: str) -> tuple[float, float, float]:
    """Share of other statuses; where it is the same, largest differences of delta_u [A] and of M_c as a share of it."""
    same = (found[:, 3:] == expected[:, 3:]).all(axis=1)
    worst = float(np.abs(found - expected)[same, 0].max())
    scale = np.maximum(np.abs(expected[:, 1:2]), 1.0)
    measure = float((np.abs(found - expected)[:, 1:3] / scale)[same].max())
    counts = np.bincount(expected[:, 3].astype(int), minlength=5)
    print(f"{label}: delta_u {worst:.2g} A, M_c {measure:.2g} of it, other status {(~same).sum()} of {counts.tolist()}")
    return float((~same).mean()), worst, measure


def test_what_is_exported_decides_as_the_graphs_filter_but_for_rounding(
    programs: dict[str, Path], shipped_run: FloatArray, tmp_path: Path
) -> None:
    """The shipped metric, and under the compensated law a bench file with all that the loop has a place for."""
    other = uneven()
    k, run = np.arange(5000), recorded(*other, 4, 5000)
    scale = 1.0 + 0.2 * np.sin(k / 300.0)
    law = np.column_stack([1.02 * run[:, PLACES[2]], 1.1 * run[:, PLACES[3]], (0.3 + 0.2 * (k > 4000)) * scale, scale])
    trials = {
        "recorded": (*SHIPPED, programs["double"], shipped_run, None, 1e-13),
        "drawn": (*SHIPPED, programs["double"], drawn(5000), None, 1e-12),
        "uneven, recorded": (*other, compiled(tmp_path, *other, "double"), run, law, 1e-12),
    }
    for label, (metric, truth, by, samples, shaped, most) in trials.items():
        expected = decided(metric, truth, samples, shaped)
        differing, worst, measure = compare(replay(by, "double", samples, shaped), expected, label)
        assert differing == 0.0 and worst < most and measure < 1e-9, label
        counts = np.bincount(expected[:, 3].astype(int), minlength=5)
        assert counts.min() > 100 if label == "drawn" else counts[:2].min() > 0, "every status is tried"
    rows = shipped_run.astype(np.float32).astype(np.float64)
    found = replay(programs["single"], "single", rows)
    differing, worst, _ = compare(found, decided(*SHIPPED, rows), "single, recorded")
    assert differing < 1e-3 and worst < 1e-6


@pytest.mark.parametrize("precision", WORDS)
def test_hostile_samples_raise_no_exception_and_no_word_of_a_sanitizer(tmp_path: Path, precision: str) -> None:
    rows = hostile(20_000, 1, precision)
    other = hostile(20_000, 3, precision)[:, 8:12]
    law = np.where(np.random.default_rng(5).random(other.shape) < 0.9, seen(rows, None)[:, 13:17], other)
    found = replay(compiled(tmp_path, *SHIPPED, precision, *SANITIZE), precision, rows, law)
    assert np.isfinite(found).all() and set(found[:, 3]) == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert np.all(found[np.isin(found[:, 3], (0.0, 3.0, 4.0)), 0] == 0.0), "no correction where there is none"
