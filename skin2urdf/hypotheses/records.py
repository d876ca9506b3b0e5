"""What kinds of faults tell each other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Turn:
    """An encoder that counts the other way from a moment in a log on.

    Attributes:
        dof: the joint.
        log: index of the log.
        between: times between which it is [s].
    """

    dof: str
    log: int
    between: tuple[float, float]
