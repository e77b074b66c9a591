# SPDX-License-Identifier: Apache-2.0
"""Command-line options of a run's plant, and checks of its box against them."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_origin, get_type_hints

from hydro_bridge.plant_clock import parse_pace
from hydro_bridge.ros.companion import add_dashboard_option
from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.cli.console import UserError
from hydro_core.files import site
from hydro_core.settings import read_yaml
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.evaluation.controllers import policy_file
from hydro_policy.runs.run_directory import RunDirectory
from hydro_policy.task.mdp import BASE_GAINS
from hydro_sim.files.pairing import BoxIdentity, mismatch, raise_if_mismatched, read_provenance

if TYPE_CHECKING:
    from hydro_policy.runs.initial_agent import InitialAgent

PLANTS = ("sim", "emulator", "bench", "external")
NO_FILTER_WORDS = ("none",)  # words of `--filter none`
LAWS = ("both", "paper", "compensated")  # values of `evaluate --law`
SCRATCH = "scratch"  # value of `--from` for no agent, besides a run's folder
BEGUN = ("start", "configuration")  # options that a resumed run has from its beginning
SITE_OPTIONS = {"bench", "base_gains", "filter", "model"}  # those that --site replaces


def _option(*only: str, **words: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return the plants that an option goes with, if not with all, and its words for `add_argument`."""
    return only, words


def _device(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("the port's name is empty: give the device, as in --port /dev/ttyUSB0")
    return text


# fmt: off
@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """Options of a run's plant and companion processes: those of the command line, and those added by the run."""

    plant: Annotated[str, _option(choices=PLANTS, default="external",
        help="start the other nodes, too: sim (sim with filter, recorder), emulator (emulator, bridge with filter, "
        "recorder), bench (bridge with filter, recorder), or external: they run already (default)")]
    port: Annotated[str | None, _option("bench", "emulator", type=_device, metavar="PATH",
        help="serial port of the bench (default: the bridge's)")] = None
    truth: Annotated[Path | None, _option("emulator", type=Path, metavar="FILE",
        help="YAML of what the emulated bench is made of")] = None
    faults: Annotated[str | None, _option("emulator", metavar="FILE",
        help="link faults of the emulator, a file or a preset")] = None
    pace: Annotated[str, _option("sim", "emulator", metavar="PACE",
        help="of sim or emulator: plant (default): its clock waits for the graph's answers, as fast as they come, and "
        "a run is a function of its seed; real: real time; a number: that many times real time")] = "plant"
    bench: Annotated[Path | None, _option(type=Path, metavar="FILE",
        help="bench.yaml (default: the nominal bench)")] = None
    load_cell: Annotated[Path | None, _option(type=Path, metavar="FILE",
        help="bench file or corrected.yaml: under the compensated law the force in front of this load cell's amplifier "
        "follows the reference (default: the measured force does)")] = None
    model: Annotated[Path | None, _option("sim", type=Path, metavar="FILE",
        help="bench file that sim simulates, while the box keeps to --bench; the filter's is "
        'its own word: --filter="--model FILE --metric FILE"')] = None
    base_gains: Annotated[Sequence[float] | None, _option("sim", "bench", nargs=2, type=float, metavar=("KP", "KI"),
        help="of the box (default: 15 5, the paper's); those of a plant that runs already are asked for")] = None
    filter: Annotated[tuple[str, ...], _option("sim", "emulator", "bench", default="", metavar="WORDS",
        help='further words for the filter that is started, in one string: --filter="--contraction-rate 2"; none: no '
        "filter, for the compensated law")] = ()
    rearm: Annotated[str | None, _option(choices=("auto", "ask"),
        help="who arms: auto (default with sim and emulator), or you on purpose (otherwise), by Enter or `arm`")] = None
    # fmt: on

    recording: Path | None = None  # folder for the recording; None: none
    metadata: tuple[str, ...] = ()  # key=value words kept in the recording
    attachments: tuple[Path, ...] = ()  # files kept in the recording, besides the bench file
    policies: tuple[Path, ...] = ()  # policy files that act in this run; the recording keeps their digests
    seed: int = 0  # of the noise of simulation or emulator
    controller: str = ""
    """Name of the node that commands the plant: the first sample waits for it, as for recorder and filter."""

    @property
    def real_time(self) -> bool:
        """Whether the plant runs in real time."""
        return self.plant == "bench" or self.pace == "real"


_OPTIONS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(PlantOptions, include_extras=True).items()
    if get_origin(hint) is Annotated
}


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options about the plant and its companion processes."""
    group = parser.add_argument_group("plant")
    for name in _OPTIONS:
        add_option(group, name)
        if name == "bench":
            site.add_site_option(group, "--bench, --base-gains and --filter, of --model where --plant is sim")
    add_dashboard_option(group)


def add_option(parser: argparse._ActionsContainer, name: str) -> None:
    """Add one option of `PlantOptions`."""
    parser.add_argument("--" + name.replace("_", "-"), **_OPTIONS[name][1])


def as_stored(value: Any) -> Any:
    """Return the value of an option as stored in YAML, the path of an existing file as an absolute one."""
    stored = isinstance(value, list | int)
    return value if stored else str(Path(value).absolute() if os.path.exists(value) else value)


def plant_options_as_yaml(options: argparse.Namespace) -> dict[str, Any]:
    """Return the plant options as stored in YAML, with those of `BEGUN`."""
    return {name: as_stored(value) for name in (*_OPTIONS, *BEGUN) if (value := getattr(options, name))}


def restore_options(result: argparse.ArgumentParser, run: RunDirectory, said: Mapping[str, Any]) -> None:
    """Make a run's original options, if they were saved, the defaults; those of its plant unless another is requested.

    Raises UserError: one that a resumption cannot change has another value. `said`: the options given explicitly.
    """
    seed, plant = run.load_settings().seed, read_yaml(run.config).get("plant")
    plant = plant if isinstance(plant, dict) else {}
    own = {"seed": seed, "runs": as_stored(run.path.parent), "name": run.path.absolute().name}
    own |= {name: plant.get(name, "the default") for name in BEGUN}
    for name in own.keys() & said.keys():
        if as_stored(said[name]) != own[name]:
            word = "--from" if name == "start" else f"--{name}"
            raise UserError(f"{word} {said[name]} is not the run's, {own[name]}: omit it, or begin another run")
    retained = {*BEGUN}
    if said.get("plant", plant.get("plant")) == plant.get("plant"):
        retained |= _OPTIONS.keys() - (SITE_OPTIONS if "site" in said else set())
    files = {"start", *(name for name, (_, option) in _OPTIONS.items() if option.get("type") is Path)}
    words = {name: Path(value) if name in files else value for name, value in plant.items() if name in retained}
    result.set_defaults(**words)


def apply_site(options: argparse.Namespace) -> None:
    """Set the options that --site replaces: bench, base gains, filter, model. Raises UserError: one is given, too."""
    files = {} if options.plant == "external" else {"filter": f"--model {site.MODEL_FILE} --metric {site.METRIC_FILE}"}
    files |= {"model": site.MODEL_FILE} if options.plant == "sim" else {}
    site.apply_site_option(options, bench=site.BENCH_FILE, **files)
    if options.site and not options.base_gains and options.plant in _OPTIONS["base_gains"][0]:
        options.base_gains = site.base_gains(options.site)


def load_cell(options: argparse.Namespace) -> LoadCell | None:
    """Return the load cell of --load-cell, or None. Raises UserError: --law paper, which does not use it."""
    if options.load_cell is not None and getattr(options, "law", LAWS[0]) == "paper":
        raise UserError("--load-cell is of no use with --law paper")
    return None if options.load_cell is None else LoadCell.load(options.load_cell)


def may_rearm(options: argparse.Namespace) -> bool:
    """Return whether the session may arm the plant without a person."""
    return bool((options.rearm or ("auto" if options.plant in ("sim", "emulator") else "ask")) == "auto")


def plant_options(options: argparse.Namespace, **more: Any) -> PlantOptions:
    """Return the plant options from the command line; `more` are further fields."""
    given = {name: value for name in _OPTIONS if (value := getattr(options, name))}
    for name in given:
        plants, _ = _OPTIONS[name]
        if plants and options.plant not in plants:
            word = "--" + name.replace("_", "-")
            raise UserError(f"{word} goes with --plant {' or '.join(plants)}, not with {options.plant}")
    made = PlantOptions(**{**given, "filter": tuple(shlex.split(options.filter))}, **more)
    parse_pace(made.pace)
    return made


PRETRAIN_HINT = "make one with `pretrain` and its --box and --base-gains"


def expected_box(options: argparse.Namespace) -> BoxIdentity:
    """Return the expected box: by --bench and --base-gains, or the nominal one.

    Of a plant that runs already only the bench of --bench is expected, if it is given.
    """
    plant_options(options)
    if options.model is not None and not options.model.is_file():
        raise UserError(f"--model {options.model}: there is no such file")
    if options.plant == "external":
        return BoxIdentity.of_file(options.bench) if options.bench else BoxIdentity(digest="", source="what runs")
    box = BoxIdentity.of_file(options.bench, tuple(options.base_gains or BASE_GAINS))
    from hydro_sim.box.box import BoxConfig  # with numba, which takes a second: not for --help or a slip

    return box if options.plant == "bench" else replace(box, integral=BoxConfig().integral)


def box_mismatch(plan: BoxIdentity, box: BoxDescription) -> str:
    """Return the reason why the box is not the expected one, with the options that fit it; empty if it is."""
    if plan.digest and box.bench_digest and plan.digest != box.bench_digest:
        told = f"the box believes {BoxIdentity.of_box(box).description}, this run is for bench {plan.description}"
        return f"{told}: name the bench.yaml of this box by --bench"
    expected, (kp, ki) = plan.base_gains or box.base_gains, box.base_gains
    if isclose(expected[0], kp, rel_tol=1e-6) and isclose(expected[1], ki, rel_tol=1e-6):
        return ""
    return "this run was planned for base gains ({:g}, {:g}): ".format(*expected) + f"say --base-gains {kp:g} {ki:g}"


def require_matching_agent(start: InitialAgent | None, box: BoxIdentity) -> None:
    """Raise PairingError if this agent was not made for this box."""
    if start is not None:
        remedy = f"{PRETRAIN_HINT}, or begin without one: --from scratch"
        raise_if_mismatched(mismatch(f"the agent {start.source.name}", start.made, box, remedy))


def require_matching_policy(path: Path, box: BoxIdentity) -> None:
    """Raise PairingError if the policy of this run or file was not made for this box; ValueError if there is none."""
    raise_if_mismatched(mismatch(f"the policy {path.name}", read_provenance(policy_file(path)), box, PRETRAIN_HINT))
