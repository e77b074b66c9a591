# SPDX-License-Identifier: Apache-2.0
"""Does the simulation of a corrected.yaml track as the bench does? Truth, corrected bench and bench.yaml, fixed gains.

Of each concealed truth the emulator records three runs of 20 s, `diagnose` writes a corrected.yaml, and the same
references are tracked in closed loop by the emulator, by the analytic plant of corrected.yaml and by that of
bench.yaml. The box believes bench.yaml in all three. RMSE of e = f_r - f_l in N, first 2 s left out; `off`: over the
truth's, - 1.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._report import finish, parser
from hydro_bridge.signals import ReferenceSignal, StateArray, Waveform
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation.schedules import Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

TRUTHS: dict[str, dict[str, Any]] = {
    "worn valve": {
        "profile": "nominal",
        "effects": {
            "valve_deadband": {"half_width": 1e-4},
            "leakage_internal": {"coefficient": 1e-12},
            "friction_coulomb": {"force": 15.0},
        },
    },
    "late and weak": {
        "profile": "nominal",
        "effects": {
            "transport_delay": {"time": 3e-3},
            "valve_gain": {"ratio": 0.8},
            "supply_droop": {"resistance": 2e10, "time_constant": 0.02},
        },
    },
    "the default truth": {"profile": "default"},
}
FREQUENCIES = (0.5, 1.0, 1.5, 2.0)
SETTLING = 2000
SECONDS = 12.0


def corrected(truth: dict[str, Any], folder: Path) -> Bench:
    """What a diagnosis of three recordings makes of bench.yaml."""
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth))
    sine = {"waveform": "sine", "amplitude": 250.0, "frequency": 1.3, "kp": 60.0}
    (folder / "sine.yaml").write_text(yaml.safe_dump({"segments": [{"seconds": 20.0, **sine}]}))
    for k, schedule in enumerate(([], [], ["--schedule", "sine.yaml"])):
        record = ["emulator", "--offline", "--truth", "truth.yaml", "--seconds", "20", "--seed", str(k + 1), *schedule]
        _run("hydro_sim", [*record, "--out", f"run{k}"], folder)
    _run("hydro_diagnosis", ["diagnose", "run0", "run1", "--holdout", "run2", "--out", "found"], folder)
    return Bench.load(folder / "found" / "corrected.yaml")


def _run(package: str, words: list[str], folder: Path) -> None:
    subprocess.run(["ros2", "run", package, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def rmse(states: StateArray) -> float:
    """RMSE of e [N] after settling."""
    error = (states["reference_force"] - states["load_force"])[SETTLING:]
    return float(np.sqrt(np.mean(error**2)))


def tracked(truth: dict[str, Any], found: Bench, kp: float, frequency: float) -> dict[str, float]:
    """RMSE [N] of truth, corrected and nominal bench."""
    segment = Segment(seconds=SECONDS, amplitude=250.0, frequency=frequency, kp=kp, ki=10.0)
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=250.0, frequency=frequency)
    schedule = Schedule(reference=reference, gains=(kp, 10.0), seconds=SECONDS)
    nominal = Bench.nominal()
    outcome = {"truth": rmse(record_offline(truth_from_mapping(truth), [segment], seed=9).states)}
    for name, bench in (("corrected", found), ("nominal", nominal)):
        outcome[name] = rmse(simulate(AnalyticPlant(bench), nominal, schedule, seed=9))
    return outcome


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    options = parser("corrected_bench", __doc__)
    options.add_argument("--kp", type=float, nargs="+", default=[30.0, 60.0])
    options.add_argument("--only", choices=list(TRUTHS), nargs="+", default=list(TRUTHS), help="default all")
    asked = options.parse_args(arguments)
    result: dict[str, Any] = {}
    for name in asked.only:
        with tempfile.TemporaryDirectory() as folder:
            found = corrected(TRUTHS[name], Path(folder))
        print(f"\n{name}: {', '.join(map(label, found.effects))}")
        print(f"{'K_p':>6}{'Hz':>6}{'truth':>10}{'corrected':>12}{'off':>9}{'nominal':>10}{'off':>9}")
        rows = {}
        for kp in asked.kp:
            for frequency in FREQUENCIES:
                row = tracked(TRUTHS[name], found, kp, frequency)
                off = {key: row[key] / row["truth"] - 1.0 for key in ("corrected", "nominal")}
                print(
                    f"{kp:>6g}{frequency:>6g}{row['truth']:>10.2f}{row['corrected']:>12.2f}{off['corrected']:>+9.1%}"
                    f"{row['nominal']:>10.2f}{off['nominal']:>+9.1%}"
                )
                rows[f"{kp:g}, {frequency:g} Hz"] = row
        result[name] = {"effects": list(found.effects), "rmse": rows}
    finish({"unit": "N", **result}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
