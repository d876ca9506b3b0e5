"""Who does the work: this process, a pool of processes, or a dask.distributed cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from skin2urdf.errors import UsageError

T = TypeVar("T")
R = TypeVar("R")
Map = Callable[[Callable[[T], R], Iterable[T]], Iterator[tuple[T, R | Exception]]]
"""Does work on things, which it takes as late as it can, and yields each with its result as it is
finished, or with why there is none."""

_SCRIPTS = Path(__file__).resolve().parents[1]
_AHEAD = 2
"""Tasks that a cluster is given for each of its threads, so that none waits for the next."""


def workers(jobs: int, scheduler: str | None) -> Map[Any, Any]:
    """A map over the workers asked for.

    Args:
        jobs: number of processes on this machine; 0 for this one.
        scheduler: address of a dask.distributed scheduler whose workers are used instead.
    """
    if scheduler:
        return _cluster(scheduler)
    return _pool(jobs) if jobs > 0 else _here


def _here(work: Callable[[T], R], things: Iterable[T]) -> Iterator[tuple[T, R | Exception]]:
    """One after the other in this process."""
    for thing in things:
        yield thing, work(thing)


def _pool(jobs: int) -> Map[Any, Any]:
    """A map over a pool of processes.

    A worker that dies takes the pool with it. Then everything it may have died of is done again
    in a process of its own, so that the one to blame has no result and the others do.
    """

    def over(work: Callable[[T], R], things: Iterable[T]) -> Iterator[tuple[T, R | Exception]]:
        left = iter(things)
        broken = True
        while broken:
            broken = False
            suspects: list[T] = []
            with _processes(jobs) as executor:
                for thing, result in _finished(executor, jobs, work, left):
                    if isinstance(result, BrokenProcessPool):
                        suspects.append(thing)
                        broken = True
                    else:
                        yield thing, result
            for thing in suspects:
                with _processes(1) as executor:
                    yield from _finished(executor, 1, work, iter([thing]))

    return over


def _finished(
    executor: Executor, slots: int, work: Callable[[T], R], left: Iterator[T]
) -> Iterator[tuple[T, R | Exception]]:
    """Results as they come, with at most so many things under way; stops taking at a dead pool."""
    under_way: dict[Future[R], T] = {}
    alive = True
    while True:
        while alive and len(under_way) < slots:
            try:
                thing = next(left)
            except StopIteration:
                break
            try:
                under_way[executor.submit(work, thing)] = thing
            except BrokenProcessPool as error:
                alive = False
                yield thing, error
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            thing = under_way.pop(future)
            problem = future.exception()
            alive = alive and not isinstance(problem, BrokenProcessPool)
            if problem is not None and not isinstance(problem, Exception):
                raise problem
            yield thing, future.result() if problem is None else problem


def _processes(jobs: int) -> ProcessPoolExecutor:
    """Fresh interpreters: forking a process that has loaded Pinocchio and BLAS is asking for it."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """End this process without a word when it is interrupted, or the one that started it is gone.

    A worker of a killed pool would wait for work forever.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _cluster(address: str) -> Map[Any, Any]:
    """A map over the workers of an existing dask.distributed scheduler.

    The workers need skin2urdf installed; the packages beside the scripts are sent to them.

    Args:
        address: of the scheduler, such as ``tcp://127.0.0.1:8786``.

    Raises:
        UsageError: dask.distributed is not installed, nobody answers at the address, or the
            scheduler has no worker.
    """

    def over(work: Callable[[T], R], things: Iterable[T]) -> Iterator[tuple[T, R | Exception]]:
        with _client(address) as client:
            slots = _AHEAD * sum(client.nthreads().values())
            if not slots:
                raise UsageError(f"the scheduler at {address} has no worker", "start `dask worker`")
            with client.get_executor(pure=False) as executor:
                yield from _finished(executor, slots, work, iter(things))

    return over


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of a scheduler whose workers know the packages beside the scripts."""
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--scheduler needs dask", "pip install distributed") from error
    try:
        client = Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no scheduler answers at {address}", "give what `dask scheduler` prints"
        ) from error
    with client, tempfile.TemporaryDirectory() as folder:
        packages = sorted(path.parent for path in _SCRIPTS.glob("*/__init__.py"))
        archive = Path(folder) / "skin2urdf_scripts.zip"
        with zipfile.ZipFile(archive, "w") as file:
            for source in sorted(path for package in packages for path in package.rglob("*.py")):
                file.write(source, source.relative_to(_SCRIPTS).as_posix())
        client.upload_file(str(archive))
        # A worker may hold the modules that an earlier batch has sent.
        client.run(_forget, frozenset(package.name for package in packages))
        yield client


def _forget(packages: frozenset[str]) -> None:
    """Have modules loaded again when they are next asked for."""
    for name in [name for name in sys.modules if name.partition(".")[0] in packages]:
        del sys.modules[name]
