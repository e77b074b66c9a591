# SPDX-License-Identifier: Apache-2.0
"""The optional parts in C, generated here and compiled: the filter's decision, a policy's forward pass."""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_bridge.signals import STATE_FIELDS, FloatArray
from hydro_filter.certificate import qp
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.controller import header as filter_header
from hydro_filter.controller.filter import ContractionFilter
from hydro_filter.model.sample import Sample
from hydro_policy.sac import header as policy_header
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.task.mdp import ACTIONS, GainRange, observe
from hydro_sim.model.bench import Bench
from tests.firmware_filter import hostile

ROOT = Path(__file__).resolve().parent.parent
POLICIES = ROOT / "src" / "hydro_policy" / "hydro_policy" / "data"
PRECISIONS = {"double": ([], ctypes.c_double), "single": (["-DHYDRO_SINGLE"], ctypes.c_float)}
FILTER = """#include <fenv.h>
#include "filter_config.h"
int many(int count, const hydro_real *in, hydro_real *out)
{
    feclearexcept(FE_ALL_EXCEPT);
    for (int k = 0; k < count; k++, in += 11, out += 4) {
        hydro_decision made = hydro_decide(&HYDRO_FILTER, in, in[8], in[9], in[10]);
        out[0] = made.delta_u;
        out[1] = made.before;
        out[2] = made.after;
        out[3] = (hydro_real)made.status;
    }
    return fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
}
"""
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
    strict = ["-std=c99", "-O2", "-ffreestanding", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    places = [f"-I{ROOT / 'firmware'}", f"-I{folder}", "-fPIC", "-shared"]
    program = [os.environ.get("CC", "cc"), *strict, *places, *words, str(folder / "many.c"), "-o", str(library), "-lm"]
    subprocess.run(program, check=True)
    given, made = np.ascontiguousarray(rows, kind), np.zeros((len(rows), width), kind)
    pointer = ctypes.POINTER(kind)
    raised = ctypes.CDLL(str(library)).many(len(rows), given.ctypes.data_as(pointer), made.ctypes.data_as(pointer))
    assert raised == 0, "a floating-point exception"
    return made.astype(np.float64)


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return ContractionFilter.for_bench(Bench.nominal()).certificate


@pytest.fixture(scope="module")
def filtered(certificate: Certificate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filter")
    (folder / "filter_config.h").write_text(filter_header.header(certificate, Bench.nominal()))
    return folder


def drawn_samples(count: int) -> FloatArray:
    """x, u_nom, f_r, K_p of samples over and beyond what a bench does: saturated, cavitating, within the noise."""
    rng = np.random.default_rng(4)
    low = [-800, -2e4, -800, -2e4, -0.4e6, -0.4e6, -4e-3, -0.4, -0.08, -400, -40]
    high = [800, 2e4, 800, 2e4, 17e6, 17e6, 0.084, 0.4, 0.08, 400, 300]
    rows = rng.uniform(low, high, (count, 11))
    near = rng.random(count) < 0.4
    rows[near, 9] = rows[near, 2] + rng.normal(0.0, 2.5, near.sum())
    rows[::50, 9] = rows[::50, 2]
    return rows


def judged(certificate: Certificate, rows: FloatArray) -> FloatArray:
    """delta_u, M_c before and after, and status, with the QP's closed form."""
    limit, made = certificate.current_max, []
    for row in rows:
        nominal = float(row[8])
        line = certificate.evaluate(Sample(row[:8].copy(), nominal, float(row[9]), float(row[10])))
        applied = min(max(nominal, -limit), limit)
        change, status = qp.closed_form(line.a, line.b, -limit - applied, limit - applied)
        delta_u = change + (applied - nominal) if change else 0.0
        made.append((delta_u, -line.b, line.value(change), float(status)))
    return np.array(made)


def test_the_filter_in_c_decides_as_the_certificate_to_the_bit(certificate: Certificate, filtered: Path) -> None:
    rows = drawn_samples(20_000)
    expected, found = judged(certificate, rows), many(filtered, "double", FILTER, rows, 4)
    np.testing.assert_array_equal(found, expected)
    assert set(expected[:, 3]) == {0.0, 1.0, 2.0, 3.0}, "every status is tried"


def test_the_filter_in_single_precision_stays_near(certificate: Certificate, filtered: Path) -> None:
    rows = drawn_samples(20_000).astype(np.float32).astype(np.float64)
    expected, found = judged(certificate, rows), many(filtered, "single", FILTER, rows, 4)
    same = found[:, 3] == expected[:, 3]
    print(f"other status: {(~same).sum()}; delta_u {np.abs(found - expected)[same, 0].max():g} A")
    assert (~same).mean() < 1e-3
    assert np.abs(found - expected)[same, 0].max() < 1e-6
    assert (np.abs(found - expected)[:, 1] <= 1e-4 * np.abs(expected[:, 1]) + 1e-6).all()


@pytest.mark.parametrize("place", range(11))
def test_the_filter_corrects_nothing_where_a_number_is_not_finite(filtered: Path, place: int) -> None:
    rows = np.repeat(drawn_samples(1), 3, axis=0)
    rows[:, place] = math.nan, math.inf, -math.inf
    found = many(filtered, "double", FILTER, rows, 4)
    assert (found == [0.0, 0.0, 0.0, 4.0]).all()


def of_a_state(rows: FloatArray) -> FloatArray:
    """The columns that hydro_decide reads: x, u_nom, f_r, K_p."""
    return np.ascontiguousarray(rows[:, [*range(8), 9, 10, 12]])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_hostile_samples_raise_no_exception_in_the_filter(filtered: Path, precision: str) -> None:
    found = many(filtered, precision, FILTER, of_a_state(hostile(20_000, 1, precision)), 4)
    assert np.isfinite(found).all() and set(found[:, 3]) == {0.0, 1.0, 2.0, 3.0, 4.0}


@pytest.fixture(scope="module", params=["pretrained_paper", "pretrained_wide"])
def trained(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Policy, GainRange, Path]:
    policy, gains, _ = load_policy(POLICIES / request.param / "policy.safetensors")
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "policy_weights.h").write_text(policy_header.header(policy, gains, "A test."))
    return policy, gains, folder


def drawn_states(count: int) -> FloatArray:
    rng = np.random.default_rng(5)
    spread = [200, 3e3, 200, 3e3, 2e6, 2e6, 8e-3, 0.1, 0.02, 0.02, 200, 3e3, 40, 5]
    center = [0, 0, 0, 0, 8e6, 8e6, 0.04, 0, 0, 0, 0, 0, 50, 8]
    assert len(center) == len(STATE_FIELDS)
    rows = center + rng.normal(0.0, 1.0, (count, 14)) * spread
    rows[count // 2, 4] = math.nan  # there the last action stays
    return np.asarray(rows)


@pytest.mark.parametrize(("precision", "allowed"), [("double", 1e-13), ("single", 2e-5)])
def test_the_policy_in_c_acts_as_the_policy(
    trained: tuple[Policy, GainRange, Path], precision: str, allowed: float
) -> None:
    policy, _, folder = trained
    rows, worst = drawn_states(2000).astype(np.float32).astype(np.float64), 0.0
    action: FloatArray = np.zeros(ACTIONS)
    for row, found in zip(rows, many(folder, precision, POLICY, rows, 4), strict=True):
        observation = observe(row, action)
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


def test_both_commands_write_what_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = str(POLICIES / "pretrained_paper" / "policy.safetensors")
    asked = (
        (filter_header, ["--out", str(tmp_path / "filter_config.h")], FILTER, 11),
        (policy_header, ["--policy", shipped, "--out", str(tmp_path / "policy_weights.h")], POLICY, 14),
    )
    for module, words, source, width in asked:
        monkeypatch.setattr("sys.argv", ["header", *words])
        with pytest.raises(SystemExit) as ended:
            module.main()
        assert ended.value.code == 0
        assert np.isfinite(many(tmp_path, "single", source, np.ones((1, width)), 4)).all()


@pytest.mark.parametrize("change", [{"stroke": 2.0}, {"piston_area": 0.02}])
@pytest.mark.parametrize("metric", ["constant", "learned"])
def test_a_bench_beyond_what_the_filters_in_c_take_is_refused(
    metric: str,
    change: dict[str, float],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(replace(Bench.nominal(), **change).to_mapping()))
    words = ["--metric", metric, "--bench", str(tmp_path / "bench.yaml"), "--out", str(tmp_path / "filter_config.h")]
    monkeypatch.setattr("sys.argv", ["header", *words])
    with pytest.raises(SystemExit) as ended:
        filter_header.main()
    assert ended.value.code not in (0, None)
    assert "they would correct nothing" in capsys.readouterr().err
    assert not (tmp_path / "filter_config.h").exists()
