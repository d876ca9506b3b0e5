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
from pathlib import Path

from faulty import table
from faulty.trials import CLEAN, CLEAN_TWO, INJECTIONS, Case, Setting, Trial, died, perform
from validation import batch

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, robot_names


def parser() -> argparse.ArgumentParser:
    """The command line."""
    words, _, rest = (__doc__ or "").partition("\n")
    new = argparse.ArgumentParser(
        description=words, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = Setting()
    new.add_argument("--robot", default=default.robot, choices=robot_names(), metavar="ROBOT")
    new.add_argument("--grade", default=default.grade, choices=sorted(GRADES))
    new.add_argument("--excite", default=default.excite, choices=["one", "all"])
    new.add_argument("--poses", type=int, default=default.poses, help="poses per recording")
    new.add_argument("--encoder-bits", type=int, default=default.encoder_bits)
    new.add_argument(
        "--kinds", nargs="+", default=list(INJECTIONS), choices=list(INJECTIONS), metavar="KIND",
        help=f"of {', '.join(INJECTIONS)} (default: all)",
    )  # fmt: skip
    new.add_argument("--recordings", type=int, default=10, help="per kind (default: 10)")
    new.add_argument("--clean", type=int, default=0, help="recordings without a fault")
    new.add_argument("--first-seed", type=int, default=0, help="where to start instead of 0")
    new.add_argument("--output", type=Path, default=Path("faults.jsonl"), metavar="FILE")
    new.add_argument("--workers", type=int, default=2, help="processes; 0 runs in this one")
    new.add_argument("--summary-only", action="store_true", help="run nothing, show the output")
    return new


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every trial asked for, seed by seed.

    Raises:
        UsageError: an option can not be used.
    """
    if min(options.poses, options.encoder_bits) < 1 or min(options.recordings, options.clean) < 0:
        raise UsageError("numbers of poses, bits and recordings are positive", "give larger ones")
    setting = Setting(
        options.robot, options.grade, options.excite, options.poses, options.encoder_bits
    )
    cases = []
    for i in range(max(options.recordings, options.clean)):
        kinds = list(options.kinds) if i < options.recordings else []
        clean = [CLEAN, CLEAN_TWO] if i < options.clean else []
        cases += [Case(setting, kind, options.first_seed + i) for kind in (*clean, *kinds)]
    return cases


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    return batch.command("faults.py", _run, options)


def _run(options: argparse.Namespace) -> int:
    shown = batch.outcomes(options, cases_of, perform, Trial.from_json, died)
    print(table.report(shown), end="")
    return int(not table.complete(shown))


if __name__ == "__main__":
    sys.exit(main())
