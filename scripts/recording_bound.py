r"""The Cramer-Rao bound of recordings: what no calibration of their accelerometers can do better.

A recording is simulated, and the information that its readings have on the true robot is added up:
Pinocchio's dynamics of the true URDF along the true motion, differentiated numerically, with the
noise of the sensors alone. Encoders are taken as exact and front ends as known, so that the bound
is a bound for every estimator. Nothing of the estimation is used.

    python scripts/recording_bound.py --robots ur5 --excite none --seeds 261000 261001
    python scripts/recording_bound.py --robots ur5 --excite all --upright --gyro 0.1

Exit status: 0; 2 for bad usage.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from bench.trials import robot

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.simulation import SimulationSettings, Truth, simulate

RATE = 40.0
"""Instants per second at which information is added up; motions have 4 Hz and less [Hz]."""
SHAPES = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
STEP = 1e-6
"""Step of numerical derivatives [m or rad]."""
GAUGE = 1e-9
"""Eigenvalue of the information on coordinates of unit information, below which there is none."""
CONFIGURATIONS = 40


@dataclass(frozen=True)
class Known:
    """What is known of sensors before, as standard deviations.

    Attributes:
        bias: of each axis [m/s^2].
        scale: of each axis [1].
        cross: of symmetric cross-axis errors [1].
        lag: of a clock [s].
        gyro_bias: of a gyroscope's axes [rad/s].
        gyro_matrix: of its sensitivity [1].
    """

    bias: float = 5e-3 * GRAVITY / 3**0.5
    scale: float = 0.03
    cross: float = 0.01
    lag: float = 1.0
    gyro_bias: float = float(np.deg2rad(1.0)) / 3**0.5
    gyro_matrix: float = 0.03


SENSORS = {
    "like any, 3 % and 1 %": Known(),
    "as samples show them": Known(scale=8e-5, cross=6e-5, gyro_matrix=1e-3),
    "without scale and cross-axis errors": Known(scale=1e-7, cross=1e-7, gyro_matrix=1e-7),
}
"""What may be known of the sensors: what is before a log is read; ten times the noise that three
minutes leave of such errors, to which a calibration narrows it; and the simulated sensors."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    new = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    new.add_argument("--robots", nargs="+", default=["panda"])
    new.add_argument("--seeds", nargs="+", type=int, default=[0])
    new.add_argument("--excite", default="none", choices=["one", "all", "none", "series"])
    new.add_argument("--poses", type=int, default=8)
    new.add_argument("--minutes", type=float, default=3.0)
    new.add_argument("--upright", action="store_true")
    new.add_argument("--gyro", type=float, default=0.0, help="noise of gyroscopes [deg/s]; 0: none")
    new.add_argument(
        "--beyond-first", action="store_true", help="without SUs on first joints, as if not known"
    )
    new.add_argument("--held", type=int, default=1, help="times that each reading is sent")
    return new


class Robot:
    """The true robot: M joints' placements and U SUs, whose readings follow from Pinocchio."""

    def __init__(self, truth: Truth) -> None:
        self.model = pin.buildModelFromXML(truth.urdf)
        self.model.gravity.linear = truth.gravity_base
        self.names = [su.name for su in truth.sus]
        frames = [self.model.frames[self.model.getFrameId(name)] for name in self.names]
        self.joint = [int(frame.parentJoint) for frame in frames]
        self.placement = [frame.placement.copy() for frame in frames]
        of = [self.model.joints[self.model.getJointId(name)] for name in truth.joint_names]
        if self.model.nq != self.model.nv:
            raise ValueError("a joint of this robot turns without end")
        self.columns = np.argsort([each.idx_v for each in of])

    def moved(self, joint: int, coordinate: int, step: float) -> None:
        """Displace a joint in one coordinate of its own frame (tx, ty, tz, rx, ry, rz)."""
        twist = np.zeros(6)
        twist[coordinate] = step
        self.model.jointPlacements[joint] = self.model.jointPlacements[joint] * pin.exp6(twist)

    def states(self, motion: tuple[F64, F64, F64]) -> F64:
        """(N, J, 4, 3) v, w, a - g and alpha of all joints, in their own frames."""
        data = self.model.createData()
        out = np.empty((len(motion[0]), self.model.njoints, 4, 3))
        for n, (q, v, a) in enumerate(zip(*motion, strict=True)):
            pin.rnea(self.model, data, q, v, a)
            for j in range(self.model.njoints):
                out[n, j] = (
                    data.v[j].linear,
                    data.v[j].angular,
                    data.a_gf[j].linear,
                    data.a_gf[j].angular,
                )
        return out

    def read(self, states: F64, u: int, T: pin.SE3) -> F64:
        """(N, 6) specific force and turn rate that SU u feels at a placement on its joint."""
        v, w, a, alpha = np.moveaxis(states[:, self.joint[u]], 1, 0)
        r = T.translation
        felt = a + np.cross(w, v + np.cross(w, r)) + np.cross(alpha, r)
        return np.concatenate([felt @ T.rotation, w @ T.rotation], axis=1)


def information(truth: Truth, settings: SimulationSettings, held: int) -> F64:
    """Information of readings on 4 coordinates (tx, ty, rx, ry) of each joint, then 16 of each SU.

    Those are its placement, bias, scale and symmetric cross-axis errors, and its clock's lag; with
    a gyroscope its biases and sensitivity as well.

    Args:
        truth: of the recording.
        settings: of the recording.
        held: times that each reading is sent.
    """
    robot_ = Robot(truth)
    U, D = len(truth.sus), robot_.model.njoints - 1
    begin, end = truth.motion.time[[0, -1]] + 0.5
    time = np.arange(begin, end - 1.0, 1 / RATE)
    q, v, a = (x[:, robot_.columns] for x in truth.motion.at(time))
    motion = q, v, a
    plain = robot_.states(motion)
    moved: list[tuple[F64, F64]] = []
    for j in range(D):
        for coordinate in (0, 1, 3, 4):
            ways = []
            for step in (STEP, -STEP):
                robot_.moved(j + 1, coordinate, step)
                ways.append(robot_.states(motion))
                robot_.moved(j + 1, coordinate, -step)
            moved.append((ways[0], ways[1]))
    n_gyro = 12 if settings.gyro is not None else 0
    own = 16 + n_gyro
    size = 4 * D + own * U
    total = np.zeros((size, size))
    grade = settings.sensor_grade
    noise = np.hypot(grade.noise_rms * GRAVITY, grade.step / 12**0.5)
    gyro = settings.gyro_grade
    each = settings.imu_rate / held / RATE
    for u in range(U):
        T = robot_.placement[u]
        felt = robot_.read(plain, u, T)
        rows = np.zeros((len(time), 6, size))
        for c, (up, down) in enumerate(moved):
            rows[:, :, c] = (robot_.read(up, u, T) - robot_.read(down, u, T)) / (2 * STEP)
        first = 4 * D + own * u
        for c in range(6):
            twist = np.zeros(6)
            twist[c] = STEP
            up, down = T * pin.exp6(twist), T * pin.exp6(-twist)
            rows[:, :, first + c] = (robot_.read(plain, u, up) - robot_.read(plain, u, down)) / (
                2 * STEP
            )
        for c in range(3):
            rows[:, c, first + 6 + c] = 1.0
        for c, (i, k) in enumerate(SHAPES):
            rows[:, i, first + 9 + c] += felt[:, k]
            if i != k:
                rows[:, k, first + 9 + c] += felt[:, i]
        rows[:, :3, first + 15] = np.gradient(felt[:, :3], 1 / RATE, axis=0)
        if n_gyro:
            for i in range(3):
                rows[:, 3 + i, first + 16 + i] = 1.0
                for k in range(3):
                    rows[:, 3 + i, first + 19 + 3 * i + k] = felt[:, 3 + k]
        accelerometer = rows[:, :3].reshape(-1, size)
        total += each / noise**2 * accelerometer.T @ accelerometer
        if gyro is not None:
            turning = rows[:, 3:].reshape(-1, size)
            total += each / (gyro.noise_rms * gyro.unit) ** 2 * turning.T @ turning
    return total


def before(known: Known, n_joints: int, n_sus: int, own: int) -> F64:
    """Information on the same coordinates before anything is read, of which joints have none."""
    each = np.repeat([known.bias, known.scale, known.cross, known.lag], [3, 3, 3, 1])
    gyro = np.repeat([known.gyro_bias, known.gyro_matrix], [3, 9])[: own - 16]
    of_su = np.concatenate([np.zeros(6), each**-2.0, gyro**-2.0])
    return np.diag(np.concatenate([np.zeros(4 * n_joints), np.tile(of_su, n_sus)]))


def covariance(total: F64) -> F64:
    """The inverse of an information along the directions that have any."""
    scale = np.sqrt(np.maximum(np.diag(total), 1e-30))
    some = np.diag(total) > 1e-6
    scale = np.where(some, scale, 1.0)
    lam, V = np.linalg.eigh(total / scale[:, None] / scale)
    kept = lam > GAUGE
    root = V[:, kept] / np.sqrt(lam[kept]) / scale[:, None]
    return np.asarray(root @ root.T)


def errors(truth: Truth, C: F64, own: int, chosen: Sequence[int]) -> tuple[float, float, F64]:
    """Position [mm] and orientation [deg] of chosen SUs to expect at least.

    Root mean squares over the SUs and configurations, each after the best rigid transform of the
    whole robot; and (U,) orientation of each SU.
    """
    robot_ = Robot(truth)
    model, data = robot_.model, robot_.model.createData()
    D, rng = model.njoints - 1, np.random.default_rng(0)
    span = truth.motion.position[:, robot_.columns]
    low, high = span.min(axis=0), span.max(axis=0)
    rows, frames = [], []
    for q in rng.uniform(low, high, (CONFIGURATIONS, len(low))):
        pin.forwardKinematics(model, data, q)
        for u in chosen:
            T = data.oMi[robot_.joint[u]] * robot_.placement[u]
            G = np.zeros((6, len(C)))
            j = robot_.joint[u]
            while j > 0:
                # A joint's displacement moves what is beyond it about the frame before it turns.
                before = data.oMi[model.parents[j]] * model.jointPlacements[j]
                columns = 4 * (j - 1) + np.arange(4)
                G[:, columns] = (T.actInv(before)).toActionMatrix()[:, [0, 1, 3, 4]]
                j = model.parents[j]
            at = 4 * D + own * u
            G[:, at : at + 6] = np.eye(6)
            world = np.kron(np.eye(2), T.rotation)
            rows.append(world @ G)
            p = T.translation
            frames.append(np.block([[np.eye(3), -pin.skew(p)], [np.zeros((3, 3)), np.eye(3)]]))
    moves, A = np.array(rows), np.array(frames)
    lengths = moves[:, :3].reshape(-1, moves.shape[2]), A[:, :3].reshape(-1, 6)
    turns = moves[:, 3:].reshape(-1, moves.shape[2]), A[:, 3:, 3:].reshape(-1, 3)
    out, each = [], np.zeros(0)
    for (error, frame), unit in ((lengths, 1e3), (turns, float(np.rad2deg(1.0)))):
        left = error - frame @ np.linalg.lstsq(frame, error, rcond=None)[0]
        variance = np.einsum("ij,jk,ik->i", left, C, left)
        by_su = variance.reshape(CONFIGURATIONS, len(chosen), 3).sum(axis=2).mean(axis=0)
        each = unit * np.sqrt(by_su)
        out.append(float(np.sqrt((each**2).mean())))
    return out[0], out[1], each


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    patterns = options.excite in ("one", "all")
    print(f"{'':44}{'position':>10}{'orientation':>13}   of each SU, joint by joint")
    print(f"{'':44}{'mm':>10}{'deg':>13}   deg")
    for name in options.robots:
        for seed in options.seeds:
            settings = SimulationSettings(
                n_poses=options.poses, excite=options.excite, seed=seed, upright=options.upright,
                minutes=None if patterns else options.minutes, gyro=options.gyro or None,
            )  # fmt: skip
            truth = simulate(robot(name), settings).truth
            true = Robot(truth)
            first = 1 if options.beyond_first else 0
            carried = [u for u, j in enumerate(true.joint) if true.model.parents[j] >= first and j]
            carried.sort(key=lambda u: true.joint[u])
            own = 16 + 12 * (settings.gyro is not None)
            shown = information(truth, settings, options.held)
            D = (len(shown) - own * len(truth.sus)) // 4
            for words, known in SENSORS.items():
                C = covariance(shown + before(known, D, len(truth.sus), own))
                position, turned, each = errors(truth, C, own, carried)
                print(
                    f"{name} {seed} {words:36}{position:10.4f}{turned:13.5f}   "
                    + " ".join(f"{x:.5f}" for x in each),
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
