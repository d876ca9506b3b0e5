"""``skin2urdf guide``: the documentation that comes with the package."""

from __future__ import annotations

import argparse
import sys
from importlib import resources
from importlib.resources.abc import Traversable

from skin2urdf.cli.arguments import Parser
from skin2urdf.errors import UsageError

HELP = "show a guide: record, calibrate, judge, use and more"
EPILOG = """\
example:
  skin2urdf guide
  skin2urdf guide record

Without a name: what guides there are. Piped, a guide is plain Markdown."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("name", nargs="?", metavar="NAME", help="the guide to show")


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    known = guides()
    if options.name is None:
        width = max(map(len, known))
        for name, guide in known.items():
            print(f"{name:{width}}  {_title(guide)}")
        return 0
    if options.name not in known:
        raise UsageError(f"there is no guide {options.name!r}", f"one of {', '.join(known)}")
    text = known[options.name].read_text(encoding="utf-8")
    if not sys.stdout.isatty():
        print(text, end="")
        return 0
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    with console.pager(styles=True):
        console.print(Markdown(text))
    return 0


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
