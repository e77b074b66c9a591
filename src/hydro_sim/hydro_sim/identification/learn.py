# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim learn BAG... --out BENCH.yaml: fit a bench file's effects to recordings and write the result."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import yaml

from hydro_core.cli.console import Table, UserError, add_json_argument, bounded_number, command, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_sim.files import recordings
from hydro_sim.files.learned_bench import BENCH_FILES
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import bench_learning
from hydro_sim.model.bench import Bench

COLUMNS = {
    "parameter": "", "before": "in the bench file", "learnt": "",
    "low": "of its 95 % interval, as far as the model is whole", "high": "", "unit": "",
    "seen": "whether the recordings say more of it than the bench file",
}  # fmt: skip


@command(DataError, ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    if Path(options.out).suffix not in BENCH_FILES:
        raise UserError(f"--out {options.out}: a bench file's name ends in {' or '.join(BENCH_FILES)}")
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    data = recordings.split(recordings.load_states(options.bags))
    result = bench_learning.learn(
        bench, data, count=options.windows, seed=options.seed, report=lambda text: print(text, file=sys.stderr)
    )
    table = Table(COLUMNS, title="parameters of the bench file's effects")
    for one in result.parameters:
        table.add(
            parameter=one.name, before=one.before, learnt=one.value, low=one.low, high=one.high, unit=one.unit,
            seen="yes" if one.informed else "no",
        )  # fmt: skip
    table.show(options.json)
    lines = [
        "bench.yaml with its effects' parameters learnt by `ros2 run hydro_sim learn`; SI units.",
        result.quality.sentence(),
        *(f"from {name}, samples {digest[:12]}" for name, digest in data.digests.items()),
        *(f"{one.name}: 95 % within {one.low:.6g} and {one.high:.6g} {one.unit}" for one in result.parameters),
    ]
    head = "".join(f"# {line}\n" for line in lines)
    content = yaml.safe_dump(result.with_quality().to_mapping(), sort_keys=False)
    Path(options.out).parent.mkdir(parents=True, exist_ok=True)
    write_atomic(Path(options.out), (head + content).encode())
    print(f"{options.out}: {result.quality.sentence()}")


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    result = argparse.ArgumentParser(
        prog="learn",
        description="Fit the parameters of a bench file's effects and closures to recordings, so that predictions of "
        "70 samples fit. The file that is written is a model for `sim`, the filter and the training commands.",
    )
    result.add_argument("bags", nargs="+", metavar="BAG", help="recordings; of three or more the last one validates")
    result.add_argument("--out", required=True, type=writable_file, metavar="FILE", help="bench file to write, .yaml")
    result.add_argument(
        "--bench", metavar="FILE",
        help="bench file to start from, such as corrected.yaml of `diagnose`; the shipped one by default. Where it "
        "names no effects the usual ones are learned: valve, supply, oil, spring, friction, leak, load cell",
    )  # fmt: skip
    result.add_argument("--windows", type=bounded_number(1), default=120,
                        help="predictions that it is learnt from (120)")  # fmt: skip
    result.add_argument("--seed", type=bounded_number(0), default=0, help="of the choice of predictions (0)")
    add_json_argument(result)
    return result
