r"""Change one constant of the code at a time and see what becomes of short recordings.

Every number that a module names is halved and doubled, and recordings that lead through its room
are calibrated: with patterns, with ordinary moves, with cheap sensors, with gyroscopes, late clocks
of SUs and of a publisher of joints, a slip, an encoder that jumps, a hit, and gears that yield.
Each trial is one line of JSON in the output as soon as it is finished; what is there already is not
done again.

    python scripts/sensitivity.py --rooms hypotheses signals/clocks
    python scripts/sensitivity.py --output sensitivity.jsonl --summary-only

Exit status: 0; 1 where a trial failed; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from sensitive.constants import PACKAGE, constants
from sensitive.logs import SEEN_BY
from sensitive.table import report
from sensitive.trials import Case, Figures, Trial, perform

from skin2urdf.errors import UsageError

FACTORS = (0.5, 2.0)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="sensitivity.jsonl", recordings=1, of=" of each kind"
    )
    what = new.add_argument_group("what to change")
    what.add_argument(
        "--rooms", nargs="+", default=list(SEEN_BY), metavar="ROOM",
        help=f"folders or modules of the package (default: {' '.join(SEEN_BY)})",
    )  # fmt: skip
    what.add_argument(
        "--names", nargs="+", metavar="NAME", help="of these constants (default: all)"
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every trial asked for, recording by recording.

    Raises:
        UsageError: an option can not be used.
    """
    for room in options.rooms:
        path = PACKAGE / room
        if room.split("/")[0] not in SEEN_BY or not (
            path.is_dir() or path.with_suffix(".py").is_file()
        ):
            raise UsageError(
                f"--rooms: no recording leads through {room!r}", f"say one of {', '.join(SEEN_BY)}"
            )
    wanted = [c for c in constants(options.rooms) if not options.names or c.name in options.names]
    logs = dict.fromkeys(log for of in SEEN_BY.values() for log in of)
    return [
        Case(constant.module, constant.name, factor, log, seed)
        for seed in batch_options.seeds(options)
        for log in logs
        for constant in wanted
        if log in SEEN_BY[constant.module.split("/")[0]]
        for factor in FACTORS
    ]


def shortfalls(trial: Trial) -> Sequence[str]:
    """What went wrong with a trial."""
    return [str(trial.failure)] if trial.failure else []


def passed(trials: Sequence[Trial]) -> bool:
    """Whether all trials came to an end."""
    return not any(trial.failure for trial in trials)


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, passed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
