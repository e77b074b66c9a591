# SPDX-License-Identifier: Apache-2.0
"""What tests of all packages do: many cases in one, commands, compilers, waiting, a disk that is full."""

from __future__ import annotations

import os
import resource
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest


def each(cases: Iterable[Any], check: Callable[..., None], name: Callable[[Any], object] = str) -> None:
    """Check all cases: what fails is named together in the end."""
    listed, wrong = list(cases), []
    for case in listed:
        try:
            check(case)
        except (Exception, pytest.fail.Exception) as error:
            wrong.append(f"{name(case)}: {error!r}")
    assert listed, "no case"
    assert not wrong, f"{len(wrong)} of {len(listed)} fail\n" + "\n".join(wrong)


def status_of(main: Callable[[], object], *words: object) -> int:
    """Exit status of a command with these words."""
    with patch("sys.argv", ["command", *map(str, words)]), pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def ran(*command: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """A program that has ended, with what it said; `more`: see subprocess.run."""
    usual: dict[str, Any] = {"capture_output": True, "text": True, "check": False, "timeout": 280.0}
    return subprocess.run([*map(str, command)], **usual | more)


def compiled(source: Path, program: Path, *words: str) -> Path:
    """The program that a C compiler makes of a source, without a warning."""
    strict = ("-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror")
    command = [os.environ.get("CC", "cc"), *strict, *words, str(source), "-o", str(program), "-lm"]
    subprocess.run(command, check=True)
    return program


def wait(
    condition: Callable[[], object], timeout: float = 30.0, meanwhile: Callable[[], object] = lambda: time.sleep(2e-3)
) -> None:
    """Wait until `condition` holds; fails after `timeout` seconds."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        meanwhile()


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Within, the system refuses to let a file grow beyond `size` bytes, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
