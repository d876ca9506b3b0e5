"""``skin2urdf compare``: an estimated URDF against the true one."""

from __future__ import annotations

import argparse
import sys

from skin2urdf.cli.arguments import Parser, add_number, check_within, offer_json, print_json
from skin2urdf.cli.terminal import show

HELP = "compare an estimated URDF with the true one"
EPILOG = """\
example:
  skin2urdf compare robot.urdf truth.urdf

SUs and joints are matched by name, limbs are aligned, links may have any names. Directions of SUs
and branches that the JSON beside the estimate (robot.json) calls not observable do not count.
TRUTH may be a vendor's file without SUs: joints are then matched by name, or by how their axes
lie, and every SU is put onto its link where it fits best, so that its motion counts.
Exits with 0 if the trees are equal, else with 1."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("estimate", metavar="ESTIMATE", help="URDF that was found")
    command.add_argument("truth", metavar="TRUTH", help="URDF that is right")
    offer_json(command)
    command.add_argument(
        "--align",
        choices=("limbs", "base"),
        default="limbs",
        help="one rigid transform per limb, which nothing connects but gravity, or one for the "
        "whole robot (%(default)s)",
    )
    group = command.add_argument_group("configurations")
    add_number(group, "--configurations", 200, "how many, drawn at random (%(default)s)", int)
    add_number(group, "--seed", 0, "what they are drawn from (%(default)s)", int)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    check_within(options, "seed", 0)
    import numpy as np

    from skin2urdf.report.comparison import as_text
    from skin2urdf.urdf.compare import compare

    comparison = compare(
        options.estimate,
        options.truth,
        align=options.align,
        n_configurations=options.configurations,
        rng=np.random.default_rng(options.seed),
    )
    if options.json:
        print_json(comparison.to_dict())
    elif not options.quiet:
        show(lambda: as_text(comparison))
        if comparison.document is None:
            print(
                f"note: no JSON of this very file beside {options.estimate}: what the log could "
                "not tell counts as error",
                file=sys.stderr,
            )
    return 0 if comparison.tree_equal else 1
