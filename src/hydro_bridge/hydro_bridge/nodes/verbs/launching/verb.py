# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch PACKAGE FILE [NAME:=VALUE ...]`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.launching.description import DeclareLaunchArgument, LaunchDescription, share_of
from hydro_bridge.nodes.verbs.launching.modules import load, provide
from hydro_bridge.nodes.verbs.launching.processes import run


def add_group(groups: Any) -> None:
    """Add the command."""
    parser = groups.add_parser("launch", help="start what a launch file describes", allow_abbrev=False)
    parser.add_argument("package", help="or the path of a launch file")
    parser.add_argument("rest", nargs="*", metavar="FILE NAME:=VALUE", help="launch file and its arguments")
    parser.add_argument("-s", "--show-args", action="store_true", help="only its arguments, and what they mean")
    parser.set_defaults(carry_out=_launch)


def _launch(options: argparse.Namespace) -> int:
    provide()
    file, words = _file(options.package, options.rest)
    described, values = load(file), _values(words)
    if options.show_args:
        _show(described)
        return 0
    return run(described, values)


def _file(package: str, rest: list[str]) -> tuple[Path, list[str]]:
    """Return the launch file and the words after it; raises UserError."""
    if Path(package).is_file():
        return Path(package), rest
    if not rest or ":=" in rest[0]:
        raise UserError(f"ros2 launch {package}: which launch file? It has: {', '.join(_files(package)) or 'none'}")
    if rest[0] not in _files(package):
        raise UserError(f"{package} has no launch file {rest[0]}; it has: {', '.join(_files(package)) or 'none'}")
    return Path(share_of(package), "launch", rest[0]), rest[1:]


def _files(package: str) -> list[str]:
    return sorted(path.name for path in Path(share_of(package), "launch").glob("*.launch.py"))


def _values(words: list[str]) -> dict[str, str]:
    for word in words:
        if ":=" not in word:
            raise UserError(f"{word}: name:=value is meant")
    return {name: value for name, _, value in (word.partition(":=") for word in words)}


def _show(described: LaunchDescription) -> None:
    print("Arguments (pass arguments as '<name>:=<value>'):\n")
    for entity in described.entities:
        if isinstance(entity, DeclareLaunchArgument):
            choices = f" One of: {', '.join(entity.choices)}" if entity.choices else ""
            default = "" if entity.default_value is None else f"\n        (default: '{entity.default_value}')"
            print(f"    '{entity.name}':\n        {entity.description}{choices}{default}\n")
