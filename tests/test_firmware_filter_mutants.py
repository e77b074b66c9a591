# SPDX-License-Identifier: Apache-2.0
"""The default filter in C: every line and branch reached, and its mutants, by samples that Python decided about."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from tests.firmware_filter import FIRMWARE, decided, drawn, recorded, shipped, written

PARTS = ("structured.h", "loop.h", "loop_filter.h")

EQUIVALENT: dict[str, str] = {}
"""Mutants that change nothing that can be observed, by part and what the line becomes, and why."""


@pytest.fixture(scope="module")
def mutation() -> ModuleType:
    sys.path.insert(0, str(FIRMWARE / "test"))
    try:
        return import_module("mutation")
    finally:
        sys.path.remove(str(FIRMWARE / "test"))


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("filter_mutants"), shipped())


@pytest.fixture(scope="module")
def runs() -> list[tuple[FloatArray, FloatArray]]:
    """Samples and what Python decided: drawn ones, which most mutants do not survive, then recorded ones."""
    parts = shipped()
    return [(rows, decided(parts, rows)) for rows in (drawn(1500, 5), recorded(parts, 3, 6000))]


def agrees(program: Path, rows: FloatArray, expected: FloatArray) -> bool:
    """Whether a program decides as Python does, but for rounding."""
    try:
        done = subprocess.run([str(program)], input=rows.tobytes(), capture_output=True, check=False, timeout=60)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode or len(done.stdout) != expected.nbytes:
        return False
    found = np.frombuffer(done.stdout).reshape(expected.shape)
    scale = np.maximum(np.abs(expected[:, 1:2]), 1.0)
    error = np.abs(found - expected)
    return bool(error[:, 3].max() == 0.0 and error[:, 0].max() < 1e-12 and (error[:, 1:3] / scale).max() < 1e-9)


@pytest.mark.study
@pytest.mark.timeout(4 * 3600)
def test_mutants_of_the_default_filter_decide_otherwise(
    mutation: ModuleType, generated: Path, runs: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    def lives(firmware: Path) -> bool | None:
        source, program = firmware / "test" / "replay_filter.c", tmp_path / "replay"
        command = [os.environ.get("CC", "cc"), "-std=c99", "-O0", "-w", "-ffp-contract=off", f"-I{firmware}"]
        command += [f"-I{generated}", str(source), "-o", str(program), "-lm"]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return None
        return all(agrees(program, rows, expected) for rows, expected in runs)

    assert lives(FIRMWARE)
    found = mutation.mutate(tmp_path, PARTS, lives, EQUIVALENT)
    print(f"{found.count} mutants, {found.equivalent} that change nothing, {len(found.alive)} alive")
    assert found.alive == []
