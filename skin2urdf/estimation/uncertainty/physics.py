"""What real robots have and ideal ones have not, in words, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees

STAND_STILL = "record while it stands still, or fix it"
"""What to do about a base that moves."""
IMPOSSIBLE_SLACK = (
    "joints off their encoders by two degrees or more, other in every place, which no gear allows: "
    "the tree lacks a joint, or positions are commands",
    "put an SU on every segment, move one joint at a time now and then, see that positions are "
    "measured ones",
)
"""What it means where slack explains the readings that is none, and what to do about it."""
_PHYSICS = {
    "elastic": (
        "joints that yield under load",
        "links that give way look alike: log the positions of the links if the robot has encoders "
        "behind its gears",
    ),
    "base": (
        "a base that gives way",
        "put an SU on the base, and fix it more stiffly",
    ),
    "tilts": (
        "a base that tilts by itself",
        STAND_STILL,
    ),
    "play": (
        "joints with play",
        "have the gears' play taken up, or log the positions of the links if the robot has "
        "encoders behind its gears",
    ),
    "nonlinearity": (
        "sensors that are not linear",
        "use sensors of less nonlinearity",
    ),
    "drift": (
        "biases that drift",
        "let the sensors warm up before recording",
    ),
    "warming": (
        "scales that drift",
        "let the sensors warm up before recording",
    ),
    "clock": (
        "clocks of joints and SUs that wander against each other",
        "stamp both by one clock, or keep clocks together (PTP, chrony)",
    ),
    "lags": (
        "joints that are read one after another under one stamp",
        "read them all at once, or stamp each when it is read",
    ),
    "smoothed": (
        "positions that are smoothed before they are logged, as by a low-pass",
        "log positions as encoders have them",
    ),
    "ratio": (
        "joints that move by another share than their positions say",
        "see that each driver has the right gear ratio and encoder scale",
    ),
    "harmonics": (
        "uneven gears or encoders",
        "see that encoders are centred and their tables of corrections are loaded, and log the "
        "positions of the links if the robot has encoders behind its gears",
    ),
    "ripples": (
        "ripples of gears",
        "log the positions of the links if the robot has encoders behind its gears",
    ),
    "creep": (
        "encoders whose zeros creep",
        "see that couplings and belts do not slip and that encoders lose no counts",
    ),
    "homed": (
        "encoders whose zeros are others in another log",
        "home them once, before the first log, and see that couplings and belts do not slip",
    ),
    "slack": (
        "joints off their encoders by other amounts in every place, as play, a base that gives way "
        "and loads that are taken up and put down make them",
        "put an SU on the base, fix it more stiffly, carry nothing, and check the joints for play",
    ),
}
"""What causes are called, and what to do about them."""


def physics_found(causes: Sequence[str]) -> tuple[str, str] | None:
    """What was found that a rigid robot with steady sensors has not, and what to do about it.

    Args:
        causes: names of what a fit of all samples has added, the first first.

    Returns:
        What it is, and its cures, each once; None where nothing was found.
    """
    known = [_PHYSICS[cause] for cause in causes]
    if not known:
        return None
    what, cures = (list(dict.fromkeys(words)) for words in zip(*known, strict=True))
    return " and ".join(what), "; ".join(cures)


def why_unexplained(
    tried: Mapping[str, float], misfit: float, what: str, remedy: str
) -> tuple[str, str]:
    """What a bad fit of all samples looks like once physics was tried, and what to do about it.

    Args:
        tried: misfit with each cause that was tried.
        misfit: the misfit of the best.
        what: what the features look like.
        remedy: what is done about that.
    """
    likely = min(tried, key=lambda cause: tried[cause])
    name, cure = _PHYSICS[likely]
    told = (
        f"{what}; of what real robots have, {name} explain the samples best, and "
        f"leave {misfit:.0f} times what noise would"
    )
    return told, f"{cure}; otherwise {remedy}"


def base_moves(angle: float) -> str:
    """What shows that a base moves, in words.

    Args:
        angle: by which gravity turns in half a second at rest [rad].
    """
    return (
        f"the base moves by itself: gravity turns by {degrees(angle):.2g} deg in half a second, "
        "in all SUs alike, while no joint moves"
    )


def felt_at_rest(change: float) -> str:
    """What shows that a base moves at times, or is shaken, in words.

    Args:
        change: of what SUs feel from one half second at rest to the next [m/s^2].
    """
    return (
        f"while no joint moves, what the SUs feel changes by {change:.2g} m/s^2 from one half "
        "second to the next, in most of them at a time: the base drives or turns, or something "
        "shakes the robot"
    )


def in_odd_units(joints: Sequence[str]) -> str:
    """What positions look like that go farther and faster than any in rad or m, in words.

    Args:
        joints: whose positions they are.
    """
    return (
        f"{', '.join(joints)} {'go' if len(joints) > 1 else 'goes'} farther and faster than any "
        "joint does in rad or m: the positions look like degrees, millimetres or counts"
    )
