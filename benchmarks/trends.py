# SPDX-License-Identifier: Apache-2.0
"""Wear that is concealed in a year of recordings: when `trends` finds it, and what it finds where there is none.

Each bench has a recording a day and is looked at every --every days, as a nightly job does. Tables are drawn as
diagnose_many writes them, values with the intervals that stand beside them and a scatter between recordings of the same
size; a cause below three standard deviations is not claimed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import parser
from hydro_core.cli import jobs
from hydro_core.cli.console import Table, command
from hydro_core.signals import FloatArray
from hydro_diagnosis.change_points import fit_trend
from hydro_diagnosis.diagnose_many import write_study
from hydro_diagnosis.trends import PARAMETERS_WITH_NEUTRAL_VALUE, Series, series_of

DAYS = 365
NUMBERS = {
    "leakage_internal.coefficient": (2e-14, 1e-13),
    "friction_coulomb.force": (1.0, 12.0),
    "valve_deadband.half_width": (1e-5, 0.0),
    "entrained_air.volume_fraction": (3e-4, 0.0),
    "load_cell_bias.force": (0.5, 0.0),
}
"""Standard deviation of a diagnosis, and the value of a new bench."""
KINDS = ("wear", "slow wear", "wear, repaired", "step")
CALM = ("nothing", "nothing, 2 % wrong", "nothing, slow scatter")
WORN = 10.0
"""Standard deviations by which a number has grown after `SPAN` days of wear."""
SPAN = {"wear": 60.0, "slow wear": 180.0, "wear, repaired": 60.0, "step": 1e-9}
LIMIT = 12.0
"""Standard deviations above new at which the limit stands."""
REPAIRED = 60


def wear(kind: str, begin: int) -> FloatArray:
    """Growth of a number by day in standard deviations, shape (365,); a step is half as large."""
    days = np.arange(DAYS, dtype=np.float64)
    grown = np.clip((days - begin) / SPAN[kind], 0.0, 0.5 if kind == "step" else np.inf) * WORN
    return np.where(days >= begin + REPAIRED, 0.0, grown) if kind == "wear, repaired" else grown


def scatter(kind: str, rng: np.random.Generator) -> FloatArray:
    """Scatter of a number between recordings in standard deviations, shape (365,)."""
    white = rng.standard_normal(DAYS)
    if kind == "nothing, 2 % wrong":
        return white + 10.0 * rng.standard_normal(DAYS) * (rng.random(DAYS) < 0.02)
    if kind == "nothing, slow scatter":
        keep = np.exp(-1.0 / 3.0)
        for day in range(1, DAYS):
            white[day] = keep * white[day - 1] + np.sqrt(1.0 - keep**2) * white[day]
    return white


def rows_of(name: str, true: FloatArray, rng: np.random.Generator) -> dict[int, dict[str, Any]]:
    """Rows of parameters.parquet for a number's values by day, where its cause is claimed."""
    sd = NUMBERS[name][0] * np.exp(rng.uniform(np.log(0.5), np.log(2.0), DAYS))
    value, neutral = true + sd * rng.standard_normal(DAYS), PARAMETERS_WITH_NEUTRAL_VALUE[name]
    cause, parameter = name.split(".")
    claimed = np.flatnonzero(np.abs(value - neutral.neutral) > np.maximum(3.0 * sd, neutral.smallest_reported))
    return {
        day: {"cause": cause, "options": "", "parameter": parameter, "value": value[day], "unit": neutral.unit,
              "low": value[day] - 1.96 * sd[day], "high": value[day] + 1.96 * sd[day]}
        for day in claimed.tolist()
    }  # fmt: skip


def drawn(kind: str, worn: str, begin: int, seed: int) -> list[Series]:
    """The numbers of a bench of a kind, by way of the tables; only the worn one where one is worn."""
    rng = np.random.default_rng(seed)
    diagnosis = {"verdict": "explained", "causes": []}
    found: list[dict[str, Any]] = [
        {"diagnosis": {"begin": round(86400e6 * day), **diagnosis}, "parameters": []} for day in range(DAYS)
    ]
    for name, (sd, new) in NUMBERS.items():
        if kind in CALM or name == worn:
            true = new + sd * (scatter(kind, rng) + (wear(kind, begin) if kind in SPAN else 0.0))
            for day, row in rows_of(name, true, rng).items():
                found[day]["parameters"].append({"begin": found[day]["diagnosis"]["begin"]} | row)
    with tempfile.TemporaryDirectory() as folder:
        write_study(Path(folder), {f"{day:03d}": one for day, one in enumerate(found)})
        return series_of(Path(folder))


def watched(kind: str, worn: str, begin: int, seed: int, every: int) -> dict[str, Any]:
    """What the looks at a bench say: days of alarms, and dates of the change and of the limit when found and later."""
    alarms, dated, ahead = [], [], {}
    for series in drawn(kind, worn, begin, seed):
        known = 0
        for day in range(every, DAYS, every):
            seen = series.time <= day
            found = fit_trend(series.time[seen], series.value[seen], series.sd[seen], series.bound[seen])
            if found is None:
                continue
            if found.finding_count > known:
                alarms.append(day)
                if found.changes and day >= begin:
                    dated.append((found.changes[-1].time, found.changes[-1].earliest, found.changes[-1].latest))
            known = found.finding_count
            if kind in ("wear", "slow wear") and found.has_slope and day >= begin:
                sd, new = NUMBERS[worn]
                limit, first, last = found.lines[-1].time_to_limit(new + LIMIT * sd, True)
                ahead[day] = tuple(day + one for one in (limit, first, last))
    return {"alarms": alarms, "dated": dated, "ahead": list(ahead.items())}


def about(kind: str, begins: list[int], results: list[Mapping[str, Any]]) -> dict[str, Any]:
    """A row of the table over the benches of a kind."""
    years, calm = DAYS / 365.0, kind in CALM
    false = [sum(calm or day < begin for day in one["alarms"]) for begin, one in zip(begins, results, strict=True)]
    at_risk = sum(years if calm else begin / 365.0 for begin in begins)
    row: dict[str, Any] = {"kind": kind, "benches": len(results), "false": sum(false), "years": at_risk,
                           "false_per_year": sum(false) / at_risk}  # fmt: skip
    after = [[day - b for day in one["alarms"] if day >= b] for b, one in zip(begins, results, strict=True)]
    late = [one[0] for one in after if one]
    dated = [(b, *one["dated"][0]) for b, one in zip(begins, results, strict=True) if one["dated"]]
    errors = [abs(when - b) for b, when, _, _ in dated]
    held = [first <= b <= last for b, _, first, last in dated]
    row |= {"found": None if calm else len(late), "days": _median(late, calm), "date_error": _median(errors, calm),
            "date_held": None if calm or not held else 100.0 * float(np.mean(held))}  # fmt: skip
    limits = [
        (abs(when - true), first <= true <= last)
        for begin, one in zip(begins, results, strict=True) if kind in ("wear", "slow wear")
        for true in [begin + LIMIT / WORN * SPAN[kind]]
        for day, (when, first, last) in one["ahead"] if 0.0 < true - day <= 30.0
    ]  # fmt: skip
    row["limit_error"] = _median([error for error, _ in limits], not limits)
    row["limit_held"] = 100.0 * float(np.mean([held for _, held in limits])) if limits else None
    return row


def _median(values: list[float], none: bool) -> float | None:
    return None if none or not values else float(np.median(values))


MEANINGS = {
    "kind": "", "benches": "a year each", "false": "alarms before the wear began, or where there is none",
    "years": "of benches without wear",
    "false_per_year": "false alarms per bench and year (five numbers where calm, else one)",
    "found": "benches whose wear was found", "days": "from its begin to the alarm, median",
    "date_error": "of the begin as told with the alarm, days, median", "date_held": "% of its intervals that hold it",
    "limit_error": "of the date of the limit, told in the 30 days before it, days, median",
    "limit_held": "% of its intervals that hold it",
}  # fmt: skip


@command(ValueError, OSError)
def main() -> None:
    """Draw, look, print the table."""
    options = parser("trends", __doc__, parallel=True)
    options.add_argument("--benches", type=int, default=12, help="of each kind (default: 12)")
    options.add_argument("--every", type=int, default=3, metavar="DAYS", help="between looks (default: 3)")
    options.add_argument("--seed", type=int, default=1)
    asked = options.parse_args()
    rng, cases = np.random.default_rng(asked.seed), {}
    for kind in (*KINDS, *CALM):
        for k in range(asked.benches):
            worn, begin = list(NUMBERS)[k % len(NUMBERS)], int(rng.integers(90, 180))
            cases[f"{kind} {k}"] = (kind, worn, begin, int(rng.integers(2**31)), asked.every)
    found = jobs.run_all(watched, cases, **jobs.job_options(asked), label="benches", unit="bench")
    table = Table(MEANINGS)
    for kind in (*KINDS, *CALM):
        names = [name for name in cases if cases[name][0] == kind]
        table.add(**about(kind, [cases[name][2] for name in names], [found[name] for name in names]))
    table.show(asked.json)


if __name__ == "__main__":
    main()
