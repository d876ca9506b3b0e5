"""A controller on the calibrated URDF moves the true robot: what a calibration is good for.

usage: python scripts/control_demo.py [--robot panda] [--grade bma150] [--plot FILE.png]

A robot is simulated with cheap accelerometers and calibrated without the truth. Differential
inverse kinematics (pink) then computes joint motion from the calibrated URDF alone, and the URDF
that the recording was made from says where the robot really goes:

- targets: frames of SUs are sent to poses, one after the other;
- retreat: an SU is touched, and moves away from the contact along its normal.

Printed are the true errors against what a skin's user needs; exit status 0 where they are met. Base
frames are aligned first, as `skin2urdf compare` does: a log can not tell the base's yaw and origin.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask, PostureTask

from skin2urdf import calibrate, compare, save
from skin2urdf.arrays import F64
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.urdf.beside import untold_beside
from skin2urdf.urdf.kinematics import kinematics
from skin2urdf.urdf.loading import Robot, configuration
from skin2urdf.urdf.loading import load_robot as load_urdf

POSITION, ORIENTATION, DIRECTION = 0.3e-3, np.deg2rad(0.8), np.deg2rad(0.6)
"""True rms errors of SUs that are small enough: [m], [rad], of a retreat's direction [rad]."""
SOLVER = "daqp"
DT = 0.02
"""Period of the controller [s]."""
STEPS = 500
"""Periods that a motion may take."""
ARRIVED = 1e-6
"""What the controller itself may leave of a target, by its own model [m, rad]."""
STRIDE = 0.6
"""Largest move of a joint from target to target [rad or m]."""
RETREAT, WAYPOINTS = 0.05, 10
"""Length of a retreat [m], and into how many straight pieces it is cut."""
DEXTEROUS = 5
"""Joints before an SU that can retreat in any direction almost anywhere."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """True errors of what the controller did.

    Attributes:
        sus: SU of each of N motions.
        position: (N,) of SUs that were sent to targets [m]; empty for retreats.
        orientation: (N,) likewise [rad].
        direction: (N,) angle between a retreat and the true normal [rad]; empty for targets.
        given_up: motions that the controller could not do by its own model, and that do not count.
    """

    sus: tuple[str, ...]
    position: F64
    orientation: F64
    direction: F64
    given_up: int


class Bench:
    """A controller that knows the estimate, and a plant that is the truth."""

    def __init__(self, estimate: Path, truth: Path) -> None:
        self.estimate, self.plant = load_urdf(estimate), load_urdf(truth)
        compared = compare(estimate, truth, n_configurations=50, rng=np.random.default_rng(0))
        self._T_truth_estimate = {
            su: alignment.T_truth_estimate for alignment in compared.alignments
            for su in alignment.sus
        }  # fmt: skip
        untold = untold_beside(estimate)
        free = (untold.unobservable if untold else None) or {}
        self.sus = [
            su for su in self._T_truth_estimate
            if self.estimate.chain(su) and not len(free.get(su, ()))
        ]  # fmt: skip
        self.ranges = dict(untold.ranges) if untold else dict(self.estimate.limits)

    def true_pose(self, su: str, q: F64) -> F64:
        """(4, 4) where an SU really is at a configuration of the estimate, in its base frame."""
        names = list(self.estimate.joint_types)
        positions = positions_of(self.estimate, q)[None]
        (T,), _ = kinematics(self.plant, [su], names, positions)
        return np.asarray(np.linalg.solve(self._T_truth_estimate[su], T[0]))

    def random_configuration(self, rng: np.random.Generator) -> F64:
        """(nq,) anywhere in the ranges that the log saw."""
        return self._at({n: rng.uniform(*self.ranges[n]) for n in self.estimate.joint_types})

    def configuration_near(self, q: F64, rng: np.random.Generator) -> F64:
        """(nq,) a stride away."""
        at = dict(zip(self.estimate.joint_types, positions_of(self.estimate, q), strict=True))
        near = {n: at[n] + rng.uniform(-STRIDE, STRIDE) for n in at}
        return self._at({n: float(np.clip(x, *self.ranges[n])) for n, x in near.items()})

    def _at(self, positions: dict[str, float]) -> F64:
        return configuration(self.estimate, positions)

    def go(self, q: F64, su: str, T_base_su: F64, *, turn: bool) -> tuple[F64, float]:
        """Let the controller bring an SU to a pose, or only its origin there.

        Args:
            q: (nq,) where to begin.
            su: the SU.
            T_base_su: (4, 4) target in the estimate's base frame.
            turn: whether its orientation counts.

        Returns:
            Where the controller ends, and what it leaves by its own model [m, rad].
        """
        task = FrameTask(su, position_cost=1.0, orientation_cost=0.3 if turn else 0.0)
        task.set_target(pin.SE3(T_base_su))
        posture = PostureTask(cost=1e-6)
        posture.set_target(q)
        model = self.estimate.model
        state = pink.Configuration(model, model.createData(), q)
        rows = slice(0, 6 if turn else 3)
        for _ in range(STEPS):
            left = float(np.abs(task.compute_error(state)[rows]).max())
            if left < ARRIVED:
                break
            velocity = pink.solve_ik(
                state, [task, posture], DT, solver=SOLVER, damping=1e-10, safety_break=False
            )
            state.integrate_inplace(velocity, DT)
        return np.array(state.q), left


def targets(bench: Bench, count: int, rng: np.random.Generator) -> Outcome:
    """Send SUs to poses, from one to the next.

    Args:
        bench: controller and plant.
        count: number of targets.
        rng: source of SUs and targets.
    """
    sus: list[str] = []
    errors: list[tuple[float, float]] = []
    given_up = 0
    q = bench.random_configuration(rng)
    while len(errors) < count and given_up < 2 * count:
        su = bench.sus[rng.integers(len(bench.sus))]
        goal = bench.configuration_near(q, rng)
        names = list(bench.estimate.joint_types)
        (T,), _ = kinematics(bench.estimate, [su], names, positions_of(bench.estimate, goal)[None])
        q, left = bench.go(q, su, T[0], turn=True)
        if left > 1e-5:
            given_up += 1
            q = bench.random_configuration(rng)
            continue
        real = bench.true_pose(su, q)
        sus.append(su)
        errors.append(
            (
                float(np.linalg.norm(real[:3, 3] - T[0, :3, 3])),
                angle_of(T[0, :3, :3].T @ real[:3, :3]),
            )
        )
    position, orientation = np.reshape(errors, (-1, 2)).T
    return Outcome(tuple(sus), position, orientation, np.zeros(0), given_up)


def retreats(bench: Bench, count: int, rng: np.random.Generator) -> Outcome:
    """Touch SUs that enough joints move, and let them retreat along their normal, which is -z.

    Args:
        bench: controller and plant.
        count: number of contacts.
        rng: source of SUs and poses.
    """
    able = [su for su in bench.sus if len(bench.estimate.chain(su)) >= DEXTEROUS]
    sus: list[str] = []
    errors: list[float] = []
    given_up = 0
    while able and len(errors) < count and given_up < 4 * count:
        su = able[rng.integers(len(able))]
        q = bench.random_configuration(rng)
        names = list(bench.estimate.joint_types)
        (T,), _ = kinematics(bench.estimate, [su], names, positions_of(bench.estimate, q)[None])
        begin, left = bench.true_pose(su, q), 0.0
        for piece in range(1, WAYPOINTS + 1):
            target = T[0].copy()
            target[:3, 3] -= T[0, :3, 2] * RETREAT * piece / WAYPOINTS
            q, left = bench.go(q, su, target, turn=False)
            if left > 1e-5:
                break
        if left > 1e-5:
            given_up += 1
            continue
        way = bench.true_pose(su, q)[:3, 3] - begin[:3, 3]
        sus.append(su)
        errors.append(angle_between(way, -begin[:3, 2]))
    return Outcome(tuple(sus), np.zeros(0), np.zeros(0), np.array(errors), given_up)


def positions_of(robot: Robot, q: F64) -> F64:
    """(D,) joint positions of a configuration (nq,), joints without end by their angle."""
    joints = [robot.model.joints[robot.model.getJointId(name)] for name in robot.joint_types]
    return np.array(
        [q[j.idx_q] if j.nq == 1 else np.arctan2(q[j.idx_q + 1], q[j.idx_q]) for j in joints]
    )


def angle_of(R: F64) -> float:
    """Angle of a rotation (3, 3) [rad]."""
    return float(np.linalg.norm(pin.log3(R)))


def angle_between(a: F64, b: F64) -> float:
    """Angle between two vectors (3,) [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def rms(values: F64) -> float:
    """Root mean square; NaN of nothing, which meets no requirement."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def report(reached: Outcome, retreated: Outcome) -> tuple[bool, str]:
    """Whether the requirements are met, and a table that says so.

    Args:
        reached: of targets.
        retreated: of retreats.
    """
    rows = (
        ("SU at its target, position", rms(reached.position), POSITION, 1e3, "mm"),
        ("SU at its target, orientation", rms(reached.orientation), ORIENTATION, 57.29578, "deg"),
        ("retreat from a contact, direction", rms(retreated.direction), DIRECTION, 57.29578, "deg"),
    )
    lines = [f"{'true error, rms':36}{'found':>10}{'needed':>10}"]
    met = True
    for name, found, needed, scale, unit in rows:
        good = found <= needed
        met &= good
        mark = "" if good else "   <- too much"
        lines.append(f"{name:36}{found * scale:>10.3f}{needed * scale:>10.3f} {unit}{mark}")
    lines.append(
        f"{len(reached.sus)} targets ({reached.given_up} given up by the controller), "
        f"{len(retreated.sus)} retreats of {RETREAT * 1e3:.0f} mm ({retreated.given_up} given up)"
    )
    return met, "\n".join(lines)


def draw(reached: Outcome, retreated: Outcome, title: str, path: Path) -> None:
    """Draw every error with what is needed."""
    from matplotlib.figure import Figure

    panels = (
        ("position at target [mm]", reached.position * 1e3, POSITION * 1e3, reached.sus),
        ("orientation at target [deg]", np.rad2deg(reached.orientation),
         float(np.rad2deg(ORIENTATION)), reached.sus),
        ("direction of retreat [deg]", np.rad2deg(retreated.direction),
         float(np.rad2deg(DIRECTION)), retreated.sus),
    )  # fmt: skip
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = figure.subplots(1, 3)
    names = sorted({*reached.sus, *retreated.sus})
    colours = {name: f"C{n}" for n, name in enumerate(names)}
    for axis, (label, values, needed, sus) in zip(axes, panels, strict=True):
        for name in names:
            at = [n for n, su in enumerate(sus) if su == name]
            if at:
                axis.plot(at, values[at], "o", color=colours[name], markersize=4, label=name)
        axis.axhline(needed, color="#c0392b", linewidth=1.2, label="needed, rms")
        axis.axhline(
            rms(values), color="#1f2933", linewidth=1.2, linestyle="--", label="found, rms"
        )
        axis.set(title=label, xlabel="motion")
        axis.set_ylim(0, 1.15 * max(needed, float(np.max(values, initial=0.0))))
        axis.grid(color="#e4e7eb")
    lines = [line for axis in axes for line in axis.get_lines()]
    handles = {str(line.get_label()): line for line in lines}
    handles = {label: handles[label] for label in sorted(handles)}
    figure.legend(handles.values(), handles.keys(), loc="outside right center", fontsize=8)
    figure.savefig(path, dpi=130)


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate, calibrate, control, and hold the errors against what is needed.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="panda", help="robot to simulate (%(default)s)")
    parser.add_argument("--grade", default="bma150", choices=("ideal", "mems", "bma150"))
    parser.add_argument("--poses", type=int, default=12, help="poses of the log (%(default)s)")
    parser.add_argument("--count", type=int, default=50, help="targets, retreats (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (%(default)s)")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="draw all errors")
    options = parser.parse_args(arguments)
    settings = SimulationSettings(n_poses=options.poses, seed=options.seed, grade=options.grade)
    simulation = simulate(load_robot(options.robot), settings)
    calibration = calibrate(simulation.recording)
    with tempfile.TemporaryDirectory() as folder:
        truth = Path(folder) / "truth.urdf"
        truth.write_text(simulation.truth.urdf, encoding="utf-8")
        urdf, _ = save(calibration, Path(folder) / "robot.urdf")
        bench = Bench(urdf, truth)
    rng = np.random.default_rng(options.seed)
    reached = targets(bench, options.count, rng)
    retreated = retreats(bench, options.count, rng)
    met, text = report(reached, retreated)
    print(f"{options.robot}, {options.grade}: {calibration.quality}\n{text}")
    if options.plot:
        title = f"{options.robot} with {options.grade}: pink on the calibrated URDF, truth as plant"
        draw(reached, retreated, title, options.plot)
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())
