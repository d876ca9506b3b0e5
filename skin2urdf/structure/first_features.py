"""The first look at logs: patterns around poses where there are any, else what gravity shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skin2urdf.errors import InsufficientDataError
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.gravity import gravity_features, gravity_windows


def first_features(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    tell: Callable[[float], None] = lambda _: None,
) -> Features:
    """Features of logs of which nothing is known yet.

    Rests that were recorded one by one may be shorter than the filters that patterns are looked for
    with. Their means tell gravity all the same.

    Args:
        sampled: the logs, all with the same DoF and SU names.
        su_names: U names.
        tell: told the share of the work that is done.

    Raises:
        InsufficientDataError: there are neither patterns nor two rests with readings.
    """
    try:
        return extract_features(sampled, su_names, tell=tell)
    except InsufficientDataError:
        windows = gravity_windows(sampled, su_names)
        if len(windows.q) < _FEWEST:
            raise
        return gravity_features(windows, sampled)


_FEWEST = 2
"""Rests from which gravity can be seen to turn."""
