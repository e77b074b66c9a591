# SPDX-License-Identifier: Apache-2.0
"""Train the policy in simulation: 160 episodes of 18 s on many benches at once, in some three minutes.

ros2 run hydro_policy pretrain --out runs/pretrained
ros2 run hydro_policy pretrain --out runs/wide --configuration wide
ros2 run hydro_policy pretrain --out runs/own --site own
ros2 run hydro_policy trainer --plant emulator --from runs/pretrained
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from hydro_core.cli.console import add_json_argument, command, make_parser, writable_folder
from hydro_core.files import site
from hydro_policy.envs import FILTERS
from hydro_policy.pretraining.configurations import CONFIGURATIONS
from hydro_sim.box.box import Integral


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = make_parser("pretrain", __doc__)
    where = result.add_mutually_exclusive_group(required=True)
    where.add_argument("--out", type=writable_folder, metavar="RUN", help="folder of a new run")
    where.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="go on with a run as it was begun, after Ctrl-C, or with more --episodes",
    )
    what = result.add_argument_group("what is simulated")
    what.add_argument(
        "--model",
        metavar="shipped|analytic|FILE",
        help="the learned bench that comes with hydro_sim, the nominal one, or a bench file, a diagnosis' "
        "corrected.yaml for instance (default: shipped)",
    )
    what.add_argument("--box", metavar="FILE", help="bench.yaml that the box believes in (default: the nominal bench)")
    what.add_argument(
        "--base-gains", nargs=2, type=float, metavar=("KP", "KI"), help="of the box (default: 15 5, the paper's)"
    )
    site.add_site_option(what, "--model, --box and --base-gains")
    what.add_argument(
        "--randomise", action="store_true", help="another bench every episode: docs/manual/how-to/pretrain.md"
    )
    what.add_argument(
        "--filter", choices=FILTERS, default="none", help="the filter between policy and box (default: none)"
    )
    what.add_argument(
        "--integral", choices=get_args(Integral), default="bumpless", help="of the box's force law (default: bumpless)"
    )
    how = result.add_argument_group("how")
    how.add_argument(
        "--configuration", choices=CONFIGURATIONS, default="paper", help="see docs/manual/how-to/pretrain.md"
    )
    how.add_argument("--episodes", type=int, metavar="N", help="default 160")
    how.add_argument("--hidden", type=int, metavar="N", help="units in each of the two hidden layers, default 32")
    how.add_argument("--steps", type=int, metavar="N", help="policy steps of 10 ms in an episode, default 1800")
    how.add_argument("--updates-per-step", type=float, metavar="X", help="default 1")
    how.add_argument("--benches", type=int, default=8, metavar="N", help="side by side, default 8")
    how.add_argument("--seed", type=int, default=0, metavar="N", help="of everything that is drawn; default 0")
    add_json_argument(result)
    return result


@command(ValueError, FileExistsError, FloatingPointError)
def main() -> int:
    """Entry point."""
    options = parser().parse_args()
    site.apply_site_option(options, model=site.MODEL_FILE, box=site.BENCH_FILE)
    if options.site and not options.base_gains:
        options.base_gains = site.base_gains(options.site)
    from hydro_policy.pretraining.run import pretrain  # it compiles: not for --help or a slip

    return pretrain(options)


if __name__ == "__main__":
    main()
