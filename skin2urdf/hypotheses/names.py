"""SUs whose names are exchanged in one of several logs.

One log alone, in which every name means one SU, says where the SUs sit. In another log every name
is held against every SU: the readings that a name has there either follow from where an SU sits in
the first log, or do not. Names are assigned to SUs so that all fit best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from skin2urdf.arrays import F64, Int
from skin2urdf.calibration.rounds import Logs, take_features
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.start.starts import felt_up
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.alone import alone, negated
from skin2urdf.hypotheses.attempts import Search, imitations
from skin2urdf.hypotheses.measure import excess, explains
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.activity import CERTAIN, Activity
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.records import KinematicTree

_FAR_BETTER = 10.0
"""Factor by which every SU's chi-squared must fall with another name. By chance it falls by a few
per cent: there are dozens of measurements to a pose. SUs a centimetre apart make it hundreds."""


@dataclass(frozen=True)
class Renamed(Amendment):
    """SUs that have other names in one log.

    Attributes:
        log: index of the log.
        names: the SUs, and
        called: the names they have there.
    """

    log: int
    names: tuple[str, ...]
    called: tuple[str, ...]

    def of_logs(self, logs: Logs) -> Logs:
        """The logs with the SUs' own names."""
        sampled = list(logs.sampled)
        sampled[self.log] = _renamed(sampled[self.log], columns_of(logs, self.names, self.called))
        return logs.of(sampled)


def columns_of(logs: Logs, names: Sequence[str], called: Sequence[str]) -> Int:
    """(U,) the column that holds each SU's readings where some have other names."""
    columns = np.arange(len(logs.su_names))
    columns[[logs.su_names.index(n) for n in names]] = [logs.su_names.index(n) for n in called]
    return columns


class Names:
    """SUs whose names in one log are not those of the log with the most poses."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """All names of a log that do not agree, in all logs."""
        if len(search.plain.sampled) < 2 or (now is not None and explains(now.solution.found)):
            return []
        new = search.once("names", lambda: self._renamed(search))
        if not new or (now is not None and new[0] in now.amendments):
            return []
        names = tuple(name for a in new for name in a.names)
        drop = np.inf if now is None else excess(now.solution.found)
        instead = imitations(search, now, names)
        return [Candidate("swapped", names, new, drop, instead=instead)]

    def _renamed(self, search: Search) -> tuple[Renamed, ...]:
        """Names in the logs that do not agree with those of the log with the most poses."""
        logs = search.plain
        reference = int(np.argmax([len(s.neighbourhoods) for s in logs.sampled]))
        known = alone(search, reference)
        if known is None:
            return ()
        out = []
        for log, other in enumerate(logs.sampled):
            if log == reference:
                continue
            there = negated(logs.of([other]), known.mirrored)
            try:
                features = take_features(there, search.clock, latency=known.features.latency)
                called = names_in(known.found, features)
            except InsufficientDataError:
                continue
            names = known.found.tree.su_names
            who = np.flatnonzero(called != np.arange(len(called)))
            if len(who):
                mine = tuple(names[u] for u in who)
                out.append(Renamed(log, mine, tuple(names[called[u]] for u in who)))
        return tuple(out)

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """The SUs that were renamed."""
        return [
            Fault("swapped", name, "between logs", log=a.log, sus=(called,))
            for a in last.amendments if isinstance(a, Renamed)
            for name, called in zip(a.names, a.called, strict=True)
        ]  # fmt: skip


def names_in(found: Estimate, features: Features) -> Int:
    """(U,) index of the name that each SU of an estimate has in another log.

    Args:
        found: an estimate from a log of its own.
        features: of the other log.
    """
    per = misfit(found, features)
    known = np.isfinite(per)
    who = np.flatnonzero(np.diag(known))
    same = np.arange(len(per))
    loss = np.log(np.where(known, np.maximum(per, 1.0), 1e300))[np.ix_(who, who)]
    # Of names that fit alike, as on the reference segment, the same one is to be preferred.
    _, columns = linear_sum_assignment(loss - 1e-6 * np.eye(len(who)))
    for cycle in _cycles(columns):
        gain = loss[cycle, cycle] - loss[cycle, columns[cycle]]
        if (gain > np.log(_FAR_BETTER)).all():
            same[who[cycle]] = who[columns[cycle]]
    return same


def named_as_felt(tree: KinematicTree, seen: Activity) -> KinematicTree:
    """A tree whose SUs have the names of those that feel what it says of them.

    Joints that move one at a time make a tree certain. Where few poses show all joints at once,
    they do not tell the tree, but they do tell which of two SUs is where.

    Args:
        tree: the tree.
        seen: what the SUs felt in other poses.
    """
    names = [name for name in tree.su_names if name in seen.su_names]
    own, rows = places_of(names, tree.su_names), places_of(names, seen.su_names)
    evidence = seen.evidence[np.ix_(rows, places_of(tree.joint_names, seen.dof_names))]
    felt = np.where(tree.activity()[own], 1.0, -1.0)
    fits = felt @ np.clip(evidence, -CERTAIN, CERTAIN).T
    # Of places that suit alike, the same one is to be preferred.
    _, called = linear_sum_assignment(-fits - 1e-6 * np.eye(len(names)))
    joint = np.array(tree.su_joint)
    joint[own[called]] = tree.su_joint[own]
    return replace(tree, su_joint=joint)


def misfit(found: Estimate, features: Features) -> F64:
    """(U, U) chi-squared per measurement of SU u with the readings of the name v, at [u, v].

    Args:
        found: U SUs.
        features: of another log; NaN where a name has no readings in it.
    """
    tree, U = found.tree, found.tree.n_sus
    priors = found.cost.priors
    state = replace(found.state, up=found.state.up[:1])
    per = np.full((U, U), np.nan)
    for shift in range(U):
        names = tuple(tree.su_names[(u + shift) % U] for u in range(U))
        cost = Cost(
            replace(tree, su_names=names),
            feature_blocks(features, replace(tree, su_names=names)),
            priors,
        )
        if shift == 0:
            state = replace(state, up=felt_up(state, cost, features))
        chi2 = cost.at(state).chi2_by_block().sum(axis=0)
        count = cost.blocks.count.sum(axis=0)
        u = np.arange(U)
        per[u, (u + shift) % U] = np.where(count > 0, chi2 / np.maximum(count, 1), np.nan)
    return per


def _cycles(permutation: Int) -> list[Int]:
    """Cycles of two and more in a permutation of 0 to n - 1."""
    left, cycles = set(range(len(permutation))), []
    while left:
        cycle = [left.pop()]
        while (after := int(permutation[cycle[-1]])) in left:
            left.remove(after)
            cycle.append(after)
        cycles.append(np.array(cycle))
    return [cycle for cycle in cycles if len(cycle) > 1]


def _renamed(sampled: Sampled, columns: Int) -> Sampled:
    """A log in which each SU has the readings of another column."""
    return replace(
        sampled,
        readings=sampled.readings[:, columns],
        valid=sampled.valid[:, columns],
        computed=sampled.computed[:, columns],
        period=sampled.period[columns],
        digits=sampled.digits[columns],
        turning=sampled.turning and sampled.turning.of(columns),
    )
