r"""Hold the stated errors of calibrations against the true ones, whatever a robot has.

Every row is a recording with the physics of one defect of real robots in it, or of eight at once.
It is calibrated without a word about that, and compared with the truth: a stated error that is
less than half of the true one can not be believed. Each recording is one line of JSON in the output
as soon as it is finished; what is there already is not done again.

    python scripts/defects.py --robots panda --recordings 1
    python scripts/defects.py --rows sound "low-pass 21 Hz" --first-seed 100 --recordings 5
    python scripts/defects.py --excite none --minutes 3 --rows sound
    python scripts/defects.py --summary-only

Exit status: 0; 1 where a row fell short; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from bench.measured import Figures
from bench.rows import ROWS
from bench.table import complete, report, shortfalls
from bench.trials import TWO_ARMS, Case, perform

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, robot_names

ROBOTS = ("panda", "ur5", TWO_ARMS)
"""Robots of the table: two arms, and a tree."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="defects.jsonl", recordings=5, of=" of each row and robot"
    )
    what, default = new.add_argument_group("what to record"), Case("", "", 0)
    what.add_argument(
        "--robots", nargs="+", default=list(ROBOTS), choices=[*robot_names(), TWO_ARMS],
        metavar="ROBOT", help=f"names (default: {', '.join(ROBOTS)})",
    )  # fmt: skip
    what.add_argument(
        "--rows", nargs="+", default=list(ROWS), choices=list(ROWS), metavar="ROW",
        help=f"of {', '.join(ROWS)} (default: all)".replace("%", "%%"),
    )  # fmt: skip
    what.add_argument("--grade", default=default.grade, choices=sorted(GRADES))
    what.add_argument("--excite", default=default.excite, choices=["one", "all", "none", "series"])
    what.add_argument("--poses", type=int, default=default.poses, help="poses per recording")
    what.add_argument(
        "--minutes", type=float, default=default.minutes, help="length without patterns [min]"
    )
    what.add_argument(
        "--imu-rate", type=float, default=default.imu_rate, help="samples per second of each SU"
    )
    what.add_argument(
        "--bits", type=int, default=default.bits, help="resolution of the encoders [bits per turn]"
    )
    what.add_argument(
        "--effort", type=float, default=default.effort, metavar="NM",
        help="noise of the torques that joint states hold [N m] (default: they hold none)",
    )  # fmt: skip
    what.add_argument(
        "--motion",
        default="all",
        choices=("all", "patterns"),
        help="samples that count (%(default)s)",
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every recording asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if options.poses < 1 or not options.minutes > 0 or options.bits < 1:
        raise UsageError("--poses and --bits start at 1, --minutes above 0", "give larger numbers")
    return [
        Case(
            robot, row, seed, options.excite, options.poses, options.minutes, options.grade,
            options.motion, options.imu_rate, options.effort, options.bits,
        )
        for seed in batch_options.seeds(options)
        for robot in options.robots
        for row in options.rows
    ]  # fmt: skip


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
