"""What changes in the middle of a log: an encoder counts the other way, SUs exchange their names.

Most poses of the log, of its first half or of its second are of one kind, and an estimate explains
them. All poses are held against it, each for itself: what follows from it if a joint counts the
other way, or if an SU has another name, does so up to some pose or from some pose on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.calibration.rounds import Logs
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.arising import turning_between
from skin2urdf.hypotheses.attempts import Search, imitations, of_logs
from skin2urdf.hypotheses.corrected import Corrected, errors_of
from skin2urdf.hypotheses.measure import excess, explains
from skin2urdf.hypotheses.names import columns_of, names_in
from skin2urdf.hypotheses.parts import sound_part
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.hypotheses.sense import FOLLOWED, TURNED, felt_at_rest, felt_in_patterns
from skin2urdf.signals.encoders import reversal, standstill
from skin2urdf.signals.mending import computed
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.records import EncoderError, Features
from skin2urdf.signals.sampling import Sampled

_ALLOWANCE = 3.0
"""Time of a change into a pose, over what the pose's misfit says: patterns begin gently."""
_MIXED = 0.5
"""Share of a pose that may be of the other kind, from which it tells neither."""
_BLUR = 2
"""Grid samples on either side of an exchange that may be of both SUs."""


@dataclass(frozen=True)
class Exchanged(Amendment):
    """SUs that have other names from some moment in a log on.

    Attributes:
        log: index of the log.
        names: the SUs, and
        called: the names they have later.
        between: times between which they got them [s].
        begin: the time at which they did [s].
    """

    log: int
    names: tuple[str, ...]
    called: tuple[str, ...]
    between: tuple[float, float]
    begin: float

    def of_logs(self, logs: Logs) -> Logs:
        """The logs with the earlier names."""
        sampled = list(logs.sampled)
        columns = columns_of(logs, self.names, self.called)
        sampled[self.log], _ = _renamed_from(sampled[self.log], columns, self.between)
        return logs.of(sampled)


class Changes:
    """What changes in the middle of a log: the sense of an encoder, the names of SUs."""

    rank: Literal[0, 1, 2] = 1

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """All that changes in any log, senses and names apart."""
        if now is not None and explains(now.solution.found):
            return []
        found = None if now is None else now.solution.found
        drop = np.inf if found is None else excess(found)
        known = () if now is None else now.amendments
        return [
            Candidate(kind, tuple(subjects), new, drop, instead=imitations(search, now, subjects))
            for kind, subjects, new in search.once("changes", lambda: _changes(search, found))
            if new[0] not in known
        ]

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """The names that were exchanged; senses are told with the other errors of encoders."""
        return [
            Fault("swapped", name, "in a log", log=a.log, begin=a.begin, sus=(called,))
            for a in last.amendments if isinstance(a, Exchanged)
            for name, called in zip(a.names, a.called, strict=True)
        ]  # fmt: skip


def _changes(
    search: Search, found: Estimate | None
) -> list[tuple[str, list[str], tuple[Amendment, ...]]]:
    """Kind, subjects and amendments of what changes within logs.

    Args:
        search: has the logs.
        found: an estimate from all of them, where there is one.
    """
    logs = search.plain
    tree = None if found is None else of_logs(found.tree, logs)
    exchanges, turns = list[Exchanged](), list[Corrected]()
    for log, s in enumerate(logs.sampled):
        sound = sound_part(logs.of([s]), tree, search.clock)
        if sound is None:
            continue
        known, poses = sound
        turns += [
            _turned(search, (known, poses), log, turn)
            for turn in turns_within(known, poses, s.motion)
        ]
        exchange = _exchange(known, poses)
        if exchange is not None:
            names, called, between = exchange
            _, time = _renamed_from(s, columns_of(logs, names, called), between)
            exchanges.append(Exchanged(log, tuple(names), tuple(called), between, time))
    out = list[tuple[str, list[str], tuple[Amendment, ...]]]()
    if turns:
        out.append(("encoder turn", [turn.error.dof for turn in turns], tuple(turns)))
    if exchanges:
        out.append(("swapped in a log", [n for e in exchanges for n in e.names], tuple(exchanges)))
    return out


@dataclass(frozen=True)
class Turn:
    """A joint that counts the other way from some time on.

    Attributes:
        joint: its number in the tree.
        between: times between which it begins to [s].
        about: sum of its positions with either sense [rad]; NaN where that is not known.
        late: whether it is the earlier poses that differ from what is known.
    """

    joint: int
    between: tuple[float, float]
    about: float
    late: bool


def turns_within(known: Estimate, poses: Features, motion: Motion) -> Iterator[Turn]:
    """Joints of a tree that change their sense, and when.

    Args:
        known: an estimate from sound poses of the same robot.
        poses: features of one log, each visit to a pose for itself.
        motion: of the joints in that log.
    """
    patterns = felt_in_patterns(known, poses)
    both = patterns.with_more(felt_at_rest(known, poses))
    # Of two senses in one pose its patterns tell, where it has any.
    share = _doubtful(np.where(np.isfinite(patterns.ratio), patterns.ratio, both.ratio))
    for d in range(known.tree.n_joints):
        ratio = both.ratio[:, d]
        # Another zero is as good as a value to be mirrored about, but for the patterns.
        differs = (ratio < FOLLOWED) & ~(patterns.ratio[:, d] > 1.0)
        tells = differs | (ratio > 1 / FOLLOWED)
        own = motion.dof_names.index(known.tree.joint_names[d])
        reach = _reach(share[:, d], poses, motion.grid.time, motion.qd[:, own])
        turn = _Change.of(poses, differs, tells, reach)
        if turn is None:
            continue
        # One value to be mirrored about may suit a single pose in which something else is wrong.
        pure = ~(share[:, d] >= _MIXED)
        later = poses.span.mean(axis=1) > sum(turn.between) / 2
        left = np.where(later != turn.late, both.turned[:, d], both.same[:, d])
        if left[pure].sum() < TURNED * both.same[pure, d].sum():
            yield Turn(d, turn.between, float(both.about[d]), turn.late)


def _turned(search: Search, known: tuple[Estimate, Features], log: int, turn: Turn) -> Corrected:
    """An encoder mirrored from where its sense changes in a log.

    A leap of the track tells when that was; else the track itself, where it turns round at once.
    Of standstills that would hide it, the readings tell which.
    """
    dof = known[0].tree.joint_names[turn.joint]
    begin, end = turn.between
    leaps = [
        e for e in errors_of(search.evident)
        if (e.dof, e.log) == (dof, log) and begin < e.begin < end
    ]  # fmt: skip
    if leaps:
        at = max(leaps, key=lambda e: abs(e.size)).begin
    else:
        recordings = list(search.recordings)
        for each in search.evident:
            recordings = each.of_recordings(recordings)
        (track,) = (j for j in recordings[log].joints if j.name == dof)
        sharp = reversal(track, turn.between)
        if sharp is not None:
            at = sharp
        else:
            s = search.plain.sampled[log]
            between = turning_between(dof, turn.between, turn.about, turn.late, known, s)
            at = standstill(track, between)
    return Corrected(EncoderError("sign", dof, -1.0, log, at))


@dataclass(frozen=True)
class _Change:
    """Something that was one way before, and another way after.

    Attributes:
        between: times between which it changed [s].
        late: whether it is the earlier poses that differ from what is known.
    """

    between: tuple[float, float]
    late: bool

    @classmethod
    def of(cls, poses: Features, differs: Bool, tells: Bool, reach: F64) -> _Change | None:
        """The change of P poses, where there is just one.

        Args:
            poses: their features, in the order of time.
            differs: (P,) True where a pose is unlike what is known.
            tells: (P,) False for poses that say nothing of it.
            reach: (P, 2) time after the beginning of a pose, and before its end, that may be of the
                other kind [s].
        """
        at = np.flatnonzero(tells)
        steps = np.flatnonzero(np.diff(differs[at].astype(np.int8)))
        if len(steps) != 1:
            return None
        before, after = at[steps[0]], at[steps[0] + 1]
        between = poses.span[before, 1] - reach[before, 1], poses.span[after, 0] + reach[after, 0]
        return cls((float(between[0]), float(between[1])), bool(differs[before]))


def _doubtful(ratio: F64) -> F64:
    """(P, D) share of a joint's motion in a pose that it may have counted the other way.

    Where it does so in a share x, its effects are measured as 1 - 2 x times themselves, and
    chi-squared of one sense over the other's is ``((1 - x) / x)^2``. Errors of the model make x
    seem larger; windows in which little moves count little.
    """
    far = np.sqrt(np.maximum(ratio, 1 / np.maximum(ratio, 1e-300)))
    return np.minimum(1.0, _ALLOWANCE / (1 + far))


def _reach(share: F64, poses: Features, time: F64, qd: F64) -> F64:
    """(P, 2) time in which a joint makes a share of its motion in each of P poses [s].

    The first is after the beginning of a pose, the second before its end: how a joint counts does
    not show while it stands.

    Args:
        share: (P,) of its motion; all of it where that is not known.
        poses: their features.
        time: (N,) of the samples [s].
        qd: (N,) velocities of the joint [rad/s or m/s].
    """
    out = np.empty((poses.n_poses, 2))
    for p, (begin, end) in enumerate(poses.span):
        here = slice(*np.searchsorted(time, (begin, end)))
        made = np.cumsum(qd[here] ** 2)
        part = 1.0 if np.isnan(share[p]) else share[p]
        first, last = np.searchsorted(made, made[-1] * np.array([part, 1 - part]))
        out[p] = time[here][min(first, len(made) - 1)] - begin, end - time[here][last]
    return out


def _exchange(
    known: Estimate, poses: Features
) -> tuple[list[str], list[str], tuple[float, float]] | None:
    """SUs, the names they have from some time on, and the times between which they got them."""
    names = known.tree.su_names
    P = poses.n_poses
    called = np.array([names_in(known, poses.of_poses(np.array([p]))) for p in range(P)])
    differs = np.array([list(row) != list(range(len(names))) for row in called])
    heard = np.asarray(poses.valid.any(axis=1))
    whole = np.ptp(poses.span, axis=1)
    change = _Change.of(poses, differs, heard, np.stack([whole, whole], axis=1))
    if change is None:
        return None
    ways, number = np.unique(called[differs], axis=0, return_counts=True)
    way = ways[np.argmax(number)]
    # What is known may be the later names.
    way = np.argsort(way) if change.late else way
    who = np.flatnonzero(way != np.arange(len(way)))
    return [names[u] for u in who], [names[u] for u in way[who]], change.between


def _renamed_from(s: Sampled, columns: Int, between: tuple[float, float]) -> tuple[Sampled, float]:
    """A log in which each SU has the readings of another column from some time on, and that time.

    It is where the readings become steadiest: each SU's steps across it are smallest in relation
    to those without.

    Args:
        s: the log.
        columns: (U,) the column each SU has later.
        between: times between which it is [s].
    """
    time = s.motion.grid.time
    first, last = np.searchsorted(time, between)
    before, after = s.readings[first : last - 2], s.readings[first + 2 : last]
    gain = ((after[:, columns] - before) ** 2 - (after - before) ** 2).sum(axis=(1, 2))
    known = s.valid[first : last - 2] & s.valid[first + 2 : last]
    at = int(first + 1 + np.argmin(np.where(known.all(axis=1), gain, np.inf)))
    readings, valid = np.array(s.readings), np.array(s.valid)
    readings[at:], valid[at:] = s.readings[at:, columns], s.valid[at:, columns]
    moved = columns != np.arange(len(columns))
    valid[max(0, at - _BLUR) : at + _BLUR + 1, moved] = False
    readings, filled = computed(s.motion, s.neighbourhoods, s.cutoff, readings, valid)
    turning = s.turning
    if turning is not None:
        later = (np.arange(len(valid)) >= at)[:, None] & moved
        turning = turning.exchanged(columns, later).where(valid | ~moved)
    new = replace(
        s,
        readings=readings,
        valid=valid | filled,
        computed=(s.computed & valid) | filled,
        turning=turning,
    )
    return new, float(time[at])
