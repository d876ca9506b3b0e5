"""What a fit of all samples is worth: its information, and the covariance that residuals show.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.cost import NormalEquations
from skin2urdf.estimation.problem.residuals import columns_of
from skin2urdf.estimation.problem.state import N_JOINT, N_SU
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse, newton_step
from skin2urdf.estimation.trajectory.clusters import Clusters, clusters
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem, parts_of
from skin2urdf.estimation.trajectory.state import Layout
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance
from skin2urdf.model.prediction import Chains

_DRAWS = 16
"""Versions with independent noise; their mean is known to a few per cent."""
_COMMON = 20.0
"""Clusters' worth of evidence that the ratio of all coordinates counts for in that of each. A ratio
from C clusters scatters by the root of 2 / C, 30 % with that many: about as much as ratios differ
from coordinate to coordinate in recordings with nothing but noise of encoders and sensors."""


@dataclass(frozen=True, eq=False)
class MotionInformation:
    """Information of a fit on placements, bias and shape, and what disturbs it.

    Coordinates x are those of joints and logs, z what all SUs share beyond them (gravity's size,
    numbers of unseen motion), y those of each SU (placement, bias, shape), whatever its clock and
    front end are.

    Attributes:
        equations: information on x and y for known z, without the prior on offsets.
        shared: (Z, Z) information on z, and
        shared_joint: (Z, J), and
        shared_su: (U, 15, Z) its coupling with x and with y.
        defects: pulls of what the fit lacks, and the readings do not rule out.
        rounding: pulls of what encoders round off, drawn anew.
        errors: pulls of spans of time with the residuals as they are, and
        draws: with independent noise.
        prior_xz: (U, Q, J + Z) pulls of what is known of each SU before, on x and z, and
        prior_y: (U, Q, 15) on y.
        clusters: which parts of the time the errors are of.
        moments: (M, J) pulls of moments on x for known z, whatever the SUs are.
        kinds: (J,), (U, 15) and (Z,) kind of each coordinate: offset, turn, bias, scale ..
        shares: (S, J), (S, U, 15) and (S, Z) share of the information on each coordinate that a
            part has.
        prior_joint: (J + Z,) information on x and z that is known before.
    """

    equations: NormalEquations
    shared: F64
    shared_joint: F64
    shared_su: F64
    defects: Pulls
    rounding: Pulls
    errors: Pulls
    draws: tuple[Pulls, ...]
    prior_xz: F64
    prior_y: F64
    clusters: Clusters
    moments: F64
    kinds: tuple[Int, Int, Int]
    shares: tuple[F64, F64, F64]
    prior_joint: F64


@dataclass(frozen=True, eq=False)
class Pulls:
    """Pulls of E independent errors.

    Attributes:
        x: (E, J) on the coordinates of joints and logs.
        z: (E, Z) on what all share.
        y: (U, E, 15) on those of the SUs.
    """

    x: F64
    z: F64
    y: F64

    def times(self, factor: float) -> Pulls:
        """Errors that are larger by a factor."""
        return Pulls(factor * self.x, factor * self.z, factor * self.y)

    def along(self, axes: F64) -> Pulls:
        """The same on other numbers that all share: axes (Z, Z) times these are the former."""
        return replace(self, z=self.z @ axes)

    def together(self, label: Int) -> Pulls:
        """Sums of errors that go together, as they have the same label (E,)."""
        return Pulls(
            _summed(self.x, label),
            _summed(self.z, label),
            np.swapaxes(_summed(np.swapaxes(self.y, 0, 1), label), 0, 1),
        )


def motion_information(
    problem: MotionProblem,
    fitted: Fitted,
    defects: Sequence[tuple[F64, F64]] = (),
    rounding: tuple[F64, F64] | None = None,
    *,
    misfit: float = 1.0,
) -> MotionInformation:
    """Information and disturbances at the end of a fit.

    Args:
        problem: what was fitted.
        fitted: the fit.
        defects: parts (J,) and (U, n) of the gradient, each by something that the fit lacks, of the
            size that the readings give it.
        rounding: (R, J) and (R, U, n) parts of the gradient, each by what encoders might have
            rounded off; None where they round nothing off.
        misfit: what the fit leaves over spans of time, over what noise makes of it; what is beyond
            1 makes all errors larger.
    """
    layout, tree, full = problem.layout, problem.tree, fitted.equations
    free_joint, free_su = problem.free_joint, problem.free_su
    J, own = layout.gravity, slice(N_SU, layout.n_su)
    # What an SU's clock and front end explain is taken off.
    both = free_su[:, own, None] & free_su[:, None, own]
    S = np.where(both, full.su[:, own, own], 0.0)
    index = np.arange(S.shape[1])
    S[:, index, index] += ~free_su[:, own]
    cross = np.where(free_su[:, None, own], full.su[:, :N_SU, own], 0.0)
    mixed = np.where(free_su[:, :, None] & free_joint, full.mixed, 0.0)
    follow = np.linalg.solve(S, np.concatenate([np.swapaxes(cross, 1, 2), mixed[:, own]], axis=2))
    by_y, by_x = follow[..., :N_SU], follow[..., N_SU:]
    su = full.su[:, :N_SU, :N_SU] - cross @ by_y
    coupling = mixed[:, :N_SU] - cross @ by_x
    joint = np.where(free_joint[:, None] & free_joint, full.joint, 0.0)
    joint -= np.einsum("unj,unk->jk", mixed[:, own], by_x)
    weight = problem.priors.sensors.position**-2.0
    held = N_JOINT * np.arange(tree.n_joints)[:, None] + np.arange(2)
    joint[held, held] -= weight
    su[:, range(3), range(3)] -= weight
    parts = clusters(tree, problem.logs)
    pulls, shares, moments = _errors(problem, fitted, parts, by_x, by_y)
    lacking = (
        np.array([joint for joint, _ in defects]).reshape(-1, layout.n_joint) * free_joint,
        np.array([own for _, own in defects]).reshape(-1, tree.n_sus, layout.n_su) * free_su,
    )
    none = np.zeros((0, layout.n_joint)), np.zeros((0, tree.n_sus, layout.n_su))
    off_joint, off_su = none if rounding is None else rounding
    joint_prior, su_prior, _, _ = problem.prior_information(fitted.state)
    scores = _roots(np.where(free_su[:, :, None] & free_su[:, None, :], su_prior, 0.0))
    chains = Chains.of(tree)
    columns = columns_of(chains, tree.n_joints, layout.n_logs)
    return MotionInformation(
        equations=NormalEquations(
            joint=joint[:J, :J],
            su=su,
            mixed=_of_chains(coupling[..., :J], columns, chains),
            columns=columns,
        ),
        shared=joint[J:, J:] + np.diag(~free_joint[J:] * 1.0),
        shared_joint=joint[J:, :J],
        shared_su=coupling[..., J:],
        defects=_pulls(*lacking, by_x, by_y, J),
        rounding=_pulls(off_joint * free_joint, off_su * free_su, by_x, by_y, J),
        errors=pulls[0].times(np.sqrt(max(1.0, misfit))),
        draws=tuple(pulls[1:]),
        prior_xz=-scores[..., N_SU:] @ by_x,
        prior_y=scores[..., :N_SU] - scores[..., N_SU:] @ by_y,
        clusters=parts,
        moments=moments,
        kinds=_kinds(layout, tree.n_sus),
        shares=shares,
        prior_joint=np.where(free_joint, joint_prior, 0.0),
    )


def _errors(
    problem: MotionProblem, fitted: Fitted, parts: Clusters, by_x: F64, by_y: F64
) -> tuple[list[Pulls], tuple[F64, F64, F64], F64]:
    """Pulls of parts of the time in every version, after a fit to it.

    Args:
        problem: what was fitted.
        fitted: the fit.
        parts: of the time.
        by_x: (U, m, J + Z) and
        by_y: (U, m, 15) how an SU's clock and front end follow the rest.

    Returns:
        Pulls of each version; shares (S, J), (S, U, 15) and (S, Z) of the information that each
        part has; (M, J) pulls of moments on x, whatever the SUs are.
    """
    layout, U, full = problem.layout, problem.tree.n_sus, fitted.equations
    free_joint, free_su, J = problem.free_joint, problem.free_su, layout.gravity
    dx, dy = _steps(problem, fitted)
    S, V = len(parts.place), len(dx)
    x, y = np.zeros((V, S, layout.n_joint)), np.zeros((U, V, S, N_SU))
    on_joint, on_su = np.zeros((S, layout.n_joint)), np.zeros((S, U, N_SU))
    moments = np.zeros((J, 1 + max(int(each.max()) for each in parts.moments)))
    lean = eliminated(full.of_joint(np.arange(J)), free_joint[:J], free_su).lean
    samples = [parts_of(members) for members in parts.members]
    for rows in problem.versions(fitted.state, fitted.predicted, fitted.weights, V - 1):
        u, own, A = rows.su, np.array(rows.columns), rows.derivatives
        step, nj = np.concatenate([dx[:, own], dy[:, u]], axis=1), len(own)
        left = rows.residuals - np.tensordot(step, A, 1)
        which = np.array([s for s, _ in samples[rows.log]])
        scores, square = np.empty((V, len(which), len(A))), np.empty((len(which), len(A)))
        for i, (_, at) in enumerate(samples[rows.log]):
            part = A[:, :, at].reshape(len(A), -1)
            np.matmul(left[:, :, at].reshape(V, -1), part.T, out=scores[:, i])
            np.einsum("ck,ck->c", part, part, out=square[i])
        of_su = np.where(free_su[u], scores[..., nj:], 0.0)
        x[:, which[:, None], own] += scores[..., :nj]
        x[:, which] -= of_su[..., N_SU:] @ by_x[u]
        y[u][:, which] += of_su[..., :N_SU] - of_su[..., N_SU:] @ by_y[u]
        on_joint[which[:, None], own] += square[:, :nj]
        on_su[which, u] += square[:, nj : nj + N_SU]
        moment = parts.moments[rows.log]
        first = np.flatnonzero(np.diff(moment, prepend=-1))
        pull = np.einsum("cik,ik->ck", A, rows.residuals[0])
        pull, here = np.add.reduceat(pull, first, axis=1), own < J
        moments[np.ix_(own[here], moment[first])] += pull[:nj][here]
        moments[:, moment[first]] += lean[u].T @ pull[nj:]
    x = np.where(free_joint, x, 0.0)
    pulls = [Pulls(x[v, :, :J], x[v, :, J:], y[:, v]) for v in range(V)]
    shares = _shares(on_joint[:, :J]), _shares(on_su), _shares(on_joint[:, J:])
    return pulls, shares, moments.T * free_joint[:J]


def _steps(problem: MotionProblem, fitted: Fitted) -> tuple[F64, F64]:
    """Steps (V, J + Z) and (V, U, n) from a fit to that of every version."""
    full, free_joint = fitted.equations, problem.free_joint
    # The estimate itself is off the optimum where the noise of encoders was taken off.
    joint = np.tile(full.joint_gradient, (1 + _DRAWS, 1))
    su = np.tile(full.su_gradient, (1 + _DRAWS, 1, 1))
    joint[1:], su[1:] = 0.0, 0.0
    for rows in problem.versions(fitted.state, fitted.predicted, fitted.weights, _DRAWS):
        drawn, nj = (
            np.tensordot(rows.residuals[1:], rows.derivatives, ((1, 2), (1, 2))),
            len(rows.columns),
        )
        joint[1:, rows.columns] += drawn[:, :nj]
        su[1:, rows.su] += drawn[:, nj:]
    system = eliminated(full, free_joint, problem.free_su)
    steps = [
        newton_step(
            replace(
                system,
                gradient=np.where(free_joint, g, 0.0) + np.einsum("unj,un->j", system.lean, own),
                own=np.einsum("unm,um->un", system.su_inverse, own),
            ),
            free_joint,
        )
        for g, own in zip(joint, su, strict=True)
    ]
    return np.array([x for x, _ in steps]), np.array([y for _, y in steps])


def _pulls(joint_scores: F64, su_scores: F64, by_x: F64, by_y: F64, J: int) -> Pulls:
    """Pulls on x, z and y of gradients in all coordinates, the rest following."""
    nuisance = su_scores[..., N_SU:]
    both = joint_scores - np.einsum("eum,umj->ej", nuisance, by_x)
    y = su_scores[..., :N_SU] - np.einsum("eum,umi->eui", nuisance, by_y)
    return Pulls(both[:, :J], both[:, J:], np.swapaxes(y, 0, 1))


def _roots(information: F64) -> F64:
    """(U, n, n) rows whose products add up to information matrices (U, n, n)."""
    lam, V = np.linalg.eigh(information)
    return np.swapaxes(V * np.sqrt(np.maximum(lam, 0.0))[:, None, :], 1, 2)


def _kinds(layout: Layout, n_sus: int) -> tuple[Int, Int, Int]:
    """Kinds of coordinates (J,), (U, 15) and (Z,): offsets, turns, biases, scales, cross axes."""
    of_joints = np.ones(layout.gravity, dtype=np.int64)  # gravity turns in every log
    of_joints[layout.joints] = np.arange(N_JOINT * layout.n_joints) % N_JOINT // 2
    of_sus = np.tile(np.arange(N_SU) // 3, (n_sus, 1))
    return of_joints, of_sus, np.zeros(layout.n_joint - layout.gravity, dtype=np.int64)


def _shares(information: F64) -> F64:
    """Share (S, ...) that each part has of the sum."""
    total = information.sum(axis=0)
    return np.asarray(
        np.divide(information, total, out=np.zeros_like(information), where=total > 0)
    )


def _summed(values: F64, label: Int) -> F64:
    """(n, ...) sums of values (E, ...) of the same label (E,)."""
    out = np.zeros((int(label.max(initial=-1)) + 1, *values.shape[1:]))
    np.add.at(out, label, values)
    return out


def _of_chains(mixed: F64, columns: Int, chains: Chains) -> F64:
    """(U, 15, C) coupling with the columns of each SU's chain; padded columns couple with zero."""
    out = np.take_along_axis(mixed, columns[:, None, :], axis=2)
    present = np.repeat(chains.present, N_JOINT, axis=1)
    out[:, :, : present.shape[1]] *= present[:, None, :]
    return np.asarray(out)


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
    info = _along(info, axes)
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


def _along(info: MotionInformation, axes: F64) -> MotionInformation:
    """The same with other numbers that all share: axes (Z, Z) times these are the former."""
    J = info.shared_joint.shape[1]
    of_parts = info.shares[2] @ (np.diag(info.shared)[:, None] * axes**2)
    before = info.prior_joint
    return replace(
        info,
        shared=axes.T @ info.shared @ axes,
        shared_joint=axes.T @ info.shared_joint,
        shared_su=info.shared_su @ axes,
        defects=info.defects.along(axes),
        rounding=info.rounding.along(axes),
        errors=info.errors.along(axes),
        draws=tuple(each.along(axes) for each in info.draws),
        prior_xz=np.concatenate([info.prior_xz[..., :J], info.prior_xz[..., J:] @ axes], axis=2),
        shares=(*info.shares[:2], _shares(of_parts)),
        prior_joint=np.append(before[:J], before[J:] @ axes**2),
    )


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
        fewest = [
            (_summed(share, label) ** 2).sum(axis=0) for label in (parts.place, parts.stretch)
        ]
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
