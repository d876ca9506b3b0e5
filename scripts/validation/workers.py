"""Who does the work: this process, a pool of processes, or a dask.distributed cluster."""

from __future__ import annotations

import multiprocessing
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TypeVar

from skin2urdf.errors import UsageError
from validation.cases import Case
from validation.records import Failure, Run

C = TypeVar("C")
R = TypeVar("R")
Map = Callable[[Callable[[C], R], Sequence[C]], Iterator[R]]
"""Does the work on every case and yields the runs as they finish."""


def here(work: Callable[[C], R], cases: Sequence[C]) -> Iterator[R]:
    """One after the other in this process."""
    yield from map(work, cases)


def failed(case: Case, words: str) -> Run:
    """The run of a case whose worker died."""
    return Run(case, Failure("WorkerDied", words, "its worker process"))


def pool(workers: int, died: Callable[[C, str], R]) -> Map[C, R]:
    """A map over a pool of processes on this machine.

    A worker that dies takes the pool with it. Then every case it may have died of is run again
    in a process of its own, so that the one to blame is a failure and the others are not.

    Args:
        workers: number of processes.
        died: the run of a case whose worker died, with words.
    """

    def over(work: Callable[[C], R], cases: Sequence[C]) -> Iterator[R]:
        waiting = list(cases)
        while waiting:
            under_way: dict[Future[R], C] = {}
            with _executor(min(workers, len(waiting))) as executor:
                try:
                    while waiting or under_way:
                        while waiting and len(under_way) < workers:
                            under_way[executor.submit(work, waiting[0])] = waiting[0]
                            waiting.pop(0)
                        done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                        for future in done:
                            run = future.result()
                            del under_way[future]
                            yield run
                except BrokenProcessPool:
                    suspects = list(under_way.values())
            if under_way:
                for case in suspects:
                    yield _alone(work, case, died)

    return over


def _executor(workers: int) -> ProcessPoolExecutor:
    """Fresh interpreters: forking a process that has loaded Pinocchio and BLAS is asking for it."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _alone(work: Callable[[C], R], case: C, died: Callable[[C, str], R]) -> R:
    """Run a case in a process of its own, which may die."""
    with _executor(1) as executor:
        try:
            return executor.submit(work, case).result()
        except BrokenProcessPool as error:
            return died(case, str(error))


def cluster(address: str) -> Map[Case, Run]:
    """A map over the workers of an existing dask.distributed scheduler.

    The workers need skin2urdf installed; the code of the validation itself is sent to them.

    Args:
        address: of the scheduler, such as ``tcp://127.0.0.1:8786``.

    Raises:
        UsageError: dask.distributed is not installed, or nobody answers at the address.
    """

    def over(work: Callable[[Case], Run], cases: Sequence[Case]) -> Iterator[Run]:
        try:
            from distributed import Client, as_completed
        except ImportError as error:
            raise UsageError("--scheduler needs dask", "pip install distributed") from error
        try:
            client = Client(address, timeout=10)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            raise UsageError(
                f"no scheduler answers at {address}", "give what `dask scheduler` prints"
            ) from error
        with client, tempfile.TemporaryDirectory() as folder:
            client.upload_file(_packed(Path(folder)))
            futures = client.map(work, cases, key=[case.key for case in cases], pure=False)
            case_of = dict(zip((future.key for future in futures), cases, strict=True))
            for future in as_completed(futures):  # type: ignore[no-untyped-call]
                problem = future.exception()
                if problem is None:
                    yield future.result()
                else:
                    failure = Failure(type(problem).__name__, str(problem), "its dask worker")
                    yield Run(case_of[future.key], failure)
                future.release()

    return over


def _packed(folder: Path) -> str:
    """Path of a zip file of this package, as Python imports it."""
    package = Path(__file__).parent
    path = folder / f"{package.name}.zip"
    with zipfile.ZipFile(path, "w") as file:
        for source in sorted(package.glob("*.py")):
            file.write(source, f"{package.name}/{source.name}")
    return str(path)
