# SPDX-License-Identifier: Apache-2.0
"""`ros2 service list|type|call`."""

from __future__ import annotations

import argparse
from typing import Any

from rclpy.node import Node

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.graph import (
    PATIENCE,
    absolute,
    add_list_options,
    answer_of,
    print_list,
    settle,
    visiting,
    wait_for,
)
from hydro_bridge.nodes.verbs.values import fill, interface, parsed

GROUP, HELP = "service", "services of the running graph: list, type, call"


def add_verbs(verbs: Any) -> None:
    """Add the group's verbs."""
    several = verbs.add_parser("list", help="names of all services")
    add_list_options(several, "services")
    several.set_defaults(carry_out=_list)
    kind = verbs.add_parser("type", help="a service's type")
    kind.add_argument("service")
    kind.set_defaults(carry_out=_type)
    call = verbs.add_parser("call", help="ask a service once, and show what it answers")
    call.add_argument("service")
    call.add_argument("type", help="e.g. std_srvs/srv/SetBool")
    call.add_argument("values", nargs="?", default="", help="fields as YAML, e.g. '{data: false}'")
    call.set_defaults(carry_out=_call)


def _list(options: argparse.Namespace) -> None:
    with visiting() as node:
        settle(node, options.spin_time)
        print_list(options, node.get_service_names_and_types())


def _type(options: argparse.Namespace) -> None:
    with visiting() as node:
        print("\n".join(_kinds(node, absolute(options.service))))


def _call(options: argparse.Namespace) -> None:
    service, kind = absolute(options.service), interface(options.type, "srv")
    request = kind.Request(check_fields=True)
    fill(request, parsed(options.values))
    with visiting() as node:
        offered = _kinds(node, service)
        package, _, name = kind.__module__.partition(".")[0], "", kind.__name__
        if f"{package}/srv/{name}" not in offered:
            raise UserError(f"{service} is of type {', '.join(offered)}, not {options.type}")
        client = node.create_client(kind, service)
        if not client.wait_for_service(timeout_sec=PATIENCE):
            raise UserError(f"{service} was not ready within {PATIENCE:g} s")
        print(f"requester: making request: {request}\n")
        print(f"response:\n{answer_of(node, client.call_async(request), service)}\n")


def _kinds(node: Node, service: str) -> list[str]:
    wait_for(lambda: service in dict(node.get_service_names_and_types()), f"nobody offers the service {service}")
    return list(dict(node.get_service_names_and_types())[service])
