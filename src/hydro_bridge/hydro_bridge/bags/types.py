# SPDX-License-Identifier: Apache-2.0
"""Types shared by reader and writer: the error, a topic's quality of service, definitions of messages.

A definition is ros2msg text with its nested types, and the RIHS01 type hash. Those of the hydro graph are package data,
so that recording needs no ROS installation; others come from the ament index. `python -m hydro_bridge.bags.types`
renews the package data from the installed messages; a test compares the two.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from hydro_core.errors import UserError


class RecordingError(UserError):
    """A recording cannot be read or written; the message is one sentence."""


@dataclass(frozen=True, kw_only=True)
class TopicQos:
    """Offered quality of service of a topic; policies not listed here are at their defaults."""

    reliability: str = "reliable"
    """reliable or best_effort."""
    durability: str = "volatile"
    """volatile or transient_local."""
    depth: int = 10

    @classmethod
    def from_rosbag2(cls, profiles: str) -> TopicQos:
        """Parse the YAML list in a channel's metadata; missing or unknown entries take their defaults."""
        first = (yaml.safe_load(profiles) or [{}])[0]
        best_effort = first.get("reliability") in ("best_effort", 2)  # numbers before version 9
        latched = first.get("durability") in ("transient_local", 1)
        return cls(
            reliability="best_effort" if best_effort else "reliable",
            durability="transient_local" if latched else "volatile",
            depth=int(first.get("depth") or 10),
        )

    def as_rosbag2(self) -> dict[str, object]:
        """Return all keys of an offered QoS profile, version 9."""
        forever = {"sec": 9223372036, "nsec": 854775807}
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(forever),
            "lifespan": dict(forever),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(forever),
            "avoid_ros_namespace_conventions": False,
        }


BUNDLED_TYPES = (
    "hydro_msgs/msg/Authority",
    "hydro_msgs/msg/BenchState",
    "hydro_msgs/msg/BoxInfo",
    "hydro_msgs/msg/BoxLaw",
    "hydro_msgs/msg/Correction",
    "hydro_msgs/msg/Gains",
    "hydro_msgs/msg/LawCommand",
    "hydro_msgs/msg/LawState",
    "hydro_msgs/msg/PolicyStep",
    "hydro_msgs/msg/ReferenceSignal",
    "hydro_msgs/msg/TrainingStatus",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
)
"""Types whose definitions are shipped with this package."""
_SCHEMA_FILE = Path(__file__).with_name("schemas.json")

_SEPARATOR = "=" * 80


@dataclass(frozen=True, kw_only=True)
class Definition:
    """Type definition for an MCAP channel."""

    text: str
    """Encoding ros2msg: the type's own .msg text, then each nested type below a rule and `MSG: package/Type`."""
    type_hash: str
    """RIHS01 hash of the type description."""


class UnknownTypeError(UserError, LookupError):
    """No definition of this message type was found; the message names the type."""


@cache
def definition(type_name: str) -> Definition:
    """Return the definition of `package/msg/Type`.

    Raises UnknownTypeError: neither package data nor the ament index has it.
    """
    packaged = json.loads(_SCHEMA_FILE.read_text(encoding="utf-8"))
    return Definition(**packaged[type_name]) if type_name in packaged else installed_definition(type_name)


def installed_definition(type_name: str) -> Definition:
    """Return the definition from the .msg and .json files installed by rosidl; raises UnknownTypeError."""
    description = json.loads(_installed(type_name, ".json"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    nested = [entry["type_name"] for entry in description["type_description_msg"]["referenced_type_descriptions"]]
    parts = [_installed(type_name, ".msg").rstrip("\n")]
    for name in nested:
        parts += [_SEPARATOR, f"MSG: {name.replace('/msg/', '/')}", _installed(name, ".msg").rstrip("\n")]
    return Definition(text="\n".join(parts) + "\n", type_hash=hashes[type_name])


def _installed(type_name: str, suffix: str) -> str:
    package, *rest = type_name.split("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "share", package, *rest).with_suffix(suffix)
        if prefix and path.is_file():
            return path.read_text(encoding="utf-8")
    raise UnknownTypeError(f"no definition of {type_name} in AMENT_PREFIX_PATH: is its package built and sourced?")


def main() -> None:
    """Regenerate the package data from the installed messages."""
    packaged = {name: vars(installed_definition(name)) for name in BUNDLED_TYPES}
    _SCHEMA_FILE.write_text(json.dumps(packaged, indent=1) + "\n", encoding="utf-8")
    print(f"{_SCHEMA_FILE}: {len(packaged)} types")


if __name__ == "__main__":
    main()
