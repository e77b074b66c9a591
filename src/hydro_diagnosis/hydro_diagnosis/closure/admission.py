# SPDX-License-Identifier: Apache-2.0
"""Admission of a closure: simulated forward on held-out recordings, it must make no channel worse."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydro_diagnosis.closure.selection import ClosureFit
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import Closure, is_closure
from hydro_diagnosis.estimation.fit import by_claim
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.validation import Known, held_out
from hydro_sim.model.laws import Law

WORSE_RATIO = 1.02
"""Ratio to the error of the names alone above which a channel counts as worse: windows are few."""
LEAST_SHARE = 0.05
"""Share of the held-out gap that a closure must close."""


@dataclass(frozen=True)
class Admitted:
    """An admitted closure."""

    closed: ClosureFit
    held: dict[str, Any]
    """`fit` of report.json, with the closure."""
    share: float
    """Share of the held-out gap that it closes."""
    error_by_form: dict[str, float | None]
    """By form that was tried: the share of the held-out gap that it closes; None: it made an error worse."""


def admitted(
    problem: Problem,
    holdout: Problem,
    candidates: Iterable[ClosureFit],
    named: Mapping[str, Any],
    known: Known | None = None,
) -> Admitted | None:
    """Return the first candidate that makes no held-out channel worse than the names alone do, or None.

    `holdout`: the held-out recordings; `named`: `fit` of report.json with the names alone; `known`:
    what has been simulated already.
    """
    errors: dict[str, float | None] = {}
    for closed in candidates:
        held = held_out(problem, holdout, closed.fit.claims, known)
        share = share_closed(named, held) if harmless(named, held) else None
        errors[closed.form] = share
        if share is not None and share > LEAST_SHARE:
            return Admitted(closed, _with_named(held, named), share, errors)
    return None


def share_closed(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """Share closed of the held-out squared errors above the noise, over all channels."""
    gaps = [_gaps(one) for one in (before, after)]
    total = sum(gaps[0].values())
    return 1.0 - sum(gaps[1].values()) / total if total > 0.0 else 0.0


def _gaps(held: Mapping[str, Any]) -> dict[str, float]:
    errors = held["holdout"] or held.get("equations", {})
    shown = {name: one for name, one in errors.items() if one["noise_floor"] > 0.0}
    return {name: max((one["rmse_after"] / one["noise_floor"]) ** 2 - 1.0, 0.0) for name, one in shown.items()}


def harmless(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether each held-out error is finite and at most `WORSE_RATIO` times that of the names alone."""
    for part in ("holdout", "equations"):
        for name, one in after.get(part, {}).items():
            for key in ("rmse_after", "rmse_after_all"):
                if key in one and not one[key] <= WORSE_RATIO * before[part][name][key]:
                    return False
    return True


def _with_named(held: dict[str, Any], named: Mapping[str, Any]) -> dict[str, Any]:
    holdout = {
        name: {**one, "rmse_named": named["holdout"][name]["rmse_after"]} for name, one in held["holdout"].items()
    }
    return {**held, "holdout": holdout}


def reports(found: Admitted, bounds: Sequence[Interval]) -> list[ClosureReport]:
    """One entry per term; `bounds`: of the parameters of all claims, in their order."""
    claims = by_claim(found.closed.fit.claims, bounds)
    return [_report(one, one.effect, own, found) for one, own in claims if is_closure(one.effect)]


def _report(claim: Claim, effect: Closure, bounds: Sequence[Interval], found: Admitted) -> ClosureReport:
    terms = {one.name: bound.estimate(one.unit) for one, bound in zip(effect.parameters, bounds, strict=True)}
    return ClosureReport(
        equation=effect.law.equation,
        form="law" if isinstance(effect.law, Law) else "smooth",
        expression=_expression(claim, effect),
        terms=terms,
        range=None if isinstance(effect.law, Law) else list(effect.limits),
        sentence=effect.sentence(claim.values),
        share_closed=found.share,
        share_by_form=found.error_by_form,
    )


def _expression(claim: Claim, effect: Closure) -> str:
    if isinstance(effect.law, Law):
        over = "".join(f", {one.name} = {claim.values[one.name]:.4g} {one.unit}" for one in effect.law.numbers)
        return f"{claim.values['coefficient']:.4g} {effect.law.unit} * {effect.law.text}{over}"
    factor = f"{effect.law.factor.text} " if effect.law.factor else ""
    count = len(effect.parameters)
    return f"{factor}f({effect.law.variable}), a sum of {count} cubic B-splines, constant beyond"
