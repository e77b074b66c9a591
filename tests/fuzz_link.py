# SPDX-License-Identifier: Apache-2.0
"""Hostile frames to the decoder of the serial line.

Frames of all types are sent through a line that damages them, each in one of the ways of `DAMAGES`, and cuts the
stream anywhere. What must hold: nothing is raised; no frame is accepted that was not sent; every frame that arrives
whole is accepted, also right behind garbage; what is kept of a stream is bounded.
"""

from __future__ import annotations

from binascii import crc32
from collections import Counter
from collections.abc import Callable, Mapping
from random import Random

from cobs import cobs

from hydro_bridge.serial import protocol
from hydro_bridge.serial.protocol import ENCODED_SIZE_MAX, BoxInfo, Frame, LawState
from hydro_bridge.serial.stream import Decoder
from hydro_core.signals import Command, Law, ReferenceSignal, Waveform

BATCH = 2000
RULES = ("forged", "whole lost", "bytes kept too many")
"""What must be 0 of all that is counted: frames accepted that were never sent; whole ones not accepted; memory."""


def _flip(wire: bytes, random: Random) -> bytes:
    """One to eight bits turned over anywhere, delimiters included."""
    damaged = bytearray(wire)
    for _ in range(random.randint(1, 8)):
        damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
    return bytes(damaged)


def _splice(wire: bytes, random: Random) -> bytes:
    """Bytes missing, too many, or others in their place: anywhere, at most up to the end."""
    begin = random.randrange(len(wire))
    end = min(begin + random.choice((0, 1, 8, len(wire))), len(wire))
    return wire[:begin] + random.randbytes(random.choice((0, 8, end - begin))) + wire[end:]


def _seal_anew(wire: bytes, random: Random) -> bytes:
    """Another version, type or length, with a check sum that holds: a foreign or a broken sender."""
    byte = random.randrange(4, 256)
    return altered(wire, {random.choice((0, 1)): byte}, random.randbytes(random.choice((0, 0, 1, 40))))


def altered(wire: bytes, bytes_at: Mapping[int, int], more: bytes = b"") -> bytes:
    """The frame with other bytes at some places of its body, and `more` behind it: its check sum holds."""
    body = bytearray(cobs.decode(wire[1:-1])[:-4])
    for place, byte in bytes_at.items():
        body[place] = byte
    return sealed(bytes(body) + more)


def sealed(body: bytes) -> bytes:
    """A frame of this body, with its check sum."""
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


DAMAGES: dict[str, tuple[Callable[[bytes, Random], bytes], bool]] = {
    "none": (lambda wire, random: wire, True),
    "bits flipped": (_flip, False),
    "bytes exchanged": (_splice, False),
    "foreign": (_seal_anew, False),
    "garbage before": (
        lambda wire, random: random.randbytes(random.choice((1, 3, 20, 5 * ENCODED_SIZE_MAX))) + wire,
        True,
    ),
    "duplicated": (lambda wire, random: 2 * wire, True),
    "reordered": (lambda wire, random: wire, True),
}
"""What is done, and whether the frame is still whole after it."""


def make_frame(sequence: int, random: Random) -> bytes:
    """A frame of any type with random content."""
    time_us, kind = random.getrandbits(64), random.random()
    numbers = [random.gauss(0, 1e4) for _ in range(14)]
    if kind < 0.6:
        acting = LawState(Law.COMPENSATED, *numbers[:2], (1.0, *numbers[2:5]), *numbers[5:7])
        return protocol.encode_state(sequence, time_us, numbers, random.getrandbits(8), sequence, (sequence, 1), acting)
    if kind < 0.98:
        signal = ReferenceSignal(
            waveform=random.choice(tuple(Waveform)), amplitude=numbers[0], offset=numbers[1], frequency=numbers[2],
            phase=numbers[3],
        )  # fmt: skip
        command = Command(
            arm=random.random() < 0.5, delta_kp=numbers[4], delta_ki=numbers[5], delta_u=numbers[6], reference=signal,
            corrected_sequence=random.getrandbits(32), filter_fresh=random.random() < 0.5,
            law=random.choice(tuple(Law)), coefficients=(1.0, *numbers[7:10]),
        )  # fmt: skip
        return protocol.encode_command(sequence, time_us, command)
    info = BoxInfo(name="box", base_kp=random.random()) if kind < 0.99 else None
    return protocol.encode_hello(sequence, time_us, info)


def hostile_batch(first: int, count: int, random: Random) -> tuple[bytes, dict[int, tuple[str, Frame]]]:
    """Stream of damaged frames, and what was sent: sequence -> damage, frame."""
    sent: dict[int, tuple[str, Frame]] = {}
    wires: list[tuple[str, bytes]] = []
    for sequence in range(first, first + count):
        damage, wire = random.choice(tuple(DAMAGES)), make_frame(sequence, random)
        sent[sequence] = (damage, protocol.decode(wire[1:-1]))
        wires.append((damage, DAMAGES[damage][0](wire, random)))
    for place in range(count - 1):
        if wires[place][0] == "reordered":
            wires[place], wires[place + 1] = wires[place + 1], wires[place]
    return b"".join(wire for _, wire in wires) + b"\0", sent


def fuzz(frames: int, seed: int) -> Counter[str]:
    """Send `frames` frames: how many there were of each damage, delivered just as sent (a duplicate twice), and not."""
    random, decoder, counted = Random(seed), Decoder(), Counter[str]()
    for first in range(0, frames, BATCH):
        count = min(BATCH, frames - first)
        stream, sent = hostile_batch(first, count, random)
        seen: set[int] = set()
        while stream:  # in chunks of 1 to 400 bytes, as a port delivers it
            size = random.choice((1, 2, 16, 85, 400))
            for frame in decoder.feed(stream[:size]):
                damage, original = sent.get(frame.sequence, ("unknown", None))
                counted[f"{damage}: {'delivered' if frame == original else 'forged'}"] += 1
                seen.add(frame.sequence)
            stream = stream[size:]
            counted["bytes kept too many"] += len(decoder._pending) > ENCODED_SIZE_MAX
        for sequence, (damage, _) in sent.items():
            counted[f"{damage}: frames"] += 1
            if sequence not in seen:
                counted[f"{damage}: {'whole lost' if DAMAGES[damage][1] else 'refused'}"] += 1
    return counted


def violations(counted: Counter[str]) -> list[str]:
    """Rules that were broken."""
    return [f"{what}: {number}" for what, number in counted.items() if what.endswith(RULES) and number]
