# SPDX-License-Identifier: Apache-2.0
"""The plant of a run: its options, the box that they name, and the companion processes that serve it.

--plant sim         sim with filter, recorder
--plant emulator    emulator, bridge with filter, recorder
--plant bench       bridge with filter, recorder
--plant external    none: everything runs already

The filter is in the plant's process (`hydro_filter.nodes.filtered_plant`). With `--filter none` there is no filter: the
compensated law needs none, and of the paper's law base gains are in force.

The guard is widened to the policy's range of gains, and told which filter that range relies on. A recording gets the
bench file, and digests of all weights involved.
"""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from hashlib import sha256
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rclpy.node import Node

from hydro_bridge.ros.companion import Companion, add_dashboard_option, start_dashboard
from hydro_bridge.ros.node import declare_parameters
from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.safety.pace import parse_pace
from hydro_core.cli.console import UserError
from hydro_core.files import bench_file, site
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.evaluation.controllers import policy_file
from hydro_policy.nodes.announcements import companion_output
from hydro_policy.nodes.graph_node import GraphNode
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.mdp import BASE, GainRange
from hydro_sim.files.learned_bench import shipped_bench
from hydro_sim.files.pairing import BoxIdentity, mismatch, raise_if_mismatched, read_provenance

if TYPE_CHECKING:
    from hydro_filter.controller.factory import FilterChoice
    from hydro_filter.controller.loop_filter import LoopFilterSettings
    from hydro_policy.runs.initial_agent import InitialAgent

T = TypeVar("T")

PLANTS = ("sim", "emulator", "bench", "external")
NO_FILTER = ("none",)
"""Words of `--filter none`."""
LOAD_FORCE = "load_force"
"""File, in the folder of the companions, of the last forces on the emulated load (`evaluation.load_force`)."""
LAWS = ("both", "paper", "compensated")
"""Values of `evaluate --law`."""
SCRATCH = "scratch"
"""Value of `--from` for no agent, besides a run's folder."""
_FILES = ("truth", "bench", "load_cell", "model")
_PLANT_WORDS = (
    "plant",
    "port",
    "truth",
    "faults",
    "pace",
    "bench",
    "load_cell",
    "model",
    "base_gains",
    "filter",
    "rearm",
)
_NEEDS = {
    "hand_over": ("external",),
    "truth": ("emulator",),
    "faults": ("emulator",),
    "pace": ("sim", "emulator"),
    "port": ("bench", "emulator"),
    "model": ("sim",),
    "base_gains": ("sim", "bench"),
    "filter": ("sim", "emulator", "bench"),
}


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
    """What is simulated in its place, a bench file; box and filter keep to `bench`."""
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
    """Further words for the filter's command line, its metric for instance; `NO_FILTER`: there is none."""
    seed: int = 0
    """Of the noise of simulation or emulator."""
    pace: str = "plant"
    """Of simulation or emulator: plant, real, or a factor of real time."""
    controller: str = ""
    """Name of the node that commands the plant: the first sample waits for it, as for recorder and filter."""

    @property
    def real_time(self) -> bool:
        """Whether the plant runs in real time."""
        return self.plant == "bench" or self.pace == "real"


# --------------------------------------------------------------------------------------------------------- options


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options about the plant and its companion processes."""
    group = parser.add_argument_group("plant")
    add = group.add_argument
    add("--plant", choices=PLANTS, default="external",
        help="start the other nodes, too: sim (sim with filter, recorder), emulator (emulator, bridge with filter, "
        "recorder), bench (bridge with filter, recorder), or external: they run already (default)")  # fmt: skip
    add("--port", metavar="PATH", help="serial port of the bench (default: the bridge's)")
    add("--truth", type=Path, metavar="FILE", help="YAML of what the emulated bench is made of")
    add("--faults", metavar="FILE", help="link faults of the emulator, a file or a preset")
    add("--pace", metavar="PACE",
        help="of sim or emulator: plant (default): its clock waits for the graph's answers, as fast as they come, and "
        "a run is a function of its seed; real: real time; a number: that many times real time")  # fmt: skip
    add("--bench", type=Path, metavar="FILE", help="bench.yaml (default: the nominal bench)")
    site.add_site_option(group, "--bench, --base-gains and --filter, of --model where --plant is sim")
    add("--load-cell", type=Path, metavar="FILE",
        help="bench file or corrected.yaml: under the compensated law the force in front of this load cell's amplifier "
        "follows the reference (default: the measured force does)")  # fmt: skip
    add("--model", type=Path, metavar="FILE",
        help="bench file that sim simulates, while the box keeps to --bench; the filter's is "
        'its own word: --filter="--model FILE --metric FILE"')  # fmt: skip
    add("--base-gains", nargs=2, type=float, metavar=("KP", "KI"),
        help="of the box (default: 15 5, the paper's); those of a plant that runs already are asked for")  # fmt: skip
    add("--filter", default="", metavar="WORDS",
        help='further words for the filter that is started, in one string: --filter="--contraction-rate 2"; none: no '
        "filter, for the compensated law")  # fmt: skip
    add_rearm_option(group)
    add("--hand-over", metavar="NODE",
        help="when all is done hand an external plant to this node, which waits for it; a run that is stopped "
        "does not")  # fmt: skip
    add_dashboard_option(group)


def add_rearm_option(parser: argparse._ActionsContainer) -> None:
    """Add the option --rearm."""
    help_text = "who arms: auto (default with sim and emulator), or you on purpose (otherwise), by Enter or `arm`"
    parser.add_argument("--rearm", choices=("auto", "ask"), help=help_text)


def plant_options_as_yaml(options: argparse.Namespace) -> dict[str, Any]:
    """Return the plant options as stored in YAML, with absolute paths."""
    words = {name: value for name in _PLANT_WORDS if (value := getattr(options, name))}
    return {
        name: value if isinstance(value, list) else str(Path(value).absolute() if os.path.exists(value) else value)
        for name, value in words.items()
    }


def restore_plant_options(result: argparse.ArgumentParser, plant: dict[str, Any], said: Mapping[str, Any]) -> None:
    """Make a run's original plant options, `plant`, the defaults, unless another plant is requested."""
    if said.get("plant", plant.get("plant")) == plant.get("plant"):
        words = {name: value for name, value in plant.items() if name in _PLANT_WORDS}
        result.set_defaults(**{name: Path(word) if name in _FILES else word for name, word in words.items()})


def apply_site(options: argparse.Namespace) -> None:
    """Set the options that --site takes the place of (raises UserError)."""
    files = {} if options.plant == "external" else {"filter": f"--model {site.MODEL} --metric {site.METRIC}"}
    files |= {"model": site.MODEL} if options.plant == "sim" else {}
    site.apply_site_option(options, bench=site.BENCH, **files)
    if options.site and not options.base_gains and options.plant in _NEEDS["base_gains"]:
        options.base_gains = site.base_gains(options.site)


def load_cell(options: argparse.Namespace) -> LoadCell | None:
    """Return the load cell of --load-cell.

    Raises UserError: the compensated law is not to run; ValueError, OSError: as `LoadCell.load`.
    """
    if options.load_cell is not None and getattr(options, "law", LAWS[0]) == "paper":
        raise UserError("--load-cell is of no use with --law paper")
    return None if options.load_cell is None else LoadCell.load(options.load_cell)


def may_rearm(options: argparse.Namespace) -> bool:
    """Return whether the session may arm the plant without a person."""
    return bool((options.rearm or ("auto" if options.plant in ("sim", "emulator") else "ask")) == "auto")


def plant_options(options: argparse.Namespace, **more: Any) -> PlantOptions:
    """Return the plant options from the command line; `more` are further fields.

    Raises UserError: an option that does not apply to this plant: refused rather than ignored; SettingsError: --pace.
    """
    for name, plants in _NEEDS.items():
        if getattr(options, name) and options.plant not in plants:
            word = "--" + name.replace("_", "-")
            raise UserError(f"{word} is of no use with --plant {options.plant}; it goes with {' or '.join(plants)}")
    pace = options.pace or "plant"
    parse_pace(pace)
    given = {name: getattr(options, name) for name in ("plant", "port", "truth", "faults", "bench", "model")}
    words = tuple(shlex.split(options.filter))
    return PlantOptions(**given, base_gains=options.base_gains, filter=words, pace=pace, **more)


def declare_settings(node: Node, settings: TrainingSettings) -> TrainingSettings:
    """Declare all settings of a run as ROS parameters: episodes, sac.gamma, task.gains.delta_kp_max ..."""
    gains = declare_parameters(node, settings.task.gains, "task.gains.")
    task = replace(declare_parameters(node, settings.task, "task."), gains=gains)
    parts = {name: declare_parameters(node, getattr(settings, name), f"{name}.") for name in ("sac", "exam", "monitor")}
    return replace(declare_parameters(node, settings), task=task, **parts)


def keep_overridden(node: Node, before: T, after: T, prefix: str = "") -> T:
    """Return the settings `after`, but what the user set as a parameter is as `before`."""
    kept: dict[str, Any] = {}
    for name in (field.name for field in fields(before)):  # type: ignore[arg-type]
        value = getattr(before, name)
        if is_dataclass(value):
            kept[name] = keep_overridden(node, value, getattr(after, name), f"{prefix}{name}.")
        elif f"{prefix}{name}" in node._parameter_overrides:  # rclpy: no public way
            kept[name] = value
    return replace(after, **kept)  # type: ignore[type-var]


# --------------------------------------------------------------------------------------------------------- the box

PRETRAIN = "make one with `ros2 run hydro_policy pretrain` and its --box and --base-gains"


def expected_box(options: argparse.Namespace) -> BoxIdentity:
    """Return the expected box: by --bench and --base-gains, or the nominal one.

    Of a plant that runs already nothing is expected but what --bench says.

    Raises ValueError: the bench file cannot be used; UserError: the box of a running plant is specified, or the model
    is not a file.
    """
    plant_options(options)
    if options.model is not None and not options.model.is_file():
        raise UserError(f"--model {options.model}: there is no such file")
    if options.plant == "external":
        return BoxIdentity.of_file(options.bench) if options.bench else BoxIdentity(digest="", source="what runs")
    box = BoxIdentity.of_file(options.bench, tuple(options.base_gains or BASE))
    from hydro_sim.box.box import BoxConfig  # with numba, which takes a second: not for --help or a slip

    return box if options.plant == "bench" else replace(box, integral=BoxConfig().integral)


def box_mismatch(plan: BoxIdentity, box: KnownBox) -> str:
    """Return why the box is not the expected one, with the options that would fit it; empty if it is."""
    if plan.digest and box.bench_digest and plan.digest != box.bench_digest:
        told = BoxIdentity.of_box(box).description
        planned = f"the box believes {told}, this run was planned for bench {plan.description}"
        return f"{planned}: name the bench.yaml of this box by --bench"
    expected, (kp, ki) = plan.base_gains or box.base_gains, box.base_gains
    if isclose(expected[0], kp, rel_tol=1e-6) and isclose(expected[1], ki, rel_tol=1e-6):
        return ""
    told = f"the box adds changes to base gains ({kp:g}, {ki:g}), this run was planned for "
    return told + "({:g}, {:g})".format(*expected) + f": say --base-gains {kp:g} {ki:g}"


def require_matching_agent(start: InitialAgent | None, box: BoxIdentity) -> None:
    """Raise PairingError if this agent was not made for this box."""
    if start is not None:
        remedy = f"{PRETRAIN}, or begin without one: --from scratch"
        raise_if_mismatched(mismatch(f"the agent {start.source.name}", start.made, box, remedy))


def require_matching_policy(path: Path, box: BoxIdentity) -> None:
    """Raise PairingError if the policy of this run or file was not made for this box; ValueError if there is none."""
    raise_if_mismatched(mismatch(f"the policy {path.name}", read_provenance(policy_file(path)), box, PRETRAIN))


def describe_policy(path: Path) -> str:
    """Describe a file's policy: the digest of its weights, as in diagnostics, and of the file, as in recordings.

    Raises ValueError: the file is not a policy.
    """
    return f"policy {path}: weights {load_policy(path)[0].digest()}, SHA-256 {_digest(path)}"


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


# ------------------------------------------------------------------------------------------------------ companions


def requested_filter(words: Sequence[str], bench: Path | None = None) -> tuple[FilterChoice, LoopFilterSettings]:
    """Return the filter selected by its command-line arguments on this bench; invalid arguments end the program.

    Raises PairingError: its metric and model are not this bench's: nothing is started, and no guard is widened for it.
    """
    from hydro_filter.controller.factory import parse_args

    choice, settings, _ = parse_args([*(["--bench", str(bench)] if bench else []), *words])
    return choice, settings


def guard_range(gains: GainRange) -> GainRange:
    """Return the gain changes allowed by the plant's guard: its defaults, widened to the policy's range if larger."""
    return GainRange.enclosing(gains, GuardSettings())


def guard_parameters(gains: GainRange, words: Sequence[str]) -> list[str]:
    """Return the ROS parameters that widen the plant's guard to the policy's range, where its defaults are narrower.

    The guard is given the filter on which the wider range relies, by its command line's `words` with its metric named,
    and reports it: it is never widened silently, nor without a filter.
    """
    if tuple(words) == NO_FILTER:
        return []
    from hydro_filter.controller.factory import LEARNED

    named = any(word.split("=")[0] == "--metric" for word in words)
    relies_on = " ".join(words if named else (f"--metric {LEARNED}", *words))
    default, wanted = GuardSettings(), asdict(guard_range(gains))
    changed = {name: value for name, value in wanted.items() if value != getattr(default, name)}
    words = [word for name, value in changed.items() for word in ("-p", f"guard.{name}:={float(value)}")]
    return ["--ros-args", *words, "-p", f"guard.relies_on:={relies_on}"] if words else []


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
    """Start page, plant and companions, which `node` watches; returns what the filter leaves uncovered (safety.md).

    `gains`: range that the guard has to pass. `folder`: of port and pipes of an emulator, and of its load force.

    Raises PairingError before anything runs: the filter does not fit; CompanionError: the packages are not built or
    sourced.
    """
    start_dashboard(stack, node, wanted=page, keep=node.announcer.keep)
    if options.plant == "external":
        return ""
    uncovered = ""
    if options.filter != NO_FILTER:
        _, settings = requested_filter(options.filter, options.bench)
        if settings.bypass and guard_range(gains).delta_kp_max > GuardSettings().delta_kp_max:
            uncovered = "the filter is bypassed: only the monitor and the box's force limit protect from high gains"
            node.say(uncovered, warning=True)
    node.watch_companions(start_companions(stack, options, gains, folder, node.announcer.keep), options.recording)
    node.load_force = folder / LOAD_FORCE if options.plant == "emulator" else None
    return uncovered


def commands(options: PlantOptions, gains: GainRange, folder: Path) -> list[tuple[str, str, list[str]]]:
    """Return (package, executable, arguments) of each companion, in starting order."""
    if options.plant == "external":
        return []
    bench = ["--bench", str(options.bench)] if options.bench else []
    started: list[tuple[str, str, list[str]]] = []
    peers = [options.controller] if options.controller else []
    scheduling = ["--realtime"] if options.real_time else []
    if options.recording is not None:
        started.append(("hydro_bridge", "recorder", [*scheduling, *recorder_arguments(options, options.recording)]))
        peers.append("recorder")
    guard = guard_parameters(gains, options.filter)
    if peers and not options.real_time:
        guard = ["--ros-args", "-p", f"pace.peers:={' '.join(peers)}", *guard[1:]]
    if options.plant == "sim":
        package, node, model = "hydro_sim", "sim", ["--model", str(options.model)] if options.model else []
        words = [*bench, *model, *scheduling, "--seed", str(options.seed), "--pace", options.pace]
        if options.base_gains is not None:
            kp, ki = map(float, options.base_gains)
            guard = [*(guard or ["--ros-args"]), "-p", f"box.base_kp:={kp}", "-p", f"box.base_ki:={ki}"]
    else:
        package, node, port = "hydro_bridge", "bridge", options.port
        if options.plant == "emulator":
            port = port or str(folder / "port")
            arguments = ["--link", port, "--seed", str(options.seed), "--pace", options.pace, *bench]
            arguments += ["--control", str(folder / "emulator_control"), "--load-force", str(folder / LOAD_FORCE)]
            arguments += ["--truth", str(options.truth)] if options.truth else []
            arguments += ["--faults", options.faults] if options.faults else []
            started.append(("hydro_sim", "emulator", arguments))
        words = [*scheduling, *(["--port", port] if port else []), *bench]
    words += guard
    if options.filter == NO_FILTER:
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
    if options.filter != NO_FILTER:
        choice, _ = requested_filter(options.filter, options.bench)
        metadata += [f"filter_{name}_sha256={_digest(path)}" for name, path in choice.files.items()]
    attachments = filter(None, (options.bench or bench_file.shipped_bench_file(), *options.attachments))
    return ["--out", str(folder), "--metadata", *metadata, "--attach", *map(str, attachments)]
