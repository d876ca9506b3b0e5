"""Known errors of encoders: how logs are mended of them, and which are of one change."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.calibration.rounds import Logs
from skin2urdf.hypotheses.records import Amendment
from skin2urdf.recording.records import Recording
from skin2urdf.signals.encoders import corrected, leaps
from skin2urdf.signals.records import EncoderError, Features

SMALL = 1e-3
"""Offset [rad or m] or scale error [1] that sound gears and encoders have as well."""


@dataclass(frozen=True)
class Corrected(Amendment):
    """An encoder whose error is taken off.

    Attributes:
        error: the error.
    """

    error: EncoderError

    @property
    def key(self) -> Hashable:
        """The encoder and the change, whatever its size."""
        e = self.error
        return ("scale", e.dof) if e.kind == "scale" else (e.kind, e.dof, e.log, e.begin)

    @property
    def subject(self) -> str:
        """The joint."""
        return self.error.dof

    def of_recordings(self, recordings: list[Recording]) -> list[Recording]:
        """The recordings with the error taken off."""
        return corrected(recordings, [self.error])

    def left_out(self, logs: Logs) -> Logs:
        """The logs without the samples in which the error arises."""
        e = self.error
        if e.spread <= 0:
            return logs
        sampled = list(logs.sampled)
        s = sampled[e.log]
        whole = s.valid & (np.abs(s.motion.grid.time - e.begin) >= e.spread)[:, None]
        sampled[e.log] = replace(s, valid=whole)
        return logs.of(sampled)


def evident_errors(recordings: Sequence[Recording]) -> tuple[Corrected, ...]:
    """The leaps that are seen in the tracks alone."""
    return tuple(Corrected(e) for log, r in enumerate(recordings) for e in leaps(r, log))


def errors_of(amendments: Sequence[Amendment]) -> list[EncoderError]:
    """The errors that amendments take off, in their order."""
    return [a.error for a in amendments if isinstance(a, Corrected)]


def with_another(
    amendments: Sequence[Amendment], error: EncoderError, features: Features
) -> Corrected:
    """An error with an earlier error of the same place, as the one that takes its place.

    Args:
        amendments: what was taken off before.
        error: as seen in the corrected recordings.
        features: tell which times lie between the same two poses.
    """
    errors = errors_of(amendments)
    turned = [i for i, e in enumerate(errors) if (e.kind, e.dof) == ("sign", error.dof)]
    for i, old in enumerate(errors):
        # What was taken off before a track was mirrored is of the other sense.
        if (old.kind, old.dof) != (error.kind, error.dof) or i < max(turned, default=0):
            continue
        if error.kind == "scale":
            return Corrected(replace(old, size=old.size * error.size))
        if old.log == error.log and of_one_change(old, error, features):
            # A leap that is not the whole change leaves open when the rest of it came.
            known = abs(error.size) < SMALL
            reach = 0.0 if known else error.spread + abs(error.begin - old.begin)
            spread = max(old.spread, reach)
            return Corrected(replace(old, size=old.size + error.size, spread=spread))
    return Corrected(error)


def turn_at(
    offset: EncoderError, amendments: Sequence[Amendment], features: Features
) -> Corrected | None:
    """The change of sense in a log that an offset would be part of, where it is known."""
    for each in amendments:
        if not (isinstance(each, Corrected) and each.error.kind == "sign"):
            continue
        within = offset.kind == "offset" and np.isfinite(each.error.begin)
        if within and of_one_turn(offset, each.error, features):
            return each
    return None


def together(errors: Sequence[EncoderError], features: Features) -> list[EncoderError]:
    """Errors with those of one change added up: a zero may need several samples for its way."""
    out: list[EncoderError] = []
    for error in errors:
        for i, other in enumerate(out):
            if error.kind == "offset" and are_alike(error, other, features):
                larger = max(error, other, key=lambda e: abs(e.size))
                out[i] = replace(larger, size=error.size + other.size)
                break
        else:
            out.append(error)
    return out


def are_alike(a: EncoderError, b: EncoderError, features: Features) -> bool:
    """Whether two errors are of one encoder and one change of it."""
    if (a.kind, a.dof) != (b.kind, b.dof):
        return False
    return a.kind == "scale" or (a.log == b.log and of_one_change(a, b, features))


def of_one_change(a: EncoderError, b: EncoderError, features: Features) -> bool:
    """Whether no pose lies between the beginnings of two offsets in one log."""
    middle = features.span[features.log == a.log].mean(axis=1)
    first, last = sorted((a.begin, b.begin))
    return not ((middle > first) & (middle < last)).any()


def of_one_turn(offset: EncoderError, sign: EncoderError, features: Features) -> bool:
    """Whether an offset is part of a change of sense: which value a track is mirrored about."""
    return (offset.dof, offset.log) == (sign.dof, sign.log) and of_one_change(
        offset, sign, features
    )


def is_small(error: EncoderError, logs: Logs) -> bool:
    """Whether sound gears and encoders have as much; one step of an encoder is rounding."""
    if error.kind == "scale":
        return abs(error.size - 1) < SMALL
    return abs(error.size) < max(SMALL, step_of(error, logs))


def step_of(error: EncoderError, logs: Logs) -> float:
    """Step of an encoder [rad or m], by which two rests may differ for its rounding alone."""
    motion = logs.sampled[error.log].motion
    return float(motion.resolution[motion.dof_names.index(error.dof)])
