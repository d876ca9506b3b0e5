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

from chains.judge import Case, Outcome, judged
from chains.summary import report
from validation import store, workers

from skin2urdf.errors import Skin2UrdfError, UsageError

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
    try:
        return _run(options)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on where {options.output} ends", file=sys.stderr)
        return 130
    except Skin2UrdfError as error:
        print(f"random_chains.py: {error}", file=sys.stderr)
        if error.remedy:
            print(f"  {error.remedy}", file=sys.stderr)
        return error.exit_status


def _run(options: argparse.Namespace) -> int:
    outcomes, _ = store.load(options.output, Outcome.from_json)
    if options.summary_only:
        shown = list(outcomes.values())
    else:
        if options.chains < 1 or options.first_seed < 0 or options.workers < 0:
            raise UsageError("numbers of chains, seeds and processes are not negative", "")
        seeds = range(options.first_seed, options.first_seed + options.chains)
        wanted = [Case(seed) for seed in seeds]
        left = [case for case in wanted if case.key not in outcomes]
        over = workers.pool(options.workers) if options.workers else workers.here
        output = store.Store(options.output)
        for n, outcome in enumerate(over(judged, left), 1):
            output.append(outcome)
            outcomes[outcome.case.key] = outcome
            if sys.stderr.isatty():
                print(f"\r{n} of {len(left)}", end="", file=sys.stderr, flush=True)
        shown = [outcomes[case.key] for case in wanted]
    print(report(shown), end="")
    missed = [o for o in shown if o.failed]
    return int(len(missed) > ALLOWED * len(shown) or not all(o.recognised for o in missed))


if __name__ == "__main__":
    sys.exit(main())
