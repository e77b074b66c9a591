# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim export_c --bench bench.yaml --out box_config.h: the configuration of a box in C."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from hydro_bridge.cli.console import command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_sim.box.box import BoxConfig, Integral
from hydro_sim.box.configuration import header, values
from hydro_sim.box.firmware import NAME
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="export_c", description="Write the configuration of a box in C from a bench file.", allow_abbrev=False
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument("--name", default=NAME, help="name and version that the box gives itself; default: %(default)s")
    parser.add_argument("--integral", choices=get_args(Integral), default="bumpless", help="default: %(default)s")
    return parser


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    config = BoxConfig(integral=options.integral).of_bench(bench)
    text = header(values(bench, config, Sensors(), options.name))
    write_whole(Path(options.out), text.encode())
    print(f"{options.out}: box {options.name}, bench {bench.digest}")
