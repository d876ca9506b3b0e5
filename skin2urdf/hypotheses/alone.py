"""What one log says alone, to be held against the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.calibration.rounds import (
    Logs,
    find_structure,
    relinearise,
    settle,
    take_features,
)
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import mirrored_sus
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.measure import explains
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled


@dataclass(frozen=True, eq=False)
class Alone:
    """One log explained without the others.

    Attributes:
        found: the estimate.
        features: its features.
        mirrored: names of the SUs whose readings were negated for it.
    """

    found: Estimate
    features: Features
    mirrored: frozenset[str]


def alone(search: Search, log: int) -> Alone | None:
    """What a log says alone; None where it gives no estimate. Done once in a search."""
    return search.once(("alone", log), lambda: _alone(search, log))


def _alone(search: Search, log: int) -> Alone | None:
    logs = search.plain.of([search.plain.sampled[log]])
    try:
        first = _estimated(search, logs)
        if first is None or explains(first[0]):
            return None if first is None else Alone(*first, frozenset())
        names = frozenset(first[0].tree.su_names[u] for u in mirrored_sus(first[0]))
        second = _estimated(search, negated(logs, names)) if names else None
    except InsufficientDataError:
        return None
    if second is not None and second[0].misfit < first[0].misfit:
        return Alone(*second, names)
    return Alone(*first, frozenset())


def _estimated(search: Search, logs: Logs) -> tuple[Estimate, Features] | None:
    features = take_features(logs, search.clock)
    tree = find_structure(logs, features, search.clock).tree
    if tree is None:
        return None
    return settle(logs, *relinearise(logs, tree, features, search.clock), search.clock)


def negated(logs: Logs, names: Iterable[str]) -> Logs:
    """The logs with the readings of some SUs negated, of those that they have."""
    columns = [logs.su_names.index(name) for name in names if name in logs.su_names]
    return logs.of([_negated(s, columns) for s in logs.sampled]) if columns else logs


def _negated(sampled: Sampled, sus: Sequence[int]) -> Sampled:
    """A log with the readings of some SUs negated."""
    readings = np.array(sampled.readings)
    readings[:, list(sus)] *= -1
    return replace(sampled, readings=readings)
