# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter learn_metric --out METRIC: solve the contraction metric of a learned bench.

Rolls out, labels, solves a metric for each gain, and evaluates it on held-out rollouts. The result depends on the
command's arguments alone.
"""

from __future__ import annotations

import argparse

from hydro_bridge.bags.recording import RecordingError
from hydro_core.cli.console import add_json_argument, command, writable_file
from hydro_sim.files.weights import WeightsError


@command(WeightsError, RecordingError, ValueError)
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="learn_metric", description="Solve the contraction metric of the learned bench."
    )
    parser.add_argument(
        "--out", required=True, type=writable_file, metavar="METRIC", help="file to write, .safetensors"
    )
    parser.add_argument("--model", metavar="FILE", help="bench file of the learned bench; the shipped one by default")
    parser.add_argument("--bench", metavar="FILE", help="bench.yaml that the box believes; the nominal one by default")
    parser.add_argument(
        "--recording", metavar="BAG",
        help="recording of the box, whose compensated law it told; by default that of the emulator for this bench",
    )  # fmt: skip
    parser.add_argument(
        "--law", choices=("both", "paper", "compensated"), default="both",
        help="force law that the metric is for; a learned bench has the paper's alone. Default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--rollouts", type=int, default=160, help="rollouts of 3 s; every fifth judges")
    parser.add_argument("--seed", type=int, default=0, help="of gains, references and noise")
    add_json_argument(parser)
    options = parser.parse_args()
    if options.seed < 0:
        parser.error("--seed needs 0 or more")
    from hydro_filter.training.metric_learning import learn_metric  # with compiled code: not for --help or a slip

    learn_metric(options)
