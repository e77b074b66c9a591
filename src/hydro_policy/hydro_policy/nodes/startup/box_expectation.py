# SPDX-License-Identifier: Apache-2.0
"""The box that a run expects, from its command line, and whether the plant's box matches it."""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_bridge.cli.console import UserError
from hydro_bridge.safety.box_info import KnownBox
from hydro_policy.evaluation.controllers import policy_file
from hydro_policy.nodes.startup.options import plant_options
from hydro_policy.task.mdp import BASE
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.pairing import BoxIdentity, MadeFor, mismatch, raise_if_mismatched, read_provenance

if TYPE_CHECKING:  # it needs torch, which takes seconds to import, and which evaluate does without
    from hydro_policy.runs.initial_agent import InitialAgent

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
    return box if options.plant == "bench" else replace(box, integral=BoxConfig().integral)


def box_mismatch(plan: BoxIdentity, box: KnownBox) -> str:
    """Return why the box is not the expected one, with the options that would fit it; empty if it is."""
    if plan.digest and box.bench_digest and plan.digest != box.bench_digest:
        told = (
            f"the box believes {BoxIdentity.of_box(box).description}, this run was planned for bench {plan.description}"
        )
        return f"{told}: name the bench.yaml of this box by --bench"
    expected = plan.base_gains or box.base_gains
    if not all(isclose(*pair, rel_tol=1e-6) for pair in zip(expected, box.base_gains, strict=True)):
        kp, ki = box.base_gains
        planned = "({:g}, {:g})".format(*expected)
        told = f"the box adds changes to base gains ({kp:g}, {ki:g}), this run was planned for {planned}"
        return f"{told}: say --base-gains {kp:g} {ki:g}"
    return ""


def require_matching_agent(start: InitialAgent | None, box: BoxIdentity) -> None:
    """Raise PairingError if this agent was not made for this box."""
    if start is not None:
        remedy = f"{PRETRAIN}, or begin without one: --from scratch"
        raise_if_mismatched(mismatch(f"the agent {start.source.name}", start.made, box, remedy))


def require_matching_policy(path: Path, box: BoxIdentity) -> None:
    """Raise PairingError if the policy of this run or file was not made for this box; ValueError if there is none."""
    file = policy_file(path)
    raise_if_mismatched(mismatch(f"the policy {path.name}", read_provenance(file), box, PRETRAIN))


def require_same_box(run: Path, made: MadeFor | None, box: BoxIdentity) -> None:
    """Raise PairingError if a run was started on another box; a run of unknown provenance is accepted."""
    if made is not None:
        raise_if_mismatched(
            mismatch(f"the run {run.name}", made, box, "go on with it on its own box, or begin one here")
        )


def training_provenance(box: BoxIdentity) -> MadeFor:
    """Return the provenance of a policy or run trained on this box."""
    kp, ki = box.base_gains or (None, None)
    return MadeFor(box=box.digest, base_kp=kp, base_ki=ki, integral=box.integral)
