# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim export --fmu bench.fmu --bench corrected.yaml: export a bench to other simulators."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from hydro_core.cli.console import UserError, command, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_sim.box.box import NAME, BoxConfig, Integral
from hydro_sim.box.header import render_header
from hydro_sim.export.model import ExportedModel
from hydro_sim.model.bench import Bench

FORMATS = {
    "fmu": (".fmu", "Functional Mock-up Unit, FMI 3.0: co-simulation, and model exchange where no effect forbids it"),
    "mujoco": (".py", "Python module: the cylinder as an actuator of MuJoCo"),
    "simulink": (".c", "Simulink S-function, level 2"),
    "c": (".c", "the model in C99"),
    "box": (".h", "configuration of a box in C (firmware/hydro/config.h), which no effect is part of"),
}


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    parser = argparse.ArgumentParser(
        prog="export",
        description="Write a bench for another program, its effects and closures with it. Input: valve current [A]. "
        "Outputs: hydraulic and load force, both pressures, piston position, as the sensors show them without noise.",
        allow_abbrev=False,
    )
    formats = parser.add_mutually_exclusive_group(required=True)
    for name, (suffix, text) in FORMATS.items():
        formats.add_argument(f"--{name}", type=writable_file, metavar=f"FILE{suffix}", help=text)
    parser.add_argument(
        "--bench", type=Path, metavar="FILE", help="bench.yaml, or corrected.yaml of `diagnose`, whose report.json "
        "beside it gives the intervals of the FMU's parameters; default: nominal",
    )  # fmt: skip
    parser.add_argument("--name", default=NAME, help="of --box: its name and version; default: %(default)s")
    parser.add_argument(
        "--integral", choices=get_args(Integral), default="bumpless", help="of --box; default: bumpless"
    )
    return parser


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    kind, out = next((name, Path(path)) for name in FORMATS if (path := getattr(options, name)))
    if out.suffix != FORMATS[kind][0]:
        raise UserError(f"{out}: a file of --{kind} ends in {FORMATS[kind][0]}")
    if kind != "box" and (options.name, options.integral) != (NAME, "bumpless"):
        raise UserError(f"--name and --integral go with --box, not with --{kind}")
    if not re.fullmatch(r"[\w .-]+", options.name, flags=re.ASCII):
        raise UserError(f"--name {options.name!r}: a box is named by letters, digits, spaces, _, . and -")
    name = re.sub(r"\W|^(?=\d)", "_", out.stem, flags=re.ASCII)
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    exported = ExportedModel(bench, read_intervals(options.bench) if options.bench else ())
    content: str | bytes
    if kind == "fmu":
        content = exported.fmu(name)
    elif kind == "simulink":
        if name != out.stem:
            raise UserError(f"{out}: the name of an S-function is made of letters, digits and _")
        content = exported.simulink(name)
    elif kind == "box":
        config = BoxConfig(integral=options.integral).of_bench(bench)
        content = render_header(config.constants(bench, name=options.name))
    else:
        content = exported.mujoco() if kind == "mujoco" else exported.c_source()
    write_atomic(out, content.encode() if isinstance(content, str) else content)
    print(f"{out}: bench {bench.digest}, {f'box {options.name}' if kind == 'box' else f'{len(bench.terms)} effects'}")
    if kind == "fmu" and exported.discrete_effects:
        print(f"co-simulation only: {', '.join(exported.discrete_effects)} move on by whole steps")


def read_intervals(bench: Path) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, value and 95 % interval of each estimate, from the report.json next to a corrected.yaml."""
    try:
        report = json.loads((bench.parent / "report.json").read_text(encoding="utf-8"))
        estimates: list[tuple[str, Any]] = [(one["name"], one) for one in report["estimated"]]
        for one in (*report["effects"], *report["closures"]):
            estimates += one.get("parameters", one.get("terms", {})).items()
        for name, estimate in estimates:
            if estimate["ci95"]:
                yield name, estimate["value"], *estimate["ci95"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return  # not a report of `diagnose`
