# SPDX-License-Identifier: Apache-2.0
"""A policy in C, generated here and compiled."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, FloatArray
from hydro_policy.sac import header
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.mdp import ACTION_SIZE, observe
from tests.checks import compiled, status_of
from tests.test_firmware_loop_filter import hostile

ROOT = Path(__file__).resolve().parent.parent
POLICIES = ROOT / "src" / "hydro_policy" / "hydro_policy" / "data"
PRECISIONS = {"double": ([], ctypes.c_double, 1e-13), "single": (["-DHYDRO_SINGLE"], ctypes.c_float, 2e-5)}
"""Words for the compiler, kind of number, allowed difference of an action."""
SOURCE = """#include <fenv.h>
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


def acted(folder: Path, precision: str, rows: FloatArray) -> FloatArray:
    """Actions and changes of the gains, shape (n, 4), of STATE in rows; compiled as a freestanding program is."""
    words, kind, _ = PRECISIONS[precision]
    (folder / "many.c").write_text(SOURCE)
    places = (f"-I{ROOT / 'firmware'}", f"-I{folder}")
    library = folder / f"many_{precision}.so"
    compiled(folder / "many.c", library, "-O2", "-ffreestanding", "-fPIC", "-shared", *places, *words)
    given, made = np.ascontiguousarray(rows, kind), np.zeros((len(rows), 4), kind)
    pointer = ctypes.POINTER(kind)
    raised = ctypes.CDLL(str(library)).many(len(rows), given.ctypes.data_as(pointer), made.ctypes.data_as(pointer))
    assert raised == 0, "a floating-point exception"
    return made.astype(np.float64)


@pytest.mark.parametrize("name", ["pretrained_paper", "pretrained_wide"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_policy_in_c_acts_as_the_policy_and_goes_on_after_hostile_samples(
    name: str, precision: str, tmp_path: Path
) -> None:
    policy, gains, _ = load_policy(POLICIES / name / "policy.safetensors")
    (tmp_path / "policy_weights.h").write_text(header.header(policy, gains, "A test."))
    spread = [200, 3e3, 200, 3e3, 2e6, 2e6, 8e-3, 0.1, 0.02, 0.02, 200, 3e3, 40, 5]
    center = [0, 0, 0, 0, 8e6, 8e6, 0.04, 0, 0, 0, 0, 0, 50, 8]
    rows = (center + np.random.default_rng(5).normal(size=(2000, len(STATE_FIELDS))) * spread).astype(np.float32)
    rows[1000, 4] = math.nan  # there the last action stays
    rows, expected, action = rows.astype(np.float64), np.zeros((2000, ACTION_SIZE)), np.zeros(ACTION_SIZE)
    for k, row in enumerate(rows):
        observation = observe(row, action, policy.size)
        action = expected[k] = policy.act(observation) if np.isfinite(observation).all() else action
    found, allowed = acted(tmp_path, precision, rows), PRECISIONS[precision][2]
    np.testing.assert_allclose(found[:, :ACTION_SIZE], expected, rtol=0.0, atol=allowed)
    np.testing.assert_allclose(found[:, ACTION_SIZE:], gains.changes(expected), rtol=0.0, atol=100.0 * allowed)
    found = acted(tmp_path, precision, hostile(20_000, 2, precision)[:, :14])
    assert np.isfinite(found).all() and np.abs(found[:, :ACTION_SIZE]).max() <= 1.0
    assert np.ptp(found[-1000:, :ACTION_SIZE], axis=0).min() > 0.1, "it goes on"


def test_the_command_writes_what_compiles(tmp_path: Path) -> None:
    shipped = POLICIES / "pretrained_paper" / "policy.safetensors"
    assert status_of(header.main, "--policy", shipped, "--out", tmp_path / "policy_weights.h") == 0
    assert np.isfinite(acted(tmp_path, "single", np.ones((1, 14)))).all()
