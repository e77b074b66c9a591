# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch`: the part of `launch` and `launch_ros` that our launch files use, with upstream's names and arguments.

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
from hydro_core.process.termination import signals_ignored


@dataclass
class LaunchContext:
    """Present values of the launch arguments."""

    launch_configurations: dict[str, str]


@dataclass
class Substitution:
    """Substitution: text that is evaluated once the launch arguments are known."""

    perform: Callable[[LaunchContext], str]
    """Returns the text; raises UserError."""


SomeSubstitutions: TypeAlias = "str | int | float | Path | Substitution"


def perform_substitution(words: SomeSubstitutions | ExecutableInPackage, context: LaunchContext) -> str:
    """Return the text of a substitution or a plain value; raises UserError."""
    if isinstance(words, Substitution):
        return words.perform(context)
    if isinstance(words, (str, int, float, Path)):
        return str(words)
    raise UserError(f"{words!r}: words that need a full ROS 2 Jazzy")


def LaunchConfiguration(variable_name: str) -> Substitution:
    """Substitution by the value of a launch argument; UserError if it is not set."""

    def value(context: LaunchContext) -> str:
        if variable_name not in context.launch_configurations:
            raise UserError(f"{variable_name}:= is needed")
        return context.launch_configurations[variable_name]

    return Substitution(value)


def PathJoinSubstitution(substitutions: Sequence[SomeSubstitutions]) -> Substitution:
    """Substitution by a path joined from its parts."""
    return Substitution(lambda context: os.path.join(*(perform_substitution(part, context) for part in substitutions)))


def FindPackageShare(package: str) -> Substitution:
    """Substitution by the share folder of a package."""
    return Substitution(lambda context: package_share(package))


def package_share(package: str) -> str:
    """Return a package's share folder; raises UserError."""
    try:
        return str(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise UserError(f"package '{package}' not found: is the workspace sourced?") from None


def IfCondition(predicate_expression: SomeSubstitutions) -> Callable[[LaunchContext], bool]:
    """Condition for starting a process; UserError if it is neither true nor false."""
    values = {"true": True, "1": True, "false": False, "0": False}

    def holds(context: LaunchContext) -> bool:
        word = perform_substitution(predicate_expression, context).strip().lower()
        if word not in values:
            raise UserError(f"{word!r} is neither true nor false")
        return values[word]

    return holds


@dataclass
class LaunchDescriptionEntity:
    """Entry of a launch file other than a process; expanded in the order of the file."""

    visit: Callable[[LaunchContext], LaunchEntries]
    """Returns the entries that it expands to; raises UserError."""


LaunchEntries: TypeAlias = "Iterable[LaunchDescriptionEntity | ExecuteProcess]"


def LaunchDescription(entities: LaunchEntries = ()) -> LaunchDescriptionEntity:
    """Launch description: a list of entries."""
    return LaunchDescriptionEntity(lambda context: entities)


def DeclareLaunchArgument(
    name: str,
    *,
    default_value: SomeSubstitutions | None = None,
    description: str = "",
    choices: Sequence[str] | None = None,
) -> LaunchDescriptionEntity:
    """Declaration of an argument `name:=value`; UserError for a missing or invalid value."""

    def declare(context: LaunchContext) -> LaunchEntries:
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

    def include(context: LaunchContext) -> LaunchEntries:
        for name, words in launch_arguments:
            context.launch_configurations[name] = perform_substitution(words, context)
        return [load(Path(perform_substitution(launch_description_source, context)))]

    return LaunchDescriptionEntity(include)


def OpaqueFunction(*, function: Callable[[LaunchContext], LaunchEntries | None]) -> LaunchDescriptionEntity:
    """Function of the arguments that returns further entries; its error becomes a UserError."""

    def call(context: LaunchContext) -> LaunchEntries:
        try:
            return function(context) or ()
        except (RuntimeError, TypeError, AttributeError) as error:
            raise UserError(str(error)) from None

    return LaunchDescriptionEntity(call)


@dataclass(kw_only=True)
class Shutdown:
    """Value of `on_exit` of a process: its end shuts down all other processes."""

    reason: str = ""


@dataclass
class ExecutableInPackage:
    """Program of an `ExecuteProcess`: one of a package's executables."""

    executable: str
    package: str


@dataclass(kw_only=True)
class ExecuteProcess:
    """Process of a launch file: an executable of a package, with its arguments."""

    cmd: Sequence[SomeSubstitutions | ExecutableInPackage]
    output: str = "log"
    emulate_tty: bool = False
    sigterm_timeout: SomeSubstitutions = "5"
    """Time [s] to end before SIGKILL."""
    on_exit: Shutdown | None = None
    condition: Callable[[LaunchContext], bool] | None = None


def Node(
    *, package: str, executable: str, arguments: Sequence[SomeSubstitutions] = (), **options: Any
) -> ExecuteProcess:
    """Process of a ROS node."""
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


def processes(entity: LaunchDescriptionEntity | ExecuteProcess, context: LaunchContext) -> Iterator[ExecuteProcess]:
    """Yield all processes of a description whose conditions hold, in its order; raises UserError."""
    if isinstance(entity, ExecuteProcess):
        if entity.condition is None or entity.condition(context):
            yield entity
    elif isinstance(entity, LaunchDescriptionEntity):
        for part in entity.visit(context):
            yield from processes(part, context)
    else:
        raise UserError(f"{entity!r}: an entry that needs a full ROS 2 Jazzy")


_POLL_PERIOD = 0.1  # s


def run(entity: LaunchDescriptionEntity, values: dict[str, str]) -> int:
    """Start all processes, and wait until all of them, or one that shuts down the others, have ended.

    Returns 0, or 1 if a process that ended by itself had a non-zero exit status. Raises UserError: an argument is
    missing or refused; nothing was started. CompanionError: an executable is missing; the processes already started
    have been ended.
    """
    context = LaunchContext(values)
    planned = []
    for process in list(processes(entity, context)):
        program, *rest = process.cmd
        if not isinstance(program, ExecutableInPackage):
            said = perform_substitution(program, context)
            raise UserError(f"{said}: a process that is not an executable of a package")
        words = [perform_substitution(word, context) for word in rest]
        planned.append((process, program, words, float(perform_substitution(process.sigterm_timeout, context))))
    if not planned:
        raise UserError("nothing is to be started")
    started: list[tuple[Companion, float]] = []
    running: list[tuple[Companion, Shutdown | None]] = []
    failed = False
    try:
        for number, (process, program, words, patience) in enumerate(planned, 1):
            name, output = f"{program.executable}-{number}", partial(print, end="", flush=True)
            companion = Companion(program.package, program.executable, words, name=name, output=output)
            started.append((companion, patience))
            running.append((companion, process.on_exit))
            print(f"[INFO] [{name}]: process started with pid [{companion.process.pid}]", flush=True)
        while running:
            time.sleep(_POLL_PERIOD)
            for companion, on_exit in [one for one in running if not one[0].running]:
                running.remove((companion, on_exit))
                status = companion.process.returncode
                failed = failed or status != 0
                how = "process has finished cleanly" if status == 0 else f"process has died, exit code {status}"
                print(f"[{'ERROR' if status else 'INFO'}] [{companion.name}]: {how}", flush=True)
                if on_exit is not None:
                    print(f"[INFO] [launch]: {on_exit.reason or 'shutdown'}", flush=True)
                    return int(failed)
        return int(failed)
    finally:
        with signals_ignored():
            for companion, patience in reversed(started):
                companion.stop(patience)


def launch(package: str, rest: list[str]) -> int:
    """Run `ros2 launch PACKAGE REST...`; returns the exit status and raises as `run`.

    Imports of `launch` and `launch_ros` in this process resolve to the classes of this module.
    """
    for name, names in _MODULES.items():
        module = ModuleType(name)
        module.__path__ = []
        for one in names:
            setattr(module, one, globals()[one])
        sys.modules[name] = module
        above, _, last = name.rpartition(".")
        if above:
            setattr(sys.modules[above], last, module)
    path, words = Path(package), rest
    if not path.is_file():
        files = {file.name: file for file in sorted(Path(package_share(package), "launch").glob("*.launch.py"))}
        if not rest or rest[0] not in files:
            raise UserError(f"ros2 launch {package}: which launch file? It has: {', '.join(files) or 'none'}")
        path, words = files[rest[0]], rest[1:]
    values = {}
    for word in words:
        name, given, value = word.partition(":=")
        if not given:
            raise UserError(f"{word}: must be name:=value")
        values[name] = value
    return run(load(path), values)
