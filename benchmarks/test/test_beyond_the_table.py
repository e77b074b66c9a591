# SPDX-License-Identifier: Apache-2.0
"""The plant with unnamed physics against the foreign one, the cases that are drawn, and the scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.beyond_the_table.__main__ import carried_out
from benchmarks.beyond_the_table.cases import Case, drawn, simulated
from benchmarks.beyond_the_table.kinds import KINDS, Kind
from benchmarks.beyond_the_table.score import right_form, scored, summary

pytestmark = pytest.mark.study
KIND = {kind.name: kind for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_kind_shows(kind: Kind) -> None:
    """By more than a force cell's noise at the least magnitude, in a force or a pressure, and the loop still tracks."""
    missing = simulated(Case(kind.name, None, seed=5), 0, 2.0)
    there = simulated(Case(kind.name, kind, kind.size[0], seed=5), 0, 2.0)
    gap = np.sqrt(np.mean((there - missing)[:, [0, 2, 4, 5]] ** 2, axis=0)) / [0.6, 0.6, 6e3, 6e3]
    assert gap.max() > 1.0
    assert np.std(there[500:, 10] - there[500:, 2]) < 100.0


def closure(equation: str, text: str, form: str = "law") -> dict[str, Any]:
    return {"equation": equation, "form": form, "expression": f"1.5 N * {text}", "share_closed": 0.9}


LOOP = closure("actuation", "w, w' = (u' - |u'| w) / path, path = 0.0003 A")


@pytest.mark.parametrize(("kind", "law", "right"), [
    ("turbulent_drag", closure("motion", "v |v|"), True),
    ("turbulent_drag", closure("motion", "v^3"), False),
    ("turbulent_drag", closure("motion", "v |v|", "smooth"), False),
    ("turbulent_drag", closure("load", "v |v|"), False),
    ("torque_motor_play", LOOP, True),
    ("torque_motor_play", closure("actuation", "u |u|"), False),
    ("flow_curve_bends", LOOP, False),
    ("coils_touch", closure("load", "max(x - threshold, 0), threshold = 0.043 m"), True),  # numbers are no form
])  # fmt: skip
def test_right_form(kind: str, law: dict[str, Any], right: bool) -> None:
    assert right_form(KIND[kind], law) is right


def test_score_counts_what_is_closed_and_what_is_claimed() -> None:
    def row(case: Case, after: float, named: list[str], closures: list[dict[str, Any]]) -> dict[str, Any]:
        error = {"rmse_before": 10.0, "rmse_named": 10.0, "rmse_after": after, "noise_floor": 1.0}
        report = {"verdict": "modelled", "effects": [{"id": one, "options": {}, "parameters": {}} for one in named],
                  "closures": closures, "fit": {"holdout": {"load_force": error}}, "remainder": None}  # fmt: skip
        return scored(case, {"report": report, "said": "", "cpu": 9.0})

    case = Case("turbulent_drag_1", KIND["turbulent_drag"], named=("valve_gain",))
    good = row(case, 1.0, ["valve_gain"], [closure("motion", "v |v|")])
    assert good["place"] and good["form"] and good["named"]
    assert (good["all"], good["names"]) == pytest.approx((1.0, 0.0))
    bad = row(case, 10.0, ["moving_mass"], [])
    assert not bad["named"] and bad["all"] == pytest.approx(0.0)
    said = summary([good, bad, row(Case("clean_dev_0", None), 10.0, [], [])])
    for part in ("least 0.00", "claims on clean 0 of 1", "names right beside 1 of 2"):
        assert part in said


def test_a_leak_is_diagnosed_end_to_end_and_kept(tmp_path: Path) -> None:
    (leak,) = (case for case in drawn("named", 99, 1) if case.name == "leakage_internal")
    row = scored(leak, carried_out(leak, tmp_path / "leak", seconds=6.0))
    assert row["named"]
    found = float(row["values"].split()[1])
    assert found == pytest.approx(6e-14, rel=0.01, abs=0.0)
    for true, missed in ((found, False), (7e-14, True)):
        other = replace(leak, causes={"leakage_internal": {"coefficient": true}})
        assert scored(other, carried_out(leak, tmp_path / "leak"))["values"].endswith("!") is missed
