"""Gears and encoders that are off by functions of their joint's position.

The field calls them the kinematic error of a gear and the integral nonlinearity of an encoder.

Wheels and scales out of centre and out of round make errors once and twice per turn of the joint,
tables of encoders and potentiometers any smooth function of its position, the wave of a strain wave
gear (and the magnet of a motor's encoder) one or two hundred per turn, and wheels in between, as
planets and the cranks of cycloids are, as many as they turn, which need not be a whole number.

An error ``a sin(n q) + b cos(n q)`` is linear in a and b. What is smooth is a sum of many whose
sizes fall with n, and how steeply is asked of the readings: were once and twice per turn all, a
joint of limited range would have little more than parabolas of them, of which large ones that all
but cancel follow anything. Which single n a gear has besides is looked for: what the residuals pull
at every n is a sum over samples, as a periodogram is.

A driver that takes a gear for one of another ratio has positions that are off by a share of
themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import Size, lacking
from skin2urdf.estimation.trajectory.unseen import MOST_NUMBERS, Unseen
from skin2urdf.signals.filters import filtered, first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_LARGEST = 2
"""Errors per turn up to which any may be as large as any other: wheels out of centre make the
first, wheels out of round the second."""
_SMOOTH = 20
"""Errors per turn that smooth ones are made of, at most: with 30, tables of straight lines between
entries 0.5 rad apart gain 1 to 2 % of their likelihood's logarithm."""
_STEEPNESS = (1.0, 2.0, 3.0, 4.0)
"""Powers of the number per turn with which errors of more than two per turn fall: tables with
straight lines between their entries fall with the second, and of the fourth little but errors once
and twice per turn is left. One between the first two gains at most 1 % of a likelihood's logarithm.
"""
_APART = 0.5
"""Errors per turn from one that is looked for to the next: over a whole turn, either takes four
fifths of what one midway between two would. Over several turns, whole and half numbers alone are
seen as well; more would take time with every turn that a wheel makes."""
_RIPPLES = np.arange(3.0, 642.0, _APART)
"""Errors per turn that are looked for one by one: from three, which no wheel out of centre or round
makes by itself, to twice per turn of motors that are geared down by up to 320."""
_FINER = 8
"""Parts of the way to the next one in which the likeliest is looked for: the right one is then at
most a sixtieth of a period off by the ends of a whole turn."""
_AT_ONCE = 32
"""Ripples that are looked at together; it decides about memory alone."""
_BETWEEN = 8
"""Ripples from one whose information is summed up to the next; it decides about time alone."""
_STANDS_OUT = 30.0
"""Pull of a ripple, over the median of all of its joint's, from which it is one.

Noise alone exceeds the median of chi-squared with two degrees of freedom by that much once in
``exp(30 * 0.69)``, coloured noise of encoders and sensors reached 21 times (panda, one recording),
and ripples of 0.1 mrad have 35 to 300 where their joint carries much."""


@dataclass(frozen=True, eq=False)
class Ratios(Unseen):
    """Links that are further by a share of what their encoders say: a number for each joint."""


def ratios(logs: Sequence[Trajectory]) -> Ratios:
    """Other shares of what the encoders of all joints say.

    Args:
        logs: trajectories.
    """
    return Ratios(np.arange(logs[0].q.shape[1]), tuple(log.q for log in logs))


@dataclass(frozen=True, eq=False)
class Uneven(Unseen):
    """Links that are off their encoders by functions of their joints' positions."""


def ripples(logs: Sequence[Trajectory], which: Sequence[tuple[int, float]]) -> Uneven | None:
    """Errors of some joints, so many times per turn: a sine and a cosine each; None without any.

    Args:
        logs: trajectories.
        which: joints, and periods in a turn of theirs.
    """
    if not which:
        return None
    joint = np.array([k for k, _ in which])
    n = np.array([per_turn for _, per_turn in which], dtype=float)
    return Uneven(np.repeat(joint, 2), tuple(_waves(log, joint, n) for log in logs))


def _waves(log: Trajectory, joint: Int, n: F64) -> F64:
    """(N, 2 S) sines and cosines of S joints' positions, low-passed as these."""
    phase = log.q[:, joint] * n
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(phase), -1)
    return filtered(waves, log.taps)


def find_harmonics(problem: MotionProblem, fitted: Fitted) -> tuple[Uneven, Size] | None:
    """Errors of encoders that are smooth functions of position, as steep as is likeliest.

    Args:
        problem: what was fitted.
        fitted: the fit, of whose residuals such errors would explain a part.

    Returns:
        Errors of all joints that turn, whose numbers are of one size [rad], and what the readings
        say of it; None without any joint that turns.
    """
    turning = np.flatnonzero(~problem.tree.prismatic)
    most = int(np.clip(MOST_NUMBERS // (2 * max(1, len(turning))), _LARGEST, _SMOOTH))
    per_turn = np.arange(1, most + 1)
    more = ripples(problem.logs, [(int(k), float(n)) for k in turning for n in per_turn])
    if more is None:
        return None
    falls = np.tile(np.repeat(np.minimum(1.0, _LARGEST / per_turn), 2), len(turning))
    shown = lacking(problem, fitted, [more])
    sizes = [(falls**power, shown.size(0, units=falls**power)) for power in _STEEPNESS]
    unit, size = max(sizes, key=lambda each: each[1].gain)
    return replace(more, unit=unit), size


def find_ripples(problem: MotionProblem, fitted: Fitted) -> list[tuple[int, float]]:
    """The ripple of every joint that stands out most, if it does.

    Args:
        problem: what was fitted.
        fitted: the fit, of whose residuals ripples would explain a part.

    Returns:
        Joints, and periods in a turn of theirs.
    """
    parts = problem.pulls_of_joints(fitted.state, fitted.predicted, fitted.weights)
    found = []
    for k in np.flatnonzero(~problem.tree.prismatic).tolist():
        of_joint = [(G[k], H[k]) for G, H in parts]
        about = _about(problem.logs, of_joint, k)
        usual = float(np.median(about))
        likely = _RIPPLES[about > 0.5 * _STANDS_OUT * usual]
        if not usual > 0 or not len(likely):
            continue
        best, pull = _best(problem.logs, of_joint, k, likely)
        if pull > _STANDS_OUT * usual:
            nearby = best + _APART / _FINER * np.arange(1.0 - _FINER, _FINER)
            found.append((k, _best(problem.logs, of_joint, k, nearby)[0]))
    return found


def _best(
    logs: Sequence[Trajectory], parts: Sequence[tuple[F64, F64]], joint: int, n: F64
) -> tuple[float, float]:
    """Which of some ripples would take the most of chi-squared, and how much."""
    split = np.array_split(n, -(-len(n) // _AT_ONCE))
    pulls = np.concatenate([_pulls(logs, parts, joint, few) for few in split])
    best = int(np.argmax(pulls))
    return float(n[best]), float(pulls[best])


def _about(logs: Sequence[Trajectory], parts: Sequence[tuple[F64, F64]], joint: int) -> F64:
    """(n,) nearly the chi-squared that every ripple that is looked for would take.

    Gradients are exact, by sums over samples of what residuals pull at; information is that of some
    ripples between which it changes little, the same on sines and cosines.
    """
    gradient = np.zeros(len(_RIPPLES), dtype=np.complex128)
    for log, (G, _) in zip(logs, parts, strict=True):
        pull = np.zeros((3, len(log.q)))
        pull[:, log.kept] = G
        position, speed, push = pull
        position = position - first_derivative(speed, log.rate)  # which is antisymmetric
        pull_of_wave = filtered(position + second_derivative(push, log.rate), log.taps)
        q = log.q[:, joint]
        near = np.exp(1j * q[:, None] * (_RIPPLES[:_AT_ONCE] - _RIPPLES[0]))
        for begin in range(0, len(_RIPPLES), _AT_ONCE):
            far = pull_of_wave * np.exp(1j * q * _RIPPLES[begin])
            some = gradient[begin : begin + _AT_ONCE]
            some += (far @ near)[: len(some)]
    at = np.unique(np.append(_RIPPLES[::_BETWEEN], _RIPPLES[-1]))
    information = np.concatenate(
        [
            np.trace(_sums(logs, parts, joint, n)[1], axis1=1, axis2=2)
            for n in np.array_split(at, -(-len(at) // _AT_ONCE))
        ]
    )
    return np.asarray(2 * np.abs(gradient) ** 2 / np.interp(_RIPPLES, at, information))


def _pulls(logs: Sequence[Trajectory], parts: Sequence[tuple[F64, F64]], joint: int, n: F64) -> F64:
    """(n,) chi-squared that a ripple would take, all else as it is."""
    g, h = _sums(logs, parts, joint, n)
    return np.asarray(np.einsum("na,na->n", g, np.linalg.solve(h, g[..., None])[..., 0]))


def _sums(
    logs: Sequence[Trajectory], parts: Sequence[tuple[F64, F64]], joint: int, n: F64
) -> tuple[F64, F64]:
    """(n, 2) gradient in sines and cosines of ripples, and (n, 2, 2) information on them."""
    g, h = np.zeros((len(n), 2)), np.zeros((len(n), 2, 2))
    for log, (G, H) in zip(logs, parts, strict=True):
        e = _waves(log, np.full(len(n), joint, dtype=np.int64), n)
        E = np.stack(
            [
                x[log.kept]
                for x in (e, first_derivative(e, log.rate), second_derivative(e, log.rate))
            ]
        )
        E = E.reshape(3, len(log.kept), len(n), 2)
        g += np.einsum("mk,mkna->na", G, E, optimize=True)
        HE = np.einsum("mlk,lkna->mkna", H, E, optimize=True)
        h += np.einsum("mkna,mknb->nab", E, HE, optimize=True)
    h += 1e-9 * np.trace(h, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
    return g, h
