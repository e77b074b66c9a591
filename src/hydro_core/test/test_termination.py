# SPDX-License-Identifier: Apache-2.0
"""Signals become an orderly end, wherever they come, even where Python drops exceptions; cleaning up is left alone."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

from tests.checks import ran

BEGINNING = """
import os, signal, sys, time
from hydro_core.process import termination
from hydro_core.cli.console import command

def me(number):
    os.kill(os.getpid(), number)

@command()
def main():
"""


def ended(body: str, **more: object) -> tuple[int, str, str]:
    """Status and output of a command; in a session of its own: whatever it signals is not who runs the tests."""
    program = f"{BEGINNING}{body}\nmain()\n"
    process = ran(sys.executable, "-c", program, timeout=20.0, start_new_session=True, **more)
    return process.returncode, process.stdout, process.stderr


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_unwinds_the_command_and_is_its_status_and_putting_in_order_is_not_disturbed(name: str) -> None:
    body = f"""
    try:
        me(signal.{name})
        time.sleep(10)
    finally:
        with termination.signals_ignored():
            for number in termination.SIGNALS:
                me(number)
            print("put in order")
"""
    assert ended(body) == (128 + getattr(signal, name), "put in order\n", "")


def test_a_hangup_that_nohup_ignores_stays_ignored() -> None:
    nohup = lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)  # noqa: E731
    assert ended("    me(signal.SIGHUP); print('goes on')", preexec_fn=nohup) == (0, "goes on\n", "")


def test_a_terminal_that_has_gone_is_no_error() -> None:
    body = """
    try:
        print("runs", flush=True)
        time.sleep(20)
    finally:
        print("nobody reads this any more", flush=True)
        print("nor this", file=sys.stderr, flush=True)
        open(sys.argv[1], "w").write("put in order")
main()
"""
    (ours, theirs), (read, write) = pty.openpty(), os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", BEGINNING + body, f"/dev/fd/{write}"],
        stdin=theirs, stdout=theirs, stderr=theirs, pass_fds=(write,), start_new_session=True,
        preexec_fn=lambda: os.close(os.open(os.ttyname(theirs), os.O_RDWR)),  # its controlling terminal
    )  # fmt: skip
    os.close(theirs)
    os.close(write)
    assert os.read(ours, 100).startswith(b"runs")
    os.close(ours)  # the ssh session closes: the kernel sends SIGHUP
    assert process.wait(10.0) == 128 + signal.SIGHUP
    assert os.read(read, 100) == b"put in order"
    os.close(read)


def test_an_exception_that_compiled_code_drops_comes_again_but_not_into_the_clean_up() -> None:
    body = """
    try:
        try:
            me(signal.SIGTERM)  # as PyObject_HasAttr and PyDict_GetItem do with an exception of Python code below them
        except termination.Terminated:
            pass
        time.sleep(10)
    finally:
        time.sleep(1.2)
        print("put in order")
"""
    assert ended(body) == (128 + signal.SIGTERM, "put in order\n", "")
