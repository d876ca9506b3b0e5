"""What the noise of encoders does to a fit through the loads that links bend under.

Loads go with accelerations, which encoders' noise shakes, and what bends shakes with them: by as
large a part of the motion as the resonance is near. A base that gives way so moves where the
encoders' noise says so, and all SUs that it carries seem closer to it than they are, by a multiple
of what noise does to lengths of a robot that does not bend (:mod:`encoder_noise`). Nothing so
simple as a square of noise says by how much: positions are rounded off anew (:mod:`rounded`), the
loads balanced along them, and what that does to the gradient is found in the mean over the draws,
as more noise does to an estimate what the noise in it has done already (simulation extrapolation:
Cook and Stefanski 1994).

Draws are of rounding: of noise that is more than that nothing is drawn, and what gyroscopes feel of
it is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.trajectory.balance import balanced
from skin2urdf.estimation.trajectory.bending import Bending, bends_of
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rounded import drawn_anew
from skin2urdf.estimation.trajectory.unseen import together
from skin2urdf.signals.trajectory import Trajectory

_DRAWS = 8
"""Draws at most, of those of :mod:`rounded`: each takes as long as a step of the fit. What is taken
off in their mean is then known to a third of the error that the noise makes through loads."""


@dataclass(frozen=True, eq=False)
class ShakenLoads(Record):
    """Pulls by what encoders' noise does through loads, one for each of the first R draws.

    Attributes:
        joints: the joints whose encoders round.
        joint: (R, J) and
        su: (R, U, n) parts of the gradient.
        counted: (J,) part that a fit has had added, so that nothing is paid for what springs make
            of noise (:mod:`shaken_springs`).
        taken_off: whether their mean was taken off an estimate.
    """

    joints: Int
    joint: F64
    su: F64
    counted: F64
    taken_off: bool = False

    @property
    def mean(self) -> tuple[F64, F64]:
        """Parts (J,) and (U, n) of the gradient that noise makes in the mean."""
        return self.joint.mean(axis=0) + self.counted, self.su.mean(axis=0)

    @property
    def off(self) -> list[tuple[F64, F64]]:
        """Parts (J,) and (U, n) of the gradient by which an estimate may be off.

        So few draws do not tell the mean exactly; where it was not taken off, it is an error.
        """
        R = len(self.joint)
        apart = self.joint - self.joint.mean(axis=0), self.su - self.su.mean(axis=0)
        unknown = [(joint / R, su / R) for joint, su in zip(*apart, strict=True)]
        return unknown if self.taken_off else [*unknown, self.mean]


def shaken_loads(problem: MotionProblem, fitted: Fitted) -> ShakenLoads | None:
    """What noise does through loads; None where a fit follows none, or where encoders are exact.

    Numbers near those of no robot may bring loads and what they bend into balance along some
    positions and not along others, which tell nothing then.

    Args:
        problem: what was fitted.
        fitted: its fit.
    """
    bends, rounds = bends_of(problem.unseen), np.zeros(problem.tree.n_joints, dtype=bool)
    for log in problem.logs:
        rounds |= log.resolution > 0 if len(log.resolution) else False
    if bends is None or not rounds.any():
        return None
    about = _Followed(problem, fitted, bends)
    still = about.along(problem.logs)
    if not still[0].holds:
        return None
    pulls = []
    for off in islice(drawn_anew(problem.logs), _DRAWS):
        logs = [log.with_joints_off(each) for log, each in zip(problem.logs, off, strict=True)]
        there = about.along(logs)
        if not there[0].holds:
            continue
        followed, held = about.gradient(there, logs), about.gradient(still, logs)
        pulls.append([a - b for a, b in zip(followed, held, strict=True)])
    if not pulls:
        return None
    joint, su = (np.array(each) for each in zip(*pulls, strict=True))
    counted, first = np.zeros(problem.layout.n_joint), problem.layout.unseen.start
    of_bends = slice(first, first + bends.n_numbers)
    counted[of_bends] = fitted.shaken.pull(problem, fitted.state)[0][of_bends]
    return ShakenLoads(np.flatnonzero(rounds), joint, su, counted)


@dataclass(frozen=True, eq=False)
class _Followed:
    """A fit, of which deflections follow their loads along other positions.

    Attributes:
        problem: what was fitted.
        fitted: its fit.
        bends: its deflections.
    """

    problem: MotionProblem
    fitted: Fitted
    bends: Bending

    def along(self, logs: Sequence[Trajectory]) -> tuple[Bending, F64]:
        """Deflections about the fit's numbers along logs, and these numbers (S,)."""
        state, tree = self.fitted.state, self.problem.tree
        x = state.unseen[: self.bends.n_numbers]
        there = balanced(self.bends, tree, logs, state.placements, state.gravity, x)
        return there.moved_by_numbers(), there.x

    def gradient(
        self, followed: tuple[Bending, F64], logs: Sequence[Trajectory]
    ) -> tuple[F64, F64]:
        """Gradient (J,) and (U, n) of samples with these deflections, and with other positions."""
        bends, x = followed
        problem, state, unseen = self.problem, self.fitted.state, self.problem.unseen
        others = unseen.several[1:] if unseen is not None else ()
        state = replace(state, unseen=np.concatenate([x, state.unseen[len(x) :]]))
        about = MotionProblem(
            problem.tree,
            logs,
            problem.priors,
            problem.layout.n_knots,
            together([bends, *others]) if others else bends,
        )
        predicted = [about.predict(state, g) for g in range(len(logs))]
        pulls = [
            np.where(p.measured[..., None], w[..., :3] * p.residual, 0.0)
            for w, p in zip(self.fitted.weights, predicted, strict=True)
        ]
        ((joint, su),) = about.gradients(state, predicted, [pulls])
        return joint, su
