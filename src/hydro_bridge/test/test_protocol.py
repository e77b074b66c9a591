# SPDX-License-Identifier: Apache-2.0
"""Frames and their stream; the bytes of each frame are those of protocol.md (tests/test_protocol_page.py)."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.serial import protocol
from hydro_bridge.serial.protocol import MalformedError, WrongVersionError, decode
from hydro_bridge.serial.stream import Decoder, SequenceTracker
from hydro_core.signals import Command
from tests.box_frames import encode_details, encode_law, encode_state
from tests.frames import DAMAGES, altered, sealed

COMMAND = protocol.encode_command(1, 2, Command())
STATE = encode_state(1, 2, [0.0] * 14, 3, 4)


def inside(wire: bytes) -> bytes:
    assert wire[0] == 0 and wire[-1] == 0 and 0 not in wire[1:-1]
    return wire[1:-1]


def wire(sequence: int) -> bytes:
    return encode_state(sequence, 1000 * sequence, [float(sequence)] * 14, 0, 0)


def test_a_greeting_is_read_whatever_version_and_form_of_the_integral_it_tells():
    told = protocol.encode_hello(1, 2, protocol.BoxInfo(integral="paper"))
    assert altered(told, {17: 1}) == told
    hello = decode(inside(altered(told, {14: 1, 15: 2})))
    assert (hello.version_min, hello.version_max) == (1, 2)
    for number, form in ((0, ""), (1, "paper"), (2, "bumpless"), (3, ""), (255, "")):  # a newer box is not refused
        assert decode(inside(altered(told, {17: number}))).info.integral == form


def test_beyond_float32_becomes_infinity():
    assert decode(inside(encode_state(1, 2, [1e300, -1e300, *[0.0] * 12], 0, 0))).values[:2] == (inf, -inf)
    assert decode(inside(protocol.encode_command(1, 2, Command(delta_kp=1e300)))).command.delta_kp == inf


@given(st.binary(max_size=120))
def test_decoding_hostile_bytes_with_a_valid_check_sum_raises_malformed_only(body):
    try:
        decode(inside(sealed(body)))
    except MalformedError as error:
        assert not isinstance(error, protocol.CheckSumError)


@pytest.mark.parametrize(
    ("unreadable", "kind", "said"),
    [
        (
            altered(encode_details(1, 2, protocol.BoxDetails()), {0: 1}),
            WrongVersionError,
            "of version 1, here",
        ),
        (altered(STATE, {0: protocol.VERSION + 1}), WrongVersionError, f"frame of version {protocol.VERSION + 1}"),
        (altered(STATE, {1: 200}), protocol.UnknownFrameError, None),
        (altered(COMMAND, {34: 9}), MalformedError, "waveform 9"),
        (altered(COMMAND, {54: 2}), MalformedError, "law 2"),
        (altered(STATE, {86: 2}), MalformedError, "law 2"),
        (altered(encode_law(1, 2, protocol.BoxLaw()), {14: 2}), MalformedError, "law 2"),
        (altered(COMMAND, {}, b"x"), MalformedError, "bytes in a COMMAND"),
    ],
    ids=range(8),
)
def test_what_cannot_be_read_is_told_by_its_kind(unreadable, kind, said):
    with pytest.raises(kind, match=said):
        decode(inside(unreadable))


WHOLE: tuple[Callable[[bytes, Random], bytes], ...] = (
    lambda wire, random: wire,
    lambda wire, random: 2 * wire,
    lambda wire, random: random.randbytes(random.choice((1, 20, 5 * protocol.ENCODED_SIZE_MAX))) + wire,
)


@given(st.lists(st.sampled_from((*WHOLE, *DAMAGES)), max_size=60), st.integers(0, 1 << 32))
def test_of_a_hostile_stream_whole_frames_are_delivered_and_none_that_was_not_sent(damages, seed):
    random, decoder, delivered = Random(seed), Decoder(), set()
    stream = b"".join(damage(wire(sequence), random) for sequence, damage in enumerate(damages)) + b"\0"
    while stream:  # in pieces, as a port delivers it
        size = random.choice((1, 2, 16, 85, 400))
        for frame in decoder.feed(stream[:size]):
            assert frame == decode(inside(wire(frame.sequence)))
            delivered.add(frame.sequence)
        assert len(decoder._pending) <= protocol.ENCODED_SIZE_MAX
        stream = stream[size:]
    assert delivered >= {sequence for sequence, damage in enumerate(damages) if damage in WHOLE}
    assert max(delivered, default=-1) < len(damages)


def test_a_stream_without_delimiter_is_counted_once_and_not_kept():
    decoder = Decoder()
    for _ in range(1000):
        assert decoder.feed(b"x" * 1000) == []
        assert len(decoder._pending) <= protocol.ENCODED_SIZE_MAX
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
