"""``skin2urdf plan``: the motion to record, as a trajectory for the robot's controller."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skin2urdf.cli.arguments import (
    Parser,
    add_number,
    offer_json,
    print_json,
    refuse_to_overwrite,
    shown,
)
from skin2urdf.cli.terminal import progress_bar
from skin2urdf.errors import UsageError
from skin2urdf.files import check_target, write_atomically

if TYPE_CHECKING:
    from skin2urdf.model.records import KinematicModel
    from skin2urdf.planning.collisions import CollisionChecker
    from skin2urdf.planning.earlier import Earlier, Shrinking
    from skin2urdf.planning.expected import Expected
    from skin2urdf.planning.limits import Given
    from skin2urdf.planning.records import Limits, Plan
    from skin2urdf.simulation.mechanism import Mechanism

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


@dataclass(frozen=True, eq=False)
class _Robot:
    """What is planned for.

    Attributes:
        limits: of its joints.
        model: its placements and SUs, None where only limits are known.
        checker: keeps its bodies apart; None where nothing is known of them.
        notes: what is to be said of that.
    """

    limits: Limits
    model: KinematicModel | None
    checker: CollisionChecker | None
    notes: tuple[str, ...]


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    targets = [check_target(p) for p in (options.output, options.csv) if p]
    if options.plot:
        from skin2urdf.report.canvas import check_picture

        targets.append(check_picture(options.plot))
    if len(set(targets)) < len(targets):
        raise UsageError("two outputs would be the same file", "give each a name of its own")
    if not (options.model or options.limits or options.after):
        raise UsageError(
            "a plan needs a model, limits, or an earlier calibration",
            "give --model robot.urdf, --limits joint_limits.yaml, or --after robot.json",
        )
    inputs = [p for p in (options.model, options.limits, options.after) if p]
    refuse_to_overwrite(inputs, *targets)
    from dataclasses import replace

    from skin2urdf.geometry.units import GRAVITY
    from skin2urdf.planning.earlier import read_earlier, shrinking
    from skin2urdf.planning.files import approach_time, as_csv, as_yaml
    from skin2urdf.planning.plan import make_plan
    from skin2urdf.planning.records import PlanSettings

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

        draw_plan(plan, options.plot)
    _tell(options, robot, plan, accuracy, shrinks, advice)
    if not (options.quiet or options.json):
        print(f"wrote {' and '.join(map(shown, targets))}")
    return 0


def _tell(
    options: argparse.Namespace,
    robot: _Robot,
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


def _robot(options: argparse.Namespace, earlier: Earlier | None) -> _Robot:
    """The robot as the options describe it."""
    import numpy as np

    from skin2urdf.planning.limits import (
        Given,
        acceleration_and_jerk,
        check_names,
        complete,
        merged,
        read_limits,
    )

    given = read_limits(options.limits) if options.limits else {}
    if not options.model:
        if earlier is None:
            limits = complete(tuple(given), given)
            return _Robot(limits, None, None, (_NO_MODEL,))
        names = earlier.model.tree.joint_names
        check_names(given, names, options.limits or "")
        known = {n: merged(given.get(n, Given()), earlier.limits[n]) for n in names}
        return _Robot(complete(names, known), _tilted(options, earlier.model), None, (_NO_SHAPES,))

    from skin2urdf.simulation import load_robot
    from skin2urdf.simulation.mechanism import load_mechanism, read_urdf

    spec = load_robot(options.model)
    r, p, y = np.deg2rad(options.base_rpy)
    mechanism = load_mechanism(spec, (float(r), float(p), float(y)))
    check_names(given, mechanism.joint_names, options.limits or "")
    beyond = acceleration_and_jerk(read_urdf(spec))
    bounded = [
        n for n, low in zip(mechanism.joint_names, mechanism.lower, strict=True) if low > -np.inf
    ]
    ranged = {name for name, limits in given.items() if limits.lower is not None}
    seen, ranges = _seen(spec.urdf, ranged.issuperset(bounded))
    limits_of = {}
    for d, name in enumerate(mechanism.joint_names):
        of_model = Given(
            prismatic=bool(mechanism.prismatic[d]),
            lower=_finite(mechanism.lower[d]),
            upper=_finite(mechanism.upper[d]),
            velocity=_finite(mechanism.speed_limit[d]),
        )
        for more in (beyond, seen, given):
            of_model = merged(more.get(name, Given()), of_model)
        limits_of[name] = of_model
    names = mechanism.joint_names
    model = _placements(options, mechanism)
    if earlier is not None:
        names = earlier.model.tree.joint_names
        check_names(dict.fromkeys(names, Given()), mechanism.joint_names, options.after)
        model = _tilted(options, earlier.model)
    limits = complete(names, limits_of)
    checker, notes = _checker(options, mechanism, limits)
    return _Robot(limits, model, checker, (*ranges, *notes))


def _seen(urdf: Path, ranged: bool) -> tuple[Mapping[str, Given], tuple[str, ...]]:
    """Ranges of a calibrated robot, whose URDF has limits that are nobody's, and what to say of it.

    Args:
        urdf: its file.
        ranged: whether a file of limits has the ranges of all joints.

    Raises:
        UsageError: neither its JSON nor a file of limits says how far its joints may go.
    """
    from skin2urdf.planning.earlier import seen_ranges
    from skin2urdf.urdf.beside import document_beside
    from skin2urdf.urdf.records import NO_LIMITS

    beside = document_beside(urdf)
    ranges = seen_ranges(beside) if beside else {}
    if ranges:
        return ranges, (
            f"joints keep to the ranges that the log of {urdf.name} saw: its own limits are "
            "placeholders, and --limits says otherwise",
        )
    if not ranged and NO_LIMITS in urdf.read_text(encoding="utf-8", errors="replace"):
        raise UsageError(
            f"the limits in {urdf} are placeholders, and its JSON is not beside it",
            "put the JSON there, or give the ranges of all joints: min_position and max_position "
            "in a file of limits (--limits)",
        )
    return {}, ()


_NO_MODEL = (
    "without a model, poses fill the joints' ranges, nothing is known of what the robot may touch, "
    "and no accuracy can be told"
)
_NO_SHAPES = "nothing is known of what the robot may touch: give --model as well"


def _finite(value: float) -> float | None:
    return float(value) if abs(value) < float("inf") else None


def _placements(options: argparse.Namespace, mechanism: Mechanism) -> KinematicModel:
    """Placements of the model, with the SUs that it has or that are assumed."""
    from fnmatch import fnmatchcase

    import numpy as np
    import pinocchio as pin

    from skin2urdf.planning.kinematics import kinematic_model, sus_on_links, usual_sus

    if options.sus:
        bodies = [f.name for f in mechanism.model.frames if f.type == pin.FrameType.BODY]
        links = [name for name in bodies if fnmatchcase(name, options.sus)]
        if not links:
            raise UsageError(
                f'no link of the model fits "{options.sus}"',
                f"its links are {', '.join(bodies[:8])}{' ..' if len(bodies) > 8 else ''}",
            )
        sus = sus_on_links(mechanism.model, links)
    else:
        sus = usual_sus(mechanism.model, [int(p) for p in mechanism.parent])
    R = pin.rpy.rpyToMatrix(*np.deg2rad(options.base_rpy))
    return kinematic_model(mechanism.model, list(mechanism.prismatic), R, sus)


def _tilted(options: argparse.Namespace, model: KinematicModel) -> KinematicModel:
    """A calibrated robot with its base tilted as the options say."""
    from dataclasses import replace

    import numpy as np
    import pinocchio as pin

    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*np.deg2rad(options.base_rpy))
    on_base = model.tree.parent < 0
    sus_on_base = model.tree.su_joint < 0
    return replace(
        model,
        T_parent_joint=np.where(
            on_base[:, None, None], T @ model.T_parent_joint, model.T_parent_joint
        ),
        T_joint_su=np.where(sus_on_base[:, None, None], T @ model.T_joint_su, model.T_joint_su),
    )


def _checker(
    options: argparse.Namespace, mechanism: Mechanism, limits: Limits
) -> tuple[CollisionChecker | None, tuple[str, ...]]:
    """What keeps the robot's bodies apart, and what is to be said of it."""
    from skin2urdf.planning.collisions import CollisionChecker
    from skin2urdf.simulation import load_robot
    from skin2urdf.simulation.mechanism import read_urdf

    if options.no_collisions:
        return None, ("collisions are not looked at (--no-collisions)",)
    spec = load_robot(options.model)
    xml = read_urdf(spec)
    if xml.find("link/collision") is None:
        return None, ("the URDF has no <collision> shapes: the robot may touch itself",)
    try:
        checker = CollisionChecker(
            xml, Path(spec.urdf), limits.joint_names, mechanism.locked,
            (limits.lower, limits.upper), options.floor,
        )  # fmt: skip
    except (ValueError, RuntimeError) as error:
        raise UsageError(
            f"the shapes of {spec.urdf} can not be read: {' '.join(str(error).split())}",
            "put its meshes where package:// leads from a folder above the URDF, or plan without "
            "them (--no-collisions)",
        ) from error
    return checker, ()


def _accuracy(
    plan: Plan, model: KinematicModel, grades: Sequence[str], tell: Callable[[float], None]
) -> list[Expected]:
    """The accuracy to expect with each grade of accelerometers."""
    from skin2urdf.geometry.units import GRAVITY
    from skin2urdf.planning.expected import Sensors, expected
    from skin2urdf.simulation import GRADES

    out = []
    for i, name in enumerate(grades):
        grade = GRADES[name]
        spread = 3**-0.5  # standard deviation of what is drawn evenly from -1 to 1
        sensors = Sensors(
            name,
            grade.noise_rms * GRAVITY,
            grade.step,
            spread * grade.bias * GRAVITY,
            spread * grade.scale,
            # Symmetric terms are means of two; what is left of these turns the sensor's frame.
            spread * grade.cross / 2**0.5,
        )
        tell(i / len(grades))
        out.append(expected(plan.trajectory, model, sensors))
    return out


def _advice(options: argparse.Namespace, robot: _Robot, lead: float) -> tuple[str, ...]:
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
