# SPDX-License-Identifier: Apache-2.0
"""The rules of --resume: a resumed run keeps the options that it was started with.

run.resume                      goes on with the settings that it was begun with
run.resume --seed 3             fine if it has this seed, else refused: nothing that is said is ignored
run.resume --episodes 320       what a command lets change on the way (its help says so) applies
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from typing import Any

from hydro_bridge.errors import UserError

NEW_ONLY: Any = object()
"""What was begun with an option that only what begins can be told: no word is right."""
_UNSAID = object()


def explicit_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> dict[str, Any]:
    """Options given explicitly in `words`, by name; those left at their defaults are omitted."""
    names = vars(parser.parse_args(words))
    said = vars(parser.parse_args(words, argparse.Namespace(**dict.fromkeys(names, _UNSAID))))
    return {name: value for name, value in said.items() if value is not _UNSAID}


def refuse_changes(parser: argparse.ArgumentParser, words: Sequence[str], what: str, begun: Mapping[str, Any]) -> None:
    """Raise UserError if `words` contradict the options that `what` was started with.

    Parameters
    ----------
    what
        What goes on, for the sentence.
    begun
        What it was begun with, by the options' names, files as absolute paths, or `NEW_ONLY`. Options that are not in
        it may change.

    Raises
    ------
    UserError
        It names each such option, and what the run has instead.
    """
    spelled = {action.dest: action.option_strings[0] for action in parser._actions if action.option_strings}
    wrong = [
        f"{spelled[name]} {_shown(value)}".rstrip() + _instead(begun[name])
        for name, value in explicit_options(parser, words).items()
        if name in begun and value != begun[name] and os.path.abspath(str(value)) != begun[name]
    ]
    if wrong:
        raise UserError(f"{what} goes on as it was begun, without {' and '.join(wrong)}: leave that out, or begin anew")


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return ""
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _instead(value: Any) -> str:
    if value is NEW_ONLY or isinstance(value, bool):
        return ""
    return f" (it has {'none' if value is None else _shown(value)})"
