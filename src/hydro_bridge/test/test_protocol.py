# SPDX-License-Identifier: Apache-2.0
"""Frames and their stream."""

from __future__ import annotations

import struct
from dataclasses import fields, replace
from zlib import crc32

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.serial.frames import FEEDBACKS
from hydro_bridge.serial.protocol import (
    HANDSHAKE,
    MAX_ENCODED,
    VERSION,
    BoxDetails,
    BoxInfo,
    BoxLaw,
    CheckSumError,
    CommandFrame,
    Details,
    Hello,
    LawFrame,
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
    negotiate,
)
from hydro_bridge.serial.stream import Decoder, SequenceTracker
from hydro_bridge.signals import Command, Law, ReferenceSignal, Waveform

u32 = st.integers(0, 2**32 - 1)
single = st.floats(width=32, allow_nan=False)
signals = st.builds(
    ReferenceSignal, waveform=st.sampled_from(Waveform), amplitude=single, offset=single, frequency=single, phase=single
)
laws, quadruples = st.sampled_from(Law), st.tuples(*[single] * 4)


def inside(wire: bytes) -> bytes:
    assert wire[0] == 0 and wire[-1] == 0 and 0 not in wire[1:-1]
    return wire[1:-1]


def sealed(body: bytes) -> bytes:
    return cobs.encode(body + struct.pack("<I", crc32(body)))


@given(u32, u32, st.sampled_from(FEEDBACKS), st.lists(single, min_size=10, max_size=10), st.integers(0, 255))
def test_details_round_trip(sequence, epoch, feedback, numbers, laws):
    names = [entry.name for entry in fields(BoxDetails)][4:]
    details = BoxDetails(
        epoch=epoch, bench_digest="0123456789ab", feedback=feedback, laws=laws, **dict(zip(names, numbers, strict=True))
    )
    assert decode(inside(encode_details(sequence, 5, details))) == Details(sequence, 5, details)
    older = decode(inside(encode_details(sequence, 5, details, version=2)))
    assert older == Details(sequence, 5, replace(details, laws=0))


@given(u32, st.lists(single, min_size=14, max_size=14), st.lists(quadruples, min_size=3, max_size=3))
def test_law_round_trip(sequence, numbers, limits):
    record = BoxLaw(**dict(zip((entry.name for entry in fields(BoxLaw)), (*numbers, *limits), strict=True)))
    assert decode(inside(encode_law(sequence, 5, record))) == LawFrame(sequence, 5, Law.COMPENSATED, record)


def test_a_frame_of_version_2_is_none_of_version_1():
    body = body_of(encode_details(1, 2, BoxDetails(), version=2))
    body[0] = 1
    with pytest.raises(UnknownFrameError):
        decode(sealed(bytes(body)))
    body = body_of(encode_state(1, 2, [0.0] * 14, 3, 4, (5, 6)))
    body[0] = 1
    with pytest.raises(MalformedError, match="86 bytes in a STATE"):
        decode(sealed(bytes(body)))


@pytest.mark.parametrize(("number", "form"), [(0, ""), (1, "paper"), (2, "bumpless"), (3, ""), (255, "")])
def test_the_fourth_byte_of_a_hello_is_the_form_of_the_integral(number, form):
    """What is not known here counts as not told: a newer box is not refused for it."""
    body = bytearray(cobs.decode(inside(encode_hello(1, 2, BoxInfo(integral="paper"))))[:-4])
    assert body[14 + 3] == 1
    body[14 + 3] = number
    assert decode(sealed(bytes(body))).info.integral == form


def test_beyond_float32_becomes_infinity():
    frame = decode(inside(encode_state(1, 2, [1e300, -1e300, *[0.0] * 12], 0, 0)))
    assert isinstance(frame, State) and frame.values[:2] == (float("inf"), float("-inf"))
    command = decode(inside(encode_command(1, 2, Command(delta_kp=1e300))))
    assert isinstance(command, CommandFrame) and command.command.delta_kp == float("inf")


@given(st.binary(max_size=120))
def test_decoding_hostile_bytes_with_a_valid_check_sum_raises_malformed_only(body):
    try:
        decode(sealed(body))
    except MalformedError as error:
        assert not isinstance(error, CheckSumError)


def body_of(wire: bytes) -> bytearray:
    return bytearray(cobs.decode(inside(wire))[:-4])


def test_unknown_type_of_this_version_is_told_from_another_version():
    body = body_of(encode_state(1, 2, [0.0] * 14, 3, 4))
    body[1] = 200
    with pytest.raises(UnknownFrameError):
        decode(sealed(bytes(body)))
    body[0], body[1] = VERSION + 1, 2
    with pytest.raises(WrongVersionError) as caught:
        decode(sealed(bytes(body)))
    assert caught.value.version == VERSION + 1


def test_unknown_waveform_and_wrong_length_are_malformed():
    body = body_of(encode_command(1, 2, Command()))
    with pytest.raises(MalformedError, match="bytes in a COMMAND"):
        decode(sealed(bytes(body) + b"x"))
    body[34] = 9
    with pytest.raises(MalformedError, match="waveform 9"):
        decode(sealed(bytes(body)))
    law_state = LawState(Law.PAPER, 1.0, 2.0, (1.0,) * 4, 1.0, 1.0)
    wires = (encode_command(1, 2, Command(), 3), encode_state(1, 2, [0.0] * 14, 3, 4, (5, 6), law_state))
    for wire, place in zip((*wires, encode_law(1, 2, BoxLaw())), (54, 86, 14), strict=True):
        body = body_of(wire)
        body[place] = 2
        with pytest.raises(MalformedError, match="law 2"):
            decode(sealed(bytes(body)))


def test_versions_are_negotiated():
    hello = Hello(1, 2, 1, 1, BoxInfo())
    assert negotiate(hello) == 1
    assert negotiate(hello._replace(version_max=7)) == VERSION
    with pytest.raises(WrongVersionError):
        negotiate(hello._replace(version_min=VERSION + 1, version_max=VERSION + 2))
    assert HANDSHAKE == 0


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


def test_tracker_wraps():
    tracker = SequenceTracker()
    assert all(tracker.accept(n % 2**32) for n in range(2**32 - 5, 2**32 + 5))
    assert tracker.counts.lost == tracker.counts.restarts == 0


def test_tracker_notices_a_restart_of_the_box():
    for before in (5_000, 3_000_000_000):
        tracker = SequenceTracker()
        assert tracker.accept(before) and tracker.accept(0) and tracker.accept(1)
        assert tracker.counts.restarts == 1 and tracker.counts.lost == 0
