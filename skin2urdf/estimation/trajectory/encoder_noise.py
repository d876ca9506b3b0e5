"""What the noise of encoders does to a fit, taken off.

Positions are differentiated twice, so that accelerations carry noise, and least squares with noise
in what they rest on shortens: lever arms come out as if part of the acceleration had not been.
With ``dq''`` the noise of a joint's acceleration, the prediction is off by ``tau dq''`` and its
derivatives by ``(d tau) dq''``; their product does not average out. Its mean follows from the
variance of ``dq''``, and a step or two take it off (corrected scores: Stefanski 1985; Nakamura
1990).

Where joints are somewhat beyond their encoders, a link elsewhere has another tau as well. Slack of
two joints makes up for most of what another axis between them does, so that a part of the mean
which is left out of either moves both, along what hardly shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.trajectory.ahead import step_ahead, step_along
from skin2urdf.estimation.trajectory.fit import Fitted, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.shaken import EVERY
from skin2urdf.estimation.trajectory.shaken_loads import ShakenLoads, shaken_loads
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.uncertainty.covariance import UNKNOWN
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

LEVER = 0.5
"""Offset of an SU from its joint [m] of which shares may be hidden: that of an arm."""
_MOST = 2.0
"""Squared residuals of an SU over what they were, from which a step took off more than was there.
Noise of variance C beside motion of S shortens by C / (S + C) and leaves S C / (S + C), where the
right lengths leave C: (S + C) / S as much, twice where motion is as large as the noise."""
_STEPS = 4
"""Steps at most, each from where the one before has led; the last is shorter than noise."""


@dataclass(frozen=True, eq=False)
class Shortening(Record):
    """What the noise of some encoders does to a fit.

    Attributes:
        joints: which encoders.
        joint: (J,) and
        su: (U, n) parts of the gradient.
    """

    joints: Int
    joint: F64
    su: F64


def whole_of(parts: Sequence[Shortening]) -> tuple[F64, F64]:
    """Parts (J,) and (U, n) of the gradient that the noise of all encoders makes."""
    return np.sum([each.joint for each in parts], axis=0), np.sum([e.su for e in parts], axis=0)


def without_shortening(
    problem: MotionProblem, fitted: Fitted
) -> tuple[Fitted, tuple[Shortening, ...], ShakenLoads | None]:
    """A fit without what the noise of encoders does to it.

    Args:
        problem: what was fitted.
        fitted: its optimum.

    Returns:
        The fit, some standard deviations away, what led there, and what of that noise does through
        loads; the same fit and nothing where steps would not take it off (see `hidden_lengths`), as
        in a log of motion so slow that it is lost in the noise.
    """
    parts, loads = _shortening(problem, fitted, fitted.state), shaken_loads(problem, fitted)
    if not parts:
        return fitted, (), loads
    if loads is not None:
        joint, su = loads.mean
        # What more noise does is what noise has done: the reverse takes it off.
        there = _taken_off(problem, fitted, parts, (Shortening(loads.joints, -joint, -su),))
        if there is not None:
            return *there, replace(loads, taken_off=True)
    there = _taken_off(problem, fitted, parts, ())
    return (fitted, (), loads) if there is None else (*there, loads)


def _taken_off(
    problem: MotionProblem,
    fitted: Fitted,
    parts: tuple[Shortening, ...],
    through: tuple[Shortening, ...],
) -> tuple[Fitted, tuple[Shortening, ...]] | None:
    """A fit without what noise does to it, and what that is; None where steps would not do.

    Args:
        problem: what was fitted.
        fitted: its optimum.
        parts: what noise does there to lengths, which is another thing elsewhere.
        through: what it does through loads, which is taken to be the same.
    """
    left, found = _left(fitted, fitted), fitted
    step = step_along(fitted, *whole_of([*parts, *through]), within=UNKNOWN)
    for _ in range(_STEPS):
        found = held(problem, problem.layout.moved(found.state, *step.steps))
        if not (_left(found, fitted) <= _MOST * left).all():
            return None
        if not step.is_most:
            break
        # So far away it is another step that takes off what noise does there.
        parts = _shortening(problem, found, found.state)
        step = step_ahead(found, whole_of([*parts, *through]), within=UNKNOWN)
    return found, (*parts, *through)


def hidden_lengths(
    problem: MotionProblem, fitted: Fitted, corrected: Sequence[Shortening]
) -> list[tuple[F64, F64]]:
    """What the noise of encoders does to lengths and was not taken off, as far as is known.

    Args:
        problem: what was fitted.
        fitted: its optimum.
        corrected: what was taken off.

    Returns:
        Parts (J,) and (U, n) of the gradient. Where motion is lost in noise of variance C beside
        its own S, S / (S + C) is left of an offset, whatever it is: what is found of one says
        nothing then of the rest, which may be as long as an arm, along each axis. Where it is not
        lost, all that the noise does; none where that was taken off.
    """
    lost = _lost(problem.logs)
    there = _shortening(problem, fitted, fitted.state) if lost or not corrected else ()
    if not there:
        return []
    return _hidden_offsets(problem, fitted, there) if lost else [whole_of(there)]


def _hidden_offsets(
    problem: MotionProblem, fitted: Fitted, there: Sequence[Shortening]
) -> list[tuple[F64, F64]]:
    """What noise would do to offsets of an arm's length beyond what it does `there`."""
    out = []
    for axis in range(3):
        T = np.array(fitted.state.placements.T_joint_su)
        T[:, axis, 3] += LEVER
        placements = replace(fitted.state.placements, T_joint_su=T)
        further = _shortening(problem, fitted, replace(fitted.state, placements=placements))
        # Directions are told by gravity, of which noise of accelerations hides nothing.
        own = np.zeros_like(there[0].su)
        own[:, :3] = (whole_of(further)[1] - whole_of(there)[1])[:, :3]
        out.append((np.zeros_like(there[0].joint), own))
    return out


def _lost(logs: Sequence[Trajectory]) -> bool:
    """Whether some joint's accelerations are noise for the most part."""
    of_noise, of_all = 0.0, 0.0
    for log in logs:
        if log.noise is None:
            return False
        of_noise = of_noise + (log.shaken * log.noise).sum(axis=0)
        of_all = of_all + (log.qdd[log.kept] ** 2).sum(axis=0)
    return bool(np.any(2 * of_noise > of_all))


def _shortening(
    problem: MotionProblem, fitted: Fitted, where: MotionState
) -> tuple[Shortening, ...]:
    """What the noise of each encoder does to lengths; nothing where no noise is known."""
    noise = [log.noise for log in problem.logs if log.noise is not None]
    if len(noise) < len(problem.logs):
        return ()
    layout, tree = problem.layout, problem.tree
    state = replace(
        where,
        unseen=np.zeros(layout.n_unseen),
        knots=tuple(k[:0] for k in where.knots),
        gyro=np.zeros((tree.n_sus, 0)),
    )
    still = _posed(problem, [])
    at_rest = _predicted(still, state)
    # What is steady shows nothing of clocks and front ends; of these the fit itself takes it off.
    own = slice(0, layout.front.start)
    groups = _never_in_one_chain(tree)
    by_driven, by_still = [], []
    for pushed in groups:
        driven_by = _posed(problem, pushed)
        driven = _predicted(driven_by, state)
        active = tree.activity()[:, pushed]
        beyond, felt = active.any(axis=1), np.array(pushed)[active.argmax(axis=1)]
        # Residuals are readings less predictions, so this is what a unit of acceleration does.
        tau = [
            np.where((a.measured & b.measured & beyond)[..., None], a.residual - b.residual, 0.0)
            for a, b in zip(at_rest, driven, strict=True)
        ]
        weights = [
            w[::EVERY, :, :3] * (EVERY * (log.shaken[::EVERY, felt] * beyond)[..., None])
            for w, log in zip(fitted.weights, problem.logs, strict=True)
        ]
        louder = [w * n[felt, None] for w, n in zip(weights, noise, strict=True)]
        by_still.append([w * t for w, t in zip(louder, tau, strict=True)])
        by_driven += driven_by.gradients(state, driven, by_still[-1:])
    parts: list[Shortening] = []
    # What stands still has the same derivatives whichever joint is pushed.
    at_still = still.gradients(state, at_rest, by_still)
    for pushed, (joint, su), (of_joint, of_su) in zip(groups, by_driven, at_still, strict=True):
        to_su = np.zeros((tree.n_sus, layout.n_su))
        to_su[:, own] = (su - of_su)[:, own]
        parts.append(Shortening(np.array(pushed), joint - of_joint, to_su))
    return tuple(parts)


def _left(found: Fitted, weighed: Fitted) -> F64:
    """(U,) squared residuals of each SU, with the weights of a fit."""
    by_log = [
        np.einsum("kuc,ku->u", w[..., :3] * p.residual**2, p.measured)
        for w, p in zip(weighed.weights, found.predicted, strict=True)
    ]
    return np.asarray(np.sum(by_log, axis=0))


def _predicted(problem: MotionProblem, state: MotionState) -> list[Predicted]:
    return [problem.predict(state, g) for g in range(len(problem.logs))]


def _never_in_one_chain(tree: KinematicTree) -> list[list[int]]:
    """The joints, in groups of which no SU feels more than one: those as far from the ground."""
    depth = [len(tree.chain(d)) for d in range(tree.n_joints)]
    return [[d for d in range(tree.n_joints) if depth[d] == level] for level in sorted(set(depth))]


def _posed(problem: MotionProblem, pushed: Sequence[int]) -> MotionProblem:
    """A problem whose logs stand still in some of its positions, some joints accelerating by 1."""
    logs = [_posed_log(log, pushed) for log in problem.logs]
    return MotionProblem(problem.tree, logs, problem.priors, unseen=_standing(problem))


def _standing(problem: MotionProblem) -> Unseen | None:
    """What numbers of unseen motion make of positions, where nothing moves; None without any."""
    unseen = problem.unseen
    if unseen is None:
        return None
    kept = []
    for motions in unseen.at_kept(problem.logs):
        here = np.zeros(motions[:, :, ::EVERY].shape)
        here[0] = motions[0, :, ::EVERY]
        kept.append(here)
    return Unseen(
        unseen.joint, (), column=unseen.columns, unit=unseen.units, number=unseen.number,
        kept=tuple(kept),
    )  # fmt: skip


def _posed_log(log: Trajectory, pushed: Sequence[int]) -> Trajectory:
    q = log.q[log.kept[::EVERY]]
    qdd = np.zeros_like(q)
    qdd[:, pushed] = 1.0
    return replace(
        log,
        rate=log.rate / float(np.median(np.diff(log.kept))) / EVERY,
        taps=np.ones(1),
        q=q,
        qd=np.zeros_like(q),
        qdd=qdd,
        readings=np.zeros((len(q), *log.readings.shape[1:])),
        kept=np.arange(len(q)),
        thin=1,
        valid=log.valid[::EVERY],
        moving=log.moving[::EVERY],
        shaken=log.shaken[::EVERY],
        rates=None,
        turning=None,
        positions=q,
        beyond=None,
    )
