# SPDX-License-Identifier: Apache-2.0
"""The filter's command line: metric, model and settings."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from hydro_bridge.settings import describe
from hydro_filter.controller.factory import CONSTANT, DEFAULT, LEARNED, FilterChoice, Settings
from hydro_filter.controller.filter import FilterSettings
from hydro_filter.controller.loop_filter import LoopFilterSettings
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.model.bench import Bench

NUMBERS = ("contraction_rate", "foreign_rate", "noise_share", "innovation_limit", "noise_floor", "state_age_max")
"""Settings that are options, too; each metric has some of them."""


def parser() -> argparse.ArgumentParser:
    """Build the parser; its options and the ROS parameters of the same names have the same meaning."""
    result = argparse.ArgumentParser(
        prog="filter", description="Contraction filter: /hydro/state to /hydro/correction."
    )
    result.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml; default: the nominal bench")
    text = f"{LEARNED} (the shipped one), {CONSTANT} (solved for the bench file, on the analytic model), or a file"
    result.add_argument("--metric", default=DEFAULT, metavar="METRIC", help=f"{text}; default {DEFAULT}")
    result.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="bench file of the learned bench; default: the shipped one",
    )
    for name in NUMBERS:
        docs = {
            kind: describe(kind)[name].text for kind in (LoopFilterSettings, FilterSettings) if name in describe(kind)
        }
        text = "; with the constant metric: ".join(dict.fromkeys(docs.values()))
        if list(docs) == [FilterSettings]:
            text += "; of the constant metric"
        result.add_argument("--" + name.replace("_", "-"), type=float, metavar="NUMBER", help=text)
    result.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="N",
        help="answer every Nth sample, by the constant metric; 10 is 100 Hz. A plant lets a correction act for "
        "guard.correction_hold (0.003 s): set it to N ms there",
    )
    result.add_argument("--bypass", action="store_true", help=describe(FilterSettings)["bypass"].text)
    result.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if permitted")
    return result


def arguments(given: list[str]) -> tuple[FilterChoice, Settings, argparse.Namespace]:
    """Parse the command line into the filter choice, its settings, and the remaining options.

    Raises
    ------
    PairingError
        Metric, model and bench do not belong together.
    """
    asked = parser().parse_args(given)
    if asked.every < 1:
        parser().error("--every needs 1 or more")
    if asked.every > 1 and asked.metric != CONSTANT:
        parser().error(
            f"--every {asked.every} needs --metric constant: the learned metric certifies a correction for one sample"
        )
    if asked.metric == CONSTANT and asked.model:
        parser().error("the constant metric is solved for the bench file; --model needs a learned one")
    bench = Bench.load(asked.bench) if asked.bench else Bench.nominal()
    choice = FilterChoice(bench=bench, bench_file=asked.bench, metric=asked.metric, model=asked.model)
    settings = choice.default_settings()
    numbers = {name: value for name in NUMBERS if (value := getattr(asked, name)) is not None}
    for name in numbers:
        if name not in describe(type(settings)):
            parser().error(f"--{name.replace('_', '-')} is no setting of this metric")
    raise_if_mismatched(choice.trouble())
    return choice, replace(settings, bypass=asked.bypass, **numbers), asked
