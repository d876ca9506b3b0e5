"""Words about faults, made of their numbers: what is wrong, what was done about it, what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skin2urdf.faults import Fault

_CHECK_SENSOR = "check its cable and its driver"
_CHECK_CONSTANT = (
    f"{_CHECK_SENSOR}; where it stands still and its digits are coarser than its noise, nothing is "
    "wrong with it, but it tells nothing either"
)
_NAMED = 4
"""SUs that are named at most; others are counted."""


@dataclass(frozen=True)
class Words:
    """A fault in words.

    Attributes:
        what: a sentence: what is wrong, where, and what was done about it.
        remedy: what to check or to record.
    """

    what: str
    remedy: str

    def __str__(self) -> str:
        """Both in one line."""
        return f"{self.what}: {self.remedy}"


def fault_words(fault: Fault, n_logs: int) -> Words:
    """A fault in words.

    Args:
        fault: the fault.
        n_logs: number of logs; one log needs no number.
    """
    log = f" of log {fault.log + 1}" if fault.log is not None and n_logs > 1 else ""
    match fault.kind:
        case "encoder sign" | "encoder scale" | "encoder jump":
            return _of_an_encoder(fault, log)
        case "contact":
            felt = ", ".join(fault.sus[:_NAMED])
            more = f" and {len(fault.sus) - _NAMED} others" if len(fault.sus) > _NAMED else ""
            return Words(
                f"something hit or pushed the robot at {fault.begin:.1f} s{log}: {fault.subject} "
                f"moved without its encoder seeing all of it, felt by {felt}{more}; those readings "
                "are left out",
                "keep people and things away from the robot while it moves",
            )
        case "loose":
            return _of_a_slip(fault, log)
        case "bias step":
            return _of_a_bias(fault, log)
        case "swapped":
            return _of_names(fault, log)
        case "mirrored":
            return Words(
                f"{fault.subject} reports negated readings or a left-handed frame, unlike the "
                "other SUs; it was calibrated on the negated readings",
                "mind that when you use its frame",
            )
        case _:
            return _of_a_stream(fault)


def _of_a_stream(fault: Fault) -> Words:
    """Faults that show in an SU's stream alone."""
    su, percent = fault.subject, 100 * fault.size
    match fault.kind:
        case "saturated":
            what = f"is at the end of its range in {percent:.3g} % of its samples; they were left"
            return Words(f"{su} {what} out", "use a larger range or weaker patterns")
        case "intermittent":
            gap = fault.end - fault.begin
            what = f"lost {percent:.0f} % of its samples (longest gap {gap:.2f} s); what is there"
            return Words(f"{su} {what} was used", _CHECK_SENSOR)
        case "noisy" if fault.detail == "impulses":
            what = "leaves its value again and again while the robot rests, and comes back:"
            what += f" {fault.size:.0f} times its noise; it is left out"
            return Words(f"{su} {what}", _CHECK_SENSOR)
        case "noisy":
            what = f"has {fault.size:.0f} times the noise of the other SUs and counts accordingly"
            return Words(f"{su} {what} less", "check its fixing, its supply and its filter")
        case "unattached":
            what = "moves as often while all joints rest as while they move, and no other SU does;"
            return Words(
                f"{su} {what} it is left out",
                "see whether it is on this robot, fixed to it and on time; if it is of something "
                f"else, leave it out (--without {su})",
            )
        case "wrong unit":
            what = f"reads {fault.size:.2g} g at rest and is left out"
            check = "check its unit and its scale, and whether its driver takes gravity off"
            return Words(f"{su} {what}", check)
        case "frozen" if fault.detail == "encoder":
            what = (
                f"{su}'s encoder repeats one value for {fault.size:.1f} s between "
                f"{fault.begin:.1f} and {fault.end:.1f} s, while {su} moves; these times were left "
                "out"
            )
            return Words(what, _CHECK_SENSOR)
        case "frozen" if fault.detail in ("x axis", "y axis", "z axis"):
            what = f"has one value on its {fault.detail} all the time and is left out"
            return Words(f"{su} {what}", _CHECK_SENSOR)
        case "frozen" if fault.detail != "always":
            what = (
                f"repeats one value for {fault.size:.1f} s between {fault.begin:.1f} and "
                f"{fault.end:.1f} s; these samples were left out"
            )
            return Words(f"{su} {what}", _CHECK_SENSOR)
        case "frozen":
            return Words(f"{su} repeats one value all the time and is left out", _CHECK_CONSTANT)
    if fault.detail == "silent":
        times = [f"until {fault.begin:.1f} s"] if math.isfinite(fault.begin) else []
        times += [f"from {fault.end:.1f} s on"] if math.isfinite(fault.end) else []
        what = f"sends nothing {' and '.join(times)}; the rest of its readings was used"
        return Words(f"{su} {what}", _CHECK_SENSOR)
    when = {
        "no samples": "has no samples while the joints were recorded,",
        "no samples at rest": "has no samples while the robot rests,",
    }.get(fault.detail, "is dead: it reads one value all the time, in which there is no gravity,")
    return Words(f"{su} {when} and is left out", _CHECK_SENSOR)


def _when(fault: Fault, log: str) -> str:
    """Between which times an SU changed."""
    if fault.log is not None and fault.end_log is not None and fault.log < fault.end_log:
        return f"between log {fault.log + 1} and log {fault.end_log + 1}"
    return f"between {fault.begin:.0f} and {fault.end:.0f} s{log}"


def _of_a_bias(fault: Fault, log: str) -> Words:
    """An SU whose bias is another from some time on."""
    step = f"{1e3 * fault.size:.1f} mg {_when(fault, log)}"
    return Words(
        f"the bias of {fault.subject} stepped by {step}; its readings before are those of "
        f"{fault.sus[1]}, which sits in the same place",
        "check its supply and its temperature",
    )


def _of_a_slip(fault: Fault, log: str) -> Words:
    """An SU that sits elsewhere from some time on."""
    when = _when(fault, log)
    distance = f"{1e3 * fault.size:.1f} mm and " if math.isfinite(fault.size) else ""
    turn = f"{distance}{np.rad2deg(fault.turn):.2f} deg {when}"
    placed = f"its placement is the later one, the earlier one is {fault.sus[1]}"
    if fault.detail == "or its encoder":
        return Words(
            f"{fault.subject} is loose, or the encoder of its joint has jumped: it moved about the "
            f"joint's axis by {turn}; {placed}",
            "check both and record again",
        )
    return Words(
        f"{fault.subject} is loose: it moved by {turn}; {placed}",
        "fix it rigidly and record again",
    )


def _of_names(fault: Fault, log: str) -> Words:
    """An SU that has another's name."""
    (called,) = fault.sus
    if fault.detail == "in a log":
        return Words(
            f"{fault.subject} is called {called} from {fault.begin:.2f} s{log} on: the names are "
            "swapped; the earlier ones were used",
            "check the names of the SUs and their cables",
        )
    return Words(
        f"{fault.subject} is called {called}{log.replace(' of', ' in')}: the names are swapped; "
        "those of the log with the most poses were used",
        "check the names of the SUs in the logs",
    )


def _of_an_encoder(fault: Fault, log: str) -> Words:
    """An encoder that counts the other way, by another factor, or from another zero."""
    joint, from_a_time = fault.subject, math.isfinite(fault.begin)
    if fault.kind == "encoder sign" and from_a_time:
        return Words(
            f"{joint} counts the other way from {fault.begin:.2f} s{log} on; its positions after "
            "it were mirrored",
            "check the encoder's cables and what changed then: the URDF's axis and zero are those "
            "of the log's beginning",
        )
    if fault.kind == "encoder sign":
        return Words(
            f"{joint} counts the other way{log.replace(' of', ' in')} than in the first; its "
            "positions in that log were taken negative",
            "check what changed between the logs: the URDF's axis is for the first log's sense",
        )
    if fault.kind == "encoder scale":
        return Words(
            f"{joint} reports {fault.size:.5f} (sd {fault.deviation:.5f}) times its true motion; "
            "it was calibrated on the corrected positions, and so are its limits",
            f"divide its positions by {fault.size:.5f} before you use the URDF: check the gear "
            "ratio and the encoder's resolution in the driver",
        )
    unit, factor = ("deg", float(np.degrees(1.0))) if fault.unit == "rad" else ("mm", 1e3)
    sure = f" (sd {factor * fault.deviation:.3f})" if math.isfinite(fault.deviation) else ""
    where = f"at {fault.begin:.2f} s" if from_a_time else "as against the first log"
    return Words(
        f"{joint}'s encoder jumps by {factor * fault.size:.2f} {unit}{sure} {where}{log}; "
        "positions after it were corrected",
        "check the coupling between joint and encoder, its index and its cable; the URDF's zero "
        "is that of the first log's beginning",
    )
