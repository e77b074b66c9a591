# SPDX-License-Identifier: Apache-2.0
"""Conversion of an evaluation's command line to controllers, settings and the gain range that the guard must allow."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller
from hydro_policy.evaluation.gain_search import GridSettings
from hydro_policy.evaluation.session import EvaluationSettings
from hydro_policy.nodes.startup.box_expectation import require_matching_policy
from hydro_policy.task.mdp import BASE, GainRange
from hydro_sim.files.pairing import BoxIdentity


def make_controllers(options: argparse.Namespace, box: BoxIdentity) -> list[Controller]:
    """Create the controllers named on the command line, for this box.

    Raises
    ------
    ValueError
        A controller cannot be used.
    PairingError
        A policy was made for another box.
    """
    for path in options.policy:
        require_matching_policy(path, box)
    controllers: list[Controller] = [policy_controller(path) for path in options.policy]
    gains = options.fixed or ([] if options.law == "compensated" else [(90.0, 15.0), (15.0, 5.0)])
    return controllers + [FixedGains(kp, ki, box.base_gains or BASE) for kp, ki in gains]


def evaluation_settings(options: argparse.Namespace) -> EvaluationSettings:
    """Evaluation settings from defaults and command line."""
    names = ("repeats", "settle", "periods", "multisine", "steps")
    given = {name: getattr(options, name) for name in names}
    given["frequencies"] = options.frequencies and tuple(options.frequencies)
    return EvaluationSettings(**{key: value for key, value in given.items() if value is not None})


def required_gain_range(
    controllers: Sequence[Controller], grid: GridSettings | None = None, base: tuple[float, float] | None = None
) -> GainRange:
    """Range of gain changes that the guard must allow on a box with these base gains."""
    ranges = [controller.reach for controller in controllers] or [FixedGains(*(base or BASE), base or BASE).reach]
    if grid is not None:
        corners = ((grid.kp_min, grid.ki_min), (grid.kp_max, grid.ki_max))
        ranges += [FixedGains(*pair, base or BASE).reach for pair in corners]
    return GainRange(
        delta_kp_min=min(r.delta_kp_min for r in ranges),
        delta_kp_max=max(r.delta_kp_max for r in ranges),
        delta_ki_min=min(r.delta_ki_min for r in ranges),
        delta_ki_max=max(r.delta_ki_max for r in ranges),
    )
