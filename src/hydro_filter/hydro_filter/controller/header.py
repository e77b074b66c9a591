# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter filter_header --bench bench.yaml --out filter_config.h: the constant metric's filter for C.

The header holds the numbers of `compiled.FilterParts` that firmware/hydro/filter.h needs; its decision is that of
`compiled.decide`. The filter with the learned metric has no form in C.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_bridge.cli.console import command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.settings import check
from hydro_filter.controller.compiled import FilterParts, filter_parts
from hydro_filter.controller.filter import ContractionFilter, FilterSettings
from hydro_filter.model.state import LOAD_FORCE
from hydro_sim.box.c_text import header_file, reals
from hydro_sim.box.configuration import BENCH_FIELDS
from hydro_sim.model.bench import Bench


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    usual = FilterSettings()
    parser = argparse.ArgumentParser(
        prog="filter_header",
        description="Write the filter with the constant metric for a box in C (firmware/hydro/filter.h).",
        allow_abbrev=False,
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument(
        "--contraction-rate", type=float, default=usual.contraction_rate, metavar="1/s", help="default: %(default)s"
    )
    parser.add_argument(
        "--noise-floor", type=float, default=usual.noise_floor, metavar="N", help="default: %(default)s"
    )
    return parser


def header(parts: FilterParts, digest: str) -> str:
    """Text of the header that defines `HYDRO_FILTER`, for a bench of this digest."""
    bench = parts.bench[0]
    lines = [
        "    .bench = {",
        *(f"        .{field} = HYDRO_R({float(bench[field])!r})," for field in BENCH_FIELDS),
        "    },",
        f"    .gain_floor = HYDRO_R({float(parts.gain_floor)!r}),",
        f"    .metric = {reals(parts.metric[:, LOAD_FORCE])},",
        f"    .scale = {reals(parts.scale)},",
        f"    .contraction_rate = HYDRO_R({float(parts.contraction_rate)!r}),",
        f"    .noise_floor = HYDRO_R({float(parts.noise_floor)!r}),",
    ]
    body = '#include "hydro/filter.h"\n\nstatic const hydro_filter HYDRO_FILTER = {\n' + "\n".join(lines) + "\n};"
    origin = f"Written by `ros2 run hydro_filter filter_header` for the bench {digest}, constant metric."
    return header_file("HYDRO_FILTER_CONFIG_H", origin, body)


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    settings = FilterSettings(contraction_rate=options.contraction_rate, noise_floor=options.noise_floor)
    check(settings)
    parts = filter_parts(ContractionFilter.for_bench(bench, settings).certificate)
    write_whole(Path(options.out), header(parts, bench.digest).encode())
    print(f"{options.out}: constant metric for bench {bench.digest}")
