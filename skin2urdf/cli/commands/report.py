"""``skin2urdf report``: a calibration as one HTML page."""

from __future__ import annotations

import argparse
from pathlib import Path

from skin2urdf.cli.arguments import Parser, present, refuse_to_overwrite, wrote
from skin2urdf.cli.terminal import progress_bar

HELP = "show a calibration as one HTML page"
EPILOG = """\
example:
  skin2urdf report robot.urdf
  skin2urdf report robot.urdf -o page.html --truth truth.urdf --log log.mcap

Needs robot.json beside robot.urdf, as `skin2urdf calibrate` wrote both. The page holds all that it
shows and asks the network for nothing: the verdict, the robot in 3D with what is known of every
place, what was found wrong and what to record next, the tree, residuals, and with --log the
readings beside their prediction. `skin2urdf calibrate --report FILE` writes it at once.
Needs plotly and jinja2: pip install 'skin2urdf[report]'"""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("urdf", metavar="URDF", help="what `skin2urdf calibrate` wrote")
    command.add_argument(
        "-o", "--output", metavar="HTML", help="page to write (that of the URDF, ending .html)"
    )
    command.add_argument(
        "--truth", metavar="URDF", help="another robot to lay over it: the truth, a vendor's model"
    )
    command.add_argument(
        "--log",
        metavar="LOG",
        action="append",
        default=[],
        help="log of the calibration, to show its readings; may be given several times",
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    output = options.output or str(Path(options.urdf).with_suffix(".html"))
    inputs = [options.urdf, Path(options.urdf).with_suffix(".json"), *options.log]
    refuse_to_overwrite([*inputs, *([options.truth] if options.truth else [])], output)
    from skin2urdf.page.contents import load_contents
    from skin2urdf.page.html import as_page, check_libraries
    from skin2urdf.page.writing import check_page, write_page

    check_libraries()
    check_page(output)
    replaced = present([output])
    with progress_bar(options.quiet) as bar:
        contents = load_contents(options.urdf, other=options.truth, logs=options.log, progress=bar)
        bar("drawing", 0.0)
        written = write_page(output, as_page(contents))
    if not options.quiet:
        print(wrote([written], replaced))
    return 0
