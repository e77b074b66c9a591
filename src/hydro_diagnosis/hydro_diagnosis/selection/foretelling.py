# SPDX-License-Identifier: Apache-2.0
"""Whether what accounts for the fitted recordings also accounts for those that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import locate, noticeable

WORSE = 1.1
"""Ratio of a held-out channel's error after to that before from which a model has made it worse."""
SHOWN = 1.35
"""Noise floors from which a simulated held-out channel's RMS error is more than noise and an uncertain start."""


def made_worse(proof: Mapping[str, Any]) -> str:
    """Held-out channels that the corrected model predicts worse than the bench file; empty where none is.

    `proof`: `fit` of report.json. Under much noise wrong names may leave nothing in what they were fitted to.
    """
    worse = [
        f"{channel} at {error['rmse_after'] / error['noise_floor']:.3g} noise floors instead of "
        f"{error['rmse_before'] / error['noise_floor']:.3g}"
        for channel, error in proof["holdout"].items()
        if error["rmse_after"] > max(WORSE * error["rmse_before"], SHOWN * error["noise_floor"])
    ]
    return "; ".join(worse)


def made_worse_in_all(proof: Mapping[str, Any]) -> str:
    """`made_worse`, where the squared errors beyond the noise have grown over all channels together; else empty."""
    ratios = [(error["rmse_before"], error["rmse_after"], error["noise_floor"]) for error in proof["holdout"].values()]
    grown = [max((after / floor) ** 2, 1.0) - max((before / floor) ** 2, 1.0) for before, after, floor in ratios]
    return made_worse(proof) if sum(grown) > 0.0 else ""


def withheld(claims: Sequence[Claim], worse: str, *, whole: bool) -> str:
    """Note on names that fit and are not handed back, since `worse` of the held-out recordings.

    `whole`: whether they leave nothing of what was fitted.
    """
    names = ", ".join(dict.fromkeys(claim.effect.id for claim in claims))
    share = "" if whole else "a part of "
    return (
        f"{names} would explain {share}the recordings that were fitted, but predict the held-out ones worse than the "
        f"bench file does ({worse}): not claimed; record with less noise or more motion"
    )


def distrusted(worse: str) -> str:
    """Note on a model that is handed back although `worse`; empty where it is not."""
    if not worse:
        return ""
    return (
        f"the held-out recordings are predicted worse than by the bench file ({worse}): do not trust what is named; "
        "record with less noise or more motion"
    )


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
