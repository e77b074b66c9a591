# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: everything that a run needs to resume, in a folder that is written atomically.

    learner.safetensors   networks, optimizers, temperature, random generator (`snapshot`)
    replay.npy            stored transitions, oldest first; the count of all ever stored is in trainer.json
    trainer.json          episode, steps, random states of the acting side, best episode

It is written into a temporary folder and renamed, so that an interrupted writer leaves the previous one.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_bridge.files.atomic import flush_folder, write_whole
from hydro_bridge.files.tensors import UnsoundError, check_numbers
from hydro_policy.sac.replay import ReplayBuffer


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint: the learner's bytes, transitions [n, width], their total count, the acting side's state."""

    learner: bytes
    replay: NDArray[np.float32]
    produced: int
    trainer: dict[str, Any]


def save_checkpoint(folder: Path, learner: bytes, replay: ReplayBuffer, trainer: dict[str, Any]) -> None:
    """Write a checkpoint to `folder`, replacing the one there only once it is complete on disk.

    Raises
    ------
    OSError
        The checkpoint cannot be written; the previous one is unchanged.
    """
    partial, previous = folder.with_name(folder.name + ".partial"), folder.with_name(folder.name + ".previous")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        rows, produced = replay.stored()
        with (partial / "replay.npy").open("wb") as file:
            np.save(file, rows)
            _flush(file)
        write_whole(partial / "learner.safetensors", learner)
        state = {"produced": produced, "trainer": trainer}
        write_whole(partial / "trainer.json", json.dumps(state, indent=1).encode())
    except OSError:  # full disk: the partial checkpoint takes space that others need
        shutil.rmtree(partial, ignore_errors=True)
        raise
    shutil.rmtree(previous, ignore_errors=True)
    if folder.exists():
        folder.rename(previous)
    partial.rename(folder)
    flush_folder(folder.parent)
    shutil.rmtree(previous, ignore_errors=True)


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read a checkpoint, or the previous one if the writer died between the two renames.

    Raises
    ------
    ValueError
        There is no checkpoint, or it is damaged.
    """
    previous = folder.with_name(folder.name + ".previous")
    source = previous if not (folder / "trainer.json").exists() and previous.exists() else folder
    try:
        state = json.loads((source / "trainer.json").read_text())
        rows = np.load(source / "replay.npy", allow_pickle=False)
        if rows.ndim != 2 or not len(rows) <= int(state["produced"]) or not isinstance(state["trainer"], dict):
            raise UnsoundError(f"{rows.shape} transitions of {state['produced']} and the state beside them do not fit")
        check_numbers({"replay.npy": rows})
        return Checkpoint((source / "learner.safetensors").read_bytes(), rows, int(state["produced"]), state["trainer"])
    except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder} holds no readable checkpoint: {error}") from error


def _flush(file: Any) -> None:
    file.flush()
    os.fsync(file.fileno())
