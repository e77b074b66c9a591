# SPDX-License-Identifier: Apache-2.0
"""The scores of the proof count what is right, and a seal opens to what was sealed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from benchmarks.prove import __main__ as prove
from benchmarks.prove.cases import Case, draw
from benchmarks.prove.scores import Result
from hydro_core.cli.console import UserError

LEAK = {"leakage_internal": {"coefficient": 1e-13}}
COULOMB, LUGRE = {"friction_coulomb": {"force": 9.0}}, {"friction_coulomb": {"force": 9.0, "form": "lugre"}}
OFFSETS = {"force_offset": {"force": 9.0}, "load_cell_bias": {"force": 4.0, "cell": "load_force"}}


def result(effects: Mapping[str, Any], *claims: str, motion: float | None = None, **parameters: Any) -> Result:
    """A case with these effects, and an answer that claims those; a claim may have its cell behind its name."""
    named = [one.partition(" ") for one in claims]
    found = [{"id": id, "options": {"cell": cell} if cell else {}, "parameters": parameters} for id, _, cell in named]
    verdict = "explained" if claims else "no_mismatch" if motion is None else "unknown"
    shares = {} if motion is None else {"motion": motion, "load": 1.0 - motion}
    location = [{"equation": name, "share": share} for name, share in shares.items()]
    holdout = {"load_force": {"rmse_before": 9.0, "rmse_after": 0.9, "noise_floor": 0.6}}
    report = {"verdict": verdict, "effects": found, "location": location, "fit": {"holdout": holdout}}
    kind = ("clean", "single", "pair")[len(effects)] if motion is None else "outside"
    outside = {"friction_rib": {"force": 5.0}} if kind == "outside" else {}
    case = Case(name="case-000", kind=kind, label="x", effects=dict(effects), outside=outside)
    return Result(case=case, answer={"report": report, "refused": None, "wall": 1.0, "cpu": 1.0, "engine": "x"})


@pytest.mark.parametrize(("truth", "claims", "exact"), [
    ({}, (), True),
    ({}, ("valve_gain",), False),
    (LEAK, ("leakage_internal",), True),
    (LEAK, ("leakage_internal", "valve_gain"), False),
    (LEAK, (), False),
    ({**LEAK, "moving_mass": {"mass": 0.5}}, ("leakage_internal",), False),
    (LUGRE, ("friction_coulomb", "friction_presliding"), True),
    (COULOMB, ("friction_coulomb", "friction_presliding"), False),
    (OFFSETS, ("spring_rest", "force_offset"), True),
    (OFFSETS, ("spring_rest", "load_cell_bias hydraulic_force"), False),
])  # fmt: skip
def test_naming_counts_if_nothing_else_is_claimed_and_names_of_the_same_bench_are_all_right(
    truth: dict[str, Any], claims: tuple[str, ...], exact: bool
) -> None:
    found = result(truth, *claims)
    assert found.exact is found.passed is exact


def test_outside_cause_must_be_called_unknown_in_its_own_equation() -> None:
    assert result({}, motion=0.95).passed
    assert not result({}, motion=0.8).passed
    assert not result({}, "friction_coulomb", motion=1.0).passed


def test_estimates_and_held_out_errors_are_scored_against_the_truth() -> None:
    coefficient = {"value": 1.01e-13, "ci95": [0.99e-13, 1.03e-13], "unit": ""}
    found = result(LEAK, "leakage_internal", coefficient=coefficient)
    (near,), held_out = found.estimates, found.answer["report"]["fit"]["holdout"]["load_force"]
    assert near.error == pytest.approx(0.01) and near.inside and found.held_out == pytest.approx(1.5)
    (far,) = result(LEAK, "leakage_internal", coefficient={**coefficient, "ci95": [1.1e-13, 1.3e-13]}).estimates
    held_out["rmse_after"] = None  # the simulation diverges
    assert not far.inside and found.held_out == float("inf")


def test_seal_opens_to_the_same_answers_and_not_after_a_change(tmp_path: Path) -> None:
    cases, answers = draw(8, 4), tmp_path / prove.ANSWERS
    digest = prove.seal(cases, tmp_path)
    assert prove.unseal(tmp_path, digest) == cases
    answers.chmod(0o600)
    answers.write_text(answers.read_text().replace("case-003", "case-004"))
    with pytest.raises(UserError, match="changed after it was sealed"):
        prove.unseal(tmp_path, digest)
