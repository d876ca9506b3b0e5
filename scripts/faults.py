r"""Put faults into simulated recordings and see whether a calibration finds them and survives.

For every kind of fault and seed a recording is simulated, the fault is put into it (whom it
strikes, when and how hard are drawn), and it is calibrated without knowing. The errors of the SUs
that have no fault are held against those of the same recording without the fault. Clean recordings
show false alarms. Each trial is one line of JSON in the output as soon as it is finished; what is
there already is not done again.

    python scripts/faults.py --kinds loose swapped --recordings 20
    python scripts/faults.py --recordings 100 --clean 200 --output faults.jsonl
    python scripts/faults.py --output faults.jsonl --summary-only

Exit status: 0; 1 where a fault was missed or a false alarm given; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from faulty.table import complete, report, shortfalls
from faulty.trials import CLEAN, CLEAN_TWO, INJECTIONS, Case, Figures, Setting, perform

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, robot_names


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = batch_options.parser(
        __doc__ or "", output="faults.jsonl", recordings=10, of=" of each kind"
    )
    what, default = new.add_argument_group("what to record"), Setting()
    what.add_argument("--robot", default=default.robot, choices=robot_names(), metavar="ROBOT")
    what.add_argument("--grade", default=default.grade, choices=sorted(GRADES))
    what.add_argument("--excite", default=default.excite, choices=["one", "all"])
    what.add_argument("--poses", type=int, default=default.poses, help="poses per recording")
    what.add_argument("--encoder-bits", type=int, default=default.encoder_bits)
    what.add_argument(
        "--kinds", nargs="*", default=list(INJECTIONS), choices=list(INJECTIONS), metavar="KIND",
        help=f"of {', '.join(INJECTIONS)} (default: all)",
    )  # fmt: skip
    what.add_argument(
        "--clean", type=int, default=0, metavar="N", help="recordings without a fault"
    )
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every trial asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if min(options.poses, options.encoder_bits) < 1 or options.clean < 0:
        raise UsageError("--poses and --encoder-bits start at 1", "give larger numbers")
    setting = Setting(
        options.robot, options.grade, options.excite, options.poses, options.encoder_bits
    )
    seeds = batch_options.seeds(options, least=0)
    cases = []
    for i in range(max(len(seeds), options.clean)):
        kinds = list(options.kinds) if i < len(seeds) else []
        clean = [CLEAN, CLEAN_TWO] if i < options.clean else []
        cases += [Case(setting, kind, seeds.start + i) for kind in (*clean, *kinds)]
    return cases


BATCH = Batch(Case, Figures, perform, cases_of, report, shortfalls, complete)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
