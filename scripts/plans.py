r"""Plans by the batch: no limit is left anywhere, and nothing touches.

For robots by name, for every URDF of example-robot-data (urdfs), and for robots of which only
limits are known, drawn at random (limits), plans are made and looked at as files have them: limits
on a grid of a millisecond, bodies at instants that planning has not looked at. Each is one line of
JSON in the output as soon as it is finished; what is there already is not done again.

    python scripts/plans.py --robots urdfs --recordings 15
    python scripts/plans.py --robots limits --recordings 1000
    python scripts/plans.py --summary-only

Exit status: 0; 1 where a limit is left or bodies touch; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from planned.table import complete, report, shortfalls
from planned.trials import LIMITS, Case, Figures, perform
from validation.cases import ALL_URDFS, robots_named

from skin2urdf.errors import UsageError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="plans.jsonl", recordings=1, counted=("--plans",), of=" of each robot"
    )
    what = new.add_argument_group("what to plan")
    what.add_argument(
        "--robots", nargs="+", default=[ALL_URDFS, LIMITS], metavar="ROBOT",
        help="names, all, urdfs, paths in example-robot-data, or limits (default: urdfs limits)",
    )  # fmt: skip
    what.add_argument(
        "--minutes", type=float, default=3.0, help="length, if that will do [min] (%(default)s)"
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every plan asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if not options.minutes > 0:
        raise UsageError("--minutes starts above 0", "give a larger number")
    named = robots_named([name for name in options.robots if name != LIMITS])
    robots = [*named, *([LIMITS] if LIMITS in options.robots else [])]
    return [
        Case(robot, seed, options.minutes)
        for seed in batch_options.seeds(options)
        for robot in robots
    ]


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
