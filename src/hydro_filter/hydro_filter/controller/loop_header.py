# SPDX-License-Identifier: Apache-2.0
"""Parameters of the default filter as a header for firmware/hydro/loop_filter.h.

The C code has the structured model's physics and the metric's table. Both files may also hold a network; the shipped
networks contribute nothing, and files whose networks do are refused.
"""

from __future__ import annotations

from math import exp

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.controller.loop_decision import LoopParts
from hydro_filter.model.loop_model import LoopModel
from hydro_sim.box.c_text import header_file, reals, wrapped
from hydro_sim.box.configuration import BENCH_FIELDS
from hydro_sim.neural.mlp import Layers


def header(parts: LoopParts, origin: str) -> str:
    """Return the header that defines `HYDRO_LOOP_FILTER`.

    Raises
    ------
    ValueError
        A network contributes to the metric or to the model, or the model is a bench file: not supported in C.
    """
    loop, metric = parts.loop, parts.metric
    if not isinstance(loop, LoopModel):
        raise ValueError("the box in C has no place for a bench file as model: --model needs one of `learn`")
    for what, layers in (("metric", metric.layers), ("model", loop.model[1])):
        if _adds(layers):
            raise ValueError(f"the {what} has a network that adds to it, for which the box in C has no place")
    rows, table = len(metric.gains), metric.table
    step = metric.gains[1] - metric.gains[0] if rows > 1 else 1.0
    kept, foreign_kept = (exp(-2.0 * rate * SAMPLE_PERIOD) for rate in (parts.rate, parts.foreign_rate))
    numbers = {
        "gain_low": metric.gains[0], "gain_high": metric.gains[-1], "gain_step": step, "floor": metric.floor,
        "kept": kept, "foreign_kept": foreign_kept, "noise_size": parts.noise_size,
        "foreign_noise_size": parts.foreign_noise_size, "integral_allowance": parts.integral_allowance,
    }  # fmt: skip
    lines = [
        '#include "hydro/loop_filter.h"\n',
        f"static const hydro_real HYDRO_LOOP_TABLE[{rows + 1}][HYDRO_FACTOR] = {{",
        *("    {\n" + wrapped((_real(number) for number in row), indent=" " * 8) + "\n    }," for row in table),
        "};\n",
        "static const hydro_loop_filter HYDRO_LOOP_FILTER = {",
        *_loop(loop),
        "    .table = HYDRO_LOOP_TABLE,",
        f"    .rows = {rows},",
        *(f"    .{name} = {_real(number)}," for name, number in numbers.items()),
        "};",
    ]
    return header_file("HYDRO_LOOP_FILTER_CONFIG_H", origin, "\n".join(lines))


def _loop(loop: LoopModel) -> list[str]:
    """Lines of `hydro_loop`."""
    bench = loop.bench[0]
    return [
        "    .loop = {",
        "        .model = {\n" + wrapped(map(_real, loop.model[0]), indent=" " * 12) + "\n        },",
        "        .bench = {",
        *(f"            .{field} = {_real(bench[field])}," for field in BENCH_FIELDS),
        "        },",
        f"        .gain_floor = {_real(loop.gain_floor)},",
        f"        .velocity_memory = {_real(loop.model[4][1])},",
        f"        .scale = {reals(loop.scale)},",
        "    },",
    ]


def _real(number: float) -> str:
    return f"HYDRO_R({float(number)!r})"


def _adds(layers: Layers) -> bool:
    """Return whether a network's last layer is non-zero."""
    return bool(np.any(layers.w3) or np.any(layers.b3))
