"""SUs that sit elsewhere, or whose bias is another, from some time on: a score test of all samples.

An SU that changes at a time adds ``J_k d`` to its readings from then on, where d is the change of
its placement and bias, and J_k are the derivatives in these after time k and zero before it. With
everything else estimated again, which to first order projects the columns of all other coordinates
out, chi-squared falls by

    gain = g' S^-1 g,    g = J_k' W r,    S = J_k' W J_k - J_k' W J N^-1 J' W J_k

where r are the residuals of the fit, W their weights and N its normal equations (Rao's score test,
Rao 1948; of a change at an unknown time, Andrews 1993). The fit need not be made again for any SU
or any time: sums over spans of time do for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.state import N_PLACEMENT
from skin2urdf.estimation.trajectory.arrow import Eliminated, eliminated, joint_inverse
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.misfit import (
    SPAN,
    misfit,
    misfit_of_sus,
    span_edges,
    span_means,
)
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.spans import parts_of

FALSE_ALARM = 1e-6
"""Probability that noise makes any SU of a log look as if it had changed."""
_CHANGES = N_PLACEMENT + 3
"""Coordinates of an SU that change: its placement and its bias, the first of its own."""
_KNOWN = 1e-6
"""Share of its own information that a direction of a change keeps beside everything else, from
which readings tell of it."""
_FEWEST = 2
"""Spans of time on either side of a change."""


@dataclass(frozen=True)
class Displaced:
    """An SU that changed at some time.

    Attributes:
        su: its number in the tree.
        until: number of the log, and the last time in it at which the SU was as before [s], and
        since: the same of the first one from which it is as after; times are the trajectory's.
        gain: of chi-squared over spans, to first order.
        share: of what the fit leaves of the SU beyond noise, which the change explains.
    """

    su: int
    until: tuple[int, float]
    since: tuple[int, float]
    gain: float
    share: float


def displaced(problem: MotionProblem, fitted: Fitted, among: Bool) -> tuple[Displaced, ...]:
    """SUs that changed at some time beyond doubt, the most certain one first.

    Args:
        problem: what was fitted.
        fitted: the fit.
        among: (U,) the SUs that are asked for.
    """
    spans = _Spans.of(problem)
    if len(spans.begin) < 2 * _FEWEST:
        return ()
    system = eliminated(fitted.minimised(fitted.equations), problem.free_joint, problem.free_su)
    covariance = joint_inverse(system.schur, problem.free_joint)
    means, variances = span_means(problem, fitted.predicted, fitted.weights, SPAN)
    of_sus, known = misfit_of_sus(means, variances), np.isfinite(variances)
    count, squares = known.sum(axis=(0, 2)), np.where(known, means**2, 0.0)
    chi2 = float((squares[known] / variances[known]).sum())
    out = []
    for u, sums in _sums(problem, fitted, spans, among):
        best, freedom = _best(sums, u, problem, system, covariance)
        # By chance, in the noise that the change leaves.
        rest = max(int(count.sum()) - freedom, 1)
        F = best.gain / freedom / (max(chi2 - best.gain, 1.0) / rest) if freedom else 0.0
        tests = problem.tree.n_sus * len(spans.begin)
        if freedom and fdtrc(freedom, rest, F) < FALSE_ALARM / tests:
            left = (of_sus[u] - 1) * count[u]
            share = best.gain / left if left > 0 else np.inf
            around = spans.around(best.span)
            out.append(Displaced(u, *around, best.gain, float(share)))
    return tuple(sorted(out, key=lambda each: -each.gain))


def one_alone_changed(problem: MotionProblem, fitted: Fitted, limit: float) -> bool:
    """Whether only one SU leaves more than noise, and all of that for having changed at some time.

    Args:
        problem: what was fitted.
        fitted: the fit.
        limit: misfit up to which nothing is left to explain, of all and of an SU, of which it is to
            first order what a change leaves. A bias that drifts leaves more.
    """
    means, variances = span_means(problem, fitted.predicted, fitted.weights, SPAN)
    of_sus = np.nan_to_num(misfit_of_sus(means, variances))
    suspicious = of_sus > limit
    if misfit(means, variances) <= limit or suspicious.sum() != 1:
        return False
    changes = displaced(problem, fitted, suspicious)
    worst = float(of_sus.max())
    return bool(changes) and worst - changes[0].share * (worst - 1) <= limit


@dataclass(frozen=True, eq=False)
class _Spans:
    """Spans of time of all logs, one after the other.

    Attributes:
        log: (S,) number of the log of each.
        begin: (S,) its first time, and
        end: (S,) its last one [s].
        member: per log (K,) the span of each sample.
    """

    log: Int
    begin: F64
    end: F64
    member: tuple[Int, ...]

    @staticmethod
    def of(problem: MotionProblem) -> _Spans:
        """Those over which the misfit is taken."""
        log, begin, end, member = list[int](), list[float](), list[float](), list[Int]()
        for each in problem.logs:
            edges = span_edges(each, SPAN)
            n = len(edges) - 1
            member.append(len(log) + np.repeat(np.arange(n), np.diff(edges)))
            log += [each.log] * n
            begin += each.time[edges[:-1]].tolist()
            end += each.time[edges[1:] - 1].tolist()
        return _Spans(np.array(log), np.array(begin), np.array(end), tuple(member))

    def around(self, span: int) -> tuple[tuple[int, float], tuple[int, float]]:
        """Between which times something changed whose change is seen at the beginning of a span.

        It may have changed in that span, or in the one before.
        """
        before, after = max(span - 2, 0), min(span + 1, len(self.begin) - 1)
        return (
            (int(self.log[before]), float(self.end[before])),
            (int(self.log[after]), float(self.begin[after])),
        )


@dataclass(frozen=True, eq=False)
class _Sums:
    """What an SU says from each span on, of a change at its beginning.

    Attributes:
        own: (S, n, c) information that the change shares with the SU's own coordinates, of which it
            is the first c.
        joint: (S, c, J) the same with the joint part.
        gradient: (S, c).
    """

    own: F64
    joint: F64
    gradient: F64


def _sums(
    problem: MotionProblem, fitted: Fitted, spans: _Spans, among: Bool
) -> Iterator[tuple[int, _Sums]]:
    """Sums of every one of some SUs that has samples."""
    layout, S = problem.layout, len(spans.begin)
    beyond = problem.beyond()
    of_sus: dict[int, _Sums] = {}
    for rows in problem.rows(fitted.state, fitted.predicted, fitted.weights):
        if not among[rows.su]:
            continue
        columns, A = rows.whole(beyond[rows.log] if beyond else None)
        none = (S, layout.n_su, _CHANGES), (S, _CHANGES, layout.n_joint), (S, _CHANGES)
        sums = of_sus.setdefault(rows.su, _Sums(*map(np.zeros, none)))
        for s, which in parts_of(spans.member[rows.log]):
            part = A[:, :, which].reshape(len(A), -1)
            own, residual = part[len(columns) :], rows.residual[:, which].ravel()
            sums.own[s] += own @ own[:_CHANGES].T
            sums.joint[s][:, columns] += own[:_CHANGES] @ part[: len(columns)].T
            sums.gradient[s] += own[:_CHANGES] @ residual
    for u, sums in of_sus.items():
        yield u, _Sums(*map(_from_there_on, (sums.own, sums.joint, sums.gradient)))


def _from_there_on(x: F64) -> F64:
    """(S, ...) sums of each entry and of all after it."""
    return np.cumsum(x[::-1], axis=0)[::-1]


@dataclass(frozen=True)
class _Change:
    """A change at the beginning of a span, and what it gains."""

    span: int
    gain: float


def _best(
    sums: _Sums, u: int, problem: MotionProblem, system: Eliminated, covariance: F64
) -> tuple[_Change, int]:
    """The time at which a change of an SU gains most, and how many numbers it has there."""
    step = covariance @ system.gradient
    own_step = system.own[u] + system.lean[u] @ step
    best, freedom = _Change(0, 0.0), 0
    free = problem.free_su[u, :_CHANGES]
    for k in range(_FEWEST, len(sums.gradient) - _FEWEST + 1):
        own, joint = sums.own[k], sums.joint[k]
        information = own[:_CHANGES]
        size = np.sqrt(np.maximum(np.diag(information), 0.0))
        open_ = free & (size > 0)
        shared = joint.T + system.lean[u].T @ own
        seen = information - own.T @ system.su_inverse[u] @ own - shared.T @ covariance @ shared
        pull = sums.gradient[k] - own.T @ own_step - joint @ step
        size = size[open_]
        value, vectors = np.linalg.eigh(seen[np.ix_(open_, open_)] / size / size[:, None])
        along = vectors.T @ (pull[open_] / size)
        tells = value > _KNOWN
        gain = float((along[tells] ** 2 / value[tells]).sum())
        if gain > best.gain:
            best, freedom = _Change(k, gain), int(tells.sum())
    return best, freedom
