# SPDX-License-Identifier: Apache-2.0
"""Score of one diagnosed case: named or not, located or not, parameter errors, held-out fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_diagnosis.blind_benchmark.cases import Case
from hydro_diagnosis.blind_benchmark.names import PLACES, Name, names

_IDS = {
    "motion": ("friction_coulomb", "friction_viscous", "friction_stribeck", "friction_presliding", "moving_mass",
               "end_cushion", "force_offset", "friction_rib", "friction_pressure", "load_hum", "load_walk"),
    "load": ("spring_stiffness", "spring_hardening", "spring_rest", "backlash", "spring_hysteresis", "load_hum",
             "load_walk"),
    "sensor": ("load_cell_gain", "load_cell_bias", "pressure_sensor_bias", "sensor_lag", "cell_crosstalk"),
    "actuation": ("valve_deadband", "valve_lag", "transport_delay", "valve_offset", "valve_gain",
                  "valve_gain_asymmetry", "valve_null_leakage", "valve_gain_drift", "supply_droop", "supply_pressure",
                  "tank_pressure", "valve_temperature", "valve_underlap", "supply_ripple"),
    "pressure_a": ("leakage_internal", "leakage_external", "bulk_modulus", "entrained_air", "piston_area",
                   "dead_volume", "wall_flexibility"),
    "pressure_b": ("leakage_internal", "leakage_external", "bulk_modulus", "entrained_air", "piston_area",
                   "dead_volume", "area_ratio", "wall_flexibility"),
}  # fmt: skip
SHARE = 0.1
"""Share of the mismatch below which a place does not count against the location."""


_BY_RATIO = ("valve_gain", "valve_gain_asymmetry", "bulk_modulus", "load_cell_gain", "spring_stiffness",
             "supply_pressure", "piston_area", "area_ratio", "dead_volume")  # fmt: skip
_NEUTRAL = {**{(cause, "ratio"): 1.0 for cause in _BY_RATIO}, ("spring_rest", "position"): 0.04}
"""Neutral values other than 0."""


def equations(cause: str) -> set[str]:
    """Equations in which a cause acts."""
    return {equation for equation, ids in _IDS.items() if cause in ids}


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimated parameter of a correctly named cause, with its true value."""

    cause: str
    name: str
    truth: float
    value: float
    inside: bool
    """Whether the 95 % interval holds the truth."""

    @property
    def error(self) -> float:
        """Error relative to the true value."""
        return abs(self.value - self.truth) / abs(self.truth)

    @property
    def error_of_size(self) -> float:
        """Error relative to the true value's distance from neutral: for a ratio of 1.05, relative to 0.05."""
        return abs(self.value - self.truth) / abs(self.truth - _NEUTRAL.get((self.cause, self.name), 0.0))


@dataclass(frozen=True, kw_only=True)
class Result:
    """One case, its diagnosis, and the errors of the true structure."""

    case: Case
    answer: Mapping[str, Any]
    """answer.json of `blind`."""
    ruling: Mapping[str, Any] = field(default_factory=dict)
    """Held-out errors of the true structure by channel, where the diagnosis has not fitted it itself."""

    @property
    def refused(self) -> bool:
        """Whether the recordings could not be diagnosed."""
        return self.answer["report"] is None

    @property
    def verdict(self) -> str:
        """Verdict of the report, or `refused`."""
        return "refused" if self.refused else str(self.answer["report"]["verdict"])

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Claims of the report."""
        return [] if self.refused else list(self.answer["report"]["effects"])

    @property
    def claimed(self) -> list[str]:
        """Ids of the claims."""
        return [effect["id"] for effect in self.effects]

    @property
    def exact(self) -> bool:
        """Whether exactly the concealed causes are named, in their chamber, cell or sensor; on a clean bench, none."""
        if self.case.kind == "clean":
            return self.verdict == "no_mismatch"
        return not self.refused and len(self.claims) == len(self.effects) and self.claims in names(self.case.effects)

    @property
    def claims(self) -> frozenset[Name]:
        """Claims with their chamber, cell or sensor."""
        return frozenset((effect["id"], _place(effect["options"])) for effect in self.effects)

    @property
    def spurious(self) -> list[str]:
        """Claimed ids that occur in no correct naming of the concealed causes."""
        allowed = frozenset().union(*names(self.case.effects))
        return sorted(cause for cause, place in self.claims if (cause, place) not in allowed)

    @property
    def admitted(self) -> bool:
        """Whether the report states that an unnamed cause is present."""
        return self.verdict in ("modelled", "unknown", "partly_explained")

    @property
    def places(self) -> dict[str, float]:
        """Share of the mismatch by equation."""
        shares: dict[str, float] = {}
        for place in [] if self.refused else self.answer["report"]["location"]:
            shares[place["equation"]] = shares.get(place["equation"], 0.0) + place["share"]
        return shares

    @property
    def located(self) -> bool:
        """Whether every place with a tenth of the mismatch or more is an equation in which a concealed cause acts."""
        causes = {cause for way in names(self.case.effects) for cause, _ in way} | set(self.case.outside)
        right = set().union(*(equations(cause) for cause in causes))
        found = {equation for equation, share in self.places.items() if share >= SHARE}
        return bool(found) and found <= right

    @property
    def passed(self) -> bool:
        """Whether the diagnosis meets the requirement of this kind of case."""
        if self.case.kind == "outside":
            return self.admitted and self.located and not self.claimed
        if self.case.kind == "faint":
            return not self.spurious and not self.refused
        return self.exact

    @property
    def estimates(self) -> list[Estimate]:
        """Parameters that truth and report share and that the recordings identify, if all causes are named."""
        found = []
        alike = self.exact and {cause for cause, _ in self.claims} >= set(self.case.effects)
        for effect in self.effects if alike else ():
            truth = self.case.effects.get(effect["id"], {})
            for name, one in effect["parameters"].items():
                if name in truth and one["ci95"] is not None:
                    low, high = one["ci95"]
                    found.append(Estimate(cause=effect["id"], name=name, truth=truth[name], value=one["value"],
                                          inside=low <= truth[name] <= high))  # fmt: skip
        return found

    @property
    def held_out(self) -> float | None:
        """Held-out error over the noise floor, root mean square over channels; infinite where it diverges."""
        return None if self.refused else _over(self.answer["report"]["fit"]["holdout"])

    @property
    def held_out_true(self) -> float | None:
        """The same for the fit of the true structure; None where the library does not have it."""
        return self.held_out if self.exact and not self.case.outside else _over(self.ruling)

    def worst_channel(self) -> str:
        """Channel whose held-out error is largest over its noise floor."""
        ratios = _ratios({} if self.refused else self.answer["report"]["fit"]["holdout"])
        return max(ratios, key=lambda name: ratios[name]) if ratios else ""


def _place(options: Mapping[str, str]) -> str:
    return next((options[key] for key in PLACES if key in options), "")


def _over(channels: Mapping[str, Any]) -> float | None:
    ratios = list(_ratios(channels).values())
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def _ratios(channels: Mapping[str, Any]) -> dict[str, float]:
    return {
        name: float("inf") if one["rmse_after"] is None else one["rmse_after"] / one["noise_floor"]
        for name, one in channels.items()
        if one["noise_floor"]
    }
