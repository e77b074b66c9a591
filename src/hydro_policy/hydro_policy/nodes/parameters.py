# SPDX-License-Identifier: Apache-2.0
"""Settings of a run as ROS parameters."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from rclpy.node import Node

from hydro_bridge.ros.node import declare_parameters
from hydro_policy.runs.run_directory import TrainingSettings

T = TypeVar("T")


def declare_settings(node: Node, settings: TrainingSettings) -> TrainingSettings:
    """Declare all settings of a run as ROS parameters: episodes, sac.gamma, task.gains.delta_kp_max ..."""
    gains = declare_parameters(node, settings.task.gains, "task.gains.")
    task = replace(declare_parameters(node, settings.task, "task."), gains=gains)
    parts = {name: declare_parameters(node, getattr(settings, name), f"{name}.") for name in ("sac", "exam", "monitor")}
    return replace(declare_parameters(node, settings), task=task, **parts)


def keep_overridden(node: Node, before: T, after: T, prefix: str = "") -> T:
    """Return the settings `after`, but with the values of `before` where the user has set the ROS parameter."""
    kept: dict[str, Any] = {}
    for name in (field.name for field in fields(before)):  # type: ignore[arg-type]
        value = getattr(before, name)
        if is_dataclass(value):
            kept[name] = keep_overridden(node, value, getattr(after, name), f"{prefix}{name}.")
        elif f"{prefix}{name}" in node._parameter_overrides:  # rclpy: no public way
            kept[name] = value
    return replace(after, **kept)  # type: ignore[type-var]
