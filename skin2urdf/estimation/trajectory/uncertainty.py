"""The covariance of a fit of all samples that its residuals show.

Weights take whitened residuals as independent of each other. They are not: an encoder's noise is
felt by all SUs beyond it, and is of high frequencies; whatever the model lacks stays for a while,
and comes back wherever the robot does the same again. What clusters of samples, at one place or one
after the other (:mod:`clusters`), contribute to the gradient, which the estimate has brought to a
sum of zero, shows how large such errors really are (the sandwich estimator: Huber 1967; Liang and
Zeger 1986). What the estimate bent itself to is missing in it. So it is held against what
independent noise leaves, drawn, fitted and added up alike: the ratio tells by how much errors are
larger or smaller than the weights say, coordinate by coordinate. That of clusters by place and that
of clusters by time are added, less that of parts that are alike in both. Where few clusters tell of
a coordinate, that of all joints' or all SUs' coordinates speaks for it.

No error is smaller than what encoders round off makes alone, see :mod:`rounded`.

Noise of encoders is felt by all SUs on a link alike, so that with many SUs it is nearly all of the
error, and by how much variances exceed those of the weights grows with their number. It is new at
every moment all the same. Whether errors come back is therefore told by what clusters show beyond
what moments do.

Where a fit leaves more than noise, errors of its clusters have a part in common that its estimate
has bent to, of unknown size. That is taken to be as much larger than what is seen of it as all that
is left is larger than noise (Birge 1932).

What goes with the motion in the same way all the time, as a base that yields to the robot's weight,
shows in no cluster: the estimate bends to it. What it would change is stated as well, as the
difference of two estimates of which neither can be ruled out (Hausman 1978), see :mod:`swaying`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import N_JOINT, N_SU
from skin2urdf.estimation.trajectory.arrow import joint_inverse
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.information import (
    MotionInformation,
    Pulls,
    motion_information,
    summed,
)
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance

_COMMON = 20.0
"""Clusters' worth of evidence that the ratio of all coordinates counts for in that of each. A ratio
from C clusters scatters by the root of 2 / C, 30 % with that many: about as much as ratios differ
from coordinate to coordinate in recordings with nothing but noise of encoders and sensors."""


@dataclass(frozen=True, eq=False)
class _Response:
    """How x, z and the SUs, for known x and z, answer to pulls.

    Attributes:
        weights: the inverse of the information on x and y for known z.
        lean: (U, 15, J) how each SU follows x.
        z_x: (Z, J) coupling of z and x, whatever the SUs are.
        own_z: (U, 15, Z) minus how each SU follows z.
        inverse_z: (Z, Z) covariance of z if the weights are right.
    """

    weights: ArrowCovariance
    lean: F64
    z_x: F64
    own_z: F64
    inverse_z: F64

    @staticmethod
    def of(weights: ArrowCovariance, info: MotionInformation) -> _Response:
        J = len(weights.joint)
        lean = np.zeros((len(weights.own), N_SU, J))
        for u, columns in enumerate(weights.columns):
            np.add.at(lean[u].T, columns, weights.lean[u].T)
        z_x = info.shared_joint + np.einsum("uiz,uij->zj", info.shared_su, lean)
        own_z = np.einsum("uij,ujz->uiz", weights.own, info.shared_su)
        left = info.shared - np.einsum("uiz,uiw->zw", info.shared_su, own_z)
        left -= z_x @ weights.joint @ z_x.T
        return _Response(weights, lean, z_x, own_z, np.linalg.inv(0.5 * (left + left.T)))

    @property
    def x_z(self) -> F64:
        """(J, Z) how x follows z."""
        return np.asarray(-self.weights.joint @ self.z_x.T)

    def to(self, pulls: Pulls) -> tuple[F64, F64, F64]:
        """Changes (E, J) of x for known z, (U, E, 15) of y for known x and z, and (E, Z) of z."""
        dx = (pulls.x + np.einsum("uei,uij->ej", pulls.y, self.lean)) @ self.weights.joint
        rest = pulls.z - np.einsum("uei,uiz->ez", pulls.y, self.own_z)
        return dx, pulls.y @ self.weights.own, (rest - dx @ self.z_x.T) @ self.inverse_z


def disturbed(weights: ArrowCovariance, info: MotionInformation) -> tuple[ArrowCovariance, float]:
    """The covariance of an estimate under the errors that the residuals show.

    What all SUs share beyond the joints (z) joins the joint part, behind the logs' coordinates.

    Args:
        weights: the inverse of the information on x and y for known z.
        info: the information and the errors.

    Returns:
        The covariance, and the variances that clusters show, over those of errors that are new at
        every moment, in the mean over the joints' coordinates.
    """
    axes = _axes(_Response.of(weights, info).inverse_z, info.prior_joint[len(weights.joint) :])
    info = info.along(axes)
    response = _Response.of(weights, info)
    known = _of_priors(response, info)
    by_joint, by_su, by_z = _widening(response, info)
    x_z, z = response.x_z, _scaled(response.inverse_z, known[2], by_z)
    apart = _scaled(weights.joint, known[0], by_joint)
    joint = np.block([[apart + x_z @ z @ x_z.T, x_z @ z], [z @ x_z.T, z]])
    dx, dy, dz = response.to(info.defects)
    lacking = np.hstack([dx + dz @ x_z.T, dz])
    joint += lacking.T @ lacking
    J, Z, U = len(apart), len(z), len(weights.own)
    columns = np.concatenate([weights.columns, np.tile(J + np.arange(Z), (U, 1))], axis=1)
    lean = np.concatenate([weights.lean, -response.own_z], axis=2)
    own = _scaled(weights.own, known[1], by_su) + np.einsum("uei,uej->uij", dy, dy)
    # Numbers again, as they were.
    back = np.linalg.inv(axes)
    joint[J:] = axes @ joint[J:]
    joint[:, J:] = joint[:, J:] @ axes.T
    lean[..., weights.lean.shape[2] :] = -response.own_z @ back
    told = np.diag(weights.joint) > 0
    noise = _of_noise(response, info)
    widening = float(by_joint[told].mean() / noise[told].mean()) if told.any() else 1.0
    return ArrowCovariance(joint, columns, lean, own), widening


def _axes(covariance: F64, known: F64) -> F64:
    """(Z, Z) numbers that all share, column by column, whose errors have nothing to do with others.

    Of loads, what makes the readings is known a thousand times better than each of them. A single
    one's errors, which are those of what hardly shows, must not widen the whole: by as much as they
    differ, numbers that make up for each other would do so no longer. In units of what is known
    before, what shows best comes apart from what shows least.

    Args:
        covariance: (Z, Z) if the weights are right.
        known: (Z,) information before; 0 for numbers that are not estimated.
    """
    some = np.flatnonzero(known > 0)
    scale = known[some] ** -0.5
    axes = np.eye(len(known))
    _, turn = np.linalg.eigh(covariance[np.ix_(some, some)] / np.outer(scale, scale))
    axes[np.ix_(some, some)] = scale[:, None] * turn
    return axes


def shared_covariance(problem: MotionProblem, fitted: Fitted, misfit: float) -> F64:
    """Covariance of what all SUs share beyond the joints, under the errors that residuals show.

    Args:
        problem: what was fitted.
        fitted: the fit.
        misfit: what it leaves over spans of time, over what noise makes of it.

    Returns:
        (Z, Z) of gravity's size and of the numbers of unseen motion.
    """
    info = motion_information(problem, fitted, misfit=misfit)
    full, _ = disturbed(_weights(problem, info), info)
    Z = len(info.shared)
    return np.asarray(full.joint[-Z:, -Z:])


def _weights(problem: MotionProblem, info: MotionInformation) -> ArrowCovariance:
    """Inverse of the information on joints (J,) and SUs (U, 15) for given shared numbers (Z,).

    Offsets of joints and places of SUs that nothing shows are held by what is known before [m].
    """
    equations = info.equations
    J, free_su = len(equations.joint), problem.free_su[:, :N_SU]
    weight = problem.priors.sensors.position**-2.0
    H, su = np.array(equations.joint), np.array(equations.su)
    held = N_JOINT * np.arange(problem.tree.n_joints)[:, None] + np.arange(2)
    H[held, held] += weight
    su[:, range(3), range(3)] += weight
    own = np.stack([joint_inverse(H_su, free) for H_su, free in zip(su, free_su, strict=True)])
    lean = -own @ equations.mixed
    columns = equations.columns
    back = np.swapaxes(equations.mixed, 1, 2) @ lean
    np.add.at(H, (columns[:, :, None], columns[:, None, :]), back)
    return ArrowCovariance(joint_inverse(H, problem.free_joint[:J]), columns, lean, own)


def _widening(response: _Response, info: MotionInformation) -> tuple[F64, F64, F64]:
    """By how much larger variances (J,), (U, 15) and (Z,) are than those of the weights."""
    shown, alone = _ratios(response, info), _by_rounding(response, info)
    x, y, z = (np.maximum(*each) for each in zip(shown, alone, strict=True))
    return x, y, z


def _of_noise(response: _Response, info: MotionInformation) -> F64:
    """Variances (J,) that noise of encoders and SUs makes, over those of independent noise.

    What is new at every moment is noise, as is what encoders round off; at least the independent
    noise of SUs is.
    """
    moments = ((info.moments @ response.weights.joint) ** 2).sum(axis=0)
    drawn = np.mean([_variances(response, each)[0] for each in info.draws], axis=0)
    over = np.divide(moments, drawn, out=np.ones_like(drawn), where=drawn > 1e-300)
    return np.asarray(np.maximum(np.maximum(over, _by_rounding(response, info)[0]), 1.0))


def _by_rounding(response: _Response, info: MotionInformation) -> list[F64]:
    """Variances that rounding alone makes, over those of the weights."""
    draws = max(len(info.rounding.x), 1)
    own = np.einsum("uii->ui", response.weights.own)
    weights = np.diag(response.weights.joint), own, np.diag(response.inverse_z)
    return [
        np.divide(seen / draws, expected, out=np.zeros_like(seen), where=expected > 0)
        for seen, expected in zip(_variances(response, info.rounding), weights, strict=True)
    ]


def _variances(response: _Response, pulls: Pulls) -> tuple[F64, F64, F64]:
    """Variances (J,) of x for known z, (U, 15) of y for known x and z, and (Z,) of z."""
    dx, dy, dz = response.to(pulls)
    return (dx**2).sum(axis=0), (dy**2).sum(axis=1), (dz**2).sum(axis=0)


def _ratios(response: _Response, info: MotionInformation) -> list[F64]:
    """By how much variances under the errors of clusters exceed those under independent noise.

    Args:
        response: how coordinates answer to errors.
        info: the errors.
    """
    parts = info.clusters
    by_place, by_time, by_both = (
        _excess(response, info, label)
        for label in (parts.place, parts.stretch, np.arange(len(parts.place)))
    )
    out = []
    for i, (share, kinds) in enumerate(zip(info.shares, info.kinds, strict=True)):
        ratio = np.maximum(by_place[i] + by_time[i] - by_both[i], 0.0)
        fewest = [(summed(share, label) ** 2).sum(axis=0) for label in (parts.place, parts.stretch)]
        known = share.sum(axis=0) > 0
        # Joints feel what all SUs beyond them share, each SU its own noise as well; turns and
        # biases are seen at rest, lengths while all moves.
        common = np.ones_like(ratio)
        for kind in np.unique(kinds):
            alike = known & (kinds == kind)
            if alike.any():
                common[alike] = ratio[alike].mean()
        count = np.where(known, 1 / np.maximum(np.max(fewest, axis=0), 1e-12), 0.0)
        out.append((_COMMON * common + count * ratio) / (_COMMON + count))
    return out


def _excess(response: _Response, info: MotionInformation, label: Int) -> list[F64]:
    """Variances of errors that go together by label (S,), over those of independent noise."""
    seen = _variances(response, info.errors.together(label))
    drawn = [_variances(response, each.together(label)) for each in info.draws]
    expected = [np.mean(each, axis=0) for each in zip(*drawn, strict=True)]
    return [
        np.divide(one, other, out=np.ones_like(other), where=other > 1e-300)
        for one, other in zip(seen, expected, strict=True)
    ]


def _scaled(covariance: F64, known: F64, ratio: F64) -> F64:
    """A covariance (..., n, n) with the part that data have in variances scaled by ratios (..., n).

    Args:
        covariance: what it is if the weights are right.
        known: (..., n) the part of the variances that was known before.
        ratio: of the data's part.
    """
    total = np.einsum("...ii->...i", covariance)
    left = np.minimum(known, total)
    factor = np.sqrt(
        np.divide(left + ratio * (total - left), total, out=np.ones_like(total), where=total > 0)
    )
    return np.asarray(covariance * factor[..., :, None] * factor[..., None, :])


def _of_priors(response: _Response, info: MotionInformation) -> tuple[F64, F64, F64]:
    """Variances as of :func:`_variances` that come from what was known before."""
    U, J = len(info.prior_y), info.shared_joint.shape[1]
    # What is known of an SU pulls on its own coordinates, and on those that all share.
    x = info.prior_xz[..., :J] + info.prior_y @ response.lean
    z = info.prior_xz[..., J:] - info.prior_y @ response.own_z
    dx = x @ response.weights.joint
    dz = (z - dx @ response.z_x.T) @ response.inverse_z
    own = ((info.prior_y @ response.weights.own) ** 2).sum(axis=1)
    joint, shared = (dx**2).sum(axis=(0, 1)), (dz**2).sum(axis=(0, 1))
    roots = np.diag(np.sqrt(info.prior_joint))[info.prior_joint > 0]
    nothing = np.zeros((U, len(roots), N_SU))
    dx, _, dz = response.to(Pulls(roots[:, :J], roots[:, J:], nothing))
    return joint + (dx**2).sum(axis=0), own, shared + (dz**2).sum(axis=0)
