"""The file of runs: one line of JSON each, appended as they finish."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeVar

from skin2urdf.errors import UnreadableInputError
from validation.records import Run


class Keyed(Protocol):
    """A case; equal cases have equal keys."""

    @property
    def key(self) -> str:
        """Names it."""


class Line(Protocol):
    """What becomes a line: a run of some case."""

    @property
    def case(self) -> Keyed:
        """What was run."""

    def to_json(self) -> str:
        """The line."""


L = TypeVar("L", bound=Line)


def load(path: Path, parse: Callable[[str], L] = Run.from_json) -> tuple[dict[str, L], int]:
    """Runs of a file by key; of several with one key the last counts.

    Args:
        path: the file; it need not exist.
        parse: makes a run of a line, or raises ValueError.

    Returns:
        The runs, and the number of lines that are no run (a line half-written when the batch was
        stopped).

    Raises:
        UnreadableInputError: the file can not be read, or holds lines but no run.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return {}, 0
    except OSError as error:
        raise UnreadableInputError(str(path), f"can not be read: {error.strerror}") from error
    runs: dict[str, L] = {}
    broken = 0
    for line in filter(str.strip, lines):
        try:
            run = parse(line)
        except ValueError:
            broken += 1
            continue
        runs[run.case.key] = run
    if broken > 1 and not runs:
        raise UnreadableInputError(
            str(path), "holds no run of this script", "give another file to --output"
        )
    return runs, broken


class Store:
    """Appends runs to a file, each whole and at once on disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and (content := path.read_bytes()) and not content.endswith(b"\n"):
            self._write("\n")

    def append(self, run: Line) -> None:
        """Add a run."""
        self._write(run.to_json() + "\n")

    def _write(self, text: str) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(text)
