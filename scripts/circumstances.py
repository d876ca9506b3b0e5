r"""Hold what calibrations state against what is true, in circumstances drawn at random.

Every seed draws a robot (of the package, any URDF of example-robot-data, or a random tree), its
SUs, their grade and rates, encoders, motion, its length, stamps, and none to three defects of real
robots. What is calibrated is not told any of it. False is a true error of more than twice what is
stated, a wrong tree that was not refused, a fault that is not there, an error that is not in plain
words, and ten times the time of others; a refusal is not. Each recording is one line of JSON in the
output as soon as it is finished; what is there already is not done again.

    python scripts/circumstances.py --recordings 100
    python scripts/circumstances.py --first-seed 1000 --recordings 1 --joints 4
    python scripts/circumstances.py --summary-only

Exit status: 0; 1 where something is false; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from drawn.table import complete, report, shortfalls
from drawn.trials import Case, Outcome, perform

from skin2urdf.errors import UsageError

FEWEST = 2
"""Joints that a random tree has at least."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(__doc__ or "", output="circumstances.jsonl", recordings=20)
    what = new.add_argument_group("what to record")
    what.add_argument(
        "--joints", type=int, default=Case(0).most_joints, metavar="N",
        help="that move at most (default: %(default)s)",
    )  # fmt: skip
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every recording asked for.

    Raises:
        UsageError: an option can not be used.
    """
    if options.joints < FEWEST:
        raise UsageError(f"--joints starts at {FEWEST}", "give a larger number")
    return [Case(seed, options.joints) for seed in batch_options.seeds(options)]


BATCH = Batch(Case, Outcome, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
