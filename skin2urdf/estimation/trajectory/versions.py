"""What a fit leaves of every link, as it is and as independent noise would be.

Errors that disturb a fit are told by what parts of the time contribute to its gradient, in many
versions. Of the joint part that is as much work for a link as for one SU on it, as SUs of one link
read the same few points: their residuals are put back on these first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from skin2urdf.arrays import F64, Int
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
        n_sus: number of these.
        of_sus: what makes those of some of the SUs at a time, for several such at a time.
    """

    log: int
    blocks: Sequence[Block]
    information: F64
    n_sus: int
    of_sus: Iterable[Callable[[], VersionsOfSus]]

    def kept(self) -> Versions:
        """The same, made once and for all."""
        return replace(self, of_sus=[partial(_known, make()) for make in self.of_sus])


@dataclass(frozen=True, eq=False)
class VersionsOfSus:
    """Versions of what some SUs leave in a log.

    Attributes:
        sus: (s,) numbers of the SUs.
        sensed: (s, 3, 3 p) what makes readings of what the p points of their link feel.
        root: (s, 3, K) one over the standard deviation of each of their readings.
        own: (s, n, 3, K) whitened derivatives in their own coordinates.
        residuals: (V, s, 3, K) whitened residuals of V versions, the first as they are, the others
            independent noise of unit size.
    """

    sus: Int
    sensed: F64
    root: F64
    own: F64
    residuals: F64

    def reads(self, felt: F64) -> F64:
        """(V, s, 3, K) whitened readings of what the points feel (V, 3 p, K)."""
        read = self.sensed.reshape(-1, felt.shape[1]) @ felt
        return np.asarray(read.reshape(len(felt), *self.root.shape) * self.root)

    def put_back(self, residuals: F64) -> F64:
        """(V, 3 p, K) what whitened residuals (V, s, 3, K) say of what the points feel."""
        weighed = (residuals * self.root).reshape(len(residuals), -1, residuals.shape[-1])
        return np.asarray(self.sensed.reshape(weighed.shape[1], -1).T @ weighed)


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

    def drawn(residuals: F64) -> F64:
        out = np.empty((1 + n_draws, *residuals.shape))
        out[0] = residuals
        for u in range(len(residuals)):
            out[1:, u] = rng.standard_normal((n_draws, *residuals.shape[1:]))
        return out

    for link, carried in problem.links(state, predicted, weights):
        further = blocks_of(link, beyond[link.log] if beyond else None)
        blocks = [(slice(None), np.array(link.columns), link.by_coordinates), *further]

        def of_sus(
            link: LinkRows = link, carried: Carried = carried
        ) -> Iterator[Callable[[], VersionsOfSus]]:
            # Noise is drawn in the order of the SUs.
            for some, own in problem.own_parts(state, link, carried):
                root = np.sqrt(link.weights[some])
                yield partial(_made, link, some, root, own, drawn(link.residual[some] * root))

        yield Versions(link.log, blocks, link.information, len(link.sus), of_sus())
        for u in link.sus.tolist():
            for rows in problem.gyro_rows(state, link.log, u, carried):
                A, C, K = rows.by_coordinates, len(rows.columns), rows.residual.shape[1]
                alone = [(slice(None), np.array(rows.columns), A[:C].swapaxes(0, 1))]
                axes, residuals = np.eye(3), drawn(rows.residual[None])
                gyro = VersionsOfSus(
                    np.array([u]), axes[None], np.ones((1, 3, K)), A[None, C:], residuals
                )
                information = np.tile(axes, (K, 1, 1))
                yield Versions(link.log, alone, information, 1, [partial(_known, gyro)])


def _made(
    link: LinkRows, some: slice, root: F64, own: Callable[[], F64], residuals: F64
) -> VersionsOfSus:
    """Versions of some SUs of a link, whose derivatives are yet to be worked out."""
    whitened = own() * root[:, None]
    return VersionsOfSus(link.sus[some], link.sensed[some], root, whitened, residuals)


def _known(of_sus: VersionsOfSus) -> VersionsOfSus:
    """Those that are made already."""
    return of_sus
