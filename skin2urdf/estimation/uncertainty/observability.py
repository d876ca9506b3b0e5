"""What the log determines: covariances, directions it says nothing about, verdicts.

Everything follows from the rank and the inverse of the weighted Jacobian at the estimate, never
from a list of cases. A direction counts as not observable where the data alone would leave it
uncertain by more than :data:`~skin2urdf.estimation.uncertainty.covariance.UNKNOWN`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.estimation.problem.cost import NormalEquations, Priors
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, N_SU, Free, State
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.solve.spread import learnt_hidden
from skin2urdf.estimation.trajectory.information import MotionInformation
from skin2urdf.estimation.trajectory.uncertainty import disturbed
from skin2urdf.estimation.uncertainty.bounds import Align, expected_errors
from skin2urdf.estimation.uncertainty.covariance import UNKNOWN, ArrowCovariance
from skin2urdf.estimation.uncertainty.open_directions import ALIKE, open_directions
from skin2urdf.estimation.uncertainty.shared_errors import with_shared_errors
from skin2urdf.model.records import OpenDirection
from skin2urdf.structure.records import KinematicTree

Verdict = Literal["determined", "weak", "not observable"]

ARM = 0.1
"""Length [m] by which the angular part of a direction is multiplied where directions are given."""
WEAK = 0.005
"""Standard deviation [m or rad] beyond which a direction is weak: 5 mm, 0.3 deg."""
_LIMITED = 0.5
"""Standard deviation [rad] up to which a turn is limited by what sensors' errors can be: a larger
one is no small turn, as which it was linearised, and next to nothing is known of it."""
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Observability(Record):
    """Uncertainty of an estimate.

    Twists are (linear, angular) in the local frame of the placement they move,
    ``T -> T exp(xi)``.

    Attributes:
        su_covariance: (U, 6, 6) covariance of each SU's placement on its joint [m, rad], without
            the directions that are not observable.
        su_unobservable: per SU (k, 6) orthonormal directions (linear [m], angular times ARM)
            along which the log says nothing about the SU's placement on its joint.
        su_hidden_turn: (U,) standard deviation of the turns among them, as large as the errors of
            sensors that hide them can be [rad]; 0 where none is hidden, and for a turn that nothing
            limits.
        su_verdict: per SU; of what recordings tell, which the turn that cross-axis errors hide
            is not.
        joint_covariance: (D, 4, 4) covariance of each joint's local coordinates tx, ty, rx, ry.
        joint_verdict: per joint; "not observable" for those that an open direction moves.
        open_directions: independent ways in which branches may sit elsewhere relative to the rest
            of their limb, beyond what ``su_unobservable`` has.
        rank: number of determined coordinates.
        hidden_rotation: standard deviation per axis of the rotation of an SU's frame that
            cross-axis errors hide [rad]; part of ``su_covariance`` and ``covariance``.
        covariance: covariance of all coordinates.
        widening: by how much variances exceed those that noise of SUs and encoders would make, in
            the mean over the joints.
    """

    su_covariance: F64
    su_unobservable: tuple[F64, ...]
    su_hidden_turn: F64
    su_verdict: tuple[Verdict, ...]
    joint_covariance: F64
    joint_verdict: tuple[Verdict, ...]
    open_directions: tuple[OpenDirection, ...]
    rank: int
    hidden_rotation: float
    covariance: ArrowCovariance
    widening: float

    @property
    def n_open(self) -> int:
        """Number of open directions between branches."""
        return len(self.open_directions)


def observability(estimate: Estimate, along: MotionInformation | None = None) -> Observability:
    """Covariances and verdicts at an estimate.

    Covariances are those of the weights, times the residual-based scale (cost per degree of
    freedom) where that is above 1.
    """
    subject = Subject(
        tree=estimate.tree,
        state=estimate.state,
        free=estimate.free,
        q=estimate.cost.blocks.q,
        priors=along.sensors if along else estimate.cost.priors,
        given=estimate.given,
    )

    def hidden(stated: ArrowCovariance) -> float:
        variance = np.einsum("uii->ui", stated.su())
        return learnt_hidden(subject.priors, subject.state, variance, subject.free)

    if along:
        return _judged(subject, along.equations, lambda w: disturbed(w, along), 1.0, hidden)
    scale = max(1.0, estimate.cost_per_dof)

    def widened(weights: ArrowCovariance) -> tuple[ArrowCovariance, float]:
        return with_shared_errors(weights, estimate.cost, estimate.state).scaled(scale), scale

    return _judged(subject, _of_the_data(estimate), widened, scale, hidden)


@dataclass(frozen=True, eq=False)
class Subject:
    """An estimate that is judged.

    Attributes:
        tree: D joints and U SUs.
        state: the estimate.
        free: coordinates that were estimated.
        q: (C, D) configurations of the logs.
        priors: of the sensors, with all of them seen.
        given: what was known of them before.
    """

    tree: KinematicTree
    state: State
    free: Free
    q: F64
    priors: Priors
    given: Priors


def observability_along(subject: Subject, along: MotionInformation) -> Observability:
    """Covariances and verdicts of a fit of all samples, of sensors that are as the priors say.

    Args:
        subject: the estimate.
        along: what the samples tell.
    """
    hidden = subject.priors.hidden_rotation
    return _judged(
        subject, along.equations, lambda weights: disturbed(weights, along), 1.0, lambda _: hidden
    )


def _judged(
    subject: Subject,
    equations: NormalEquations,
    widened: Callable[[ArrowCovariance], tuple[ArrowCovariance, float]],
    scale: float,
    hidden_by: Callable[[ArrowCovariance], float],
) -> Observability:
    """Covariances and verdicts from information.

    Args:
        subject: the estimate.
        equations: information of the data.
        widened: makes the covariance out of that of the weights, and tells by how much larger
            variances are.
        scale: variances over those of the weights, for what counts as open.
        hidden_by: tells the rotation that cross-axis errors hide [rad] from the covariance.
    """
    tree, free = subject.tree, subject.free
    D, U = tree.n_joints, tree.n_sus
    free_joint = np.concatenate([free.joints.ravel(), free.logs.ravel()])
    inverse = np.zeros((U, N_SU, N_SU))
    known = np.tile(np.eye(N_SU), (U, 1, 1))
    open_of_su = []
    learnt = _information(subject.priors) - _information(subject.given)
    for u in range(U):
        inverse[u] = _su_inverse(equations.su[u], free.sus[u])
        # What only the likeness of other sensors tells is no observation.
        unseen = _open_directions(equations.su[u] - learnt, free.sus[u], scale)
        known[u, :N_PLACEMENT, :N_PLACEMENT] -= unseen.T @ unseen
        open_of_su.append(unseen)
    columns = equations.columns
    mixed = equations.mixed * free_joint[columns][:, None]
    lean = -inverse @ mixed
    H = equations.joint * free_joint[:, None] * free_joint
    np.add.at(H, (columns[:, :, None], columns[:, None, :]), np.swapaxes(mixed, 1, 2) @ lean)
    joint_inverse, null = _joint_inverse(H, free_joint, scale)
    # The antisymmetric part of a cross-axis error is a rotation of the sensor's frame: it can not
    # be seen, and is as large as the symmetric part.
    weights = ArrowCovariance(joint_inverse, columns, lean, inverse)
    full, widening = widened(weights)
    beyond = _known_in_part(full, known).su()[:, :N_PLACEMENT, :N_PLACEMENT]
    for u in range(U):
        # What noise alone would let the data tell, other errors may hide.
        lam, V = np.linalg.eigh(beyond[u])
        unseen = V[:, lam > UNKNOWN**2].T
        known[u, :N_PLACEMENT, :N_PLACEMENT] -= unseen.T @ unseen
        open_of_su[u] = np.concatenate([open_of_su[u], unseen])
    lengths = np.r_[1, 1, 1, ARM, ARM, ARM]
    directions = [np.linalg.qr((unseen * lengths).T)[0].T for unseen in open_of_su]
    open_ = open_directions(
        tree, subject.state, subject.q, equations, null, known @ lean, directions,
        least=scale / UNKNOWN**2, arm=ARM,
    )  # fmt: skip
    moving = {name for direction in open_ for name in _moving(direction)}
    hidden = hidden_by(full)
    turns = np.zeros(N_SU)
    turns[3:N_PLACEMENT] = hidden**2
    covariance = _known_in_part(full, known)
    covariance = replace(covariance, own=covariance.own + np.diag(turns))
    su_covariance = covariance.su()[:, :N_PLACEMENT, :N_PLACEMENT]
    blocks = covariance.joint[: N_JOINT * D, : N_JOINT * D].reshape(D, N_JOINT, D, N_JOINT)
    joint_covariance = np.einsum("dadb->dab", blocks)
    # No recording tells what they hide; a verdict is about what this one does not tell.
    told = su_covariance - turns[:N_PLACEMENT, None] * np.eye(N_PLACEMENT)
    su_verdict = tuple(_verdict(told[u], len(directions[u])) for u in range(U))
    joint_verdict = tuple(
        _verdict(joint_covariance[j], int(name in moving))
        for j, name in enumerate(tree.joint_names)
    )
    rank = int(free_joint.sum()) - len(null) + int(free.sus.sum())
    rank -= sum(len(d) for d in directions)
    return Observability(
        su_covariance=su_covariance,
        su_unobservable=tuple(directions),
        su_hidden_turn=_hidden_turns(equations, free.sus, full, known, subject.given.position),
        su_verdict=su_verdict,
        joint_covariance=joint_covariance,
        joint_verdict=joint_verdict,
        open_directions=open_,
        rank=rank,
        hidden_rotation=hidden,
        covariance=covariance,
        widening=widening,
    )


def _known_in_part(full: ArrowCovariance, known: F64) -> ArrowCovariance:
    """A covariance without the directions of SUs that projectors known (U, 15, 15) lack."""
    return replace(full, lean=known @ full.lean, own=known @ full.own @ known)


def _of_the_data(estimate: Estimate) -> NormalEquations:
    """Information at the estimate without the prior on offsets, which is no knowledge of them."""
    equations = estimate.cost.at(estimate.state).normal_equations()
    joint, su = equations.joint.copy(), equations.su.copy()
    weight = estimate.cost.priors.position**-2.0
    held = N_JOINT * np.arange(estimate.tree.n_joints)[:, None] + np.arange(2)
    joint[held, held] -= weight
    su[:, range(3), range(3)] -= weight
    return replace(equations, joint=joint, su=su)


def _hidden_turns(
    equations: NormalEquations, free: Bool, full: ArrowCovariance, known: F64, position: float
) -> F64:
    """(U,) standard deviations of turns that are open, but limited by the errors of sensors [rad].

    Args:
        equations: information of the data and of what is known of sensors.
        free: (U, 15) coordinates that were estimated.
        full: the covariance, of which that of the joints is taken.
        known: (U, 15, 15) projectors that lack the open directions.
        position: standard deviation of an offset before anything is known of it [m].
    """
    turns = slice(3, N_PLACEMENT)
    out = np.zeros(len(known))
    for u, (H, projector) in enumerate(zip(equations.su, known, strict=True)):
        open_ = np.eye(N_SU) - projector
        if not open_[turns, turns].any():
            continue
        index = np.flatnonzero(free[u])
        held = H + np.diag(np.r_[np.full(3, position**-2.0), np.zeros(N_SU - 3)])
        lam, V = np.linalg.eigh(held[np.ix_(index, index)])
        some = lam > _TINY * lam.max(initial=0.0)
        own = np.zeros((N_SU, N_SU))
        own[np.ix_(index, index)] = (V[:, some] / lam[some]) @ V[:, some].T
        lean = own @ equations.mixed[u]
        columns = equations.columns[u]
        whole = own + lean @ full.joint[np.ix_(columns, columns)] @ lean.T
        variance = np.linalg.eigvalsh((open_ @ whole @ open_)[turns, turns])
        out[u] = np.sqrt(variance[(variance > _TINY) & (variance < _LIMITED**2)].sum())
    return out


def _information(priors: Priors) -> F64:
    """(15, 15) information of an SU's coordinates in the priors of its sensor."""
    deviations = priors.deviations
    known = np.divide(1.0, deviations**2, out=np.zeros_like(deviations), where=deviations > 0)
    return np.diag(np.concatenate([np.zeros(N_PLACEMENT), known]))


def _marginal(H: F64, free: Bool) -> tuple[F64, F64, F64]:
    """Information about an SU's placement whatever its sensor's errors are.

    Returns:
        (n, n) information of the n free coordinates of the placement, (m, m) covariance of the m of
        the sensor for a known placement, and (m, n) how those follow the placement.
    """
    placed = free & (np.arange(N_SU) < N_PLACEMENT)
    sensor = free & ~placed
    across = H[np.ix_(placed, sensor)]
    # By the root: a difference of large numbers keeps only what no inverse has rounded.
    root = np.linalg.cholesky(H[np.ix_(sensor, sensor)])
    left = np.linalg.solve(root, across.T)
    back = np.linalg.solve(root, np.eye(len(root)))
    return H[np.ix_(placed, placed)] - left.T @ left, back.T @ back, -back.T @ left


def _su_inverse(H: F64, free: Bool) -> F64:
    """(15, 15) inverse information of an SU's coordinates given the joints.

    It is 0 along directions of the placement that nothing at all determines.
    """
    marginal, own, follow = _marginal(H, free)
    lam, V = np.linalg.eigh(marginal)
    # What the sensor's errors explain cancels, up to rounding of what was there before.
    whole = np.diag(H)[:N_PLACEMENT][free[:N_PLACEMENT]]
    some = lam > _TINY * whole.max(initial=0.0)
    P = (V[:, some] / lam[some]) @ V[:, some].T
    index = np.flatnonzero(free)
    out = np.zeros((N_SU, N_SU))
    both = follow @ P
    out[np.ix_(index, index)] = np.block([[P, both.T], [both, own + both @ follow.T]])
    return out


def _open_directions(H: F64, free: Bool, scale: float) -> F64:
    """(k, 6) orthonormal directions of a placement that are not observable."""
    lam, V = np.linalg.eigh(_marginal(H, free)[0])
    open_ = V[:, lam < scale / UNKNOWN**2].T
    basis = np.zeros((len(open_), N_PLACEMENT))
    basis[:, free[:N_PLACEMENT]] = open_
    return np.concatenate([np.eye(N_PLACEMENT)[~free[:N_PLACEMENT]], basis])


def _joint_inverse(H: F64, free: Bool, scale: float) -> tuple[F64, F64]:
    """Inverse of the joints' information (J, J) without its open directions, and those (k, J)."""
    index = np.flatnonzero(free)
    A = H[np.ix_(index, index)]
    lam, V = np.linalg.eigh(A) if len(index) else (np.zeros(0), np.zeros((0, 0)))
    open_ = lam < np.maximum(scale / UNKNOWN**2, _TINY * lam.max(initial=0.0))
    out, null = np.zeros_like(H), np.zeros((int(open_.sum()), len(H)))
    out[np.ix_(index, index)] = (V[:, ~open_] / lam[~open_]) @ V[:, ~open_].T
    null[:, index] = V[:, open_].T
    return out, null


def _moving(direction: OpenDirection) -> list[str]:
    """Joints that an open direction moves noticeably."""
    size = {name: float(np.abs(xi).max()) for name, xi in direction.joints.items()}
    return [name for name, each in size.items() if each > ALIKE * max(size.values())]


def _verdict(covariance: F64, n_open: int) -> Verdict:
    """Verdict from a covariance and the number of open directions."""
    if n_open:
        return "not observable"
    return "weak" if np.linalg.eigvalsh(covariance)[-1] > WEAK**2 else "determined"


def aligned_deviations(
    estimate: Estimate | Subject, found: Observability, q: F64, *, align: Align = "limbs"
) -> tuple[F64, F64]:
    """Standard deviations to expect when the robot is compared with the truth.

    The Cramer-Rao bound of the comparison's metrics: SU position and orientation over the given
    configurations, after one rigid transform of each limb and with open directions of branches
    and unobservable ones of SUs left out. A limb is aligned by its determined SUs; where it has
    none by those that are observable in all directions, and where it has none of these either, by
    all it has.

    Args:
        estimate: the estimate.
        found: its covariance, unobservable directions and verdicts.
        q: (C, D) configurations.
        align: one transform per limb, or one for the whole robot ("base").

    Returns:
        position (U,) [m] and orientation (U,) [rad], root mean square over configurations; NaN for
        SUs of which nothing is observable, and for the position of SUs on the RS.
    """
    tree = estimate.tree
    n_open = np.array([len(rows) for rows in found.su_unobservable])
    determined = np.array([verdict == "determined" for verdict in found.su_verdict])
    nothing = n_open == N_PLACEMENT
    position, orientation = expected_errors(
        tree, estimate.state, found.covariance, q,
        free=found.su_unobservable,
        trust=np.where(nothing, -1, (n_open == 0) * 1 + (determined & (n_open == 0))),
        open_directions=found.open_directions, arm=ARM, align=align,
    )  # fmt: skip
    position[nothing | (tree.su_joint < 0)], orientation[nothing] = np.nan, np.nan
    return position, orientation
