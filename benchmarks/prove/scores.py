# SPDX-License-Identifier: Apache-2.0
"""Scores of diagnosed cases (named, located, parameter errors, held-out fit), and the standards (diagnosis.md).

Several names are correct where different sets of causes give exactly the same bench. A spring's rest position shifts
the force on the mass and, by the same amount in the opposite direction, the reading of its load cell: any two of
`force_offset`, `spring_rest` and a bias of the load cell make every bench that all three do. A dead band around a
shifted null is an asymmetric one around the old null. LuGre friction is friction with bristles.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.prove.cases import Case
from hydro_core.cli.console import Table

Name = tuple[str, str]
"""Id, and the chamber, cell, sensor or edge if it has one."""
PLACES = ("chamber", "cell", "sensor", "edge")
_CONSTANT = (("force_offset", ""), ("spring_rest", ""), ("load_cell_bias", "load_force"))
_BAND, _NULL = ("valve_deadband", ""), ("valve_offset", "")


def names(effects: Mapping[str, Mapping[str, Any]]) -> list[frozenset[Name]]:
    """All sets of causes that are equivalent to these effects, the given set first."""
    own = frozenset((cause, next((str(values[key]) for key in PLACES if key in values), ""))
                    for cause, values in effects.items())  # fmt: skip
    ways = [own]
    if len(own & set(_CONSTANT)) >= 2:
        ways += [own - set(_CONSTANT) | set(two) for two in combinations(_CONSTANT, 2)]
    if {_BAND, _NULL} <= own:
        ways += [way - {_NULL} for way in ways]
    if "half_width_negative" in effects.get("valve_deadband", ()):
        ways += [way | {_NULL} for way in ways]
    if effects.get("friction_coulomb", {}).get("form") == "lugre":
        ways += [way | {("friction_presliding", "")} for way in ways]
    return ways


_IDS = {
    "motion": ("friction_coulomb", "friction_viscous", "friction_stribeck", "friction_presliding", "moving_mass",
               "end_cushion", "force_offset", "friction_rib", "friction_pressure", "load_hum", "load_walk"),
    "load": ("spring_stiffness", "spring_hardening", "spring_rest", "backlash", "spring_hysteresis", "load_hum",
             "load_walk"),
    "sensor": ("load_cell_gain", "load_cell_bias", "pressure_sensor_bias", "sensor_lag", "cell_crosstalk"),
    "actuation": ("valve_deadband", "valve_lag", "transport_delay", "valve_offset", "valve_gain",
                  "valve_gain_asymmetry", "valve_null_leakage", "valve_gain_drift", "supply_droop", "return_line",
                  "supply_pressure", "supply_pump", "tank_pressure", "valve_underlap", "valve_edge",
                  "valve_temperature", "supply_ripple"),
    "pressure_a": ("leakage_internal", "leakage_external", "bulk_modulus", "oil_drift", "entrained_air", "piston_area",
                   "dead_volume", "wall_flexibility"),
    "pressure_b": ("leakage_internal", "leakage_external", "bulk_modulus", "oil_drift", "entrained_air", "piston_area",
                   "dead_volume", "area_ratio", "wall_flexibility"),
}  # fmt: skip
"""Causes that act in each equation."""
SHARE = 0.1
"""Share of the mismatch below which a place does not count against the location."""


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


@dataclass(frozen=True, kw_only=True)
class Result:
    """One case and its diagnosis."""

    case: Case
    answer: Mapping[str, Any]
    """answer.json of `blind`."""

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
        found = ((effect["id"], effect["options"]) for effect in self.effects)
        return frozenset((cause, next((at[key] for key in PLACES if key in at), "")) for cause, at in found)

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
        right = {equation for equation, ids in _IDS.items() if causes & set(ids)}
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
    def forecast_errors(self) -> tuple[float, float] | None:
        """Error of the forecast RMSE in closed loop, over the recorded one: corrected, and bench file."""
        (one,) = (None if self.refused else self.answer["report"].get("forecast")) or (None,)
        if one is None:
            return None
        corrected, believed = (
            float("inf") if rmse is None else abs(rmse / one["rmse_recorded"] - 1.0)
            for rmse in (one["rmse_corrected"], one["rmse_bench_file"])
        )
        return corrected, believed

    @property
    def held_out(self) -> float | None:
        """Held-out error over the noise floor, root mean square over channels; infinite where it diverges."""
        channels = {} if self.refused else self.answer["report"]["fit"]["holdout"]
        ratios = [
            float("inf") if one["rmse_after"] is None else one["rmse_after"] / one["noise_floor"]
            for one in channels.values()
            if one["noise_floor"]
        ]
        return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


COLUMNS = {
    "standard": "what is asked for",
    "goal": "",
    "reached": "share of cases, or a percentile",
    "count": "of how many",
    "wilson": "95 % interval of the share (Wilson)",
    "met": "whether the goal is met",
}


def wilson(hits: int, count: int) -> str:
    """95 % interval of a share (Wilson 1927), as it is shown."""
    found = binomtest(hits, count).proportion_ci(method="wilson")
    return f"{found.low:.1%} to {found.high:.1%}"


def standards(results: Sequence[Result]) -> Table:
    """The table of standards; those without a case are left out."""
    table = Table(COLUMNS, title=f"{len(results)} sealed cases")
    kinds: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        kinds[result.case.kind].append(result)
    placed = [result for result in results if result.case.kind not in ("clean", "faint")]

    def share(standard: str, goal: float | None, of: Sequence[Result], test: Callable[[Result], bool]) -> None:
        """Add a row with a share; a negative goal is an upper limit."""
        if of:
            hits, count = sum(map(test, of)), len(of)
            words = "" if goal is None else f">= {goal:.0%}" if goal > 0 else f"<= {-goal:.0%}"
            met = None if goal is None else hits / count >= goal if goal > 0 else hits / count <= -goal
            row(standard, words, f"{hits}/{count} = {hits / count:.1%}", count, met, wilson(hits, count))

    def row(standard: str, goal: str, reached: str, count: int, met: bool | None, interval: str = "") -> None:
        said = "" if met is None else "yes" if met else "no"
        table.add(standard=standard, goal=goal, reached=reached, count=count, wilson=interval, met=said)

    share("single concealed effect named exactly, nothing else", 0.98, kinds["single"], lambda r: r.exact)
    share("two effects: both named, nothing else", 0.95, kinds["pair"], lambda r: r.exact)
    share("three effects: all named, nothing else", 0.90, kinds["triple"], lambda r: r.exact)
    share("same cause, other form: cause named, nothing else", 0.90, kinds["form"], lambda r: r.exact)
    share("wrong value in the bench file named", 0.90, kinds["value"], lambda r: r.exact)
    share("nothing missing: any claim", -0.01, kinds["clean"], lambda r: not r.exact)
    share("outside the table: unknown or partly, right equation", 0.90, kinds["outside"],
          lambda r: r.admitted and r.located)  # fmt: skip
    share("outside the table: wrong name", -0.05, kinds["outside"], lambda r: bool(r.claimed))
    share("right equation", 0.99, placed, lambda r: r.located)
    own_form = ("single", "value", "pair", "triple")
    if estimates := [one for result in results if result.case.kind in own_form for one in result.estimates]:
        count, hits = len(estimates), sum(one.inside for one in estimates)
        middle, tail = np.percentile([one.error for one in estimates], [50, 95])
        row("parameter error, median", "<= 0.5%", f"{middle:.2%}", count, middle <= 0.005)
        row("parameter error, 95th percentile", "<= 3%", f"{tail:.2%}", count, tail <= 0.03)
        row("95 % intervals that hold the truth", "92% to 98%", f"{hits / count:.1%}", count,
            0.92 <= hits / count <= 0.98, wilson(hits, count))  # fmt: skip
    if over := [r.held_out for r in placed if r.case.kind != "outside" and r.held_out is not None]:
        middle, tail = np.percentile(over, [50, 95], method="higher")  # some may diverge
        row("held-out error over noise floor, median", "<= 1.03", f"{middle:.3f}", len(over), middle <= 1.03)
        row("held-out error over noise floor, 95th percentile", "<= 1.3", f"{tail:.3f}", len(over), tail <= 1.3)
    if errors := [result.forecast_errors for result in results if result.forecast_errors is not None]:
        for percent, name, goal in ((50, "median", 0.10), (95, "95th percentile", 0.25)):
            after, before = np.percentile(errors, percent, axis=0, method="higher")
            row(f"forecast of the RMSE in closed loop, error, {name}", f"<= {goal:.0%}",
                f"{after:.1%} (bench file: {before:.1%})", len(errors), after <= goal)  # fmt: skip
    wall, cpu = ([float(result.answer[key]) for result in results] for key in ("wall", "cpu"))
    for name, most, of in (("median", 10, np.median), ("longest", 60, max)):
        row(f"time per case, {name}", f"<= {most} s", f"{of(wall):.1f} s ({of(cpu):.1f} s CPU)", len(wall),
            of(wall) <= most)  # fmt: skip
    share("faint (a fifth to all of the smallest single): named", None, kinds["faint"], lambda r: r.exact)
    share("faint: wrong name", None, kinds["faint"], lambda r: bool(r.spurious))
    share("refused: recordings that cannot be diagnosed", None, results, lambda r: r.refused)
    return table


def confusion(results: Sequence[Result]) -> dict[str, dict[str, int]]:
    """Counts of diagnosed against concealed causes, over cases with one concealed cause or none."""
    matrix: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        names = [*result.case.effects, *result.case.outside] or ["nothing"]
        if len(names) == 1 and result.case.kind != "faint":
            matrix[names[0]].update(result.claimed or [result.verdict])
    return {name: dict(counter) for name, counter in sorted(matrix.items())}


def failures(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Cases that missed the requirement of their kind, with their diagnosis."""
    return [
        {
            "case": result.case.name, "kind": result.case.kind, "noise": result.case.noise,
            "truth": {**result.case.effects, **result.case.outside}, "verdict": result.verdict,
            "claimed": {e["id"]: {n: p["value"] for n, p in e["parameters"].items()} for e in result.effects},
            "places": result.places, "why": result.answer["refused"] or "",
        }
        for result in results if not result.passed
    ]  # fmt: skip
