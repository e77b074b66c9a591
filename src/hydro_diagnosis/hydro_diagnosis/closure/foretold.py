# SPDX-License-Identifier: Apache-2.0
"""Names beside laws that leave something, judged on the held-out recordings: one that predicts them worse goes.

Where a law of the wrong form leaves something, a name may take a part of it in the fitted recordings alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_diagnosis.closure.growth import Closed
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.effect_summary import holdout_gain
from hydro_diagnosis.selection.localisation import noticeable

WORSE = 0.01
"""Share of what all claims explain of the held-out residual's square, by which it is smaller without a name."""


def foretold(closed: Closed, unseen: Problem) -> Closed:
    """The model without names that make the held-out residual larger, the worst first; as it is if nothing remains."""
    problem = closed.problem
    while noticeable(problem, closed.fit.residual):
        names = [claim for claim in closed.fit.removable if not isinstance(claim.effect, Closure)]
        fewer = [_without(problem, closed.fit, claim.effect.label) for claim in names]
        gains = [holdout_gain(unseen, one, closed.fit) for one in fewer]
        if not gains or min(gains) >= -WORSE:
            break
        closed = replace(closed, fit=fewer[int(np.argmin(gains))])
    return closed


def _without(problem: Problem, found: Fit, label: str) -> Fit:
    return fit(problem, tuple(claim for claim in found.claims if claim.effect.label != label))
