r"""Calibrate many recordings and hold their errors against the uncertainty each states.

Every recording is simulated with sensors, clocks (lags of 0 to 30 ms) and a motion of its own,
calibrated without the truth, and its errors are divided by the covariances the calibration states.
Over many recordings the normalised squared error per direction (NEES) averages to 1 where the
stated uncertainty is true. Each recording is a line of JSON in the output; what is there is not
run again.

    python scripts/monte_carlo.py --robots panda --grades mems bma150 --recordings 200
    python scripts/monte_carlo.py --output recordings.jsonl --summary-only

Exit status: 0; 1 where a calibration failed; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product

from batch import options as batch_options
from batch import run
from batch.run import Batch
from montecarlo.perform import perform
from montecarlo.records import Case, Figures, Run
from montecarlo.table import report
from validation.cases import circumstances, robots_named

from skin2urdf.errors import UsageError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="recordings.jsonl", recordings=20, of=" of each robot and grade"
    )
    what = new.add_argument_group("what to record")
    what.add_argument("--robots", nargs="+", default=["panda"], help="names in robots/")
    what.add_argument("--grades", nargs="+", default=["mems"], help="sensor grades")
    what.add_argument(
        "--excite", default="all", choices=["one", "all", "none", "series"],
        help="one DoF after the other, all at once (default), or moves without patterns",
    )  # fmt: skip
    what.add_argument("--poses", type=int, default=6, help="poses per recording (default: 6)")
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every recording that was asked for, so ordered that a batch cut short covers all groups.

    Raises:
        UsageError: an option can not be used.
    """
    if options.poses < 1:
        raise UsageError("--poses starts at 1", "give a larger number")
    grades = [grade for grade, *_ in circumstances(options.grades, ["tilted"], [options.excite])]
    return [
        Case(robot, grade, options.excite, options.poses, seed)
        for seed, robot, grade in product(
            batch_options.seeds(options), robots_named(options.robots), grades
        )
    ]


def _shortfalls(run: Run) -> list[str]:
    return [str(run.failure)] if run.failure else []


def _passed(runs: Sequence[Run]) -> bool:
    return not any(run.failure for run in runs)


BATCH = Batch(Case, Figures, perform, cases_of, report, _shortfalls, _passed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
