"""``skin2urdf guide``: the documentation that comes with the package."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib import resources
from importlib.resources.abc import Traversable

from skin2urdf.cli.arguments import Parser, did_you_mean
from skin2urdf.errors import UsageError

HELP = "show a guide: record, calibrate, judge, use and more"
EPILOG = """\
example:
  skin2urdf guide
  skin2urdf guide record

Without a name: what guides there are. Piped, a guide is plain Markdown."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument(
        "name", nargs="*", metavar="NAME", help="the guide to show, or how its name begins"
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    known = guides()
    if not options.name:
        width = max(map(len, known))
        for name, guide in known.items():
            print(f"{name:{width}}  {_title(guide)}")
        return 0
    text = known[_meant(" ".join(options.name), list(known))].read_text(encoding="utf-8")
    if not sys.stdout.isatty():
        print(text, end="")
        return 0
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    with console.pager(styles=True):
        console.print(Markdown(text))
    return 0


def _meant(text: str, names: Sequence[str]) -> str:
    """The one of some names that a text means, as a person may write it or a file is called.

    Raises:
        UsageError: it means none of them, or several.
    """
    asked = re.sub(r"[\s_-]+", "-", text.strip().lower()).removesuffix(".md")
    found = [name for name in names if name == asked] or [
        name for name in names if asked and name.startswith(asked)
    ]
    if len(found) > 1:
        raise UsageError(f"several guides begin with {text!r}", f"one of {', '.join(found)}")
    if not found:
        near = did_you_mean(asked, names)
        raise UsageError(f"there is no guide {text!r}{near}", f"one of {', '.join(names)}")
    return found[0]


def guides() -> dict[str, Traversable]:
    """The guides by name, in the order they are read in."""
    folder = resources.files("skin2urdf") / "guides"
    found = {
        entry.name.removesuffix(".md"): entry
        for entry in folder.iterdir()
        if entry.name.endswith(".md")
    }
    listed = [name for name in _ORDER if name in found]
    return {name: found[name] for name in (*listed, *sorted(found.keys() - _ORDER))}


_ORDER = (
    "record",
    "plan",
    "formats",
    "calibrate",
    "judge",
    "see",
    "use",
    "vendor-models",
    "real-robots",
    "gyroscopes",
    "simulate",
    "how-it-works",
    "measured",
)
"""From a first log to the last detail; others follow by name."""


def _title(guide: Traversable) -> str:
    """The guide's first line."""
    return guide.read_text(encoding="utf-8").split("\n", 1)[0].lstrip("# ")
