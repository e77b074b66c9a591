# SPDX-License-Identifier: Apache-2.0
"""Scores of a study against the standards of docs/diagnosis.md, "Standards it is held to"."""

from __future__ import annotations

from collections import Counter, defaultdict
from math import sqrt
from typing import Any

import numpy as np

Result = dict[str, Any]
COMPANIONS = {"lugre": {"friction_presliding"}}
"""Forms that are two causes of the table at once: LuGre friction has bristles. Naming the companion is right too."""
EQUATIONS = {
    "friction_rib": {"motion"},
    "friction_pressure": {"motion"},
    "spring_hysteresis": {"load"},
    "valve_temperature": {"actuation"},
    "valve_underlap": {"actuation"},
    "cell_crosstalk": {"sensor"},
    "load_hum": {"load", "motion"},
    "load_walk": {"load", "motion"},
    "wall_flexibility": {"pressure_a", "pressure_b"},
    "supply_ripple": {"actuation"},
}
_OF_IDS = {
    "motion": ("friction_coulomb", "friction_viscous", "friction_stribeck", "friction_presliding", "moving_mass",
               "end_cushion", "force_offset"),
    "load": ("spring_stiffness", "spring_hardening", "spring_rest", "backlash"),
    "sensor": ("load_cell_gain", "load_cell_bias", "pressure_sensor_bias", "sensor_lag"),
    "actuation": ("valve_deadband", "valve_lag", "transport_delay", "valve_offset", "valve_gain",
                  "valve_gain_asymmetry",
                  "valve_null_leakage", "valve_gain_drift", "supply_droop", "supply_pressure", "tank_pressure"),
    "pressure_a": ("leakage_internal", "leakage_external", "bulk_modulus", "entrained_air", "piston_area",
                   "dead_volume"),
    "pressure_b": ("leakage_internal", "leakage_external", "bulk_modulus", "entrained_air", "piston_area",
                   "dead_volume", "area_ratio"),
}  # fmt: skip
for _equation, _ids in _OF_IDS.items():
    for _id in _ids:
        EQUATIONS.setdefault(_id, set()).add(_equation)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not count:
        return 0.0, 1.0
    z, share = 1.96, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    reach = z / (1 + z * z / count) * sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return middle - reach, middle + reach


def true_ids(result: Result) -> set[str]:
    """Ids that are concealed."""
    return set(result["truth"]["effects"])


def claimed_ids(result: Result) -> list[str]:
    """Ids that are claimed."""
    return [effect["id"] for effect in result["effects"]]


def exact(result: Result) -> bool:
    """Exactly what is concealed is named."""
    truth, claims = true_ids(result), claimed_ids(result)
    companions = {
        c for values in result["truth"]["effects"].values() for c in COMPANIONS.get(values.get("form", ""), set())
    }
    return truth <= set(claims) <= truth | companions and len(claims) == len(set(claims))


def located(result: Result) -> bool:
    """Every place that holds a tenth of the mismatch or more is an equation in which something is concealed."""
    right = set().union(*(EQUATIONS[name] for name in (*result["truth"]["effects"], *result["truth"]["outside"])))
    places = [place["equation"] for place in result["location"] if place["share"] >= 0.1]
    return bool(places) and set(places) <= right


def _shares(results: list[Result], test: Any) -> tuple[int, int]:
    return sum(bool(test(result)) for result in results), len(results)


def table(results: list[Result]) -> dict[str, Any]:
    """The standards with what was reached, as text and as data."""
    by_kind: dict[str, list[Result]] = defaultdict(list)
    refused = [result["name"] for result in results if result["verdict"] == "refused"]
    results = [result for result in results if result["verdict"] != "refused"]
    for result in results:
        by_kind[result["kind"]].append(result)
    rows: list[tuple[str, str, str]] = []

    def share(label: str, goal: str, kind: str, test: Any) -> None:
        hits, count = _shares(by_kind[kind], test)
        if count:
            low, high = wilson(hits, count)
            rows.append((label, goal, f"{hits}/{count} = {hits / count:.1%} (Wilson {low:.0%} to {high:.0%})"))

    share("single named exactly", ">= 98 %", "single", exact)
    share("wrong bench value named", ">= 90 %", "value", exact)
    share("other form: cause named", ">= 90 %", "form", exact)
    share("two effects named", ">= 95 %", "pair", exact)
    share("three effects named", ">= 90 %", "triple", exact)
    share("nothing missing: any claim", "<= 1 %", "clean", lambda result: result["verdict"] != "no_mismatch")
    share("outside: unknown or partly, right equation", ">= 90 %", "outside",
          lambda result: result["verdict"] in ("unknown", "partly_explained") and located(result))  # fmt: skip
    share("outside: wrong name", "<= 5 %", "outside", lambda result: bool(result["effects"]))
    placed = [result for result in results if result["kind"] != "clean"]
    if placed:
        hits, count = _shares(placed, located)
        rows.append(("right equation", ">= 99 %", f"{hits}/{count} = {hits / count:.1%}"))
    rows += _parameters(results) + _heldout(results) + _times(results)
    if refused:
        rows.append(("benches that tripped at once, refused", "", f"{len(refused)}: {', '.join(refused)}"))
    width = max((len(row[0]) for row in rows), default=0)
    lines = [f"{label:{width}}  goal {goal:28}  reached {reached}" for label, goal, reached in rows]
    return {"rows": rows, "confusion": _confusion(results), "text": "\n".join([*lines, "", _failures(results)])}


def _parameters(results: list[Result]) -> list[tuple[str, str, str]]:
    """Errors and coverage over parameters that are named alike in truth and report."""
    errors, inside, by_name = [], [], defaultdict(list)
    for result in results:
        if result["kind"] not in ("single", "value", "pair", "triple") or not exact(result):
            continue
        for effect in result["effects"]:
            truth = result["truth"]["effects"][effect["id"]]
            for name, estimate in effect["parameters"].items():
                if name not in truth or estimate["ci95"] is None:
                    continue
                true = truth[name]
                errors.append(abs(estimate["value"] - true) / abs(true))
                inside.append(estimate["ci95"][0] <= true <= estimate["ci95"][1])
                by_name[f"{effect['id']}.{name}"].append((errors[-1], inside[-1]))
    if not errors:
        return []
    middle, tail = np.percentile(errors, [50, 95])
    low, high = wilson(sum(inside), len(inside))
    return [
        ("parameter error", "median <= 0.5 %, p95 <= 3 %", f"median {middle:.2%}, p95 {tail:.2%} of {len(errors)}"),
        ("95 % intervals hold the truth", "92 to 98 %",
         f"{sum(inside) / len(inside):.1%} of {len(inside)} (Wilson {low:.0%} to {high:.0%})"),
    ]  # fmt: skip


def _heldout(results: list[Result]) -> list[tuple[str, str, str]]:
    ratios = []
    for result in results:
        if result["kind"] in ("single", "value", "pair", "triple"):
            channels = result["fit"]["holdout"].values()
            parts = [
                channel["rmse_after"] / channel["noise_floor"]
                if channel["rmse_after"] is not None and channel["noise_floor"]
                else 99.0
                for channel in channels
            ]
            ratios.append(float(np.sqrt(np.mean(np.square(parts)))) if parts else 99.0)
    if not ratios:
        return []
    middle, tail = np.percentile(ratios, [50, 95])
    return [("held-out error over noise floor", "median <= 1.03, p95 <= 1.3", f"median {middle:.3f}, p95 {tail:.3f}")]


def _times(results: list[Result]) -> list[tuple[str, str, str]]:
    wall, cpu = [r["wall"] for r in results], [r["cpu"] for r in results]
    if not wall:
        return []
    text = f"median {np.median(wall):.1f} s wall, {np.median(cpu):.1f} s CPU; "
    text += f"longest {max(wall):.1f} s wall, {max(cpu):.1f} s CPU"
    return [("time per case (60 s of data)", "median <= 10 s, max <= 60 s", text)]


def _confusion(results: list[Result]) -> dict[str, dict[str, int]]:
    """Counts of claimed ids by concealed id, over cases with one concealed effect or none."""
    matrix: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        names = [*result["truth"]["effects"], *result["truth"]["outside"]] or ["nothing"]
        if len(names) == 1:
            matrix[names[0]].update(claimed_ids(result) or [result["verdict"]])
    return {name: dict(counter) for name, counter in sorted(matrix.items())}


def _failures(results: list[Result]) -> str:
    lines = ["failures:"]
    for result in results:
        kind = result["kind"]
        fine = {"clean": result["verdict"] == "no_mismatch", "outside": not result["effects"] and located(result)}
        if not fine.get(kind, exact(result)):
            names = [
                f"{e['id']}({','.join(f'{v:.3g}' for v in (p['value'] for p in e['parameters'].values()))})"
                for e in result["effects"]
            ]
            places = [f"{place['equation']} {place['share']:.2f}" for place in result["location"]]
            lines.append(f"  {result['name']}: {result['verdict']} {names} {places} truth {result['truth']}")
    return "\n".join(lines)
