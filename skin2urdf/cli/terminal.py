"""What the command line does besides arguments and results: progress, and pipes that close."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PATIENCE = 1.0
"""How long work may take before a progress bar appears [s]."""


class Bar:
    """A progress bar on the error stream that appears once the work takes over a second."""

    def __init__(self, shown: bool, patience: float = PATIENCE) -> None:
        self._lock = threading.Lock()
        self._closed = False
        self._progress: Progress | None = None
        self._shares: dict[str, float] = {}
        self._tasks: dict[str, TaskID] = {}
        # A timer, because one long stage may be all there is, and it tells nothing meanwhile.
        self._timer = threading.Timer(patience, self._appear)
        self._timer.daemon = True
        if shown:
            self._timer.start()

    def __call__(self, stage: str, share: float) -> None:
        """Say that a share in [0, 1] of a stage is done."""
        with self._lock:
            self._shares[stage] = share
            self._draw(stage)

    def close(self) -> None:
        """Take the bar off the screen."""
        self._timer.cancel()
        with self._lock:
            self._closed = True
            if self._progress is not None:
                self._progress.stop()

    def _appear(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._progress = _started()
            for stage in self._shares:
                self._draw(stage)

    def _draw(self, stage: str) -> None:
        """Show what is known of a stage; a stage that has not told its share yet only pulses."""
        if self._progress is None:
            return
        if stage not in self._tasks:
            self._tasks[stage] = self._progress.add_task(stage, total=None)
        share = self._shares[stage]
        if share > 0:
            self._progress.update(self._tasks[stage], total=1.0, completed=share)


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
def progress_bar(quiet: bool, patience: float = PATIENCE) -> Iterator[Bar]:
    """A bar for the work inside; silent when asked to be, and where nobody watches.

    Args:
        quiet: whether to show none.
        patience: how long the work may take before the bar appears [s].
    """
    bar = Bar(shown=not quiet and sys.stderr.isatty(), patience=patience)
    try:
        yield bar
    finally:
        bar.close()


def open_streams() -> None:
    """Send to nowhere what would go to an output that was closed before the program began.

    Otherwise the first file that is opened takes its place, and gets what was meant for a screen.
    """
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            with contextlib.suppress(OSError):
                descriptor = os.open(os.devnull, os.O_WRONLY)
                if descriptor != number:
                    os.dup2(descriptor, number)
                    os.close(descriptor)
                setattr(sys, name, os.fdopen(number, "w", closefd=False))


def silence_stdout() -> None:
    """Send what is still to be written to nowhere, after its reader has gone or its disk is full.

    Python writes its buffers once more on exit, which would fail again.
    """
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
