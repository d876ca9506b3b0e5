"""The command line: arguments in, text or JSON out, and an exit status that can be relied on."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence

from skin2urdf.cli.commands.completion import answer_the_shell
from skin2urdf.cli.parser import COMMANDS, make_parser, order_of_arguments
from skin2urdf.cli.terminal import complain, open_streams, silence_stdout
from skin2urdf.errors import Skin2UrdfError, UnreadableInputError, UsageError
from skin2urdf.recording.naming import printable

_INTERRUPTED = 130
INTERNAL_ERROR = "internal error"
"""What the line begins with, after ``error:``, that tells of a defect of this program."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: words after the program's name; those of the process by default.

    Returns:
        Exit status: 0 all is well; 1 no trustworthy result can be given, or trees differ, or an
        internal error; 2 bad usage or unreadable input; 130 interrupted.
    """
    open_streams()
    _tolerant_output()
    _one_thread()
    parser = make_parser()
    if "_ARGCOMPLETE" in os.environ:
        answer_the_shell(parser)
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words:
        parser.print_help(sys.stderr)
        return UsageError.exit_status
    options = parser.parse_args(words)
    if not options.debug:
        # The quality of a result is told in words; stray warnings of libraries only puzzle.
        warnings.simplefilter("ignore")
    try:
        status = COMMANDS[options.command].run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        silence_stdout()
        return 0
    except Skin2UrdfError as error:
        if options.debug:
            raise
        complain(f"error: {printable(str(error))}")
        if remedy := _remedy(error, options):
            print(f"  -> {printable(remedy)}", file=sys.stderr)
        return error.exit_status
    except OSError as error:
        if options.debug:
            raise
        silence_stdout()
        where = f"{error.filename}: " if error.filename else "the output can not be written: "
        complain(f"error: {where}{error.strerror or error}")
        print("  -> check the paths, and that there is space where they lead", file=sys.stderr)
        return UsageError.exit_status
    except MemoryError as error:
        if options.debug:
            raise
        complain(f"error: the memory does not suffice: {error}".rstrip(": "))
        print("  -> give less at once: shorter logs, smaller numbers", file=sys.stderr)
        return Skin2UrdfError.exit_status
    except KeyboardInterrupt:
        print("interrupted; no file was left half-written", file=sys.stderr)
        return _INTERRUPTED
    except Exception as error:
        if options.debug:
            raise
        complain(f"{INTERNAL_ERROR}: {type(error).__name__}: {error}")
        print("  -> this is a defect; add --debug to see where, and report it", file=sys.stderr)
        return 1
    return status


def _remedy(error: Skin2UrdfError, options: argparse.Namespace) -> str:
    """What to do about an error; where a log and a URDF changed places, what the order is."""
    if isinstance(error, UnreadableInputError) and error.why in ("a log", "a text"):
        order = order_of_arguments(options, error.path)
        return f"{error.remedy}, as in {order}" if order else error.remedy
    return error.remedy


def _one_thread() -> None:
    """Keep linear algebra to one thread, unless the environment says otherwise.

    The matrices are many and small: threads that wait for each other make a calibration four
    times slower on a busy machine. Must come before NumPy is imported.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _tolerant_output() -> None:
    """Let a terminal that lacks a character show a question mark, not a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
