"""``skin2urdf man``: the manual page of this very version."""

from __future__ import annotations

import argparse
import functools
import re
import sys

from skin2urdf.cli.arguments import Filled, Parser, version

HELP = "print the manual page"
EPILOG = """\
to read it:
  skin2urdf man | man -l -
to install it:
  skin2urdf man > ~/.local/share/man/man1/skin2urdf.1"""

_WIDTH = 72
"""Characters in a line, beside the indent that `man` gives; 80 in all."""


def declare(command: Parser) -> None:
    """Add what the command takes: nothing."""


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    from skin2urdf.cli.commands.completion import commands_of

    top: argparse.ArgumentParser = options.parser
    about = (top.description or "").rstrip(".")
    general = Filled("", width=_WIDTH)
    general.add_text(top.epilog)
    lines = [
        f'.TH SKIN2URDF 1 "" "skin2urdf {_escaped(version())}" "User Commands"',
        ".SH NAME",
        rf"skin2urdf \- {_escaped(about[:1].lower() + about[1:])}",
        ".SH SYNOPSIS",
        r".B skin2urdf",
        r".I COMMAND",
        r"[\fIOPTION\fR ...]",
        ".SH DESCRIPTION",
        *_verbatim(general.format_help()),
        ".SH COMMANDS",
    ]
    for name, command in commands_of(top).items():
        command.formatter_class = functools.partial(Filled, width=_WIDTH)
        text = re.sub(r"\x1b\[[0-9;]*m", "", command.format_help())
        lines += [f".SS {name}", *_verbatim(text)]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def _verbatim(text: str) -> list[str]:
    """Lines that are shown as they are."""
    return [".nf", *(_escaped(line) for line in text.strip("\n").splitlines()), ".fi"]


def _escaped(line: str) -> str:
    """A line in which nothing is taken for an instruction."""
    line = line.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{line}" if line.startswith((".", "'")) else line
