# SPDX-License-Identifier: Apache-2.0
"""Check of launch arguments: `ros2 launch` ignores those that no file declares, even a misspelt bench."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

from hydro_core.errors import UserError


def refuse_unknown_arguments(file: str, known: Sequence[str]) -> None:
    """Raise UserError if this process launches `file` with an argument that is not `known`.

    `file`: `__file__` of the launch file; not checked if another file includes it. `known`: names of all declared
    arguments, including those of included files.
    """
    words = sys.argv[1:]
    package = Path(file).resolve().parent.parent.name  # of the form PACKAGE FILE
    named = any(pair == (package, Path(file).name) for pair in pairwise(words))
    if not named and not any(Path(word).resolve() == Path(file).resolve() for word in words):
        return
    for word in words:
        name, said, _ = word.partition(":=")
        if said and name not in known:
            close = get_close_matches(name, known, 1)
            hint = f"is {close[0]}:= meant?" if close else f"it has: {', '.join(f'{one}:=' for one in known)}"
            raise UserError(f"{name}:= is no argument of {Path(file).name}; {hint}")
