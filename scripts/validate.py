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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from validation import batch, plot, store, table, workers
from validation.cases import TRACKINGS, Case, Circumstance, circumstances, robots_named
from validation.measure import perform
from validation.records import Figures, Run
from validation.summary import converged, shortfalls

from skin2urdf.errors import UsageError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    words, _, rest = (__doc__ or "").partition("\n")
    new = argparse.ArgumentParser(
        description=words, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = new.add_argument_group("what to run")
    what.add_argument(
        "--robots", nargs="+", default=["panda"], metavar="ROBOT",
        help="names in robots/, URDFs, 'all' for all of robots/, 'urdfs' for every URDF of "
        "example-robot-data in which a joint can move (default: panda)",
    )  # fmt: skip
    what.add_argument("--seeds", type=int, default=1, help="seeds 0 to N - 1 (default: 1)")
    what.add_argument("--first-seed", type=int, default=0, help="where to start instead of 0")
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
    how = new.add_argument_group("how to run it")
    how.add_argument(
        "--output", type=Path, default=Path("runs.jsonl"), metavar="FILE",
        help="one line of JSON per run; what is in it is not run again (default: runs.jsonl)",
    )  # fmt: skip
    how.add_argument("--retry", action="store_true", help="run again what failed")
    how.add_argument(
        "--workers", type=int, default=2, metavar="N",
        help="processes; 0 runs in this one, for a debugger (default: 2)",
    )  # fmt: skip
    how.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="use the workers of this dask.distributed scheduler (tcp://host:8786)",
    )  # fmt: skip
    how.add_argument(
        "--summary-only", action="store_true", help="run nothing, show what the output holds"
    )
    how.add_argument("--plot", type=Path, metavar="FILE", help="write plots into this image")
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every case that was asked for, seed by seed, so that a batch cut short covers all robots.

    Raises:
        UsageError: an option can not be used.
    """
    if min(options.seeds, options.poses) < 1 or options.first_seed < 0:
        raise UsageError("--seeds and --poses start at 1", "give a larger number")
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
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    return [Case(robot, seed, kind) for seed, kind, robot in product(seeds, kinds, robots)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    return batch.command("validate.py", _validate, options)


def _validate(options: argparse.Namespace) -> int:
    runs, broken = store.load(options.output)
    if broken:
        print(f"{options.output}: {broken} line(s) hold no whole run and are passed over")
    if options.summary_only:
        shown = list(runs.values())
    else:
        wanted = cases_of(options)
        left = [case for case in wanted if not _is_done(runs.get(case.key), options.retry)]
        if len(left) < len(wanted):
            print(f"{len(wanted) - len(left)} of {len(wanted)} runs are in {options.output}")
        if left:
            runs |= _run(left, options)
        shown = [runs[case.key] for case in wanted]
    print(table.report(shown), end="")
    if options.plot is not None:
        plot.save(shown, options.plot)
        print(f"plots: {options.plot}")
    return int(any(not _is_good(run) for run in shown))


def _is_done(run: Run | None, retry: bool) -> bool:
    return run is not None and (isinstance(run.outcome, Figures) or not retry)


def _is_good(run: Run) -> bool:
    return isinstance(run.outcome, Figures) and converged(run.outcome)


def _run(cases: Sequence[Case], options: argparse.Namespace) -> dict[str, Run]:
    """Run cases, each into the output as it finishes; returns them by key."""
    if options.scheduler:
        over = workers.cluster(options.scheduler)
    else:
        over = workers.here
        if options.workers > 0:
            over = workers.pool(options.workers, workers.failed)
    output = store.Store(options.output)
    found: dict[str, Run] = {}
    with _progress(len(cases)) as progress:
        for run in over(perform, cases):
            output.append(run)
            found[run.case.key] = run
            (task,) = progress.task_ids
            progress.advance(task)
            for words in shortfalls(run):
                progress.console.print(f"{run.case.key}: {words}", markup=False, highlight=False)
    return found


@contextmanager
def _progress(total: int) -> Iterator[Progress]:
    """A bar on stderr with the time that is left."""
    columns = (
        TextColumn("validating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("left"),
    )  # fmt: skip
    console = Console(stderr=True, soft_wrap=True)
    # The time of a run varies by robot: the estimate of what is left looks far back.
    with Progress(*columns, console=console, speed_estimate_period=600.0) as progress:
        progress.add_task("runs", total=total)
        yield progress


if __name__ == "__main__":
    sys.exit(main())
