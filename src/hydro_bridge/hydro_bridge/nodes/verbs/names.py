# SPDX-License-Identifier: Apache-2.0
"""`ros2 node list|info`."""

from __future__ import annotations

import argparse
from typing import Any

from rclpy.node import Node

from hydro_bridge.nodes.verbs.graph import absolute, add_spin_time, full_name, hidden, settle, visiting, wait_for

GROUP, HELP = "node", "nodes of the running graph: list, info"
_TYPED = list[tuple[str, list[str]]]


def add_verbs(verbs: Any) -> None:
    """Add the group's verbs."""
    several = verbs.add_parser("list", help="names of all nodes")
    several.add_argument("-a", "--all", action="store_true", help="hidden ones, too")
    several.add_argument("-c", "--count-nodes", action="store_true", help="only how many")
    add_spin_time(several)
    several.set_defaults(carry_out=_list)
    info = verbs.add_parser("info", help="what a node publishes, hears, serves and calls")
    info.add_argument("node")
    info.add_argument("--include-hidden", action="store_true", help="hidden topics and services, too")
    add_spin_time(info)
    info.set_defaults(carry_out=_info)


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes, sorted."""
    return sorted(full_name(namespace, name) for name, namespace in node.get_node_names_and_namespaces())


def find_node(node: Node, wanted: str) -> tuple[str, str]:
    """Return name and namespace of a node once it is found; raises UserError."""
    wanted = absolute(wanted)
    wait_for(lambda: wanted in node_names(node), f"there is no node {wanted}")
    namespace, _, name = wanted.rpartition("/")
    return name, namespace or "/"


def _list(options: argparse.Namespace) -> None:
    with visiting() as node:
        settle(node, options.spin_time)
        found = [name for name in node_names(node) if options.all or not hidden(name)]
    print(len(found) if options.count_nodes else "\n".join(found))


def _info(options: argparse.Namespace) -> None:
    with visiting() as node:
        name, namespace = find_node(node, options.node)
        settle(node, options.spin_time)
        sections: dict[str, _TYPED] = {
            "Subscribers": node.get_subscriber_names_and_types_by_node(name, namespace),
            "Publishers": node.get_publisher_names_and_types_by_node(name, namespace),
            "Service Servers": node.get_service_names_and_types_by_node(name, namespace),
            "Service Clients": node.get_client_names_and_types_by_node(name, namespace),
        }
    print(full_name(namespace, name))
    for title, entries in sections.items():
        print(f"  {title}:")
        for entry, kinds in sorted(entries):
            if options.include_hidden or not hidden(entry):
                print(f"    {entry}: {', '.join(kinds)}")
