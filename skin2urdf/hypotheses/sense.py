"""Joints that count the other way in another log than in the first, or in part of a log.

The sense of a joint is a convention: axis and joint turn the other way together. Between logs, and
between parts of a log, it is a contradiction: what one of them says of the robot predicts the
others, with the sense of every joint as it is, or turned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from skin2urdf.arrays import F64
from skin2urdf.calibration.rounds import take_features
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.geometry.so3 import cross
from skin2urdf.hypotheses.alone import alone, negated
from skin2urdf.hypotheses.attempts import Search, imitations
from skin2urdf.hypotheses.corrected import Corrected
from skin2urdf.hypotheses.measure import excess, explains
from skin2urdf.hypotheses.records import Attempt, Candidate
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.records import EncoderError, Features

_TELLS = 100.0
"""Chi-squared of both senses together from which an SU tells a joint's sense."""
FOLLOWED = 0.5
"""Chi-squared with one more joint turned, over that without, from which it is followed."""
TURNED = 0.1
"""Chi-squared with joints turned, over that with none, from which they are believed."""

_ABOUT = 72
"""Values that a joint may be mirrored about: 5 deg apart, from where gravity leads to the best."""


class Senses:
    """Encoders that count the other way in a later log than in the first."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """All joints that are turned in a later log, as the first log alone predicts it."""
        if len(search.plain.sampled) < 2 or (now is not None and explains(now.solution.found)):
            return []
        new = search.once("senses", lambda: self._turned(search))
        if not new or (now is not None and new[0] in now.amendments):
            return []
        joints = tuple(a.error.dof for a in new)
        drop = np.inf if now is None else excess(now.solution.found)
        instead = imitations(search, now, joints)
        return [Candidate("encoder sign", joints, new, drop, instead=instead)]

    def _turned(self, search: Search) -> tuple[Corrected, ...]:
        first = alone(search, 0)
        if first is None:
            return ()
        try:
            features = take_features(negated(search.plain, first.mirrored), search.clock)
        except InsufficientDataError:
            return ()
        return tuple(Corrected(error) for error in reversed_encoders(first.found, features))

    def findings(self, last: Attempt) -> Sequence[Fault]:  # noqa: ARG002
        """None of its own: they are told with the other errors of encoders."""
        return []


def reversed_encoders(first: Estimate, features: Features) -> Iterator[EncoderError]:
    """Encoders that count the other way in later logs.

    Args:
        first: an estimate from the first log alone.
        features: of all logs.
    """
    for log in np.unique(features.log[features.log > 0]):
        here = features.of_poses(np.flatnonzero(features.log == log))
        turned: list[str] = []
        before = now = _misfit(first, here)
        for _ in first.tree.joint_names:
            left = [n for n in first.tree.joint_names if n not in turned]
            trials = [_misfit(first, _turned(here, [*turned, name])) for name in left]
            best = int(np.argmin(trials))
            if trials[best] > FOLLOWED * now:
                break
            now = trials[best]
            turned.append(left[best])
            if len(turned) == len(first.tree.joint_names):
                break
        if now < TURNED * before:
            yield from (EncoderError("sign", name, -1.0, int(log)) for name in turned)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What P poses say of the sense of D joints.

    Attributes:
        same: (P, D) chi-squared with each joint as it is, and
        turned: (P, D) with it counting the other way; 0 where a pose says nothing.
        about: (D,) sum of the positions with either sense [rad]; NaN where that is not known.
    """

    same: F64
    turned: F64
    about: F64

    @property
    def ratio(self) -> F64:
        """(P, D) the latter over the former, NaN where a pose does not tell.

        Below :data:`TURNED` the joint counts the other way.
        """
        tells = self.same + self.turned > _TELLS
        return np.where(tells, self.turned / np.maximum(self.same, 1e-300), np.nan)

    def with_more(self, other: Evidence) -> Evidence:
        """This and other, independent evidence."""
        about = np.where(np.isnan(self.about), other.about, self.about)
        return Evidence(self.same + other.same, self.turned + other.turned, about)


def felt_in_patterns(known: Estimate, features: Features) -> Evidence:
    """What poses say of the sense of joints by their patterns, as felt by an SU near the joint.

    The columns that a joint has in the Jacobian of an SU depend on the joints between the two
    alone; with gravity as the SU reads it, nothing that lies before the joint matters, the joint's
    own position included. So an encoder that is mirrored about any value is seen pose by pose.

    Args:
        known: an estimate from sound poses of the same robot.
        features: of P poses of one log.
    """
    cost = Cost(known.tree, feature_blocks(features, known.tree), known.cost.priors)
    state, blocks = replace(known.state, up=known.state.up[:1]), cost.blocks
    kin, M = cost.at(state).kin, state.sensor_matrix()
    L = blocks.chains.joint.shape[1]
    seen: F64 = np.array(blocks.coefficients)
    seen[:, :, 0] -= state.bias
    seen = np.asarray(np.linalg.solve(M, np.swapaxes(seen, -1, -2))).swapaxes(-1, -2)
    expected = np.concatenate([cross(seen[:, :, :1], kin.w), kin.v], axis=2)
    weight = 1 / (blocks.variance[:, :, 1:, None] * blocks.noise[:, :, None] ** 2)
    misfit = [
        (weight * (seen[:, :, 1:] - sense * expected) ** 2).sum(axis=-1) for sense in (1.0, -1.0)
    ]
    chi2 = np.array([part[:, :, :L] + part[:, :, L:] for part in misfit])
    out = np.zeros((2, features.n_poses, known.tree.n_joints))
    u, i = np.nonzero(blocks.chains.present)
    # Of the SUs beyond a joint, those with the fewest joints in between know it best.
    for k in np.argsort(i - blocks.chains.length[u], kind="stable"):
        both = chi2[:, :, u[k], i[k]]
        tells = both.sum(axis=0) > _TELLS
        out[:, tells, blocks.chains.joint[u[k], i[k]]] = both[:, tells]
    return Evidence(out[0], out[1], np.full(known.tree.n_joints, np.nan))


def felt_at_rest(known: Estimate, features: Features) -> Evidence:
    """What poses say of the sense of joints by gravity.

    A joint that counts the other way is mirrored about one value in all poses, namely that with
    which most poses follow from the one sense or the other. A log may begin with moves of single
    joints, which have no patterns, and a joint may turn before the first pattern.

    Args:
        known: an estimate from sound poses of the same robot.
        features: of P poses of one log.
    """
    blocks = feature_blocks(features, known.tree)
    model, M = known.state.model(known.tree), known.state.sensor_matrix()
    up = known.state.up[0] * known.cost.priors.gravity
    seen, weight = blocks.coefficients[:, :, 0], 1 / (blocks.variance[:, :, :1] * blocks.noise**2)
    P, D = blocks.q.shape

    def chi2(q: F64) -> F64:
        still = np.zeros_like(q)
        ideal = specific_forces(model, q, still, still, up).reshape(-1, P, known.tree.n_sus, 3)
        left = seen - known.state.bias - np.einsum("uij,npuj->npui", M, ideal)
        return np.asarray((weight * left**2).sum(axis=(-1, -2)))

    def mirrored(joint: int, about: F64) -> F64:
        q = np.tile(blocks.q, (len(about), 1, 1))
        q[:, :, joint] = about[:, None] - q[:, :, joint]
        return chi2(q.reshape(-1, D))

    plain = chi2(blocks.q)[0]
    out = Evidence(np.zeros((P, D)), np.zeros((P, D)), np.full(D, np.nan))
    grid = np.linspace(-np.pi, np.pi, _ABOUT, endpoint=False)
    for j in map(int, np.flatnonzero(~known.tree.prismatic)):

        def left(about: float, j: int = j) -> float:
            return float(np.minimum(mirrored(j, np.array([about]))[0], plain).sum())

        first = grid[np.argmin(np.minimum(mirrored(j, grid), plain).sum(axis=1))]
        step = 2 * np.pi / _ABOUT
        about = minimize_scalar(left, bounds=(first - step, first + step), method="bounded").x
        out.same[:, j], out.turned[:, j] = plain, mirrored(j, np.array([about]))[0]
        out.about[j] = about
    return out


def _turned(features: Features, names: list[str]) -> Features:
    """Features as they are where some joints count the other way."""
    D = features.n_dofs
    sign = np.ones(D)
    sign[[features.dof_names.index(name) for name in names]] = -1.0
    rows = np.concatenate([[1.0], sign, sign])
    return replace(
        features,
        q=features.q * sign,
        coefficients=features.coefficients * rows[:, None],
        information=features.information.scaled(rows),
        encoders=features.encoders.rescaled(sign),
    )


def _misfit(first: Estimate, features: Features) -> float:
    """Chi-squared of poses under another log's estimate, gravity taken from the readings."""
    cost = Cost(first.tree, feature_blocks(features, first.tree), first.cost.priors)
    state = replace(first.state, up=first.state.up[:1])
    kin = cost.at(state).kin
    sensed = cost.blocks.coefficients[:, :, 0] - state.bias
    true = np.linalg.solve(state.sensor_matrix(), sensed[..., None])
    seen = (cost.blocks.count > 0)[..., None]
    up = ((kin.R @ true)[..., 0] * seen).sum(axis=(0, 1))
    size = float(np.linalg.norm(up))
    if size < 1e-9:
        return np.inf
    return float(cost.at(replace(state, up=(up / size)[None])).chi2_by_block().sum())
