# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic|node|param|service|bag|launch ...` without a full ROS 2."""

from __future__ import annotations

import argparse
from typing import NoReturn

from hydro_bridge.cli.console import UserError, command
from hydro_bridge.nodes.verbs import bags, names, parameters, services, topics
from hydro_bridge.nodes.verbs.launching import verb as launching
from hydro_bridge.ros.companion import CompanionError


class Parser(argparse.ArgumentParser):
    """Parser whose error is one sentence, which names where to find unsupported commands."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line; raises UserError."""
        raise UserError(f"{self.prog}: {message}; what is not in `{self.prog} --help` needs a full ROS 2 Jazzy")


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = Parser(prog="ros2", description=__doc__)
    groups = result.add_subparsers(dest="group", required=True, metavar="GROUP", parser_class=Parser)
    for module in (topics, names, parameters, services, bags):
        group = groups.add_parser(module.GROUP, help=module.HELP, description=module.HELP, allow_abbrev=False)
        verbs = group.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)
        module.add_verbs(verbs)
    launching.add_group(groups)
    return result


@command(CompanionError)
def main() -> int | None:
    """Entry point."""
    options = parser().parse_args()
    status: int | None = options.carry_out(options)
    return status


if __name__ == "__main__":
    main()
