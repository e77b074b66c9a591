# SPDX-License-Identifier: Apache-2.0
"""A named pipe for commands to a running emulator: `echo "unplug 2" > PATH`."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from hydro_bridge.settings import SettingsError
from hydro_sim.emulator.line.faults import CHANCES, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.machine import Machine

ORDERS = (*CHANCES, "stall", "unplug", "clear", "reboot")


class ControlPipe:
    """Commands, one per line: a probability (`corrupt 0.01`), `stall 0.3`, `unplug 2`, `clear`, `reboot`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if not path.exists():
                os.mkfifo(path, 0o600)
            if not stat.S_ISFIFO(path.stat().st_mode):
                raise SettingsError(f"{path} exists and is no named pipe: give another place with --control")
            self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)  # for writing too: no end of file between writers
        except OSError as error:
            raise SettingsError(f"{path} cannot be made: {os.strerror(error.errno or 0).lower()}") from error
        self._rest = b""

    def lines(self) -> Iterator[str]:
        """Return the complete lines that have arrived."""
        with contextlib.suppress(BlockingIOError):
            self._rest = (self._rest + os.read(self._file, 4096))[-8192:]
        *lines, self._rest = self._rest.split(b"\n")
        for line in lines:
            yield line.decode(errors="replace")

    def close(self) -> None:
        """Remove the pipe."""
        os.close(self._file)
        with contextlib.suppress(OSError):
            self.path.unlink()


def execute(order: str, machine: Machine, link: BoxLink, now: float) -> None:
    """Execute one command at time `now` [s].

    Raises
    ------
    SettingsError
        If it is not an order.
    """
    word, *rest = order.split() or [""]
    if word not in ORDERS or len(rest) != (0 if word in ("clear", "reboot") else 1):
        raise SettingsError(f"order {order!r} is none of: {', '.join(ORDERS)}; all but clear and reboot take a number")
    number = _number(rest[0]) if rest else 0.0
    if word == "clear":
        link.set_faults(LinkFaults())
    elif word == "reboot":
        machine.restart()
        link.reboot()
    elif word == "stall":
        link.stall(number, now)
    elif word == "unplug":
        link.unplug(number, now)
    elif number > 1.0:
        raise SettingsError(f"order {order!r}: a chance is within [0, 1]")
    else:
        link.set_faults(replace(link.up.faults, **{word: number}))  # type: ignore[arg-type]


def _number(text: str) -> float:
    with contextlib.suppress(ValueError):
        number = float(text)
        if 0.0 <= number < 1e6:
            return number
    raise SettingsError(f"order: {text!r} is not a number of 0 or more")
