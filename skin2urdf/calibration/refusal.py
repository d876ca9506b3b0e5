"""The refusal of estimates that do not explain the readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from skin2urdf.calibration.result import BAD_FIT, BAD_MISFIT, HOPELESS_FIT
from skin2urdf.errors import BadFitError, StructureError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.health import few_affected, why_bad
from skin2urdf.estimation.uncertainty.physics import (
    STAND_STILL,
    base_moves,
    felt_at_rest,
    in_odd_units,
    why_unexplained,
)
from skin2urdf.geometry.units import IN_UNITS
from skin2urdf.notes import of_kind
from skin2urdf.signals.sampling import Sampled


def check_hope(found: Estimate) -> None:
    """Refuse an estimate of features that nothing found in all samples could mend.

    Raises:
        BadFitError: it leaves too much of the readings.
    """
    _refuse_beyond(HOPELESS_FIT, found.cost_per_dof, found)


def check_fit(found: Estimate, along: MotionEstimate | None) -> None:
    """Refuse an estimate that does not explain the readings.

    Args:
        found: the estimate.
        along: what all samples say, which decides where there is any.

    Raises:
        BadFitError: it does not.
    """
    cost, limit = (found.cost_per_dof, BAD_FIT) if along is None else (along.misfit, BAD_MISFIT)
    _refuse_beyond(limit, cost, found, along)


@contextmanager
def tell_what_streams_show(sampled: Sequence[Sampled]) -> Iterator[None]:
    """Where no model explains the readings, say first what the streams show by themselves.

    That is a base that moves, or joints whose positions are in another unit.

    Args:
        sampled: the logs.
    """
    try:
        yield
    except (BadFitError, StructureError) as error:
        if told := _told(sampled):
            what, error.remedy = told
            error.args = (f"{what}; {error}",)
        raise


def _told(sampled: Sequence[Sampled]) -> tuple[str, str] | None:
    """What is wrong with the streams and what to do about it, in words; None where nothing is."""
    notes = [note for s in sampled for note in s.notes]
    if turns := [note.size for note in of_kind(notes, "base moves")]:
        return base_moves(max(turns)), STAND_STILL
    if changes := [note.size for note in of_kind(notes, "felt at rest")]:
        return felt_at_rest(max(changes)), STAND_STILL
    if odd := sorted({joint for note in of_kind(notes, "odd unit") for joint in note.joints}):
        return in_odd_units(odd), IN_UNITS
    return None


def _refuse_beyond(
    limit: float, cost: float, found: Estimate, along: MotionEstimate | None = None
) -> None:
    """Refuse an estimate that leaves more of the readings than a limit."""
    if cost <= limit:  # NaN is none
        return
    of_samples = None if along is None else (along.misfit, along.misfit_of_sus)
    what, remedy = why_bad(found, limit, of_samples)
    # What links and joints do is felt by most: it is not that, where most SUs are explained.
    of_few = few_affected(found, limit, of_samples)
    if along is not None and along.tried and not of_few:
        what, remedy = why_unexplained(along.tried, along.misfit, what, remedy)
    raise BadFitError(what, remedy, cost_per_dof=cost)
