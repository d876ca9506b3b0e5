"""Activity: which SU is moved by which DoF, from static and dynamic evidence (paper II-B.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.records import Features, StaticMoves, Turns
from skin2urdf.structure.records import KinematicTree

STATIC_THRESHOLD = 0.05 * GRAVITY
"""Change of a static reading that makes an SU active, 0.05 g [m/s^2] (paper III)."""

CERTAIN = float(np.log(4.0))
"""Evidence beyond which a bit of the activity matrix is not doubted."""
_SMALLEST_STATIC = 0.1
"""Static evidence that noise alone may make, in thresholds."""
_SMALLEST_EFFECT = 2e-3
"""Effect of a pattern [m/s^2 rms] that is never taken for activity on its own."""
_SHARE = 0.3
"""Share of a DoF's largest static effect from which an SU counts as beyond it."""
_ALIKE = 0.75
"""Smallest static effect of the SUs beyond a DoF, over the largest."""
_SIGNIFICANT = 4.0
"""Standard deviations of chi-squared from which a pattern's effect is no chance."""
_UNMODELLED_FACTOR = 2.4
"""Doubt about an SU's effects, over what its regression leaves beyond noise."""
_LENGTH = 0.2
"""Error of the length of an axis that a gyroscope's scale, axes that turn with a pattern, and
joints that move alike may cause."""
_TELLS = 0.3
"""Standard deviation of such a length up to which it tells 1 from 0."""
_SECOND_ORDER = 0.3
"""Largest second-order effect of a pattern, over its first-order effect."""


@dataclass(frozen=True, eq=False)
class Activity(Record):
    """Activity matrix with its evidence.

    Attributes:
        su_names: U SU names.
        dof_names: D DoF names.
        static: (U, D) change of a static reading when that DoF moved, by and large alone, as all
            its moves together tell, over the threshold; NaN where no such move was recorded.
        dynamic: (U, D) what the reading owes to a DoF's pattern, over what chance and the
            second-order effects of other patterns can make; NaN where none was recorded.
        static_doubt: (D,) largest static evidence that noise and the small motions of other joints
            can have made.
        excited: (D,) False for DoFs that never moved.
        heard: (U,) False for SUs without data.
        turned: (U, D) logarithm of the evidence of gyroscopes that a DoF turns an SU; NaN where
            they do not tell. None without any.
    """

    su_names: tuple[str, ...]
    dof_names: tuple[str, ...]
    static: F64
    dynamic: F64
    static_doubt: F64
    excited: Bool
    heard: Bool
    turned: F64 | None = None

    @property
    def patterns_felt(self) -> bool:
        """Whether patterns of most joints that moved were felt around some pose.

        What is taken for a pattern of one joint or another may be the end of a move; estimates from
        patterns need those of nearly all joints, and logs without them have all their samples.
        """
        felt = np.nan_to_num(self.dynamic, nan=0.0).max(axis=0, initial=0.0) >= 1.0
        return bool(2 * (felt & self.excited).sum() > self.excited.sum())

    @property
    def evidence(self) -> F64:
        """(U, D) logarithm of the evidence: positive active, near zero undecided.

        A DoF that turns gravity turns it by the same angle in every SU beyond it: where the largest
        static effect stands out from doubt, all SUs are judged by how close they come to it.
        Dynamic evidence decides for the DoFs that turn no gravity in this log. An SU that was not
        recorded while a DoF moved is undecided, 0, and so are all where a DoF without dynamic
        evidence turns no gravity: its axis may be vertical. Gyroscopes decide where they tell: an
        SU turns with a joint or it does not, whatever the joint's axis is.
        """
        static = np.nan_to_num(self.static, nan=0.0)
        largest = static.max(axis=0, initial=0.0)
        relative = static / np.maximum(_SHARE * largest, 1e-12)
        # All that lies beyond a DoF is turned alike: figures in between come from something else.
        beyond = np.where(relative >= 1.0, relative * _SHARE, np.inf)
        alike = beyond.min(axis=0, initial=np.inf) > _ALIKE
        known = np.isfinite(self.static) & (largest >= self.static_doubt) & alike
        dynamic = np.nan_to_num(self.dynamic, nan=0.0)
        certain = static / np.maximum(self.static_doubt, 1.0)
        strongest = np.where(known, relative, np.maximum(certain, dynamic))
        told = np.isfinite(self.dynamic) | (np.isfinite(self.static) & (known | (certain >= 1.0)))
        felt = np.where(told, np.log(np.maximum(strongest, 1e-3)), 0.0)
        if self.turned is None:
            return felt
        # A sliding DoF turns no SU, those that it carries neither.
        return np.where(np.isfinite(self.turned) & self.turns, self.turned, felt)

    @property
    def turns(self) -> Bool:
        """(D,) True for DoFs with which an SU turns for certain, as its gyroscope says."""
        if self.turned is None:
            return np.zeros(len(self.dof_names), dtype=bool)
        told = np.nan_to_num(self.turned, nan=-np.inf)
        return np.asarray(told.max(axis=0, initial=-np.inf) > CERTAIN)

    @property
    def tested(self) -> Bool:
        """(U, D) False for SUs that were not recorded while a DoF moved."""
        tested = np.isfinite(self.static) | np.isfinite(self.dynamic)
        return tested if self.turned is None else np.asarray(tested | np.isfinite(self.turned))

    @property
    def matrix(self) -> Bool:
        """(U, D) activity matrix."""
        return np.asarray(self.evidence > 0)

    def felt_somewhere(self, dofs: Sequence[str]) -> Activity:
        """The same evidence, with given DoFs felt at least by the SU that shows most of them.

        A DoF that moved is felt by something, unless no SU sits beyond it.

        Args:
            dofs: names of DoFs.
        """
        dynamic = np.array(self.dynamic)
        for name in dofs:
            d = self.dof_names.index(name)
            if not self.tested[:, d].any():
                continue
            u = int(np.argmax(self.evidence[:, d]))
            dynamic[u, d] = np.fmax(dynamic[u, d], 1.01)
        return replace(self, dynamic=dynamic)

    def as_in(self, tree: KinematicTree) -> Activity:
        """The same evidence, with all SUs of a tree certainly moved by what moves them there."""
        at = np.ix_(
            [self.su_names.index(name) for name in tree.su_names],
            [self.dof_names.index(name) for name in tree.joint_names],
        )
        return self._told(at, tree.activity())

    def moved_by(self, su: str, dof: str, moved: bool) -> Activity:
        """The same evidence, with one SU certainly moved by a DoF, or certainly not."""
        at = np.ix_([self.su_names.index(su)], [self.dof_names.index(dof)])
        return self._told(at, np.array([[moved]]))

    def _told(self, at: tuple[Int, ...], moved: Bool) -> Activity:
        """The same evidence, where some of it ``at`` is for certain that SUs are moved, or not."""
        static, dynamic = np.array(self.static), np.array(self.dynamic)
        static[at] = np.nan
        dynamic[at] = np.exp(2 * CERTAIN * np.where(moved, 1.0, -1.0))
        turned = None if self.turned is None else np.array(self.turned)
        if turned is not None:
            turned[at] = np.nan
        return replace(self, static=static, dynamic=dynamic, turned=turned)


def activity(features: Features, threshold: float = STATIC_THRESHOLD) -> Activity:
    """Evidence for every SU and DoF.

    Several logs are combined by OR: evidence from any of them counts (paper II-B.1).

    Args:
        features: the measurements of all logs.
        threshold: change of a static reading that counts [m/s^2].
    """
    U, D = features.n_sus, features.n_dofs
    moves = features.moves
    static, static_doubt = _static(moves, D, threshold)
    significance, effect = np.zeros((U, D)), np.zeros((U, D))
    patterned, excited = np.zeros((U, D), dtype=bool), np.zeros(D, dtype=bool)
    finite = features.valid
    noise2 = np.where(finite[..., None], features.noise, 0.0) ** 2
    samples = features.information.diagonal()[:, :, 0] * finite
    total = np.maximum(samples.sum(axis=0), 1.0)
    residual2 = (noise2.mean(axis=-1) * samples).sum(axis=0) / total
    floor2 = np.where(finite, noise2.mean(axis=-1), np.inf).min(axis=0)
    floor2 = np.where(np.isfinite(floor2), floor2, 0.0)
    # Noise averages out; second-order effects of other DoFs' patterns do not.
    unmodelled = _UNMODELLED_FACTOR * np.sqrt(np.maximum(residual2 - 1.3 * floor2, 0.0))
    own = own_information(features)
    for d in range(D):
        c = features.coefficients[:, :, [1 + d, 1 + D + d]]
        info = own[:, :, d]
        seen = (np.einsum("puii->pu", info) > 0) & finite & features.left[:, None]
        excited[d] = bool(seen.any()) or bool((moves.dof == d).any())
        if len(moves.moved):
            excited[d] = moves.moved[d]
        patterned[:, d] = seen.any(axis=0)
        explained = np.einsum("puia,puij,puja->pu", c, info, c) * seen
        variance = noise2.mean(axis=-1) * seen
        chance = 6 * variance.sum(axis=0)
        freedom = np.maximum(6.0 * seen.sum(axis=0), 1.0)
        ratio = explained.sum(axis=0) / np.maximum(chance, 1e-300)
        felt = (ratio - 1) * np.sqrt(freedom / 2) / _SIGNIFICANT
        significance[:, d] = np.where(seen.any(axis=0), np.maximum(felt, 0.0), 0.0)
        weight = np.maximum((samples * seen).sum(axis=0), 1.0)
        effect[:, d] = np.sqrt(np.maximum(explained.sum(axis=0) - chance, 0.0) / weight)
    doubt = np.minimum(unmodelled[:, None], _SECOND_ORDER * _largest_other(effect))
    dynamic = np.minimum(significance, effect / (_SMALLEST_EFFECT + doubt))
    dynamic[~patterned] = np.nan
    return Activity(
        su_names=features.su_names,
        dof_names=features.dof_names,
        static=static,
        dynamic=dynamic,
        static_doubt=static_doubt,
        excited=excited,
        heard=np.asarray(finite.any(axis=0)),
        turned=None if features.turns is None else _turned(features.turns),
    )


def _turned(turns: Turns) -> F64:
    """(U, D) logarithm of the odds that SUs turn with DoFs, from lengths of 1 or 0."""
    variance = turns.deviation**2 + _LENGTH**2
    odds = np.clip((2 * turns.length - 1) / (2 * variance), -2 * CERTAIN, 2 * CERTAIN)
    return np.where(turns.deviation < _TELLS, odds, np.nan)


def _static(moves: StaticMoves, n_dofs: int, threshold: float) -> tuple[F64, F64]:
    """What the moves of each DoF say together: a regression on how far each turns gravity.

    A move turns gravity alike in all SUs beyond the DoF, by as much as in the one that shows most,
    and not at all in the others. So an SU's changes are regressed on the largest of each move,
    moves in which other joints took part counting less.

    Args:
        moves: S moves, U SUs.
        n_dofs: number D of DoFs.
        threshold: change of a static reading that counts [m/s^2].

    Returns:
        (U, D) changes over the threshold, NaN for SUs without readings, and (D,) what noise and the
        other joints can have made of them.
    """
    size = np.linalg.norm(moves.change, axis=-1)
    static, doubt = np.full((size.shape[1], n_dofs), np.nan), np.ones(n_dofs)
    for d in np.unique(moves.dof):
        mine = moves.dof == d
        heard = np.isfinite(size[mine])
        felt = np.where(heard, size[mine], 0.0)
        largest = felt.max(axis=1, initial=0.0)
        others = moves.doubt[mine]
        certain = largest / (others**2 + (_SMALLEST_STATIC * threshold) ** 2)
        known = certain @ (heard * largest[:, None])
        # An SU may have been recorded in moves alone that turned gravity by little.
        scale = (heard * largest[:, None]).max(axis=0, initial=0.0) / threshold
        ratio = np.divide(certain @ felt, known, out=np.zeros_like(known), where=known > 0)
        static[:, d] = np.where(heard.any(axis=0), ratio * scale, np.nan)
        share = float(certain @ others) / max(float(certain @ largest), 1e-12)
        doubt[d] = _SMALLEST_STATIC + 3 * share * float(scale.max(initial=0.0))
    return static, doubt


def _largest_other(effect: F64) -> F64:
    """(U, D) largest effect on each SU of all DoFs but one."""
    if effect.shape[1] < 2:
        return np.zeros_like(effect)
    largest = np.sort(effect, axis=1)
    is_largest = np.arange(effect.shape[1]) == effect.argmax(axis=1)[:, None]
    return np.where(is_largest, largest[:, -2:-1], largest[:, -1:])


def own_information(features: Features) -> F64:
    """(P, U, D, 2, 2) information on s_d and tau_d of each DoF, all other coefficients unknown."""
    D, information = features.n_dofs, features.information
    G, gain = information.factor, information.gain
    size = np.sqrt(np.einsum("kij,kij->ki", G, G))
    unit = np.divide(G, size[..., None], out=np.zeros_like(G), where=size[..., None] > 0)
    inverse = np.linalg.pinv(unit, rcond=_DEPENDENT)
    spread = np.divide(1.0, gain, out=np.zeros_like(gain), where=gain > 0)[..., None]
    rows = np.stack([1 + np.arange(D), 1 + D + np.arange(D)], axis=1)
    out = np.zeros((*information.which.shape, D, 2, 2))
    for d in range(D):
        back = inverse[:, :, rows[d]][information.which]
        covariance = np.swapaxes(back, -1, -2) @ (spread * back)
        # Rows of s and tau that are one and the same to the eye still have an inverse.
        own = np.einsum("puii->pui", covariance)
        ridge = np.where(own > 0, _DEPENDENT**2 * own, 1.0)
        out[:, :, d] = np.linalg.inv(covariance + ridge[..., None] * np.eye(2))
    root = (size[information.which] * information.weight)[:, :, rows]
    return np.asarray(out * root[..., :, None] * root[..., None, :])


_DEPENDENT = 3e-5
"""Relative size of a combination of regressors below which it counts as not excited."""
