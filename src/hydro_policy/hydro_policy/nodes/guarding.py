# SPDX-License-Identifier: Apache-2.0
"""How wide the plant's guard is opened for a policy, which filter that relies on, and whether that filter covers it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_bridge.safety.guard import GuardSettings
from hydro_policy.task.mdp import GainRange

if TYPE_CHECKING:  # the filter's compiled code is not for --help or a slip
    from hydro_filter.controller.factory import Choice, Settings


def asked_filter(words: Sequence[str], bench: Path | None = None) -> tuple[Choice, Settings]:
    """The filter that these words of its command line ask for, on this bench; words that it does not take end here.

    Raises
    ------
    PairingError
        Its metric and model are not this bench's: nothing is started, and no guard is opened on its word.
    """
    from hydro_filter.nodes.options import arguments

    choice, settings, _ = arguments([*(["--bench", str(bench)] if bench else []), *words])
    return choice, settings


def guard_range(gains: GainRange) -> GainRange:
    """What the plant's guard lets through: its defaults, opened as wide as the policy's gains where they are wider."""
    default = GuardSettings()
    return GainRange(
        delta_kp_min=min(gains.delta_kp_min, default.delta_kp_min),
        delta_kp_max=max(gains.delta_kp_max, default.delta_kp_max),
        delta_ki_min=min(gains.delta_ki_min, default.delta_ki_min),
        delta_ki_max=max(gains.delta_ki_max, default.delta_ki_max),
    )


def guard_parameters(gains: GainRange, relies_on: str) -> list[str]:
    """ROS parameters that open the plant's guard as wide as the policy's gains, where its defaults are narrower.

    The guard is told which filter the wider range relies on, and tells it: nothing opens it in silence.
    """
    default, wanted = GuardSettings(), asdict(guard_range(gains))
    changed = {name: value for name, value in wanted.items() if value != getattr(default, name)}
    words = [word for name, value in changed.items() for word in ("-p", f"guard.{name}:={float(value)}")]
    return ["--ros-args", *words, "-p", f"guard.relies_on:={relies_on}"] if words else []


def relied_on(words: Sequence[str]) -> str:
    """The filter's command line, its metric named also where that is the default."""
    from hydro_filter.controller.factory import DEFAULT

    named = any(word.split("=")[0] == "--metric" for word in words)
    return " ".join(words if named else (f"--metric {DEFAULT}", *words))


def uncovered(gains: GainRange, words: Sequence[str], bench: Path | None = None) -> str:
    """Why this filter does not protect from the whole range of gains; empty where it does (safety.md)."""
    choice, settings = asked_filter(words, bench)
    if guard_range(gains).delta_kp_max <= GuardSettings().delta_kp_max:
        return ""
    if settings.bypass:
        return "the filter is bypassed: only the monitor and the box's force limit protect from high gains"
    if choice.constant:
        return "the constant metric does not protect from high gains: only the monitor and the box's force limit do"
    return ""
