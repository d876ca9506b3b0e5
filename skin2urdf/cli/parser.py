"""The parser of the whole command line, with help that teaches."""

from __future__ import annotations

import argparse
from typing import Protocol

from skin2urdf.cli.arguments import Filled, Parser, version
from skin2urdf.cli.commands import (
    calibrate,
    check,
    compare,
    completion,
    convert,
    explore,
    export,
    guide,
    info,
    man,
    plan,
    report,
    simulate,
    view,
)


class Command(Protocol):
    """What a module of ``commands/`` offers; it imports what is heavy inside ``run``."""

    HELP: str
    EPILOG: str

    def declare(self, command: Parser) -> None:
        """Add what the command takes."""

    def run(self, options: argparse.Namespace) -> int:
        """Do it; the exit status."""


COMMANDS: dict[str, Command] = {
    "plan": plan,
    "calibrate": calibrate,
    "check": check,
    "report": report,
    "view": view,
    "export": export,
    "info": info,
    "explore": explore,
    "compare": compare,
    "simulate": simulate,
    "convert": convert,
    "guide": guide,
    "completion": completion,
    "man": man,
}
"""The commands by name, in the order that help shows them."""

_DESCRIPTION = "From a ROS 2 bag of joint states and accelerometers to the URDF of the robot."
_EPILOG = """\
try it without a robot:
  skin2urdf simulate panda -o log.mcap --truth truth.urdf
  skin2urdf info log.mcap
  skin2urdf calibrate log.mcap -o robot.urdf
  skin2urdf compare robot.urdf truth.urdf

each command explains itself: skin2urdf calibrate --help

exit status: 0 all is well, 1 no trustworthy result (or the trees differ), 2 bad usage or an
unreadable input, 3 the URDF was written, but an SU or an encoder needs repair, or most SUs are not
determined (calibrate), or an SU is not where it was (check)"""


def order_of_arguments(options: argparse.Namespace, path: str) -> str:
    """What a command takes beside options, in its order; empty where a path is none of that.

    Args:
        options: what was given, with the parser of the whole command line.
        path: as it was given.
    """
    command = completion.commands_of(options.parser)[options.command]
    places = [action for action in command._actions if not action.option_strings]
    given: list[str] = []
    for place in places:
        value = getattr(options, place.dest)
        given += value if isinstance(value, list) else [value]
    forms = {"+": "{} ..", "?": "[{}]"}
    words = [forms.get(str(place.nargs), "{}").format(place.metavar) for place in places]
    return f"{command.prog} {' '.join(words)}" if path in given else ""


def make_parser() -> Parser:
    """The parser of the whole command line; ``command`` names the command."""
    top = Parser(
        prog="skin2urdf",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=Filled,
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"skin2urdf {version()}")
    top.set_defaults(parser=top)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, module in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=module.HELP,
            description=f"{module.HELP[0].upper()}{module.HELP[1:]}.",
            epilog=module.EPILOG,
            formatter_class=Filled,
            allow_abbrev=False,
        )
        command.add_argument("--quiet", action="store_true", help="print errors only")
        command.add_argument("--debug", action="store_true", help="show where an error comes from")
        module.declare(command)
        command.options = [
            option for action in command._actions for option in action.option_strings
        ]
    return top
