# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page that reads well on a laptop and prints."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from hydro_diagnosis import plots
from hydro_diagnosis.pipeline import Diagnosis
from hydro_diagnosis.report import EffectReport, Report

_VERDICTS = {
    "no_mismatch": "The simulation matches these recordings: nothing is missing that they could show.",
    "explained": "What is missing was found and named; with it, nothing but noise remains.",
    "partly_explained": "A cause was named, but something remains that it does not account for.",
    "unknown": "Something is missing, and no known cause accounts for it.",
}
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1d2129;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #d9dce1}
table{border-collapse:collapse;margin:.6rem 0}td,th{padding:.2rem .8rem .2rem 0;text-align:left;vertical-align:top}
th{font-weight:600;color:#5b6068}td.n{text-align:right;font-variant-numeric:tabular-nums}
.verdict{font-size:1.1rem;padding:.6rem 1rem;background:#eef4fa;border-left:4px solid #0072b2}
.quiet{color:#5b6068;font-size:.9rem}svg{max-width:100%;height:auto}
section{break-inside:avoid}@media print{body{margin:0;max-width:none;font-size:11px}}
"""


def write_page(found: Diagnosis, path: Path) -> None:
    """Write report.html."""
    report = found.report
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Diagnosis</title>",
        f"<style>{_STYLE}</style></head><body><h1>Diagnosis</h1>",
        f"<p class='quiet'>{escape(', '.join(_recordings(found)))}; {report.seconds:.1f} s of computing</p>",
        f"<p class='verdict'><b>{escape(report.verdict.replace('_', ' '))}.</b> {_VERDICTS[report.verdict]}</p>",
        _locations(report),
        *(_effect(found, effect) for effect in report.effects),
        _remainder(report),
        _held_out(report),
        "<section><h2>Residuals of the first recording</h2>" + plots.residual_plot(found) + "</section>",
        _evidence(found),
        _next(report),
        _list("Checked equations", report.checked),
        _list("Not checked, for lack of channels", report.not_checked),
        _list("Data quality", report.data_quality),
        "</body></html>",
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def _recordings(found: Diagnosis) -> list[str]:
    return list(dict.fromkeys(model.segment.recording for model in found.problem.models))


def _locations(report: Report) -> str:
    if not report.location:
        return ""
    rows = "".join(
        f"<tr><td>{escape(place.sentence)}</td><td>{escape(_region(place.region))}</td></tr>"
        for place in report.location
    )
    head = "<tr><th></th><th>where it stands out (10th to 90th percentile)</th></tr>"
    return f"<section><h2>Where</h2><table>{head}{rows}</table></section>"


def _region(region: dict[str, list[float]]) -> str:
    units = {"position": ("mm", 1e3), "velocity": ("mm/s", 1e3), "current": ("mA", 1e3)}
    return "; ".join(
        f"{name} {low * units[name][1]:.3g} to {high * units[name][1]:.3g} {units[name][0]}"
        for name, (low, high) in region.items()
    )


def _effect(found: Diagnosis, effect: EffectReport) -> str:
    claim = next(
        one
        for one in found.assessment.fit.claims
        if one.effect.id == effect.id and dict(one.effect.options) == effect.options
    )
    rows = "".join(
        f"<tr><td>{name}</td><td class='n'>{estimate.value:.5g}</td><td>{escape(estimate.unit)}</td>"
        f"<td>{_bounds(estimate.ci95)}</td></tr>"
        for name, estimate in effect.parameters.items()
    )
    rivals = "".join(f"<li>{escape(rival.why)}</li>" for rival in effect.rivals)
    return (
        f"<section><h2>{escape(effect.id)}</h2><p>{escape(effect.sentence)}</p>"
        f"<table><tr><th>parameter</th><th>value</th><th>unit</th><th>95 %</th></tr>{rows}</table>"
        f"<p class='quiet'>Evidence {effect.evidence['delta_bic']:.0f} of BIC.</p>{plots.effect_plot(found, claim)}"
        f"<ul class='quiet'>{rivals}</ul></section>"
    )


def _bounds(ci95: list[float] | None) -> str:
    return "not identifiable from these recordings" if ci95 is None else f"{ci95[0]:.5g} to {ci95[1]:.5g}"


def _remainder(report: Report) -> str:
    if not report.remainder:
        return ""
    places = " ".join(place["sentence"] for place in report.remainder["location"])
    depends = ", ".join(report.remainder["depends_on"]) or "none of the variables that were tried"
    dropped = ", ".join(report.remainder["dropped"])
    note = f" Names that the search tried and that do not hold: {escape(dropped)}." if dropped else ""
    return f"<section><h2>What remains</h2><p>{escape(places)} It depends on {escape(depends)}.{note}</p></section>"


def _held_out(report: Report) -> str:
    rows = ""
    for name, error in report.fit["holdout"].items():
        free: dict[str, Any] = report.fit["free_run"].get(name, {})
        cells = [
            error["rmse_before"],
            error["rmse_after"],
            error["noise_floor"],
            free.get("rmse_before"),
            free.get("rmse_after"),
        ]
        numbers = "".join(f"<td class='n'>{cell:.4g}</td>" if cell is not None else "<td></td>" for cell in cells)
        rows += f"<tr><td>{name}</td><td>{error['unit']}</td>{numbers}</tr>"
    if not rows:
        return ""
    return (
        "<section><h2>Held-out error (RMSE)</h2><table><tr><th>channel</th><th>unit</th><th>70 ms, before</th>"
        "<th>after</th><th>noise floor</th><th>free run, before</th><th>after</th></tr>"
        f"{rows}</table></section>"
    )


def _evidence(found: Diagnosis) -> str:
    if not found.outcome.steps:
        return ""
    return "<section><h2>How evidence converged</h2>" + plots.evidence_plot(found) + "</section>"


def _next(report: Report) -> str:
    if not report.next_recording:
        return ""
    return f"<section><h2>Next recording</h2><p>{escape(report.next_recording['why'])}</p></section>"


def _list(title: str, entries: list[str]) -> str:
    items = "".join(f"<li>{escape(entry)}</li>" for entry in entries)
    return f"<section><h2>{title}</h2><ul>{items}</ul></section>" if entries else ""
