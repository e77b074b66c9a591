# SPDX-License-Identifier: Apache-2.0
"""Diagnose recordings from Python: made here, read from a CSV in a rig's own units, diagnosed, corrected, checked.

    python docs/examples/diagnose_a_recording.py [FOLDER]

The bench below is worn: its oil leaks past the piston, and a new seal rubs. The diagnosis knows neither.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import pandas as pd

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis import Diagnosis, diagnose
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BELIEVED = Bench.nominal()
WORN = replace(
    BELIEVED,
    effects=(
        {"id": "leakage_internal", "parameters": {"coefficient": 2e-13}},
        {"id": "friction_coulomb", "parameters": {"force": 8.0}},
    ),
)
COLUMNS = {
    "time": "t[ms]",
    "piston_position": "x[mm]",
    "pressure_a": "pa[bar]",
    "pressure_b": "pb[bar]",
    "hydraulic_force": "f_rod[kN]",
    "load_force": "f_load[kN]",
    "valve_current": "i[mA]",
}
"""BenchState field: what the rig's logger calls it, and its unit. The rest of the fields may be missing."""


def record(folder: Path, seed: int, waveform: Waveform) -> Path:
    """Ten seconds of the worn bench, as a rig would log them."""
    reference = ReferenceSignal(waveform=waveform, amplitude=260.0, frequency=0.7)
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=10.0)
    states = simulate(AnalyticPlant(WORN), BELIEVED, schedule, seed=seed)
    path = folder / f"run{seed}.csv"
    log = {
        "t": states["time"] * 1e3,
        "x": states["piston_position"] * 1e3,
        "pa": states["pressure_a"] * 1e-5,
        "pb": states["pressure_b"] * 1e-5,
        "f_rod": states["hydraulic_force"] * 1e-3,
        "f_load": states["load_force"] * 1e-3,
        "i": states["valve_current"] * 1e3,
    }
    pd.DataFrame(log).to_csv(path, index=False)
    return path


def show(found: Diagnosis) -> None:
    """What a person wants to know."""
    report = found.report
    print(f"verdict: {report.verdict}")
    for effect in report.effects:
        print(f"  {effect.id}: {effect.sentence}")
        for name, estimate in effect.parameters.items():
            print(f"    {name} = {estimate.value:.4g} {estimate.unit}, 95 % {estimate.ci95}")
    for channel, error in report.fit["holdout"].items():
        errors = [error[key] for key in ("rmse_before", "rmse_after", "noise_floor")]
        print("  {}: 70 ms ahead {:.3g} before, {:.3g} after, noise {:.3g} {}".format(channel, *errors, error["unit"]))


def main(folder: Path) -> tuple[Diagnosis, Diagnosis]:
    """Make recordings, diagnose them, correct the bench, diagnose a fresh one."""
    runs = [record(folder, 1, Waveform.MULTISINE), record(folder, 2, Waveform.SINE)]
    unseen, fresh = record(folder, 3, Waveform.SMOOTH_STEP), record(folder, 4, Waveform.MULTISINE)
    found = diagnose(runs, holdout=[unseen], bench=BELIEVED, columns=COLUMNS)
    show(found)
    corrected = corrected_bench(found.bench, found.assessment.fit.claims)
    again = diagnose([fresh], bench=corrected, columns=COLUMNS)
    print(f"a fresh recording beside the corrected bench: {again.report.verdict}")
    return found, again


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
