# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page that reads well on a laptop and prints; its words are in its template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from jinja2 import Environment

from hydro_bridge.files.atomic import write_whole
from hydro_bridge.pages import environment
from hydro_diagnosis.findings import EffectReport, Report
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.report import plots
from hydro_diagnosis.report.comparison import compare
from hydro_diagnosis.report.corrected_bench import write_corrected
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report.plots import STATIC, location_plot, valve_plot
from hydro_sim.plotting import UNITS

_VERDICTS = {
    "no_mismatch": "The simulation matches these recordings: nothing is missing that they could show.",
    "explained": "What is missing was found and named; with it, nothing but noise remains.",
    "modelled": "What is missing is modelled, part of it without a name; with it, nothing but noise remains.",
    "partly_explained": "A cause was named, but something remains that it does not account for.",
    "unknown": "Something is missing, and no known cause accounts for it.",
}
_SHOWN = {"m": ("µm", 1e6), "Pa": ("kPa", 1e-3), "N": ("N", 1.0)}
"""Units of the table of errors, and the factor from SI."""
_MINUS = "\N{MINUS SIGN}"


def write_files(found: Diagnosis, folder: Path) -> None:
    """Write report.json, corrected.yaml and report.html to a folder, which is made only now."""
    folder.mkdir(parents=True, exist_ok=True)
    found.report.write(folder)
    write_corrected(found.corrected, (), folder / "corrected.yaml")
    write_whole(folder / "report.html", rendered(found).encode())


def rendered(found: Diagnosis) -> str:
    """Return the page."""
    report, comparison = found.report, compare(found)
    return _environment().get_template("report.html").render(
        title="Diagnosis",
        report=report,
        fitted=_names(found.problem.models),
        checked=_names(found.holdout),
        verdict=_VERDICTS[report.verdict],
        effects=[(effect, _picture(found, effect)) for effect in report.effects],
        comparison=comparison,
        held_out=_held_out(report),
        equations=_equations(report),
        location_plot=location_plot(found) if report.location else "",
        curves=plots.curves_plot(found) if any(report.checks.get("curves", {}).values()) else "",
        residual_plot=plots.residual_plot(found),
        evidence_plot=plots.evidence_plot(found) if found.outcome.steps else "",
    )  # fmt: skip


def _environment() -> Environment:
    made = environment("hydro_diagnosis", "report/templates")
    made.filters.update(heading=_heading, range=_range, bounds=_bounds, gain=_gain, number=_number)
    return made


def _names(models: Sequence[SegmentModel]) -> str:
    return ", ".join(dict.fromkeys(model.segment.recording for model in models))


def _heading(identifier: str) -> str:
    """An id as a heading."""
    words = identifier.replace("_", " ").capitalize()
    return words.replace("coulomb", "(Coulomb)").replace("stribeck", "(Stribeck)")


def _range(bounds: Sequence[float] | None) -> str:
    """Two numbers in thousandths; empty for none."""
    return "" if bounds is None else f"{bounds[0] * 1e3:.3g} to {bounds[1] * 1e3:.3g}".replace("-", _MINUS)


def _bounds(ci95: Sequence[float] | None) -> str:
    return "not identifiable from these recordings" if ci95 is None else f"{ci95[0]:.5g} to {ci95[1]:.5g}"


def _gain(share: float) -> str:
    if share < -1e-3:
        return "It does not help on the held-out recordings."
    amount = "less than 0.1" if share < 1e-3 else f"{share * 100:.3g}"
    return f"It removes {amount} % of what stands above the noise in the held-out recordings."


def _number(value: float | None, factor: float) -> str:
    if value is None:
        return ""
    return f"{value * factor:.4g}" if isfinite(value) else "diverges"


def _picture(found: Diagnosis, effect: EffectReport) -> str:
    claim = next(
        one
        for one in found.assessment.fit.claims
        if one.effect.id == effect.id and dict(one.effect.options) == effect.options
    )
    return valve_plot(found, claim) if claim.effect.id in STATIC else plots.effect_plot(found, claim)


def _held_out(report: Report) -> list[dict[str, Any]]:
    """Errors of the channels: 70 ms before and after, a free run before and after, the noise floor."""
    rows = []
    for name, error in report.fit["holdout"].items():
        free: dict[str, Any] = report.fit["free_run"].get(name, {})
        ends = [error["rmse_before"], error["rmse_after"], free.get("rmse_before"), free.get("rmse_after")]
        rows.append(_row(UNITS[name][0], error, [*ends, error["noise_floor"]]))
    return rows


def _equations(report: Report) -> list[dict[str, Any]]:
    """Held-out residuals of the equations, where nothing can be simulated."""
    keys = ("rmse_before", "rmse_after", "noise_floor", "signal")
    return [_row(name, error, [error[key] for key in keys]) for name, error in report.fit.get("equations", {}).items()]


def _row(name: str, error: Mapping[str, Any], values: Sequence[float | None]) -> dict[str, Any]:
    unit, factor = _SHOWN[error["unit"]]
    return {"name": name, "unit": unit, "factor": factor, "values": values}
