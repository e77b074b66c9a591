# SPDX-License-Identifier: Apache-2.0
"""The default filter's decision in C, generated here and compiled, against the compiled Python one."""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, Command, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller import header, loop_decision, loop_header
from hydro_filter.controller.loop_decision import LoopParts
from hydro_filter.controller.loop_filter import loop_parts
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.model.loop import memories
from hydro_sim.box.box import Box
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

ROOT = Path(__file__).resolve().parent.parent
WIDTH = len(STATE_FIELDS)
PRECISIONS = {"double": ([], ctypes.c_double), "single": (["-DHYDRO_SINGLE"], ctypes.c_float)}
SOURCE = """#include <fenv.h>
#include "filter_config.h"
int many(int count, const hydro_real *in, hydro_real *out)
{
    hydro_memory_of_loop memory = {0};
    feclearexcept(FE_ALL_EXCEPT);
    for (int k = 0; k < count; k++, in += 15, out += 4) {
        hydro_decision made = hydro_decide_loop(&HYDRO_LOOP_FILTER, &memory, in, in[14] > HYDRO_R(0));
        out[0] = made.delta_u;
        out[1] = made.before;
        out[2] = made.after;
        out[3] = (hydro_real)made.status;
    }
    return fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
}
"""
SIGNALS = ("nominal_valve_current", "valve_current", "reference_force", "reference_force_rate", "proportional_gain")
PLACES = [STATE_FIELDS.index(name) for name in SIGNALS]


@pytest.fixture(scope="module")
def parts() -> LoopParts:
    return loop_parts(LearnedMetric.load(), Learned.load().model, Bench.nominal())  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def generated(parts: LoopParts, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop_filter")
    (folder / "filter_config.h").write_text(loop_header.header(parts, "A test."))
    return folder


def in_c(folder: Path, precision: str, rows: FloatArray) -> FloatArray:
    """delta_u, before, after, status of samples in a row: `STATE_FIELDS`, then whether it is armed."""
    words, kind = PRECISIONS[precision]
    (folder / "many.c").write_text(SOURCE)
    library = folder / f"many_{precision}.so"
    strict = ["-std=c99", "-O2", "-ffreestanding", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    places = [f"-I{ROOT / 'firmware'}", f"-I{folder}", "-fPIC", "-shared"]
    program = [os.environ.get("CC", "cc"), *strict, *places, *words, str(folder / "many.c"), "-o", str(library), "-lm"]
    subprocess.run(program, check=True)
    given, made = np.ascontiguousarray(rows, kind), np.zeros((len(rows), 4), kind)
    pointer = ctypes.POINTER(kind)
    raised = ctypes.CDLL(str(library)).many(len(rows), given.ctypes.data_as(pointer), made.ctypes.data_as(pointer))
    assert raised == 0, "a floating-point exception"
    return made.astype(np.float64)


def decided(parts: LoopParts, rows: FloatArray) -> FloatArray:
    """The same by the compiled Python; what is not finite as 0, as C tells it."""
    memory, space = memories(parts.loop), loop_decision.space(parts)
    made = [
        loop_decision.decide(parts, memory[0], row[:8].copy(), *row[PLACES], bool(row[WIDTH]), space) for row in rows
    ]
    return np.nan_to_num(np.array(made))


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
    memory, space = memories(parts.loop), loop_decision.space(parts)
    x, rows, wanted, delta_u = plant.reset(seed), [], dict(commands(seed, samples)), 0.0
    for k in range(samples):
        command = wanted.get(k - k % 400, Command())
        box.receive(replace(command, delta_u=float(delta_u)), k * 1e-3)
        sample = box.tick(x, k * 1e-3)
        armed = bool(int(sample["flags"]) & Flag.ARMED)
        row = np.array([float(sample[name]) for name in STATE_FIELDS] + [float(armed)])
        rows.append(row)
        delta_u = loop_decision.decide(parts, memory[0], row[:8].copy(), *row[PLACES], armed, space)[0]
        x = plant.step(float(sample["valve_current"]))
    return np.array(rows)


def drawn(count: int) -> FloatArray:
    """Samples that do not follow one another, over all that the sensors show; some are not finite."""
    rng = np.random.default_rng(4)
    low = [-800, -2e4, -800, -2e4, -0.4e6, -0.4e6, -4e-3, -0.4, -0.05, -0.08, -400, -4e3, -40, 0]
    high = [800, 2e4, 800, 2e4, 17e6, 17e6, 0.084, 0.4, 0.05, 0.08, 400, 4e3, 300, 50]
    rows = np.column_stack([rng.uniform(low, high, (count, WIDTH)), rng.random(count) < 0.9])
    rows[::97, rng.integers(0, 13)] = math.nan
    return rows


def compare(found: FloatArray, expected: FloatArray, label: str) -> tuple[float, float]:
    """Share of other statuses, and the largest difference of delta_u [A] where it is the same."""
    same = found[:, 3] == expected[:, 3]
    worst = float(np.abs(found - expected)[same, 0].max())
    scale = np.maximum(np.abs(expected[:, 1]), 1.0)
    before = float((np.abs(found - expected)[:, 1] / scale).max())
    counts = np.bincount(expected[:, 3].astype(int), minlength=5)
    print(f"{label}: delta_u {worst:g} A, M_c {before:g} of itself, other status {(~same).sum()} of {counts.tolist()}")
    return float((~same).mean()), worst


@pytest.mark.parametrize("seed", [1, 2])
def test_recorded_samples_are_decided_as_in_python_but_for_rounding(
    parts: LoopParts, generated: Path, seed: int
) -> None:
    rows = recorded(parts, seed, 10_000)
    expected = decided(parts, rows)
    other, worst = compare(in_c(generated, "double", rows), expected, f"recorded, {seed}")
    assert other == 0.0 and worst < 1e-14
    assert {0.0, 1.0} <= set(expected[:, 3]), "there was something to correct"


def test_drawn_samples_are_decided_as_in_python_but_for_rounding(parts: LoopParts, generated: Path) -> None:
    rows = drawn(10_000)
    expected = decided(parts, rows)
    other, worst = compare(in_c(generated, "double", rows), expected, "drawn")
    assert other == 0.0 and worst < 1e-13
    assert set(expected[:, 3]) == {0.0, 1.0, 2.0, 3.0, 4.0}, "every status is tried"


def test_single_precision_stays_near(parts: LoopParts, generated: Path) -> None:
    rows = recorded(parts, 1, 10_000).astype(np.float32).astype(np.float64)
    other, worst = compare(in_c(generated, "single", rows), decided(parts, rows), "single, recorded")
    assert other < 1e-3 and worst < 1e-6


def test_a_network_is_refused_in_a_sentence(parts: LoopParts) -> None:
    with_network = LearnedMetric.load()
    flat = with_network.flat.copy()
    flat[-1] = 0.1
    other = parts._replace(metric=with_network.with_weights(flat).parts)
    with pytest.raises(ValueError, match="the metric has a network that adds to it, for which the box in C has no pl"):
        loop_header.header(other, "")


def written(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["filter_header", *words])
    with pytest.raises(SystemExit) as ended:
        header.main()
    return int(ended.value.code or 0)


def test_the_command_writes_what_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert written(monkeypatch, "--metric", "learned", "--out", str(tmp_path / "filter_config.h")) == 0
    found = in_c(tmp_path, "single", np.ones((3, WIDTH + 1)))
    assert np.isfinite(found).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--metric", "learned", "--noise-floor", "1"], "--noise-floor: a learned metric brings its own"),
        (["--model", "x"], "--model: the constant metric has none"),
        (["--metric", "nothing.safetensors"], "nothing.safetensors"),
        (["--metric", "learned", "--contraction-rate", "-1"], "contraction_rate"),
    ],
)
def test_what_cannot_be_is_told_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert written(monkeypatch, *words, "--out", str(tmp_path / "filter_config.h")) != 0
    assert said in capsys.readouterr().err and not (tmp_path / "filter_config.h").exists()
