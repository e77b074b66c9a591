# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page that reads well on a laptop and prints."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from math import isfinite
from pathlib import Path
from typing import Any

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.findings import EffectReport, Report
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.report import plots
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report.residual_plots import location_plot
from hydro_diagnosis.report.valve_plots import STATIC, valve_plot
from hydro_sim.plotting import UNITS

_VERDICTS = {
    "no_mismatch": "The simulation matches these recordings: nothing is missing that they could show.",
    "explained": "What is missing was found and named; with it, nothing but noise remains.",
    "modelled": "What is missing is modelled, part of it without a name; with it, nothing but noise remains.",
    "partly_explained": "A cause was named, but something remains that it does not account for.",
    "unknown": "Something is missing, and no known cause accounts for it.",
}
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1d2129;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #d9dce1}
h2 code{font-size:.8rem;font-weight:400;color:#5b6068;margin-left:.6rem}
table{border-collapse:collapse;margin:.6rem 0}td,th{padding:.2rem 1.2rem .2rem 0;text-align:left;vertical-align:top}
th{font-weight:600;color:#5b6068}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.verdict{font-size:1.1rem;padding:.6rem 1rem;background:#eef4fa;border-left:4px solid #0072b2}
.quiet{color:#5b6068;font-size:.9rem}svg{max-width:100%;height:auto;display:block}
section{break-inside:avoid}h2{break-after:avoid}
@media print{@page{margin:15mm}html{font-size:11px}body{margin:0;max-width:none;padding:0;font-size:1rem}
h2{margin-top:1.2rem}svg{max-width:75%}}
"""
_SHOWN = {"m": ("&micro;m", 1e6), "Pa": ("kPa", 1e-3), "N": ("N", 1.0)}
"""Units of the table of errors, and the factor from SI."""


def write_page(found: Diagnosis, path: Path) -> None:
    """Write report.html."""
    report = found.report
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Diagnosis</title>",
        f"<style>{STYLE}</style></head><body><h1>Diagnosis</h1>",
        f"<p class='quiet'>Fitted on {_names(found.problem.models)}; checked on {_names(found.holdout)}; "
        f"{report.seconds:.1f} s of computing.</p>",
        f"<p class='verdict'><b>{_title(report.verdict)}.</b> {_VERDICTS[report.verdict]}</p>",
        _locations(found),
        *(_effect(found, effect) for effect in report.effects),
        _closures(report),
        _remainder(report),
        _held_out(report),
        "<section><h2>Residuals of the first recording</h2><p class='quiet'>What each equation leaves unexplained, "
        "with the bench file alone (before) and with the effects above (after).</p>"
        + plots.residual_plot(found)
        + "</section>",
        _evidence(found),
        _next(report),
        _list("Checked equations", report.checked),
        _list("Not checked, for lack of channels", report.not_checked),
        _list("Data quality", report.data_quality),
        "</body></html>",
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def _names(models: Sequence[SegmentModel]) -> str:
    return escape(", ".join(dict.fromkeys(model.segment.recording for model in models)))


def _title(identifier: str) -> str:
    """An id as a heading."""
    words = identifier.replace("_", " ").capitalize()
    return escape(words.replace("coulomb", "(Coulomb)").replace("stribeck", "(Stribeck)"))


def _locations(found: Diagnosis) -> str:
    report = found.report
    if not report.location:
        return ""
    rows = "".join(
        f"<tr><td>{escape(place.sentence)}</td>{''.join(_range(place.region.get(name)) for name in _REGION)}</tr>"
        for place in report.location
    )
    head = "".join(f"<th class='n'>{name} [{unit}]</th>" for name, unit in _REGION.items())
    return (
        f"<section><h2>Where</h2><table><tr><th></th>{head}</tr>{rows}</table>"
        "<p class='quiet'>Ranges: where it stands out, 10th to 90th percentile. Below: what the bench file alone "
        "leaves unexplained, in units of the noise.</p>" + location_plot(found) + "</section>"
    )


_REGION = {"position": "mm", "velocity": "mm/s", "current": "mA"}


def _range(bounds: list[float] | None) -> str:
    shown = "" if bounds is None else f"{bounds[0] * 1e3:.3g} to {bounds[1] * 1e3:.3g}".replace("-", "&minus;")
    return f"<td class='n'>{shown}</td>"


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
    tried = [*(rival.why for rival in effect.rivals), *(alike.why for alike in effect.look_alikes)]
    rivals = "".join(f"<li>{escape(why)}.</li>" for why in tried)
    others = f"<p class='quiet'>Other causes that were tried:</p><ul class='quiet'>{rivals}</ul>" if rivals else ""
    which = " ".join([effect.id, *effect.options.values()])
    return (
        f"<section><h2>{_title(effect.id)}<code>{escape(which)}</code></h2><p>{escape(effect.sentence)}</p>"
        f"<table><tr><th>parameter</th><th class='n'>value</th><th>unit</th><th>95 % interval</th></tr>{rows}</table>"
        f"<p class='quiet'>Evidence: without it the recordings are explained worse by "
        f"{effect.evidence['delta_bic']:.0f} of BIC. {_gain(effect.evidence['holdout_gain'])}</p>"
        f"{_picture(found, claim)}{others}</section>"
    )


def _picture(found: Diagnosis, claim: Claim) -> str:
    if claim.effect.id in STATIC:
        return valve_plot(found, claim)
    return plots.effect_plot(found, claim)


def _gain(share: float) -> str:
    if share < -1e-3:
        return "It does not help on the held-out recordings."
    amount = "less than 0.1" if share < 1e-3 else f"{share * 100:.3g}"
    return f"It removes {amount} % of what stands above the noise in the held-out recordings."


def _bounds(ci95: list[float] | None) -> str:
    return "not identifiable from these recordings" if ci95 is None else f"{ci95[0]:.5g} to {ci95[1]:.5g}"


def _closures(report: Report) -> str:
    if not report.closures:
        return ""
    rows = "".join(
        f"<tr><td>{escape(one.equation)}</td><td>{escape(one.expression)}</td>"
        f"<td>{escape(_bounds(one.terms['coefficient'].ci95)) if one.form == 'law' else ''}</td>"
        f"<td>{escape(one.sentence)}</td></tr>"
        for one in report.closures
    )
    share = report.closures[0].share_closed
    return (
        "<section><h2>Modelled without a name</h2><table><tr><th>equation</th><th>term</th><th>95 % interval</th>"
        f"<th>what such a term usually is</th></tr>{rows}</table><p class='quiet'>Terms, not causes: together they "
        f"remove {share * 100:.3g} % of what the names leave above the noise in the held-out recordings.</p></section>"
    )


def _remainder(report: Report) -> str:
    if not report.remainder:
        return ""
    places = " ".join(place["sentence"] for place in report.remainder["location"])
    depends = ", ".join(report.remainder["depends_on"]) or "none of the variables that were tried"
    dropped = ", ".join(report.remainder["dropped"])
    note = f" Names that the search tried and that do not hold: {escape(dropped)}." if dropped else ""
    likeness = escape(" ".join(report.remainder["looks_like"]))
    told = f"{escape(places)} It depends on {escape(depends)}. {likeness}{note}"
    return f"<section><h2>What remains</h2><p>{told}</p></section>"


def _held_out(report: Report) -> str:
    rows = ""
    for name, error in report.fit["holdout"].items():
        unit, factor = _SHOWN[error["unit"]]
        free: dict[str, Any] = report.fit["free_run"].get(name, {})
        cells = [error["rmse_before"], error["rmse_after"], free.get("rmse_before"), free.get("rmse_after")]
        numbers = "".join(_number(cell, factor) for cell in (*cells, error["noise_floor"]))
        rows += f"<tr><td>{UNITS[name][0]}</td><td>{unit}</td>{numbers}</tr>"
    if not rows:
        why = escape(report.fit.get("why", "no held-out stretch was long enough"))
        return f"<section><h2>Held-out error</h2><p>Not simulated: {why}.</p>{_equations(report)}</section>"
    columns = ("70 ms, before", "70 ms, after", "free run, before", "free run, after", "noise floor")
    head = "".join(f"<th class='n'>{title}</th>" for title in columns)
    seconds, unpredictable = report.fit["free_run"].get("seconds", 0.0), report.fit["unpredictable"]["why"]
    return (
        f"<section><h2>Held-out error</h2><table><tr><th>channel</th><th>unit</th>{head}</tr>{rows}</table>"
        "<p class='quiet'>Root mean square error of simulations from the recorded valve current, on recordings that "
        f"nothing was fitted to: 70 ms, and free runs of {seconds:g} s. {escape(unpredictable)}</p></section>"
    )


def _equations(report: Report) -> str:
    """Held-out residuals of the equations, where nothing can be simulated."""
    rows = ""
    for name, error in report.fit.get("equations", {}).items():
        unit, factor = _SHOWN[error["unit"]]
        numbers = [error[key] for key in ("rmse_before", "rmse_after", "noise_floor", "signal")]
        rows += f"<tr><td>{name}</td><td>{unit}</td>{''.join(_number(number, factor) for number in numbers)}</tr>"
    head = "".join(f"<th class='n'>{title}</th>" for title in ("before", "after", "noise floor", "signal"))
    return (
        f"<table><tr><th>equation</th><th>unit</th>{head}</tr>{rows}</table><p class='quiet'>Root mean square of what "
        "each equation leaves unexplained on recordings that nothing was fitted to, each residual weighted as in the "
        "fit, and of the measured signal.</p>"
    )


def _number(value: float | None, factor: float) -> str:
    if value is None:
        return "<td></td>"
    return f"<td class='n'>{value * factor:.4g}</td>" if isfinite(value) else "<td class='n'>diverges</td>"


def _evidence(found: Diagnosis) -> str:
    if not found.outcome.steps:
        return ""
    return "<section><h2>How evidence converged</h2>" + plots.evidence_plot(found) + "</section>"


def _next(report: Report) -> str:
    if not report.next_recording:
        return ""
    reference = report.next_recording["reference"] or {}
    rows = "".join(f"<tr><td>{key}</td><td>{escape(str(value))}</td><td>{_REFERENCE.get(key, '')}</td></tr>"
                   for key, value in reference.items())  # fmt: skip
    return (
        f"<section><h2>Next recording</h2><p>{escape(report.next_recording['why'])}</p><table>{rows}</table></section>"
    )


_REFERENCE = {"amplitude": "N", "offset": "N", "frequency": "Hz", "seconds": "s"}


def _list(title: str, entries: list[str]) -> str:
    items = "".join(f"<li>{escape(entry)}</li>" for entry in entries)
    return f"<section><h2>{title}</h2><ul>{items}</ul></section>" if entries else ""
