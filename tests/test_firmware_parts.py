# SPDX-License-Identifier: Apache-2.0
"""A policy in C, generated here and compiled."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, FloatArray
from hydro_policy.sac import header as policy_header
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.task.mdp import ACTIONS, GainRange, observe
from tests.checks import compiled, status_of
from tests.test_firmware_loop_filter import hostile

ROOT = Path(__file__).resolve().parent.parent
POLICIES = ROOT / "src" / "hydro_policy" / "hydro_policy" / "data"
PRECISIONS = {"double": ([], ctypes.c_double), "single": (["-DHYDRO_SINGLE"], ctypes.c_float)}
POLICY = """#include <fenv.h>
#include "policy_weights.h"
int many(int count, const hydro_real *in, hydro_real *out)
{
    feclearexcept(FE_ALL_EXCEPT);
    hydro_real action[2] = {0, 0};
    for (int k = 0; k < count; k++, in += 14, out += 4) {
        hydro_act(&HYDRO_POLICY, in, action, out + 2);
        out[0] = action[0];
        out[1] = action[1];
    }
    return fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
}
"""


def many(folder: Path, precision: str, source: str, rows: FloatArray, width: int) -> FloatArray:
    """What the C code makes of rows of inputs: rows of `width` numbers. Compiled as a freestanding program is."""
    words, kind = PRECISIONS[precision]
    (folder / "many.c").write_text(source)
    library = folder / f"many_{precision}.so"
    places = (f"-I{ROOT / 'firmware'}", f"-I{folder}")
    compiled(folder / "many.c", library, "-O2", "-ffreestanding", "-fPIC", "-shared", *places, *words)
    given, made = np.ascontiguousarray(rows, kind), np.zeros((len(rows), width), kind)
    pointer = ctypes.POINTER(kind)
    raised = ctypes.CDLL(str(library)).many(len(rows), given.ctypes.data_as(pointer), made.ctypes.data_as(pointer))
    assert raised == 0, "a floating-point exception"
    return made.astype(np.float64)


@pytest.fixture(scope="module", params=["pretrained_paper", "pretrained_wide"])
def trained(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Policy, GainRange, Path]:
    policy, gains, _ = load_policy(POLICIES / request.param / "policy.safetensors")
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "policy_weights.h").write_text(policy_header.header(policy, gains, "A test."))
    return policy, gains, folder


@pytest.mark.parametrize(("precision", "allowed"), [("double", 1e-13), ("single", 2e-5)])
def test_the_policy_in_c_acts_as_the_policy(
    trained: tuple[Policy, GainRange, Path], precision: str, allowed: float
) -> None:
    policy, _, folder = trained
    spread = [200, 3e3, 200, 3e3, 2e6, 2e6, 8e-3, 0.1, 0.02, 0.02, 200, 3e3, 40, 5]
    center = [0, 0, 0, 0, 8e6, 8e6, 0.04, 0, 0, 0, 0, 0, 50, 8]
    rows = (center + np.random.default_rng(5).normal(size=(2000, len(STATE_FIELDS))) * spread).astype(np.float32)
    rows[1000, 4] = math.nan  # there the last action stays
    rows, worst, action = rows.astype(np.float64), 0.0, np.zeros(ACTIONS)
    for row, found in zip(rows, many(folder, precision, POLICY, rows, 4), strict=True):
        observation = observe(row, action, policy.size)
        action = policy.act(observation) if np.isfinite(observation).all() else action
        worst = max(worst, float(np.abs(found[:2] - action).max()))
    print(f"{precision}: {worst:g}")
    assert worst < allowed


@pytest.mark.parametrize("precision", PRECISIONS)
def test_hostile_samples_raise_no_exception_in_the_policy(
    trained: tuple[Policy, GainRange, Path], precision: str
) -> None:
    _, _, folder = trained
    found = many(folder, precision, POLICY, hostile(20_000, 2, precision)[:, :14], 4)
    assert np.isfinite(found).all() and np.abs(found[:, :2]).max() <= 1.0
    assert np.ptp(found[-1000:, :2], axis=0).min() > 0.1, "it goes on"


def test_the_command_writes_what_compiles(tmp_path: Path) -> None:
    shipped = POLICIES / "pretrained_paper" / "policy.safetensors"
    assert status_of(policy_header.main, "--policy", shipped, "--out", tmp_path / "policy_weights.h") == 0
    assert np.isfinite(many(tmp_path, "single", POLICY, np.ones((1, 14)), 4)).all()
