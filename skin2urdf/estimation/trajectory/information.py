"""What a fit of all samples is worth: its information, and the errors that disturb it.

Weights take whitened residuals as independent of each other. They are not: an encoder's noise is
felt by all SUs beyond it, and is of high frequencies; whatever the model lacks stays for a while,
and comes back wherever the robot does the same again. So what clusters of samples, at one place or
one after the other (:mod:`clusters`), contribute to the gradient is kept beside the information,
with residuals as they are and as independent noise would leave them, drawn, fitted and added up
alike. What they make of the stated errors is told in :mod:`uncertainty`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.cost import NormalEquations, Priors
from skin2urdf.estimation.problem.residuals import columns_of
from skin2urdf.estimation.problem.state import N_JOINT, N_SU
from skin2urdf.estimation.trajectory.arrow import eliminated, newton_step
from skin2urdf.estimation.trajectory.clusters import Clusters, clusters
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.spans import parts_of
from skin2urdf.estimation.trajectory.state import Layout
from skin2urdf.estimation.trajectory.versions import Versions, VersionsOfSus, versions
from skin2urdf.model.prediction import Chains
from skin2urdf.threads import each

_DRAWS = 16
"""Versions with independent noise; their mean is known to a few per cent."""
_AT_HAND = 1 << 26
"""Derivatives that are kept [bytes], rather than worked out twice: eight SUs on seven joints for
two minutes, beside which all else of a calibration takes several times as much."""


@dataclass(frozen=True, eq=False)
class MotionInformation:
    """Information of a fit on placements, bias and shape, and what disturbs it.

    Coordinates x are those of joints and logs, z what all SUs share beyond them (gravity's size,
    numbers of unseen motion, where limbs are on a base that moves), y those of each SU (placement,
    bias, shape), whatever its clock and front end are.

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
        sensors: what is known of the sensors, which is part of the information on y.
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
    sensors: Priors

    def along(self, axes: F64) -> MotionInformation:
        """The same with other numbers that all share: axes (Z, Z) times these are the former."""
        J = self.shared_joint.shape[1]
        of_parts = self.shares[2] @ (np.diag(self.shared)[:, None] * axes**2)
        before, pulls = self.prior_joint, self.prior_xz
        return replace(
            self,
            shared=axes.T @ self.shared @ axes,
            shared_joint=axes.T @ self.shared_joint,
            shared_su=self.shared_su @ axes,
            defects=self.defects.along(axes),
            rounding=self.rounding.along(axes),
            errors=self.errors.along(axes),
            draws=tuple(each.along(axes) for each in self.draws),
            prior_xz=np.concatenate([pulls[..., :J], pulls[..., J:] @ axes], axis=2),
            shares=(*self.shares[:2], _shares(of_parts)),
            prior_joint=np.append(before[:J], before[J:] @ axes**2),
        )


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
            summed(self.x, label),
            summed(self.z, label),
            np.swapaxes(summed(np.swapaxes(self.y, 0, 1), label), 0, 1),
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
    own = slice(N_SU, layout.n_su)
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
    joint -= np.tensordot(mixed[:, own], by_x, ((0, 1), (0, 1)))
    weight = problem.priors.sensors.position**-2.0
    held = N_JOINT * np.arange(tree.n_joints)[:, None] + np.arange(2)
    held = np.setdiff1d(held, problem.between_limbs)
    joint[held, held] -= weight
    su[:, range(3), range(3)] -= weight
    parts = clusters(tree, problem.logs)
    split = _Split.of(problem)
    pulls, shares, moments = _errors(problem, fitted, parts, by_x, by_y, split)
    lacking = (
        np.array([joint for joint, _ in defects]).reshape(-1, layout.n_joint) * free_joint,
        np.array([own for _, own in defects]).reshape(-1, tree.n_sus, layout.n_su) * free_su,
    )
    none = np.zeros((0, layout.n_joint)), np.zeros((0, tree.n_sus, layout.n_su))
    off_joint, off_su = none if rounding is None else rounding
    joint_prior, su_prior, _, _ = problem.prior_information(fitted.state)
    joint_prior[problem.between_limbs] = weight
    scores = _roots(np.where(free_su[:, :, None] & free_su[:, None, :], su_prior, 0.0))
    chains = Chains.of(tree)
    columns = columns_of(chains, tree.n_joints, layout.n_logs)
    return MotionInformation(
        equations=NormalEquations(
            joint=split.x(split.x(joint).T),
            su=su,
            mixed=_of_chains(split.x(coupling), columns, chains),
            columns=columns,
        ),
        shared=split.z(split.z(joint).T) + np.diag(1.0 - split.z(free_joint.astype(np.float64))),
        shared_joint=split.x(split.z(joint).T),
        shared_su=split.z(coupling),
        defects=_pulls(*lacking, by_x, by_y, split),
        rounding=_pulls(off_joint * free_joint, off_su * free_su, by_x, by_y, split),
        errors=pulls[0].times(np.sqrt(max(1.0, misfit))),
        draws=tuple(pulls[1:]),
        prior_xz=split.both(-scores[..., N_SU:] @ by_x),
        prior_y=scores[..., :N_SU] - scores[..., N_SU:] @ by_y,
        clusters=parts,
        moments=moments,
        kinds=_kinds(layout, tree.n_sus, len(problem.between_limbs)),
        shares=shares,
        prior_joint=split.both(np.where(free_joint, joint_prior, 0.0)),
        sensors=problem.priors.sensors,
    )


@dataclass(frozen=True, eq=False)
class _Split:
    """The joint part's coordinates as x and z, last in any array.

    Where limbs are on a base that moves is no coordinate of a robot that stands still, and becomes
    one of those that all SUs share: the last of them.

    Attributes:
        gravity: number of the first that is of z.
        limbs: coordinates among those before that are of z as well.
    """

    gravity: int
    limbs: Int

    @staticmethod
    def of(problem: MotionProblem) -> _Split:
        return _Split(problem.layout.gravity, problem.between_limbs)

    def x(self, values: F64) -> F64:
        """(..., J) of joints and logs; 0 where limbs are."""
        out = values[..., : self.gravity]
        if len(self.limbs):
            out = np.array(out)
            out[..., self.limbs] = 0
        return out

    def z(self, values: F64) -> F64:
        """(..., Z) of all else."""
        beyond = values[..., self.gravity :]
        if not len(self.limbs):
            return beyond
        return np.concatenate([beyond, values[..., self.limbs]], axis=-1)

    def both(self, values: F64) -> F64:
        """(..., J + Z) one behind the other."""
        return np.concatenate([self.x(values), self.z(values)], axis=-1)


def _errors(
    problem: MotionProblem,
    fitted: Fitted,
    parts: Clusters,
    by_x: F64,
    by_y: F64,
    split: _Split,
) -> tuple[list[Pulls], tuple[F64, F64, F64], F64]:
    """Pulls of parts of the time in every version, after a fit to it.

    Args:
        problem: what was fitted.
        fitted: the fit.
        parts: of the time.
        by_x: (U, m, J + Z) and
        by_y: (U, m, 15) how an SU's clock and front end follow the rest.
        split: which of the joint part's coordinates are of x and of z.

    Returns:
        Pulls of each version; shares (S, J), (S, U, 15) and (S, Z) of the information that each
        part has; (M, J) pulls of moments on x, whatever the SUs are.
    """
    layout, U, full = problem.layout, problem.tree.n_sus, fitted.equations
    free_joint, free_su, J = problem.free_joint, problem.free_su, layout.gravity
    every = _versions(problem, fitted)
    dx, dy = _steps(problem, fitted, every())
    S, V = len(parts.place), len(dx)
    x, y = np.zeros((V, S, layout.n_joint)), np.zeros((U, V, S, N_SU))
    on_joint, on_su = np.zeros((S, layout.n_joint)), np.zeros((S, U, N_SU))
    moments = np.zeros((J, 1 + max(int(each.max()) for each in parts.moments)))
    lean = eliminated(full.of_joint(np.arange(J)), free_joint[:J], free_su).lean
    for link in every():
        at_once, moment = _Sorted.of(parts.members[link.log]), parts.moments[link.log]
        first = np.flatnonzero(np.diff(moment, prepend=-1))
        felt = np.zeros((V, *link.information.shape[1::-1]))
        for at, columns, P in link.blocks:
            felt[..., at] += np.tensordot(dx[:, columns], P, (1, 1))

        def look(
            make: Callable[[], VersionsOfSus],
            felt: F64 = felt,
            at_once: _Sorted = at_once,
            first: Int = first,
        ) -> tuple[F64, F64, F64, F64]:
            of_sus = make()
            sus, A = of_sus.sus, of_sus.own
            left = of_sus.residuals - of_sus.reads(felt)
            steps = np.moveaxis(dy[:, sus], 0, 1) @ A.reshape(*A.shape[:2], -1)
            left -= np.moveaxis(steps, 0, 1).reshape(left.shape)
            scores, square = at_once.products(left, A)
            scores = np.where(free_su[sus, None, None], scores, 0.0)
            own, others = scores[..., :N_SU], scores[..., N_SU:]
            own = own - (others.reshape(len(A), -1, others.shape[3]) @ by_y[sus]).reshape(own.shape)
            y[np.ix_(sus, np.arange(V), at_once.parts)] += own
            on_su[np.ix_(at_once.parts, sus)] += square[:, :, :N_SU]
            pulls = np.add.reduceat(
                np.einsum("ucik,uik->uck", A, of_sus.residuals[0]), first, axis=2
            )
            return (
                of_sus.put_back(left),
                of_sus.put_back(of_sus.residuals[:1]),
                np.tensordot(others, by_x[sus], ((0, 3), (0, 1))),
                np.tensordot(lean[sus], pulls, ((0, 1), (0, 1))),
            )

        back, whole = np.zeros_like(felt), np.zeros_like(felt[:1])
        for put_back, as_it_is, follow, pull in each(look, link.of_sus, link.n_sus):
            back += put_back
            whole += as_it_is
            x[:, at_once.parts] -= follow
            moments[:, moment[first]] += pull
        for at, columns, P in link.blocks:
            # What all SUs of the link say together of the joint part.
            by_sample, here = np.ascontiguousarray(np.moveaxis(P, 2, 0)), columns < J
            square = ((link.information[at] @ by_sample) * by_sample).sum(axis=1)
            for s, some in parts_of(parts.members[link.log][at]):
                x[:, s, columns] += _on_columns(P[..., some], back[..., at][..., some])
                on_joint[s, columns] += square[some].sum(axis=0)
            pull = np.einsum("pck,pk->ck", P, whole[0, :, at])
            first = np.flatnonzero(np.diff(moment[at], prepend=-1))
            pull = np.add.reduceat(pull, first, axis=1)
            moments[np.ix_(columns[here], moment[at][first])] += pull[here]
    x = np.where(free_joint, x, 0.0)
    pulls = [Pulls(split.x(x[v]), split.z(x[v]), y[:, v]) for v in range(V)]
    shares = _shares(split.x(on_joint)), _shares(on_su), _shares(split.z(on_joint))
    return pulls, shares, moments.T * split.x(free_joint.astype(np.float64))


@dataclass(frozen=True, eq=False)
class _Sorted:
    """Samples of a log in the order of the parts of the time that they are in.

    Attributes:
        order: (K,) the samples.
        parts: (p,) the parts that there are.
        ends: (p + 1,) where each begins in that order, and where the last ends.
    """

    order: Int
    parts: Int
    ends: Int

    @staticmethod
    def of(members: Int) -> _Sorted:
        """Of the parts (K,) that the samples are in."""
        order = np.argsort(members, kind="stable")
        parts, first = np.unique(members[order], return_index=True)
        return _Sorted(order, parts, np.append(first, len(order)))

    def products(self, left: F64, own: F64) -> tuple[F64, F64]:
        """Products of residuals (V, s, 3, K) and derivatives (s, n, 3, K), summed in every part.

        Returns:
            (s, V, p, n), and (p, s, n) squares of the derivatives.
        """
        by_axis = np.moveaxis(left[..., self.order], 0, 2)
        A = own[..., self.order].swapaxes(1, 2)
        scores = np.empty((len(own), len(left), len(self.parts), own.shape[1]))
        for i, (begin, end) in enumerate(pairwise(self.ends)):
            part = by_axis[..., begin:end] @ A[..., begin:end].swapaxes(2, 3)
            part.sum(axis=1, out=scores[:, :, i])
        squares = np.einsum("sink,sink->snk", A, A)
        return scores, np.moveaxis(np.add.reduceat(squares, self.ends[:-1], axis=2), 2, 0)


def _versions(problem: MotionProblem, fitted: Fitted) -> Callable[[], Iterable[Versions]]:
    """What gives the versions of a fit, which are kept where they take little memory."""

    def anew() -> Iterable[Versions]:
        return versions(problem, fitted.state, fitted.predicted, fitted.weights, _DRAWS)

    numbers = problem.layout.n_joint + problem.layout.n_su + 1 + _DRAWS
    if 8 * numbers * sum(p.residual.size for p in fitted.predicted) > _AT_HAND:
        return anew
    kept = [link.kept() for link in anew()]
    return lambda: kept


def _on_columns(P: F64, pulls: F64) -> F64:
    """(V, c) what pulls (V, p, k) on what points feel say of columns, of derivatives (p, c, k)."""
    return np.asarray(np.tensordot(pulls, P, ((1, 2), (0, 2))))


def _steps(problem: MotionProblem, fitted: Fitted, every: Iterable[Versions]) -> tuple[F64, F64]:
    """Steps (V, J + Z) and (V, U, n) from a fit to that of every version."""
    full, free_joint = fitted.equations, problem.free_joint
    # The estimate itself is off the optimum where the noise of encoders was taken off.
    joint = np.tile(full.joint_gradient, (1 + _DRAWS, 1))
    su = np.tile(full.su_gradient, (1 + _DRAWS, 1, 1))
    joint[1:], su[1:] = 0.0, 0.0
    for link in every:

        def look(make: Callable[[], VersionsOfSus]) -> F64:
            of_sus = make()
            drawn, A = of_sus.residuals[1:], of_sus.own
            by_su = np.moveaxis(drawn, 0, 1).reshape(len(A), _DRAWS, -1)
            scores = by_su @ A.reshape(*A.shape[:2], -1).swapaxes(1, 2)
            su[1:, of_sus.sus] += scores.swapaxes(0, 1)
            return of_sus.put_back(drawn)

        pulls = np.zeros((_DRAWS, *link.information.shape[1::-1]))
        for put_back in each(look, link.of_sus, link.n_sus):
            pulls += put_back
        for at, columns, P in link.blocks:
            joint[1:, columns] += _on_columns(P, pulls[..., at])
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


def _pulls(joint_scores: F64, su_scores: F64, by_x: F64, by_y: F64, split: _Split) -> Pulls:
    """Pulls on x, z and y of gradients in all coordinates, the rest following."""
    nuisance = su_scores[..., N_SU:]
    both = joint_scores - np.einsum("eum,umj->ej", nuisance, by_x)
    y = su_scores[..., :N_SU] - np.einsum("eum,umi->eui", nuisance, by_y)
    return Pulls(split.x(both), split.z(both), np.swapaxes(y, 0, 1))


def _roots(information: F64) -> F64:
    """(U, n, n) rows whose products add up to information matrices (U, n, n)."""
    lam, V = np.linalg.eigh(information)
    return np.swapaxes(V * np.sqrt(np.maximum(lam, 0.0))[:, None, :], 1, 2)


def _kinds(layout: Layout, n_sus: int, n_between: int) -> tuple[Int, Int, Int]:
    """Kinds of coordinates (J,), (U, 15) and (Z,): offsets, turns, biases, scales, cross axes.

    Of Z the last ones, of which there are ``n_between``, tell where limbs are.
    """
    of_joints = np.ones(layout.gravity, dtype=np.int64)  # gravity turns in every log
    of_joints[layout.joints] = np.arange(N_JOINT * layout.n_joints) % N_JOINT // 2
    of_sus = np.tile(np.arange(N_SU) // 3, (n_sus, 1))
    n_shared = layout.n_joint - layout.gravity + n_between
    return of_joints, of_sus, np.zeros(n_shared, dtype=np.int64)


def _shares(information: F64) -> F64:
    """Share (S, ...) that each part has of the sum."""
    total = information.sum(axis=0)
    return np.asarray(
        np.divide(information, total, out=np.zeros_like(information), where=total > 0)
    )


def summed(values: F64, label: Int) -> F64:
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
