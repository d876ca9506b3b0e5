"""Arguments of the command line: what each command takes, and help that teaches."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from importlib import metadata

_DESCRIPTION = "From a ROS 2 bag of joint states and accelerometers to the URDF of the robot."
_EPILOG = """\
try it without a robot:
  skin2urdf simulate panda -o log.mcap --truth truth.urdf
  skin2urdf info log.mcap
  skin2urdf calibrate log.mcap -o robot.urdf
  skin2urdf compare robot.urdf truth.urdf

each command explains itself: skin2urdf calibrate --help

exit status: 0 all is well, 1 no trustworthy result (or the trees differ), 2 bad usage or an
unreadable input, 3 the URDF was written, but an SU or an encoder needs repair (calibrate)"""

_CALIBRATE = """\
example:
  skin2urdf calibrate log.mcap -o robot.urdf
  skin2urdf calibrate upright.mcap tilted.mcap -o robot.urdf --bias 5 --scale 0.003

A log is an MCAP file or a rosbag2 folder with sensor_msgs/JointState and an accelerometer topic
per skin unit (SU). The robot rests in some ten poses and moves its joints a little around each of
them (0.1 rad at 1 to 4 Hz). Several logs are of one robot whose base was tilted in between.
Writes robot.urdf, and robot.json with all that a URDF has no place for.
If it fails, look at the log with `skin2urdf info` and at the structure with `skin2urdf explore`."""

_COMPARE = """\
example:
  skin2urdf compare robot.urdf truth.urdf

SUs and joints are matched by name, limbs are aligned, links may have any names. Directions of SUs
and branches that the JSON beside the estimate (robot.json) calls not observable do not count.
Exits with 0 if the trees are equal, else with 1."""

_EXPLORE = """\
example:
  skin2urdf explore log.mcap
  skin2urdf explore log.mcap --plot structure.svg

Rows of the activity matrix are SUs, columns are DoFs. A figure is the evidence in multiples of
the threshold: 1 and more is active. Several logs are combined by OR."""

_INFO = """\
example:
  skin2urdf info log.mcap

Shows the topics and what they are used as, rates and gaps, where the robot rests and what it
excites around each pose, and what is missing for a calibration."""

_SIMULATE = """\
example:
  skin2urdf simulate panda -o log.mcap --truth truth.urdf
  skin2urdf simulate my_robot.urdf -o log.mcap --truth truth.urdf --poses 8 --grade bma150 --seed 3

ROBOT is one of the names below, a robot's file (.toml), or any URDF.
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose epilog may be worked out when help is asked for."""

    late_epilog: Callable[[], str] | None = None

    def format_help(self) -> str:
        if self.late_epilog is not None:
            self.epilog = self.late_epilog()
        return super().format_help()


def parser(robot_names: Callable[[], Sequence[str]]) -> argparse.ArgumentParser:
    """The parser of the whole command line; ``command`` names the command.

    Args:
        robot_names: tells the robots that can be simulated; called when help asks for them.
    """
    top = _Parser(
        prog="skin2urdf",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"skin2urdf {_version()}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _calibrate(_command(commands, "calibrate", "find the robot in one or several logs", _CALIBRATE))
    simulation = _command(commands, "simulate", "record a robot of known URDF", _SIMULATE)
    simulation.late_epilog = lambda: f"{_SIMULATE}robots: {', '.join(robot_names())}"
    _simulate(simulation)
    _compare(_command(commands, "compare", "compare an estimated URDF with the true one", _COMPARE))
    _explore(_command(commands, "explore", "show which SU moves with which joint", _EXPLORE))
    _info(_command(commands, "info", "show what a log holds and what it lacks", _INFO))
    return top


def _version() -> str:
    try:
        return metadata.version("skin2urdf")
    except metadata.PackageNotFoundError:
        from skin2urdf import __version__

        return __version__


def _command(
    commands: argparse._SubParsersAction[_Parser], name: str, what: str, epilog: str
) -> _Parser:
    """A command with the options that all of them have."""
    command = commands.add_parser(
        name,
        help=what,
        description=f"{what[0].upper()}{what[1:]}.",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("--quiet", action="store_true", help="print errors only")
    command.add_argument("--debug", action="store_true", help="show where an error comes from")
    return command


def _json(command: _Parser) -> None:
    command.add_argument("--json", action="store_true", help="print JSON in place of text")


def _number(
    command: argparse._ArgumentGroup,
    option: str,
    default: float | None,
    text: str,
    kind: type = float,
) -> None:
    command.add_argument(
        option, type=kind, default=default, metavar="N" if kind is int else "X", help=text
    )


def _calibrate(command: _Parser) -> None:
    command.add_argument("logs", nargs="+", metavar="LOG", help="MCAP file or rosbag2 folder")
    command.add_argument(
        "-o", "--output", required=True, metavar="URDF", help="file to write; JSON goes beside it"
    )
    _json(command)
    command.add_argument("--name", help="the robot's name in the URDF (that of the file)")
    command.add_argument("--no-visuals", action="store_true", help="leave out the simple shapes")
    command.add_argument(
        "--method",
        choices=("default", "paper"),
        default="default",
        help="paper: the estimator of Mittendorfer and Cheng, for comparison; it stops far above "
        "the noise (%(default)s)",
    )
    command.add_argument(
        "--refine",
        choices=("casadi", "none"),
        default="none",
        help="how to finish: a second least-squares over the whole tree, or not (%(default)s)",
    )
    _number(
        command.add_argument_group("structure"),
        "--threshold",
        0.05,
        "change of a static reading that counts as activity [g] (%(default)s)",
    )
    sensors = command.add_argument_group("sensors, as standard deviations over a production")
    sensors.add_argument(
        "--no-intrinsics", action="store_true", help="take bias, scale and cross-axis as perfect"
    )
    _number(sensors, "--bias", None, "bias of an axis [mg] (51)")
    _number(sensors, "--scale", None, "relative scale error of an axis (0.03)")
    _number(sensors, "--cross", None, "cross-axis sensitivity (0.01)")
    sensors.add_argument(
        "--bandwidth",
        type=_bandwidth,
        metavar="HZ[:ORDER]",
        help="cutoff of the sensors' low-pass, from the data sheet; order 1 or 2 (1). Else it is "
        "estimated, and taken to be 20 Hz or faster",
    )
    lengths = command.add_argument_group(
        "gravity, on which every length rests", "at most one of these"
    ).add_mutually_exclusive_group()
    lengths.add_argument(
        "--gravity",
        type=float,
        metavar="X",
        help="its size where the log was recorded [m/s^2] (9.81, not known to better than 0.02)",
    )
    lengths.add_argument(
        "--site",
        type=_site,
        metavar="LAT,HEIGHT",
        help="the same from latitude [deg] and height above the sea [m]",
    )
    command.add_argument(
        "--motion",
        choices=("all", "patterns"),
        default="all",
        help="estimate from all samples of the log, or from the patterns around poses alone "
        "(%(default)s)",
    )


def _bandwidth(text: str) -> tuple[float, int]:
    """Cutoff [Hz] and order of a low-pass."""
    cutoff, _, order = text.partition(":")
    found = float(cutoff), int(order or 1)
    if not (1.0 <= found[0] < 1e5 and found[1] in (1, 2)):
        raise argparse.ArgumentTypeError(f"{text!r} is no cutoff of 1 Hz or more, and order 1 or 2")
    return found


def _site(text: str) -> tuple[float, float]:
    """Latitude [deg] and height [m]."""
    latitude, _, height = text.partition(",")
    found = float(latitude), float(height or 0)
    if not (abs(found[0]) <= 90 and -500 <= found[1] <= 9000):
        raise argparse.ArgumentTypeError(f"{text!r} is no latitude [deg] and height [m]")
    return found


def _compare(command: _Parser) -> None:
    command.add_argument("estimate", metavar="ESTIMATE", help="URDF that was found")
    command.add_argument("truth", metavar="TRUTH", help="URDF that is right")
    _json(command)
    command.add_argument(
        "--align",
        choices=("limbs", "base"),
        default="limbs",
        help="one rigid transform per limb, which nothing connects but gravity, or one for the "
        "whole robot (%(default)s)",
    )
    group = command.add_argument_group("configurations")
    _number(group, "--configurations", 200, "how many, drawn at random (%(default)s)", int)
    _number(group, "--seed", 0, "what they are drawn from (%(default)s)", int)


def _explore(command: _Parser) -> None:
    command.add_argument("logs", nargs="+", metavar="LOG", help="MCAP file or rosbag2 folder")
    _json(command)
    command.add_argument("--plot", metavar="FILE", help="draw matrix and tree (.svg, .png, .pdf)")
    _number(
        command.add_argument_group("structure"),
        "--threshold",
        0.05,
        "change of a static reading that counts as activity [g] (%(default)s)",
    )


def _info(command: _Parser) -> None:
    command.add_argument("log", metavar="LOG", help="MCAP file or rosbag2 folder")
    _json(command)


def _simulate(command: _Parser) -> None:
    command.add_argument("robot", metavar="ROBOT", nargs="?", help="name, .toml or .urdf")
    command.add_argument("--list", action="store_true", help="list the robots by name and stop")
    command.add_argument("-o", "--output", metavar="LOG", help="log to write (.mcap)")
    command.add_argument("--truth", metavar="URDF", help="write the robot as it was simulated")

    motion = command.add_argument_group("motion")
    _number(motion, "--poses", 12, "random poses to rest and excite in (%(default)s)", int)
    _number(motion, "--seed", 0, "skin, poses and noise are drawn from it (%(default)s)", int)
    motion.add_argument(
        "--excite",
        choices=("one", "all", "none"),
        default="one",
        help="pattern on one DoF after the other, on all at once, or ordinary moves from pose to "
        "pose without any (%(default)s)",
    )
    _number(motion, "--minutes", None, "how long to move without patterns [min] (3)")
    motion.add_argument(
        "--structural",
        action=argparse.BooleanOptionalAction,
        help="begin with a move of each DoF alone (where there are patterns)",
    )
    motion.add_argument(
        "--tracking",
        choices=("none", "servo", "soft"),
        default="servo",
        help="how far joints lag, sag and couple (%(default)s)",
    )
    base = motion.add_mutually_exclusive_group()
    base.add_argument("--upright", action="store_true", help="base upright, not tilted")
    base.add_argument(
        "--base-rpy", nargs=3, type=float, metavar=("R", "P", "Y"), help="tilt of the base [deg]"
    )

    skin = command.add_argument_group("skin")
    _number(skin, "--sus-per-segment", None, "SUs on every moving segment (the robot's)", int)
    _number(skin, "--sus-on-base", None, "SUs on the base (the robot's)", int)
    skin.add_argument(
        "--grade",
        choices=("ideal", "mems", "bma150"),
        default="mems",
        help="accelerometers: perfect, good, or 10 bit and cheap (%(default)s)",
    )

    clock = command.add_argument_group("rates and clocks")
    _number(clock, "--imu-rate", 500.0, "readings of an SU per second (%(default)s)")
    _number(clock, "--joint-rate", 250.0, "joint states per second (%(default)s)")
    _number(clock, "--encoder-bits", 17, "bits per revolution; 0 for exact (%(default)s)", int)
    _number(clock, "--jitter", 0.1, "rms noise of the stamps [ms] (%(default)s)")
    _number(clock, "--lag", 0.0, "each SU's clock lags by up to this [ms] (%(default)s)")

    file = command.add_argument_group("file")
    file.add_argument(
        "--compression",
        choices=("zstd", "lz4", "none"),
        default="zstd",
        help="of the chunks (%(default)s)",
    )
    file.add_argument("--no-chunks", action="store_true", help="messages outside of chunks")
    file.add_argument("--no-index", action="store_true", help="leave out all indexes")
