# SPDX-License-Identifier: Apache-2.0
"""Subset of `launch` and `launch_ros` used by our launch files, under upstream's names and arguments.

Unsupported arguments are refused by Python, unsupported names by `modules`: nothing is silently ignored.
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
        from hydro_bridge.nodes.verbs.launching.modules import load

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
        raise UserError(f"sigterm_timeout {words}: a number of seconds, 0 or more, is meant")

    def command(self, context: LaunchContext) -> tuple[str, str, list[str]]:
        """Return package, executable and arguments; raises UserError."""
        program, *words = self.cmd
        if not isinstance(program, ExecutableInPackage):
            raise UserError(f"{performed(program, context)}: a process that is no executable of a package")
        return program.package, program.executable, [performed(word, context) for word in words]


class Node(ExecuteProcess):
    """ROS node."""

    def __init__(self, *, package: str, executable: str, arguments: Sequence[Words] = (), **options: Any) -> None:
        super().__init__(cmd=[ExecutableInPackage(executable, package), *arguments], **options)
