# SPDX-License-Identifier: Apache-2.0
"""What several files of whole-graph tests use."""

from __future__ import annotations

import importlib
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.graph_probe import Probe


@pytest.fixture
def probe() -> Iterator[Probe]:
    """A node that watches, in a domain of its own."""
    from tests.graph_probe import Probe, own_domain

    with own_domain():
        watcher = Probe()
        yield watcher
        watcher.close()


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """Call `package executable` as its entry point does: one sentence, status 2, nothing left in the folder, its @."""
    from docs.generate_reference import executables

    def check(command: str, words: str, sentence: str, folder: Path) -> None:
        package, name = command.split()
        before = set(folder.rglob("*"))
        monkeypatch.setattr(sys, "argv", [name, *shlex.split(words.replace("@", f"{folder}/"))])
        with pytest.raises(SystemExit) as ended:
            sys.exit(importlib.import_module(executables(package)[name]).main())
        *others, said = capfd.readouterr().err.splitlines()
        assert ended.value.code == 2, said
        assert "error: " in said and sentence in said, said
        assert "Traceback" not in "".join(others) and set(folder.rglob("*")) == before, "nothing is left behind"

    return check
