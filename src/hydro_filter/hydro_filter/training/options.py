# SPDX-License-Identifier: Apache-2.0
"""The command line of `learn_metric`, and which options may change on --resume."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydro_bridge.cli.console import add_json_argument, writable
from hydro_bridge.cli.resuming import refuse_changes

RESUME_HELP = (
    "go on from METRIC's checkpoint, if there is one, with what it was begun with; --epochs, --patience and --threads "
    "may change"
)
_FIXED = ("law", "rollouts", "contraction_rate", "unstable_weight", "batch", "learning_rate", "seed")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="learn_metric", description="Train the contraction metric on the learned bench."
    )
    result.add_argument(
        "--out", required=True, type=writable, metavar="METRIC", help="file to write, .safetensors; its curve beside it"
    )
    result.add_argument(
        "--model",
        metavar="FILE",
        help="bench file of the learned bench; the shipped one by default",
    )
    result.add_argument("--bench", metavar="FILE", help="bench.yaml that the box believes; the nominal one by default")
    result.add_argument(
        "--law", choices=("both", "paper", "compensated"), default="both",
        help="force law that the metric is for; a learned bench has the paper's alone. Default: %(default)s",
    )  # fmt: skip
    result.add_argument("--rollouts", type=int, default=160, help="rollouts of 3 s; every fifth is not trained on")
    result.add_argument("--contraction-rate", type=float, default=0.1, help="lambda [1/s]; the paper's 0.1")
    result.add_argument("--unstable-weight", type=float, default=0.02, help="of unstable samples beside stable ones")
    result.add_argument("--epochs", type=int, default=400, help="at most; 0: the solved metrics alone, as shipped")
    result.add_argument("--patience", type=int, default=40, help="epochs without a better validation before it stops")
    result.add_argument("--batch", type=int, default=1024, help="windows per step (Table training_metric)")
    result.add_argument(
        "--learning-rate", type=float, default=1e-4, help="of Adam; the paper's 1e-3 leaps away from solved metrics"
    )
    result.add_argument("--seed", type=int, default=0, help="of gains, references, noise, weights and shuffles")
    result.add_argument("--resume", action="store_true", help=RESUME_HELP)
    result.add_argument("--threads", type=int, default=0, help="cores to use; 0: all")
    add_json_argument(result)
    return result


def arguments(words: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; with --resume, the defaults are those of the checkpoint's training.

    Raises
    ------
    UserError
        The options of a resumed training contradict those it was started with.
    """
    asked = parser().parse_args(words)
    if asked.seed < 0 or asked.threads < 0:
        parser().error("--seed and --threads need 0 or more")
    checkpoint = Path(asked.out).with_suffix(".checkpoint")
    if not asked.resume:
        return asked
    if not checkpoint.exists():
        print(f"there is no {checkpoint}: the training begins at its beginning", file=sys.stderr)
        return asked
    from hydro_filter.training.training import saved_options  # with torch: not for --help or a slip

    before = saved_options(checkpoint)
    refuse_changes(parser(), words, str(checkpoint), before)
    return argparse.Namespace(**{**vars(asked), **before})


def fixed_options(asked: argparse.Namespace) -> dict[str, Any]:
    """Options that must not change on --resume: data, loss and optimizer; files as absolute paths."""
    files = {name: getattr(asked, name) and os.path.abspath(getattr(asked, name)) for name in ("model", "bench")}
    return {**{name: getattr(asked, name) for name in _FIXED}, **files}
