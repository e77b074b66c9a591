# SPDX-License-Identifier: Apache-2.0
"""Files of a recording: those of a rosbag2 folder, complete or not, or a single .mcap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.bags.types import RecordingError


def mcap_files(path: Path) -> tuple[list[Path], list[str]]:
    """Return the .mcap files in order, and notes on anything unusual about the folder.

    Raises
    ------
    RecordingError
        Nothing there, or a recording that is not stored as plain mcap.
    """
    if path.is_file():
        return [path], []
    if not path.is_dir():
        raise RecordingError(f"{path} does not exist")
    if not (path / "metadata.yaml").is_file():
        files, notes = (sorted(path.glob("*.mcap")), [f"{path} has no metadata.yaml: read every .mcap in it, by name"])
    else:
        files, notes = _listed(path), []
    if not files:
        raise RecordingError(f"{path} holds no recording: there is no .mcap in it")
    return files, notes


def _listed(folder: Path) -> list[Path]:
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
        information: dict[str, Any] = yaml.safe_load(text)["rosbag2_bagfile_information"]
        names = [Path(name).name for name in information["relative_file_paths"]]
    except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
        raise RecordingError(f"{folder / 'metadata.yaml'} is no metadata of rosbag2") from None
    storage, mode = (information.get("storage_identifier"), str(information.get("compression_mode") or "none").lower())
    if storage != "mcap":
        raise RecordingError(f"{folder} is stored as {storage}, not as mcap: convert it with rosbags-convert")
    if mode != "none":
        raise RecordingError(f"{folder} is compressed by {mode}, not within mcap: convert it with rosbags-convert")
    return [folder / name for name in names]
