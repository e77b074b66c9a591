# SPDX-License-Identifier: Apache-2.0
"""What a trainer says: a sentence as often as it is news, a flood as one; a log that cannot be written ends nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydro_policy.nodes.graph.announcements import Announcer, RepeatFilter


def test_a_flood_of_two_sentences_is_told_in_a_few_lines_and_then_counted() -> None:
    flood = RepeatFilter(8)
    told = []
    for k in range(564):  # as many as a flood of false states once made in 2.5 s
        sentence = f"paused at step {k}" if k % 2 else "plant: armed"
        told.append(flood.passed(sentence, now=2.5 * k / 564))
    assert sum(map(bool, told)) == 16
    assert flood.passed("plant: armed", now=12.0) == "plant: armed (and 274 times before this)"
    assert flood.passed("plant: armed", now=12.1) == "plant: armed"


def test_a_log_that_takes_no_more_ends_and_is_told_of_once(capsys: pytest.CaptureFixture[str]) -> None:
    announcer = Announcer()
    with Path("/dev/full").open("w", buffering=1) as announcer.log:
        announcer.say("one")
        announcer.say("two", warning=True)
        announcer.keep("a companion's line\n")
    assert capsys.readouterr().err.splitlines() == ["one", "! the log ends here: No space left on device", "! two"]
