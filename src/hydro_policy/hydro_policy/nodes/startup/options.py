# SPDX-License-Identifier: Apache-2.0
"""Options shared by trainer and evaluate."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from rclpy.node import Node

from hydro_bridge.ros.companion import add_dashboard_option
from hydro_bridge.ros.node import declare_parameters
from hydro_bridge.safety.pace import parse_pace
from hydro_core.cli.console import UserError
from hydro_core.files import site
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.nodes.startup.companions import PLANTS, PlantOptions
from hydro_policy.runs.run import TrainingSettings

T = TypeVar("T")

LAWS = ("both", "paper", "compensated")
"""Values of `evaluate --law`."""

SCRATCH = "scratch"
"""Value of `--from` for no agent, besides a run's folder."""

_PLANT_WORDS = (
    "plant",
    "port",
    "truth",
    "faults",
    "pace",
    "bench",
    "load_cell",
    "model",
    "base_gains",
    "filter",
    "rearm",
)
_NEEDS = {
    "hand_over": ("external",),
    "truth": ("emulator",),
    "faults": ("emulator",),
    "pace": ("sim", "emulator"),
    "port": ("bench", "emulator"),
    "model": ("sim",),
    "base_gains": ("sim", "bench"),
    "filter": ("sim", "emulator", "bench"),
}


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options about the plant and its companion processes."""
    group = parser.add_argument_group("plant")
    group.add_argument(
        "--plant",
        choices=PLANTS,
        default="external",
        help="start the other nodes, too: sim (sim with filter, recorder), emulator (emulator, bridge with filter, "
        "recorder), bench (bridge with filter, recorder), or external: they run already (default)",
    )
    group.add_argument("--port", metavar="PATH", help="serial port of the bench (default: the bridge's)")
    group.add_argument("--truth", type=Path, metavar="FILE", help="YAML of what the emulated bench is made of")
    group.add_argument("--faults", metavar="FILE", help="link faults of the emulator, a file or a preset")
    group.add_argument(
        "--pace",
        metavar="PACE",
        help="of sim or emulator: plant (default): its clock waits for the graph's answers, as fast as they come, and "
        "a run is a function of its seed; real: real time; a number: that many times real time",
    )
    group.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml (default: the nominal bench)")
    site.add_site_option(group, "--bench, --base-gains and --filter, of --model where --plant is sim")
    group.add_argument(
        "--load-cell",
        type=Path,
        metavar="FILE",
        help="bench file or corrected.yaml: under the compensated law the force in front of this load cell's amplifier "
        "follows the reference (default: the measured force does)",
    )
    group.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="bench file that sim simulates, while the box keeps to --bench; the filter's is "
        'its own word: --filter="--model FILE --metric FILE"',
    )
    group.add_argument(
        "--base-gains",
        nargs=2,
        type=float,
        metavar=("KP", "KI"),
        help="of the box (default: 15 5, the paper's); those of a plant that runs already are asked for",
    )
    group.add_argument(
        "--filter",
        default="",
        metavar="WORDS",
        help='further words for the filter that is started, in one string: --filter="--contraction-rate 2"; none: no '
        "filter, for the compensated law",
    )
    group.add_argument(
        "--rearm",
        choices=("auto", "ask"),
        help="who arms: auto (default with sim and emulator), or you on purpose (otherwise), by Enter or `arm`",
    )
    group.add_argument(
        "--hand-over",
        metavar="NODE",
        help="when all is done hand an external plant to this node, which waits for it; a run that is stopped does not",
    )
    add_dashboard_option(group)


def plant_options_as_yaml(options: argparse.Namespace) -> dict[str, Any]:
    """Return the plant options as stored in YAML, with absolute paths."""
    words = {name: getattr(options, name) for name in _PLANT_WORDS}
    return {
        name: value if isinstance(value, list) else str(Path(value).absolute() if os.path.exists(value) else value)
        for name, value in words.items()
        if value
    }


def restore_plant_options(result: argparse.ArgumentParser, plant: dict[str, Any], said: Mapping[str, Any]) -> None:
    """Make a run's original plant options, `plant`, the defaults, unless another plant is requested."""
    if said.get("plant", plant.get("plant")) != plant.get("plant"):
        return
    words = {name: value for name, value in plant.items() if name in _PLANT_WORDS}
    result.set_defaults(
        **{n: Path(v) if n in ("truth", "bench", "load_cell", "model") else v for n, v in words.items()}
    )


def take_site(options: argparse.Namespace) -> None:
    """Set the options that --site takes the place of (raises UserError)."""
    files = {} if options.plant == "external" else {"filter": f"--model {site.MODEL} --metric {site.METRIC}"}
    site.apply_site_option(
        options, bench=site.BENCH, **files, **({"model": site.MODEL} if options.plant == "sim" else {})
    )
    if options.site and not options.base_gains and options.plant in _NEEDS["base_gains"]:
        options.base_gains = site.base_gains(options.site)


def load_cell(options: argparse.Namespace) -> LoadCell | None:
    """Return the load cell of --load-cell.

    Raises UserError: the compensated law is not to run; ValueError, OSError: as `LoadCell.load`.
    """
    if options.load_cell is None:
        return None
    if getattr(options, "law", LAWS[0]) == "paper":
        raise UserError("--load-cell is of no use with --law paper")
    return LoadCell.load(options.load_cell)


def may_rearm(options: argparse.Namespace) -> bool:
    """Return whether the session may arm the plant without a person."""
    return bool((options.rearm or ("auto" if options.plant in ("sim", "emulator") else "ask")) == "auto")


def plant_options(options: argparse.Namespace, **more: Any) -> PlantOptions:
    """Return the plant options from the command line; `more` are further fields.

    Raises UserError: an option that does not apply to this plant: refused rather than ignored; SettingsError: --pace.
    """
    for name, plants in _NEEDS.items():
        if getattr(options, name) and options.plant not in plants:
            word = "--" + name.replace("_", "-")
            raise UserError(f"{word} is of no use with --plant {options.plant}; it goes with {' or '.join(plants)}")
    names = ("plant", "port", "truth", "faults", "bench", "model", "base_gains")
    words = tuple(shlex.split(options.filter))
    pace = options.pace or "plant"
    parse_pace(pace)
    return PlantOptions(**{name: getattr(options, name) for name in names}, filter=words, pace=pace, **more)


def declare_settings(node: Node, settings: TrainingSettings) -> TrainingSettings:
    """Declare all settings of a run as ROS parameters: episodes, sac.gamma, task.gains.delta_kp_max ..."""
    gains = declare_parameters(node, settings.task.gains, "task.gains.")
    task = replace(declare_parameters(node, settings.task, "task."), gains=gains)
    sac = declare_parameters(node, settings.sac, "sac.")
    exam = declare_parameters(node, settings.exam, "exam.")
    monitor = declare_parameters(node, settings.monitor, "monitor.")
    return replace(declare_parameters(node, settings), task=task, sac=sac, exam=exam, monitor=monitor)


def unless_said(node: Node, before: T, after: T, prefix: str = "") -> T:
    """Return the settings `after`, but what the user set as a parameter is as `before`."""
    kept: dict[str, Any] = {}
    for name in (field.name for field in fields(before)):  # type: ignore[arg-type]
        value = getattr(before, name)
        if is_dataclass(value):
            kept[name] = unless_said(node, value, getattr(after, name), f"{prefix}{name}.")
        elif f"{prefix}{name}" in node._parameter_overrides:  # rclpy: no public way
            kept[name] = value
    return replace(after, **kept)  # type: ignore[type-var]
