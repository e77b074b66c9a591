# SPDX-License-Identifier: Apache-2.0
"""The filter's command line: metric, model and settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_bridge.files import site
from hydro_bridge.settings import describe
from hydro_filter.controller.factory import LEARNED, FilterChoice
from hydro_filter.controller.loop_filter import LoopFilterSettings
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.model.bench import Bench

NUMBERS = ("contraction_rate", "foreign_rate", "noise_share", "innovation_limit", "state_age_max")
"""Settings that are options, too."""


def parser() -> argparse.ArgumentParser:
    """Build the parser; its options and the ROS parameters of the same names have the same meaning."""
    result = argparse.ArgumentParser(
        prog="filter", description="Contraction filter: /hydro/state to /hydro/correction."
    )
    result.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml; default: the nominal bench")
    result.add_argument("--metric", metavar="FILE", help=f"of `learn_metric`; default: {LEARNED}, the shipped one")
    result.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="bench file that the metric was made for; default: the shipped one",
    )
    site.add_site_option(result, "--bench, --metric and --model")
    docs = describe(LoopFilterSettings)
    for name in NUMBERS:
        result.add_argument("--" + name.replace("_", "-"), type=float, metavar="NUMBER", help=docs[name].text)
    result.add_argument("--bypass", action="store_true", help=docs["bypass"].text)
    result.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if permitted")
    return result


def arguments(given: list[str]) -> tuple[FilterChoice, LoopFilterSettings, argparse.Namespace]:
    """Parse the command line into the filter choice, its settings, and the remaining options.

    Raises PairingError: metric, model and bench do not belong together.
    """
    asked = parser().parse_args(given)
    site.take_site(asked, bench=site.BENCH, metric=site.METRIC, model=site.MODEL)
    bench = Bench.load(asked.bench) if asked.bench else Bench.nominal()
    choice = FilterChoice(bench=bench, bench_file=asked.bench, metric=str(asked.metric or LEARNED), model=asked.model)
    numbers = {name: value for name in NUMBERS if (value := getattr(asked, name)) is not None}
    raise_if_mismatched(choice.trouble())
    return choice, LoopFilterSettings(bypass=asked.bypass, **numbers), asked
