"""Fits of joints whose gears have play: links lie on one side of a gap or on the other.

On which side a link lies is the sense of the torque that its gear bears, ``e = -b tanh(tau / s)``
with half a gap b of each joint, and torques that are linear in the masses of the links, as those
that bend springs are. Only their sizes over s count, by which links fall across slowly or at once;
what would bend springs, followed or to first order, tells the loads to begin with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.balance import step_of
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.coarser import coarser, on_grid
from skin2urdf.estimation.trajectory.fit import Fitted, Led, fit_following
from skin2urdf.estimation.trajectory.play import rms
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.torques import regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory

_STEPS = 24
"""Steps at most: as many as springs may take."""
_ON_A_SIDE = 0.5
"""Deflections, rms, over half of the gaps from which links lie on their sides: in gaps of 0.3 to
3.5 mrad it is 0.9 and more, and 0.15 where a fit has ended in what is linear of them."""
_WIDER = 3.0
"""Standard deviation of half a gap, over the rms of deflections to begin with."""


@dataclass(frozen=True, eq=False)
class Gaps(Unseen):
    """Deflections of D joints in gaps, by P loads that say on which side; P + D numbers.

    Attributes:
        torques: per log (M, D, P) torques per load, at each so many-th sample, over those across
            which a link falls from one side to the other.
    """

    torques: tuple[F64, ...] = field(kw_only=True)

    def about(self, logs: Sequence[Trajectory], x: F64) -> Gaps:
        """The same gaps, and what each number does to them, about some numbers.

        Args:
            logs: trajectories as the encoders have them.
            x: (P + D,) loads, and half of each gap [rad or m].
        """
        P = self.torques[0].shape[2]
        half, motions, settled = x[P:], [], []
        for log, torques, step in zip(logs, self.torques, self.every, strict=True):
            n = len(log.q)
            side = np.tanh(on_grid(torques @ x[:P], step, n))
            falls = half * (1 - side**2)
            # What links fall by is too fast for a coarser grid until it is low-passed.
            of_loads = [on_grid(Y, step, n) for Y in np.moveaxis(torques, 2, 0)]
            by_load = [filtered(falls * Y, log.taps)[::step] for Y in of_loads]
            lies = filtered(side, log.taps)
            motions.append(-np.hstack([*by_load, lies[::step]]))
            bent = np.zeros((n, len(half) + N_HINGES))
            bent[:, : len(half)] = -half * lies
            settled.append(bent)
        return replace(self, motions=tuple(motions), settled=tuple(settled), origin=x)


def fit_gaps(
    problem: MotionProblem, begin: MotionState, bends: Bending, loads: F64, half: F64
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that lie in gaps; None where links hang within them, as on springs.

    Args:
        problem: the rigid robot.
        begin: a state to begin with, whatever it has of unseen motion.
        bends: what bends springs.
        loads: (P,) loads, as far as they are known.
        half: (D,) half of each gap to begin with [rad or m].
    """
    logs, P, D = problem.logs, len(loads), problem.tree.n_joints
    wide = np.full(D, _WIDER * np.sqrt(np.mean(half**2)))
    priors = replace(problem.priors, unseen=np.concatenate([bends.spread[:P], wide]))
    gaps = _gaps(problem, begin, bends, loads)

    def follow(_: MotionProblem, at: MotionState) -> Led:
        there = gaps.about(logs, at.unseen)
        about = MotionProblem(problem.tree, logs, priors, problem.layout.n_knots, there)
        return Led(about, at, lambda: about)

    first = follow(problem, replace(begin, unseen=np.concatenate([loads, half])))
    about, fitted = fit_following(first.problem, first.state, follow, iterations=_STEPS)
    lies = np.linalg.norm(rms(about.deflections(fitted.state))[:D])
    found = np.linalg.norm(fitted.state.unseen[P:])
    return (about, fitted) if lies > _ON_A_SIDE * found else None


def _gaps(problem: MotionProblem, state: MotionState, bends: Bending, loads: F64) -> Gaps:
    """Gaps that links fall across by loads of their rms, of which no motion is known yet."""
    tree, places, gravity = problem.tree, state.placements, state.gravity
    P, D = len(loads), tree.n_joints
    every = tuple(step_of(log) for log in problem.logs)
    torques = []
    for g, (log, step) in enumerate(zip(problem.logs, every, strict=True)):
        of_log = regressors(tree, places, g, gravity, coarser(log, step))
        torques.append(np.concatenate([Y @ bends.basis.T for Y, _ in of_log]))
    size = rms([Y @ loads for Y in torques])
    across = np.where(size > 0, size, 1.0)[:, None]
    return Gaps(
        np.tile(np.arange(D), P + 1),
        tuple(np.zeros((0, (P + 1) * D)) for _ in torques),
        number=np.concatenate([np.repeat(np.arange(P), D), P + np.arange(D)]),
        every=every,
        torques=tuple(Y / across for Y in torques),
    )
