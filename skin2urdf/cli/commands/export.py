"""``skin2urdf export``: a calibrated URDF in the formats of controllers and simulators."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from skin2urdf.cli.arguments import Parser, present, refuse_to_overwrite, wrote
from skin2urdf.errors import UsageError
from skin2urdf.files import check_target, write_atomically
from skin2urdf.recording.naming import printable

FORMATS = ("xacro", "launch", "kinematics", "imu", "mjcf")
STYLES = ("ur", "franka", "flexiv")

HELP = "write a URDF as xacro, launch file, kinematics, IMU YAML or MJCF"
EPILOG = """\
example:
  skin2urdf export robot.urdf --to xacro -o skin.xacro
  skin2urdf export robot.urdf --to launch -o skin.launch.py
  skin2urdf export robot.urdf --to kinematics --style ur -o my_robot_calibration.yaml
  skin2urdf export robot.urdf --to imu -o imu.yaml
  skin2urdf export robot.urdf --to mjcf -o robot.xml

formats:
  xacro       macros to include in a description: the SUs of each link
  launch      ROS 2 launch file with a static transform per SU, for
              robots whose frames others publish
  kinematics  one placement per joint, as the descriptions of UR, Franka
              and Flexiv robots read it
  imu         noise, errors, delays and places of the SUs, as kalibr
              writes them; needs the JSON
  mjcf        MuJoCo model with a site and an accelerometer per SU

SUs of which the log does not tell where they sit are left out and named. Without -o the text is
printed."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("urdf", metavar="URDF", help="calibrated URDF, its JSON beside it")
    command.add_argument("--to", required=True, choices=FORMATS, help="what to write")
    command.add_argument("-o", "--output", metavar="FILE", help="file to write")
    command.add_argument(
        "--style",
        choices=STYLES,
        help="whose kinematics (by the names of the joints)",
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    if options.style and options.to != "kinematics":
        raise UsageError("--style is for kinematics alone", "add --to kinematics, or leave it out")
    if options.output:
        inputs = [options.urdf, Path(options.urdf).with_suffix(".json")]
        refuse_to_overwrite(inputs, options.output)
        check_target(options.output, "leave out -o, and the text is printed; or name a file")
    from skin2urdf.export.imu import to_imu
    from skin2urdf.export.kinematics import to_kinematics
    from skin2urdf.export.launch import to_launch
    from skin2urdf.export.mjcf import to_mjcf
    from skin2urdf.export.source import load_source
    from skin2urdf.export.xacro import to_xacro

    source = load_source(options.urdf)
    if options.to == "kinematics":
        text = to_kinematics(source, options.style)
    else:
        writers = {"xacro": to_xacro, "launch": to_launch, "imu": to_imu, "mjcf": to_mjcf}
        text = writers[options.to](source)
    if not options.output:
        print(text, end="")
        return 0
    target = check_target(options.output)
    replaced = present([target])
    write_atomically(target, text)
    if not options.quiet:
        left_out = [su.name for su in source.sus if su.position_open]
        for name in left_out if options.to in ("xacro", "launch", "mjcf") else ():
            words = f"note: {printable(name)} is left out: the log does not tell where it sits"
            print(words, file=sys.stderr)
        print(wrote([target], replaced))
    return 0
