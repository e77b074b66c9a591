# SPDX-License-Identifier: Apache-2.0
"""Stand-in for the `ros2` command where only the ROS wheels are installed.

`ros2 run` is here; the other verbs are hydro_bridge's (`hydro_bridge.nodes.verbs`).
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

USAGE = """\
usage: ros2 run PACKAGE EXECUTABLE [ARGUMENT ...]
       ros2 run PACKAGE                    list its executables
       ros2 topic list|echo|hz ...
       ros2 node list
       ros2 service call ...
       ros2 param get|set ...

A stand-in for where ROS 2 comes from wheels; every other command needs a full ROS 2 Jazzy."""
VERBS = ("node", "param", "service", "topic")
"""Groups that hydro_bridge carries out."""


class UsageError(Exception):
    """What is wrong with the command line, as one sentence."""


def executables(prefix: str, package: str) -> dict[str, str]:
    """Return the executables of a package by name, with their paths."""
    folder = Path(prefix, "lib", package)
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {file.name: str(file) for file in files if file.is_file() and os.access(file, os.X_OK)}


def executables_of(package: str) -> dict[str, str]:
    """Return a package's executables, found by the ament index."""
    try:
        return executables(get_package_prefix(package), package)
    except (PackageNotFoundError, ValueError) as error:
        sentence = f"package '{package}' not found: is the workspace sourced (`source install/setup.bash`)?"
        raise UsageError(sentence) from error


def run(arguments: list[str]) -> None:
    """List a package's executables, or become one of them: signals and the exit status are then the node's own."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        return
    package, *rest = arguments
    found = executables_of(package)
    if not rest or rest[0] in ("-h", "--help"):
        print("\n".join(found))
        return
    name, *options = rest
    if name not in found:
        raise UsageError(f"package '{package}' has no executable '{name}'; it has: {', '.join(found) or 'none'}")
    os.execv(found[name], [found[name], *options])


def carry_out(arguments: list[str]) -> None:
    """Hand a command line to hydro_bridge, which ends this process with its exit status."""
    try:
        verbs = import_module("hydro_bridge.nodes.verbs")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("hydro_bridge", "hydro_msgs"):
            raise
        sentence = f"`ros2 {arguments[0]}` is part of this workspace: source install/setup.bash"
        raise UsageError(sentence) from error
    sys.argv = ["ros2", *arguments]
    verbs.main()


def main(arguments: list[str]) -> int:
    """Carry out the command line; returns the exit status."""
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            print(USAGE)
        elif arguments[0] == "run":
            run(arguments[1:])
        elif arguments[0] in VERBS:
            carry_out(arguments)
        else:
            raise UsageError(f"`ros2 {' '.join(arguments[:2])}` needs a full ROS 2 Jazzy; see `ros2 --help`.")
    except UsageError as error:
        print(f"ros2: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
