# SPDX-License-Identifier: Apache-2.0
"""`ros2 param list|get|set`."""

from __future__ import annotations

import argparse
from typing import Any

import yaml
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.graph import (
    PATIENCE,
    add_spin_time,
    answer_of,
    full_name,
    hidden,
    settle,
    visiting,
)
from hydro_bridge.nodes.verbs.names import find_node, node_names

GROUP, HELP = "param", "parameters of nodes: list, get, set"
_WORDS = {
    ParameterType.PARAMETER_BOOL: "Boolean value is",
    ParameterType.PARAMETER_INTEGER: "Integer value is",
    ParameterType.PARAMETER_DOUBLE: "Double value is",
    ParameterType.PARAMETER_STRING: "String value is",
    ParameterType.PARAMETER_BYTE_ARRAY: "Byte values are",
    ParameterType.PARAMETER_BOOL_ARRAY: "Boolean values are",
    ParameterType.PARAMETER_INTEGER_ARRAY: "Integer values are",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "Double values are",
    ParameterType.PARAMETER_STRING_ARRAY: "String values are",
}


def add_verbs(verbs: Any) -> None:
    """Add the group's verbs."""
    several = verbs.add_parser("list", help="names of a node's parameters, or of all nodes'")
    several.add_argument("node", nargs="?")
    add_spin_time(several)
    several.set_defaults(carry_out=_list)
    get = verbs.add_parser("get", help="a parameter's value")
    get.add_argument("node")
    get.add_argument("parameter")
    get.add_argument("--hide-type", action="store_true", help="the value alone")
    get.set_defaults(carry_out=_get)
    put = verbs.add_parser("set", help="set a parameter, if its node lets itself be told while it runs")
    put.add_argument("node")
    put.add_argument("parameter")
    put.add_argument("value", help="as YAML: 0.5, true, word, [1, 2]")
    put.set_defaults(carry_out=_set)


def _list(options: argparse.Namespace) -> None:
    with visiting() as node:
        if options.node:
            for name in sorted(_names(node, full_name(*reversed(find_node(node, options.node))))):
                print(f"  {name}")
            return
        settle(node, options.spin_time)
        for owner in node_names(node):
            if not hidden(owner):
                print(f"{owner}:")
                try:
                    names = sorted(_names(node, owner))
                except UserError as error:  # a node without parameters may have no parameter services
                    names = [f"({error})"]
                print(*(f"  {name}" for name in names), sep="\n")


def _names(node: Node, owner: str) -> list[str]:
    answer: Any = answer_of(node, _client(node, owner).list_parameters(), owner)
    return list(answer.result.names)


def _get(options: argparse.Namespace) -> int:
    with visiting() as node:
        owner = full_name(*reversed(find_node(node, options.node)))
        value = _value(node, owner, options.parameter)
    if value.type == ParameterType.PARAMETER_NOT_SET:
        raise UserError(f"{owner} has no parameter {options.parameter}")
    shown = parameter_value_to_python(value)
    print(shown if options.hide_type else f"{_WORDS[value.type]}: {shown}")
    return 0


def _set(options: argparse.Namespace) -> int:
    try:
        wanted = yaml.safe_load(options.value)
    except yaml.YAMLError:
        raise UserError(f"{options.value!r} is no YAML") from None
    if wanted is None:  # that would remove the parameter
        raise UserError(f"{options.value!r} is no value of a parameter")
    with visiting() as node:
        owner = full_name(*reversed(find_node(node, options.node)))
        if _value(node, owner, options.parameter).type == ParameterType.PARAMETER_DOUBLE and type(wanted) is int:
            wanted = float(wanted)
        try:
            parameter = Parameter(options.parameter, value=wanted)
        except (TypeError, AssertionError):
            raise UserError(f"{options.value!r} is no value of a parameter") from None
        answer: Any = answer_of(node, _client(node, owner).set_parameters([parameter]), owner)
    result = answer.results[0]
    if not result.successful:
        raise UserError(f"Setting parameter failed: {result.reason or 'the node gives no reason'}")
    print("Set parameter successful")
    return 0


def _value(node: Node, owner: str, name: str) -> ParameterValue:
    answer: Any = answer_of(node, _client(node, owner).get_parameters([name]), owner)
    return answer.values[0] if answer.values else ParameterValue()


def _client(node: Node, owner: str) -> AsyncParameterClient:
    client = AsyncParameterClient(node, owner)
    if not client.wait_for_services(PATIENCE):
        raise UserError(f"{owner} offers no parameters (looked for {PATIENCE:g} s)")
    return client
