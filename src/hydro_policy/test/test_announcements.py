# SPDX-License-Identifier: Apache-2.0
"""What a trainer says: a sentence as often as it is news, a flood as one; a log that cannot be written ends nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydro_policy.nodes.graph.announcements import Announcer


def test_a_log_that_takes_no_more_ends_and_is_told_of_once(capsys: pytest.CaptureFixture[str]) -> None:
    announcer = Announcer()
    with Path("/dev/full").open("w", buffering=1) as announcer.log:
        announcer.say("one")
        announcer.say("two", warning=True)
        announcer.keep("a companion's line\n")
    assert capsys.readouterr().err.splitlines() == ["one", "! the log ends here: No space left on device", "! two"]
