"""A batch from its command line to its table: what every script does alike."""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Generic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from batch.pool import Map, workers
from batch.provenance import checkout, package_digest
from batch.records import C, F, Failure, Record, parsed
from batch.store import Store
from skin2urdf.errors import Skin2UrdfError

_WAIT = 1.0
"""Between looks at what another batch has under way [s]; a case takes about as long."""


@dataclass(frozen=True)
class Batch(Generic[C, F]):
    """What a script adds to the mechanism.

    Attributes:
        case: type of its cases, a frozen dataclass with a key.
        figures: type of what comes of a case, a frozen dataclass.
        perform: does a case; of a module that workers can import. What it raises becomes a
            :class:`batch.records.Failure`, so that a batch outlives it.
        cases: the cases that the options ask for, so ordered that a batch cut short covers all
            groups.
        report: the table.
        shortfalls: what is wrong with a record, in words; empty where nothing is.
        passed: whether the records are as they should be.
    """

    case: type[C]
    figures: type[F]
    perform: Callable[[C], F]
    cases: Callable[[argparse.Namespace], Sequence[C]]
    report: Callable[[Sequence[Record[C, F]]], str]
    shortfalls: Callable[[Record[C, F]], Sequence[str]]
    passed: Callable[[Sequence[Record[C, F]]], bool]


def main(
    batch: Batch[C, F],
    options: argparse.Namespace,
    also: Callable[[Sequence[Record[C, F]]], None] | None = None,
) -> int:
    """Do what is left of a batch and print its table.

    Args:
        batch: the script.
        options: of :func:`batch.options.parser` and of the script.
        also: what else to do with the records, behind the table.

    Returns:
        Exit status: 0; 1 where something fell short; what an error says; 130 when stopped.
    """
    try:
        shown = records(batch, options)
        print(batch.report(shown), end="")
        states = sorted({record.code for record in shown})
        print(f"Code: {', '.join(states) or 'none'}")
        if len(states) > 1:
            print(
                f"These runs come from {len(states)} states of the code; give a fresh --output to "
                "measure one."
            )
        if also is not None:
            also(shown)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on where {options.output} ends", file=sys.stderr)
        return 130
    except Skin2UrdfError as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        if error.remedy:
            print(f"  {error.remedy}", file=sys.stderr)
        return int(error.exit_status)
    except OSError as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        return 2
    return int(not batch.passed(shown))


def records(batch: Batch[C, F], options: argparse.Namespace) -> list[Record[C, F]]:
    """Records of all cases asked for; those that the output lacks are done and added to it.

    Args:
        batch: the script.
        options: ``output``, ``summary_only``, ``retry``, ``jobs``, ``scheduler``, and what the
            script's cases need.

    Raises:
        UnreadableInputError: the output can not be read, or is another script's.
        UsageError: an option can not be used.
    """
    store = Store(options.output, batch.case, batch.figures)
    if store.broken:
        print(f"{options.output}: {store.broken} line(s) hold no whole run and are passed over")
    if options.summary_only:
        return list(store.records.values())
    wanted = {case.key: case for case in batch.cases(options)}
    left = {
        key: case
        for key, case in wanted.items()
        if key not in store.records or (options.retry and store.records[key].failure)
    }
    if len(left) < len(wanted):
        print(f"{len(wanted) - len(left)} of {len(wanted)} runs are in {options.output}")
    if left:
        try:
            _do(batch, left, store, workers(options.jobs, options.scheduler))
        finally:
            store.close()
    return [store.records[key] for key in wanted]


def _do(batch: Batch[C, F], left: dict[str, C], store: Store[C, F], over: Map[C, str]) -> None:
    """Do cases, each into the output as it finishes, or wait for who has it under way."""
    here = checkout()
    attempt = partial(_attempt, batch.perform, batch.figures)
    before = {key: store.records.get(key) for key in left}
    with _progress(len(left)) as (progress, advance):

        def is_done(case: C) -> bool:
            store.refresh()
            return store.records.get(case.key) is not before[case.key]

        def claimed(cases: Iterable[C]) -> Iterator[C]:
            """Those of the cases that nobody else has under way, claimed as they are taken."""
            for case in cases:
                if is_done(case):
                    advance()
                elif not store.claim(case):
                    elsewhere.append(case)
                elif is_done(case):  # by whom it was given back just before
                    store.release(case)
                    advance()
                else:
                    yield case

        waiting = list(left.values())
        while waiting:
            elsewhere: list[C] = []
            mine = claimed(waiting)
            if (first := next(mine, None)) is not None:
                for case, line in over(attempt, chain([first], mine)):
                    record = _record(batch, case, line)
                    record = replace(record, code=here.state(record.code))
                    store.append(record)
                    store.release(case)
                    advance()
                    for words in batch.shortfalls(record):
                        progress.print(f"{case.key}: {words}", markup=False, highlight=False)
            elif elsewhere:
                time.sleep(_WAIT)
            waiting = elsewhere


def _attempt(perform: Callable[[C], F], figures: type[F], case: C) -> str:
    """Line of a case, done here and now; whatever goes wrong becomes part of it."""
    try:
        line = Record(case, perform(case), package_digest()).to_json()
        parsed(line, type(case), figures)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno} {place.name}"
        failure = Failure(type(error).__name__, str(error), where)
        return Record(case, failure, package_digest()).to_json()
    return line


def _record(batch: Batch[C, F], case: C, line: str | Exception) -> Record[C, F]:
    """What a worker sent, or that it could not."""
    if isinstance(line, str):
        return parsed(line, batch.case, batch.figures)
    return Record(case, Failure(type(line).__name__, str(line), "its worker"), package_digest())


@contextmanager
def _progress(total: int) -> Iterator[tuple[Console, Callable[[], None]]]:
    """A bar on stderr with the time that is left: its console, and what moves it on."""
    columns = (
        TextColumn("running"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("left"),
    )  # fmt: skip
    console = Console(stderr=True, soft_wrap=True)
    # The time of a case varies: the estimate of what is left looks far back.
    with Progress(*columns, console=console, speed_estimate_period=600.0) as progress:
        task = progress.add_task("runs", total=total)
        yield progress.console, lambda: progress.advance(task)
