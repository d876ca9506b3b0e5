"""``skin2urdf convert``: a log of any format to MCAP."""

from __future__ import annotations

import argparse
import math

from skin2urdf.cli.arguments import (
    Parser,
    check_log_target,
    number_or_nan,
    offer_json,
    print_json,
    refuse_to_overwrite,
    shown,
)
from skin2urdf.cli.terminal import progress_bar
from skin2urdf.geometry.units import JOINT_UNITS

HELP = "write what a calibration reads of a log as MCAP"
EPILOG = """\
example:
  skin2urdf convert old.bag log.mcap
  skin2urdf convert table.csv log.mcap
  skin2urdf convert log.mcap radians.mcap --joint-unit deg --joint-unit 'lift=mm'

LOG is an MCAP file, a rosbag2 database (.db3), a ROS 1 bag, a table (.csv, .parquet), any of the
first two compressed as a whole (.zstd), or a folder with these. All other commands read them too;
MCAP is read many times faster. Topics of joint states and accelerations are written, messages of
ROS 2 byte for byte (but for joints that are given a unit), those of ROS 1 as ROS 2 would have sent
them."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("log", metavar="LOG", help="log of any format")
    command.add_argument("output", metavar="OUT", help="log to write (.mcap)")
    offer_json(command)
    command.add_argument(
        "--joint-unit",
        action="append",
        default=[],
        type=_joint_unit,
        metavar="[JOINT=]UNIT",
        help="unit of positions in LOG, which are rad and m in OUT: "
        f"{', '.join(JOINT_UNITS)} (rev is a turn), or a number of rad or m, such as that of a "
        "count; of all joints, or of those whose name JOINT fits, a pattern as 'wrist*'. May be "
        "given several times; the last that fits counts",
    )
    command.add_argument(
        "--compression",
        choices=("zstd", "lz4", "none"),
        default="zstd",
        help="of the chunks (%(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    target = check_log_target(options.output)
    refuse_to_overwrite([options.log], target)
    from skin2urdf.recording.converting import convert
    from skin2urdf.report.notes import note_words

    with progress_bar(options.quiet) as bar:
        converted = convert(
            options.log,
            target,
            compression=options.compression,
            units=options.joint_unit,
            progress=lambda share: bar("converting", share),
        )
    if options.json:
        print_json(
            {
                "output": str(target),
                "topics": list(converted.topics),
                "messages": converted.messages,
                "notes": note_words(converted.notes),
            }
        )
    elif not options.quiet:
        for note in note_words(converted.notes):
            print(f"note: {note}")
        topics = "topic" if len(converted.topics) == 1 else "topics"
        print(
            f"wrote {converted.messages} messages on {len(converted.topics)} {topics} to "
            f"{shown(target)}"
        )
    return 0


def _joint_unit(text: str) -> tuple[str, float]:
    """A pattern of names and the size of its joints' unit [rad or m]."""
    pattern, equals, unit = text.rpartition("=")
    size = JOINT_UNITS[unit] if unit in JOINT_UNITS else number_or_nan(unit)
    if not (math.isfinite(size) and size != 0):
        known = ", ".join(JOINT_UNITS)
        raise argparse.ArgumentTypeError(f"{text!r}: a unit is {known} or a number other than 0")
    return pattern if equals else "*", size
