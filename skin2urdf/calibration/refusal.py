"""The refusal of estimates that do not explain the readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from skin2urdf.calibration.result import BAD_FIT, BAD_MISFIT, HOPELESS_FIT
from skin2urdf.errors import BadFitError, StructureError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.health import why_bad
from skin2urdf.estimation.uncertainty.physics import (
    STAND_STILL,
    base_moves,
    felt_at_rest,
    why_unexplained,
)
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
def tell_of_moving_bases(sampled: Sequence[Sampled]) -> Iterator[None]:
    """Where no model explains the readings, say first that the base moves, if it does.

    Args:
        sampled: the logs.
    """
    try:
        yield
    except (BadFitError, StructureError) as error:
        if told := _of_the_base(sampled):
            error.args = (f"{told}; {error}",)
            error.remedy = STAND_STILL
        raise


def _of_the_base(sampled: Sequence[Sampled]) -> str:
    """What shows that the base moves by itself, in words; none where nothing does."""
    notes = [note for s in sampled for note in s.notes]
    if turns := [note.size for note in of_kind(notes, "base moves")]:
        return base_moves(max(turns))
    if changes := [note.size for note in of_kind(notes, "felt at rest")]:
        return felt_at_rest(max(changes))
    return ""


def _refuse_beyond(
    limit: float, cost: float, found: Estimate, along: MotionEstimate | None = None
) -> None:
    """Refuse an estimate that leaves more of the readings than a limit."""
    if cost <= limit:  # NaN is none
        return
    of_samples = None if along is None else (along.misfit, along.misfit_of_sus)
    what, remedy = why_bad(found, limit, of_samples)
    if along is not None and along.tried:
        what, remedy = why_unexplained(along.tried, along.misfit, what, remedy)
    raise BadFitError(what, remedy, cost_per_dof=cost)
