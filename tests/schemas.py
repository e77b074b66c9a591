# SPDX-License-Identifier: Apache-2.0
"""The message definitions by which recordings are read, from the installed messages: `python -m tests.schemas`."""

from __future__ import annotations

import json
import os
from pathlib import Path

from hydro_bridge.bags.cdr import SCHEMA_FILE


def installed_definition(type_name: str) -> dict[str, str]:
    """Text and hash from the .msg and .json files that rosidl installed."""

    def text(name: str, suffix: str) -> str:
        prefixes = map(Path, os.environ["AMENT_PREFIX_PATH"].split(os.pathsep))
        paths = ((prefix / "share" / name).with_suffix(suffix) for prefix in prefixes)
        return next(path for path in paths if path.is_file()).read_text(encoding="utf-8")

    description = json.loads(text(type_name, ".json"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    parts = [text(type_name, ".msg").rstrip("\n")]
    for entry in description["type_description_msg"]["referenced_type_descriptions"]:
        name = entry["type_name"]
        parts += ["=" * 80, f"MSG: {name.replace('/msg/', '/')}", text(name, ".msg").rstrip("\n")]
    return {"text": "\n".join(parts) + "\n", "type_hash": hashes[type_name]}


def installed_definitions() -> dict[str, dict[str, str]]:
    """Definitions of all recorded types."""
    from hydro_bridge.ros.topics import RECORDED_TOPICS, type_name

    return {
        name: installed_definition(name) for name in sorted(type_name(kind) for kind, _ in RECORDED_TOPICS.values())
    }


if __name__ == "__main__":
    SCHEMA_FILE.write_text(json.dumps(installed_definitions(), indent=1) + "\n", encoding="utf-8")
