# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter learn_metric --out METRIC: train the contraction metric on a learned bench.

Rolls out, labels, solves a metric for each gain, trains the network on top, and judges on rollouts not trained on.
Ctrl-C keeps the checkpoint beside METRIC; `--resume` goes on from it. Data and training depend on nothing but the
words of the command.
"""

from __future__ import annotations

import sys

from hydro_bridge.cli.console import command
from hydro_filter.training.options import arguments
from hydro_sim.files.weights import WeightsError


@command(WeightsError, ValueError)
def main() -> None:
    """Entry point."""
    options = arguments(sys.argv[1:])
    from hydro_filter.training.metric_learning import learn  # with torch, which takes seconds: not for --help or a slip

    learn(options)
