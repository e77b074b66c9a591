# SPDX-License-Identifier: Apache-2.0
"""What speaks against claims that fit: reasons to drop a claim, and why a verdict of `explained` does not hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import MOTION, Claim
from hydro_diagnosis.estimation.fit import NOTICEABLE, QUANTILE, Fit, by_claim, fit, residual_variances, without_one
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.selection.search import is_significant
from hydro_diagnosis.selection.steady_motion import FRICTION, Point, curves, missed, reproduced

MOVED = 0.25
"""Share of its size by which a number may move when one recording is left out."""
LEFT = 0.25
"""Share of the bench file's error that may be left on held-out recordings where everything is explained."""
MOST_SPEEDS = 0.5
"""Share of the steady speeds that claims may miss."""
_CONFIRMING = 4
"""Steps of the fit without a recording: it begins where the fit with all of them ended."""


def contradicted(
    problem: Problem,
    found: Fit,
    earlier: Sequence[Fit],
    bounds: Sequence[Interval],
    points: Sequence[Point],
    noise: float,
    threshold: float,
) -> dict[str, str]:
    """Reasons by label of named claims that the recordings contradict, though they fit.

    Parameters
    ----------
    earlier
        Fits with names that are not claimed any more, and nothing else that is not in `found`.
    bounds
        Of the parameters of all claims, in their order.
    points, noise
        Force over steady speed (`steady_motion.curves`), and the standard deviation [N] of a residual.
    threshold
        Evidence [BIC] that a claim needs: that of the search.
    """
    named = [claim for claim in found.judged if claim.effect.named]
    ends = [claim.effect.label for claim in named if not is_significant(claim)]
    reasons = dict.fromkeys(ends, "ends at a bound of what is physical, or is too small to matter")
    reasons |= dict.fromkeys(
        moved(problem, found, bounds), "moves by more than a quarter without one of the recordings"
    )
    turned = "has another size while the piston speeds up than while it slows down"
    reasons |= dict.fromkeys(differing(problem, found, bounds), turned)
    depends = "has another size beside names that are not claimed"
    reasons |= dict.fromkeys((label for one in earlier for label in apart(found, one, bounds)), depends)
    if reproduced(problem, found.claims) <= 0.0:
        unfounded = "in motion the equation predicts the force no better than the force's mean would"
        reasons |= {claim.effect.label: unfounded for claim in named if MOTION in claim.effect.blocks}
    for label, evidence in _evidence(problem, found, bounds).items():
        if evidence < threshold:
            reasons[label] = "by the number of its independent samples it may be chance"
    off = missed(points, noise)
    if len(off) > MOST_SPEEDS * len(points):
        for claim in named:
            others = curves(problem, found.but(claim))[FRICTION]
            without = {one.at: one.model for one in others}
            if any(abs(without[one.at] - one.model) > noise for one in off):
                reasons[claim.effect.label] = f"misses the force at {len(off)} of {len(points)} steady speeds"
    return reasons


def _evidence(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> dict[str, float]:
    """Evidence [BIC] of each named claim by its label, by as many samples as are worth one that is independent."""
    evidence, needed = {}, {name for claim in found.claims for name in claim.effect.needs}
    for claim, own in by_claim(found.claims, bounds):
        variance = max((bound.inflation**2 for bound in own), default=1.0)
        if claim.effect.named and not claim.effect.estimated and claim.effect.id not in needed:
            rise = without_one(problem, found, claim).deviance - found.deviance
            evidence[claim.effect.label] = rise / variance - len(own) * float(np.log(len(found.residual) / variance))
    return evidence


def moved(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims whose size moves by more than `MOVED`, and out of its interval, without one of the recordings.

    `bounds`: of the parameters of all claims, in their order.
    """
    names = list(dict.fromkeys(model.segment.recording for model in problem.models))
    labels: list[str] = []
    for name in names if len(names) > 1 and found.judged else []:
        others = [model.segment for model in problem.models if model.segment.recording != name]
        fewer = Problem(
            others, problem.bench, problem.baseline, noise=problem.sensor_noise, estimated=problem.estimated
        ).weighed(found.claims)
        labels += apart(found, fit(fewer, found.claims, iterations=_CONFIRMING), bounds)
    return list(dict.fromkeys(labels))


def differing(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims of the equation of motion whose size is another where the piston speeds up, or slows down.

    By more than `MOVED`, and not by chance; to first order. What takes force to set the piston moving, and gives none
    back, is no mass.
    """
    if MOTION not in problem.blocks or not found.judged:
        return []
    rows = problem.layout.channel == CHANNELS.index(MOTION)
    power = np.concatenate([model.kept(model.v) * model.kept_finish(model.a) for model in problem.models])
    deviation = np.sqrt(residual_variances(problem, found.residual)[CHANNELS.index(MOTION)])
    slopes, left = found.jacobian[rows] / deviation, found.residual[rows] / deviation
    labels: list[str] = []
    for there in (power > 0.0, power < 0.0):
        covariance = np.linalg.pinv(slopes[there].T @ slopes[there], hermitian=True)
        moves, k = -covariance @ (slopes[there].T @ left[there]), 0
        for claim in found.claims:
            for one in claim.effect.parameters:
                size, move = abs(claim.values[one.name] - one.neutral), abs(moves[k]) * one.span
                chance = QUANTILE * float(np.sqrt(covariance[k, k])) * one.span * bounds[k].inflation
                named = claim.effect.named and not claim.effect.estimated and MOTION in claim.effect.blocks
                if named and one.smallest > 0.0 and move > max(MOVED * size, chance) > 0.0:
                    labels.append(claim.effect.label)
                k += 1
    return list(dict.fromkeys(labels))


def apart(found: Fit, other: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims whose size in another fit differs by more than `MOVED`, and lies out of its interval."""
    sizes, labels = {claim.effect.label: claim for claim in other.claims}, []
    for claim, own in by_claim(found.claims, bounds):
        label = claim.effect.label
        if label in sizes and claim.effect.named and not claim.effect.estimated and _moves(claim, sizes[label], own):
            labels.append(label)
    return labels


def _moves(claim: Claim, other: Claim, bounds: Sequence[Interval]) -> bool:
    for parameter, bound in zip(claim.effect.parameters, bounds, strict=True):
        value, moved_to = claim.values[parameter.name], other.values[parameter.name]
        outside = not bound.low <= moved_to <= bound.high
        if parameter.smallest > 0.0 and outside and abs(moved_to - value) > MOVED * abs(value - parameter.neutral):
            return True
    return False


def explained_shares(proof: Mapping[str, Any]) -> dict[str, float]:
    """Share of each equation's held-out mean square beyond the noise, as the bench file leaves it, that claims remove.

    `proof`: `fit` of report.json. Without equations whose mismatch is noise.
    """
    shares = {}
    for name, one in proof.get("equations", {}).items():
        before, after = (max(one[key] ** 2 - one["noise_floor"] ** 2, 0.0) for key in ("rmse_before", "rmse_after"))
        if before > NOTICEABLE * one["noise_floor"] ** 2:
            shares[name] = 1.0 - after / before
    return shares


def doubted(verdict: str, doubts: Sequence[str], *, named: bool) -> str:
    """Return the verdict with `objections`: what is not all of it is no `explained`, nor `modelled`."""
    if verdict not in ("explained", "modelled") or not doubts:
        return verdict
    return "partly_explained" if named else "unknown"


def objections(
    found: Fit,
    bounds: Sequence[Interval],
    proof: Mapping[str, Any],
    points: Sequence[Point],
) -> list[str]:
    """Sentences on why claims do not explain everything, though they leave no more than the noise that they allow.

    `found`, `bounds`: the claims, and the intervals of their parameters. `proof`: `fit` of report.json. `points`: force
    over steady speed (`steady_motion.curves`).
    """
    owners = [(claim, one) for claim in found.claims for one in claim.effect.parameters]
    vague = [
        f"{claim.effect.id}: {one.name}"
        for (claim, one), bound in zip(owners, bounds, strict=True)
        if claim.effect.named and not claim.effect.estimated and one.smallest > 0.0 and not bound.identifiable
    ]
    said = [f"not identifiable from these recordings, or at its bound: {', '.join(vague)}"] if vague else []
    for name, one in proof.get("equations", {}).items():
        before, after, floor = one["rmse_before"], one["rmse_after"], one["noise_floor"]
        if after > LEFT * before and after**2 > (1.0 + NOTICEABLE) * floor**2:
            left = f"{100.0 * after / before:.0f} % of the bench file's error in {name} is left on what was held out"
            left = left if found.judged else f"something small is missing: {name} on what was held out"
            said.append(f"{left}, {after / floor:.3g} times the sensors' noise")
    noise = proof.get("equations", {}).get("motion", {}).get("noise_floor", 0.0)
    off = missed(points, noise) if found.judged else []
    if off:
        worst = max(off, key=lambda point: abs(point.measured - point.model))
        said.append(
            f"the model misses the measured force at {len(off)} of {len(points)} steady speeds; worst: "
            f"{abs(worst.measured - worst.model):.3g} N off at {worst.at * 1e3:.3g} mm/s, measured "
            f"{abs(worst.measured):.3g} N"
        )
    return said
