# SPDX-License-Identifier: Apache-2.0
"""Force RMSE of policies and fixed gains on sines, of 300 N on the nominal bench, on whichever plant publishes states.

ros2 run hydro_policy evaluate --plant emulator --policy runs/NAME --fixed 90 15 --fixed 15 5
ros2 run hydro_policy evaluate --plant emulator --policy runs/NAME --fixed 90 15 --grid --multisine --steps --repeats 5
ros2 run hydro_policy evaluate --plant emulator --law compensated --load-cell corrected.yaml
ros2 run hydro_policy evaluate --plant emulator --law compensated --fast --recorded ElCentroAccelNoScaling.mat
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.ros.node import running_ros
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.cli.console import command, make_parser, writable_file, writable_folder
from hydro_policy.nodes.plant_options import LAWS, add_plant_options, apply_site


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = make_parser("evaluate", __doc__)
    add_plant_options(result)
    what = result.add_argument_group("what")
    what.add_argument(
        "--policy",
        type=Path,
        action="append",
        default=[],
        metavar="RUN|FILE",
        help="a run's folder or a policy.safetensors",
    )
    what.add_argument(
        "--fixed",
        type=float,
        nargs=2,
        action="append",
        metavar=("KP", "KI"),
        help="fixed gains under the paper's law (default: 90 15 and 15 5; none with --law compensated)",
    )
    what.add_argument(
        "--law",
        choices=LAWS,
        default=LAWS[0],
        help="both (default): besides policies and fixed gains the box's compensated law with its base gains, its "
        "coefficients fitted in each run, from (1, 0.02 s, 1e-4 s2, 0 N), if the box has that law; compensated: as "
        "both, and refused without it; paper: not that one",
    )
    what.add_argument(
        "--learned-residual",
        action="store_true",
        help="the compensated law with the learned residual on top, too (explanation/training.md)",
    )
    what.add_argument(
        "--grid",
        action="store_true",
        help="find the best fixed gains on the plant first, coarse to fine, and compare them, too",
    )
    what.add_argument("--kp-max", type=float, default=300.0, metavar="KP", help="of the grid (default 300)")
    what.add_argument("--multisine", action="store_true", help="a multisine, too")
    what.add_argument("--steps", action="store_true", help="smooth steps, too")
    what.add_argument("--fast", action="store_true", help="sines of 5 Hz, 100 N, and 10 Hz, 50 N, too")
    what.add_argument(
        "--recorded",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="recorded references, scaled to 300 N, too, up to 20 s of each: CSV of time [s] and value, .mat, or a bag",
    )
    what.add_argument("--frequencies", type=float, nargs="+", metavar="HZ", help="default: 0.5 1 1.5 2")
    what.add_argument("--repeats", type=int, metavar="N", help="runs of each at each frequency (default 1)")
    what.add_argument("--seed", type=int, default=0, metavar="N", help="of the noise of simulation or emulator")
    files = result.add_argument_group("files")
    files.add_argument(
        "--runs", type=writable_folder, default="runs", metavar="DIR", help="folder of all runs (default: runs)"
    )
    files.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="go on with the interrupted evaluation in this folder, by the same options: only trials that are missing "
        "are made",
    )
    files.add_argument("--name", help="of this one's folder: figures, plot, page, recording (default: date and time)")
    files.add_argument("--json", type=writable_file, metavar="FILE", help="write every run's figures to FILE, too")
    files.add_argument("--no-record", dest="keeps_bag", action="store_false", help="make no recording")
    return result


@command(ValueError, FileExistsError, CompanionError, NotReadyError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    apply_site(options)
    from hydro_policy.nodes.evaluation import evaluate  # with compiled code: not for --help or a wrong option

    with running_ros(ros):
        return evaluate(options)
