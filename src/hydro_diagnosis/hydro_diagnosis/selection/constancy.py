# SPDX-License-Identifier: Apache-2.0
"""Constancy test: a claimed number must not explain more by varying with the state.

A sensor whose bias grows with a pressure has no bias but crosstalk. Where something remains, each claimed number is
let vary with one variable after the other, linearly; if that removes most of what remains, the name does not hold.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.free_form import variable_of, variables
from hydro_diagnosis.estimation.problem import Problem

MOST = 0.5
"""Share of what remains that a claimed number may remove by varying."""


def without_varying(problem: Problem, found: Fit, judged: npt.NDArray[np.bool_], spared: frozenset[str]) -> Fit:
    """The fit without claims that explain most of what remains if their numbers vary.

    Parameters
    ----------
    judged
        Residuals in which something remains, shape (n,).
    spared
        Ids that are not questioned.
    """
    remains = float(np.sum(np.square(found.residual[judged]))) - float(np.count_nonzero(judged))
    if not found.claims or remains <= 0.0:
        return found
    states = [_along(problem, name) for name in variables(problem)]
    steady, column = [], 0
    for claim in found.claims:
        count = len(claim.effect.parameters)
        slopes = found.jacobian[:, column : column + count]
        column += count
        removed = (
            0.0
            if claim.effect.estimated or claim.effect.id in spared
            else max(_removed(found, slopes, one, judged) for one in states)
        )
        if removed <= MOST * remains:
            steady.append(claim)
    return found if len(steady) == len(found.claims) else fit(problem, steady)


def _removed(found: Fit, slopes: FloatArray, state: FloatArray, judged: npt.NDArray[np.bool_]) -> float:
    """Squares that go if a claim's numbers follow a variable, beyond what the claims' own values can take up."""
    columns = np.column_stack([found.jacobian, slopes * state[:, None]])[judged]
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left = found.residual[judged]
    amounts = np.linalg.lstsq(columns / lengths, left, rcond=1e-10)[0]
    return float(left @ left - np.sum(np.square(left - columns @ (amounts / lengths))))


def _along(problem: Problem, name: str) -> FloatArray:
    """A variable at every residual, of mean 0 and standard deviation 1, shape (n,)."""
    layout = problem.layout
    values = np.zeros(len(layout.time))
    for k, model in enumerate(problem.models):
        at = layout.segment == k
        values[at] = np.interp(layout.time[at], model.time, variable_of(model, name))
    centred: FloatArray = values - values.mean()
    return centred / max(float(values.std()), 1e-300)
