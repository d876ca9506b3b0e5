"""What a fit leaves of every link, as it is and as independent noise would be.

Errors that disturb a fit are told by what parts of the time contribute to its gradient, in many
versions. Of the joint part that is as much work for a link as for one SU on it, as SUs of one link
read the same few points: their residuals are put back on these first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.derivatives import Carried
from skin2urdf.estimation.trajectory.links import LinkRows
from skin2urdf.estimation.trajectory.normal_equations import Block, blocks_of
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.state import MotionState


@dataclass(frozen=True, eq=False)
class Versions:
    """Versions of what the SUs of a link leave at K samples of a log.

    Attributes:
        log: number of the log.
        blocks: derivatives of what p points of the link feel in the joint part, a stretch of time
            and some columns at a time; a gyroscope is a link of one SU, whose axes are the points.
        information: (K, 3 p, 3 p) of all the SUs on what the points feel.
        of_sus: the SUs, one after the other; where many, each is made when its turn comes.
    """

    log: int
    blocks: Sequence[Block]
    information: F64
    of_sus: Iterable[VersionsOfSu]


@dataclass(frozen=True, eq=False)
class VersionsOfSu:
    """Versions of what an SU leaves in a log.

    Attributes:
        su: number of the SU.
        sensed: (3, 3 p) what makes readings of what the p points of its link feel.
        root: (3, K) one over the standard deviation of each of its readings.
        own: (n, 3, K) whitened derivatives in its own coordinates.
        residuals: (V, 3, K) whitened residuals of V versions, the first as they are, the others
            independent noise of unit size.
    """

    su: int
    sensed: F64
    root: F64
    own: F64
    residuals: F64

    def reads(self, felt: F64) -> F64:
        """(V, 3, K) whitened readings of what the points feel (V, 3 p, K)."""
        return np.asarray(self.root * (self.sensed @ felt))

    def put_back(self, residuals: F64) -> F64:
        """(V, 3 p, K) what whitened residuals (V, 3, K) say of what the points feel."""
        return np.asarray(self.sensed.T @ (self.root * residuals))


def versions(
    problem: MotionProblem,
    state: MotionState,
    predicted: Sequence[Predicted],
    weights: Sequence[F64],
    n_draws: int,
) -> Iterator[Versions]:
    """Whitened residuals of every log, link and SU, and independent noise in their place.

    The noise is the same whenever this is asked for, so that it need not be kept.

    Args:
        problem: what was fitted.
        state: where.
        predicted: residuals of each log there.
        weights: per log (K, U, 3) information of each sample [s^4/m^2]; gyroscopes' behind it.
        n_draws: versions with noise.
    """
    rng, beyond = np.random.default_rng(0), problem.beyond()

    def drawn(residual: F64) -> F64:
        out = np.empty((1 + n_draws, *residual.shape))
        out[0] = residual
        rng.standard_normal(out=out[1:])
        return out

    for link, carried in problem.links(state, predicted, weights):
        further = blocks_of(link, beyond[link.log] if beyond else None)
        blocks = [(slice(None), np.array(link.columns), link.by_coordinates), *further]

        def of_sus(link: LinkRows = link, carried: Carried = carried) -> Iterator[VersionsOfSu]:
            for some, every in problem.own(state, link, carried):
                for i, own in zip(range(some.start, some.stop), every, strict=True):
                    root = np.sqrt(link.weights[i])
                    u, residuals = int(link.sus[i]), drawn(link.residual[i] * root)
                    yield VersionsOfSu(u, link.sensed[i], root, own * root, residuals)

        yield Versions(link.log, blocks, link.information, of_sus())
        for u in link.sus.tolist():
            for rows in problem.gyro_rows(state, link.log, u, carried):
                A, C, K = rows.by_coordinates, len(rows.columns), rows.residual.shape[1]
                alone = [(slice(None), np.array(rows.columns), A[:C].swapaxes(0, 1))]
                axes, residuals = np.eye(3), drawn(rows.residual)
                gyro = VersionsOfSu(u, axes, np.ones((3, K)), A[C:], residuals)
                yield Versions(link.log, alone, np.tile(axes, (K, 1, 1)), [gyro])
