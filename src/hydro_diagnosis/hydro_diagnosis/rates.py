# SPDX-License-Identifier: Apache-2.0
"""What rows that a logger did not record cost a claim: by how much half of the rows that there are would change it.

The error of what is interpolated falls as rows come closer, so what the step from half of the rows to all of them
changes is no less than what the step to rows without a gap would (Richardson 1911, at order 0).
"""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.fit import Fit, pack, spreads
from hydro_diagnosis.problem import Problem


def shifts(problem: Problem, found: Fit) -> list[FloatArray]:
    """By how much each claim's parameters move if half of the rows are left out, to first order; 0 if none lack.

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
