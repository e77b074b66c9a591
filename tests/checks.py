# SPDX-License-Identifier: Apache-2.0
"""Many cases in one test, and a command called as its entry point calls it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
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
