# SPDX-License-Identifier: Apache-2.0
"""Cost of unrecorded rows to a claim, estimated by leaving out half of the recorded ones.

The interpolation error falls with the spacing of the rows, so the change from half of the rows to all of them is no
less than the change from there to rows without a gap (Richardson 1911, at order 0).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.estimation.fit import Fit, spreads
from hydro_diagnosis.estimation.parameters import pack
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import allowed, cause

MUCH = 10.0
"""Multiple of its smallest size worth claiming that a cause may hide without being listed."""
_PROBES = 3
"""Values at which each cause is tried."""


def shifts(problem: Problem, found: Fit) -> list[FloatArray]:
    """Shift of each claim's parameters if half of the rows are left out, to first order; 0 if none are missing.

    Returns
    -------
    One array per claim, in the parameters' units.
    """
    counts = [len(claim.effect.parameters) for claim in found.claims]
    if problem.thinner is None or not counts:
        return [np.zeros(count) for count in counts]
    weight = np.sqrt(1.0 / spreads(problem, found.residual))[problem.layout.channel]
    slopes, change = found.jacobian * weight[:, None], problem.change(found.claims) * weight
    lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    spans = np.array([parameter.span for parameter in pack(found.claims)[0]])
    moved = np.abs(np.linalg.lstsq(slopes / lengths, change, rcond=1e-10)[0]) / lengths * spans
    return np.split(moved, np.cumsum(counts)[:-1])


def untold(problem: Problem, found: Fit, library: Sequence[Effect], threshold: float) -> str | None:
    """Causes that could hide in missing rows, with the size from which they would show; None if none are missing.

    `threshold`: evidence in units of BIC that a claim needs beyond its parameters' price.
    """
    if problem.thinner is None:
        return None
    weight = np.sqrt(1.0 / spreads(problem, found.residual))[problem.layout.channel]
    change = problem.change(found.claims) * weight
    limits: dict[str, tuple[float, str]] = {}
    for effect in allowed(library, found.claims, problem.blocks):
        if not effect.named or effect.needs:
            continue
        name = " ".join(part for part in cause(effect)).replace("=", " ")
        price = threshold + len(effect.parameters) * float(np.log(len(weight)))
        tried = (_least(problem, found, effect, k, weight, change, price) for k in range(_PROBES))
        limit = min(tried, key=lambda one: one[0])
        limits[name] = min(limit, limits.get(name, limit), key=lambda one: one[0])
    hidden = [f"{name}{words}" for name, (_, words) in limits.items() if words]
    if not hidden:
        return None
    return "between the recorded rows there is room for causes that are therefore not told: " + ", ".join(hidden)


def _least(
    problem: Problem, found: Fit, effect: Effect, probe: int, weight: FloatArray, change: FloatArray, price: float
) -> tuple[float, str]:
    """Multiple of a probe from which it shows, and in words if that is much: ` under 0.4 kg`, or alone if never."""
    start = {one.name: one.probes[min(probe, len(one.probes) - 1)] for one in effect.parameters}
    signature = (problem.residual((*found.claims, Claim(effect, start))) - found.residual) * weight
    power = float(signature @ signature)
    if power <= 0.0:
        return np.inf, " at any size"
    share = max(2.0 * abs(float(signature @ change)), (price * power) ** 0.5) / power
    main = next((one for one in effect.parameters if one.smallest > 0.0), None)
    if main is None:
        return share, " at any size" if share > 1.0 else ""
    size = share * abs(start[main.name] - main.neutral)
    if size <= MUCH * main.smallest:
        return share, ""
    return share, f" under {size:.2g} {main.unit}" if main.neutral == 0.0 else f" within {size:.2g} {main.unit}"
