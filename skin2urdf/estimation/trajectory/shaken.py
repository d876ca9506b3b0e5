"""What the noise of encoders makes of predictions, which front ends must not be paid to cut off.

Positions are differentiated twice, so a prediction shakes by what noise makes of accelerations, the
more the higher the frequency. Least squares then asks for a sensor with a low-pass: readings have
nothing of that noise, and a front end that cuts it off leaves less of it. So of the noise alone a
sensor would seem slow, by as much as the patterns allow, and late by what such a low-pass does to
their phase. With encoders of 12 bits that is 5 Hz and 2 ms.

Predictions with noise ``n`` of variance S behind a front end F leave ``|F|^2 S`` of it, summed over
frequencies. This part of chi-squared is known for every F, and is taken off, so that what is
minimised is what the front end makes of the motion (corrected scores: Stefanski 1985; Nakamura
1990). What noise does to lengths is taken off in the end, see :mod:`encoder_noise`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.front_end import transfer
from skin2urdf.estimation.trajectory.kinematics import felt_of_joints
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.state import Layout, MotionState
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

EVERY = 10
"""Kept samples of which one stands for all: some three a second, in which a robot hardly turns."""


@dataclass(frozen=True, eq=False)
class Shaken(Record):
    """What encoders' noise makes of the predicted readings of U SUs, before their front ends.

    Attributes:
        w: (F,) angular frequencies [rad/s].
        chi2: (F, U) by how much chi-squared is larger for it, frequency by frequency.
    """

    w: F64
    chi2: F64

    @staticmethod
    def of(
        tree: KinematicTree, logs: Sequence[Trajectory], state: MotionState, weights: Sequence[F64]
    ) -> Shaken:
        """Of logs at a state.

        Args:
            tree: the structure.
            logs: the trajectories.
            state: where.
            weights: per log (K, U, 3) information of each sample [s^4/m^2]; gyroscopes' behind it.
        """
        parts = []
        for log, w in zip(logs, weights, strict=True):
            if log.noise is None:
                continue
            frequencies, shares = log.noise_spectrum()
            shaking = _squares_of_some(tree, log, log.noise, state.placements)
            counted = EVERY * np.einsum("ku,uk->u", w[::EVERY, :, 0], shaking)
            parts.append((frequencies, shares[:, None] * counted))
        if not parts:
            return Shaken(np.zeros(0), np.zeros((0, tree.n_sus)))
        return Shaken(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def cut_off(self, front: F64) -> float:
        """What front ends (U, 2) take of chi-squared by cutting noise off."""
        H, _ = transfer(self.w, front)
        return float((_kept_less(np.abs(H) ** 2)[0] * self.chi2).sum())

    def taken_off(self, equations: Equations, layout: Layout, front: F64) -> Equations:
        """Normal equations without what front ends (U, 2) gain by cutting noise off.

        Args:
            equations: of the samples.
            layout: where coordinates stand.
            front: front ends (U, 2) where they are.
        """
        pull = self.pull(layout, front)
        return replace(equations, su_gradient=equations.su_gradient + pull)

    def pull(self, layout: Layout, front: F64) -> F64:
        """(U, n) that part of the gradient, at front ends (U, 2)."""
        H, slopes = transfer(self.w, front)
        out = np.zeros((len(front), layout.n_su))
        _, less = _kept_less(np.abs(H) ** 2)
        out[:, layout.front] = np.einsum("fu,nfu->un", less * self.chi2, (H.conj() * slopes).real)
        return out


def _kept_less(kept: F64) -> tuple[F64, F64]:
    """How much less of noise is kept than there is, and by how much it falls as more is kept.

    Args:
        kept: parts (F, U) of the noise's squares that front ends keep; more than all where these
            rise. Of what rises the rest can be no more than all: noise that is known too large
            would else pay for sensors that rise without an end.
    """
    rises = kept > 1
    over = np.where(rises, kept, 1.0)
    return np.where(rises, 1 / over - 1, 1 - kept), over**-2.0


def made_by_encoders(tree: KinematicTree, log: Trajectory, places: State) -> F64 | None:
    """(U, K) variance of what encoders' noise makes of an axis of predicted readings [m^2/s^4].

    None where positions are exact.

    Args:
        tree: the structure.
        log: the trajectory.
        places: where joints and SUs are.
    """
    if log.noise is None:
        return None
    some = _squares_of_some(tree, log, log.noise, places) / 3
    return np.repeat(some, EVERY, axis=1)[:, : len(log.kept)]


def _squares_of_some(tree: KinematicTree, log: Trajectory, noise: F64, places: State) -> F64:
    """(U, k) mean squares of what encoders' noise (D,) makes of every so manieth sample."""
    q = log.q[log.kept[::EVERY], : tree.n_joints]
    shaking = log.shaken[::EVERY] * noise
    return np.asarray(np.einsum("kd,udk->uk", shaking, felt_of_joints(tree, places, q)))
