"""SUs that are negated or left-handed, unlike the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.rounds import Logs
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import mirrored_sus
from skin2urdf.faults import Fault
from skin2urdf.signals.sampling import Sampled


def mirrored_negated(logs: Logs, found: Estimate) -> tuple[Logs, list[Fault]]:
    """The logs with mirrored SUs negated, and their faults.

    Args:
        logs: the logs.
        found: an estimate from them, however bad.
    """
    names = [found.tree.su_names[u] for u in mirrored_sus(found)]
    return negated(logs, names), [Fault("mirrored", name) for name in names]


def negated(logs: Logs, names: Iterable[str]) -> Logs:
    """The logs with the readings of some SUs negated, of those that they have."""
    columns = [logs.su_names.index(name) for name in names if name in logs.su_names]
    return logs.of([_negated(s, columns) for s in logs.sampled]) if columns else logs


def _negated(sampled: Sampled, sus: Sequence[int]) -> Sampled:
    """A log with the readings of some SUs negated."""
    readings = np.array(sampled.readings)
    readings[:, list(sus)] *= -1
    return replace(sampled, readings=readings)
