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
import sys
from collections.abc import Sequence

from batch import options as batch_options
from batch import run
from batch.run import Batch
from chains.judge import Case, Judged, Outcome, judged, outcome_of
from chains.summary import report, shortfall

ALLOWED = 1e-4
"""Share of chains that may miss the optimum."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    return batch_options.parser(
        __doc__ or "", output="chains.jsonl", recordings=200, counted=["--chains"]
    )


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Every chain that was asked for.

    Raises:
        UsageError: an option can not be used.
    """
    return [Case(seed) for seed in batch_options.seeds(options)]


def _shortfalls(record: Judged) -> list[str]:
    outcome = outcome_of(record)
    return [shortfall(outcome)] if outcome.failed else []


def _passed(records: Sequence[Judged]) -> bool:
    missed = [o for o in map(outcome_of, records) if o.failed]
    return len(missed) <= ALLOWED * len(records) and all(o.recognised for o in missed)


BATCH = Batch(Case, Outcome, judged, cases_of, report, _shortfalls, _passed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run.main(BATCH, parser().parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
