"""The options that all batch scripts have: how many, where to, and by whom."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from skin2urdf.errors import UsageError


def parser(
    words: str, *, output: str, recordings: int, counted: Sequence[str] = (), of: str = ""
) -> argparse.ArgumentParser:
    """A command line with the options that all have.

    Args:
        words: docstring of the script: its first line, and the rest.
        output: default of ``--output``.
        recordings: default of ``--recordings``.
        counted: other names of ``--recordings`` beside ``--seeds``.
        of: what there are so many of.
    """
    first, _, rest = words.partition("\n")
    new = argparse.ArgumentParser(
        description=first, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    how = new.add_argument_group("how many, where to, and by whom")
    how.add_argument(
        "--recordings", "--seeds", *counted, dest="recordings", type=int, default=recordings,
        metavar="N", help=f"how many{of} (default: {recordings})",
    )  # fmt: skip
    how.add_argument(
        "--first-seed", type=int, default=0, metavar="N", help="of seeds in a row (default: 0)"
    )
    how.add_argument(
        "--output", type=Path, default=Path(output), metavar="FILE",
        help="a line of JSON for each as soon as it is finished; what is in it is not done again, "
        f"several batches may share it (default: {output})",
    )  # fmt: skip
    how.add_argument("--retry", action="store_true", help="do again what failed")
    how.add_argument("--summary-only", action="store_true", help="do nothing, show the output")
    how.add_argument(
        "--jobs", "--workers", dest="jobs", type=int, default=2, metavar="N",
        help="processes; 0 for none but this one, for a debugger (default: 2)",
    )  # fmt: skip
    how.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="use the workers of this dask.distributed scheduler (tcp://host:8786)",
    )  # fmt: skip
    return new


def seeds(options: argparse.Namespace, least: int = 1) -> range:
    """Seeds that the options ask for.

    Args:
        options: of a command line that :func:`parser` has begun.
        least: smallest number of recordings.

    Raises:
        UsageError: a number can not be used.
    """
    if options.recordings < least or options.first_seed < 0 or options.jobs < 0:
        raise UsageError(
            f"--recordings starts at {least}, --first-seed and --jobs at 0", "give a larger number"
        )
    return range(options.first_seed, options.first_seed + options.recordings)
