"""Estimate random serial chains from features and hold every one against its truth.

Chains of 2 to 9 revolute and prismatic joints are drawn with neighbours that are parallel,
perpendicular or meet, with SUs on every segment, on some or at the tip only, with the first axis
upright or tilted. Their features come from Pinocchio's frame Jacobians with the noise of a
regression. An estimate is at the global optimum where a refinement from the truth finds no better
one, and where it predicts fresh configurations as exactly as its covariance promises. Each chain is
one line of JSON in the output as soon as it is finished; what is there is not done again.

    python scripts/random_chains.py --chains 200
    python scripts/random_chains.py --chains 10000 --output chains.jsonl
    python scripts/random_chains.py --output chains.jsonl --summary-only

Exit status: 0; 1 where an optimum was missed without the cost saying so, or more than one in
10,000 was missed; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

# The matrices are many and small: threads of linear algebra would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from chains.judge import Case, Outcome, died, judged
from chains.summary import report
from validation import batch

from skin2urdf.errors import UsageError

ALLOWED = 1e-4
"""Share of chains that may miss the optimum."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    words, _, rest = (__doc__ or "").partition("\n")
    new = argparse.ArgumentParser(
        description=words, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    new.add_argument("--chains", type=int, default=200, help="how many (default: 200)")
    new.add_argument("--first-seed", type=int, default=0, help="where to start instead of 0")
    new.add_argument("--output", type=Path, default=Path("chains.jsonl"), metavar="FILE")
    new.add_argument("--workers", type=int, default=2, help="processes; 0 runs in this one")
    new.add_argument("--summary-only", action="store_true", help="run nothing, show the output")
    return new


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    return batch.command("random_chains.py", _run, options)


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every chain that was asked for.

    Raises:
        UsageError: an option can not be used.
    """
    if options.chains < 1 or options.first_seed < 0 or options.workers < 0:
        raise UsageError(
            "--chains starts at 1, --first-seed and --workers at 0", "give a larger number"
        )
    return [Case(options.first_seed + i) for i in range(options.chains)]


def _run(options: argparse.Namespace) -> int:
    shown = batch.outcomes(options, cases_of, judged, Outcome.from_json, died)
    print(report(shown), end="")
    missed = [o for o in shown if o.failed]
    return int(len(missed) > ALLOWED * len(shown) or not all(o.recognised for o in missed))


if __name__ == "__main__":
    sys.exit(main())
