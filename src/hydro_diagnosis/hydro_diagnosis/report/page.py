# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page for screen and print; its text is in the template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.pages import environment
from hydro_core.files.atomic import write_atomic
from hydro_diagnosis.effects.base import MOTION, EffectHypothesis, FloatArray, display_unit
from hydro_diagnosis.model.simulation import WindowSimulation
from hydro_diagnosis.report import plots
from hydro_diagnosis.report.corrected_bench import write_corrected
from hydro_diagnosis.report.diagnosis import Diagnosis, accounted_sentence, interval
from hydro_diagnosis.simulator_comparison import sentences
from hydro_diagnosis.validation import FREE_RUN_TIME, SIMULATION_CHANNELS
from hydro_sim.plotting import UNITS


def compare(found: Diagnosis) -> dict[str, Any] | None:
    """Measured and simulated signals of the first held-out segment that is long enough, as content of the page.

    `fits`: NRMSE fits [%] by channel, with the bench file alone and with the claims. None if the segment cannot be
    simulated.
    """
    model = next((one for one in found.holdout if len(one.segment) * one.step > 2.0 * FREE_RUN_TIME + 1.0), None)
    if model is None or not model.channels.keys() >= SIMULATION_CHANNELS or MOTION not in found.problem.blocks:
        return None
    length = round(FREE_RUN_TIME / model.step)
    first = model.settle - (model.settle - model.segment.phase) % model.spacing
    count = int(min(6.0 / FREE_RUN_TIME, (len(model.segment) - first - 20) // length))
    begins = first + length * np.arange(count)
    base, claims = tuple(found.problem.baseline), tuple(found.assessment.fit.claims)

    def simulated(some: tuple[EffectHypothesis, ...]) -> dict[str, FloatArray]:
        """Simulated measurements by channel, the windows in sequence, each of shape (rows,)."""
        simulation = WindowSimulation(model, some)
        shown = simulation.readings(simulation.recorded[:, begins], begins, length)
        return {name: one.T.ravel() for name, one in shown.items()}

    with np.errstate(all="ignore"):
        before, after = simulated(base), simulated((*base, *claims))
    rows = np.arange(begins[0], begins[-1] + length)
    measured = {name: model.channels[name][rows] for name in UNITS if name in before}
    time = model.segment.start + model.step * rows
    words = f"time [s] of {model.segment.recording}, free runs of {FREE_RUN_TIME:g} s one after the other"
    return {
        "recording": model.segment.recording,
        "plot": plots.signals_plot(time, words, measured, before, after),
        "fits": [
            (UNITS[name][0], [nrmse_fit(one, before[name]), nrmse_fit(one, after[name])])
            for name, one in measured.items()
        ],
    }


def nrmse_fit(measured: FloatArray, simulated: FloatArray) -> float | None:
    """NRMSE fit [%]: 100 is exact, 0 as good as the mean of the measured signal; None if it is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.linalg.norm(measured - simulated) / np.linalg.norm(measured - measured.mean()))
    return 100.0 * (1.0 - off) if isfinite(off) else None


_VERDICTS = {
    "no_mismatch": "The simulation matches these recordings: nothing is missing that they could show.",
    "explained": "What is missing was found and named.",
    "modelled": "What is missing is modelled, part of it without a name.",
    "partly_explained": "A cause was named, but something remains that it does not account for.",
    "unknown": "Something is missing, and no known cause accounts for it.",
}
_CHECKED = {
    "pressure_a": "oil of chamber A", "pressure_b": "oil of chamber B", "actuation": "valve and supply",
    "motion": "forces on the moving mass", "load": "force of the load", "sensor": "hydraulic force against pressures",
}  # fmt: skip
"""Subject of each equation in `checked` and `not_checked`."""


def write_files(found: Diagnosis, folder: Path) -> None:
    """Write report.json, corrected.yaml, report.html and the tracebacks of lost stages to a folder, made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(folder / "report.html", render_report(found).encode())
    corrected = folder / "corrected.yaml"
    found.border.run(
        "corrected", lambda: write_corrected(found.corrected, (), corrected), lambda: corrected.unlink(missing_ok=True)
    )
    found.border.write(folder)
    found.report.write(folder)


def render_report(found: Diagnosis) -> str:
    """Return report.html as text; without plots and tables if these fail."""
    return found.border.run("page", lambda: _page(found), lambda: f"<pre>{escape(str(found))}</pre>")


def _page(found: Diagnosis) -> str:
    report, comparison = found.report, compare(found)

    def row(name: str, error: Mapping[str, Any], values: Sequence[float | None]) -> dict[str, Any]:
        unit, factor = {"m": ("µm", 1e6), "Pa": ("kPa", 1e-3), "N": ("N", 1.0)}[error["unit"]]
        return {"name": name, "unit": unit, "factor": factor, "values": values}

    held_out = []  # 70 ms before and after, a free run before and after, the noise floor
    for name, error in report.fit["holdout"].items():
        free: dict[str, Any] = report.fit["free_run"].get(name, {})
        runs = (error["rmse_before"], error["rmse_after"], free.get("rmse_before"), free.get("rmse_after"))
        held_out.append(row(UNITS[name][0], error, [*runs, error["noise_floor"]]))
    keys = ("rmse_before", "rmse_after", "noise_floor", "signal")
    equations = [  # held-out residuals, where nothing can be simulated
        row(name, error, [error[key] for key in keys]) for name, error in report.fit.get("equations", {}).items()
    ]
    made = environment("hydro_diagnosis", "report/templates")
    made.filters.update(
        heading=_heading, range=_range, interval=interval, display_unit=display_unit, gain=_gain, number=_number
    )
    return made.get_template("report.html").render(
        title="Diagnosis", report=report, used=found.used, verdict=_VERDICTS[report.verdict],
        checked=[f"{name}: {_CHECKED[name]}" for name in report.checked],
        not_checked=[
            f"{name}: {_CHECKED[name]}, for lack of channels" if name in _CHECKED else name
            for name in report.not_checked
        ],
        differences=sentences(report.simulated or ()), accounted=accounted_sentence(report),
        effects=[(effect, plots.effect_plot(found, effect)) for effect in report.effects],
        comparison=comparison, held_out=held_out, equations=equations,
        curves=plots.curves_plot(found) if report.curves else "", residual_plot=plots.residual_plot(found),
    )  # fmt: skip


def _heading(identifier: str) -> str:
    """Heading for an effect's id."""
    words = identifier.replace("_", " ").capitalize()
    return words.replace("coulomb", "(Coulomb)").replace("stribeck", "(Stribeck)")


def _range(bounds: Sequence[float] | None) -> str:
    """Text of an interval, in thousandths; empty for None."""
    return "" if bounds is None else f"{bounds[0] * 1e3:.3g} to {bounds[1] * 1e3:.3g}".replace("-", "\N{MINUS SIGN}")


def _gain(share: float) -> str:
    if share < -1e-3:
        return "It is sure of the fitted recordings alone: the held-out ones fit as well without it."
    amount = "less than 0.1" if share < 1e-3 else f"{share * 100:.3g}"
    return f"It removes {amount} % of what stands above the noise in the held-out recordings."


def _number(value: float | None, factor: float) -> str:
    if value is None:
        return ""
    return f"{value * factor:.4g}" if isfinite(value) else "not finite"
