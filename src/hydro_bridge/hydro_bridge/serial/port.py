# SPDX-License-Identifier: Apache-2.0
"""Serial port: exclusive, low latency, non-blocking writes, may be unplugged and plugged in again."""

from __future__ import annotations

import contextlib
import errno
import os
import select
from dataclasses import dataclass
from typing import Annotated

import serial

from hydro_core.errors import UserError
from hydro_core.settings import SettingsError, check, described, quantity


class PortLostError(UserError):
    """The port cannot be opened or is gone; the message is one clear sentence."""


class PortTakenError(PortLostError):
    """Another program has the port."""


@dataclass(frozen=True, kw_only=True)
class PortSettings:
    """Settings of a serial port."""

    path: Annotated[str, described("Device, or link to one")] = "/dev/ttyUSB0"
    baud: Annotated[int, quantity("Bit/s", 1340000, 12000000, "A STATE each millisecond takes 1330000")] = 2_000_000
    silence_max: Annotated[
        float, quantity("s", 0.1, 60.0, "Without a sample, or a frame before the greeting: the port is reopened")
    ] = 1.0
    backoff_first: Annotated[float, quantity("s", 0.01, 10.0, "Before the second attempt to open, then doubled")] = 0.1
    backoff_max: Annotated[float, quantity("s", 0.1, 60.0, "Longest wait between attempts")] = 2.0

    def __post_init__(self) -> None:
        check(self)
        if not self.path.strip():
            raise SettingsError("the port's name is empty: give the device, as in --port /dev/ttyUSB0")


class Port:
    """A serial port that may be unplugged. Not thread-safe: one thread reads, and the caller serializes writes."""

    def __init__(self, settings: PortSettings) -> None:
        self.settings = settings
        self.low_latency = False
        self.dropped_writes = 0
        """Frames not written because the line was full: the box does not read."""
        self._serial: serial.Serial | None = None
        self._unwritten = b""

    @property
    def pseudo_terminal(self) -> bool:
        """Whether the path is a pseudo-terminal: only there may a box be an emulator whose time is its own."""
        return os.path.realpath(self.settings.path).startswith("/dev/pts/")

    def open(self) -> None:
        """Open the port; raises PortLostError with the reason, PortTakenError if another program has it.

        Raises UserError: the path is a file or a folder.
        """
        self.close()
        path = self.settings.path
        if os.path.isfile(path) or os.path.isdir(path):
            raise UserError(f"{path} is not a serial port: give the box's device by --port")
        try:
            self._serial = serial.Serial(path, self.settings.baud, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            number = getattr(error, "errno", None)
            if number in (errno.EAGAIN, errno.EBUSY):
                raise PortTakenError(f"{path} is in use by another program") from None
            reason = f"cannot be opened: {_text(error)}"
            if number == errno.ENOENT:
                reason = "is not there: is the box plugged in and switched on? /dev/serial/by-id has one name a device"
            elif number == errno.EACCES:
                reason = "may not be opened: add yourself to the group that owns it (usually dialout) and log in again"
            raise PortLostError(f"{path} {reason}") from None
        self.low_latency = False
        # Pseudo-terminals and most drivers lack this mode, and each reports it differently.
        with contextlib.suppress(Exception):
            self._serial.set_low_latency_mode(True)
            self.low_latency = True

    def close(self) -> None:
        """Close the port, if it is open."""
        port, self._serial, self._unwritten = self._serial, None, b""
        if port is not None:
            with contextlib.suppress(OSError, serial.SerialException):
                port.close()

    def read(self, timeout: float) -> bytes:
        """Return the available bytes as soon as there are any; none after `timeout` seconds.

        Raises PortLostError: the port is closed, gone, or ready without data, which is how an unplugged one appears.
        """
        try:
            descriptor = self._descriptor()
            if not select.select([descriptor], [], [], timeout)[0]:
                return b""
            data = os.read(descriptor, 65536)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise PortLostError(f"{self.settings.path} was unplugged: {_text(error)}") from None
        if not data:
            raise PortLostError(f"{self.settings.path} was unplugged: it is ready to read and has no data")
        return data

    def write(self, frame: bytes) -> bool:
        """Write a frame without waiting; returns False if the full line dropped it. Raises PortLostError."""
        data = self._unwritten + frame
        try:
            written = os.write(self._descriptor(), data)
        except BlockingIOError:
            written = 0
        except (OSError, ValueError) as error:
            raise PortLostError(f"{self.settings.path} was unplugged: {_text(error)}") from None
        if written < len(self._unwritten) or (written == 0 and not self._unwritten):
            self._unwritten = self._unwritten[written:]
            self.dropped_writes += 1
            return False
        self._unwritten = data[written:]
        return True

    def _descriptor(self) -> int:
        if self._serial is None:
            raise PortLostError(f"{self.settings.path} is closed")
        return self._serial.fileno()


def _text(error: Exception) -> str:
    return (os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)).lower()
