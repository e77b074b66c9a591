# SPDX-License-Identifier: Apache-2.0
"""Termination by signals: SIGINT (Ctrl-C), SIGTERM, SIGHUP (the terminal or ssh session was closed).

All three mean the same: disarm, save, end the companion processes, exit with status 128 + number. During start-up
`exit_during_startup` applies; after that each signal raises `Terminated`, a KeyboardInterrupt, or is handled by the
spinning executor. A signal during a later import takes effect after the import. Clean-up runs with `signals_ignored`.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from traceback import walk_stack
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_RETRY_DELAY = 0.05  # s
_DROPPED_EXCEPTION_DELAY = 0.5  # s after which an exception that nobody handles was dropped
_IMPORT_SYSTEM_FILE = "<frozen importlib._bootstrap>"  # file of its code objects
SignalHandlers = Mapping[int, Any]
"""Signal handlers by signal number, as returned by `signal.signal`."""


class Terminated(KeyboardInterrupt):
    """Request to terminate, by the signal `number`; `reason` is given where it is not obvious."""

    def __init__(self, number: int, reason: str = "") -> None:
        super().__init__(reason)
        self.number, self.reason = number, reason


def exit_status(interruption: KeyboardInterrupt) -> int:
    """Return the exit status after an interruption: 128 + the signal's number, 130 for Ctrl-C."""
    return 128 + (interruption.number if isinstance(interruption, Terminated) else signal.SIGINT)


def install_handlers(handler: Callable[[int, FrameType | None], Any] | signal.Handlers) -> SignalHandlers:
    """Install `handler` for `SIGNALS` in the main thread; return the previous handlers, for `restore_handlers`.

    An ignored SIGHUP stays ignored: a program started with nohup is to outlive the terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    wanted = [n for n in SIGNALS if n is not signal.SIGHUP or signal.getsignal(n) is not signal.SIG_IGN]
    return {number: signal.signal(number, handler) for number in wanted}


def restore_handlers(before: SignalHandlers) -> None:
    """Reinstall the previous signal handlers."""
    for number, handler in before.items():
        signal.signal(number, handler)


def raise_terminated(number: int, _: FrameType | None = None) -> None:
    """Signal handler of a running program: raise `Terminated`. A forked child dies, as by default.

    During an import, or while signals are ignored, the exception is raised afterwards: compiled modules do not expect
    one in their initialisation (torch's terminates the process). Compiled code may also drop the exception (in an
    attribute look-up, for one): unless it is being handled half a second later, it is raised again.
    """
    if os.getpid() != _process_id:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    importing = any(frame.f_code.co_filename == _IMPORT_SYSTEM_FILE for frame, _ in walk_stack(sys._getframe()))
    if importing or signal.getsignal(signal.SIGTERM) is signal.SIG_IGN:
        _raise_later(number, _RETRY_DELAY)
        return
    detach_closed_terminal()
    global _terminated
    _terminated = True
    _raise_later(number, _DROPPED_EXCEPTION_DELAY)
    raise Terminated(number)


def request_termination() -> None:
    """Send SIGINT to this process, as Ctrl-C does; for a request by a ROS message or service."""
    os.kill(os.getpid(), signal.SIGINT)


def exit_during_startup(number: int, _: FrameType | None = None) -> None:
    """Signal handler during start-up: exit at once with a sentence; there is nothing to clean up yet."""
    detach_closed_terminal()
    with suppress(OSError):
        os.write(2, f"ended by {signal.Signals(number).name} while starting: nothing had begun\n".encode())
    os._exit(128 + number)


@contextmanager
def signals_as_exceptions() -> Iterator[None]:
    """Context in which each signal of `SIGNALS` raises `Terminated`.

    Where Python cannot raise an exception (finalizers, the compiler's callbacks into Python) it drops it: `Terminated`
    is then raised again. The AttributeError of a half-constructed object's finalizer is not reported.
    """
    global _process_id, _terminated
    _process_id, _terminated = os.getpid(), False
    before, dropped = install_handlers(raise_terminated), sys.unraisablehook

    def insist(what: sys.UnraisableHookArgs) -> None:
        error = what.exc_value
        if isinstance(error, Terminated):
            _raise_later(error.number, _RETRY_DELAY)
        elif not (
            _terminated and isinstance(error, AttributeError) and getattr(what.object, "__name__", "") == "__del__"
        ):
            dropped(what)

    sys.unraisablehook = insist
    try:
        yield
    finally:
        if not _terminated:
            sys.unraisablehook = dropped
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        restore_handlers(before)


@contextmanager
def signals_ignored() -> Iterator[None]:
    """Context in which signals are ignored: for disarming and the last checkpoint, whose waits are bounded."""
    before = install_handlers(signal.SIG_IGN)
    try:
        yield
    finally:
        restore_handlers(before)


def detach_closed_terminal() -> None:
    """Replace a closed terminal by /dev/null: writing to it would raise."""
    for stream in (0, 1, 2):
        try:
            termios.tcgetattr(stream)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nothing = os.open(os.devnull, os.O_RDWR)
                os.dup2(nothing, stream)
                os.close(nothing)
        except OSError:
            continue


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


_process_id = os.getpid()
_terminated = False  # whether `Terminated` was raised
