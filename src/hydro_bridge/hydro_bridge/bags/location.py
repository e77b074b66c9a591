# SPDX-License-Identifier: Apache-2.0
"""Locations of recordings: a rosbag2 folder, an .mcap file, or a part of one from BEGIN up to END s since its start.

A part is named as in W3C's media fragments, `runs/day#t=3600,7200`; either number may be absent.
"""

from __future__ import annotations

import re
from math import inf
from pathlib import Path

import yaml

from hydro_bridge.bags.types import RecordingError


def split_location(path: Path | str) -> tuple[Path, tuple[float, float] | None]:
    """Split a location into the recording's path and the interval [s] that its `#t=` selects; None: all of it."""
    found = re.match(r"^(?P<whole>.*)#t=(?P<begin>\d+\.?\d*)?(,(?P<end>\d+\.?\d*)?)?$", str(path))
    if found is None:
        return Path(path), None
    return Path(found["whole"]), (float(found["begin"] or 0.0), float(found["end"] or inf))


def is_bag(path: Path | str) -> bool:
    """Return whether a location is a rosbag2 folder or an .mcap file, or a part of one."""
    whole, _ = split_location(path)
    return whole.is_dir() or whole.suffix == ".mcap"


def exists(path: Path | str) -> bool:
    """Return whether a location exists."""
    whole, part = split_location(path)
    return whole.exists() and (part is None or is_bag(path))


def mcap_files(path: Path) -> list[Path]:
    """Return the .mcap files of a recording, in order: those that metadata.yaml lists, without one all in the folder.

    Raises RecordingError: nothing is there, a listed file is missing, or the recording is not stored as plain mcap.
    """
    if not path.exists():
        raise RecordingError(f"{path} does not exist")
    plain, files, listing = path.suffix not in (".bag", ".db3"), [path], path / "metadata.yaml"
    if listing.is_file():
        try:
            information = yaml.safe_load(listing.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
            files = [path / Path(name).name for name in information["relative_file_paths"]]
            mode = str(information.get("compression_mode") or "none").lower()
            plain = information["storage_identifier"] == "mcap" and mode == "none"
        except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
            raise RecordingError(f"{listing} is not rosbag2 metadata: remove it to read the .mcap files") from None
    elif path.is_dir():  # day_2 before day_10
        files = sorted(path.glob("*.mcap"), key=lambda file: [int(word) for word in re.findall(r"\d+", file.name)])
    if not plain:
        source = path.parent if path.suffix == ".db3" else path
        command = f"rosbags-convert --src {source} --dst {source.with_name(f'{source.stem}_mcap')} --dst-storage mcap"
        raise RecordingError(f"{path} is not stored as plain mcap: {command}")
    if not files:
        raise RecordingError(f"{path} is no recording: there is no .mcap in it")
    if missing := [file.name for file in files if not file.exists()]:
        raise RecordingError(
            f"{listing} lists {', '.join(missing)}, which is missing: put it back, or remove metadata.yaml to read the "
            ".mcap files that are there"
        )
    return files
