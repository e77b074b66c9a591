# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch`: what our launch files use of `launch` and `launch_ros`, under upstream's names and arguments.

Unsupported arguments are refused by Python, unsupported names by the import: nothing is silently ignored. Processes are
stopped in reverse order, so that controllers end before the plant.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from hydro_bridge.cli.console import UserError
from hydro_bridge.process.endings import undisturbed
from hydro_bridge.ros.companion import Companion

_YES, _NO = ("true", "1"), ("false", "0")


class LaunchContext:
    """Present values of the arguments."""

    def __init__(self, values: dict[str, str]) -> None:
        self.launch_configurations = values


class Substitution:
    """Text that is evaluated once the arguments are known."""

    def perform(self, context: LaunchContext) -> str:
        """Return the text; raises UserError."""
        raise NotImplementedError


Words: TypeAlias = "str | int | float | Path | Substitution"


def performed(words: Words, context: LaunchContext) -> str:
    """Return the evaluated text; raises UserError."""
    if isinstance(words, Substitution):
        return words.perform(context)
    if isinstance(words, (str, int, float, Path)):
        return str(words)
    raise UserError(f"{words!r}: words that need a full ROS 2 Jazzy")


@dataclass
class LaunchConfiguration(Substitution):
    """Value of an argument."""

    variable_name: str

    def perform(self, context: LaunchContext) -> str:
        """Return its value; raises UserError if it is not set."""
        if self.variable_name not in context.launch_configurations:
            raise UserError(f"{self.variable_name}:= is needed")
        return context.launch_configurations[self.variable_name]


@dataclass
class PathJoinSubstitution(Substitution):
    """Parts of a path."""

    substitutions: Sequence[Words]

    def perform(self, context: LaunchContext) -> str:
        """Return the path."""
        return os.path.join(*(performed(part, context) for part in self.substitutions))


@dataclass
class FindPackageShare(Substitution):
    """Share folder of a package."""

    package: str

    def perform(self, context: LaunchContext) -> str:
        """Return the folder; raises UserError."""
        return share_of(self.package)


def share_of(package: str) -> str:
    """Return a package's share folder; raises UserError."""
    try:
        return str(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise UserError(f"package '{package}' not found: is the workspace sourced?") from None


@dataclass
class ExecutableInPackage(Substitution):
    """Program of an `ExecuteProcess`: one of a package's executables."""

    executable: str
    package: str

    def perform(self, context: LaunchContext) -> str:
        """Return package and executable, for a message."""
        return f"{self.package} {self.executable}"


@dataclass
class IfCondition:
    """Condition on an action."""

    predicate_expression: Words

    def evaluate(self, context: LaunchContext) -> bool:
        """Return the condition's value; raises UserError if it is neither true nor false."""
        word = performed(self.predicate_expression, context).strip().lower()
        if word not in _YES + _NO:
            raise UserError(f"{word!r} is neither true nor false")
        return word in _YES


class LaunchDescriptionEntity:
    """Entry of a launch file; entries are expanded in the order of the file."""

    condition: IfCondition | None = None

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Return the entries that it expands to; raises UserError."""
        return ()


@dataclass
class LaunchDescription(LaunchDescriptionEntity):
    """List of entries."""

    entities: Sequence[LaunchDescriptionEntity] = ()

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Return the list."""
        return self.entities


@dataclass
class DeclareLaunchArgument(LaunchDescriptionEntity):
    """Declaration of an argument `name:=value`."""

    name: str
    default_value: Words | None = field(default=None, kw_only=True)
    description: str = field(default="", kw_only=True)
    choices: Sequence[str] | None = field(default=None, kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Set the default and return nothing; raises UserError for a missing or invalid value."""
        values = context.launch_configurations
        if self.name not in values:
            if self.default_value is None:
                raise UserError(f"{self.name}:= is needed: {self.description}")
            values[self.name] = performed(self.default_value, context)
        value = values[self.name]
        if self.choices is not None and value not in self.choices:
            raise UserError(f"{self.name}:={value}: {', '.join(self.choices)} can be chosen")
        return ()


@dataclass
class PythonLaunchDescriptionSource:
    """Reference to another launch file."""

    launch_file_path: Words


@dataclass
class IncludeLaunchDescription(LaunchDescriptionEntity):
    """Inclusion of another launch file; its arguments stay set, as upstream's do."""

    launch_description_source: PythonLaunchDescriptionSource
    launch_arguments: Iterable[tuple[str, Words]] = field(default=(), kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Return the other file's description; raises UserError."""
        for name, words in self.launch_arguments:
            context.launch_configurations[name] = performed(words, context)
        return [load(Path(performed(self.launch_description_source.launch_file_path, context)))]


@dataclass
class OpaqueFunction(LaunchDescriptionEntity):
    """Function of the arguments that returns further entries."""

    function: Callable[[LaunchContext], Iterable[LaunchDescriptionEntity] | None] = field(kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Return the function's entries; raises UserError with its error message."""
        try:
            return self.function(context) or ()
        except (RuntimeError, TypeError, AttributeError) as error:
            raise UserError(str(error)) from None


@dataclass
class Shutdown(LaunchDescriptionEntity):
    """As `on_exit` of a process: ends all others with it."""

    reason: str = field(default="", kw_only=True)


@dataclass
class ExecuteProcess(LaunchDescriptionEntity):
    """Executable of a package that is not a node."""

    cmd: Sequence[Words] = field(kw_only=True)
    output: str = field(default="log", kw_only=True)
    emulate_tty: bool = field(default=False, kw_only=True)
    sigterm_timeout: Words = field(default="5", kw_only=True)
    on_exit: Shutdown | None = field(default=None, kw_only=True)
    condition: IfCondition | None = field(default=None, kw_only=True)

    def patience(self, context: LaunchContext) -> float:
        """Time allowed for it to end [s]; raises UserError."""
        words = performed(self.sigterm_timeout, context)
        with suppress(ValueError):
            if 0.0 <= (seconds := float(words)) < inf:
                return seconds
        raise UserError(f"sigterm_timeout {words}: must be a number of seconds, 0 or more")

    def command(self, context: LaunchContext) -> tuple[str, str, list[str]]:
        """Return package, executable and arguments; raises UserError."""
        program, *words = self.cmd
        if not isinstance(program, ExecutableInPackage):
            raise UserError(f"{performed(program, context)}: a process that is not an executable of a package")
        return program.package, program.executable, [performed(word, context) for word in words]


class Node(ExecuteProcess):
    """ROS node."""

    def __init__(self, *, package: str, executable: str, arguments: Sequence[Words] = (), **options: Any) -> None:
        super().__init__(cmd=[ExecutableInPackage(executable, package), *arguments], **options)


_MODULES = {
    "launch": ("LaunchContext", "LaunchDescription", "LaunchDescriptionEntity", "Substitution"),
    "launch.actions": (
        "DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription", "OpaqueFunction", "Shutdown",
    ),
    "launch.conditions": ("IfCondition",),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.substitutions": ("ExecutableInPackage", "FindPackageShare"),
}  # fmt: skip


def provide() -> None:
    """Make the classes of `description` importable as `launch` and `launch_ros` in this process."""
    for name, names in _MODULES.items():
        module = ModuleType(name)
        module.__path__ = []
        for one in names:
            setattr(module, one, globals()[one])
        sys.modules[name] = module
        package, _, last = name.rpartition(".")
        if package:
            setattr(sys.modules[package], last, module)


def load(path: Path) -> LaunchDescription:
    """Load a launch file's description.

    Raises UserError: the file is missing, is not a launch file in Python, or uses unsupported features.
    """
    scope: dict[str, object] = {"__name__": "launch_file", "__file__": str(path)}
    try:
        exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), scope)
        made = scope["generate_launch_description"]()  # type: ignore[operator]
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from None
    except (ImportError, AttributeError, NameError, TypeError) as error:
        raise UserError(f"{path.name} needs a full ROS 2 Jazzy: {error}") from None
    except (KeyError, SyntaxError, UnicodeDecodeError):
        raise UserError(f"{path.name} is not a launch file in Python") from None
    if not isinstance(made, LaunchDescription):
        raise UserError(f"{path.name} describes nothing to launch")
    return made


_LOOK = 0.1  # s


def processes(entity: LaunchDescriptionEntity, context: LaunchContext) -> Iterator[ExecuteProcess]:
    """Return all processes of a description whose conditions hold, in its order; raises UserError."""
    if entity.condition is not None and not entity.condition.evaluate(context):
        return
    if isinstance(entity, ExecuteProcess):
        yield entity
    for part in entity.visit(context):
        yield from processes(part, context)


def run(entity: LaunchDescriptionEntity, values: dict[str, str]) -> int:
    """Start all processes, and wait until all of them, or one that shuts down the others, have ended.

    Returns
    -------
    0, or 1 if a process that ended by itself had a non-zero exit status.

    Raises
    ------
    UserError
        An argument is missing or refused; nothing was started.
    CompanionError
        An executable is missing; the processes already started have been ended.
    """
    context = LaunchContext(values)
    wanted = list(processes(entity, context))
    planned = [(process, process.patience(context), process.command(context)) for process in wanted]
    if not planned:
        raise UserError("nothing is to be started")
    started: list[tuple[Companion, ExecuteProcess]] = []
    patience: dict[Companion, float] = {}
    try:
        for number, (process, seconds, (package, executable, words)) in enumerate(planned, 1):
            name = f"{executable}-{number}"
            companion = Companion(package, executable, words, name=name, output=sys.stdout)
            patience[companion] = seconds
            started.append((companion, process))
            print(f"[INFO] [{name}]: process started with pid [{companion.process.pid}]", flush=True)
        return _follow(started)
    finally:
        with undisturbed():
            for companion, _ in reversed(started):
                companion.stop(patience[companion])


def _follow(started: list[tuple[Companion, ExecuteProcess]]) -> int:
    running, failed = list(started), False
    while running:
        time.sleep(_LOOK)
        for companion, process in list(running):
            if companion.running:
                continue
            running.remove((companion, process))
            status = companion.process.returncode
            failed = failed or status != 0
            how = "process has finished cleanly" if status == 0 else f"process has died, exit code {status}"
            print(f"[{'ERROR' if status else 'INFO'}] [{companion.name}]: {how}", flush=True)
            if process.on_exit is not None:
                print(f"[INFO] [launch]: {process.on_exit.reason or 'shutdown'}", flush=True)
                return int(failed)
    return int(failed)


def add_group(groups: Any) -> None:
    """Add the command."""
    parser = groups.add_parser("launch", help="start what a launch file describes", allow_abbrev=False)
    parser.add_argument("package", help="or the path of a launch file")
    parser.add_argument("rest", nargs="*", metavar="FILE NAME:=VALUE", help="launch file and its arguments")
    parser.set_defaults(carry_out=_launch)


def _launch(options: argparse.Namespace) -> int:
    provide()
    file, words = _file(options.package, options.rest)
    return run(load(file), _values(words))


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
            raise UserError(f"{word}: must be name:=value")
    return {name: value for name, _, value in (word.partition(":=") for word in words)}
