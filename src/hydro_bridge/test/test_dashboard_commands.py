# SPDX-License-Identifier: Apache-2.0
"""What a page may do: disarm always, all else with the terminal's token and the epoch of now."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.dashboard.server import COMMANDS, RefusedError, Rules, read

EPOCH = 2**64 - 59
"""JavaScript's numbers end at 2^53."""


def asked(command: str, **words: object) -> bytes:
    return msgspec.json.encode(
        {"command": command, "epoch": str(EPOCH), "token": "right", "kp": 60, "ki": 10, "seconds": 30, **words}
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_with_token_and_epoch_all_pass(command: str) -> None:
    Rules("right").check(read(asked(command)), EPOCH)


@pytest.mark.parametrize("epoch", [0, 1, EPOCH])
def test_disarm_needs_nothing(epoch: int) -> None:
    Rules("right").check(read(b'{"command":"disarm"}'), epoch)
    Rules("right").check(read(asked("disarm", token="wrong", epoch="7")), epoch)


@pytest.mark.parametrize("command", [command for command in COMMANDS if command != "disarm"])
@pytest.mark.parametrize("token", ["", "wrong", "righ", "right ", "ü"])
def test_nobody_without_the_token_does_anything_else(command: str, token: str) -> None:
    with pytest.raises(RefusedError, match="token"):
        Rules("right").check(read(asked(command, token=token)), EPOCH)


@pytest.mark.parametrize("command", [command for command in COMMANDS if command != "disarm"])
@pytest.mark.parametrize("seen", ["", "0", str(EPOCH - 1), "1.8446744073709552e19"])
def test_a_page_from_before_the_last_trip_does_nothing(command: str, seen: str) -> None:
    with pytest.raises(RefusedError, match="nothing was done"):
        Rules("right").check(read(asked(command, epoch=seen)), EPOCH)


@settings(deadline=None, max_examples=50)
@given(st.binary(max_size=200))
def test_hostile_bytes_end_in_a_sentence(data: bytes) -> None:
    with pytest.raises(RefusedError):
        read(data)
