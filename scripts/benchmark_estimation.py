"""Time the estimation from features: closed-form starts, refinement, and what it leaves open.

Features of a robot of example-robot-data with many SUs are made straight from Pinocchio's frame
Jacobians of its URDF (poses at random, DoFs excited one after the other by the paper's pattern,
errors drawn from the features' covariances), so that robots with a thousand SUs take no log.
`estimate` starts from nothing. Figures are processor time of one core, the median of some runs.

    python scripts/benchmark_estimation.py
    python scripts/benchmark_estimation.py --sus 60
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import TypeVar

import numpy as np
import pinocchio as pin
from threadpoolctl import threadpool_limits

from skin2urdf.arrays import F64
from skin2urdf.estimation.solve.estimate import Estimate, estimate
from skin2urdf.estimation.uncertainty.observability import observability
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.simulation.mechanism import Mechanism, load_mechanism
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.pattern import windowed_pattern
from skin2urdf.simulation.robots import RobotSpec, SkinLayout, load_robot
from skin2urdf.simulation.sensors import GRADES, draw_sensor
from skin2urdf.simulation.skins import PlacedSu, place_skin
from skin2urdf.structure.records import KinematicTree

T = TypeVar("T")
RATE = 20.0
"""Independent samples per second of signals low-passed at 10 Hz [Hz]."""
NOISE = 2e-3
"""Standard deviation of an independent sample of a MEMS accelerometer [m/s^2]."""


def skin_of(mechanism: Mechanism, count: int, rng: np.random.Generator) -> list[PlacedSu]:
    """Spread SUs over all segments, the reference segment included, as evenly as their number."""
    each = -(-count // (mechanism.n_joints + 1))
    layout = SkinLayout(sus_per_segment=each, sus_on_base=each)
    # Every segment keeps one; which of the rest go is random, as the names they are sorted by are.
    sus = sorted(place_skin(mechanism, layout, rng), key=lambda su: su.name)
    first = {su.joint: su for su in reversed(sus)}.values()
    others = [su for su in sus if su not in first]
    return [*first, *others][:count]


def regressor_products(n_dofs: int, motion: MotionSettings) -> F64:
    """(n, n) products of the regressors 1, dq, qdd of patterns on one DoF after the other."""
    t = np.arange(0.0, motion.pattern_time, 1 / RATE)
    step = 1e-3
    tones = [(motion.frequency, motion.angular_acceleration[0])]
    before, dq, after = (
        windowed_pattern(t + s, motion.pattern_time, motion.ramp, tones) for s in (-step, 0.0, step)
    )
    qdd = (after - 2 * dq + before) / step**2
    X = np.zeros((n_dofs, len(t), 1 + 2 * n_dofs))
    X[..., 0] = 1.0
    for d in range(n_dofs):
        X[d, :, 1 + d], X[d, :, 1 + n_dofs + d] = dq, qdd
    flat = X.reshape(-1, 1 + 2 * n_dofs)
    return np.asarray(flat.T @ flat)


def true_rows(mechanism: Mechanism, sus: list[PlacedSu], q: F64) -> F64:
    """(P, U, n, 3) what perfect sensors measure around poses q (P, D), from LOCAL Jacobians."""
    model = mechanism.model.copy()
    frames = [
        model.addFrame(
            pin.Frame(su.name, su.joint + 1, pin.SE3(su.T_joint_su), pin.FrameType.OP_FRAME)
        )
        for su in sus
    ]
    data = model.createData()
    D = mechanism.n_joints
    rows = np.zeros((len(q), len(sus), 1 + 2 * D, 3))
    for p, configuration in enumerate(mechanism.configuration(q)):
        pin.computeJointJacobians(model, data, configuration)
        pin.updateFramePlacements(model, data)
        for u, frame in enumerate(frames):
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            f0 = -data.oMf[frame].rotation.T @ mechanism.gravity_base
            rows[p, u, 0] = f0
            rows[p, u, 1 : 1 + D] = np.cross(f0, J[3:].T)
            rows[p, u, 1 + D :] = J[:3].T
    return rows


def synthesised(
    robot: RobotSpec, n_sus: int, n_poses: int, rng: np.random.Generator
) -> tuple[Features, KinematicTree]:
    """Features of a robot with that many SUs, and its tree."""
    mechanism = load_mechanism(robot, robot.base_rpy)
    sus = skin_of(mechanism, n_sus, rng)
    D = mechanism.n_joints
    reach = robot.motion.half_range
    low, high = np.maximum(mechanism.lower, -reach), np.minimum(mechanism.upper, reach)
    q = rng.uniform(low, high, (n_poses, D))
    sensors = [draw_sensor(GRADES["mems"], rng) for _ in sus]
    products = regressor_products(D, robot.motion)
    root = np.linalg.cholesky(products)
    # SUs of a real log differ in their noise, by row and by pose.
    level = rng.uniform(0.8, 1.25, (n_poses, n_sus))
    error = NOISE * rng.standard_normal((n_poses, n_sus, 1 + 2 * D, 3))
    rows = true_rows(mechanism, sus, q) @ np.array([s.matrix.T for s in sensors])
    rows[:, :, 0] += np.array([s.bias for s in sensors])
    rows += np.linalg.solve(root.T, error * level[..., None, None])
    features = Features(
        su_names=tuple(su.name for su in sus),
        dof_names=mechanism.joint_names,
        q=q,
        log=np.zeros(n_poses, dtype=np.int64),
        coefficients=rows,
        information=Information.of(products / level[..., None, None] ** 2),
        noise=np.full((n_poses, n_sus, 3), NOISE),
        latency=np.zeros(n_sus),
        latency_sd=np.zeros(n_sus),
        moves=StaticMoves(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, n_sus, 3))),
    )
    tree = KinematicTree(
        mechanism.joint_names,
        mechanism.parent,
        tuple("prismatic" if p else "revolute" for p in mechanism.prismatic),
        features.su_names,
        np.array([su.joint for su in sus]),
    )
    return features, tree


def timed(job: Callable[[], T], repeats: int) -> tuple[T, float]:
    """Result of a job and the median processor time of some runs [s]."""
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        result = job()
        seconds.append(time.process_time() - begin)
    return result, median(seconds)


def line(robot: RobotSpec, n_sus: int, options: argparse.Namespace) -> str:
    """One line of the table: times of a robot with that many SUs."""
    rng = np.random.default_rng(options.seed)
    features, tree = synthesised(robot, n_sus, options.poses, rng)
    found: Estimate
    with threadpool_limits(1):
        found, seconds = timed(lambda: estimate(features, tree), options.repeats)
        _, rest = timed(lambda: observability(found), options.repeats)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"{tree.n_joints:5} {n_sus:5} {seconds:10.2f} {rest:14.2f} "
        f"{1e3 * (seconds + rest) / n_sus:12.2f} {peak:10.0f} {found.cost_per_dof:12.3f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--robot", default="romeo", help="its own skin is left aside")
    parser.add_argument("--sus", nargs="+", type=int, default=[60, 250, 1000], help="SUs in total")
    parser.add_argument("--poses", type=int, default=12, help="poses of the log")
    parser.add_argument("--repeats", type=int, default=3, help="runs; the median counts")
    parser.add_argument("--seed", type=int, default=0, help="seed of poses, places and errors")
    options = parser.parse_args()
    robot = replace(load_robot(options.robot), skin=SkinLayout())
    print(f"{robot.name}, {options.poses} poses; processor time of one core")
    print(
        f"{'DoFs':>5} {'SUs':>5} {'estimate s':>10} {'observable s':>14} {'ms per SU':>12} "
        f"{'peak MB':>10} {'cost per dof':>12}"
    )
    for n_sus in sorted(options.sus):
        print(line(robot, n_sus, options), flush=True)


if __name__ == "__main__":
    main()
