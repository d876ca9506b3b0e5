"""SUs whose names are exchanged in one of several logs.

One log alone, in which every name means one SU, says where the SUs sit. In another log every name
is held against every SU: the readings that a name has there either follow from where an SU sits in
the first log, or do not. Names are assigned to SUs so that all fit best.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from skin2urdf.arrays import F64, Int
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Logs, find_structure, relinearise, take_features
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.start.starts import felt_up
from skin2urdf.faults import Fault
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled

_FAR_BETTER = 10.0
"""Factor by which every SU's chi-squared must fall with another name. By chance it falls by a few
per cent: there are dozens of measurements to a pose. SUs a centimetre apart make it hundreds."""


def names_agreeing(logs: Logs, clock: Clock) -> tuple[Logs, list[Fault]]:
    """Give the SUs of all logs the names that one of the logs has for them.

    Args:
        logs: the logs.
        clock: runs the stages.

    Returns:
        The logs with names that agree, and the SUs whose names did not.
    """
    number = [len(s.neighbourhoods) for s in logs.sampled]
    reference = int(np.argmax(number))
    alone = logs.of([logs.sampled[reference]])
    try:
        features = take_features(alone, clock)
        tree = find_structure(alone, features, clock).tree
        if tree is None:
            return logs, []
        found, features = relinearise(alone, tree, features, clock)
    except InsufficientDataError:
        return logs, []
    names = found.tree.su_names
    sampled, faults = list(logs.sampled), []
    for log, other in enumerate(logs.sampled):
        if log == reference:
            continue
        there = logs.of([other])
        try:
            called = names_in(found, take_features(there, clock, latency=features.latency))
        except InsufficientDataError:
            continue
        columns = np.arange(len(logs.su_names))
        for u in np.flatnonzero(called != np.arange(len(called))):
            name, alias = names[u], names[called[u]]
            columns[logs.su_names.index(name)] = logs.su_names.index(alias)
            faults.append(Fault("swapped", name, "between logs", log=log, sus=(alias,)))
        sampled[log] = _renamed(other, columns)
    return (logs.of(sampled), faults) if faults else (logs, [])


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
    )
