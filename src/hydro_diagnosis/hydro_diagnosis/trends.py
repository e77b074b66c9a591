# SPDX-License-Identifier: Apache-2.0
"""What has worn: each named number over the recordings of a bench, from the tables of diagnose_many.

ros2 run hydro_diagnosis trends study                               # one bench; its page is study/trends.html
ros2 run hydro_diagnosis trends press_* --limit leakage_internal.coefficient=2e-13 --horizon 30

Exit status 3 if within --new days a change was found that was not known before, or a limit is passed within --horizon.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hydro_bridge.pages import environment
from hydro_core.cli.console import Table, UserError, add_json_argument, command, plural, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray
from hydro_diagnosis.change_points import MIN_RECORDINGS, PiecewiseTrend, fit_trend
from hydro_diagnosis.effects import LIBRARY, FitParameter
from hydro_diagnosis.report.plots import svg
from hydro_diagnosis.significance import QUANTILE
from hydro_sim.plotting import BLUE, GRAY, ORANGE, RED

PARAMETERS_WITH_NEUTRAL_VALUE: Mapping[str, FitParameter] = {
    f"{effect.id}.{one.name}": one for effect in LIBRARY for one in effect.amplitudes if isfinite(one.neutral)
}
"""Effect parameters by `id.parameter` that have a neutral value, at which the effect is absent."""
ALARM_EXIT_STATUS = 3
"""Exit status for a new change, or a limit within the horizon."""
_DAY = pd.Timedelta("1D")
_COLUMNS = {
    "bench": "the study's folder; the first one needs attention most",
    "number": "",
    "since": "time of the last change",
    "from": "", "to": "95 % interval of that time",
    "evidence": "of the change, BIC; 10 is needed",
    "before": "value just before the change",
    "now": "value at the last recording", "low": "", "high": "95 % interval of it",
    "per_month": "trend since the change, in 30 days; null without evidence for one",
    "limit": "", "limit_on": "expected date at which it is passed",
    "limit_first": "", "limit_last": "95 % interval of that date, null beyond ten years",
    "new": "whether it raises the exit status",
}  # fmt: skip


@dataclass(frozen=True)
class Series:
    """Time series of an estimated parameter over the recordings of one bench."""

    name: str
    """Cause, parameter and location: leakage_external.coefficient[chamber=a]."""
    unit: str
    time: FloatArray
    """Days since 1970, ascending, shape (n,)."""
    value: FloatArray
    sd: FloatArray
    bound: FloatArray
    """Half-width of the interval about the neutral value in recordings that do not name the cause; 0 in the others."""

    @property
    def key(self) -> str:
        """Cause and parameter, without the location."""
        return self.name.partition("[")[0]


def series_of(study: Path, dates: str | None = None) -> list[Series]:
    """Time series of each parameter that some recording of a study names, sorted by name.

    A recording whose mismatch is explained without the cause counts as its neutral value, with a 95 % half-width of at
    least the smallest deviation ever named; of the others, only estimates with an interval count.

    Raises UserError if the tables are missing or no recording has a time.
    """
    try:
        diagnoses, numbers = (pd.read_parquet(study / f"{name}.parquet") for name in ("diagnoses", "parameters"))
    except (OSError, ValueError) as error:
        raise UserError(f"{study}: no tables of diagnose_many can be read: {error}") from error
    diagnoses = diagnoses[diagnoses.refused.isna()].set_index("recording")
    if dates:
        texts = diagnoses.index.to_series()
        diagnoses["begin"] = pd.to_datetime(texts, format=dates, exact=False, errors="coerce", utc=True)
    diagnoses = diagnoses.dropna(subset="begin").sort_values("begin")
    if diagnoses.empty:
        raise UserError(f"{study}: no recording has a time; --dates FORMAT reads it from the names")
    options = numbers.options.str.replace(r"(^|,)form=\w*", "", regex=True).str.strip(",")
    place = ("[" + options + "]").where(options != "", "")
    numbers["cause_there"], numbers["name"] = numbers.cause + place, numbers.cause + "." + numbers.parameter + place
    claimed = {cause: rows.recording for cause, rows in numbers.groupby("cause_there")}  # in whatever form
    found = []
    for name, rows in numbers.groupby("name"):
        named = rows.drop_duplicates("recording").set_index("recording")
        sd = np.maximum((named.high - named.low) / 3.92, 1e-9 * named.value.abs())
        points = pd.DataFrame({"value": named.value, "sd": sd, "bound": 0.0}).dropna()
        points = points[points.index.isin(diagnoses.index)]
        neutral = PARAMETERS_WITH_NEUTRAL_VALUE.get(str(name).partition("[")[0])
        if neutral is not None:
            settled = diagnoses.index[diagnoses.verdict.isin(("no_mismatch", "explained", "modelled"))]
            absent = settled.difference(claimed[rows.cause_there.iloc[0]])
            away = (points.value - neutral.neutral).abs()
            spread = np.nanmax([neutral.smallest_reported, points.sd.median(), away.min() / QUANTILE])
            unnamed = {"value": neutral.neutral, "sd": spread, "bound": spread * (away / points.sd).min()}
            points = pd.concat([points, pd.DataFrame(unnamed, index=absent)])
        points["time"] = (diagnoses.begin.loc[points.index] - pd.Timestamp(0, tz="UTC")) / _DAY
        points = points.sort_values("time")
        arrays = (points[key].to_numpy(float) for key in ("time", "value", "sd", "bound"))
        found.append(Series(str(name), rows.unit.iloc[0], *arrays))
    return found


def row_of(
    bench: str, series: Series, found: PiecewiseTrend, limit: float | None, asked: argparse.Namespace
) -> dict[str, Any]:
    """Table row of a parameter's trend; `asked`: options `new` and `horizon`, in days."""
    line, last = found.lines[-1], found.changes[-1] if found.changes else None
    now, spread = float(line.at(line.end)), QUANTILE * float(line.sd(line.end))
    then = series.time <= line.end - asked.new
    before = fit_trend(series.time[then], series.value[then], series.sd[then], series.bound[then])
    new = before is not None and found.finding_count > before.finding_count
    ahead = (inf, inf, inf)  # days to the limit; without evidence for a slope only one that is passed counts
    if limit is not None:
        start = (
            PARAMETERS_WITH_NEUTRAL_VALUE[series.key].neutral
            if series.key in PARAMETERS_WITH_NEUTRAL_VALUE
            else float(found.lines[0].at(found.lines[0].begin))
        )
        reached = line.time_to_limit(limit, limit > start)
        ahead = reached if found.has_slope or reached[0] == 0.0 else ahead
    return dict(zip(_COLUMNS, (
        bench, series.name, *(_date(one) for one in ((last.time, last.earliest, last.latest) if last else (inf,) * 3)),
        last.evidence if last else None, float(found.lines[-2].at(found.lines[-2].end)) if last else None,
        now, now - spread, now + spread, 30.0 * line.slope if found.has_slope else None,
        limit, *(_date(line.end + one) for one in ahead), bool(new or ahead[0] <= asked.horizon),
    ), strict=True))  # fmt: skip


def _date(days: float) -> str | None:
    return None if not isfinite(days) else str((pd.Timestamp(0) + days * _DAY).date())


def sentence(row: Mapping[str, Any], unit: str) -> str:
    """Trend of a parameter as a sentence; `row`: of `row_of`, `unit`: of the parameter."""
    now = f"{row['now']:.3g} {unit} ({row['low']:.3g} to {row['high']:.3g})"
    told = f"steady at {now}"
    if row["since"]:
        told = (f"{row['before']:.3g} {unit} until {row['since']} (between {row['from']} and {row['to']}, evidence "
                f"{row['evidence']:.0f}), now {now}")  # fmt: skip
    if row["per_month"] is not None:
        told = told.replace("steady at", "now") + f", {row['per_month']:+.2g} a month"
    if row["limit_on"]:
        last = row["limit_last"] or "later than ten years ahead"
        told += f"; {row['limit']:g} is passed on {row['limit_on']} (between {row['limit_first']} and {last})"
    return told + "."


def trend_plot(series: Series, found: PiecewiseTrend, limit: float | None) -> str:
    """Plot the estimates with their intervals, the fitted lines, the change points and the limit, as SVG text."""
    with svg(1, (8.0, 2.4)) as (axes, text):
        axis, zero = axes[0], pd.Timestamp(0)
        time = zero + pd.to_timedelta(series.time, "D")
        axis.errorbar(time, series.value, QUANTILE * series.sd, fmt=".", color=GRAY, elinewidth=0.5, markersize=3)
        for one in found.lines:
            at = np.linspace(one.begin, one.end, 30)
            when, value, spread = zero + pd.to_timedelta(at, "D"), one.at(at), QUANTILE * one.sd(at)
            axis.plot(when, value, color=BLUE)
            axis.fill_between(when, value - spread, value + spread, color=BLUE, alpha=0.2, linewidth=0)
        for change in found.changes:
            low, high = (zero + one * _DAY for one in (change.earliest, change.latest))
            axis.axvspan(low, high, color=ORANGE, alpha=0.3)
            axis.axvline(zero + change.time * _DAY, color=ORANGE)
        if limit is not None:
            axis.axhline(limit, color=RED, linestyle=":")
        axis.set_ylabel(f"{series.key.partition('.')[2]} [{series.unit}]")
    return text.getvalue()


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    options = argparse.ArgumentParser(
        prog="trends", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )  # fmt: skip
    options.add_argument("studies", nargs="+", type=Path, metavar="STUDY", help="folder of diagnose_many, one a bench")
    options.add_argument("--limit", action="append", default=[], type=_limit, metavar="CAUSE.PARAMETER=VALUE",
                         help="repeatable")  # fmt: skip
    options.add_argument("--horizon", type=float, default=30.0, metavar="DAYS", help="ahead (default: 30)")
    options.add_argument("--new", type=float, default=1.0, metavar="DAYS", help="since the last look (default: 1)")
    options.add_argument(
        "--dates", metavar="FORMAT", help="of the recordings' names, as %%Y-%%m-%%d, if they are no bags"
    )
    options.add_argument("--page", type=writable_file, metavar="FILE", help="default: trends.html in the first STUDY")
    add_json_argument(options)
    return options


def _limit(word: str) -> tuple[str, float]:
    name, _, value = word.partition("=")
    if name not in (f"{effect.id}.{one.name}" for effect in LIBRARY for one in effect.parameters):
        raise argparse.ArgumentTypeError(f"{word}: no number {name}, as leakage_internal.coefficient")
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{word}: {value!r} is not a number") from None


@command(ValueError)
def main() -> int:
    """Entry point; 3 if something is new or near, 2 for an input that cannot be used, else 0."""
    asked = parser().parse_args(sys.argv[1:])
    limits, told, short = dict(asked.limit), [], []
    for study in asked.studies:
        for series in series_of(study, asked.dates):
            found = fit_trend(series.time, series.value, series.sd, series.bound)
            if found is None:
                short.append(
                    f"{study}: {series.name}: {plural(len(series.time), 'recording')}, {MIN_RECORDINGS} are needed"
                )
                continue
            row = row_of(str(study), series, found, limits.get(series.key), asked)
            told.append((row, sentence(row, series.unit), trend_plot(series, found, row["limit"])))

    def urgency(row: Mapping[str, Any]) -> tuple[bool, str, float]:
        """Sort key of rows: new changes and near limits first, then the nearest limit, then the evidence of change."""
        return not row["new"], row["limit_on"] or "9999", -(row["evidence"] or 0.0)

    worst: dict[str, tuple[bool, str, float]] = {}  # by bench
    for row, *_ in told:
        worst[row["bench"]] = min(worst.get(row["bench"], urgency(row)), urgency(row))
    told.sort(key=lambda one: (worst[one[0]["bench"]], one[0]["bench"], urgency(one[0])))
    table = Table(_COLUMNS, rows=[row for row, *_ in told])
    for row, words, _ in told:
        print(f"{'! ' if row['new'] else ''}{row['bench']}: {row['number']}: {words}")
    print(*short, sep="\n", end="\n" if short else "")
    page = asked.page or asked.studies[0] / "trends.html"
    made = environment("hydro_diagnosis", "report/templates").get_template("trends.html")
    write_atomic(Path(page), made.render(title="Trends", told=told, short=short).encode())
    if asked.json:
        table.write_json(asked.json)
    return ALARM_EXIT_STATUS if any(row["new"] for row in table.rows) else 0
