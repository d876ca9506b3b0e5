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
from pathlib import Path

from montecarlo.perform import died, perform
from montecarlo.records import Case, Run
from montecarlo.table import report
from validation import batch
from validation.cases import circumstances, robots_named

from skin2urdf.errors import UsageError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    words, _, rest = (__doc__ or "").partition("\n")
    new = argparse.ArgumentParser(
        description=words, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    new.add_argument("--robots", nargs="+", default=["panda"], help="names in robots/")
    new.add_argument("--grades", nargs="+", default=["mems"], help="sensor grades")
    new.add_argument(
        "--excite", default="all", choices=["one", "all"],
        help="one DoF after the other, or all at once (default)",
    )  # fmt: skip
    new.add_argument("--poses", type=int, default=6, help="poses per recording (default: 6)")
    new.add_argument("--recordings", type=int, default=20, help="of each robot and grade")
    new.add_argument("--output", type=Path, default=Path("recordings.jsonl"), metavar="FILE")
    new.add_argument("--workers", type=int, default=2, help="processes; 0 for none but this one")
    new.add_argument("--summary-only", action="store_true", help="show what the output holds")
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every recording that was asked for, so ordered that a batch cut short covers all groups.

    Raises:
        UsageError: an option can not be used.
    """
    if min(options.recordings, options.poses) < 1:
        raise UsageError("--recordings and --poses start at 1", "give a larger number")
    grades = [grade for grade, *_ in circumstances(options.grades, ["tilted"], [options.excite])]
    return [
        Case(robot, grade, options.excite, options.poses, seed)
        for seed, robot, grade in product(
            range(options.recordings), robots_named(options.robots), grades
        )
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    return batch.command("monte_carlo.py", _run, options)


def _run(options: argparse.Namespace) -> int:
    runs = batch.outcomes(options, cases_of, perform, Run.from_json, died)
    print(report(runs), end="")
    return int(any(run.failure for run in runs))


if __name__ == "__main__":
    sys.exit(main())
