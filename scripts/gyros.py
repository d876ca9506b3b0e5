r"""By how much gyroscopes make a calibration better: the same recordings with them and without.

Robots whose SUs have gyroscopes beside their accelerometers are recorded with a base that stands
upright, so that the first axis is vertical and gravity says nothing of it, and with one that is
tilted. Each recording is calibrated twice, once with --no-gyro, and both are held against the
truth. Each is one line of JSON in the output as soon as it is finished; what is there already is
not done again.

    python scripts/gyros.py --robots ur5 panda --recordings 3
    python scripts/gyros.py --excite none --minutes 2 --recordings 3
    python scripts/gyros.py --postures tilted --recordings 10 --output nees.jsonl

Exit status: 0; 1 where a recording fell short; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from gyroscopes.table import complete, report, shortfalls
from gyroscopes.trials import Case, Figures, perform

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, robot_names


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="gyros.jsonl", recordings=3, of=" of each robot and posture"
    )
    what, default = new.add_argument_group("what to record"), Case("", "tilted", 0)
    what.add_argument(
        "--robots", nargs="+", default=["ur5", "panda"], choices=robot_names(), metavar="ROBOT",
        help="names (default: ur5 panda)",
    )  # fmt: skip
    what.add_argument(
        "--postures", nargs="+", default=["upright", "tilted"], choices=["upright", "tilted"],
        help="of the base (default: both)",
    )  # fmt: skip
    what.add_argument("--grade", default=default.grade, choices=sorted(GRADES))
    what.add_argument(
        "--gyros",
        nargs="+",
        default=[default.gyro],
        metavar="GRADE",
        help="gyroscopes: noise [deg/s], or a grade (%(default)s)",
    )
    what.add_argument("--excite", default=default.excite, choices=["one", "all", "none"])
    what.add_argument("--poses", type=int, default=default.poses, help="poses per recording")
    what.add_argument(
        "--minutes", type=float, default=default.minutes, help="length without patterns [min]"
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every recording asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if options.poses < 1 or not options.minutes > 0:
        raise UsageError("--poses starts at 1, --minutes above 0", "give larger numbers")
    return [
        Case(
            robot, posture, seed, options.excite, options.poses, options.minutes, options.grade,
            gyro,
        )
        for seed in batch_options.seeds(options)
        for robot in options.robots
        for posture in options.postures
        for gyro in options.gyros
    ]  # fmt: skip


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
