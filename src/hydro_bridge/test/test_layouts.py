# SPDX-License-Identifier: Apache-2.0
"""Layouts for Foxglove and PlotJuggler name what recordings hold, and every panel that they place."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from rosbags.typesys import get_types_from_msg

from hydro_bridge.bags.schema import definition

LAYOUTS = Path(__file__).parents[1] / "layouts"
TYPES = {
    "/hydro/state": "hydro_msgs/msg/BenchState",
    "/hydro/correction": "hydro_msgs/msg/Correction",
    "/hydro/training": "hydro_msgs/msg/TrainingStatus",
    "/hydro/authority": "hydro_msgs/msg/Authority",
    "/hydro/box": "hydro_msgs/msg/BoxInfo",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def fields(topic: str) -> set[str]:
    """Of the topic's message."""
    name = TYPES[topic]
    _, members = get_types_from_msg(definition(name).text, name)[name]
    return {member for member, _ in members}


def placed(layout: str | dict[str, Any]) -> list[str]:
    """Panels in a tree of panels."""
    return [layout] if isinstance(layout, str) else placed(layout["first"]) + placed(layout["second"])


def test_what_foxglove_plots_is_in_the_messages_and_each_panel_has_one_place() -> None:
    content = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    assert sorted(placed(content["layout"])) == sorted(content["configById"])
    paths = [path["value"] for panel in content["configById"].values() for path in panel.get("paths", ())]
    assert len(paths) > 10
    for path in paths:
        topic, field = path.rsplit(".", 1)
        assert field in fields(topic), path
    whole = [panel.get("topicPath") or panel.get("topicToRender") for panel in content["configById"].values()]
    assert all(topic in TYPES for topic in whole if topic)


def test_what_plotjuggler_plots_is_in_the_messages() -> None:
    root = ElementTree.fromstring((LAYOUTS / "plotjuggler.xml").read_bytes())
    curves = [str(curve.get("name")) for curve in root.iter("curve")]
    assert len(curves) > 10
    for curve in curves:
        topic, field = curve.rsplit("/", 1)
        assert field in fields(topic), curve
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.get("count", 0)) == len(str(splitter.get("sizes")).split(";"))
