# SPDX-License-Identifier: Apache-2.0
"""The configuration of a box (firmware/hydro/config.h) as a C header, and helpers for other generated headers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from textwrap import fill
from typing import Any

import numpy as np

from hydro_sim.box.firmware import RecordArray


def initializer(value: Any, indent: str = "") -> str:
    """Return a C initializer: a structure for a mapping, an array for other iterables, `hydro_real` for floats.

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


def wrap_words(words: Iterable[str], indent: str = "    ") -> str:
    """Return words joined by commas, in lines of at most 118 characters."""
    return fill(", ".join(words), 118, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def header_file(guard: str, origin: str, body: str) -> str:
    """Return a complete header file: licence, origin, include guard, text."""
    head = f"/* SPDX-License-Identifier: Apache-2.0 */\n/* {origin} */\n"
    return f"{head}#ifndef {guard}\n#define {guard}\n\n{body}\n\n#endif\n"


def render_header(config: RecordArray) -> str:
    """Return a C header that defines `HYDRO_BOX_CONFIG` from a record of hydro_config in double precision, shape (1,).

    Decimals reproduce the doubles exactly.
    """
    members = record_members(config[0])
    members |= {name: repr(float(config[name][0])) for name in ("hold_timeout", "trip_timeout")}  # of type hydro_time
    name, digest = (config[field][0].tobytes().rstrip(b"\0").decode() for field in ("name", "digest"))
    body = f'#include "hydro/config.h"\n\nstatic const hydro_config HYDRO_BOX_CONFIG = {initializer(members)};'
    origin = f"Written by `ros2 run hydro_sim export --box` for the bench {digest}, box {name}."
    return header_file("HYDRO_BOX_CONFIG_H", origin, body)


def record_members(record: np.void) -> dict[str, Any]:
    """Return the fields of a record as nested mappings, for `initializer`."""
    members: dict[str, Any] = {}
    for name in record.dtype.names or ():
        value = record[name]
        if isinstance(value, np.void):
            members[name] = record_members(value)
        elif value.dtype.names:
            members[name] = [record_members(one) for one in value]
        else:
            members[name] = value
    return members
