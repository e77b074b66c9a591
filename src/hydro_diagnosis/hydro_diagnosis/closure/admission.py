# SPDX-License-Identifier: Apache-2.0
"""Admission of a closure: simulated forward on held-out recordings, it must increase the error of no channel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.fit import by_claim
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.significance import PRACTICAL_SHARE
from hydro_diagnosis.validation import SimulationCache, holdout_errors
from hydro_sim.model.laws import Law

if TYPE_CHECKING:
    from hydro_diagnosis.closure.selection import ClosureFit
    from hydro_diagnosis.estimation.intervals import Interval
    from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True)
class AdmittedClosure:
    """Closure admitted by forward simulation, with its errors on held-out recordings."""

    closure_fit: ClosureFit
    holdout_report: dict[str, Any]
    """`fit` of report.json, with the closure."""
    share: float
    """Share of the held-out squared error above the noise that the closure removes (`share_closed`)."""
    error_by_form: dict[str, float | None]
    """That share by form that was tried (law, smooth); None: it increased an error."""


def admit(
    problem: Problem,
    holdout: Problem,
    candidates: Iterable[ClosureFit],
    named: Mapping[str, Any],
    cache: SimulationCache | None = None,
) -> AdmittedClosure | None:
    """Return the first candidate that increases no held-out error, and closes over `PRACTICAL_SHARE`; else None.

    `holdout`: held-out recordings; `named`: `fit` of report.json with the named causes alone; `cache`: simulations so
    far.
    """
    errors: dict[str, float | None] = {}
    for closed in candidates:
        held = holdout_errors(problem, holdout, closed.fit.claims, cache)
        share = share_closed(named, held) if increases_no_error(named, held) else None
        errors[closed.form] = share
        if share is not None and share > PRACTICAL_SHARE:
            named_alone = {
                name: {**one, "rmse_named": named["holdout"][name]["rmse_after"]}
                for name, one in held["holdout"].items()
            }
            return AdmittedClosure(closed, {**held, "holdout": named_alone}, share, errors)
    return None


def share_closed(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """Return the share of the held-out squared error above the noise, over all channels, removed since `before`."""
    gaps = []
    for held in (before, after):
        errors = held["holdout"] or held.get("equations", {})
        shown = [one for one in errors.values() if one["noise_floor"] > 0.0]
        gaps.append(sum(max((one["rmse_after"] / one["noise_floor"]) ** 2 - 1.0, 0.0) for one in shown))
    return 1.0 - gaps[1] / gaps[0] if gaps[0] > 0.0 else 0.0


def increases_no_error(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether each held-out error is finite and at most 2 % above that of the named causes: windows are few."""
    for part in ("holdout", "equations"):
        for name, one in after.get(part, {}).items():
            for key in ("rmse_after", "rmse_after_all"):
                if key in one and not one[key] <= 1.02 * before[part][name][key]:
                    return False
    return True


def closure_reports(found: AdmittedClosure, bounds: Sequence[Interval]) -> list[ClosureReport]:
    """Return the report of each unnamed term; `bounds`: intervals of the parameters of all claims, in their order."""
    entries = []
    for claim, own in by_claim(found.closure_fit.fit.claims, bounds):
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
            share_closed=found.share,
            share_by_form=found.error_by_form,
        ))  # fmt: skip
    return entries
