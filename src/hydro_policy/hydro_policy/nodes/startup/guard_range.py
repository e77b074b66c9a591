# SPDX-License-Identifier: Apache-2.0
"""Width of the plant's guard for a policy, the filter that it relies on, and whether that filter covers it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_bridge.safety.guard import GuardSettings
from hydro_policy.task.mdp import GainRange

if TYPE_CHECKING:  # the filter's compiled code is not for --help or a slip
    from hydro_filter.controller.factory import FilterChoice, Settings


def requested_filter(words: Sequence[str], bench: Path | None = None) -> tuple[FilterChoice, Settings]:
    """Return the filter selected by its command-line arguments on this bench; invalid arguments end the program.

    Raises
    ------
    PairingError
        Its metric and model are not this bench's: nothing is started, and no guard is widened for it.
    """
    from hydro_filter.nodes.options import arguments

    choice, settings, _ = arguments([*(["--bench", str(bench)] if bench else []), *words])
    return choice, settings


def guard_range(gains: GainRange) -> GainRange:
    """Return the gain changes allowed by the plant's guard: its defaults, widened to the policy's range if larger."""
    default = GuardSettings()
    return GainRange(
        delta_kp_min=min(gains.delta_kp_min, default.delta_kp_min),
        delta_kp_max=max(gains.delta_kp_max, default.delta_kp_max),
        delta_ki_min=min(gains.delta_ki_min, default.delta_ki_min),
        delta_ki_max=max(gains.delta_ki_max, default.delta_ki_max),
    )


def guard_parameters(gains: GainRange, relies_on: str) -> list[str]:
    """Return the ROS parameters that widen the plant's guard to the policy's range, where its defaults are narrower.

    The guard is given the filter on which the wider range relies, and reports it: it is never widened silently.
    """
    default, wanted = GuardSettings(), asdict(guard_range(gains))
    changed = {name: value for name, value in wanted.items() if value != getattr(default, name)}
    words = [word for name, value in changed.items() for word in ("-p", f"guard.{name}:={float(value)}")]
    return ["--ros-args", *words, "-p", f"guard.relies_on:={relies_on}"] if words else []


def filter_command(words: Sequence[str]) -> str:
    """Return the filter's command line with its metric named explicitly."""
    from hydro_filter.controller.factory import DEFAULT

    named = any(word.split("=")[0] == "--metric" for word in words)
    return " ".join(words if named else (f"--metric {DEFAULT}", *words))


def protection_gap(gains: GainRange, words: Sequence[str], bench: Path | None = None) -> str:
    """Return why this filter does not protect against the whole range of gains; empty if it does (safety.md)."""
    choice, settings = requested_filter(words, bench)
    if guard_range(gains).delta_kp_max <= GuardSettings().delta_kp_max:
        return ""
    if settings.bypass:
        return "the filter is bypassed: only the monitor and the box's force limit protect from high gains"
    if choice.constant:
        return "the constant metric does not protect from high gains: only the monitor and the box's force limit do"
    return ""
