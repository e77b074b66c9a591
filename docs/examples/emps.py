# SPDX-License-Identifier: Apache-2.0
"""Real recordings: what the diagnosis says about EMPS, beside what its authors published.

    python docs/examples/emps.py FOLDER        # with DATA_EMPS.mat and DATA_EMPS_PULSES.mat in FOLDER

Two baselines, mass alone and mass with viscous friction; each once with every cause in the library, and once with
those ruled out that depend on the direction. The errors are measured as the authors did: 100 Hz Butterworth without
lag, central differences, every tenth sample, norm of what is left over norm of the force.

A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS. Workshop on Nonlinear System Identification
Benchmarks, Eindhoven 2019.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, decimate, filtfilt

from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_diagnosis import Diagnosis, InputError, diagnose
from hydro_sim.model.bench import Bench

HERE = Path(__file__).parent
NO_CELL = ("load_cell_bias", "spring_rest")
"""In a motion equation alone these are a constant force; EMPS has neither load cell nor spring."""
SYMMETRIC = (*NO_CELL, "friction_coulomb:directional", "friction_viscous:directional")
COLUMNS = {
    "baseline": "what the bench file holds",
    "causes": "all, or symmetric: without those that depend on the direction",
    "viscous": "N s/m, in all; while extending and retracting",
    "coulomb": "N; while extending and retracting",
    "offset": "N, as the authors sign it: added to the force that the motion needs",
    "error": "%, of the force, on the recording that was fitted",
    "pulses": "%, of the force, on the one that was not",
}
PUBLISHED = (
    {"baseline": "published", "causes": "symmetric", "viscous": "203.5", "coulomb": "20.39", "offset": "-3.165",
     "error": 4.08, "pulses": 5.98},
    {"baseline": "published", "causes": "all", "viscous": "166.71, 240.42", "coulomb": "20.14, 20.63", "offset": "-",
     "error": 3.11, "pulses": np.nan},
)  # fmt: skip


def diagnosed(folder: Path, viscous_friction: float, without: tuple[str, ...] = NO_CELL) -> Diagnosis:
    """EMPS from a baseline of its mass and this viscous friction [N s/m]."""
    bench = replace(Bench.load(HERE / "emps_bench.yaml"), viscous_friction=viscous_friction)
    return diagnose(
        [folder / "DATA_EMPS.mat"],
        holdout=[folder / "DATA_EMPS_PULSES.mat"],
        bench=bench,
        columns=HERE / "emps_columns.yaml",
        without=without,
    )


def model(found: Diagnosis) -> dict[str, float]:
    """The whole model in the authors' terms: baseline and effects together, SI units."""
    bench = found.bench
    numbers = {"mass": bench.moving_mass, "offset": 0.0, "fc+": 0.0, "fc-": 0.0}
    numbers |= {"fv+": bench.viscous_friction, "fv-": bench.viscous_friction}
    for effect in found.report.effects:
        values = {name: one.value for name, one in effect.parameters.items()}
        match effect.id:
            case "friction_coulomb":
                numbers["fc+"] += values.get("force", values.get("force_positive", 0.0))
                numbers["fc-"] += values.get("force", values.get("force_negative", 0.0))
            case "friction_viscous":
                numbers["fv+"] += values.get("coefficient", values.get("coefficient_positive", 0.0))
                numbers["fv-"] += values.get("coefficient", values.get("coefficient_negative", 0.0))
            case "force_offset":
                numbers["offset"] -= values["force"]
            case other:
                raise ValueError(f"{other} is none of the authors' terms")
    return numbers


def relative_error(path: Path, numbers: Mapping[str, float]) -> float:
    """% of the force that the model leaves, as the authors measure it."""
    data = loadmat(path, simplify_cells=True)
    step = float(np.median(np.diff(data["t"])))
    taps = butter(4, 100.0 * 2.0 * step)
    position = filtfilt(*taps, data["qm"])
    velocity = np.gradient(position, step)
    acceleration = np.gradient(velocity, step)
    extending = velocity > 0.0
    needed = numbers["mass"] * acceleration + numbers["offset"]
    needed += np.where(extending, numbers["fv+"], numbers["fv-"]) * velocity
    needed += np.where(extending, numbers["fc+"], numbers["fc-"]) * np.sign(velocity)
    force = filtfilt(*taps, data["vir"] * data["gtau"])
    left, force = (decimate(signal, 10)[5:-5] for signal in (force - needed, force))
    return float(100.0 * np.linalg.norm(left) / np.linalg.norm(force))


def row(found: Diagnosis, folder: Path) -> dict[str, object]:
    """What a diagnosis comes to, as a row of the table."""
    numbers = model(found)

    def both(name: str) -> str:
        positive, negative = numbers[f"{name}+"], numbers[f"{name}-"]
        return f"{positive:.5g}" if positive == negative else f"{positive:.5g}, {negative:.5g}"

    return {
        "viscous": both("fv"),
        "coulomb": both("fc"),
        "offset": f"{numbers['offset']:.4g}" if numbers["offset"] else "-",
        "error": relative_error(folder / "DATA_EMPS.mat", numbers),
        "pulses": relative_error(folder / "DATA_EMPS_PULSES.mat", numbers),
    }


@command(InputError)
def main() -> int:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path, help="with DATA_EMPS.mat and DATA_EMPS_PULSES.mat")
    add_json_argument(options)
    chosen = options.parse_args()
    table = Table(COLUMNS)
    runs = [(name, value, causes) for name, value in (("mass", 0.0), ("mass, viscous", 203.5)) for causes in (0, 1)]
    for name, value, causes in progress(runs, label="EMPS"):
        found = diagnosed(chosen.folder, value, (NO_CELL, SYMMETRIC)[causes])
        table.add(baseline=name, causes=("all", "symmetric")[causes], **row(found, chosen.folder))
    for published in PUBLISHED:
        table.add(**published)
    table.show(chosen.json)
    return 0


if __name__ == "__main__":
    main()
