r"""Find SUs on given models by the batch, and hold every result against the truth.

A minute of ordinary moves, without any pattern, is simulated on the URDFs of example-robot-data,
and SUs are found with that URDF as the model; or with one that differs as a specimen does, has a
joint of the other sense, another zero or an axis elsewhere, or is of another robot; or with the
robot mounted turned; or with one SU alone, at the tip, in two recordings. What has to be named
must be, and nothing else.

    python scripts/vendor_models.py --robots panda ur5 kinova xarm7 z1 --seeds 2
    python scripts/vendor_models.py --robots urdfs --kinds sound specimen --output urdfs.jsonl
    python scripts/vendor_models.py --output models.jsonl --summary-only

Exit status: 0; 1 where a trial failed or is not as it should be; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product

from batch import options as batch_options
from batch import run
from batch.run import Batch
from models.table import report, shortfalls
from models.trials import KINDS, Found, Run, Trial, perform
from validation.cases import Case, Circumstance, robots_named


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="models.jsonl", recordings=1, of=" of each robot and kind of model"
    )
    what = new.add_argument_group("what to run")
    what.add_argument(
        "--robots", nargs="+", default=["panda"], metavar="ROBOT",
        help="names in robots/, URDFs, 'all', or 'urdfs' for every URDF of example-robot-data",
    )  # fmt: skip
    what.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, help="of models")
    what.add_argument("--minutes", type=float, default=1.0, help="of motion (default: 1)")
    what.add_argument("--grade", default="mems", help="of the sensors (default: mems)")
    return new


def cases_of(options: argparse.Namespace) -> list[Trial]:
    """Every trial that was asked for, seed by seed, those of one recording in a row.

    Raises:
        UsageError: an option can not be used.
    """
    robots = [Case(name, 0, Circumstance()).robot_or_path for name in robots_named(options.robots)]
    every = product(batch_options.seeds(options), robots, options.kinds)
    return [Trial(robot, kind, seed, options.minutes, options.grade) for seed, robot, kind in every]


def _passed(runs: Sequence[Run]) -> bool:
    return not any(shortfalls(run) for run in runs)


BATCH = Batch(Trial, Found, perform, cases_of, report, shortfalls, _passed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
