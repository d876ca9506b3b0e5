"""What patterns around poses tell of SU placements and joint placements: information, and choice.

The derivatives are those of the fit of all samples (its :meth:`MotionProblem.spans`), taken at a
few instants of the pattern in every candidate pose. Information of independent poses adds up, so
that poses are chosen without predicting anything anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, State
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.spans import spans_of
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.planning.patterns import Tones, waveform
from skin2urdf.signals.trajectory import Trajectory

Criterion = Literal["determinant", "trace"]

_INSTANTS = 16
"""Instants of a pattern that stand for all of it; twice the unknowns of one joint's effects."""
_NOISE = 0.01
"""Noise of a low-passed reading, encoders' part included [m/s^2]: that of good sensors. It weighs
readings against what is known of sensors before."""
_BANDWIDTH = 7.0
"""Bandwidth of low-passed readings [Hz]: that which the highest tones ask for."""
_SLOWEST_POLE = 8e-3
"""Time constant of a sensor's low-pass that is slow, but not rare [s]: that of 20 Hz."""
_NOTHING = 1e-9
"""Relative weight that holds directions without any information."""
_HELD = 1e-6
"""Absolute one: that of a standard deviation of a kilometre or a thousand rad."""
_APART = 2e-3
"""Time that derivatives in time are taken over [s]."""
_ARM = 0.3
"""Length that angles are weighed by where variances are added up [m]: that of a link."""


@dataclass(frozen=True, eq=False)
class Information:
    """Information of C candidates, in arrow form.

    Attributes:
        joint: (C, J, J) of what joints share.
        su: (C, U, n, n) of each SU's coordinates.
        mixed: (C, U, n, K) coupling with the joint columns that an SU depends on.
        columns: (U, K) these columns, -1 where there are fewer.
    """

    joint: F64
    su: F64
    mixed: F64
    columns: Int


@dataclass(frozen=True, eq=False)
class Known:
    """Information that there is already; all of it in full columns.

    Attributes:
        joint: (J, J).
        su: (U, n, n).
        mixed: (U, n, J).
        free_joint: (J,) coordinates that are estimated, and
        free_su: (U, n).
        placements: (J,) True for coordinates of joint placements.
    """

    joint: F64
    su: F64
    mixed: F64
    free_joint: Bool
    free_su: Bool
    placements: Bool

    def plus(self, told: Information, c: int, sign: float = 1.0) -> Known:
        """With a candidate more, or one less."""
        mixed = self.mixed.copy()
        for u, columns in enumerate(told.columns):
            has = columns >= 0
            mixed[u][:, columns[has]] += sign * told.mixed[c, u][:, has]
        return replace(
            self, joint=self.joint + sign * told.joint[c], su=self.su + sign * told.su[c],
            mixed=mixed,
        )  # fmt: skip


def known_before(
    model: KinematicModel, joint: F64 | None = None, su: F64 | None = None
) -> tuple[MotionProblem, MotionState, Known]:
    """The problem of a robot of which nothing was recorded yet.

    Args:
        model: the robot, its base upright.
        joint: (D, 4, 4) information on joint placements from elsewhere.
        su: (U, 6, 6) information on SU placements from elsewhere.
    """
    tree = model.tree
    D, U = tree.n_joints, tree.n_sus
    none = _samples(np.zeros((1, D)), np.zeros((1, D)), np.zeros((1, D)), U)
    front = np.zeros(2), np.full(2, _SLOWEST_POLE**2)
    problem = MotionProblem(tree, [none], motion_priors(Priors(), gravity=0.02, front=front))
    up = np.array([[0.0, 0.0, 1.0]])
    placements = State(
        model.T_parent_joint, model.T_joint_su, up, np.zeros((U, 3)), np.zeros((U, 6))
    )
    state = MotionState(
        placements=placements,
        gravity=GRAVITY,
        front=np.zeros((U, 2)),
        clock=np.zeros((1, U, 2)),
        knots=(np.zeros((0, U, 3)),),
        unseen=np.zeros(0),
        gyro=np.zeros((U, 0)),
    )
    nothing = np.zeros((1, U, 3))
    still = Predicted(
        nothing, np.ones((1, U), dtype=bool), np.zeros((0, 6, 1)), np.zeros((3, 1, U, 3))
    )
    start = problem.equations(state, [still], [nothing])
    H, S = np.array(start.joint), np.array(start.su)
    if joint is not None:
        for d in range(D):
            at = slice(N_JOINT * d, N_JOINT * (d + 1))
            H[at, at] += joint[d]
    if su is not None:
        S[:, :N_PLACEMENT, :N_PLACEMENT] += su
    is_placement = np.arange(len(H)) < N_JOINT * D
    known = Known(H, S, np.array(start.mixed), problem.free_joint, problem.free_su, is_placement)
    return problem, state, known


def pattern_information(
    model: KinematicModel,
    state: MotionState,
    poses: F64,
    tones: Tones,
    amplitude: F64,
    duration: float,
    ramp: float,
    rng: np.random.Generator,
) -> Information:
    """What a pattern around each of C candidate poses tells.

    Args:
        model: the robot.
        state: where derivatives are taken.
        poses: (C, D) [rad or m].
        tones: of the joints.
        amplitude: (C, D) acceleration of each tone.
        duration: of the pattern [s].
        ramp: of its window [s].
        rng: draws the instants.
    """
    tree = model.tree
    C, U = len(poses), tree.n_sus
    time = ramp + (duration - 2 * ramp) * np.sort(rng.uniform(size=(C, _INSTANTS)), axis=1).ravel()
    which = np.repeat(np.arange(C), _INSTANTS)

    def read(t: F64) -> tuple[F64, F64, F64, F64]:
        q, qd, qdd = (x * amplitude[which] for x in waveform(tones, t, duration, ramp))
        q += poses[which]
        up = np.array([0.0, 0.0, GRAVITY])
        return q, qd, qdd, specific_forces(model, q, qd, qdd, up)

    q, qd, qdd, here = read(time)
    before, after = read(time - _APART)[3], read(time + _APART)[3]
    speed, bend = (after - before) / (2 * _APART), (after - 2 * here + before) / _APART**2
    log = _samples(q, qd, qdd, U)
    front = np.zeros(2), np.full(2, _SLOWEST_POLE**2)
    problem = MotionProblem(tree, [log], motion_priors(Priors(), gravity=0.02, front=front))
    predicted = Predicted(
        np.zeros_like(here), np.ones(here.shape[:2], dtype=bool), np.zeros((0, 6, 1)),
        np.stack([speed, 0.5 * bend, -bend]),
    )  # fmt: skip
    # The drift of a clock is told by the log as a whole, whose middle this is.
    worth = 2 * _BANDWIDTH * duration / _INSTANTS / _NOISE**2
    of_candidate = np.repeat(np.arange(C), len(here) // C)
    spans = spans_of(problem, state, [predicted], [np.full(here.shape, worth)], [of_candidate])
    return Information(spans.joint, spans.su, spans.mixed, spans.columns)


def choose(
    known: Known,
    told: Information,
    number: int,
    criterion: Criterion,
    accept: Callable[[int], bool],
    exchanges: int,
) -> list[int]:
    """Candidates that tell most together: greedily, and then each exchanged for a better one.

    Args:
        known: what is known before.
        told: what candidates tell.
        number: how many to choose.
        criterion: the logarithm of the determinant of the information on placements, or the sum of
            their variances, which the largest make.
        accept: whether a candidate will do at all.
        exchanges: how often, at most, all that are chosen are looked at again.

    Returns:
        Their indices; fewer than asked for where there are no more that will do.
    """
    open_ = np.ones(len(told.joint), dtype=bool)
    chosen: list[int] = []

    def best(base: Known) -> tuple[int, float]:
        order = np.flatnonzero(open_)
        merit = merits(base, told, order, criterion)
        for i in np.argsort(-merit):
            c = int(order[i])
            if accept(c):
                return c, float(merit[i])
            open_[c] = False
        return -1, -np.inf

    for _ in range(number):
        c, _merit = best(known)
        if c < 0:
            return chosen
        chosen.append(c)
        open_[c] = False
        known = known.plus(told, c)
    for _ in range(exchanges):
        changed = False
        for i, old in enumerate(chosen):
            without = known.plus(told, old, -1.0)
            mine = float(merits(without, told, np.array([old]), criterion)[0])
            c, merit = best(without)
            if c >= 0 and merit > mine + 1e-3:
                chosen[i], changed = c, True
                open_[old], open_[c] = True, False
                known = without.plus(told, c)
        if not changed:
            break
    return chosen


def merits(known: Known, told: Information, which: Int, criterion: Criterion) -> F64:
    """(M,) merit of each of some candidates, with what is known already."""
    U, M, J = len(known.su), len(which), len(known.joint)
    schur = known.joint + told.joint[which]
    merit = np.zeros(M)
    follow = []
    for u in range(U):
        S = _masked(known.su[u] + told.su[which, u], known.free_su[u])
        has = told.columns[u] >= 0
        columns = told.columns[u][has]
        B = known.mixed[u][:, columns] + told.mixed[which, u][:, :, has]
        B = B * (known.free_su[u][:, None] & known.free_joint[columns])
        lean = np.linalg.solve(S, B)
        schur[:, columns[:, None], columns] -= np.swapaxes(B, 1, 2) @ lean
        if criterion == "determinant":
            merit += np.linalg.slogdet(S)[1]
            merit -= np.linalg.slogdet(S[:, N_PLACEMENT:, N_PLACEMENT:])[1]
        else:
            follow.append((np.linalg.inv(S)[:, :N_PLACEMENT, :N_PLACEMENT], columns, lean))
    schur = _masked(schur, known.free_joint)
    if criterion == "determinant":
        merit += np.linalg.slogdet(schur)[1]
        rest = np.flatnonzero(~known.placements)
        merit -= np.linalg.slogdet(schur[:, rest[:, None], rest])[1]
        return merit
    covariance = np.linalg.inv(schur)
    weight = np.where(np.isin(np.arange(J) % N_JOINT, (0, 1)), 1.0, _ARM**2)
    weight = weight * (known.placements & known.free_joint)
    merit -= np.einsum("mjj,j->m", covariance, weight)
    of_su = np.array([1.0, 1.0, 1.0, _ARM**2, _ARM**2, _ARM**2])
    for u, (own, columns, lean) in enumerate(follow):
        part = lean[:, :N_PLACEMENT]
        both = covariance[:, columns[:, None], columns]
        variance = np.einsum("mii->mi", own) + np.einsum("mij,mjk,mik->mi", part, both, part)
        merit -= variance @ (of_su * known.free_su[u][:N_PLACEMENT])
    # Relative to what is there, so that gains are of the same kind as those of logarithms.
    return np.asarray(-np.log(np.maximum(-merit, 1e-300)))


def spread_out(
    poses: F64,
    number: int,
    accept: Callable[[int], bool],
    span: F64,
    before: Sequence[int] = (),
) -> list[int]:
    """Candidates that fill the joints' ranges, where no model tells what they are worth.

    The first is the one nearest to the middle; each further one is farthest from all before.

    Args:
        poses: (C, D) candidates [rad or m].
        number: how many to choose.
        accept: whether a candidate will do at all.
        span: (D,) ranges [rad or m].
        before: candidates that are chosen already.
    """
    unit = poses / span
    distance = -np.linalg.norm(unit - unit.mean(axis=0), axis=1)
    chosen: list[int] = []
    nearest = np.full(len(poses), np.inf)
    for c in before:
        nearest = np.minimum(nearest, np.linalg.norm(unit - unit[c], axis=1))
    open_ = np.ones(len(poses), dtype=bool)
    while len(chosen) < number and open_.any():
        merit = np.where(open_, nearest if chosen or before else distance, -np.inf)
        c = int(np.argmax(merit))
        open_[c] = False
        if accept(c):
            chosen.append(c)
            nearest = np.minimum(nearest, np.linalg.norm(unit - unit[c], axis=1))
    return chosen


def _masked(H: F64, free: Bool) -> F64:
    """Information (M, n, n) in which coordinates that are not estimated stay apart.

    Directions without any, as the turn about gravity of an SU on the base, stay where they are.
    """
    out = np.where(free[:, None] & free, H, 0.0)
    index = np.arange(len(free))
    out[:, index, index] = np.where(free, (1 + _NOTHING) * out[:, index, index] + _HELD, 1.0)
    return out


def _samples(q: F64, qd: F64, qdd: F64, n_sus: int) -> Trajectory:
    """Samples of motion as a log that is compared at every one of them."""
    N = len(q)
    return Trajectory(
        log=0, rate=125.0, taps=np.ones(1), q=q, qd=qd, qdd=qdd,
        readings=np.zeros((N, n_sus, 3)), kept=np.arange(N),
        valid=np.ones((N, n_sus), dtype=bool), moving=np.ones(q.shape, dtype=bool),
        shaken=np.ones(q.shape),
        independence=1.0,
    )  # fmt: skip
