# SPDX-License-Identifier: Apache-2.0
"""Companion processes: the nodes that a trainer or an evaluation starts, without `ros2 launch`.

--plant sim         sim, filter, recorder
--plant emulator    emulator, bridge, filter, recorder
--plant bench       bridge, filter, recorder
--plant external    none: everything runs already
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from hydro_bridge.ros.companion import Companion
from hydro_policy.nodes.graph.announcements import CompanionOutput
from hydro_policy.nodes.startup import provenance
from hydro_policy.nodes.startup.guard_range import filter_command, guard_parameters, requested_filter
from hydro_policy.task.mdp import GainRange

PLANTS = ("sim", "emulator", "bench", "external")
LOAD_FORCE = "load_force"
"""File, in the folder of the companions, of the last forces on the emulated load (`evaluation.load_force`)."""


@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """The plant and the companion processes of a run."""

    plant: str
    """One of `PLANTS`."""
    port: str | None = None
    """Serial port of a bench; None: the bridge's own default."""
    truth: Path | None = None
    """YAML of the emulated bench; None: the default truth plant."""
    faults: str | None = None
    """Link faults of the emulator, a file or a preset."""
    bench: Path | None = None
    """bench.yaml for box, simulation and filter; None: the nominal bench."""
    model: Path | None = None
    """What is simulated in its place, a bench file or weights of `learn`; box and filter keep to `bench`."""
    base_gains: Sequence[float] | None = None
    """K_p [1/s], K_i [1/s^2] of the box; None: the paper's. A simulated box gets them."""
    recording: Path | None = None
    """Folder for the recording; None: none."""
    metadata: tuple[str, ...] = ()
    """key=value words kept in the recording."""
    attachments: tuple[Path, ...] = ()
    """Files kept in the recording, besides the bench file."""
    policies: tuple[Path, ...] = ()
    """Policy files that act in this run; the recording keeps their digests."""
    filter: tuple[str, ...] = ()
    """Further words for the filter's command line, its metric for instance."""
    seed: int = 0
    """Of the noise of simulation or emulator."""


def start_companions(
    stack: ExitStack, options: PlantOptions, gains: GainRange, folder: Path, keep: Callable[[str], None]
) -> list[Companion]:
    """Start the companions in order; `stack` stops them in reverse, so that the recorder sees everything.

    `keep` takes each line of their output.

    Raises
    ------
    CompanionError
        A companion cannot be started: the packages are not built or sourced.
    """
    output = CompanionOutput(keep)
    return [
        stack.enter_context(Companion(package, executable, arguments, output=output))  # type: ignore[arg-type]
        for package, executable, arguments in commands(options, gains, folder)
    ]


def commands(options: PlantOptions, gains: GainRange, folder: Path) -> list[tuple[str, str, list[str]]]:
    """Return (package, executable, arguments) of each companion, in starting order."""
    if options.plant == "external":
        return []
    bench = ["--bench", str(options.bench)] if options.bench else []
    guard = guard_parameters(gains, filter_command(options.filter))
    started: list[tuple[str, str, list[str]]] = []
    if options.recording is not None:
        started.append(("hydro_bridge", "recorder", _recorder_arguments(options, options.recording)))
    started.append(("hydro_filter", "filter", [*bench, "--realtime", *options.filter]))
    if options.plant == "sim":
        words = ["--realtime", "--seed", str(options.seed), *_with_base_gains(guard, options.base_gains)]
        model = ["--model", str(options.model)] if options.model else []
        started.append(("hydro_sim", "sim", [*bench, *model, *words]))
        return started
    port = options.port
    if options.plant == "emulator":
        port = port or str(folder / "port")
        arguments = ["--link", port, "--seed", str(options.seed), *bench]
        arguments += ["--control", str(folder / "emulator_control"), "--load-force", str(folder / LOAD_FORCE)]
        arguments += ["--truth", str(options.truth)] if options.truth else []
        arguments += ["--faults", options.faults] if options.faults else []
        started.append(("hydro_sim", "emulator", arguments))
    words = [*(["--port", port] if port else []), *bench, *guard]
    started.append(("hydro_bridge", "bridge", ["--realtime", *words]))
    return started


def _with_base_gains(parameters: list[str], base_gains: Sequence[float] | None) -> list[str]:
    """Return the ROS parameters of a simulation, with its box's base gains if given."""
    if base_gains is None:
        return parameters
    kp, ki = base_gains
    return [*(parameters or ["--ros-args"]), "-p", f"box.base_kp:={float(kp)}", "-p", f"box.base_ki:={float(ki)}"]


def _recorder_arguments(options: PlantOptions, folder: Path) -> list[str]:
    digests = provenance.weights(options.plant, options.bench, options.policies, options.model)
    digests += provenance.of_filter(requested_filter(options.filter, options.bench)[0])
    metadata = [f"plant={options.plant}", *options.metadata, *digests]
    attachments = [provenance.bench_file(options.bench), *options.attachments]
    return ["--realtime", "--out", str(folder), "--metadata", *metadata, "--attach", *map(str, attachments)]
