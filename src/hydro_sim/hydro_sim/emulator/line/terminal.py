# SPDX-License-Identifier: Apache-2.0
"""A pseudo-terminal at a fixed path that behaves like a serial adapter: plugged, unplugged, non-blocking."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import tempfile
import time
import tty
from pathlib import Path

from hydro_core.settings import SettingsError


def default_link() -> Path:
    """Return the default path of the port, one per user."""
    return Path(tempfile.gettempdir()) / f"hydro-bench-{os.getuid()}"


class Terminal:
    """The box's end of a pseudo-terminal pair; the other end appears as a link at `path`.

    `path`: where the port appears. An existing link is replaced, anything else is left alone. Raises
    SettingsError if `path` exists and is not a link, or its folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        if os.path.lexists(path) and not path.is_symlink():
            raise SettingsError(f"{path} exists and is not a link: give another place with --link")
        self.path = path
        self._master: int | None = None
        self._port = ""
        self._poll = select.poll()
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the port exists."""
        return self._master is not None

    @property
    def opened(self) -> bool:
        """Whether a host has the port open."""
        return self._master is not None and not any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def plug(self) -> None:
        """Create a new pair and point the link at it; do nothing if it is plugged."""
        if self._master is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._port = os.ttyname(slave)
        os.close(slave)  # so that the kernel tells whether somebody else has it open
        self._master = master
        self._poll.register(master, select.POLLHUP)
        scratch = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            scratch.unlink(missing_ok=True)
            scratch.symlink_to(self._port)
            os.replace(scratch, self.path)
        except OSError as error:
            raise SettingsError(f"{self.path} cannot be made: {os.strerror(error.errno or 0).lower()}") from error

    def wait(self, seconds: float, *others: int) -> None:
        """Wait until bytes have arrived, here or at one of the descriptors `others`, for at most `seconds`."""
        if self._master is not None and self.opened:
            select.select([self._master, *others], [], [], seconds)
        elif others:
            select.select(others, [], [], seconds)
        else:
            time.sleep(seconds)

    def unplug(self) -> None:
        """Remove the port and its link; a host that has it open gets a hang-up."""
        if self._master is None:
            return
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = None
        with contextlib.suppress(OSError):
            if os.readlink(self.path) == self._port:  # not that of an emulator that came after
                self.path.unlink()

    def read(self) -> bytes:
        """Return the received bytes; empty if there are none, or no host has the port open."""
        if self._master is None:
            return b""
        try:
            return os.read(self._master, 65536)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EIO):  # nothing there; nobody has the port open
                return b""
            raise

    def write(self, data: bytes) -> int:
        """Write without blocking; return the number of bytes written."""
        if self._master is None:
            return 0
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0
