# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_policy pretrain: train the policy in simulation."""

from __future__ import annotations

from hydro_bridge.cli.console import command
from hydro_policy.pretraining.options import parser
from hydro_sim.files.weights import WeightsError


@command(ValueError, WeightsError)
def main() -> int:
    """Entry point."""
    options = parser().parse_args()
    from hydro_policy.pretraining.run import pretrain  # with torch, which takes seconds: not for --help or a slip

    return pretrain(options)


if __name__ == "__main__":
    main()
