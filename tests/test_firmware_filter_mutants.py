# SPDX-License-Identifier: Apache-2.0
"""The default filter in C: its mutants, by samples that Python decided about."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from tests.firmware_filter import FIRMWARE, decided, drawn, edges, firmware_module, recorded, shipped, uneven, written

PARTS = ("structured.h", "loop.h", "loop_filter.h")

DRAWN = 1500
"""Samples of a drawn trial."""

LAST_RESORT = "nothing that is believed overflows: for a header that is none"
EQUIVALENT = {
    "structured.h: #define HYDRO_MOVING 7": "a row more of s, which nothing reads",
    "structured.h: #define HYDRO_PLANT 9": "a row more of d, which nothing reads",
    "structured.h: #define HYDRO_DIRECTIONS 9": "a column more of d, which nothing reads",
    "structured.h: hydro_real into = s[2] <= HYDRO_R(0) ? s[2] : hydro_max(s[2] - c->stroke, HYDRO_R(0));": "0 is 0",
    "loop.h: /* memory->spool_rate = HYDRO_R(0); */": "it is 0 where nothing runs yet",
    (
        "loop.h: hydro_real filling = decay <= HYDRO_R(1e-4) ? HYDRO_R(1) - HYDRO_R(0.5) * decay : (HYDRO_R(1) - kept)"
        " / decay;"
    ): "one of two that are equal to 1e-9",
    "loop.h: hydro_real d[HYDRO_PLANT + 1][HYDRO_DIRECTIONS] = {{HYDRO_R(1)}}, none, moved;": "set two lines below",
    "loop.h: for (int i = 1; i < HYDRO_LOOP; i++) {": "the first is set below",
    "loop.h: hydro_real felt = gain >= loop->gain_floor ? nominal : HYDRO_R(0);": "at a corner either slope is one",
    "loop_filter.h: #define HYDRO_FACTOR (HYDRO_LOOP * (HYDRO_LOOP + 1) * 2)": "longer rows, filled with zeros",
    "loop_filter.h: #define HYDRO_FACTOR (HYDRO_LOOP * (HYDRO_LOOP + 2) / 2)": "longer rows, filled with zeros",
    "loop_filter.h: low = (int)place <= filter->rows - 2 ? (int)place : filter->rows - 2;": "one of two that are equal",
    (
        "loop_filter.h: low = (int)place < filter->rows + 2 ? (int)place : filter->rows - 2;"
    ): "the last row, with all of its share or as the one that follows",
    (
        "loop_filter.h: share = size <= HYDRO_R(2) * floor ? size / floor - HYDRO_R(1) : HYDRO_R(1);"
    ): "one of two that are equal",
    (
        "loop_filter.h: end = -p->level / (p->slope + (p->slope <= HYDRO_R(0) ? -root : root));"
    ): "a slope of 0 leads to no root: bent is above 0",
    (
        "loop_filter.h: return end >= HYDRO_R(0) ? hydro_closed_form(HYDRO_R(-1), -end, low, high, status)"
    ): "a root at 0 is no violation",
    **{
        f"loop_filter.h: static const hydro_memory_of_loop fresh = {{{numbers}, false}};": "set by the first sample"
        for numbers in (
            "HYDRO_R(1), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)", "HYDRO_R(0), HYDRO_R(1), HYDRO_R(0), HYDRO_R(0)",
            "HYDRO_R(0), HYDRO_R(0), HYDRO_R(1), HYDRO_R(0)", "HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(1)",
        )
    },
    "loop_filter.h: if (!hydro_finite(p.level) && !hydro_finite(p.slope) || !hydro_finite(p.bent)) {": LAST_RESORT,
    "loop_filter.h: if (!hydro_finite(p.level) || !hydro_finite(p.slope) && !hydro_finite(p.bent)) {": LAST_RESORT,
    "loop_filter.h: /* made.status = HYDRO_NAN; */": LAST_RESORT,
}  # fmt: skip
"""Mutants that change nothing that can be observed, by part and what the line becomes, and why."""


@pytest.fixture(scope="module")
def mutation() -> ModuleType:
    return firmware_module("mutation")


@dataclass(frozen=True)
class Trial:
    """A generated header, and samples that Python decided about with the same numbers."""

    folder: Path
    rows: FloatArray
    expected: FloatArray


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """Drawn and recorded samples, of an uneven model and at its edges too, and with tables of two rows and of one."""
    parts = shipped()
    other = uneven(parts)
    folder = written(tmp_path_factory.mktemp("uneven"), other)
    made = [
        Trial(folder, each, decided(other, each)) for each in (drawn(DRAWN, 6), edges(other), recorded(other, 3, 4000))
    ]
    gains = parts.metric.gains
    for rows in (len(gains), 2, 1):
        table = np.ascontiguousarray(parts.metric.table[[*range(rows), -1]])
        fewer = parts._replace(metric=parts.metric._replace(gains=gains[:rows].copy(), table=table))
        folder = written(tmp_path_factory.mktemp(f"rows_{rows}"), fewer)
        samples = [drawn(DRAWN, 5, (gains[0], gains[rows - 1]))]
        samples += [recorded(parts, 3, 4000)] if rows == len(gains) else []
        made += [Trial(folder, each, decided(fewer, each)) for each in samples]
    return made


def agrees(program: Path, trial: Trial) -> bool:
    """Whether a program decides as Python does, but for rounding."""
    try:
        done = subprocess.run([str(program)], input=trial.rows.tobytes(), capture_output=True, check=False, timeout=60)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode or len(done.stdout) != trial.expected.nbytes:
        return False
    found = np.frombuffer(done.stdout).reshape(trial.expected.shape)
    scale = np.maximum(np.abs(trial.expected[:, 1:2]), 1.0)
    error = np.abs(found - trial.expected)
    return bool(error[:, 3].max() == 0.0 and error[:, 0].max() < 1e-12 and (error[:, 1:3] / scale).max() < 1e-9)


@cache
def patterned(compiler: str) -> list[str]:
    """Words that fill what is not set with a pattern, so that reading it shows; none before GCC 12."""
    words = ["-ftrivial-auto-var-init=pattern"]
    done = subprocess.run([compiler, *words, "-E", "-x", "c", os.devnull], capture_output=True, check=False)
    return words if done.returncode == 0 else []


def lives(mutation: ModuleType, firmware: Path, trials: list[Trial], program: Path) -> bool | None:
    """Whether the default filter of a copy of `firmware/` passes its tests; None where it does not compile."""
    passed = mutation.passes(firmware / "test" / "test_filter.c", program, [])
    for words, tried in (([], trials), (mutation.SANITIZE, [trial for trial in trials if len(trial.rows) == DRAWN])):
        for trial in tried if passed else ():
            command = [mutation.CC, "-std=c99", "-O0", "-w", "-ffp-contract=off", f"-I{firmware}", f"-I{trial.folder}"]
            command += [
                "-ftrivial-auto-var-init=pattern",
                *words,
                str(firmware / "test" / "replay_filter.c"),
                "-o",
                str(program),
                "-lm",
            ]
            if subprocess.run(command, capture_output=True, check=False).returncode:
                return None
            if not agrees(program, trial):
                return False
    return passed  # type: ignore[no-any-return]


@pytest.mark.slow
def test_the_filter_itself_passes(mutation: ModuleType, trials: list[Trial], tmp_path: Path) -> None:
    assert lives(mutation, FIRMWARE, trials, tmp_path / "replay")


@pytest.mark.study
@pytest.mark.exhaustive
@pytest.mark.timeout(4 * 3600)
def test_mutants_of_the_default_filter_decide_otherwise(
    mutation: ModuleType, trials: list[Trial], tmp_path: Path
) -> None:
    found = mutation.mutate(
        tmp_path, PARTS, lambda copy: lives(mutation, copy, trials, tmp_path / "replay"), EQUIVALENT
    )
    print(f"{found.count} mutants, {found.equivalent} that change nothing, {len(found.alive)} alive")
    assert found.alive == []
