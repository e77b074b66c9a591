# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter export_c --bench bench.yaml --out loop_filter_config.h: a filter's C configuration for a box.

For firmware/hydro/loop_filter.h, the decision that the filter node runs as a library: the bench file's two models, as
generated C with their coefficients, and the metric's table.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_core.cli.console import command, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray
from hydro_filter.controller.factory import SHIPPED_METRIC, FilterChoice
from hydro_filter.controller.loop_filter import LoopFilterSettings, filter_record
from hydro_filter.model.loop import SUBSTEPS, Loop, make_loop, without_disturbances
from hydro_sim.box.firmware import RecordArray
from hydro_sim.box.header import header_file, initializer, record_members, wrap_words
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.source import embedded_source


def render_header(record: RecordArray, loop: Loop, table: FloatArray, origin: str) -> str:
    """Return a C header that defines the filter's configuration, `HYDRO_LOOP_FILTER`.

    Parameters
    ----------
    record
        Record of `filter_record`, shape (1,).
    loop, table
        Loop model and table of the metric.
    origin
        Comment on the files that it was made from.

    Raises
    ------
    ValueError
        The model uses a function that the C firmware does not have.
    """
    model, arrays = loop.model_bench, loop.arrays | {"table": table}
    names = {name: f"HYDRO_FILTER_{name.upper().replace('.', '_')}" for name in arrays}
    members = record_members(record[0])
    members["table"] = names.pop("table")
    for name, word in names.items():
        *path, last = name.split(".")
        (members["loop"][path[0]] if path else members["loop"])[last] = word
    at = members["loop"]
    at["whole"]["rates"], at["linear"]["rates"] = "hydro_whole_all_rates", "hydro_linear_all_rates"
    at["sample"], at["jacobian"] = "hydro_whole_all_sample", "hydro_linear_all_jacobian"
    models = (("hydro_whole", model, False), ("hydro_linear", without_disturbances(model), True))
    lines = [
        f"#define HYDRO_STATES {max(int(loop['whole.states']), int(loop['linear.states']))}",
        f"#define HYDRO_COORDINATES {len(loop.scale)}",
        '#include "hydro/loop_filter.h"\n',
        *(
            embedded_source(BenchModel(of, substeps=SUBSTEPS).symbols(), SUBSTEPS, name, jacobian=jacobian)
            for name, of, jacobian in models
        ),
    ]
    for name, array in arrays.items():
        kind = "int" if array.dtype.kind == "i" else "hydro_real"
        words = [initializer(number) for number in array.ravel()] or ["0"]
        word = names.get(name, members["table"])
        lines.append(f"static const {kind} {word}[{len(words)}] = {{\n{wrap_words(words)}\n}};\n")
    lines.append(f"static const hydro_loop_filter HYDRO_LOOP_FILTER = {initializer(members)};")
    return header_file("HYDRO_LOOP_FILTER_CONFIG_H", origin, "\n".join(lines))


@command(ValueError)
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="export_c",
        description="Write a filter's numbers for a box in C, for firmware/hydro/loop_filter.h.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--metric",
        default=SHIPPED_METRIC,
        metavar="FILE",
        help=f"of `learn_metric`; default: {SHIPPED_METRIC}, the shipped one",
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="bench file that it was made for; default: the shipped one"
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable_file, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument(
        "--contraction-rate", type=float, metavar="1/s", default=LoopFilterSettings().contraction_rate,
        help="for gains of the certified range; default: %(default)g",
    )  # fmt: skip
    options = parser.parse_args()
    choice = FilterChoice.from_files(metric=options.metric, model=options.model, bench=options.bench)
    if trouble := choice.pairing_error():
        raise ValueError(trouble)
    model, bench, metric = load_model(choice.files["model"]), choice.bench, choice.stored_metric
    settings = LoopFilterSettings(contraction_rate=options.contraction_rate)
    loop, record = make_loop(model, bench), filter_record(metric, model, bench, settings)
    told = ", ".join(f"{name} {word}" for name, word in choice.describe().items())
    origin = f"Written by `ros2 run hydro_filter export_c` for the bench {bench.digest}: {told}."
    write_atomic(Path(options.out), render_header(record, loop, metric.table, origin).encode())
    print(f"{options.out}: {options.metric} metric for bench {bench.digest}")
