# SPDX-License-Identifier: Apache-2.0
"""Trains a policy on whichever plant publishes /hydro/state.

ros2 run hydro_policy trainer --plant emulator --episodes 8 --evaluate
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from hydro_bridge.arguments import parameter_words, ros_arguments
from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.ros.node import running_ros
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.cli.console import command, explicit_options, make_parser
from hydro_policy.nodes.plant_options import SCRATCH, add_plant_options, apply_site, restore_options
from hydro_policy.pretraining.configurations import CONFIGURATIONS
from hydro_policy.runs.run_directory import RunDirectory

DEMO_OPTIONS = {"plant": "emulator", "configuration": "wide", "episodes": 6, "exam_every": 3, "evaluate": True}
"""Options of --demo: a short training on the emulator over the serial link, recorded and evaluated, in 5 minutes."""

EPILOG = """\
examples:
  ros2 run hydro_policy trainer --demo                         a short training on the emulator, evaluated: 5 minutes
  ros2 run hydro_policy trainer --plant emulator --evaluate    the paper's 160 episodes: 70 minutes of bench time
  ros2 run hydro_policy trainer --plant bench --port /dev/ttyUSB0
  ros2 run hydro_policy trainer --resume runs/NAME             goes on after Ctrl-C, an error or a power cut
every setting is a ROS parameter, too: --ros-args -p sac.gamma:=0.98 -p task.steps_per_episode:=900
(training.md explains them). Ctrl-C disarms, writes a checkpoint and ends.
"""


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = make_parser("trainer", __doc__, epilog=EPILOG)
    result.add_argument("--demo", action="store_true", help="the main job: see the examples")
    add_plant_options(result)
    run = result.add_argument_group("run")
    run.add_argument(
        "--from",
        dest="start",
        type=Path,
        metavar="RUN",
        help=f"an agent to start from: a run's folder, or {SCRATCH} (default: the one pretrained in simulation)",
    )
    run.add_argument("--episodes", type=int, metavar="N", help="episodes of 18 s in all (default 160, the paper's)")
    run.add_argument(
        "--updates-per-step",
        type=float,
        metavar="N",
        help="gradient updates per policy step (default 1 from an agent, 8 from scratch)",
    )
    run.add_argument(
        "--configuration",
        choices=CONFIGURATIONS,
        help="paper: Table training_agent, K_p up to 90; wide: K_p up to 300 (default paper)",
    )
    run.add_argument("--exam-every", type=int, metavar="N", help="episodes between examinations, 0: none (default 4)")
    run.add_argument("--seed", type=int, metavar="N", help="of networks, exploration and references (default 0)")
    run.add_argument("--evaluate", action="store_true", help="afterwards compare the policy with fixed gains")
    files = result.add_argument_group("files")
    files.add_argument(
        "--runs", type=Path, default=Path("runs"), metavar="DIR", help="folder of all runs (default: runs)"
    )
    files.add_argument("--name", help="of the run's folder (default: date and time)")
    files.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="continue the run in this folder as it was begun, on the same plant unless you name one; --episodes, "
        "--updates-per-step, --exam-every and ROS parameters may change, and hold from now on",
    )
    files.add_argument("--no-record", dest="record", action="store_false", help="make no recording")
    return result


def parse_options(words: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; --demo changes the defaults."""
    result = parser()
    if result.parse_args(words).demo:
        result.set_defaults(**DEMO_OPTIONS)
    options = result.parse_args(words)
    if options.resume is not None:
        restore_options(result, RunDirectory(options.resume), explicit_options(parser(), words))
        options = result.parse_args(words)
    apply_site(options)
    return options


@command(ValueError, FileExistsError, CompanionError, NotReadyError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parse_options([*parameter_words(parser(), "trainer", ros), *own])
    options.configuration = options.configuration or "paper"
    from hydro_policy.nodes.training import train  # with numba, which takes a second: not for --help or a slip

    with running_ros(ros):
        return train(options)
