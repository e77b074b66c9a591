# SPDX-License-Identifier: Apache-2.0
"""The benchmark control problem for real-time hybrid simulation: published entries and ours, on a plant of others.

    git clone https://github.com/lihongweiseu/RTHS_benchmark_SMC runs/hybrid_simulation    for its three .mat files
    python -m benchmarks.hybrid_simulation --json FILE           four buildings, three motions, nominal plants
    python -m benchmarks.hybrid_simulation --buildings 1 4 --motions "El Centro" --plants 200 --seed 7

The yielding specimen is that of github.com/FermandoisLab/RobustAMBCvRTHS; it stands in building 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import parser
from benchmarks.hybrid_simulation.criteria import CRITERIA
from benchmarks.hybrid_simulation.entries import ENTRIES
from benchmarks.hybrid_simulation.motions import MOTIONS, ORIGIN, ground_motion
from benchmarks.hybrid_simulation.plant import MASS, SPECIMENS, YIELDING, Actuator, drawn
from benchmarks.hybrid_simulation.simulation import reference_response, run, scores
from hydro_core.cli.console import Table, bounded_number, command, progress
from hydro_core.files.atomic import encode_json, write_atomic

INTENSITY = {"linear": 0.4, "yielding": 0.5}
"""Factor of the ground motions, as published."""
COLUMNS = {
    "entry": "", "specimen": "", "building": "", "motion": "", **CRITERIA,
    "median": "%, j2_true over the perturbed plants, inf where unstable",
    "worst": "%, the same",
    "unstable": "runs, among nominal and perturbed plants, in which the target leaves 15 mm, or j2_true is above 100",
}  # fmt: skip


@command()
def main() -> None:
    """Run what is asked for and print the table."""
    options = parser("hybrid_simulation", __doc__)
    options.add_argument("--data", type=Path, default=Path("runs/hybrid_simulation"), metavar="FOLDER",
                         help=f"holds the motions' .mat files, from {ORIGIN} (default: %(default)s)")  # fmt: skip
    options.add_argument("--plants", type=bounded_number(0), default=0, metavar="N",
                         help="perturbed plants of each building and motion (default: %(default)s)")  # fmt: skip
    options.add_argument("--seed", type=bounded_number(0), default=1, help="of plants and noise (default: %(default)s)")
    options.add_argument("--buildings", type=int, nargs="+", choices=MASS, default=list(MASS), metavar="B",
                         help="1 to 4 (default: all)")  # fmt: skip
    options.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS), metavar="MOTION",
                         help=f"{', '.join(MOTIONS)} (default: all)")  # fmt: skip
    options.add_argument("--entries", nargs="+", choices=ENTRIES, default=list(ENTRIES), metavar="ENTRY",
                         help=f"{', '.join(ENTRIES)} (default: all)")  # fmt: skip
    asked = options.parse_args()
    rows = measured(asked.data, asked.entries, asked.buildings, asked.motions, asked.plants, asked.seed)
    print(table(rows).text())
    if asked.json:
        intensities = {"intensity": INTENSITY["linear"], "intensity_yielding": INTENSITY["yielding"]}
        asked.json.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(asked.json, encode_json({"seed": asked.seed, **intensities, "rows": rows}))


def measured(
    data: Path, entries: Sequence[str], buildings: Sequence[int], motions: Sequence[str], plants: int, seed: int
) -> list[dict[str, Any]]:
    """Return a row for each run; the entries of a plant have the same noise.

    Raises UserError: `data` lacks a file of a motion.
    """
    cases = [
        (specimen, building, motion)
        for specimen in SPECIMENS for building in buildings for motion in motions
        if specimen == "linear" or building == 1
    ]  # fmt: skip
    draws = {"linear": drawn(seed, plants), "yielding": [(Actuator(), YIELDING)]}
    grounds = {(s, m): ground_motion(data, m, INTENSITY[s]) for s in SPECIMENS for m in motions}
    runs = [(case, plant, entry) for case in cases for plant in range(len(draws[case[0]])) for entry in entries]
    references, rows = {}, []
    for case, plant, entry in progress(runs, label="hybrid simulation", unit="run"):
        specimen, building, motion = case
        ground = grounds[specimen, motion]
        if case not in references:
            references[case] = reference_response(building, draws[specimen][0][1], ground)
        rng = np.random.default_rng((seed, building, list(MOTIONS).index(motion), plant))
        outcome = run(entry, building, *draws[specimen][plant], ground, rng)
        place = {"specimen": specimen, "building": building, "motion": motion, "plant": plant}
        rows.append({"entry": entry, **place, **scores(outcome, references[case])})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the nominal criteria of each entry and case, and j2_true over the perturbed plants."""
    result = Table(COLUMNS, title="Real-time hybrid simulation")
    keys = ("entry", "specimen", "building", "motion")
    for nominal in (row for row in rows if row["plant"] == 0):
        same = [row for row in rows if all(row[key] == nominal[key] for key in keys)]
        perturbed = [row["j2_true"] if row["stable"] else math.inf for row in same if row["plant"]]
        result.add(
            **{key: nominal[key] for key in (*keys, *CRITERIA)},
            median=float(np.median(perturbed)) if perturbed else None, worst=max(perturbed, default=None),
            unstable=sum(not row["stable"] for row in same),
        )  # fmt: skip
    return result


if __name__ == "__main__":
    main()
