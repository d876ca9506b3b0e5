"""``skin2urdf check``: is a calibration still true?"""

from __future__ import annotations

import argparse
import json
import time
from datetime import UTC, datetime
from pathlib import Path

from skin2urdf.cli.arguments import (
    A_LOG,
    Parser,
    offer_json,
    present,
    print_json,
    refuse_to_overwrite,
    wrote,
)
from skin2urdf.cli.terminal import progress_bar

HELP = "check from a short log whether a calibration is still true"
EPILOG = """\
example:
  skin2urdf check log.mcap robot.urdf
  skin2urdf check log.mcap robot.urdf -o new.urdf --history robot.jsonl

robot.urdf is one that skin2urdf calibrate wrote, with its JSON beside it; the log holds half a
minute of any motion. Every SU that moved, turned, died or was exchanged is named, with its size and
standard deviation. -o writes a URDF in which those alone are estimated anew.
Exits with 0 where all is as it was, with 3 where an SU is not."""

_CHANGED = 3


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("log", metavar="LOG", help=A_LOG)
    command.add_argument("urdf", metavar="URDF", help="the calibration, its JSON beside it")
    command.add_argument(
        "-o", "--output", metavar="URDF", help="write it with the changed SUs estimated anew"
    )
    command.add_argument(
        "--history", metavar="FILE", help="append a line of JSON with what was found"
    )
    offer_json(command)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    begin = time.perf_counter()
    inputs = [options.log, options.urdf, Path(options.urdf).with_suffix(".json")]
    from skin2urdf.files import append_line, check_target
    from skin2urdf.output import output_paths, write_pair

    paths = output_paths(options.output) if options.output else ()
    histories = [check_target(options.history)] if options.history else []
    refuse_to_overwrite(inputs, *paths, *histories)
    replaced = present(paths)
    from skin2urdf.report.check import as_document, as_text, history_line
    from skin2urdf.vendor.checking import check
    from skin2urdf.vendor.repairing import repaired

    with progress_bar(options.quiet) as bar:
        checked = check(options.log, options.urdf, progress=bar)
    written = write_pair(paths[0], *repaired(checked)) if paths else ()
    if options.history:
        when = datetime.now(UTC).isoformat(timespec="seconds")
        line = json.dumps(history_line(checked, when), allow_nan=False)
        append_line(options.history, line)
    if options.json:
        print_json(as_document(checked))
    elif not options.quiet:
        print(as_text(checked), end="")
        if written:
            print(wrote(written, replaced, time.perf_counter() - begin))
    return 0 if checked.true else _CHANGED
