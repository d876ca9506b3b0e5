"""``skin2urdf plan``: the motion to record, as a trajectory for the robot's controller."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from skin2urdf.cli.arguments import (
    Parser,
    add_number,
    offer_json,
    print_json,
    refuse_to_overwrite,
    settings_of_options,
    shown,
)
from skin2urdf.cli.terminal import progress_bar
from skin2urdf.errors import UsageError
from skin2urdf.files import check_target, write_atomically

if TYPE_CHECKING:
    from skin2urdf.model.records import KinematicModel
    from skin2urdf.planning.earlier import Earlier, Shrinking
    from skin2urdf.planning.expected import Expected
    from skin2urdf.planning.records import Plan
    from skin2urdf.planning.robots import PlannedRobot

HELP = "make the motion to record"
EPILOG = """\
example:
  skin2urdf plan --model robot.urdf -o plan.yaml --minutes 3 --plot plan.png
  skin2urdf plan --limits joint_limits.yaml -o plan.yaml
  skin2urdf plan --after robot.json --model robot.urdf -o more.yaml --minutes 1
  skin2urdf simulate robot.urdf --plan plan.yaml -o log.mcap

Writes a trajectory_msgs/JointTrajectory: joints one at a time, then patterns around poses that
tell most, with transfers in between; within the limits of positions, speed, acceleration and jerk,
and without the robot touching itself where its URDF has <collision> shapes. What stands around it
is not known (--floor tells how far down it may reach): watch it, with a hand on the stop button.
--limits takes what MoveIt and ros2_control read, alone or over the limits of the model."""
_GRADES = ("mems", "bma150")
_ACTION = "/joint_trajectory_controller/follow_joint_trajectory"
_UPRIGHT_DEG = 10.0
"""Angle to the vertical up to which a first axis counts as vertical: from there on gravity turns so
little about it that directions come out more than five times worse."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument(
        "--model", metavar="ROBOT", help="the robot: a URDF, a robot's file (.toml), or a name"
    )
    command.add_argument(
        "--limits", metavar="FILE", help="limits of joints, as YAML or TOML (joint_limits:)"
    )
    command.add_argument(
        "--after", metavar="JSON", help="add what shrinks the uncertainties of a calibration most"
    )
    command.add_argument("-o", "--output", required=True, metavar="YAML", help="file to write")
    command.add_argument("--csv", metavar="FILE", help="write it as a table, too")
    command.add_argument("--plot", metavar="FILE", help="draw it (.svg, .png, .pdf)")
    offer_json(command)

    motion = command.add_argument_group("motion")
    add_number(motion, "--minutes", 3.0, "how long it takes [min] (%(default)s)")
    add_number(
        motion,
        "--share",
        1.0,
        "part of limits to use, but of positions (%(default)s)",
    )
    add_number(motion, "--range", 2.0, "full scale of the accelerometers [g] (%(default)s)")
    add_number(motion, "--seed", 0, "random candidates are drawn from it (%(default)s)", int)
    motion.add_argument(
        "--action",
        default=_ACTION,
        metavar="NAME",
        help="the controller's action, for the command that is printed (%(default)s)",
    )

    model = command.add_argument_group("the model")
    model.add_argument(
        "--sus",
        metavar="PATTERN",
        help="links of the model that are SUs, as a shell pattern (one on every segment)",
    )
    model.add_argument(
        "--base-rpy",
        nargs=3,
        type=float,
        default=(0.0, 0.0, 0.0),
        metavar=("R", "P", "Y"),
        help="tilt of the base [deg] (upright)",
    )
    add_number(model, "--floor", None, "height in the base frame that nothing goes below [m]")
    model.add_argument(
        "--srdf",
        metavar="FILE",
        help="links that may touch, as MoveIt has them (disable_collisions)",
    )
    model.add_argument(
        "--no-collisions", action="store_true", help="do not look at the shapes of the URDF"
    )
    model.add_argument(
        "--grade",
        choices=_GRADES,
        action="append",
        help="accelerometers whose accuracy is told (all of these)",
    )
    model.add_argument(
        "--no-accuracy", action="store_true", help="do not work out the accuracy to expect"
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    targets = [check_target(p) for p in (options.output, options.csv) if p]
    if options.plot:
        from skin2urdf.report.canvas import check_picture

        targets.append(check_picture(options.plot))
    if not (options.model or options.limits or options.after):
        raise UsageError(
            "a plan needs a model, limits, or an earlier calibration",
            "give --model robot.urdf, --limits joint_limits.yaml, or --after robot.json",
        )
    inputs = [p for p in (options.model, options.limits, options.after, options.srdf) if p]
    refuse_to_overwrite(inputs, *targets)
    from dataclasses import replace

    from skin2urdf.geometry.units import GRAVITY
    from skin2urdf.planning.earlier import read_earlier, shrinking
    from skin2urdf.planning.files import approach_time, as_csv, as_yaml
    from skin2urdf.planning.plan import make_plan
    from skin2urdf.planning.records import PlanSettings

    with settings_of_options(full_scale="range"):
        settings = PlanSettings(
            minutes=options.minutes,
            seed=options.seed,
            share=options.share,
            full_scale=options.range * GRAVITY,
        )
    with progress_bar(options.quiet) as bar:
        bar("loading", 0.0)
        earlier = read_earlier(options.after) if options.after else None
        robot = _robot(options, earlier)
        plan = make_plan(
            robot.limits, settings, robot.model, robot.checker, earlier,
            lambda share: bar("planning", share),
        )  # fmt: skip
        plan = replace(plan, notes=(*robot.notes, *plan.notes))
        accuracy: list[Expected] = []
        if robot.model is not None and not options.no_accuracy:
            grades = options.grade or _GRADES
            accuracy = _accuracy(plan, robot.model, grades, lambda share: bar("accuracy", share))
    lead = approach_time(plan.trajectory.position[0], robot.limits)
    shifted = replace(plan.trajectory, time=plan.trajectory.time + lead)
    shrinks = shrinking(earlier, accuracy[0]) if earlier and accuracy else ()
    advice = _advice(options, robot, lead)
    comment = f"skin2urdf plan: {len(plan.poses)} poses, {plan.trajectory.duration:.0f} s"
    write_atomically(options.output, as_yaml(shifted, comment))
    if options.csv:
        write_atomically(options.csv, as_csv(shifted))
    if options.plot:
        from skin2urdf.report.plan_figure import draw_plan

        with progress_bar(options.quiet) as bar:
            bar("drawing", 0.0)
            draw_plan(plan, options.plot)
    _tell(options, robot, plan, accuracy, shrinks, advice)
    if not (options.quiet or options.json):
        print(f"wrote {' and '.join(map(shown, targets))}")
    return 0


def _tell(
    options: argparse.Namespace,
    robot: PlannedRobot,
    plan: Plan,
    accuracy: Sequence[Expected],
    shrinks: Sequence[Shrinking],
    advice: Sequence[str],
) -> None:
    """Print what there is to say."""
    from skin2urdf.report.plan import as_document, as_text

    names = robot.model.tree.su_names if robot.model else ()
    if options.json:
        print_json(as_document(plan, names, accuracy, shrinks, advice))
    elif not options.quiet:
        print(as_text(plan, names, accuracy, shrinks, advice), end="")


def _robot(options: argparse.Namespace, earlier: Earlier | None) -> PlannedRobot:
    """The robot as the options describe it."""
    from math import radians

    from skin2urdf.planning.limits import read_limits
    from skin2urdf.planning.robots import (
        Told,
        robot_found_before,
        robot_of_limits,
        robot_of_model,
    )
    from skin2urdf.planning.srdf import links_that_may_touch

    r, p, y = map(radians, options.base_rpy)
    told = Told(
        limits=read_limits(options.limits) if options.limits else {},
        source=options.limits or "",
        base_rpy=(r, p, y),
        sus=options.sus,
        floor=options.floor,
        collisions=not options.no_collisions,
        may_touch=links_that_may_touch(options.srdf) if options.srdf else frozenset(),
    )
    if options.model:
        from skin2urdf.simulation import load_robot
        from skin2urdf.simulation.mechanism import load_mechanism, read_urdf

        spec = load_robot(options.model)
        joints = load_mechanism(spec, told.base_rpy)
        return robot_of_model(spec.urdf, read_urdf(spec), joints, told, earlier)
    return robot_of_limits(told) if earlier is None else robot_found_before(earlier, told)


def _accuracy(
    plan: Plan, model: KinematicModel, grades: Sequence[str], tell: Callable[[float], None]
) -> list[Expected]:
    """The accuracy to expect with each grade of accelerometers."""
    from skin2urdf.planning.expected import expected, sensors_of
    from skin2urdf.simulation import GRADES

    out = []
    for i, name in enumerate(grades):

        def part(share: float, i: int = i) -> None:
            tell((i + share) / len(grades))

        out.append(expected(plan.trajectory, model, sensors_of(GRADES[name]), tell=part))
    return out


def _advice(options: argparse.Namespace, robot: PlannedRobot, lead: float) -> tuple[str, ...]:
    """What to do with the plan, and with the base."""
    import numpy as np

    lines = []
    if robot.model is not None:
        tree = robot.model.tree
        first = [j for j in range(tree.n_joints) if tree.parent[j] < 0 and not tree.prismatic[j]]
        upright = [
            tree.joint_names[j]
            for j in first
            if abs(robot.model.T_parent_joint[j, 2, 2]) > np.cos(np.deg2rad(_UPRIGHT_DEG))
        ]
        if upright:
            lines.append(
                f"tilt the base: the axis of {', '.join(upright)} is vertical, and gravity does "
                "not show in which direction lies what only it moves. Record the plan once more "
                "with the base tilted by 20 degrees or more, and calibrate from both logs."
            )
        else:
            lines.append("the base stands well: no first axis is vertical")
    name = options.output
    lines += [
        f"the controller takes {lead:.0f} s to the first point, from wherever the robot is, and "
        "knows nothing of what is in between. Record, and send it (ROS 2 Jazzy and later):",
        "  { echo trajectory:; sed 's/^/  /' " + _quoted(name) + "; } | ros2 action send_goal "
        f"{options.action} control_msgs/action/FollowJointTrajectory --stdin",
    ]
    return tuple(lines)


def _quoted(path: str) -> str:
    import shlex

    return shlex.quote(path)
