"""The beginning of a calibration: clocks of joints, features, structure and a first estimate.

Publishers of joint states may run on clocks of their own. What is far off is found before all else;
what is left bends the first estimate little enough for all samples to tell the rest, and all begins
again with joints on one clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from skin2urdf.calibration.at_rest import estimate_at_rest, is_likelier
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.gravity_of_slides import with_gravity_of_slides
from skin2urdf.calibration.late import late_publishers
from skin2urdf.calibration.refusal import tell_what_streams_show
from skin2urdf.calibration.rounds import (
    Logs,
    Solution,
    Structure,
    estimate_robot,
    find_structure,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError, Skin2UrdfError
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.publishers import likelihood
from skin2urdf.hypotheses.corrected import Corrected, evident_errors
from skin2urdf.recording.records import Recording
from skin2urdf.signals.encoders import corrected
from skin2urdf.signals.gaits import are_gaits
from skin2urdf.signals.motion import publishers_beyond_first
from skin2urdf.signals.publishers import joint_clocks, on_one_clock, together
from skin2urdf.signals.records import Features, JointClock
from skin2urdf.signals.sampling import Sampled

_ROUNDS = 2
"""Times that all begins again with clocks of publishers set right, at most: what is off by 30 ms
is found to 1 ms where features are bent by it, and to 10 us where they are not."""
_BENDING = 1e-4
"""Time [s] by which a publisher's stamps may be late: of a pattern of 1 rad/s 0.1 mrad."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """What a calibration begins with.

    Attributes:
        recordings: the logs, with joints on one clock.
        publishers: by log, the clocks that were set right.
        leaps: errors of encoders that are evident from a joint's track alone.
        logs: the logs on their grids, without these.
        features: their first features.
        structure: what these show.
        first: the first estimate; None where patterns contradict every tree, and for the paper's
            method, which makes its own.
        of_patterns: whether that rests on patterns, rather than on rests and moves.
    """

    recordings: tuple[Recording, ...]
    publishers: tuple[tuple[JointClock, ...], ...]
    leaps: tuple[Corrected, ...]
    logs: Logs
    features: Features
    structure: Structure
    first: Solution | None
    of_patterns: bool


def begin(
    recordings: Sequence[Recording], settings: CalibrationSettings, clock: Clock
) -> Beginning:
    """Begin a calibration.

    Args:
        recordings: the logs, every stream on its own clock.
        settings: choices.
        clock: runs the stages.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: no SU feels any joint move.
    """
    begun = _on_time(recordings, settings, clock)
    of_slides = with_gravity_of_slides(begun.first, clock)
    if of_slides is None:
        return begun
    # Clocks do not go by how large gravity is.
    return _begun(recordings, begun.publishers, of_slides, clock)


def _on_time(
    recordings: Sequence[Recording], settings: CalibrationSettings, clock: Clock
) -> Beginning:
    """The beginning, with clocks of publishers as all samples show them."""
    rough = clock.run("clocks", lambda _: tuple(map(joint_clocks, recordings)))
    begun = _begun(recordings, ((),) * len(recordings), settings, clock)
    if settings.method == "paper" or not _has_several(begun.logs.sampled):
        return begun
    looked = _look(begun, clock)
    if any(rough):
        # Readings of some seconds propose; all samples decide.
        other = _begun(recordings, rough, settings, clock)
        along = _look(other, clock)
        if _likelihood(along) > _likelihood(looked):
            begun, looked = other, along
    for _ in range(_ROUNDS):
        late = late_publishers(looked, begun.logs.sampled)
        if not _bends(late, begun.logs.sampled):
            break
        publishers = tuple(map(together, begun.publishers, late))
        begun = _begun(recordings, publishers, settings, clock)
        looked = _look(begun, clock)
    return begun


def _begun(
    recordings: Sequence[Recording],
    publishers: tuple[tuple[JointClock, ...], ...],
    settings: CalibrationSettings,
    clock: Clock,
) -> Beginning:
    """The beginning with clocks of publishers as they are known."""
    on_time = tuple(map(on_one_clock, recordings, publishers))
    # No joint leaps: what its track alone shows to be wrong is taken off before the first look.
    leaps = clock.run("leaps", lambda _: evident_errors(on_time))
    begun = _without_leaps(on_time, publishers, leaps, settings, clock)
    if not leaps or begun.of_patterns or settings.method == "paper":
        return begun
    # Where patterns tell, the search has the last word about leaps; else all samples have it.
    try:
        whole = _without_leaps(on_time, publishers, (), settings, clock)
    except Skin2UrdfError:
        return begun
    return whole if _are_denied(begun, whole, clock) else begun


def _are_denied(begun: Beginning, whole: Beginning, clock: Clock) -> bool:
    """Whether all samples find logs with their leaps likelier for certain than without.

    Args:
        begun: without.
        whole: with them. Where it has other SUs, readings of the same ones can not be compared.
        clock: runs the stages.
    """
    if begun.first is None or whole.first is None:
        return False
    if set(begun.first.found.tree.su_names) != set(whole.first.found.tree.su_names):
        return False
    looked, there = _look(begun, clock), _look(whole, clock)
    return looked is not None and there is not None and is_likelier(looked, there)


def _without_leaps(
    on_time: Sequence[Recording],
    publishers: tuple[tuple[JointClock, ...], ...],
    leaps: Sequence[Corrected],
    settings: CalibrationSettings,
    clock: Clock,
) -> Beginning:
    """The beginning of logs with some leaps taken off."""
    logs = sample_logs(corrected(on_time, [leap.error for leap in leaps]), settings, clock)
    features = take_features(logs, clock)
    first, of_patterns = None, True
    with tell_what_streams_show(logs.sampled):
        structure = find_structure(logs, features, clock)
        if settings.method != "paper":
            first, of_patterns = _first_estimate(logs, features, structure, clock)
            logs = logs if first is None or of_patterns else first.logs
    return Beginning(
        tuple(on_time), publishers, tuple(leaps), logs, features, structure, first, of_patterns
    )


def _first_estimate(
    sampled: Logs, features: Features, structure: Structure, clock: Clock
) -> tuple[Solution | None, bool]:
    """What patterns say, or else rests and moves, and whether patterns do.

    Gaits are no patterns, and tell only where rests and moves say too little.

    Returns:
        The estimate, None where patterns contradict every tree, and whether it is of patterns.

    Raises:
        InsufficientDataError: neither say enough.
        StructureError: no SU feels any joint move.
    """
    if not structure.seen.patterns_felt:
        return estimate_at_rest(sampled, structure, clock), False
    if sampled.settings.motion == "all" and are_gaits(sampled.sampled):
        with suppress(Skin2UrdfError):
            return estimate_at_rest(sampled, structure, clock), False
    try:
        return estimate_robot(sampled, features, structure, clock), True
    except InsufficientDataError as lack:
        # What looks like patterns may be too little of them, beside moves that say more.
        if sampled.settings.motion != "all":
            raise
        try:
            return estimate_at_rest(sampled, structure, clock), False
        except Skin2UrdfError:
            raise lack from None


def _has_several(sampled: Sequence[Sampled]) -> bool:
    """Whether several publishers move joints in any of the logs."""
    return any(publishers_beyond_first(s.motion.publisher, s.motion.moved) for s in sampled)


def _look(begun: Beginning, clock: Clock) -> MotionEstimate | None:
    """What all samples say of a first estimate; None where there is none, or features alone count.

    Features do not tell: what a late joint leaves in their regressions looks like noise.
    """
    first = begun.first
    if first is None or first.logs.settings.motion != "all":
        return None
    return clock.run("all samples", lambda tell: fit_samples(first, tell, look_further=False))


def _likelihood(along: MotionEstimate | None) -> float:
    """That of all samples; less than any where there is no fit of them."""
    return -np.inf if along is None else likelihood(along.fitted)


def _bends(late: Sequence[Sequence[JointClock]], sampled: Sequence[Sampled]) -> bool:
    """Whether clocks (by log) are off by more than features can bear."""
    half = 0.5 * max(s.motion.grid.size / s.motion.grid.rate for s in sampled)
    return any(
        abs(clock.latency) + half * abs(clock.drift) > _BENDING
        for of_log in late
        for clock in of_log
    )
