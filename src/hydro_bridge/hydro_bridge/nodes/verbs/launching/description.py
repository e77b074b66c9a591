# SPDX-License-Identifier: Apache-2.0
"""The part of `launch` and `launch_ros` that our launch files are written in, under upstream's names and arguments.

An argument that is not listed here is refused by Python, a name by `modules`: nothing is quietly left out.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any, TypeAlias

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from hydro_bridge.cli.console import UserError

_YES, _NO = ("true", "1"), ("false", "0")


class LaunchContext:
    """Values of the arguments by now."""

    def __init__(self, values: dict[str, str]) -> None:
        self.launch_configurations = values


class Substitution:
    """Words that are known once the arguments are."""

    def perform(self, context: LaunchContext) -> str:
        """The words; raises UserError."""
        raise NotImplementedError


Words: TypeAlias = "str | int | float | Path | Substitution"


def performed(words: Words, context: LaunchContext) -> str:
    """Words as they are now; raises UserError."""
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
        """Its value; raises UserError for one that is not set."""
        if self.variable_name not in context.launch_configurations:
            raise UserError(f"{self.variable_name}:= is needed")
        return context.launch_configurations[self.variable_name]


@dataclass
class PathJoinSubstitution(Substitution):
    """Parts of a path."""

    substitutions: Sequence[Words]

    def perform(self, context: LaunchContext) -> str:
        """The path."""
        return os.path.join(*(performed(part, context) for part in self.substitutions))


@dataclass
class FindPackageShare(Substitution):
    """Folder of what a package shares."""

    package: str

    def perform(self, context: LaunchContext) -> str:
        """The folder; raises UserError."""
        return share_of(self.package)


def share_of(package: str) -> str:
    """Folder of what a package shares; raises UserError."""
    try:
        return str(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise UserError(f"package '{package}' not found: is the workspace sourced?") from None


@dataclass
class ExecutableInPackage(Substitution):
    """Of `ExecuteProcess`, the program: one of a package's executables."""

    executable: str
    package: str

    def perform(self, context: LaunchContext) -> str:
        """Package and executable, for a message."""
        return f"{self.package} {self.executable}"


@dataclass
class IfCondition:
    """Whether something is wanted."""

    predicate_expression: Words

    def evaluate(self, context: LaunchContext) -> bool:
        """Raises UserError for what is neither yes nor no."""
        word = performed(self.predicate_expression, context).strip().lower()
        if word not in _YES + _NO:
            raise UserError(f"{word!r} is neither true nor false")
        return word in _YES


class LaunchDescriptionEntity:
    """One thing in a launch file; what it stands for is found out in the order of the file."""

    condition: IfCondition | None = None

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """What it consists of; raises UserError."""
        return ()


@dataclass
class LaunchDescription(LaunchDescriptionEntity):
    """A list of such things."""

    entities: Sequence[LaunchDescriptionEntity] = ()

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """The list."""
        return self.entities


@dataclass
class DeclareLaunchArgument(LaunchDescriptionEntity):
    """An argument `name:=value`."""

    name: str
    default_value: Words | None = field(default=None, kw_only=True)
    description: str = field(default="", kw_only=True)
    choices: Sequence[str] | None = field(default=None, kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """Nothing; sets the default, and raises UserError for a value that is missing or refused."""
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
    """Another launch file."""

    launch_file_path: Words


@dataclass
class IncludeLaunchDescription(LaunchDescriptionEntity):
    """What another launch file describes; its arguments stay set, as upstream's do."""

    launch_description_source: PythonLaunchDescriptionSource
    launch_arguments: Iterable[tuple[str, Words]] = field(default=(), kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """The other file's description; raises UserError."""
        from hydro_bridge.nodes.verbs.launching.modules import load

        for name, words in self.launch_arguments:
            context.launch_configurations[name] = performed(words, context)
        return [load(Path(performed(self.launch_description_source.launch_file_path, context)))]


@dataclass
class OpaqueFunction(LaunchDescriptionEntity):
    """A function of the arguments that gives more of it."""

    function: Callable[[LaunchContext], Iterable[LaunchDescriptionEntity] | None] = field(kw_only=True)

    def visit(self, context: LaunchContext) -> Iterable[LaunchDescriptionEntity]:
        """What the function gives; raises UserError with what it says."""
        try:
            return self.function(context) or ()
        except (RuntimeError, TypeError, AttributeError) as error:
            raise UserError(str(error)) from None


@dataclass
class Shutdown(LaunchDescriptionEntity):
    """As `on_exit` of a process: all others end with it."""

    reason: str = field(default="", kw_only=True)


@dataclass
class ExecuteProcess(LaunchDescriptionEntity):
    """A program of a package that is no node."""

    cmd: Sequence[Words] = field(kw_only=True)
    output: str = field(default="log", kw_only=True)
    emulate_tty: bool = field(default=False, kw_only=True)
    sigterm_timeout: Words = field(default="5", kw_only=True)
    on_exit: Shutdown | None = field(default=None, kw_only=True)
    condition: IfCondition | None = field(default=None, kw_only=True)

    def patience(self, context: LaunchContext) -> float:
        """How long it may take to end [s]; raises UserError."""
        words = performed(self.sigterm_timeout, context)
        with suppress(ValueError):
            if 0.0 <= (seconds := float(words)) < inf:
                return seconds
        raise UserError(f"sigterm_timeout {words}: a number of seconds, 0 or more, is meant")

    def command(self, context: LaunchContext) -> tuple[str, str, list[str]]:
        """Package, executable and its words; raises UserError."""
        program, *words = self.cmd
        if not isinstance(program, ExecutableInPackage):
            raise UserError(f"{performed(program, context)}: a process that is no executable of a package")
        return program.package, program.executable, [performed(word, context) for word in words]


class Node(ExecuteProcess):
    """A node."""

    def __init__(self, *, package: str, executable: str, arguments: Sequence[Words] = (), **options: Any) -> None:
        super().__init__(cmd=[ExecutableInPackage(executable, package), *arguments], **options)
