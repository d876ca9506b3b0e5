r"""Calibrate simulated recordings by the batch and hold every result against the truth.

For every robot, seed, sensor grade, posture and excitation a recording is simulated, calibrated
without the truth, written as URDF and compared with the truth. Each run is one line of JSON in the
output as soon as it is finished; runs that are there already are not done again. At the end stands
a summary next to the Cramer-Rao bounds and to what must be reached.

    python scripts/validate.py --robots panda ur5 --seeds 3
    python scripts/validate.py --robots all --seeds 10 --grades mems bma150 \
        --postures tilted upright --excite one all --output runs.jsonl --plot runs.png
    python scripts/validate.py --robots urdfs --seeds 5 --output urdfs.jsonl --plot urdfs.png
    python scripts/validate.py --output runs.jsonl --summary-only

Exit status: 0; 1 where a run failed, found a wrong tree or did not converge; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path

from batch import options as batch_options
from batch import run
from batch.run import Batch
from validation import plot
from validation.cases import TRACKINGS, Case, Circumstance, circumstances, robots_named
from validation.measure import perform
from validation.records import Figures, Run
from validation.summary import converged, shortfalls
from validation.table import report

from skin2urdf.errors import UsageError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="runs.jsonl", recordings=1, of=" of each robot and circumstance"
    )
    what = new.add_argument_group("what to run")
    what.add_argument(
        "--robots", nargs="+", default=["panda"], metavar="ROBOT",
        help="names in robots/, URDFs, 'all' for all of robots/, 'urdfs' for every URDF of "
        "example-robot-data in which a joint can move (default: panda)",
    )  # fmt: skip
    what.add_argument("--grades", nargs="+", default=["mems"], help="sensor grades")
    what.add_argument(
        "--postures", nargs="+", default=["tilted"], choices=["tilted", "upright"],
        help="of the base",
    )  # fmt: skip
    what.add_argument(
        "--excite", nargs="+", default=["one"], choices=["one", "all"],
        help="one DoF after the other, or all at once",
    )  # fmt: skip
    what.add_argument("--poses", type=int, default=12, help="poses per recording (default: 12)")
    what.add_argument(
        "--encoder-bits", type=int, default=17, help="bits per turn, 0 for exact (default: 17)"
    )
    what.add_argument("--tracking", default="servo", choices=TRACKINGS, help="how joints follow")
    what.add_argument(
        "--refine", default="none", choices=["none", "casadi"], help="last step of the estimation"
    )
    what.add_argument(
        "--through-mcap", action="store_true", help="write each recording to a file and read it"
    )
    what.add_argument("--plot", type=Path, metavar="FILE", help="write plots into this image")
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every case that was asked for, seed by seed, so that a batch cut short covers all robots.

    Raises:
        UsageError: an option can not be used.
    """
    if options.poses < 1:
        raise UsageError("--poses starts at 1", "give a larger number")
    robots = robots_named(options.robots)
    kinds = [
        Circumstance(
            grade=grade,
            posture=posture,
            excite=excite,
            poses=options.poses,
            encoder_bits=options.encoder_bits or None,
            tracking=options.tracking,
            refine=options.refine,
            through_mcap=options.through_mcap,
        )
        for grade, posture, excite in circumstances(
            options.grades, options.postures, options.excite
        )
    ]
    seeds = batch_options.seeds(options)
    return [Case(robot, seed, kind) for seed, kind, robot in product(seeds, kinds, robots)]


def _passed(runs: Sequence[Run]) -> bool:
    return all(not run.failure and converged(run.figures) for run in runs)


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, _passed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    extra = partial(plot.save, path=options.plot) if options.plot else None
    return run.main(BATCH, options, extra)


if __name__ == "__main__":
    sys.exit(main())
