# SPDX-License-Identifier: Apache-2.0
"""Border of the stages: an exception inside a stage costs the diagnosis that stage, not the report."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from hydro_core.files.atomic import write_atomic
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.report_json import LostStage

T = TypeVar("T")
TRACEBACKS = "tracebacks.txt"
"""File of the lost stages' tracebacks, beside the report."""


class StageError(RuntimeError):
    """Loss of a stage without which there is no report; the message is one sentence for the user."""

    def __init__(self, sentence: str, border: StageBorder) -> None:
        super().__init__(sentence)
        self.border = border


@dataclass
class StageBorder:
    """The one place where exceptions of stages are caught."""

    lost: list[LostStage] = field(default_factory=list)
    """Lost stages, in order: `lost` of report.json."""
    tracebacks: list[str] = field(default_factory=list)

    def run(self, stage: str, work: Callable[[], T], instead: Callable[[], T] | None = None) -> T:
        """Return the result of a stage, or of `instead` if the stage raises an exception other than InputError.

        Raises StageError if there is no `instead`, or if that fails too; OSError of a stage without it is raised.
        """
        try:
            return work()
        except InputError:
            raise
        except Exception as error:
            if instead is None and isinstance(error, OSError):  # a file that cannot be read: no fault of the program
                raise
            said = f"{type(error).__name__}: {error}".rstrip(": ").partition("\n")[0]
            sentence = (
                f"the stage `{stage}` failed ({said}): nothing here rests on it; {TRACEBACKS} holds the traceback"
            )
            self.lost.append(LostStage(stage=stage, sentence=sentence))
            self.tracebacks.append(f"{stage}\n{traceback.format_exc()}")
            if instead is None:
                raise StageError(sentence, self) from error
        return self.run(stage, instead)

    def write(self, folder: Path) -> None:
        """Write the tracebacks to a folder; without any, remove those of an earlier diagnosis."""
        if self.tracebacks:
            write_atomic(folder / TRACEBACKS, "\n".join(self.tracebacks).encode())
        else:
            (folder / TRACEBACKS).unlink(missing_ok=True)
