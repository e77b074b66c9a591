# SPDX-License-Identifier: Apache-2.0
"""EMPS, a real linear drive. Its recordings are not for redistribution: see diagnosis.md, "Real recordings"."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from hydro_diagnosis import Diagnosis

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("HYDRO_EMPS", ROOT.parent / "shared" / "data" / "emps"))
FILES = [DATA / name for name in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all(path.exists() for path in FILES),
        reason=f"no EMPS recordings in {DATA} (set HYDRO_EMPS): they may not be passed on with this repository",
    ),
]


@pytest.fixture(scope="module")
def emps() -> ModuleType:
    path = ROOT / "docs" / "examples" / "emps.py"
    spec = importlib.util.spec_from_file_location("emps_example", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def diagnosed(emps: ModuleType) -> Callable[[float], Diagnosis]:
    """From a baseline with this viscous friction; each is diagnosed once."""
    return cache(lambda viscous: emps.diagnosed(DATA, viscous))


def interval(found: Diagnosis, effect: str, parameter: str, base: float = 0.0) -> tuple[float, float]:
    one = next(one for one in found.report.effects if one.id == effect)
    bounds = one.parameters[parameter].ci95
    assert bounds is not None
    return base + bounds[0], base + bounds[1]


def holds(bounds: tuple[float, float], published: float) -> bool:
    return bounds[0] <= published <= bounds[1]


@pytest.mark.parametrize("baseline", [0.0, 203.5], ids=["mass", "mass and viscous friction"])
def test_direction_dependent_friction_is_found_with_the_published_values(
    baseline: float, emps: ModuleType, diagnosed: Callable[[float], Diagnosis]
) -> None:
    found = diagnosed(baseline)
    assert {effect.id for effect in found.report.effects} == {"friction_coulomb", "friction_viscous"}
    assert holds(interval(found, "friction_coulomb", "force_positive"), 20.14)
    assert holds(interval(found, "friction_coulomb", "force_negative"), 20.63)
    assert holds(interval(found, "friction_viscous", "coefficient_positive", baseline), 166.71)
    assert holds(interval(found, "friction_viscous", "coefficient_negative", baseline), 240.42)
    numbers = emps.model(found)
    assert emps.relative_error(FILES[0], numbers) < 3.11
    assert emps.relative_error(FILES[1], numbers) < 5.98
    # a real drive is more than its equation: the rest is said to be there, and where
    assert found.report.verdict == "partly_explained"
    assert found.report.remainder is not None
    assert [place["equation"] for place in found.report.remainder["location"]] == ["motion"]
    assert "velocity" in found.report.remainder["depends_on"]


def test_symmetric_friction_and_offset_are_found_from_mass_alone(emps: ModuleType) -> None:
    found = emps.diagnosed(DATA, 0.0, emps.SYMMETRIC)
    assert [effect.id for effect in found.report.effects] == ["friction_coulomb", "friction_viscous", "force_offset"]
    assert holds(interval(found, "friction_coulomb", "force"), 20.39)
    assert holds(interval(found, "friction_viscous", "coefficient"), 203.5)
    assert holds(interval(found, "force_offset", "force"), 3.165)
    assert emps.relative_error(FILES[1], emps.model(found)) < 5.98


def test_errors_of_the_published_model_are_the_published_errors(emps: ModuleType) -> None:
    """The yardstick itself: the authors' numbers give the authors' errors."""
    numbers = {"mass": 95.109, "offset": -3.165, "fc+": 20.39, "fc-": 20.39, "fv+": 203.5, "fv-": 203.5}
    assert emps.relative_error(FILES[0], numbers) == pytest.approx(4.08, abs=0.1)
    assert emps.relative_error(FILES[1], numbers) == pytest.approx(5.98, abs=0.2)


def test_equation_errors_stand_in_for_a_simulation(diagnosed: Callable[[float], Diagnosis]) -> None:
    fit = diagnosed(203.5).report.fit
    assert fit["holdout"] == {} and "pressures" in fit["why"]
    motion = fit["equations"]["motion"]
    assert motion["rmse_after"] < 0.25 * motion["rmse_before"]
    assert motion["rmse_after"] < 0.08 * motion["signal"]
