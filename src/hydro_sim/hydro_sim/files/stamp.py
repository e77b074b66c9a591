# SPDX-License-Identifier: Apache-2.0
"""Stamps older model, metric, policy and agent files with the box that they were made for.

ros2 run hydro_sim stamp FILE...                                       what they say
ros2 run hydro_sim stamp FILE... --bench own.yaml [--model FILE]    write what they were made with
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hydro_bridge.cli.console import Table, UserError, add_json_argument, command
from hydro_bridge.files.atomic import write_whole
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import MadeFor, made_for
from hydro_sim.files.stamping import header_of, stamped
from hydro_sim.model.bench import Bench

COLUMNS = {
    "file": "",
    "box": "digest of the bench.yaml that the box believed; empty: the file does not say",
    "model": "digest of the learned bench that was used",
    "base_kp": "1/s, of the box",
    "base_ki": "1/s^2, of the box",
    "integral": "",
    "any_bench": "whether it is for any bench",
}


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args(sys.argv[1:])
    made, table = _asked(options), Table(COLUMNS)
    for path in options.files:
        blob = path.read_bytes()
        try:
            header = header_of(blob)
            if made is not None:
                write_whole(path, stamped(blob, made))
        except ValueError as error:
            raise UserError(f"{path} is no model, metric, policy or agent: {error}") from error
        said = made or made_for(header)
        table.add(file=str(path), **(MadeFor(box="") if said is None else said).to_header())
    table.show(options.json)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="stamp", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("files", nargs="+", type=Path, metavar="FILE", help="safetensors files of ours")
    result.add_argument("--bench", metavar="FILE|nominal", help="bench.yaml that the box believed: write it into them")
    result.add_argument("--model", metavar="FILE|shipped", help="bench file of the learned bench that was used")
    result.add_argument(
        "--base-gains", nargs=2, type=float, metavar=("KP", "KI"), help="of the box; policies and agents have them"
    )
    result.add_argument("--integral", choices=("bumpless", "paper"), default="", help="form of the law's integral")
    add_json_argument(result)
    return result


def _asked(options: argparse.Namespace) -> MadeFor | None:
    """The stamp to write; None: only show."""
    if not options.bench:
        if options.model or options.base_gains or options.integral:
            raise UserError("a stamp needs --bench: what the box believed")
        return None
    bench = Bench.nominal() if options.bench == "nominal" else Bench.load(options.bench)
    kp, ki = options.base_gains or (None, None)
    return MadeFor(
        box=bench.digest, model=_digest(options.model), base_kp=kp, base_ki=ki,
        integral=options.integral,
    )  # fmt: skip


def _digest(model: str | None) -> str:
    """Digest of the learned bench that was used; empty: none was."""
    return learned_bench.digest(None if model == "shipped" else model) if model else ""
