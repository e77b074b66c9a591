# SPDX-License-Identifier: Apache-2.0
"""Nodes of a run's plant.

--plant sim         sim with filter, recorder
--plant emulator    emulator, bridge with filter, recorder
--plant bench       bridge with filter, recorder
--plant external    none: everything runs already

A run writes their parameters into one file, RUN/graph.yaml, and starts each with this file and nothing else; so does
`ros2 launch hydro_policy graph.launch.py graph:=FILE`.

The filter is in the plant's process (`hydro_filter.nodes.filtered_plant`). With `--filter none` there is no filter: the
compensated law needs none, and under the paper's law base gains are in force.

The guard is widened to the policy's range of gains, with the filter that this relies on as a parameter. A recording
contains the bench file, and digests of all weights involved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

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

Graph = Mapping[str, Mapping[str, Any]]
"""Parameters of each node by its name."""

GRAPH_FILE = "graph.yaml"

EXECUTABLES = {
    "recorder": ("hydro_bridge", "recorder"),
    "emulator": ("hydro_sim", "emulator"),
    "bridge": ("hydro_bridge", "bridge"),
    "sim": ("hydro_sim", "sim"),
    "filter": ("hydro_filter", "filter"),
    "dashboard": ("hydro_bridge", "dashboard"),
    "trainer": ("hydro_policy", "trainer"),
    "evaluate": ("hydro_policy", "evaluate"),
}
"""Package and executable of each node of a graph's file."""

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


def write_graph(file: Path, graph: Graph) -> None:
    """Write the parameters of all nodes as a ROS parameter file."""
    sections = {name: {"ros__parameters": dict(values)} for name, values in graph.items()}
    file.write_text(yaml.safe_dump(sections, sort_keys=False), encoding="utf-8")


def executables(graph: Graph) -> dict[str, tuple[str, ...]]:
    """Return package, executable and first words that run each node; the filter runs in the plant's process."""
    plants = {name for name in ("bridge", "sim") if name in graph and "filter" in graph}
    filtered = {name: ("hydro_filter", "filtered_plant", name) for name in plants}
    return {name: filtered.get(name, EXECUTABLES[name]) for name in graph if name != "filter" or not plants}


def start_nodes(
    stack: ExitStack, file: Path, graph: Graph, keep: Callable[[str], None], *, only: str = ""
) -> list[Companion]:
    """Write the graph's file and start its nodes, or `only` one; `stack` stops them in reverse order.

    `keep` takes each line of their output. Raises CompanionError: the packages are not built or sourced.
    """
    write_graph(file, graph)
    return [
        stack.enter_context(
            Companion(
                package, executable, [*words, "--ros-args", "--params-file", str(file)], output=companion_output(keep)
            )
        )
        for name, (package, executable, *words) in executables(graph).items()
        if only in ("", name)
    ]


def start_plant(
    stack: ExitStack, node: GraphNode, options: PlantOptions, gains: GainRange, run: Path, folder: Path, *, page: bool
) -> str:
    """Start dashboard, plant and companions, watched by `node`; returns a warning about a bypassed filter, or empty.

    `gains`: range of gain changes that the guard has to pass. `run`: folder for the graph's file. `folder`: folder for
    port, pipes and load force of an emulator. `page`: whether the dashboard is wanted.
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
    graph = plant_graph(options, gains, folder)
    started = start_nodes(stack, run / GRAPH_FILE, graph, node.announcer.write_log)
    node.watch_companions(started, options.recording)
    node.load_force_file = folder / LOAD_FORCE_FILE if options.plant == "emulator" else None
    return uncovered


def plant_graph(options: PlantOptions, gains: GainRange, folder: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node by its name, in starting order: the recorder is first, and sees everything.

    A guard that is widened to the range `gains` has the filter and the metric that this relies on as a parameter, and
    reports them; without a filter it is never widened. `folder`: as for `start_plant`.
    """
    if options.plant == "external":
        return {}
    graph: dict[str, dict[str, Any]] = {}
    peers = [options.controller] if options.controller else []
    if options.recording is not None:
        graph["recorder"] = recorder_parameters(options, options.recording)
        peers.append("recorder")
    plant: dict[str, Any] = {"bench": str(options.bench)} if options.bench else {}
    paced = {"seed": options.seed, "pace": options.pace}
    if options.plant == "sim":
        name, plant = "sim", {**plant, **({"model": str(options.model)} if options.model else {}), **paced}
        if options.base_gains is not None:
            plant["box.base_kp"], plant["box.base_ki"] = map(float, options.base_gains)
    else:
        name, port = "bridge", options.port
        if options.plant == "emulator":
            port = port or str(folder / "port")
            files = {"control": folder / "emulator_control", "load_force": folder / LOAD_FORCE_FILE}
            files |= {"truth": options.truth} if options.truth else {}
            faults = {"faults": options.faults} if options.faults else {}
            graph["emulator"] = {
                "link": port,
                **paced,
                **plant,
                **{key: str(file) for key, file in files.items()},
                **faults,
            }
        plant |= {"port": port} if port else {}
    if options.real_time:
        plant["realtime"] = True
    elif peers:
        plant["pace.peers"] = " ".join(peers)
    if options.filter != NO_FILTER_WORDS:
        choice, settings = requested_filter(options.filter, options.bench)
        graph["filter"] = {"metric": choice.metric, **asdict(settings)}
        graph["filter"] |= {"model": str(choice.model)} if choice.model else {}
        graph["filter"] |= {"bench": str(options.bench)} if options.bench else {}
        if wider := _changed(guard_range(gains), GuardSettings()):
            changed = {"metric": choice.metric, **_changed(settings, type(settings)())}
            plant |= {f"guard.{key}": float(value) for key, value in wider.items()}
            plant["guard.relies_on"] = ", ".join(f"{key} {value}" for key, value in changed.items())
    return graph | {name: plant}


def _changed(settings: Any, default: Any) -> dict[str, Any]:
    return {key: value for key, value in asdict(settings).items() if value != asdict(default)[key]}


def recorder_parameters(options: PlantOptions, folder: Path) -> dict[str, Any]:
    """Return the recorder's parameters: metadata, SHA-256 of all weights involved, and the bench file.

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
    words = {"out": str(folder), "metadata": metadata, "attach": [*map(str, attachments)]}
    return {**words, "realtime": True} if options.real_time else words
