"""What the command line does besides arguments and results: progress, and pipes that close."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_PATIENCE = 1.0
"""How long work may take before a progress bar appears [s]."""


class Bar:
    """A progress bar on the error stream that appears once the work takes over a second."""

    def __init__(self, shown: bool) -> None:
        self._shown = shown
        self._begin = time.monotonic()
        self._progress: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, share: float) -> None:
        """Say that a share in [0, 1] of a stage is done."""
        if not self._shown or (
            self._progress is None and time.monotonic() - self._begin < _PATIENCE
        ):
            return
        if self._progress is None:
            self._progress = _started()
        if stage not in self._tasks:
            self._tasks[stage] = self._progress.add_task(stage, total=1.0)
        self._progress.update(self._tasks[stage], completed=share)

    def close(self) -> None:
        """Take the bar off the screen."""
        if self._progress is not None:
            self._progress.stop()


def _started() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    progress = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    progress.start()
    return progress


@contextlib.contextmanager
def progress_bar(quiet: bool) -> Iterator[Bar]:
    """A bar for the work inside; silent when asked to be, and where nobody watches."""
    bar = Bar(shown=not quiet and sys.stderr.isatty())
    try:
        yield bar
    finally:
        bar.close()


def silence_stdout() -> None:
    """Send what is still to be written to nowhere, after the reader of a pipe has gone.

    Python writes its buffers once more on exit, which would fail again.
    """
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
