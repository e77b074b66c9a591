# SPDX-License-Identifier: Apache-2.0
"""Validation of a closure by forward simulation on held-out recordings, and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.fit import Fit, by_claim
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.validation import SimulationCache, holdout_errors
from hydro_sim.model.laws import Law

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.intervals import Interval
    from hydro_diagnosis.estimation.problem import Problem


def errors_with_closure(
    problem: Problem, holdout: Problem, found: Fit, named: Mapping[str, Any], cache: SimulationCache
) -> dict[str, Any]:
    """Return `fit` of report.json with the closure; `named`: the same with the named causes alone.

    `holdout`: held-out recordings; `cache`: simulations so far.
    """
    held = holdout_errors(problem, holdout, found.claims, cache)
    errors = {
        name: {**one, "rmse_named": named["holdout"][name]["rmse_after"]} for name, one in held["holdout"].items()
    }
    return {**held, "holdout": errors}


def share_closed(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """Return the share of the held-out squared error above the noise, over all channels, removed since `before`."""
    gaps = []
    for held in (before, after):
        errors = held["holdout"] or held.get("equations", {})
        shown = [one for one in errors.values() if one["noise_floor"] > 0.0]
        gaps.append(sum(max((one["rmse_after"] / one["noise_floor"]) ** 2 - 1.0, 0.0) for one in shown))
    return 1.0 - gaps[1] / gaps[0] if gaps[0] > 0.0 else 0.0


def closure_reports(found: Fit, bounds: Sequence[Interval], share: float) -> list[ClosureReport]:
    """Return the report of each unnamed term; `bounds`: intervals of all claims' parameters, in their order.

    `share`: `share_closed` of all terms together.
    """
    entries = []
    for claim, own in by_claim(found.claims, bounds):
        effect = claim.effect
        if not is_closure(effect):
            continue
        law, values = effect.law, claim.values
        if isinstance(law, Law):
            over = "".join(f", {one.name} = {values[one.name]:.4g} {one.unit}" for one in law.shape_parameters)
            expression = f"{values['coefficient']:.4g} {law.unit} * {law.text}{over}"
        else:
            factor = f"{law.factor.text} " if law.factor else ""
            count = len(effect.parameters)
            expression = f"{factor}f({law.variable}), a sum of {count} cubic B-splines, constant beyond"
        entries.append(ClosureReport(
            equation=law.equation,
            form="law" if isinstance(law, Law) else "smooth",
            expression=expression,
            terms={one.name: bound.estimate(one.unit) for one, bound in zip(effect.parameters, own, strict=True)},
            range=None if isinstance(law, Law) else list(effect.limits),
            sentence=effect.sentence(values),
            share_closed=share,
        ))  # fmt: skip
    return entries
