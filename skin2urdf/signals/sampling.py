"""Recordings -> samples on a grid: one clock for joints and SUs, rests, poses, usable SUs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool, frozen
from skin2urdf.errors import InsufficientDataError
from skin2urdf.faults import Fault
from skin2urdf.geometry.units import FORCE_UNITS, GRAVITY, IN_UNITS
from skin2urdf.notes import Note, Noted, of_reading
from skin2urdf.recording.holding import as_measured
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.pulses import Read, lonely_spikes
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.recording.shelf import STREAMS_IN_MEMORY, put_away, room_for_streams
from skin2urdf.signals.band import quietness, suitable_cutoffs
from skin2urdf.signals.clocks import su_clocks
from skin2urdf.signals.digits import alike, left_by_averages
from skin2urdf.signals.encoders import without_what_stood
from skin2urdf.signals.filters import sample, spread
from skin2urdf.signals.health import WEIGHTLESS, checked, is_within, unusable
from skin2urdf.signals.mending import computed
from skin2urdf.signals.motion import Motion, joint_motion, travel
from skin2urdf.signals.poses import (
    Neighbourhood,
    Rest,
    find_neighbourhoods,
    find_rests,
    slowest_moments,
)
from skin2urdf.signals.records import StaticMoves, SuClock
from skin2urdf.signals.standing import changes_at_rest
from skin2urdf.signals.swings import Swings
from skin2urdf.signals.turning import Turning, sampled_turning
from skin2urdf.threads import each

_POSED = 0.5
"""Share of the work that is done once poses are found and streams checked."""
_FARTHEST, _FASTEST = 15.0, 20.0
"""Range and speed, per second, of a joint in rad or m that are beyond all joints of arms and hands
together: two turns and a half, at three turns a second. In degrees a quarter turn a second has
both."""
_G_UNITS = (0.5, 2.0)
"""Norm at rest of a sensor that reports g, whatever its bias is."""
_TURNED = 0.1
"""Scatter over the rests, as a part of the norm, from which an SU feels gravity turn: that of less
than 6 deg. What stands still may be a bias alone."""
_UNIT_IS_KNOWN = 0.1
"""Part by which gravity in a unit may be off in every SU: biases of 0.1 g."""
_FEWEST = 5
"""Grid samples of a rest that tell a change of gravity from noise."""
_LEAST_MOVE = 0.09
"""Smallest move [rad or m], and over the DoF's travel where that is less: gravity then turns by
0.9 m/s^2, far more than sensors drift; patterns and sag leave rests that differ by less."""
_ASIDE = 0.25
"""What all other joints may move, by the root of the sum of squares, over the move: an SU that only
they turn then shows less than `activity` asks of one beyond the DoF, 0.3 of the largest effect."""
_MEMORY = 200
"""Rests that a rest is compared with, some minutes: sensors drift, and so do skins."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """One log on its grid, and what was found in it.

    Attributes:
        motion: joint motion.
        rests: where nothing moves.
        neighbourhoods: poses with their windows.
        readings: (N, U, 3) SU readings on the grid [m/s^2].
        valid: (N, U) where they are whole.
        cutoff: of the low-pass that suits the patterns [Hz].
        cutoff_along: of the one that suits all samples [Hz].
        notes: what was found and mended; what the reader says is in words.
        computed: (N, U) where they were missing, and were computed from the rest of the window.
        period: (U,) time between two readings of an SU [s]; 0 for those that have none.
        digits: (U, 2) size of an SU's digits, and what averages leave of them, rms [m/s^2].
        faults: what is wrong with the SUs' streams.
        clocks: SUs whose clock runs differently from the joints'; their samples are set right.
        turning: what gyroscopes read; None where no SU has one.
    """

    motion: Motion
    rests: tuple[Rest, ...]
    neighbourhoods: tuple[Neighbourhood, ...]
    readings: F64
    valid: Bool
    cutoff: float
    cutoff_along: float
    notes: tuple[Noted, ...]
    computed: Bool
    period: F64
    digits: F64
    faults: tuple[Fault, ...] = ()
    clocks: tuple[SuClock, ...] = ()
    turning: Turning | None = None

    @cached_property
    def swings(self) -> Swings:
        """What joints do around the poses."""
        return Swings(self.motion, self.neighbourhoods, self.cutoff)

    @property
    def at_rest(self) -> tuple[Rest, ...]:
        """The rests in which nothing moves, without moments that stand for them."""
        return tuple(rest for rest in self.rests if rest.still)


def sample_recording(
    recording: Recording,
    dof_names: Sequence[str],
    su_names: Sequence[str],
    *,
    must_rest: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> Sampled:
    """Put a recording on one grid and find its poses.

    Args:
        recording: the log.
        dof_names: D joints, and
        su_names: U SUs, in the order that is wanted.
        must_rest: False where its slowest moments may stand for rests that it lacks.
        tell: told the share of the work that is done.

    Raises:
        InsufficientDataError: too few samples, or the robot never rests and has to.
    """
    recording, stood = without_what_stood(recording)
    motion = joint_motion(recording, dof_names)
    odd = _in_odd_units(motion, recording.source)
    rests = find_rests(motion)
    if not rests and not must_rest:
        rests = slowest_moments(motion)
    if not rests:
        raise InsufficientDataError(
            f"{recording.source}: the robot never rests: no quarter of a second in which all "
            "joints keep still",
            "let the robot rest for about a second in every pose, before and after each pattern",
            lacks="rests",
        )
    neighbourhoods = find_neighbourhoods(motion, rests)
    tell(0.5 * _POSED)
    grid = motion.grid
    spans = [(grid.start + r.begin / grid.rate, grid.start + r.end / grid.rate) for r in rests]
    span = (grid.start, grid.start + grid.size / grid.rate)
    n_sus = len(recording.sus)
    measured, held = as_measured(_without_spikes(recording))
    clocks = {clock.su: clock for clock in su_clocks(measured, motion)}
    sus = [_on_time(su, clocks.get(su.name)) for su in measured]
    looked_at = checked(
        sus, spans, span, _pauses(motion), still=rests[0].still, cut=_cut(recording)
    )
    streams = {look.stream.name: look for look in looked_at}
    readings = room_for_streams(grid.size, len(su_names))
    valid = np.zeros((grid.size, len(su_names)), dtype=bool)
    period, quiet = np.zeros(len(su_names)), np.full(len(su_names), np.nan)
    digits = np.zeros((len(su_names), 2))
    notes: list[Noted] = [*recording.notes, *held, *odd]
    faults: list[Fault] = [*stood]
    still = np.zeros(grid.size, dtype=bool)
    for r in rests:
        still[r.begin : r.end] = True

    def put(u: int) -> tuple[list[Noted], list[Fault]]:
        found = streams.get(su_names[u])
        if found is None:
            readings[:, u] = 0.0
            return [], []
        stream, name = found.stream, su_names[u]
        readings[:, u], ok = sample(stream.time, stream.specific_force, grid)
        period[u] = np.median(np.diff(stream.time)) if len(stream.time) > 1 else 0.0
        valid[:, u] = ok & motion.valid & ~spread(stream.time, found.clipped, grid)
        digits[u] = left_by_averages(stream.specific_force, is_within(stream.time, spans))
        stream.put_away()
        factor = _unit(readings[still & valid[:, u], u])
        if factor != 1.0:
            readings[:, u] *= factor
            digits[u] *= factor
        fault = unusable(name, readings[:, u], still, valid[:, u], GRAVITY)
        if fault is not None:
            valid[:, u] = False
        quiet[u] = quietness(readings[:, u], still & valid[:, u], grid.rate)
        told = [] if fault is None or found.faults else [fault]
        return [Note("unit g", (name,))] if factor != 1.0 else [], [*found.faults, *told]

    for u, (noted, broken) in enumerate(each(put, range(len(su_names)), n_sus)):
        tell(_POSED + (1 - _POSED) * u / len(su_names))
        notes += noted
        faults += broken
        if u % STREAMS_IN_MEMORY == 0:
            put_away(readings)
    put_away(readings)
    turning, converted = sampled_turning(
        {name: found.stream for name, found in streams.items()}, su_names, motion, still
    )
    notes += converted
    band = suitable_cutoffs(motion, neighbourhoods, quiet)
    readings, filled = computed(motion, neighbourhoods, band.patterns, readings, valid)
    at_rest = changes_at_rest(rests, readings, valid, motion.q, grid.rate)
    if at_rest.angle:
        notes.append(Note("base moves", size=at_rest.angle))
    elif at_rest.change:
        notes.append(Note("felt at rest", size=at_rest.change))
    return Sampled(
        motion, rests, neighbourhoods, readings, valid | filled, band.patterns, band.along,
        tuple(notes), filled, frozen(period), frozen(alike(digits)), tuple(faults),
        tuple(clocks.values()), turning,
    )  # fmt: skip


def _without_spikes(recording: Recording) -> list[SuStream]:
    """Streams without single samples that no motion made; a log's are left out as it is read."""
    if recording.digest:
        return list(recording.sus)
    spiked = lonely_spikes([Read(su.time, su.specific_force) for su in recording.sus])
    found = zip(recording.sus, spiked, strict=True)
    return [su.at(~alone) if alone.any() else su for su, alone in found]


def _cut(recording: Recording) -> set[str]:
    """SUs of which one stretch is in use, since their clock jumped by itself."""
    jumped = {
        topic for note in of_reading(recording.notes, "own clock jump") for topic in note.sources
    }
    return {su.name for su in recording.sus if su.topic in jumped}


def _pauses(motion: Motion) -> list[tuple[float, float]]:
    """Times [s] in which joints were not recorded."""
    grid = motion.grid
    edges = np.flatnonzero(np.diff(np.r_[True, motion.valid, True].astype(np.int8)))
    return [
        (grid.start + a / grid.rate, grid.start + b / grid.rate) for a, b in edges.reshape(-1, 2)
    ]


def _on_time(su: SuStream, clock: SuClock | None) -> SuStream:
    """The stream on the joints' clock."""
    return su if clock is None else replace(su, time=clock.undone(su.time))


def _in_odd_units(motion: Motion, source: str) -> list[Note]:
    """Joints that go farther and faster than any does in rad or m.

    Raises:
        InsufficientDataError: they are most of those that move.
    """
    span, speed = np.ptp(motion.q, axis=0), np.abs(motion.qd).max(axis=0)
    odd = (span > _FARTHEST) & (speed > _FASTEST)
    if 2 * odd.sum() > (span > 0).sum():
        raise InsufficientDataError(
            f"{source}: joint positions span {np.median(span[odd]):.0f} and move at up to "
            f"{np.median(speed[odd]):.0f} per second: they look like degrees "
            "or millimetres",
            IN_UNITS,
            lacks="radians",
        )
    names = motion.dof_names
    return [Note("odd unit", joints=(names[d],), size=float(span[d])) for d in np.flatnonzero(odd)]


def _unit(static: F64) -> float:
    """Factor that makes a stream's static readings m/s^2."""
    if not len(static):
        return 1.0
    size = float(np.median(np.linalg.norm(static, axis=1)))
    turns = np.linalg.norm(static.std(axis=0)) > _TURNED * size
    least, most = _G_UNITS if turns else (1 - _UNIT_IS_KNOWN, 1 + _UNIT_IS_KNOWN)
    return GRAVITY if least < size < most else 1.0


def sampled_together(
    recordings: Sequence[Recording],
    *,
    must_rest: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> tuple[list[Sampled], tuple[str, ...]]:
    """All logs of one robot on their grids, and the names of the SUs that occur in any of them.

    Args:
        recordings: the logs.
        must_rest: False where slowest moments may stand for rests.
        tell: told the share of the work that is done.

    Raises:
        InsufficientDataError: there are no joints or no SUs at all, a log can not be used, or no SU
            of any log feels gravity.
    """
    dofs = tuple(sorted({joint.name for r in recordings for joint in r.joints}))
    sus = tuple(sorted({su.name for r in recordings for su in r.sus}))
    if not dofs or not sus:
        what = "accelerometer readings" if dofs else "joint positions"
        raise InsufficientDataError(
            f"{', '.join(r.source or 'the recording' for r in recordings)}: no {what}",
            "record the joint states and the SUs' topics together in one log",
            lacks="SUs" if dofs else "joints",
        )
    out = []
    for i, recording in enumerate(recordings):

        def part(share: float, i: int = i) -> None:
            tell((i + share) / len(recordings))

        out.append(sample_recording(recording, dofs, sus, must_rest=must_rest, tell=part))
    _check_gravity(out)
    return out, sus


def _check_gravity(sampled: Sequence[Sampled]) -> None:
    """Raise where no SU can be used and those that read anything read no gravity, or far more."""
    odd = [fault for s in sampled for fault in s.faults if fault.kind == "wrong unit"]
    if not odd or any(s.valid.any() for s in sampled):
        return
    sizes = [fault.size for fault in odd]
    subjects = shortened(sorted({fault.subject for fault in odd}))
    if min(sizes) > 1.0:
        raise InsufficientDataError(
            f"the SUs read {np.median(sizes):.4g} times gravity at rest ({subjects}): "
            f"their readings are not in m/s^2{_as_if_in(sizes)}",
            "publish m/s^2, as sensor_msgs/Imu has it, or write a table whose headers name the "
            "unit: see `skin2urdf guide formats`",
            lacks="gravity",
        )
    if max(sizes) >= WEIGHTLESS:
        return
    raise InsufficientDataError(
        f"the SUs feel no gravity at rest ({subjects}): something takes it off their readings",
        "record what the accelerometers read, gravity included, as sensor_msgs/Imu has it (REP "
        "145); a driver that sends linear acceleration without gravity has an option or another "
        "topic for that",
        lacks="gravity",
    )


def _as_if_in(sizes: Sequence[float]) -> str:
    """The units in which gravity is so many times as large, in words; nothing where in none."""
    units = [
        unit
        for unit, factor in FORCE_UNITS.items()
        if all(abs(size * factor - 1) < _UNIT_IS_KNOWN for size in sizes)
    ]
    return f", but look like {' or '.join(units)}" if units else ""


def static_moves(sampled: Sequence[Sampled]) -> StaticMoves:
    """Readings at rest before and after a single DoF moved (paper II-B.1).

    Held joints creep by counts and sag, and robots that move as they please change several joints
    from one rest to the next. So a move counts where one DoF makes most of it, and a rest is
    compared with the latest earlier one from which it differs by such a move.
    """
    dofs, distances, changes, doubts = [], [], [], []
    moved = np.zeros(len(sampled[0].motion.dof_names), dtype=bool)
    for s in sampled:
        here = s.motion.moved
        moved |= here
        least = np.where(here, np.minimum(_LEAST_MOVE, _LEAST_MOVE * travel(s.motion)), np.inf)
        rests = s.at_rest
        q = np.array([rest.q for rest in rests])
        for k in range(1, len(rests)):
            if not (np.abs(q[k] - q[k - 1]) >= least).any():
                continue  # the same place again
            steps = q[k] - q[:k][-_MEMORY:][::-1]
            dof = np.abs(steps).argmax(axis=1)
            size = np.abs(steps)[np.arange(len(steps)), dof]
            others = np.sqrt(np.maximum((steps**2).sum(axis=1) - size**2, 0.0))
            single = np.flatnonzero((size >= least[dof]) & (others <= _ASIDE * size))
            if not len(single):
                continue
            back = single[0]
            dofs.append(int(dof[back]))
            distances.append(float(steps[back, dof[back]]))
            changes.append(_mean(s, rests[k]) - _mean(s, rests[k - 1 - back]))
            doubts.append(GRAVITY * float(np.abs(steps[back]).sum() - size[back]))
    U = sampled[0].readings.shape[1]
    return StaticMoves(
        np.array(dofs, dtype=np.int64),
        np.array(distances),
        np.array(changes).reshape(-1, U, 3),
        np.array(doubts),
        moved,
    )


def _mean(s: Sampled, rest: Rest) -> F64:
    """(U, 3) mean readings over a rest, NaN where an SU has hardly a valid sample."""
    trim = min(12, (rest.end - rest.begin) // 4)
    part = slice(rest.begin + trim, rest.end - trim)
    valid = s.valid[part, :, None]
    total, number = (s.readings[part] * valid).sum(axis=0), valid.sum(axis=0)
    return np.where(number >= _FEWEST, total / np.maximum(number, 1), np.nan)
