# SPDX-License-Identifier: Apache-2.0
"""Processes of a run's plant.

--plant sim         sim with filter, recorder
--plant emulator    emulator, bridge with filter, recorder
--plant bench       bridge with filter, recorder
--plant external    none: everything runs already

The filter is in the plant's process (`hydro_filter.nodes.filtered_plant`). With `--filter none` there is no filter: the
compensated law needs none, and under the paper's law base gains are in force.

The guard is widened to the policy's range of gains, with the filter that this relies on as a parameter. A recording
contains the bench file, and digests of all weights involved.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydro_bridge.ros.companion import Companion, start_dashboard
from hydro_bridge.safety.guard import GuardSettings
from hydro_core.files import bench_digest
from hydro_policy.nodes.announcements import companion_output
from hydro_policy.nodes.graph_node import GraphNode
from hydro_policy.nodes.plant_options import NO_FILTER_WORDS, PlantOptions
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.mdp import GainRange
from hydro_sim.files.learned_bench import shipped_bench

if TYPE_CHECKING:
    from hydro_filter.controller.factory import FilterChoice
    from hydro_filter.controller.loop_filter import LoopFilterSettings

LOAD_FORCE_FILE = "load_force"
"""File, in the folder of the companions, of the last forces on the emulated load (`hydro_sim.files.load_force`)."""


def describe_policy(path: Path) -> str:
    """Return a policy file's identity as text: digest of its weights, as in diagnostics, and SHA-256 of the file."""
    return f"policy {path}: weights {load_policy(path)[0].digest()}, SHA-256 {_digest(path)}"


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def requested_filter(words: Sequence[str], bench: Path | None = None) -> tuple[FilterChoice, LoopFilterSettings]:
    """Return the filter selected by its command-line arguments on this bench; invalid arguments end the program."""
    from hydro_filter.controller.factory import parse_args

    choice, settings, _ = parse_args([*(["--bench", str(bench)] if bench else []), *words])
    return choice, settings


def guard_range(gains: GainRange) -> GainRange:
    """Return the gain changes allowed by the plant's guard: its defaults, widened to the policy's range if larger."""
    return GainRange.enclosing(gains, GuardSettings())


def start_companions(
    stack: ExitStack, options: PlantOptions, gains: GainRange, folder: Path, keep: Callable[[str], None]
) -> list[Companion]:
    """Start plant, filter and recorder, which `stack` stops in reverse order, so that the recorder sees everything.

    `keep` takes each line of their output. Raises CompanionError: the packages are not built or sourced.
    """
    output = companion_output(keep)
    return [
        stack.enter_context(Companion(package, executable, arguments, output=output))
        for package, executable, arguments in commands(options, gains, folder)
    ]


def start_plant(
    stack: ExitStack, node: GraphNode, options: PlantOptions, gains: GainRange, folder: Path, *, page: bool
) -> str:
    """Start dashboard, plant and companions, watched by `node`; returns a warning about a bypassed filter, or empty.

    `gains`: range of gain changes that the guard has to pass. `folder`: folder for port, pipes and load force of an
    emulator. `page`: whether the dashboard is wanted.
    """
    start_dashboard(stack, node, wanted=page, log=node.announcer.write_log)
    if options.plant == "external":
        return ""
    uncovered = ""
    if options.filter != NO_FILTER_WORDS:
        _, settings = requested_filter(options.filter, options.bench)
        if settings.bypass and guard_range(gains).delta_kp_max > GuardSettings().delta_kp_max:
            uncovered = "the filter is bypassed: only the monitor and the box's force limit protect from high gains"
            node.report(uncovered, warning=True)
    node.watch_companions(start_companions(stack, options, gains, folder, node.announcer.write_log), options.recording)
    node.load_force_file = folder / LOAD_FORCE_FILE if options.plant == "emulator" else None
    return uncovered


def commands(options: PlantOptions, gains: GainRange, folder: Path) -> list[tuple[str, str, list[str]]]:
    """Return (package, executable, arguments) of each companion, in starting order.

    A guard that is widened to the range `gains` has the filter and the metric that this relies on as a parameter, and
    reports them; without a filter it is never widened.
    """
    if options.plant == "external":
        return []
    from hydro_filter.controller.factory import SHIPPED_METRIC

    bench = ["--bench", str(options.bench)] if options.bench else []
    started: list[tuple[str, str, list[str]]] = []
    peers = [options.controller] if options.controller else []
    scheduling = ["--realtime"] if options.real_time else []
    if options.recording is not None:
        started.append(("hydro_bridge", "recorder", [*scheduling, *recorder_arguments(options, options.recording)]))
        peers.append("recorder")
    if options.plant == "sim":
        package, node, model = "hydro_sim", "sim", ["--model", str(options.model)] if options.model else []
        words = [*bench, *model, *scheduling, "--seed", str(options.seed), "--pace", options.pace]
    else:
        package, node, port = "hydro_bridge", "bridge", options.port
        if options.plant == "emulator":
            port = port or str(folder / "port")
            arguments = ["--link", port, "--seed", str(options.seed), "--pace", options.pace, *bench]
            arguments += ["--control", str(folder / "emulator_control"), "--load-force", str(folder / LOAD_FORCE_FILE)]
            arguments += ["--truth", str(options.truth)] if options.truth else []
            arguments += ["--faults", options.faults] if options.faults else []
            started.append(("hydro_sim", "emulator", arguments))
        words = [*scheduling, *(["--port", port] if port else []), *bench]
    filtered, parameters = options.filter != NO_FILTER_WORDS, dict[str, Any]()
    if peers and not options.real_time:
        parameters["pace.peers"] = " ".join(peers)
    wanted, default = asdict(guard_range(gains)), asdict(GuardSettings())
    wider = {f"guard.{name}": float(value) for name, value in wanted.items() if value != default[name]}
    if filtered and wider:
        named = any(word.split("=")[0] == "--metric" for word in options.filter)
        relies_on = " ".join(options.filter if named else (f"--metric {SHIPPED_METRIC}", *options.filter))
        parameters |= {**wider, "guard.relies_on": relies_on}
    if options.plant == "sim" and options.base_gains is not None:
        kp, ki = map(float, options.base_gains)
        parameters |= {"box.base_kp": kp, "box.base_ki": ki}
    if parameters:
        words += ["--ros-args", *(word for name, value in parameters.items() for word in ("-p", f"{name}:={value}"))]
    if not filtered:
        return [*started, (package, node, words)]
    asked = shlex.join([*bench, *options.filter])
    return [*started, ("hydro_filter", "filtered_plant", [node, f"--filter={asked}", *words])]


def recorder_arguments(options: PlantOptions, folder: Path) -> list[str]:
    """Return the command line of the recorder: metadata, SHA-256 of all weights involved, and the bench file.

    The sim node runs the given model, else the analytic model of a bench file, else the learned bench shipped with it.
    """
    metadata = [f"plant={options.plant}", *options.metadata]
    metadata += [f"policy_sha256_{path.stem}={_digest(path)}" for path in options.policies if path.is_file()]
    if options.plant == "sim":
        model = options.model or (None if options.bench else shipped_bench())
        metadata.append("model=analytic" if model is None else f"model_sha256={_digest(model)}")
    if options.filter != NO_FILTER_WORDS:
        choice, _ = requested_filter(options.filter, options.bench)
        metadata += [f"filter_{name}_sha256={_digest(path)}" for name, path in choice.files.items()]
    attachments = filter(None, (options.bench or bench_digest.shipped_bench_file(), *options.attachments))
    return ["--out", str(folder), "--metadata", *metadata, "--attach", *map(str, attachments)]
