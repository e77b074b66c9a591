# SPDX-License-Identifier: Apache-2.0
"""Types shared by reader and writer: the error, and a topic's quality of service in rosbag2's notation."""

from __future__ import annotations

from dataclasses import dataclass

import yaml


class RecordingError(Exception):
    """A recording cannot be read or written; the message is one clear sentence."""


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
        listed = yaml.safe_load(profiles) or [{}]
        first = listed[0]
        numbers = {"reliability": {2: "best_effort"}, "durability": {1: "transient_local"}}  # before version 9
        reliability = numbers["reliability"].get(first.get("reliability"), first.get("reliability"))
        durability = numbers["durability"].get(first.get("durability"), first.get("durability"))
        return cls(
            reliability="best_effort" if reliability == "best_effort" else "reliable",
            durability="transient_local" if durability == "transient_local" else "volatile",
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
