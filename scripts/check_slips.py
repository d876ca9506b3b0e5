r"""Slips of SUs, and none: what `skin2urdf check` finds from half a minute of ordinary moves.

A robot is calibrated on its model once, from three minutes; then SUs slip by given sizes, one in
each recording, or none does. Every slip has to be found, and where there is none no alarm raised.
How many would be found on average, as stated by the check, and by the Cramer-Rao bound (with the
joints, the sensors and the calibration known exactly), stands beside it.

    python scripts/check_slips.py --robots panda --slips 0,0 1,0 0,0.2 --recordings 20
    python scripts/check_slips.py --output slips.jsonl --summary-only

Exit status: 0; 1 where a trial failed or is not as it should be; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import groupby, product

from batch import options as batch_options
from batch import run
from batch.figures import cell, count, missed, rms, table
from batch.records import Failure
from batch.run import Batch
from models.slips import Noticed, Run, Slip, perform


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="slips.jsonl", recordings=1, of=" of each robot and slip"
    )
    what = new.add_argument_group("what to run")
    what.add_argument("--robots", nargs="+", default=["panda"], help="names in robots/")
    what.add_argument(
        "--slips", nargs="+", type=_slip, default=[(0.0, 0.0), (1.0, 0.0), (0.0, 0.2)],
        metavar="MM,DEG", help="sizes of slips (default: 0,0 1,0 0,0.2)",
    )  # fmt: skip
    what.add_argument("--seconds", type=float, default=30.0, help="of motion (default: 30)")
    what.add_argument("--grade", default="mems", help="of the sensors (default: mems)")
    return new


def _slip(text: str) -> tuple[float, float]:
    shift, _, turn = text.partition(",")
    return float(shift), float(turn or 0)


def cases_of(options: argparse.Namespace) -> list[Slip]:
    """Every trial that was asked for, seed by seed, those of one recording in a row."""
    every = product(batch_options.seeds(options), options.robots, options.slips)
    return [
        Slip(robot, seed, shift, turn, options.seconds, options.grade)
        for seed, robot, (shift, turn) in every
    ]


def shortfalls(run: Run) -> list[str]:
    """What of one trial is not as it should be."""
    found = run.outcome
    if isinstance(found, Failure):
        return [str(found)]
    expected = (found.slipped,) if found.slipped else ()
    if found.changed == expected:
        return []
    return [f"{', '.join(found.changed) or 'none'} told to have changed, not {expected or 'none'}"]


def report(runs: Sequence[Run]) -> str:
    """A row for each size, and the trials that fell short."""

    def size(run: Run) -> tuple[str, float, float]:
        return run.case.robot, run.case.shift_mm, run.case.turn_deg

    heads = (
        ("", "trials"), ("as it", "should"), ("slip", "found"), ("expected", "to be"),
        ("by the", "bound"), ("alarms", "beside"),
        ("shift", "sd mm"), ("turn", "sd deg"), ("largest", "chi2/dof"), ("time", "s"),
    )  # fmt: skip
    rows = []
    for (robot, shift, turn), group in groupby(sorted(runs, key=size), key=size):
        mine = list(group)
        done = [r.outcome for r in mine if isinstance(r.outcome, Noticed)]
        good = sum(not shortfalls(r) for r in mine)
        slips = [f for f in done if f.slipped]
        cells = (
            str(len(mine)),
            count(good, len(mine)),
            str(sum(f.slipped in f.changed for f in slips)),
            cell(sum(f.expected or 0.0 for f in slips) if slips else None, 1),
            cell(sum(f.found_by_bound or 0.0 for f in slips) if slips else None, 1),
            str(sum(bool(set(f.changed) - {f.slipped}) for f in done)),
            cell(rms(f.shift_sd_mm for f in slips), 3),
            cell(rms(f.turn_sd_deg for f in slips), 4),
            cell(max((f.chi2_per_dof for f in done), default=None), 1),
            cell(sum(f.seconds for f in done) / len(done) if done else None, 1),
        )
        rows.append((f"{robot} {shift:g} mm {turn:g} deg", cells))
    found = [(r.case.key, shortfalls(r)) for r in runs]
    return table("slip", heads, rows) + missed(found, "are not as they should be")


BATCH = Batch(
    Slip, Noticed, perform, cases_of, report, shortfalls,
    lambda runs: not any(shortfalls(r) for r in runs),
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
