# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter export_c --metric M --bench bench.yaml --out filter_config.h: a filter's numbers for C.

Of the constant metric (the default here) for firmware/hydro/filter.h, whose decision is that of `ContractionFilter`; of
the learned one, the graph's default, for firmware/hydro/loop_filter.h (`loop_header`), whose is `loop_decision.decide`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hydro_bridge.cli.console import command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.settings import check
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.controller import loop_header
from hydro_filter.controller.factory import CONSTANT, FilterChoice
from hydro_filter.controller.filter import ContractionFilter, FilterSettings
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_parts
from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_filter.model.force_law import ForceLaw
from hydro_filter.model.state import LOAD_FORCE, STATES
from hydro_sim.box.c_text import header_file, reals
from hydro_sim.box.configuration import BENCH_FIELDS
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

MOST_STROKE, MOST_FORCE = 0.9, 1e5
"""m and N: `hydro_conceivable` of firmware/hydro/filter.h, with room for what an encoder shows beyond the stroke."""


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    usual = FilterSettings()
    parser = argparse.ArgumentParser(
        prog="export_c",
        description="Write a filter's numbers for a box in C: of the constant metric for firmware/hydro/filter.h, "
        "of the learned one for firmware/hydro/loop_filter.h.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--metric", default=CONSTANT, metavar="constant|learned|FILE", help="of `learn_metric`; default: %(default)s"
    )
    parser.add_argument("--model", type=Path, metavar="FILE", help="bench file of `learn`; default: the shipped one")
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument(
        "--contraction-rate", type=float, metavar="1/s",
        help=f"default: {usual.contraction_rate:g}; of the learned metric that for gains of the certified range",
    )  # fmt: skip
    parser.add_argument(
        "--noise-floor", type=float, metavar="N", help=f"default: {usual.noise_floor:g}; of the constant metric only"
    )
    return parser


def header(certificate: Certificate, bench: Bench) -> str:
    """Return the header that defines `HYDRO_FILTER`: a constant metric's certificate for a bench."""
    numbers, metric = bench.constants()[0], certificate.metric.matrix(np.zeros(STATES))
    lines = [
        "    .bench = {",
        *(f"        .{field} = HYDRO_R({float(numbers[field])!r})," for field in BENCH_FIELDS),
        "    },",
        f"    .gain_floor = HYDRO_R({float(ForceLaw(bench).gain_floor)!r}),",
        f"    .metric = {reals(metric[:, LOAD_FORCE])},",
        f"    .scale = {reals(certificate.scale)},",
        f"    .contraction_rate = HYDRO_R({float(certificate.contraction_rate)!r}),",
        f"    .noise_floor = HYDRO_R({float(certificate.noise_floor)!r}),",
    ]
    body = '#include "hydro/filter.h"\n\nstatic const hydro_filter HYDRO_FILTER = {\n' + "\n".join(lines) + "\n};"
    origin = f"Written by `ros2 run hydro_filter export_c` for the bench {bench.digest}, constant metric."
    return header_file("HYDRO_FILTER_CONFIG_H", origin, body)


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    choice = FilterChoice(bench=bench, bench_file=options.bench, metric=options.metric, model=options.model)
    _conceivable(bench)
    text = _constant(choice, options) if choice.constant else _learned(choice, options)
    write_whole(Path(options.out), text.encode())
    print(f"{options.out}: {options.metric} metric for bench {bench.digest}")


def _conceivable(bench: Bench) -> None:
    """Refuse a bench whose samples `hydro_conceivable` (firmware/hydro/filter.h) would reject as implausible."""
    force = bench.supply_pressure * bench.piston_area
    if bench.stroke > MOST_STROKE or force > MOST_FORCE:
        raise ValueError(
            f"the filters in C are for strokes to {MOST_STROKE:g} m and forces to {MOST_FORCE:g} N; this bench has "
            f"{bench.stroke:g} m and {force:g} N (supply pressure times piston area): they would correct nothing"
        )


def _constant(choice: FilterChoice, options: argparse.Namespace) -> str:
    if choice.model is not None:
        raise ValueError("--model: the constant metric has none, it keeps to the bench file")
    usual, rate, floor = FilterSettings(), options.contraction_rate, options.noise_floor
    settings = FilterSettings(
        contraction_rate=usual.contraction_rate if rate is None else rate,
        noise_floor=usual.noise_floor if floor is None else floor,
    )
    check(settings)
    return header(ContractionFilter.for_bench(choice.bench, settings).certificate, choice.bench)


def _learned(choice: FilterChoice, options: argparse.Namespace) -> str:
    if options.noise_floor is not None:
        raise ValueError("--noise-floor: a learned metric brings its own level of the noise")
    if trouble := choice.trouble():
        raise ValueError(trouble)
    usual, rate = LoopFilterSettings(), options.contraction_rate
    settings = LoopFilterSettings(contraction_rate=usual.contraction_rate if rate is None else rate)
    files = choice.files
    truth = load_model(files["model"])
    parts = loop_parts(ScheduledMetric.load(files["metric"]), truth, choice.bench, settings)
    told = ", ".join(f"{name} {word}" for name, word in choice.describe().items())
    return loop_header.header(
        parts, truth, f"Written by `ros2 run hydro_filter export_c` for the bench {choice.bench.digest}: {told}."
    )
