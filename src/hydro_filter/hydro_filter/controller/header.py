# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter export_c --bench bench.yaml --out loop_filter_config.h: a filter's numbers for a box in C.

For firmware/hydro/loop_filter.h, whose decision is that of `loop_decision.decide`: the bench file's two models, as
generated C with their coefficients, and the metric's table.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from math import exp
from pathlib import Path
from typing import Any

from hydro_core.cli.console import command, writable
from hydro_core.files.atomic import write_whole
from hydro_core.signals import SAMPLE_PERIOD
from hydro_filter.controller.factory import LEARNED, FilterChoice
from hydro_filter.controller.loop_decision import LoopParts
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_parts
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import SUBSTEPS, closing_current, without_disturbances
from hydro_filter.model.overlap import Overlap
from hydro_filter.model.parts import NONE, Loop
from hydro_sim.box.firmware import BENCH_FIELDS
from hydro_sim.box.header import header_file, initializer, wrapped
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.source import embedded_source

MOST_STROKE, MOST_FORCE = 0.9, 1e5
"""m and N: `hydro_conceivable` of loop_filter.h, with room for what an encoder shows beyond the stroke."""
MOST_STATES = 16
"""HYDRO_STATES of firmware/hydro/loop.h."""


def header(parts: LoopParts, truth: Bench, origin: str) -> str:
    """Return the header that defines `HYDRO_LOOP_FILTER`, of the filter on the bench file `truth`.

    Raises ValueError: the box in C has no place for an effect of the bench file; the message is one sentence.
    """
    metric = parts.metric
    _refuse(parts)
    rows, table = len(metric.gains), metric.table
    step = metric.gains[1] - metric.gains[0] if rows > 1 else 1.0
    kept, foreign_kept = (exp(-2.0 * rate * SAMPLE_PERIOD) for rate in (parts.rate, parts.foreign_rate))
    reals = {
        "gain_low": metric.gains[0], "gain_high": metric.gains[-1], "gain_step": step, "floor": metric.floor,
        "kept": kept, "foreign_kept": foreign_kept, "noise_size": parts.noise_size,
        "foreign_noise_size": parts.foreign_noise_size, "integral_allowance": parts.integral_allowance,
    }  # fmt: skip
    numbers = {name: float(number) for name, number in reals.items()}
    members = {"loop": _loop(parts.loop, truth), "table": "HYDRO_LOOP_TABLE", "rows": rows, **numbers}
    lines = [
        '#include "hydro/loop_filter.h"\n',
        embedded_source(BenchModel(truth, substeps=SUBSTEPS).symbols(), SUBSTEPS, "hydro_whole", jacobian=False),
        embedded_source(
            BenchModel(without_disturbances(truth), substeps=SUBSTEPS).symbols(), SUBSTEPS, "hydro_linear",
            jacobian=True,
        ),
        *_arrays(parts.loop),
        f"static const hydro_real HYDRO_LOOP_TABLE[{rows + 1}][HYDRO_FACTOR] = {{",
        *("    {\n" + wrapped(map(initializer, row), indent=" " * 8) + "\n    }," for row in table),
        "};\n",
        f"static const hydro_loop_filter HYDRO_LOOP_FILTER = {initializer(members)};",
    ]  # fmt: skip
    return header_file("HYDRO_LOOP_FILTER_CONFIG_H", origin, "\n".join(lines))


def _refuse(parts: LoopParts) -> None:
    """Raise ValueError if the box in C has no place for an effect of the bench file."""
    model = parts.loop.model
    lags = (model.spool, model.spool_rate, model.cell_rate)
    reasons = {
        "a valve or a load cell without a lag of second order": NONE in lags,
        "a dead time": model.past > 0,
        "a lagging sensor beside the load cell": len(model.lagging) > 0 or model.force_shown != NONE,
        "an overlap of the valve": parts.overlap not in (Overlap(), Overlap(closing_current(parts.loop))),
        f"a model of more than {MOST_STATES} states": len(model.rest) > MOST_STATES,
    }
    for what, found in reasons.items():
        if found:
            raise ValueError(f"the filter of the box in C has no place for {what}: run the graph's filter")


def _arrays(loop: Loop) -> list[str]:
    """Coefficients, places, the still bench and the load, as arrays."""
    model = loop.model
    arrays = {"K": model.k, "SAMPLE_K": model.sample_k, "LINEAR_K": model.loop_k, "REST": model.rest,
              "FORCES": model.forces}  # fmt: skip
    places = ", ".join(map(str, model.from_whole))
    return [
        *(_array(f"HYDRO_WHOLE_{name}", numbers) for name, numbers in arrays.items()),
        f"static const int HYDRO_FROM_WHOLE[{len(model.from_whole)}] = {{{places}}};\n",
    ]


def _array(name: str, numbers: Iterable[float]) -> str:
    words = [initializer(float(number)) for number in numbers]
    return f"static const hydro_real {name}[{len(words)}] = {{\n{wrapped(words)}\n}};\n"


def _loop(loop: Loop, truth: Bench) -> dict[str, Any]:
    """Members of `hydro_loop`."""
    bench, model, numbers = loop.bench[0], loop.model, truth.constants()[0]
    reals = {
        "first": model.positions[0], "step": model.positions[1] - model.positions[0], "before": model.before,
        "after": model.after, "lag": model.lag, "inertia": model.inertia, "area": model.area, "ratio": model.ratio,
        "mass": model.mass, "dead_a": numbers["dead_volume_a"], "dead_b": numbers["dead_volume_b"],
        "stroke": numbers["stroke"], "least_gain": model.least_gain, "least_opening": model.least_opening,
        "bend_max": model.bend_max, "creep": model.creep, "gain_floor": loop.gain_floor,
        "velocity_memory": model.memories[1],
    }  # fmt: skip
    whole = len(model.rest), model.spool, model.spool_rate, model.cell, model.cell_rate
    linear = (
        len(model.from_whole), model.loop_spool, model.loop_spool_rate, model.loop_cell, model.loop_cell_rate,
    )  # fmt: skip
    return {
        "whole": ["hydro_whole_rates", "HYDRO_WHOLE_K", *whole],
        "linear": ["hydro_linear_rates", "HYDRO_WHOLE_LINEAR_K", *linear],
        "sample": "hydro_whole_sample", "sample_k": "HYDRO_WHOLE_SAMPLE_K", "jacobian": "hydro_linear_jacobian",
        "from_whole": "HYDRO_FROM_WHOLE", "rest": "HYDRO_WHOLE_REST", "forces": "HYDRO_WHOLE_FORCES",
        "points": len(model.forces), "holds": bool(model.holds),
        **{name: float(number) for name, number in reals.items()},
        "gain": model.gain, "bias": model.bias, "scale": loop.scale,
        "bench": {field: float(bench[field]) for field in BENCH_FIELDS},
    }  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="export_c",
        description="Write a filter's numbers for a box in C, for firmware/hydro/loop_filter.h.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--metric", default=LEARNED, metavar="FILE", help=f"of `learn_metric`; default: {LEARNED}, the shipped one"
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="bench file that it was made for; default: the shipped one"
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument(
        "--contraction-rate", type=float, metavar="1/s", default=LoopFilterSettings().contraction_rate,
        help="for gains of the certified range; default: %(default)g",
    )  # fmt: skip
    return parser


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    choice = FilterChoice(bench=bench, bench_file=options.bench, metric=options.metric, model=options.model)
    _refuse_bench(bench)
    if trouble := choice.trouble():
        raise ValueError(trouble)
    truth = load_model(choice.files["model"])
    settings = LoopFilterSettings(contraction_rate=options.contraction_rate)
    parts = loop_parts(ScheduledMetric.load(choice.files["metric"]), truth, bench, settings)
    told = ", ".join(f"{name} {word}" for name, word in choice.describe().items())
    origin = f"Written by `ros2 run hydro_filter export_c` for the bench {bench.digest}: {told}."
    write_whole(Path(options.out), header(parts, truth, origin).encode())
    print(f"{options.out}: {options.metric} metric for bench {bench.digest}")


def _refuse_bench(bench: Bench) -> None:
    """Refuse a bench whose samples `hydro_conceivable` (firmware/hydro/loop_filter.h) would reject as implausible."""
    force = bench.supply_pressure * bench.piston_area
    if bench.stroke > MOST_STROKE or force > MOST_FORCE:
        raise ValueError(
            f"the filter in C is for strokes to {MOST_STROKE:g} m and forces to {MOST_FORCE:g} N; this bench has "
            f"{bench.stroke:g} m and {force:g} N (supply pressure times piston area): it would correct nothing"
        )
