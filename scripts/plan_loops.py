r"""From plans over recordings to calibrations: half the time, and what is foreseen comes true.

For each robot and seed the default recording is simulated, and one that follows a plan of a given
part of its length; both are calibrated and held against the truth, and against what was foreseen
from the plan alone. Each is one line of JSON in the output as soon as it is finished.

    python scripts/plan_loops.py --robots panda ur5 --recordings 5
    python scripts/plan_loops.py --grade bma150 --no-default

Exit status: 0; 1 where a calibration fell short; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import figures, run
from batch import options as batch_options
from batch.run import Batch
from planned.loops import Case, Deviations, Figures, Loop, perform

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, robot_names

_HEAD = (
    ("re-", "cordings"), ("default", "s"), ("stated", "mm"), ("", "deg"), ("plan", "s"),
    ("foreseen", "mm"), ("", "deg"), ("stated", "mm"), ("", "deg"), ("true", "mm"), ("", "deg"),
    ("foreseen / stated", "mm"), ("", "deg"), ("foreseen / true", "mm"), ("", "deg"),
)  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="plan_loops.jsonl", recordings=3, of=" of each robot"
    )
    what, default = new.add_argument_group("what to record"), Case("", 0)
    what.add_argument(
        "--robots", nargs="+", default=["panda", "ur5"], choices=robot_names(), metavar="ROBOT",
        help="names (default: panda ur5)",
    )  # fmt: skip
    what.add_argument("--grade", default=default.grade, choices=sorted(GRADES))
    what.add_argument(
        "--part", type=float, default=default.part, help="of the default's time (%(default)s)"
    )
    what.add_argument(
        "--no-default", action="store_true", help="do not calibrate the default recording"
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every loop asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if not options.part > 0:
        raise UsageError("--part starts above 0", "give a larger number")
    return [
        Case(robot, seed, options.grade, options.part, not options.no_default)
        for seed in batch_options.seeds(options)
        for robot in options.robots
    ]


def report(loops: Sequence[Loop]) -> str:
    """One row a robot, root mean squares over its recordings."""
    if not loops:
        return "No recordings.\n"
    rows = []
    for group in dict.fromkeys(loop.case.group for loop in loops):
        own = [loop for loop in loops if loop.case.group == group]
        rows.append((group, _row([loop.figures for loop in own if not loop.failure], len(own))))
    found = [(loop.case.key, shortfalls(loop)) for loop in loops]
    return "\n".join(
        [figures.table("deviations of SUs, rms", _HEAD, rows), figures.missed(found, "fell short")]
    )


def shortfalls(loop: Loop) -> list[str]:
    """What is wrong with the calibrations."""
    if loop.failure:
        return [str(loop.failure)]
    judged = [loop.figures.planned, *([loop.figures.default] if loop.case.default else [])]
    return [each.verdict or "wrong tree" for each in judged if not each.tree_right]


def complete(loops: Sequence[Loop]) -> bool:
    """Whether every recording came to the right tree."""
    return not any(shortfalls(loop) for loop in loops)


def _row(done: Sequence[Figures], n: int) -> tuple[str, ...]:
    def both(of: Sequence[Deviations]) -> tuple[float | None, float | None]:
        return figures.rms(d.position_mm for d in of), figures.rms(d.orientation_deg for d in of)

    default = both([f.default.stated for f in done])
    foreseen = both([f.foreseen for f in done])
    stated, true = both([f.planned.stated for f in done]), both([f.planned.true for f in done])
    ratios = [
        a / b if a and b else None
        for second in (stated, true)
        for a, b in zip(foreseen, second, strict=True)
    ]
    return (
        figures.count(len(done), n),
        figures.cell(figures.rms(f.default.seconds for f in done), 0),
        *map(figures.short, default),
        figures.cell(figures.rms(f.planned.seconds for f in done), 0),
        *map(figures.short, (*foreseen, *stated, *true)),
        *(figures.cell(ratio, 2) for ratio in ratios),
    )


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
