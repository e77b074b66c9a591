# SPDX-License-Identifier: Apache-2.0
"""Whether what accounts for the fitted recordings also accounts for those that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import locate, noticeable


def not_foretold(unseen: Problem, claims: Sequence[Claim]) -> str:
    """Note on held-out recordings that hold more than noise, weighed for these claims; empty where they do not.

    Names fit what they can take the form of: viscous friction with a Stribeck rise takes that of drag with the square
    of speed, as far as the piston was moved.
    """
    residual = unseen.residual(claims)
    if not noticeable(unseen, residual):
        return ""
    places = ", ".join(dict.fromkeys(place.equation for place in locate(unseen, residual, ())))
    return (
        f"the held-out recordings hold more than noise ({places}), which those that were fitted do not show: the "
        "model that is handed back does not foretell them; fit recordings of all that the bench does"
    )
