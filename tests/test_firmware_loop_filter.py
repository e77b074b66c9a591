# SPDX-License-Identifier: Apache-2.0
"""The default filter's decision in C, generated here and compiled, against the compiled Python one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.controller.loop_decision import LoopParts
from hydro_sim.files.learned_bench import load_model
from tests.firmware_filter import (
    MOST,
    READ,
    WIDTH,
    WORDS,
    compiled,
    decided,
    drawn,
    edges,
    hostile,
    parts_of,
    recorded,
    replay,
    uneven,
    written,
)

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


@pytest.mark.parametrize("seed", [1, 2])
def test_recorded_samples_are_decided_as_in_python_but_for_rounding(
    parts: LoopParts, programs: dict[str, Path], seed: int
) -> None:
    rows = recorded(parts, seed, 10_000)
    expected = decided(parts, rows)
    other, worst, measure = compare(replay(programs["double"], "double", rows), expected, f"recorded, {seed}")
    assert other == 0.0 and worst < 1e-14 and measure < 1e-9
    assert {0.0, 1.0} <= set(expected[:, 3]), "there was something to correct"


def test_drawn_samples_are_decided_as_in_python_but_for_rounding(parts: LoopParts, programs: dict[str, Path]) -> None:
    rows = drawn(20_000)
    expected = decided(parts, rows)
    other, worst, measure = compare(replay(programs["double"], "double", rows), expected, "drawn")
    assert other == 0.0 and worst < 1e-12 and measure < 1e-9
    assert np.all(np.bincount(expected[:, 3].astype(int)) > 500), "every status is tried"


def test_an_uneven_model_is_decided_as_in_python_but_for_rounding(tmp_path: Path) -> None:
    truth = uneven()
    other, program = parts_of(truth), compiled(written(tmp_path, truth), "double", "-O2")
    trials = {"drawn": drawn(20_000, 9), "at edges": edges(truth), "recorded": recorded(other, 4, 10_000)}
    for label, rows in trials.items():
        differing, worst, measure = compare(replay(program, "double", rows), decided(other, rows), f"uneven, {label}")
        # drawn samples jump through the whole stroke in 1 ms: there 1e-10 of the valve's range is rounding
        assert differing == 0.0 and worst < (1e-11 if label == "drawn" else 1e-12) and measure < 1e-9


def test_single_precision_stays_near(parts: LoopParts, programs: dict[str, Path]) -> None:
    rows = recorded(parts, 1, 10_000).astype(np.float32).astype(np.float64)
    other, worst, _ = compare(replay(programs["single"], "single", rows), decided(parts, rows), "single, recorded")
    assert other < 1e-3 and worst < 1e-6


@pytest.mark.parametrize("precision", WORDS)
def test_a_number_that_is_none_in_any_column_is_none_for_the_decision(
    row: FloatArray, programs: dict[str, Path], precision: str
) -> None:
    for column in range(WIDTH):
        for value in (math.nan, math.inf, -math.inf):
            spoilt = row.copy()
            spoilt[column] = value
            found = replay(programs[precision], precision, np.array([row, spoilt, row]))
            fresh = replay(programs[precision], precision, np.array([row]))
            read = column < READ
            assert found[1].tolist() == [0.0, 0.0, 0.0, 4.0] if read else found[1, 3] != 4.0, column
            assert not read or found[2].tolist() == fresh[0].tolist(), "the memory began again"


@pytest.mark.parametrize("precision", WORDS)
def test_what_no_bench_shows_gets_no_decision(row: FloatArray, programs: dict[str, Path], precision: str) -> None:
    for column in range(READ):
        for sign in (-1.0, 1.0):
            beyond = np.array([row, row])
            beyond[0, column], beyond[1, column] = sign * 1.01 * MOST[column], sign * 1e30
            assert replay(programs[precision], precision, beyond)[:, 3].tolist() == [4.0, 4.0], column


@pytest.mark.parametrize("precision", WORDS)
def test_hostile_samples_raise_no_exception_and_no_word_of_a_sanitizer(generated: Path, precision: str) -> None:
    found = replay(compiled(generated, precision, *SANITIZE), precision, hostile(20_000, 1, precision))
    assert np.isfinite(found).all() and set(found[:, 3]) == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert np.all(found[np.isin(found[:, 3], (0.0, 3.0, 4.0)), 0] == 0.0), "no correction where there is none"


def test_it_compiles_for_a_bare_machine(generated: Path) -> None:
    for precision in WORDS:
        compiled(generated, precision, "-O0", "-ffreestanding")
