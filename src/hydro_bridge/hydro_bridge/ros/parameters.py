# SPDX-License-Identifier: Apache-2.0
"""A settings dataclass as ROS parameters: names, defaults, descriptions and ranges come from the dataclass."""

from __future__ import annotations

from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from hydro_bridge.settings import Setting, SettingsError, check, converted, describe

T = TypeVar("T")


def declare_parameters(node: Node, settings: T, prefix: str = "") -> T:
    """Declare a read-only parameter for each field, and return the settings with the user's values.

    Parameters
    ----------
    settings
        Instance of a settings dataclass: its values are the defaults. Fields other than numbers, strings and flags
        are skipped.
    prefix
        Prefix of each name, for instance ``guard.``.

    Raises
    ------
    SettingsError
        A value has the wrong type or is out of range.
    """
    chosen: dict[str, Any] = {}
    for field in fields(settings):  # type: ignore[arg-type]
        default = getattr(settings, field.name)
        if isinstance(default, (bool, int, float, str)):
            name, setting = prefix + field.name, describe(type(settings))[field.name]
            try:
                value = node.declare_parameter(name, default, _descriptor(setting)).value
            except ParameterException as error:
                raise SettingsError(f"parameter {name}: {error}; {setting.text}") from None
            chosen[field.name] = converted(setting, value, f"parameter {name}", strict=True)
    declared = replace(settings, **chosen)  # type: ignore[type-var]
    check(declared)
    return declared


def refuse_unknown_parameters(node: Node) -> None:
    """Raise for parameters that were set but not declared; ROS would ignore them, even a misspelt limit.

    Raises
    ------
    SettingsError
        The user set a parameter, by name or in a file, that this node does not have.
    """
    for name in node._parameter_overrides:  # rclpy has no public access to the user's values
        if not node.has_parameter(name):
            close = get_close_matches(name, node.get_parameters_by_prefix(""), 1)
            hint = f"; is {close[0]} meant?" if close else ""
            raise SettingsError(f"{node.get_name()} has no parameter {name}{hint}")


def _descriptor(setting: Setting) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=setting.text, read_only=True, dynamic_typing=True)
    if setting.range and setting.kind is float:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(setting.low), to_value=float(setting.high))
        ]
    elif setting.range:
        descriptor.integer_range = [IntegerRange(from_value=int(setting.low), to_value=int(setting.high), step=1)]
    return descriptor
