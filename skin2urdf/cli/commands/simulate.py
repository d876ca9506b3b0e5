"""``skin2urdf simulate``: a robot to a log and its truth."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from skin2urdf.cli.arguments import (
    Parser,
    add_number,
    check_log_target,
    present,
    refuse_to_overwrite,
    settings_of_options,
    wrote,
)
from skin2urdf.cli.terminal import progress_bar
from skin2urdf.errors import UsageError
from skin2urdf.files import check_target, write_atomically

if TYPE_CHECKING:
    from skin2urdf.simulation import SimulationSettings

_MOTION = {"n_poses": "poses", "excite": "excite", "minutes": "minutes", "structural": "structural"}
"""Fields of settings and names of options that say how the robot moves, in place of a plan."""

HELP = "record a robot of known URDF"
EPILOG = """\
example:
  skin2urdf simulate panda -o log.mcap --truth truth.urdf
  skin2urdf simulate my_robot.urdf -o log.mcap --truth truth.urdf --poses 8 --grade bma150 --seed 3

ROBOT is one of the names below, a robot's file (.toml), or any URDF."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("robot", metavar="ROBOT", nargs="?", help="name, .toml or .urdf")
    command.add_argument("--list", action="store_true", help="list the robots by name and stop")
    command.add_argument("-o", "--output", metavar="LOG", help="log to write (.mcap)")
    command.add_argument("--truth", metavar="URDF", help="write the robot as it was simulated")

    motion = command.add_argument_group("motion")
    add_number(motion, "--poses", None, "random poses to rest and excite in (12)", int)
    add_number(motion, "--seed", 0, "skin, poses and noise are drawn from it (%(default)s)", int)
    motion.add_argument(
        "--excite",
        choices=("one", "all", "none", "series"),
        help="pattern on one DoF after the other, on all at once, ordinary moves from pose to "
        "pose without any, or a Fourier series of each DoF without a rest (one)",
    )
    motion.add_argument(
        "--plan",
        metavar="YAML",
        help="follow a trajectory that plan wrote, in place of random poses",
    )
    add_number(motion, "--minutes", None, "how long to move without patterns [min] (3)")
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
    add_number(skin, "--sus-per-segment", None, "SUs on every moving segment (the robot's)", int)
    add_number(skin, "--sus-on-base", None, "SUs on the base (the robot's)", int)
    skin.add_argument(
        "--grade",
        choices=("ideal", "mems", "bma150"),
        default="mems",
        help="accelerometers: perfect, good, or 10 bit and cheap (%(default)s)",
    )

    skin.add_argument(
        "--gyro",
        type=_gyro,
        metavar="GRADE",
        help="gyroscopes: ideal, mems (noise of 0.1 deg/s, bias of 1 deg/s), cheap (0.4 and 5 "
        "deg/s, scale 3 %%, cross-axis 2 %%), or the noise of mems ones [deg/s] (none)",
    )

    clock = command.add_argument_group("rates and clocks")
    add_number(clock, "--imu-rate", 500.0, "readings of an SU per second (%(default)s)")
    add_number(clock, "--joint-rate", 250.0, "joint states per second (%(default)s)")
    add_number(clock, "--encoder-bits", 17, "bits per revolution; 0 for exact (%(default)s)", int)
    add_number(clock, "--jitter", 0.1, "rms noise of the stamps [ms] (%(default)s)")
    add_number(clock, "--lag", 0.0, "each SU's clock lags by up to this [ms] (%(default)s)")

    file = command.add_argument_group("file")
    file.add_argument(
        "--compression",
        choices=("zstd", "lz4", "none"),
        default="zstd",
        help="of the chunks (%(default)s)",
    )
    file.add_argument("--no-chunks", action="store_true", help="messages outside of chunks")
    file.add_argument("--no-index", action="store_true", help="leave out all indexes")
    command.late_epilog = _with_robots


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    from skin2urdf.recording.writing import write
    from skin2urdf.report.tables import count
    from skin2urdf.simulation import load_robot, robot_names, simulate

    if options.list:
        robots = [load_robot(name) for name in robot_names()]
        width = max(len(robot.name) for robot in robots)
        print("\n".join(f"{robot.name:{width}}  {robot.description}" for robot in robots))
        return 0
    if not (options.robot and options.output):
        raise UsageError(
            "a simulation needs a robot and a log to write",
            "skin2urdf simulate panda -o log.mcap (names: skin2urdf simulate --list)",
        )
    targets = [check_log_target(options.output)]
    targets += [check_target(options.truth)] if options.truth else []
    settings = simulation_settings(options)
    robot = load_robot(options.robot)
    inputs = [robot.urdf, options.robot, *([options.plan] if options.plan else [])]
    refuse_to_overwrite(inputs, *targets)
    replaced = present(targets)
    with progress_bar(options.quiet) as bar:
        bar("moving the robot", 0.0)
        simulation = simulate(robot, settings, lambda share: bar("moving the robot", share))
        bar("moving the robot", 1.0)
        bar("writing the log", 0.0)
        write(
            simulation.recording,
            targets[0],
            compression=options.compression,
            chunked=not options.no_chunks,
            indexed=not options.no_index,
            joint_order=simulation.joint_order,
            tell=lambda share: bar("writing the log", share),
        )
    if options.truth:
        write_atomically(options.truth, simulation.truth.urdf)
    if not options.quiet:
        recording = simulation.recording
        messages = sum(len(su.time) for su in recording.sus) + len(recording.joints[0].time)
        held = (len(recording.joints), "joint"), (len(recording.sus), "SU")
        print(
            f"{robot.name}: {', '.join(count(n, what) for n, what in held)}, "
            f"{count(len(simulation.truth.poses), 'pose')} in {recording.duration:.0f} s, "
            f"{messages} messages"
        )
        print(wrote(targets, replaced))
    return 0


def simulation_settings(options: argparse.Namespace) -> SimulationSettings:
    """Settings as the options say."""
    from math import radians

    from skin2urdf.planning.files import read_trajectory
    from skin2urdf.simulation import SimulationSettings

    rpy = options.base_rpy
    motion = {
        field: getattr(options, name)
        for field, name in _MOTION.items()
        if getattr(options, name) is not None
    }
    if options.plan and motion:
        given = ", ".join(f"--{_MOTION[field]}" for field in motion)
        raise UsageError(
            f"{given}: all of the motion is that of --plan", "leave them out", "--plan"
        )
    with settings_of_options(**_MOTION):
        return SimulationSettings(
            **motion,
            upright=options.upright,
            base_rpy=None if rpy is None else (radians(rpy[0]), radians(rpy[1]), radians(rpy[2])),
            seed=options.seed,
            grade=options.grade,
            gyro=options.gyro,
            tracking=options.tracking,
            imu_rate=options.imu_rate,
            joint_rate=options.joint_rate,
            encoder_bits=options.encoder_bits,
            jitter=options.jitter * 1e-3,
            lag=options.lag * 1e-3,
            sus_per_segment=options.sus_per_segment,
            sus_on_base=options.sus_on_base,
            plan=read_trajectory(options.plan) if options.plan else None,
        )


def _gyro(text: str) -> str | float:
    """Grade of gyroscopes by name, or their noise [deg/s]."""
    try:
        return float(text)
    except ValueError:
        return text


def _with_robots() -> str:
    """The epilog with the robots that come along, which only help needs to know."""
    from skin2urdf.simulation import robot_names

    return f"{EPILOG}\nrobots: {', '.join(robot_names())}"
