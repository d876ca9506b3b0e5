"""Activity: which SU is moved by which DoF, from static and dynamic evidence (paper II-B.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, frozen
from skin2urdf.signals.records import Features

STATIC_THRESHOLD = 0.05 * 9.81
"""Change of a static reading that makes an SU active, 0.05 g [m/s^2] (paper III)."""

_SMALLEST_STATIC = 0.1
"""Static evidence that noise alone may make, in thresholds."""
_SMALLEST_EFFECT = 2e-3
"""Effect of a pattern [m/s^2 rms] that is never taken for activity on its own."""
_SHARE = 0.3
"""Share of a DoF's largest static effect from which an SU counts as beyond it."""
_NOISE_FACTOR = 0.32
_UNMODELLED_FACTOR = 2.4


@dataclass(frozen=True, eq=False)
class Activity:
    """Activity matrix with its evidence.

    Attributes:
        su_names: U SU names.
        dof_names: D DoF names.
        static: (U, D) largest change of a static reading when only that DoF moved, over the
            threshold; NaN where no such move was recorded.
        dynamic: (U, D) what the reading owes to a DoF's pattern, over what the regression leaves
            unexplained.
        static_doubt: (D,) largest static evidence that noise and the small motions of other joints
            can have made.
        excited: (D,) False for DoFs that never moved.
        heard: (U,) False for SUs without data.
    """

    su_names: tuple[str, ...]
    dof_names: tuple[str, ...]
    static: F64
    dynamic: F64
    static_doubt: F64
    excited: Bool
    heard: Bool

    def __post_init__(self) -> None:
        for name in ("static", "dynamic", "static_doubt"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("excited", "heard"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.bool_))

    @property
    def evidence(self) -> F64:
        """(U, D) logarithm of the evidence: positive active, near zero undecided.

        A DoF that turns gravity turns it by the same angle in every SU beyond it: where one SU
        passes the static threshold, the others are judged by how close they come to it. Dynamic
        evidence decides for the DoFs that turn no gravity in this log.
        """
        static = np.nan_to_num(self.static, nan=0.0)
        largest = static.max(axis=0, initial=0.0)
        relative = static / np.maximum(_SHARE * largest, 1e-12)
        known = np.isfinite(self.static) & (largest >= self.static_doubt)
        strongest = np.where(known, relative, np.maximum(static, self.dynamic))
        return np.asarray(np.log(np.maximum(strongest, 1e-3)))

    @property
    def matrix(self) -> Bool:
        """(U, D) activity matrix."""
        return np.asarray(self.evidence > 0)


def activity(features: Features, threshold: float = STATIC_THRESHOLD) -> Activity:
    """Evidence for every SU and DoF.

    Several logs are combined by OR: evidence from any of them counts (paper II-B.1).

    Args:
        features: the measurements of all logs.
        threshold: change of a static reading that counts [m/s^2].
    """
    U, D = features.n_sus, features.n_dofs
    static = np.full((U, D), np.nan)
    static_doubt = np.ones(D)
    moves = features.moves
    for d in range(D):
        mine = moves.dof == d
        if mine.any():
            size = np.linalg.norm(moves.change[mine], axis=-1)
            heard = np.isfinite(size).any(axis=0)
            static[heard, d] = np.nanmax(size[:, heard], axis=0) / threshold
            others = float(moves.doubt[mine].max()) / threshold
            static_doubt[d] = min(1.0, _SMALLEST_STATIC + 3 * others)
    dynamic = np.zeros((U, D))
    excited = np.zeros(D, dtype=bool)
    finite = features.valid
    noise2 = np.where(finite[..., None], features.noise, 0.0) ** 2
    samples = features.information[:, :, 0, 0] * finite
    total = np.maximum(samples.sum(axis=0), 1.0)
    residual2 = (noise2.mean(axis=-1) * samples).sum(axis=0) / total
    floor2 = np.where(finite, noise2.mean(axis=-1), np.inf).min(axis=0)
    floor2 = np.where(np.isfinite(floor2), floor2, 0.0)
    # Noise averages out; second-order effects of other DoFs' patterns do not.
    doubt = _NOISE_FACTOR * np.sqrt(floor2) + _SMALLEST_EFFECT
    doubt += _UNMODELLED_FACTOR * np.sqrt(np.maximum(residual2 - 1.1 * floor2, 0.0))
    for d in range(D):
        rows = np.array([1 + d, 1 + D + d])
        c = features.coefficients[:, :, rows]
        info = features.information[:, :, rows[:, None], rows]
        seen = (np.einsum("puii->pu", info) > 0) & finite
        excited[d] = bool(seen.any()) or bool((moves.dof == d).any())
        explained = np.einsum("puia,puij,puja->pu", c, info, c) * seen
        chance = 3 * 2 * noise2.mean(axis=-1) * seen
        weight = np.maximum((samples * seen).sum(axis=0), 1.0)
        effect = np.sqrt(np.maximum((explained - chance).sum(axis=0), 0.0) / weight)
        dynamic[:, d] = np.where(seen.any(axis=0), effect / doubt, 0.0)
    return Activity(
        features.su_names, features.dof_names, static, dynamic, static_doubt, excited,
        np.asarray(finite.any(axis=0)),
    )  # fmt: skip
