"""Normal equations in arrow form as they are summed up, SU by SU or link by link."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.links import LinkRows
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.rows import Beyond, Rows
from skin2urdf.estimation.trajectory.state import Layout

Block = tuple[slice, Int, F64]
"""Samples, columns (s,) of numbers of unseen motion, and derivatives (3 p, s, k) of a link's points
in these."""


@dataclass(frozen=True, eq=False)
class Sums:
    """What is summed up so far, without priors.

    Attributes:
        joint: (J, J), and
        su: (U, n, n), and
        mixed: (U, n, J) information.
        joint_gradient: (J,), and
        su_gradient: (U, n).
    """

    joint: F64
    su: F64
    mixed: F64
    joint_gradient: F64
    su_gradient: F64

    @staticmethod
    def nothing(layout: Layout, n_sus: int) -> Sums:
        """Of no readings."""
        J, n = layout.n_joint, layout.n_su
        return Sums(
            np.zeros((J, J)),
            np.zeros((n_sus, n, n)),
            np.zeros((n_sus, n, J)),
            np.zeros(J),
            np.zeros((n_sus, n)),
        )

    def equations(self) -> Equations:
        """All of it."""
        return Equations(self.joint, self.su, self.mixed, self.joint_gradient, self.su_gradient)

    def add(self, rows: Rows, beyond: Beyond | None) -> None:
        """Add what an SU reads in a log.

        Args:
            rows: its derivatives and residuals.
            beyond: what encoders do not see in that log.
        """
        u, A, r = rows.su, rows.by_coordinates, rows.residual
        columns = np.array(rows.columns)
        nj, flat = len(columns), A.reshape(len(A), -1)
        H, gradient = flat @ flat.T, flat @ r.ravel()
        self.joint[np.ix_(columns, columns)] += H[:nj, :nj]
        self.su[u] += H[nj:, nj:]
        self.mixed[u][:, columns] += H[nj:, :nj]
        self.joint_gradient[columns] += gradient[:nj]
        self.su_gradient[u] += gradient[nj:]
        for at, numbers, B in beyond.blocks(rows.joints, rows.by_motion) if beyond else ():
            own, others = B.reshape(len(B), -1), A[:, :, at].reshape(len(A), -1)
            H = own @ others.T
            self.joint[np.ix_(numbers, numbers)] += own @ own.T
            self.joint[np.ix_(numbers, columns)] += H[:, :nj]
            self.joint[np.ix_(columns, numbers)] += H[:, :nj].T
            self.mixed[u][:, numbers] += H[:, nj:].T
            self.joint_gradient[numbers] += own @ r[:, at].ravel()

    def add_joints(self, link: LinkRows, beyond: Beyond | None) -> list[Block]:
        """Add what all SUs of a link say of the joint part.

        Args:
            link: the SUs and the points that tell what they feel.
            beyond: what encoders do not see in that log.

        Returns:
            Derivatives of what the points feel in that.
        """
        columns = np.array(link.columns)
        P = _by_sample(link.by_coordinates)
        weighed = link.information @ P
        self.joint[np.ix_(columns, columns)] += _symmetric(_product(P, weighed))
        blocks = list(blocks_of(link, beyond))
        self.pull_joints(link, blocks)
        for at, numbers, B in blocks:
            own = _by_sample(B)
            H = _product(own, weighed[at])
            self.joint[np.ix_(numbers, columns)] += H
            self.joint[np.ix_(columns, numbers)] += H.T
            H = _product(own, link.information[at] @ own)
            self.joint[np.ix_(numbers, numbers)] += _symmetric(H)
        return blocks

    def add_sus(self, link: LinkRows, some: slice, own: F64, blocks: list[Block]) -> None:
        """Add what some SUs of a link say of their own parts, and how these go with the joints'.

        Args:
            link: the SUs and the points that tell what they feel.
            some: their places among the SUs.
            own: (s, n, 3, K) derivatives in their own coordinates.
            blocks: what :meth:`add_joints` gave.
        """
        sus, sensed = link.sus[some], link.sensed[some]
        columns = np.array(link.columns)
        weighed = own * link.weights[some, None]
        flat = weighed.reshape(*own.shape[:2], -1)
        self.su[sus] += _symmetric(flat @ own.reshape(flat.shape).swapaxes(1, 2))
        self.su_gradient[sus] += (flat @ link.residual[some].reshape(len(own), -1, 1))[..., 0]
        of_axes = weighed.swapaxes(1, 2)
        for at, of_numbers, P in [(slice(None), columns, link.by_coordinates), *blocks]:
            felt = sensed.reshape(-1, len(P)) @ P.reshape(len(P), -1)
            felt = felt.reshape(len(own), 3, *P.shape[1:])
            coupled = (of_axes[..., at] @ felt.swapaxes(2, 3)).sum(axis=1)
            self.mixed[np.ix_(sus, np.arange(own.shape[1]), of_numbers)] += coupled

    def pull_joints(self, link: LinkRows, blocks: Sequence[Block]) -> None:
        """Add what the residuals of all SUs of a link say of the joint part.

        Args:
            link: the SUs and the points that tell what they feel.
            blocks: what :func:`blocks_of` gives of the link.
        """
        pull = link.by_coordinates.swapaxes(0, 1).reshape(len(link.columns), -1)
        self.joint_gradient[link.columns] += pull @ link.pulls.T.ravel()
        for at, numbers, B in blocks:
            pull = B.swapaxes(0, 1).reshape(len(numbers), -1)
            self.joint_gradient[numbers] += pull @ link.pulls[at].T.ravel()

    def pull_sus(self, link: LinkRows, some: slice, own: F64) -> None:
        """Add what the residuals of some SUs of a link say of their own parts; as above."""
        pulled = (link.weights[some] * link.residual[some]).reshape(len(own), -1, 1)
        self.su_gradient[link.sus[some]] += (own.reshape(*own.shape[:2], -1) @ pulled)[..., 0]


def blocks_of(link: LinkRows, beyond: Beyond | None) -> Iterator[Block]:
    """Derivatives of what the points of a link feel, in numbers of unseen motion.

    Args:
        link: the link.
        beyond: what encoders do not see in that log.
    """
    for at, numbers, B in beyond.blocks(link.joints, link.by_motion) if beyond else ():
        yield at, numbers, np.ascontiguousarray(B.swapaxes(0, 1))


def _by_sample(x: F64) -> F64:
    """(k, p, c) of (p, c, k)."""
    return np.ascontiguousarray(np.moveaxis(x, 2, 0))


def _product(a: F64, b: F64) -> F64:
    """(c, d) sums over samples and points of products of (k, p, c) and (k, p, d)."""
    return np.asarray(a.reshape(-1, a.shape[2]).T @ b.reshape(-1, b.shape[2]))


def _symmetric(H: F64) -> F64:
    """(..., c, c) the same without what rounding leaves of a difference."""
    return 0.5 * (H + H.swapaxes(-1, -2))
