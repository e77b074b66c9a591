# SPDX-License-Identifier: Apache-2.0
"""Command lines of nodes. An option is a ROS parameter, too: of the node's name, by `-p`, or in a parameter file.

A run writes the parameters of all its nodes into one file, RUN/graph.yaml, and starts each with this file
(`hydro_policy.nodes.plants`). What the command line says takes precedence.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from itertools import pairwise
from typing import Any

import yaml

from hydro_core.settings import read_yaml

_NAME = re.compile(r"(?:([\w*/]+):)?(.+?):=(.*)", re.DOTALL)


def ros_arguments() -> tuple[list[str], list[str]]:
    """Split the command line into a node's own arguments and those after `--ros-args` (up to `--`, if there is one)."""
    rest = sys.argv[1:]
    if "--ros-args" not in rest:
        return rest, []
    begin = rest.index("--ros-args")
    end = rest.index("--", begin) + 1 if "--" in rest[begin:] else len(rest)
    return rest[:begin] + rest[end:], rest[begin:end]


def sections(content: Any, above: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the nodes named in a parameter file, as patterns, with their parameters."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key == "ros__parameters":
                yield above, value if isinstance(value, dict) else {}
            else:
                yield from sections(value, f"{above}/{str(key).strip('/')}")


def reaches(pattern: str, node: str) -> bool:
    """Return whether a file's section is for this node: `/**` stands for any parts of a name, `/*` for one."""
    return fnmatch("/" + node.lstrip("/"), "/" + pattern.replace("/**", "*").lstrip("/"))


def parameters(node: str, ros: Sequence[str]) -> dict[str, Any]:
    """Return the parameters that the arguments from `--ros-args` on give to a node, by name."""
    found: dict[str, Any] = {}
    for option, value in pairwise(ros):
        rule = _NAME.fullmatch(value)
        if option in ("-r", "--remap") and rule and rule[2] in ("__node", "__name") and rule[1] in (None, node):
            node = rule[3]
    for option, value in pairwise(ros):
        if option == "--params-file":
            for pattern, given in sections(read_yaml(value)):
                found |= given if reaches(pattern, node) else {}
        elif option in ("-p", "--param") and (rule := _NAME.fullmatch(value)) and rule[1] in (None, node, "/" + node):
            found[rule[2]] = yaml.safe_load(rule[3])
    return found


def parse_arguments(
    parser: argparse.ArgumentParser, node: str, own: Sequence[str], ros: Sequence[str]
) -> argparse.Namespace:
    """Parse a node's own arguments behind its parameters that are named as an option.

    `node`: name of the node. `ros`: arguments from `--ros-args` on.
    """
    return parser.parse_args([*parameter_words(parser, node, ros), *own])


def parameter_words(parser: argparse.ArgumentParser, node: str, ros: Sequence[str]) -> list[str]:
    """Return the options that are given as parameters of the node as words of its command line."""
    given, words = parameters(node, ros), list[str]()
    for action in parser._actions:  # argparse: no public list
        if not action.option_strings or (value := given.get(action.dest)) is None:
            continue
        option = action.option_strings[-1]
        if action.nargs == 0:
            words += [option] if value == action.const else []
        elif isinstance(value, list):
            words += [option, *map(str, value)]
        else:
            words.append(f"{option}={value}")
    return words
