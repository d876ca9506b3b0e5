"""``skin2urdf info``: what a log holds and what it lacks."""

from __future__ import annotations

import argparse

from skin2urdf.cli.arguments import A_LOG, Parser, offer_json, print_json
from skin2urdf.cli.terminal import progress_bar, show

HELP = "show what a log holds and what it lacks"
EPILOG = """\
example:
  skin2urdf info log.mcap

Shows the topics and what they are used as, rates and gaps, where the robot rests and what it
excites around each pose, and what is missing for a calibration. Exits with 1 where no calibration
is possible without it."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("log", metavar="LOG", help=A_LOG)
    offer_json(command)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    with progress_bar(options.quiet) as bar:
        bar("starting", 0.0)
        from skin2urdf.report.inventory import as_document, as_text
        from skin2urdf.survey import survey

        bar("starting", 1.0)
        surveyed = survey(options.log, progress=bar)
    if options.json:
        print_json(as_document(surveyed))
    elif not options.quiet:
        show(lambda: as_text(surveyed))
    return 1 if surveyed.obstacles else 0
