"""Commands in a process of their own, with limits of time and memory."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Container, Sequence
from pathlib import Path
from typing import NamedTuple

from fuzzing.sharing import sharing
from skin2urdf.cli.main import INTERNAL_ERROR
from skin2urdf.cli.main import main as skin2urdf

# Statuses that the commands document.
STATUSES = {0, 1, 2, 3}
# A mutant may take so many times as long as the sound log, and so much more [s].
PATIENCE, GRACE = 3.0, 10.0
WAITING = 100.0


class Command(NamedTuple):
    """A command with its arguments, and the processor time after which it is ended [s]."""

    words: list[str]
    seconds: float


class Outcome(NamedTuple):
    """How a command ended.

    Attributes:
        fault: what is wrong with it, empty if nothing.
        status: exit status, negative for a signal.
        output: what it printed.
        seconds: processor time that it took, or would have alone.
    """

    fault: str
    status: int
    output: str
    seconds: float


class Performed(NamedTuple):
    """What commands of one process did.

    Attributes:
        outcomes: how they ended.
        heard: digest of the recording that they read; empty where none was read.
    """

    outcomes: list[Outcome]
    heard: str


def perform(words: list[str], seconds: float, memory: int) -> Outcome:
    """Run a command in a process of its own.

    Args:
        words: the command and its arguments.
        seconds: processor time after which it is ended; should it wait for something instead, it
            is after `WAITING` times as long.
        memory: bytes that it may take beyond those that this process has.

    Returns:
        How it ended.
    """
    return perform_in_turn([Command(words, seconds)], memory).outcomes[0]


def perform_in_turn(
    commands: Sequence[Command], memory: int, known: Container[str] = ()
) -> Performed:
    """Run commands one after the other in one process, which is not made anew for each.

    What they do alike with the same log is done once (see `sharing`).

    Args:
        commands: what to run; each has its own limit of time (see `perform`).
        memory: bytes that they may take beyond those that this process has.
        known: digests of recordings (see `sharing.digest`) whose answers are known; where a command
            reads one of these, those after it are left out.

    Returns:
        How they ended, up to one that ended the process or was the last that was needed.
    """
    begin = time.monotonic()
    longest = WAITING * sum(command.seconds for command in commands)
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as told:
        child = os.fork()
        if child == 0:
            _child(commands, memory, known, printed.fileno(), told.fileno())
        status, used = None, 0.0
        while status is None and time.monotonic() - begin < longest:
            ended, code, usage = os.wait4(child, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
                used = usage.ru_utime + usage.ru_stime
            time.sleep(0.005)
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        printed.seek(0)
        told.seek(0)
        output = printed.read()
        finished = [json.loads(line) for line in told.read().splitlines()]
    outcomes, at, spent = [], 0, 0.0
    heard = finished[-1][-1] if finished else ""
    for command, (how, until, stop, _) in zip(commands, finished, strict=False):
        outcomes.append(_judged(how, output[at:stop], until - spent, command.seconds))
        at, spent = stop, until
    if len(outcomes) < len(commands) and not (status == 0 and heard in known):
        limit = commands[len(outcomes)].seconds
        if status is None:
            fault = f"took more than {time.monotonic() - begin:.0f} s"
            text = output[at:].decode(errors="replace")
            outcomes.append(Outcome(fault, -signal.SIGKILL, text, limit))
        else:
            outcomes.append(_judged(status, output[at:], max(0.0, used - spent), limit))
    return Performed(outcomes, heard)


def _judged(status: int, printed: bytes, used: float, limit: float) -> Outcome:
    """How a command ended that took so much time where so much is allowed [s]."""
    output = printed.decode(errors="replace")
    fault = ""
    if used > limit:
        fault = f"took more than {limit:.0f} s of work"
    elif "Traceback" in output or INTERNAL_ERROR in output:
        fault = "an error that is not in words"
    elif status not in STATUSES:
        fault = f"ended with {status}"
    return Outcome(fault, status, output, used)


def _child(
    commands: Sequence[Command], memory: int, known: Container[str], output: int, told: int
) -> None:
    """Run commands, write down how each ended, and end this process."""
    status = 120
    try:
        os.dup2(output, 1)
        os.dup2(output, 2)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        begin = time.process_time()
        with sharing() as ledger:
            for command in commands:
                # Time that the process has taken counts up from its beginning.
                work = int(time.process_time() + command.seconds) + 2
                resource.setrlimit(resource.RLIMIT_CPU, (work, hard))
                status = 120
                try:
                    status = skin2urdf(command.words)
                except SystemExit as error:
                    status = int(error.code or 0)
                sys.stdout.flush()
                sys.stderr.flush()
                used = time.process_time() - begin + ledger.saved
                place = os.lseek(output, 0, os.SEEK_CUR)
                line = json.dumps([status, used, place, ledger.heard])
                os.write(told, line.encode() + b"\n")
                if ledger.heard in known:
                    status = 0
                    break
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
    finally:
        os._exit(status)
