# SPDX-License-Identifier: Apache-2.0
"""Reproduce the paper row by row: `make paper`, or `python -m benchmarks.paper [--quick] [--only TABLE ...]`.

Each piece's result is kept as JSON in the folder, and a piece that is done is not repeated: after Ctrl-C the same
command goes on. The results that came with the program (benchmarks/paper/results) count as made: --fresh runs them
again. Seed by seed, so that a run that was interrupted has all comparisons of the seeds that it finished. The report is
written again from what is there; what is not there is "not run yet".
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from benchmarks import _report
from benchmarks.paper import report
from benchmarks.paper.store import FULL, QUICK, RESULTS, Store
from hydro_core.cli.console import command

TABLES = {
    "rmse_model": "models.run",
    "training_metric": "metric.run",
    "val_cont": "validation.run",
    "rmse": "agents.run",
    "chatter": "agents.run_chatter",
    "own-row": "agents.run_own",
}
"""What runs each; imported when it does: torch and compiled code take seconds, and --show needs neither."""


@command(ValueError)
def main() -> None:
    """Run what is not there yet, print, write."""
    parser = _report.parser("paper", __doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, two seeds: minutes instead of hours")
    parser.add_argument("--only", nargs="+", choices=TABLES, metavar="TABLE", help=f"of {', '.join(TABLES)}")
    parser.add_argument("--show", action="store_true", help="run nothing: print and write what is there")
    parser.add_argument("--seeds", nargs="+", type=int, metavar="N", help="only these, from 0 (all)")
    parser.add_argument("--fresh", action="store_true", help="nothing of the results that came with the program")
    parser.add_argument("--ship", action="store_true", help="add what is there to the results that come with it")
    parser.add_argument("--folder", type=Path, default=Path("runs/paper"), help="of the results (runs/paper)")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the page there (docs/reports/paper.md)")
    asked = parser.parse_args()
    store = Store(asked.folder, QUICK if asked.quick else FULL, None if asked.fresh else RESULTS)
    seeds = range(store.size.seeds)
    if unknown := set(asked.seeds or ()) - set(seeds):
        raise ValueError(f"--seeds {min(unknown)}: the seeds of this size are 0 to {len(seeds) - 1}")
    if not asked.show:
        import torch
        from threadpoolctl import threadpool_limits

        torch.set_num_threads(1)
        threadpool_limits(1, "blas")
        for seed in asked.seeds or seeds:
            for module, function in (TABLES[name].split(".") for name in asked.only or TABLES):
                getattr(import_module(f"benchmarks.paper.{module}"), function)(store, seed)
    report.write(store, asked.report, asked.json)
    if asked.ship:
        for one in (store, store.own):
            print(f"wrote {one.ship(RESULTS)}", file=sys.stderr)


if __name__ == "__main__":
    main()
