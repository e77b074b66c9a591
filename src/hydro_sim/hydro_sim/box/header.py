# SPDX-License-Identifier: Apache-2.0
"""The configuration of the box in C (firmware/hydro/config.h), as a structure for the library and as a header.

ros2 run hydro_sim export_c --bench bench.yaml --out box_config.h
"""

from __future__ import annotations

import argparse
import ctypes
from collections.abc import Iterable, Mapping
from pathlib import Path
from textwrap import fill
from typing import Any, get_args

import numpy as np

from hydro_bridge.cli.console import command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.serial.protocol import INTEGRAL_FORMS
from hydro_bridge.signals import NEUTRAL
from hydro_sim.box.box import BoxConfig, Integral
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors

NAME = "hydro firmware"
"""Name of the box in C on the line."""


def initializer(value: Any, indent: str = "") -> str:
    """Return a C initializer: a structure of a mapping, an array of other iterables, `hydro_real` of floats.

    Decimals reproduce the doubles exactly; text is taken as it is.
    """
    if isinstance(value, Mapping):
        members = "".join(
            f"{indent}    .{name} = {initializer(one, indent + '    ')},\n" for name, one in value.items()
        )
        return f"{{\n{members}{indent}}}"
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return f"HYDRO_R({float(value)!r})"
    if isinstance(value, int | np.integer):
        return str(value)
    return f"{{{', '.join(initializer(one, indent) for one in value)}}}"


def wrapped(words: Iterable[str], indent: str = "    ") -> str:
    """Comma-separated words in lines of at most 118 characters."""
    return fill(", ".join(words), 118, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def header_file(guard: str, origin: str, body: str) -> str:
    """Return a complete header file: licence, origin, include guard, text."""
    head = f"/* SPDX-License-Identifier: Apache-2.0 */\n/* {origin} */\n"
    return f"{head}#ifndef {guard}\n#define {guard}\n\n{body}\n\n#endif\n"


BENCH_FIELDS = (
    "bulk_modulus",
    "piston_area",
    "area_ratio",
    "stroke",
    "supply_pressure",
    "tank_pressure",
    "dead_volume_a",
    "dead_volume_b",
    "valve_gain",
    "valve_current_max",
)
LAW_FIELDS = (
    "base_kp",
    "base_ki",
    "delta_kp_min",
    "delta_kp_max",
    "delta_ki_min",
    "delta_ki_max",
    "reference_max",
)
"""Numbers of a law in the order of `hydro_law`."""
SHAPING_FIELDS = ("safe", "low", "high", "rate")
"""Shaping of a law, behind them: of a_0 to a_3, C_1, C_2 each."""
REAL_FIELDS = ("delta_u_max", "load_force_limit", "gain_floor", "force_range", "recovery_margin")
"""Numbers of the box in the order of `hydro_config`, behind those of the bench and its laws."""


def structure(real: type[Any]) -> type[ctypes.Structure]:
    """`hydro_config` with numbers of `ctypes.c_double` or `ctypes.c_float`."""
    numbers = [(name, real) for name in LAW_FIELDS] + [(name, real * 6) for name in SHAPING_FIELDS]
    law: type[ctypes.Structure] = type("HydroLaw", (ctypes.Structure,), {"_fields_": numbers})
    fields: list[tuple[str, Any]] = [(name, real) for name in BENCH_FIELDS]
    fields += [("laws", ctypes.ARRAY(law, 2)), *((name, real) for name in REAL_FIELDS)]
    fields += [("low", real * 8), ("high", real * 8), ("force_rate_age", real), ("velocity_age", real)]
    fields += [("hold_timeout", ctypes.c_double), ("trip_timeout", ctypes.c_double)]
    fields += [("feedback", ctypes.c_uint32), ("integral_form", ctypes.c_uint32)]
    fields += [("name", ctypes.c_uint8 * 32), ("digest", ctypes.c_uint8 * 12)]
    return type("HydroConfig", (ctypes.Structure,), {"_fields_": fields})


def values(bench: Bench, config: BoxConfig, sensors: Sensors, name: str) -> dict[str, Any]:
    """Configuration of a box with these settings, by the fields of `hydro_config`, without the bench's."""
    believed, settings = bench.constants()[0], config.constants(bench)[0]
    result: dict[str, Any] = {field: float(believed[field]) for field in BENCH_FIELDS}
    result["laws"] = [_law(settings[name]) for name in ("paper", "compensated")]
    force_range = settings["high"][settings["feedback_channel"]]
    result |= {field: float(force_range if field == "force_range" else settings[field]) for field in REAL_FIELDS}
    result |= {"low": settings["low"].tolist(), "high": settings["high"].tolist()}
    result |= {"force_rate_age": sensors.force_rate_age, "velocity_age": sensors.velocity_age}
    result |= {"hold_timeout": config.hold_timeout, "trip_timeout": config.trip_timeout}
    result |= {"feedback": int(settings["feedback_channel"]), "integral_form": INTEGRAL_FORMS.index(config.integral)}
    result |= {"name": name.encode()[:32].ljust(32, b"\0"), "digest": bench.digest.encode()[:12].ljust(12, b"\0")}
    return result


def _law(record: np.void) -> dict[str, Any]:
    """Numbers of `hydro_law` of a record of `kernel.LAW_DTYPE`."""
    scales = ("velocity_compensation", "valve_gain_scale")
    result: dict[str, Any] = {field: float(record[field]) for field in LAW_FIELDS}
    result["safe"] = [*NEUTRAL, *(float(record[name]) for name in scales)]
    for field, end in (("low", "min"), ("high", "max")):
        result[field] = [*record[f"coefficient_{end}"].tolist(), *(float(record[f"{name}_{end}"]) for name in scales)]
    result["rate"] = [*record["coefficient_rate"].tolist(), *[float(record["scale_rate"])] * 2]
    return result


def filled(kind: type[ctypes.Structure], numbers: dict[str, Any]) -> ctypes.Structure:
    """A structure of `values`."""
    record = kind()
    for field, _ in kind._fields_:  # type: ignore[misc]
        value = numbers[field]
        if field == "laws":
            record.laws[:] = [filled(record.laws._type_, law) for law in value]
        elif isinstance(value, list | bytes):
            getattr(record, field)[:] = value
        else:
            setattr(record, field, value)
    return record


def header(numbers: dict[str, Any]) -> str:
    """The configuration as a C header that defines `HYDRO_BOX_CONFIG`; decimals that give the same double back."""
    exact = {field: repr(numbers[field]) for field in ("hold_timeout", "trip_timeout")}  # double whatever hydro_real is
    rest = {field: number for field, number in numbers.items() if field not in BENCH_FIELDS}
    members = {"bench": {field: numbers[field] for field in BENCH_FIELDS}, **rest, **exact}
    name, digest = (numbers[field].rstrip(b"\0").decode() for field in ("name", "digest"))
    body = f'#include "hydro/config.h"\n\nstatic const hydro_config HYDRO_BOX_CONFIG = {initializer(members)};'
    origin = f"Written by `ros2 run hydro_sim export_c` for the bench {digest}, box {name}."
    return header_file("HYDRO_BOX_CONFIG_H", origin, body)


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="export_c", description="Write the configuration of a box in C from a bench file.", allow_abbrev=False
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: nominal")
    parser.add_argument("--out", type=writable, required=True, metavar="FILE.h", help="header to write")
    parser.add_argument("--name", default=NAME, help="name and version that the box gives itself; default: %(default)s")
    parser.add_argument("--integral", choices=get_args(Integral), default="bumpless", help="default: %(default)s")
    return parser


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    config = BoxConfig(integral=options.integral).of_bench(bench)
    text = header(values(bench, config, Sensors(), options.name))
    write_whole(Path(options.out), text.encode())
    print(f"{options.out}: box {options.name}, bench {bench.digest}")
