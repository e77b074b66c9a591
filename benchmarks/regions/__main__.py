# SPDX-License-Identifier: Apache-2.0
"""Prove a region: python -m benchmarks.regions --numbers valve_gain --tolerance 0.05 --out region.json.

Of a bench file and a law: the box of a sine of --force, the gains, and a tolerance of the numbers to either side, in
--split parts with a metric each. Prints lambda, tubes and the CPU it took, and of runs at the same gains the share of
samples inside. Needs Clarabel: pip install -r requirements-bench.txt.
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.regions.parameters import TOLERANCED_PARAMETERS, containment_share
from benchmarks.regions.statement import RegionTarget, certify_region, simulate_states
from hydro_core.cli.console import command, make_parser
from hydro_core.files.atomic import write_atomic
from hydro_sim.box.box import BoxConfig
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import Bench


@command()
def main() -> None:
    """Entry point."""
    options = make_parser("python -m benchmarks.regions", __doc__)
    options.add_argument("--model", metavar="FILE", help="bench file; the shipped learned bench by default")
    options.add_argument("--law", choices=("paper", "compensated"), default="paper")
    options.add_argument("--gains", type=float, nargs="+", default=[89.0, 90.0], metavar="KP", help="table of K_p, 1/s")
    options.add_argument("--gain-rate", type=float, default=0.0, help="fastest change of K_p, 1/s^2")
    options.add_argument("--rate", type=float, default=0.1, help="lambda, 1/s")
    options.add_argument("--force", type=float, default=1.0 / 3.0, help="amplitude of the box over the bench's force")
    options.add_argument(
        "--numbers", nargs="*", default=[], choices=TOLERANCED_PARAMETERS, help="numbers with the tolerance"
    )
    options.add_argument("--tolerance", type=float, default=0.0, help="to either side, as a share")
    options.add_argument("--split", type=int, default=1, help="parts of each tolerance and of the dead time")
    options.add_argument("--dead-time", type=float, default=0.0, help="the bench has up to so much of it, s")
    options.add_argument("--out", type=Path, metavar="FILE", help="statement to write")
    asked = options.parse_args()
    model, bench = learned_bench.load_model(asked.model), Bench.nominal()
    target = RegionTarget(
        law=BoxConfig().of_bench(bench).compensated if asked.law == "compensated" else None,
        gains=tuple(asked.gains), gain_rate=asked.gain_rate, rate=asked.rate, tolerance=asked.tolerance,
        toleranced_parameters=tuple(asked.numbers), tolerance_parts=asked.split, dead_time_tolerance=asked.dead_time,
        force=asked.force,
    )  # fmt: skip
    statement = certify_region(model, bench, target)
    if statement is None:
        print("no proof")
        return
    tubes = ", ".join(f"{tube:.0f}" for tube in statement["facts"]["tubes"])
    print(f"proved at {asked.rate:g} 1/s in {statement['facts']['seconds']:g} s of CPU; tubes {tubes} N")
    for force in (1.0 / 3.0, 2.0 / 3.0, 1.0):
        run = simulate_states(model, bench, target, force * model.size.force, seed=7)
        print(f"{force * model.size.force:.0f} N: {100.0 * containment_share(statement['states'], run):.1f} % inside")
    if asked.out:
        write_atomic(asked.out, json.dumps(statement, indent=1).encode())


if __name__ == "__main__":
    main()
