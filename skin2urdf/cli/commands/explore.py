"""``skin2urdf explore``: activity matrix, tree and limbs."""

from __future__ import annotations

import argparse

from skin2urdf.cli.arguments import (
    A_LOG,
    Parser,
    add_threshold,
    offer_json,
    present,
    print_json,
    static_threshold,
    wrote,
)
from skin2urdf.cli.terminal import progress_bar, show

HELP = "show which SU moves with which joint"
EPILOG = """\
example:
  skin2urdf explore log.mcap
  skin2urdf explore log.mcap --plot structure.svg

Rows of the activity matrix are SUs, columns are DoFs. A figure is the evidence that the DoF moves
the SU over what it takes to say so: 1 and more is active. At rest an SU counts that feels 0.3 times
what any other does, where that is more than --threshold leaves in doubt; else patterns decide.
Several logs are combined by OR."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("logs", nargs="+", metavar="LOG", help=A_LOG)
    offer_json(command)
    command.add_argument("--plot", metavar="FILE", help="draw matrix and tree (.svg, .png, .pdf)")
    add_threshold(command)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    threshold = static_threshold(options)
    plots = []
    if options.plot:
        from skin2urdf.report.canvas import check_picture

        plots = [check_picture(options.plot)]
    replaced = present(plots)
    with progress_bar(options.quiet) as bar:
        bar("starting", 0.0)
        from skin2urdf.report.exploration import as_document, as_text
        from skin2urdf.survey import explore

        bar("starting", 1.0)
        explored = explore(options.logs, threshold, progress=bar)
    if options.json:
        print_json(as_document(explored))
    elif not options.quiet:
        show(lambda: as_text(explored))
    if plots:
        from skin2urdf.report.figures import draw_exploration

        with progress_bar(options.quiet) as bar:
            bar("drawing", 0.0)
            draw_exploration(explored.exploration, options.plot)
        if not options.quiet and not options.json:
            print(wrote(plots, replaced))
    if explored.contradiction is not None:
        raise explored.contradiction
    return 0
