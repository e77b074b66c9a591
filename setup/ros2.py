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


class UsageError(Exception):
    """What is wrong with the command line, as one sentence."""


def executables(package: str) -> dict[str, str]:
    """Return a package's executables by name, with their paths."""
    try:
        folder = Path(get_package_prefix(package), "lib", package)
    except (PackageNotFoundError, ValueError) as error:
        sentence = f"package '{package}' not found: is the workspace sourced (`source install/setup.bash`)?"
        raise UsageError(sentence) from error
    return {file.name: str(file) for file in sorted(folder.glob("*")) if file.is_file() and os.access(file, os.X_OK)}


def carry_out(arguments: list[str]) -> None:
    """Carry out a command line: `ros2 run` becomes the executable, whose signals and exit status are its own."""
    match arguments:
        case [] | ["-h" | "--help"] | ["run"] | ["run", "-h" | "--help"]:
            print(USAGE)
        case ["run", package] | ["run", package, "-h" | "--help"]:
            print("\n".join(executables(package)))
        case ["run", package, name, *options]:
            found = executables(package)
            if name not in found:
                has = ", ".join(found) or "none"
                raise UsageError(f"package '{package}' has no executable '{name}'; it has: {has}")
            os.execv(found[name], [found[name], *options])
        case ["node" | "param" | "service" | "topic" as verb, *_]:
            try:
                verbs = import_module("hydro_bridge.nodes.verbs")
            except ModuleNotFoundError as error:
                if (error.name or "").partition(".")[0] not in ("hydro_bridge", "hydro_msgs"):
                    raise
                raise UsageError(f"`ros2 {verb}` is part of this workspace: source install/setup.bash") from error
            sys.argv = ["ros2", *arguments]
            verbs.main()
        case _:
            raise UsageError(f"`ros2 {' '.join(arguments[:2])}` needs a full ROS 2 Jazzy; see `ros2 --help`.")


def main(arguments: list[str]) -> int:
    """Carry out the command line; returns the exit status."""
    try:
        carry_out(arguments)
    except UsageError as error:
        print(f"ros2: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
