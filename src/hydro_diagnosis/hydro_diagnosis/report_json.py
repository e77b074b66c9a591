# SPDX-License-Identifier: Apache-2.0
"""The outcome of a diagnosis as typed values, and as report.json (report_json.md: a contract)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydro_core.files.atomic import encode_json, write_whole

INTERRUPTED = "interrupted"
"""Value in place of a verdict where there is none."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """Location of the mismatch against the baseline."""

    equation: str
    """pressure_a, pressure_b, motion, load, actuation or sensor."""
    share: float
    windows: dict[str, list[list[float]]]
    """By recording: stretches [s, s] in which it stands out."""
    region: dict[str, list[float]]
    """By variable: [low, high], SI units."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """One number of a claimed effect."""

    value: float
    ci95: list[float] | None
    """None if the recordings do not identify it."""
    unit: str


def row_of(estimate: ParameterEstimate | NumberEstimate) -> dict[str, Any]:
    """An estimate as a row of a table: value, 95 % interval (None for none) and unit."""
    low, high = estimate.ci95 or (None, None)
    return {"value": estimate.value, "low": low, "high": high, "unit": estimate.unit}


@dataclass(frozen=True, kw_only=True)
class LookAlike:
    """Another cause in a claim's place for which the table has no id."""

    likeness: str
    """Description of the resemblance."""
    delta_bic: float
    """BIC by which it explains the recordings worse than the claim."""
    distinguishable: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Another cause of the table in a claim's place."""

    id: str
    delta_bic: float
    """BIC by which it explains the recordings worse than the claim."""
    distinguishable: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class EffectReport:
    """A claimed effect."""

    id: str
    equation: str
    options: dict[str, str]
    """Chamber, cell or sensor, and the form if the cause has several."""
    sentence: str
    parameters: dict[str, ParameterEstimate]
    evidence: dict[str, float]
    """delta_bic: loss without it; holdout_gain: share of the held-out error beyond the noise that it removes."""
    rivals: list[Rival]
    look_alikes: list[LookAlike]


@dataclass(frozen=True, kw_only=True)
class ClosureReport:
    """One term of a closure. It is no cause: it states what is missing, not why."""

    equation: str
    """motion, pressure (from chamber A into B), pressure_a, pressure_b, actuation or load."""
    form: str
    """law or smooth."""
    expression: str
    """The term as an equation, with units; what it gives: `hydro_sim.model.laws`."""
    terms: dict[str, ParameterEstimate]
    range: list[float] | None
    """Recorded range of a smooth function's variable; constant beyond."""
    sentence: str
    """Usual physical meaning of such a term."""
    share_closed: float
    """Share of the held-out squared error above the noise, left by names alone, that terms and names remove."""
    share_by_form: dict[str, float | None]
    """The same by form that was tried: shows the cost of condensing a smooth function into a law."""


@dataclass(frozen=True, kw_only=True)
class NumberEstimate:
    """A number of the bench that was estimated from the recordings."""

    name: str
    """Key of bench.yaml."""
    value: float
    unit: str
    ci95: list[float] | None
    """None if the recordings do not tell it."""
    given: float | None
    """Value in the bench file, if it holds one."""
    alike: list[str]
    """Causes, or other estimated numbers, that would look the same."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class CurveReport:
    """What is missing in an equation as a function of one variable, SI units; numbers of each point, side by side."""

    equation: str
    over: str
    """velocity, position, current or pressure_difference."""
    unit_x: str
    unit_y: str
    x: list[float]
    y: list[float]
    """Recorded less what the bench file says."""
    low: list[float]
    high: list[float]
    """95 % band of `y`."""
    named: list[float]
    """What the claimed effects make of it."""


@dataclass(frozen=True, kw_only=True)
class ForecastReport:
    """RMSE [N] of the reference less the load cell's reading in the closed loop of a held-out recording."""

    recording: str
    law: str
    """paper or compensated."""
    unit: str = "N"
    rmse_recorded: float
    rmse_bench_file: float
    """Simulated with the bench file; infinite where the box trips in it."""
    rmse_corrected: float
    """Simulated with all that was found."""
    without: dict[str, float]
    """By cause: simulated with all but it."""
    misses: bool
    """Whether `rmse_corrected` is off what was recorded by more than `forecast.MISSED` of it."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class NumberDifference:
    """A number of a cause on the bench and in a simulator of it; None where there is none."""

    real: float | None
    simulated: float | None
    difference: float | None
    """`real` less `simulated`; None where one is missing."""
    ci95: list[float] | None
    """Of the difference; of the number that there is where one is missing; None: not identified."""
    unit: str

    @property
    def tells(self) -> bool:
        """Whether the two are apart: one is missing, or their difference's interval leaves 0 out."""
        return self.difference is None or (self.ci95 is not None and not self.ci95[0] <= 0.0 <= self.ci95[1])


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A cause by which a bench and a simulator of it differ."""

    id: str
    equation: str
    options: dict[str, str]
    parameters: dict[str, NumberDifference]
    only_in: str | None
    """real or simulated; None where both have it."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a diagnosis."""

    verdict: str
    """no_mismatch, explained, modelled, partly_explained or unknown; `INTERRUPTED` where Ctrl-C came first."""
    location: list[Location]
    effects: list[EffectReport]
    remainder: dict[str, Any] | None
    """Unnamed remainder: where it is, the variables on which it depends, and the names that were dropped for it."""
    closures: list[ClosureReport] = field(default_factory=list)
    """Terms that model what no name explains; empty where names do, or no term holds on held-out recordings."""
    estimated: list[NumberEstimate] = field(default_factory=list)
    """Numbers of the bench that were to be estimated; they are no causes."""
    curves: list[CurveReport] = field(default_factory=list)
    """What is missing, as curves."""
    accounted: dict[str, dict[str, float]] = field(default_factory=dict)
    """By equation: 1 - (rms left) / (rms missing) on what was held out, the noise taken off both; with the `named`
    effects, and with `all` terms."""
    forecast: list[ForecastReport] | None = None
    """What the missing physics does to control, by held-out recording; `not_checked` says why there is none of one."""
    simulated: list[Difference] | None = None
    """By what the recordings of a simulator differ from the bench's; None where none were given."""
    fit: dict[str, Any]
    next_recording: dict[str, Any] | None
    checked: list[str]
    """Equations, as in `Location.equation`; sensor: the hydraulic force against the pressures."""
    not_checked: list[str]
    """Equations; and `forecast: ` and a reason where there is no forecast of control."""
    recordings: list[dict[str, Any]]
    """Recordings, as `location` names them: `name`, and `begin`, the stamp [s] of the first sample of a bag."""
    data_quality: list[str]
    baseline: dict[str, Any]
    versions: dict[str, str]
    seconds: float
    steps: list[dict[str, Any]] = field(default_factory=list)
    """Steps of the search: action, label, delta_bic against nothing."""

    def to_json(self) -> str:
        """report.json."""
        return encode_json(self).decode()

    def write(self, folder: Path) -> None:
        """Write report.json."""
        write_whole(folder / "report.json", encode_json(self))


class DiagnosisInterrupted(KeyboardInterrupt):
    """Ctrl-C, or another request to end, before the verdict; `status` is the program's exit status."""

    def __init__(self, report: Report, status: int) -> None:
        super().__init__("the diagnosis was interrupted before its verdict")
        self.report, self.status = report, status
