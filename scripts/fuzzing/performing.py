"""A command in a process of its own, with limits of time and memory."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from skin2urdf.cli.main import INTERNAL_ERROR
from skin2urdf.cli.main import main as skin2urdf

# Statuses that the commands document.
STATUSES = {0, 1, 2, 3}
# A mutant may take so many times as long as the sound log, and so much more [s].
PATIENCE, GRACE = 3.0, 10.0
WAITING = 100.0


class Outcome(NamedTuple):
    """How a command ended.

    Attributes:
        fault: what is wrong with it, empty if nothing.
        status: exit status, negative for a signal.
        output: what it printed.
        seconds: processor time that it took.
    """

    fault: str
    status: int
    output: str
    seconds: float


def perform(words: Sequence[str], seconds: float, memory: int) -> Outcome:
    """Run a command in a process of its own.

    Args:
        words: the command and its arguments.
        seconds: processor time after which it is ended; should it wait for something instead, it
            is after `WAITING` times as long.
        memory: bytes that it may take beyond those that this process has.

    Returns:
        How it ended.
    """
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+", errors="replace") as printed:
        child = os.fork()
        if child == 0:
            _child(words, seconds, memory, printed.fileno())
        status, used = None, 0.0
        while status is None and time.monotonic() - begin < WAITING * seconds:
            ended, code, usage = os.wait4(child, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
                used = usage.ru_utime + usage.ru_stime
            time.sleep(0.005)
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        printed.seek(0)
        output = printed.read()
    if status is None:
        waited = time.monotonic() - begin
        return Outcome(f"took more than {waited:.0f} s", -signal.SIGKILL, output, seconds)
    if used > seconds:
        return Outcome(f"took more than {seconds:.0f} s of work", status, output, used)
    if "Traceback" in output or INTERNAL_ERROR in output:
        return Outcome("an error that is not in words", status, output, used)
    if status not in STATUSES:
        return Outcome(f"ended with {status}", status, output, used)
    return Outcome("", status, output, used)


def _child(words: Sequence[str], seconds: float, memory: int, output: int) -> None:
    """Run a command and end this process."""
    status = 120
    try:
        os.dup2(output, 1)
        os.dup2(output, 2)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        work = int(seconds) + 2
        resource.setrlimit(resource.RLIMIT_CPU, (work, work))
        status = skin2urdf(list(words))
        sys.stdout.flush()
        sys.stderr.flush()
    except SystemExit as error:
        status = int(error.code or 0)
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
    finally:
        os._exit(status)
