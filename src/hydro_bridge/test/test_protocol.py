# SPDX-License-Identifier: Apache-2.0
"""Frames and their stream."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.serial.protocol import (
    HANDSHAKE,
    MAX_ENCODED,
    VERSION,
    BoxDetails,
    BoxInfo,
    BoxLaw,
    CheckSumError,
    CommandFrame,
    Hello,
    LawState,
    MalformedError,
    State,
    UnknownFrameError,
    WrongVersionError,
    decode,
    encode_command,
    encode_details,
    encode_hello,
    encode_law,
    encode_state,
    version_mismatch_message,
)
from hydro_bridge.serial.stream import Decoder, SequenceTracker
from hydro_core.signals import Command, Law
from tests.fuzz_link import altered, sealed


def inside(wire: bytes) -> bytes:
    assert wire[0] == 0 and wire[-1] == 0 and 0 not in wire[1:-1]
    return wire[1:-1]


@pytest.mark.parametrize(("number", "form"), [(0, ""), (1, "paper"), (2, "bumpless"), (3, ""), (255, "")])
def test_the_fourth_byte_of_a_hello_is_the_form_of_the_integral(number, form):
    """What is not known here counts as not told: a newer box is not refused for it."""
    told = encode_hello(1, 2, BoxInfo(integral="paper"))
    assert altered(told, {17: 1}) == told
    assert decode(inside(altered(told, {17: number}))).info.integral == form


def test_beyond_float32_becomes_infinity():
    frame = decode(inside(encode_state(1, 2, [1e300, -1e300, *[0.0] * 12], 0, 0)))
    assert isinstance(frame, State) and frame.values[:2] == (float("inf"), float("-inf"))
    command = decode(inside(encode_command(1, 2, Command(delta_kp=1e300))))
    assert isinstance(command, CommandFrame) and command.command.delta_kp == float("inf")


@given(st.binary(max_size=120))
def test_decoding_hostile_bytes_with_a_valid_check_sum_raises_malformed_only(body):
    try:
        decode(inside(sealed(body)))
    except MalformedError as error:
        assert not isinstance(error, CheckSumError)


STATE = encode_state(1, 2, [0.0] * 14, 3, 4, (5, 6), LawState(Law.PAPER, 1.0, 2.0, (1.0,) * 4, 1.0, 1.0))
UNREADABLE = (
    (encode_details(1, 2, BoxDetails()), {0: 1}, WrongVersionError, "frame of version 1, here version 3"),
    (STATE, {1: 200}, UnknownFrameError, None),
    (STATE, {0: VERSION + 1}, WrongVersionError, f"frame of version {VERSION + 1}"),
    (encode_command(1, 2, Command()), {34: 9}, MalformedError, "waveform 9"),
    (encode_command(1, 2, Command()), {54: 2}, MalformedError, "law 2"),
    (STATE, {86: 2}, MalformedError, "law 2"),
    (encode_law(1, 2, BoxLaw()), {14: 2}, MalformedError, "law 2"),
)
"""Frames, other bytes at places of them, and what is said: other versions, unknown types, waveforms, laws."""


def test_what_cannot_be_read_is_told_by_its_kind():
    for wire, bytes_at, kind, said in UNREADABLE:
        with pytest.raises(kind, match=said):
            decode(inside(altered(wire, bytes_at)))
    with pytest.raises(MalformedError, match="bytes in a COMMAND"):
        decode(inside(altered(encode_command(1, 2, Command()), {}, b"x")))


def test_a_greeting_is_read_whatever_version_it_offers():
    hello = decode(inside(altered(encode_hello(1, 2, BoxInfo()), {14: 1, 15: 2})))
    assert isinstance(hello, Hello) and (hello.version_min, hello.version_max) == (1, 2)
    assert (
        HANDSHAKE == 0
        and "rebuild its firmware" in version_mismatch_message(2)
        and "update hydro" in version_mismatch_message(4)
    )


def wire(sequence: int) -> bytes:
    return encode_state(sequence, 1000 * sequence, [float(sequence)] * 14, 0, 0)


def test_a_stream_without_delimiter_is_counted_once_and_not_kept():
    decoder = Decoder()
    for _ in range(1000):
        assert decoder.feed(b"x" * 1000) == []
        assert len(decoder._pending) <= MAX_ENCODED
    assert decoder.counts.malformed == 1
    assert [frame.sequence for frame in decoder.feed(wire(5))] == [5]


@pytest.mark.parametrize("cut", [0, 1, 20, -1])
def test_a_piece_that_the_opening_of_the_port_cut_is_no_error(cut):
    decoder = Decoder()
    for _ in range(2):
        assert [frame.sequence for frame in decoder.feed(wire(3)[cut:] + wire(4))] == ([3, 4] if cut == 0 else [4])
        decoder.reset()
    decoder.feed(wire(5)[:-9] + wire(6))
    assert decoder.counts.crc_errors + decoder.counts.malformed == 1, "a piece between delimiters is"


@given(st.lists(st.integers(0, 30), max_size=60))
def test_tracker_delivers_each_number_once_and_in_order(arrivals):
    tracker = SequenceTracker()
    delivered = [n for n in arrivals if tracker.accept(n)]
    assert delivered == sorted(set(delivered))
    counts = tracker.counts
    assert len(delivered) + counts.duplicates + counts.reordered == len(arrivals)
    if delivered:
        assert counts.lost == delivered[-1] - delivered[0] + 1 - len(delivered)
