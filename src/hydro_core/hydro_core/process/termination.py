# SPDX-License-Identifier: Apache-2.0
"""Termination by signals: SIGINT (Ctrl-C), SIGTERM, SIGHUP (the terminal or ssh session was closed).

All three mean the same: disarm, save, end the companion processes, exit with status 128 + number. During start-up
`exit_during_startup` applies; after that each signal raises `Terminated`, a KeyboardInterrupt, or is noted by a loop
that polls (`signals_noted`). Clean-up runs with `signals_ignored`.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from traceback import walk_stack
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
Handler = Callable[[int, FrameType | None], Any] | signal.Handlers


class Terminated(KeyboardInterrupt):
    """Request to terminate, by the signal `number`; `reason` is given where it is not obvious."""

    def __init__(self, number: int, reason: str = "") -> None:
        super().__init__(reason)
        self.number, self.reason = number, reason


def exit_status(interruption: KeyboardInterrupt) -> int:
    """Return the exit status after an interruption: 128 + the signal's number, 130 for Ctrl-C."""
    return 128 + (interruption.number if isinstance(interruption, Terminated) else signal.SIGINT)


def install(handler: Handler) -> dict[int, Any]:
    """Install `handler` for `SIGNALS`, in the main thread only; return the previous ones by signal.

    An ignored SIGHUP stays ignored: a program started with nohup is to outlive the terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    wanted = [n for n in SIGNALS if n is not signal.SIGHUP or signal.getsignal(n) is not signal.SIG_IGN]
    return {number: signal.signal(number, handler) for number in wanted}


os.register_at_fork(after_in_child=lambda: install(signal.SIG_DFL))


@contextmanager
def handled_by(handler: Handler) -> Iterator[None]:
    """Context in which `handler` handles `SIGNALS`."""
    before = install(handler)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def signals_ignored() -> AbstractContextManager[None]:
    """Context in which signals are ignored: for disarming and the last checkpoint, whose waits are bounded."""
    return handled_by(signal.SIG_IGN)


@contextmanager
def signals_noted() -> Iterator[list[int]]:
    """Context in which signals are appended to the list that it yields, for a loop that polls it."""
    noted: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        detach_closed_terminal()
        noted.append(number)

    with handled_by(note):
        yield noted


@contextmanager
def signals_as_exceptions() -> Iterator[None]:
    """Context in which each signal of `SIGNALS` raises `Terminated`, again where Python or compiled code drops it."""
    global _terminated
    _terminated, report = False, sys.unraisablehook
    sys.unraisablehook = lambda what: None if _terminated else report(what)
    try:
        with handled_by(raise_terminated):
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if not _terminated:
            sys.unraisablehook = report


def raise_terminated(number: int, _: FrameType | None = None) -> None:
    """Signal handler of a running program: raise `Terminated`.

    During an import, or while signals are ignored, the exception is raised afterwards: compiled modules do not expect
    one in their initialisation (torch's terminates the process). Compiled code may also drop the exception (in an
    attribute look-up, for one): unless it is being handled half a second later, it is raised again.
    """
    bootstrap = "<frozen importlib._bootstrap>"
    importing = any(frame.f_code.co_filename == bootstrap for frame, _ in walk_stack(sys._getframe()))
    if importing or signal.getsignal(signal.SIGTERM) is signal.SIG_IGN:
        _raise_later(number, 0.05)
        return
    detach_closed_terminal()
    global _terminated
    _terminated = True
    _raise_later(number, 0.5)
    raise Terminated(number)


def exit_during_startup(number: int, _: FrameType | None = None) -> None:
    """Signal handler during start-up: exit at once with a sentence; there is nothing to clean up yet."""
    detach_closed_terminal()
    with suppress(OSError):
        os.write(2, f"ended by {signal.Signals(number).name} while starting: nothing had begun\n".encode())
    os._exit(128 + number)


def detach_closed_terminal() -> None:
    """Replace a closed terminal by /dev/null: writing to it would raise."""
    for stream in (0, 1, 2):
        try:
            termios.tcgetattr(stream)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                os.dup2(os.open(os.devnull, os.O_RDWR), stream)


def print_error(sentence: str) -> None:
    """Print an error message to standard error, if that is still writable."""
    with suppress(OSError, ValueError):
        print(f"error: {sentence}", file=sys.stderr, flush=True)


def _raise_later(number: int, seconds: float) -> None:
    signal.signal(signal.SIGALRM, lambda *_: None if _handled() else raise_terminated(number))
    signal.setitimer(signal.ITIMER_REAL, seconds)


def _handled() -> bool:
    """Whether an `except`, a `finally` or a context manager is at work on `Terminated`."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, Terminated):
        error = error.__context__
    return error is not None


_terminated = False  # whether `Terminated` was raised
