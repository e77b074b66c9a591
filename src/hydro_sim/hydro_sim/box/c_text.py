# SPDX-License-Identifier: Apache-2.0
"""Generation of C text: numbers and headers for the box in C."""

from __future__ import annotations

from collections.abc import Iterable


def reals(numbers: Iterable[float]) -> str:
    """Initializer of an array of `hydro_real`, in decimals that reproduce the doubles exactly."""
    return "{" + ", ".join(f"HYDRO_R({float(number)!r})" for number in numbers) + "}"


def wrapped(words: Iterable[str], width: int = 118, indent: str = "    ") -> str:
    """Comma-separated words in lines of at most `width` characters."""
    lines, line = [], indent
    for word in words:
        if len(line) + len(word) + 2 > width and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += f"{word}, "
    return "\n".join([*lines, line.rstrip().rstrip(",")])


def header_file(guard: str, origin: str, body: str) -> str:
    """Return a complete header file: licence, origin, include guard, text."""
    head = f"/* SPDX-License-Identifier: Apache-2.0 */\n/* {origin} */\n"
    return f"{head}#ifndef {guard}\n#define {guard}\n\n{body}\n\n#endif\n"
