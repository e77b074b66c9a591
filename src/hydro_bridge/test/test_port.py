# SPDX-License-Identifier: Apache-2.0
"""On real pseudo-terminals: these behave as serial ports do, unplugging included."""

from __future__ import annotations

import os
import time
from contextlib import suppress

import pytest

from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.settings import SettingsError


@pytest.fixture
def port(cable):
    made = Port(PortSettings(path=str(cable.path)))
    yield made
    made.close()


def test_bytes_arrive_as_soon_as_they_are_there(cable, port):
    port.open()
    os.write(cable.box, b"\x00\x01\xff\r\n\x03")
    began = time.monotonic()
    assert port.read(5.0) == b"\x00\x01\xff\r\n\x03"
    assert time.monotonic() - began < 1.0


def test_the_port_is_opened_exclusively(cable, port):
    port.open()
    with pytest.raises(PortLostError, match="in use by another program"):
        Port(port.settings).open()


def test_unplugging_is_noticed_by_reading_and_by_writing_and_replugging_opens(cable, port):
    port.open()
    cable.unplug()
    with pytest.raises(PortLostError, match="unplugged"):
        port.read(1.0)
    with pytest.raises(PortLostError, match="unplugged"):
        port.write(b"x")
    with pytest.raises(PortLostError, match="not there"):
        port.open()
    cable.plug_in()
    port.open()
    os.write(cable.box, b"again")
    assert port.read(1.0) == b"again"


def test_a_box_that_does_not_read_never_blocks_a_write_and_frames_stay_whole(cable, port):
    port.open()
    began = time.monotonic()
    frames = [b"<%06d>" % n for n in range(20_000)]
    written = [frame for frame in frames if port.write(frame)]
    assert time.monotonic() - began < 5.0
    assert port.dropped_writes == len(frames) - len(written) > 0
    received = b""
    with suppress(BlockingIOError):
        while True:
            received += os.read(cable.box, 65536)
            time.sleep(0.001)
    assert received == b"".join(written)[: len(received)]


def test_a_line_too_slow_for_version_2_is_refused_with_the_number():
    with pytest.raises(SettingsError, match=r"baud must be within .* not 921600: .* version 2 930000"):
        PortSettings(baud=921600)
