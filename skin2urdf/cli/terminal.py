"""What the command line does for whoever watches: progress, colour, lines that fit, pipes."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
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
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    progress = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
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


def show(text: Callable[[], str]) -> None:
    """Print a result: as it is to a file or a pipe, in lines that fit and with colour to a screen.

    Colour is left out where NO_COLOR is set.

    Args:
        text: makes the text; its tables then know how wide they may be.
    """
    if not sys.stdout.isatty():
        print(text(), end="")
        return
    from rich.console import Console
    from rich.text import Text

    from skin2urdf.report.tables import fitting

    width = max(_NARROWEST, shutil.get_terminal_size().columns)
    with fitting(width):
        lines = text().splitlines()
    shown = Text("\n".join(part for line in lines for part in _folded(line, width)))
    for pattern, style in _STYLES:
        shown.highlight_regex(pattern, style)
    Console(highlight=False, soft_wrap=True).print(shown)


def complain(text: str) -> None:
    """Print what is wrong to the error stream, the first word in red on a screen."""
    if not sys.stderr.isatty():
        print(text, file=sys.stderr)
        return
    from rich.console import Console
    from rich.text import Text

    shown = Text(text)
    shown.highlight_regex(r"^[a-z ]*error:", "bold red")
    Console(stderr=True, highlight=False, soft_wrap=True).print(shown)


_NARROWEST = 40
"""Columns that results take at least."""
_STYLES = (
    (r"\Agood:|^Tree: right", "bold green"),
    (r"\Afair:", "bold yellow"),
    (r"\Abad:|^Tree: WRONG", "bold red"),
    (r"(?m)^(Faults|Missing):", "bold red"),
    (r"(?m)^Not observable from this log:", "bold yellow"),
    (r"\bnot observable\b|\bweak\b|\bplace open\b|\bnever move[sd]\b|\bmoves no SU\b", "yellow"),
)
"""What needs attention, and how that shows."""


def _folded(line: str, width: int) -> list[str]:
    """A line of prose in lines that fit; what follows a bullet stays behind it."""
    if len(line) <= width:
        return [line]
    start = len(line) - len(line.lstrip(" -"))
    return textwrap.wrap(
        line, width, subsequent_indent=" " * start, break_on_hyphens=False, break_long_words=False
    )


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
