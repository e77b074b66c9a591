# SPDX-License-Identifier: Apache-2.0
"""Rules of --resume: a resumed run keeps the options that it was started with.

run.resume                      continues with the settings that the run was started with
run.resume --seed 3             accepted if the run has this seed, else refused: no option is silently ignored
run.resume --episodes 320       applies, since the command's help lists the option as changeable
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from typing import Any

from hydro_bridge.errors import UserError

NEW_ONLY: Any = object()
"""Start value of an option that only a new run accepts: any value on resume is refused."""
_UNSAID = object()


def explicit_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> dict[str, Any]:
    """Return the options given explicitly in `words`, by name; those left at their defaults are omitted."""
    names = vars(parser.parse_args(words))
    said = vars(parser.parse_args(words, argparse.Namespace(**dict.fromkeys(names, _UNSAID))))
    return {name: value for name, value in said.items() if value is not _UNSAID}


def refuse_changes(parser: argparse.ArgumentParser, words: Sequence[str], what: str, begun: Mapping[str, Any]) -> None:
    """Raise UserError if `words` contradict the options that `what` was started with.

    `what`: name of what is resumed, for the message. `begun`: original values by option name, files as absolute paths,
    or `NEW_ONLY`. Options that are not listed may change. Raises UserError: the message names each contradicting option
    and the run's own value.
    """
    spelled = {action.dest: action.option_strings[0] for action in parser._actions if action.option_strings}
    wrong = [
        f"{spelled[name]} {_shown(value)}".rstrip() + _instead(begun[name])
        for name, value in explicit_options(parser, words).items()
        if name in begun and value != begun[name] and os.path.abspath(str(value)) != begun[name]
    ]
    if wrong:
        raise UserError(
            f"{what} resumes with the options of its start, without {' and '.join(wrong)}: drop that, or start again"
        )


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return ""
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _instead(value: Any) -> str:
    if value is NEW_ONLY or isinstance(value, bool):
        return ""
    return f" (it has {'none' if value is None else _shown(value)})"
