"""What batch scripts share: a command line that ends in words, and cases done only once."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

from skin2urdf.errors import Skin2UrdfError
from validation import store, workers

C = TypeVar("C", bound=store.Keyed)
L = TypeVar("L", bound=store.Line)


def command(
    name: str, work: Callable[[argparse.Namespace], int], options: argparse.Namespace
) -> int:
    """Exit status of a script's work; what goes wrong is said in words on stderr.

    Args:
        name: the script's.
        work: gives the exit status.
        options: of the command line, with the ``output`` that a stopped batch goes on with.
    """
    try:
        return work(options)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on where {options.output} ends", file=sys.stderr)
        return 130
    except Skin2UrdfError as error:
        print(f"{name}: {error}", file=sys.stderr)
        if error.remedy:
            print(f"  {error.remedy}", file=sys.stderr)
        return error.exit_status


def outcomes(
    options: argparse.Namespace,
    cases: Callable[[argparse.Namespace], Sequence[C]],
    perform: Callable[[C], L],
    parse: Callable[[str], L],
    died: Callable[[C, str], L],
) -> list[L]:
    """Outcomes of all cases asked for, those that the output lacks done now and added to it.

    Args:
        options: ``output``; ``summary_only`` to do nothing and take what the output holds;
            ``workers``, processes, 0 for this one.
        cases: the cases that the options ask for.
        perform: does one.
        parse: an outcome from a line of the output, or ValueError.
        died: the outcome of a case whose process died, with words.

    Raises:
        UnreadableInputError: the output can not be read, or is another script's.
    """
    done, _ = store.load(options.output, parse)
    if options.summary_only:
        return list(done.values())
    wanted = cases(options)
    left = [case for case in wanted if case.key not in done]
    over = workers.pool(options.workers, died) if options.workers > 0 else workers.here
    output = store.Store(options.output)
    for n, outcome in enumerate(over(perform, left), 1):
        output.append(outcome)
        done[outcome.case.key] = outcome
        if sys.stderr.isatty():
            print(f"\r{n} of {len(left)}", end="", file=sys.stderr, flush=True)
    return [done[case.key] for case in wanted]
