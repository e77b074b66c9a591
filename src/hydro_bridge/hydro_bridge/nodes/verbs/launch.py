# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch`: what our launch files use of `launch` and `launch_ros`, under upstream's names and arguments.

Unsupported arguments are refused by Python, unsupported names by the import: nothing is silently ignored. Processes are
stopped in reverse order, so that controllers end before the plant.
"""

# ruff: noqa: N802
from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from hydro_bridge.ros.companion import Companion
from hydro_core.cli.console import UserError
from hydro_core.process.endings import signals_ignored

_YES, _NO = ("true", "1"), ("false", "0")


@dataclass
class LaunchContext:
    """Present values of the arguments."""

    launch_configurations: dict[str, str]


@dataclass
class Substitution:
    """Text that is evaluated once the arguments are known."""

    perform: Callable[[LaunchContext], str]
    """Returns the text; raises UserError."""


SomeSubstitutions: TypeAlias = "str | int | float | Path | Substitution"


def perform_substitution(words: SomeSubstitutions | ExecutableInPackage, context: LaunchContext) -> str:
    """Return the evaluated text; raises UserError."""
    if isinstance(words, Substitution):
        return words.perform(context)
    if isinstance(words, (str, int, float, Path)):
        return str(words)
    raise UserError(f"{words!r}: words that need a full ROS 2 Jazzy")


def LaunchConfiguration(variable_name: str) -> Substitution:
    """Value of an argument; UserError if it is not set."""

    def value(context: LaunchContext) -> str:
        if variable_name not in context.launch_configurations:
            raise UserError(f"{variable_name}:= is needed")
        return context.launch_configurations[variable_name]

    return Substitution(value)


def PathJoinSubstitution(substitutions: Sequence[SomeSubstitutions]) -> Substitution:
    """Parts of a path."""
    return Substitution(lambda context: os.path.join(*(perform_substitution(part, context) for part in substitutions)))


def FindPackageShare(package: str) -> Substitution:
    """Share folder of a package."""
    return Substitution(lambda context: package_share(package))


def package_share(package: str) -> str:
    """Return a package's share folder; raises UserError."""
    try:
        return str(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise UserError(f"package '{package}' not found: is the workspace sourced?") from None


def IfCondition(predicate_expression: SomeSubstitutions) -> Callable[[LaunchContext], bool]:
    """Condition on a process; UserError if it is neither true nor false."""

    def holds(context: LaunchContext) -> bool:
        word = perform_substitution(predicate_expression, context).strip().lower()
        if word not in _YES + _NO:
            raise UserError(f"{word!r} is neither true nor false")
        return word in _YES

    return holds


@dataclass
class LaunchDescriptionEntity:
    """Entry of a launch file other than a process; expanded in the order of the file."""

    visit: Callable[[LaunchContext], Entries]
    """Returns the entries that it expands to; raises UserError."""


Entries: TypeAlias = "Iterable[LaunchDescriptionEntity | ExecuteProcess]"


def LaunchDescription(entities: Entries = ()) -> LaunchDescriptionEntity:
    """List of entries."""
    return LaunchDescriptionEntity(lambda context: entities)


def DeclareLaunchArgument(
    name: str,
    *,
    default_value: SomeSubstitutions | None = None,
    description: str = "",
    choices: Sequence[str] | None = None,
) -> LaunchDescriptionEntity:
    """Declaration of an argument `name:=value`; UserError for a missing or invalid value."""

    def declare(context: LaunchContext) -> Entries:
        values = context.launch_configurations
        if name not in values:
            if default_value is None:
                raise UserError(f"{name}:= is needed: {description}")
            values[name] = perform_substitution(default_value, context)
        if choices is not None and values[name] not in choices:
            raise UserError(f"{name}:={values[name]}: {', '.join(choices)} can be chosen")
        return ()

    return LaunchDescriptionEntity(declare)


def PythonLaunchDescriptionSource(launch_file_path: SomeSubstitutions) -> SomeSubstitutions:
    """Reference to another launch file."""
    return launch_file_path


def IncludeLaunchDescription(
    launch_description_source: SomeSubstitutions, *, launch_arguments: Iterable[tuple[str, SomeSubstitutions]] = ()
) -> LaunchDescriptionEntity:
    """Inclusion of another launch file; its arguments stay set, as upstream's do."""

    def include(context: LaunchContext) -> Entries:
        for name, words in launch_arguments:
            context.launch_configurations[name] = perform_substitution(words, context)
        return [load(Path(perform_substitution(launch_description_source, context)))]

    return LaunchDescriptionEntity(include)


def OpaqueFunction(*, function: Callable[[LaunchContext], Entries | None]) -> LaunchDescriptionEntity:
    """Function of the arguments that returns further entries; its error becomes a UserError."""

    def call(context: LaunchContext) -> Entries:
        try:
            return function(context) or ()
        except (RuntimeError, TypeError, AttributeError) as error:
            raise UserError(str(error)) from None

    return LaunchDescriptionEntity(call)


@dataclass(kw_only=True)
class Shutdown:
    """As `on_exit` of a process: ends all others with it."""

    reason: str = ""


@dataclass
class ExecutableInPackage:
    """Program of an `ExecuteProcess`: one of a package's executables."""

    executable: str
    package: str


@dataclass(kw_only=True)
class ExecuteProcess:
    """Executable of a package that is not a node."""

    cmd: Sequence[SomeSubstitutions | ExecutableInPackage]
    output: str = "log"
    emulate_tty: bool = False
    sigterm_timeout: SomeSubstitutions = "5"
    on_exit: Shutdown | None = None
    condition: Callable[[LaunchContext], bool] | None = None

    def shutdown_timeout(self, context: LaunchContext) -> float:
        """Return the time [s] that the process has to end before SIGKILL."""
        return float(perform_substitution(self.sigterm_timeout, context))

    def command(self, context: LaunchContext) -> tuple[str, str, list[str]]:
        """Return package, executable and arguments; raises UserError."""
        program, *words = self.cmd
        if not isinstance(program, ExecutableInPackage):
            raise UserError(
                f"{perform_substitution(program, context)}: a process that is not an executable of a package"
            )
        return program.package, program.executable, [perform_substitution(word, context) for word in words]


def Node(
    *, package: str, executable: str, arguments: Sequence[SomeSubstitutions] = (), **options: Any
) -> ExecuteProcess:
    """ROS node."""
    return ExecuteProcess(cmd=[ExecutableInPackage(executable, package), *arguments], **options)


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


def install_modules() -> None:
    """Register this module's classes as `launch` and `launch_ros` for imports in this process."""
    for name, names in _MODULES.items():
        module = ModuleType(name)
        module.__path__ = []
        for one in names:
            setattr(module, one, globals()[one])
        sys.modules[name] = module
        package, _, last = name.rpartition(".")
        if package:
            setattr(sys.modules[package], last, module)


def load(path: Path) -> LaunchDescriptionEntity:
    """Load a launch file's description; raises UserError if it is none in Python, or uses unsupported features."""
    scope: dict[str, object] = {"__name__": "launch_file", "__file__": str(path)}
    try:
        exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), scope)
        made: LaunchDescriptionEntity = scope["generate_launch_description"]()  # type: ignore[operator]
    except (ImportError, AttributeError, NameError, TypeError) as error:
        raise UserError(f"{path.name} needs a full ROS 2 Jazzy: {error}") from None
    except (KeyError, SyntaxError, UnicodeDecodeError):
        raise UserError(f"{path.name} is not a launch file in Python") from None
    return made


_LOOK = 0.1  # s


def processes(entity: LaunchDescriptionEntity | ExecuteProcess, context: LaunchContext) -> Iterator[ExecuteProcess]:
    """Return all processes of a description whose conditions hold, in its order; raises UserError."""
    if isinstance(entity, ExecuteProcess):
        if entity.condition is None or entity.condition(context):
            yield entity
    elif isinstance(entity, LaunchDescriptionEntity):
        for part in entity.visit(context):
            yield from processes(part, context)
    else:
        raise UserError(f"{entity!r}: an entry that needs a full ROS 2 Jazzy")


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
    planned = [(process, process.shutdown_timeout(context), process.command(context)) for process in wanted]
    if not planned:
        raise UserError("nothing is to be started")
    started: list[tuple[Companion, ExecuteProcess, float]] = []
    try:
        for number, (process, seconds, (package, executable, words)) in enumerate(planned, 1):
            output = partial(print, end="", flush=True)
            companion = Companion(package, executable, words, name=f"{executable}-{number}", output=output)
            started.append((companion, process, seconds))
            print(f"[INFO] [{companion.name}]: process started with pid [{companion.process.pid}]", flush=True)
        return _follow([(companion, process) for companion, process, _ in started])
    finally:
        with signals_ignored():
            for companion, _, seconds in reversed(started):
                companion.stop(seconds)


def _follow(running: list[tuple[Companion, ExecuteProcess]]) -> int:
    failed = False
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


def launch(package: str, rest: list[str]) -> int:
    """Run `ros2 launch PACKAGE REST...`; returns the exit status and raises as `run`."""
    install_modules()
    file, words = _file(package, rest)
    return run(load(file), _values(words))


def _file(package: str, rest: list[str]) -> tuple[Path, list[str]]:
    """Return the launch file and the words after it; raises UserError."""
    if Path(package).is_file():
        return Path(package), rest
    files = {path.name: path for path in sorted(Path(package_share(package), "launch").glob("*.launch.py"))}
    if not rest or rest[0] not in files:
        raise UserError(f"ros2 launch {package}: which launch file? It has: {', '.join(files) or 'none'}")
    return files[rest[0]], rest[1:]


def _values(words: list[str]) -> dict[str, str]:
    for word in words:
        if ":=" not in word:
            raise UserError(f"{word}: must be name:=value")
    return {name: value for name, _, value in (word.partition(":=") for word in words)}
