# SPDX-License-Identifier: Apache-2.0
"""Report of a diagnosis as typed records, and as report.json (report_json.md: a contract)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydro_core.files.atomic import encode_json, write_atomic
from hydro_sim.model.effects.base import display_unit


@dataclass(frozen=True, kw_only=True)
class Regime:
    """Range of a variable in which the mean of the mismatch is not 0."""

    variable: str
    """time, position, velocity, current, pressure_a or pressure_b."""
    low: float
    high: float
    """SI units."""
    mean: float
    """Mean of the residual [N, Pa]."""
    rate: float
    """Smallest false-discovery rate at which the regime is named."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """Location of the mismatch against the baseline."""

    equation: str
    """pressure_a, pressure_b, motion, load, actuation or sensor."""
    share: float
    windows: dict[str, list[list[float]]]
    """Time windows [s, s] with a significant mismatch, by recording."""
    region: dict[str, list[float]]
    """Range [low, high] of each variable with a significant mismatch: 10th and 90th percentile, SI units."""
    regimes: list[Regime]
    """Regimes of one variable in which the mean mismatch is not 0, at a false-discovery rate of 5 %."""
    sentence: str
    where: str
    """Sentence of the regimes; empty if there are none."""


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """Estimate of one parameter of a claimed effect or closure."""

    value: float
    ci95: list[float] | None
    """95 % confidence interval; None if the recordings do not identify the parameter."""
    unit: str


def row_of(estimate: ParameterEstimate | BenchParameterEstimate) -> dict[str, Any]:
    """Table row of an estimate: value, 95 % interval (None for both ends if not identified) and unit."""
    low, high = estimate.ci95 or (None, None)
    return {"value": estimate.value, "low": low, "high": high, "unit": estimate.unit}


@dataclass(frozen=True, kw_only=True)
class LookAlike:
    """Rival of a claim that is not an effect of the table."""

    likeness: str
    """Description of the resemblance."""
    delta_bic: float
    """BIC by which it explains the recordings worse than the claim."""
    distinguishable: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Rival of a claim: another effect of the table in its place."""

    id: str
    delta_bic: float
    """BIC by which it explains the recordings worse than the claim."""
    distinguishable: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class Validity:
    """Range in which a claim was seen to hold; nothing is known beyond."""

    over: str
    """velocity (its magnitude), position, current or pressure."""
    unit: str
    low: float
    high: float

    @property
    def words(self) -> str:
        """The range in words."""
        unit, factor = display_unit(self.unit)
        return f"seen from {self.low * factor:.3g} to {self.high * factor:.3g} {unit} of {self.over}"


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
    """delta_bic: increase of the BIC without it; holdout_gain: share of the held-out error above the noise it removes.
    """
    rivals: list[Rival]
    look_alikes: list[LookAlike]
    holds: Validity | None = None
    """Range in which it was seen to hold; None where it is no function of a recorded variable."""

    @property
    def said(self) -> str:
        """The sentence, with the range in which it was seen to hold."""
        return f"{self.sentence[:-1]}, {self.holds.words}." if self.holds else self.sentence


@dataclass(frozen=True, kw_only=True)
class ClosureReport:
    """Term of a closure: it models the mismatch without naming its cause."""

    equation: str
    """motion, pressure (from chamber A into B), pressure_a, pressure_b, actuation or load."""
    form: str
    """law or smooth."""
    expression: str
    """The term as an equation, with units; its output and sign: `hydro_sim.model.laws`."""
    terms: dict[str, ParameterEstimate]
    range: list[float] | None
    """Recorded range of a smooth function's variable; constant beyond."""
    sentence: str
    """Usual physical meaning of such a term."""
    share_closed: float
    """Share of the held-out squared error above the noise, left by names alone, that terms and names remove."""


@dataclass(frozen=True, kw_only=True)
class BenchParameterEstimate:
    """Estimate of a bench parameter from the recordings."""

    name: str
    """Key of bench.yaml."""
    value: float
    unit: str
    ci95: list[float] | None
    """95 % confidence interval; None if the recordings do not identify it."""
    given: float | None
    """Value in the bench file, if it holds one."""
    alike: list[str]
    """Causes, or other estimated parameters, with the same signature."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class CurveReport:
    """Missing force or flow of an equation as a function of one variable, SI units; lists with an entry per point."""

    equation: str
    over: str
    """velocity, position, current or pressure_difference."""
    unit_x: str
    unit_y: str
    x: list[float]
    y: list[float]
    """Missing force or flow: recorded minus computed by the bench file."""
    low: list[float]
    high: list[float]
    """95 % band of `y`."""
    named: list[float]
    """Part of `y` that the claimed effects explain."""


@dataclass(frozen=True, kw_only=True)
class ForecastReport:
    """Forecast of the closed loop of a held-out recording: RMSE [N] of the reference minus the load cell's reading."""

    recording: str
    law: str
    """paper or compensated."""
    unit: str = "N"
    rmse_recorded: float
    rmse_bench_file: float
    """Simulated with the bench file; infinite where the box trips in it."""
    rmse_corrected: float
    """Simulated with the corrected bench."""
    without: dict[str, float]
    """By cause: simulated with the corrected bench without it."""
    misses: bool
    """Whether `rmse_corrected` deviates from `rmse_recorded` by more than a share `forecast.MAX_FORECAST_ERROR`."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ParameterDifference:
    """Difference of an effect's parameter between a bench and its simulator; a value is None where it is absent."""

    real: float | None
    simulated: float | None
    difference: float | None
    """`real` minus `simulated`; None where one is missing."""
    ci95: list[float] | None
    """95 % interval of the difference, or of the only value where one is missing; None: not identified."""
    unit: str

    @property
    def is_significant(self) -> bool:
        """Whether the difference is significant: one value is missing, or the interval excludes 0."""
        return self.difference is None or (self.ci95 is not None and not self.ci95[0] <= 0.0 <= self.ci95[1])


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Effect in which a bench and its simulator differ."""

    id: str
    equation: str
    options: dict[str, str]
    parameters: dict[str, ParameterDifference]
    only_in: str | None
    """real or simulated; None where both have it."""


@dataclass(frozen=True, kw_only=True)
class LostStage:
    """Stage that raised an exception: the report has none of its results, and no name that rests on them."""

    stage: str
    """reading (then there is no report), naming, wiring, modelling, curves, forecast, report, page or corrected."""
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a diagnosis."""

    verdict: str
    """no_mismatch, explained, modelled, partly_explained or unknown."""
    location: list[Location]
    effects: list[EffectReport]
    remainder: dict[str, Any] | None
    """Remaining mismatch: locations, variables on which it depends, dropped names, and resemblances; None if none."""
    closures: list[ClosureReport] = field(default_factory=list)
    """Closure terms of the unnamed mismatch; empty if there is none, or no term holds on held-out recordings."""
    estimated: list[BenchParameterEstimate] = field(default_factory=list)
    """Estimates of the bench parameters that were requested; they are no causes."""
    curves: list[CurveReport] = field(default_factory=list)
    """Missing forces and flows as curves over one variable."""
    accounted: dict[str, dict[str, float]] = field(default_factory=dict)
    """By equation: 1 - (residual RMS) / (mismatch RMS) on held-out recordings, both above the noise; with the `named`
    effects, and with `all` terms."""
    forecast: list[ForecastReport] | None = None
    """Forecasts of the control error by held-out recording; `not_checked` states the reason for a missing one."""
    simulated: list[Difference] | None = None
    """Differences between the bench and its simulator; None without recordings of a simulator."""
    fit: dict[str, Any]
    next_recording: dict[str, Any] | None
    checked: list[str]
    """Checked equations, as in `Location.equation`; sensor: the hydraulic force against the pressures."""
    not_checked: list[str]
    """Equations that cannot be checked, and `forecast: ` with the reason for a missing forecast."""
    recordings: list[dict[str, Any]]
    """Recordings, as `location` names them: `name`, and `begin`, the stamp [s] of the first sample of a bag."""
    data_quality: list[str]
    baseline: dict[str, Any]
    versions: dict[str, str]
    seconds: float
    steps: list[dict[str, Any]] = field(default_factory=list)
    """Steps of the search: action, label, and delta_bic relative to the fit without claims."""
    lost: list[LostStage] = field(default_factory=list)
    """Stages that failed, an error of the program; usually empty."""

    @property
    def answers(self) -> list[str]:
        """Answers to what a practitioner asks first: what moves and holds, what opposes motion, what does the valve."""
        kinds = (
            ("force_offset", "load_cell_bias", "spring", "end_cushion"),
            ("friction", "backlash"),
            ("valve", "transport_delay"),
        )
        weight, friction, valve = ([one.said for one in self.effects if one.id.startswith(kind)] for kind in kinds)
        weight += [one.sentence for one in self.closures if one.equation == "motion"]
        found = []
        if "motion" in self.checked:
            found += [" ".join(weight) or "No constant force and no force over the stroke is missing."]
            found += [" ".join(friction) or "No friction beyond the bench file's could be named."]
        if "actuation" in self.checked:
            found += [" ".join(valve) or "No cause in the valve could be named."]
        return found

    def to_json(self) -> str:
        """Return the report as JSON text."""
        return encode_json(self).decode()

    def write(self, folder: Path) -> None:
        """Write report.json to a folder."""
        write_atomic(folder / "report.json", encode_json(self))
