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
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import (
    Logs,
    Structure,
    alike,
    find_structure,
    relinearise,
    settle,
    take_features,
)
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.encoder import Corrected, errors_of
from skin2urdf.hypotheses.names import columns_of, named_as_felt, names_in
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.hypotheses.search import Search, excess, explains, imitations
from skin2urdf.hypotheses.sense import TURNED, felt_at_rest, felt_in_patterns
from skin2urdf.signals.encoders import reversal
from skin2urdf.signals.mending import computed
from skin2urdf.signals.records import EncoderError, Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree

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

    rank: Literal[0, 1, 2, 3] = 2

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
    tree = None if found is None else _as_logged(found.tree, logs.su_names)
    exchanges, turns = list[Exchanged](), list[Corrected]()
    for log, s in enumerate(logs.sampled):
        sound = _sound_part(logs.of([s]), tree, search.clock)
        if sound is None:
            continue
        known, poses = sound
        turns += [
            _turned(search, known.tree.joint_names[d], log, between)
            for d, between in turns_within(known, poses)
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


def _as_logged(tree: KinematicTree, names: Sequence[str]) -> KinematicTree:
    """A tree without the SUs that stand for earlier placements of others."""
    own = np.flatnonzero([name in names for name in tree.su_names])
    return replace(tree, su_names=tuple(tree.su_names[u] for u in own), su_joint=tree.su_joint[own])


def turns_within(known: Estimate, poses: Features) -> Iterator[tuple[int, tuple[float, float]]]:
    """Joints of a tree that change their sense, and the times between which they do.

    Args:
        known: an estimate from sound poses of the same robot.
        poses: features of one log, each visit to a pose for itself.
    """
    patterns = felt_in_patterns(known, poses)
    both = patterns.with_more(felt_at_rest(known, poses))
    # Of two senses in one pose its patterns tell, where it has any.
    share = _doubtful(np.where(np.isfinite(patterns.ratio), patterns.ratio, both.ratio))
    for d in range(known.tree.n_joints):
        ratio = both.ratio[:, d]
        # Another zero is as good as a value to be mirrored about, but for the patterns.
        differs = (ratio < TURNED) & ~(patterns.ratio[:, d] > 1.0)
        turn = _Change.of(poses, differs, np.isfinite(ratio), share[:, d])
        if turn is None:
            continue
        # One value to be mirrored about may suit a single pose in which something else is wrong.
        pure = ~(share[:, d] >= _MIXED)
        later = poses.span.mean(axis=1) > sum(turn.between) / 2
        left = np.where(later != turn.late, both.turned[:, d], both.same[:, d])
        if left[pure].sum() < TURNED * both.same[pure, d].sum():
            yield d, turn.between


def _turned(search: Search, dof: str, log: int, between: tuple[float, float]) -> Corrected:
    """An encoder mirrored from where its sense changes in a log.

    A leap of the track tells when that was; else the track itself, where it turns round at once.
    """
    begin, end = between
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
        at = reversal(track, between)
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
    def of(cls, poses: Features, differs: Bool, tells: Bool, doubtful: F64) -> _Change | None:
        """The change of P poses, where there is just one.

        Args:
            poses: their features, in the order of time.
            differs: (P,) True where a pose is unlike what is known.
            tells: (P,) False for poses that say nothing of it.
            doubtful: (P,) share of a pose's time that may be of the other kind.
        """
        at = np.flatnonzero(tells)
        steps = np.flatnonzero(np.diff(differs[at].astype(np.int8)))
        if len(steps) != 1:
            return None
        before, after = at[steps[0]], at[steps[0] + 1]
        reach = doubtful * np.ptp(poses.span, axis=1)
        between = poses.span[before, 1] - reach[before], poses.span[after, 0] + reach[after]
        return cls((float(between[0]), float(between[1])), bool(differs[before]))


def _doubtful(ratio: F64) -> F64:
    """(P, D) share of a pose in which a joint may have counted the other way than otherwise.

    Where it does so in a share x, its effects are measured as 1 - 2 x times themselves, and
    chi-squared of one sense over the other's is ``((1 - x) / x)^2``. Errors of the model make x
    seem larger; windows in which little moves count little.
    """
    far = np.sqrt(np.maximum(ratio, 1 / np.maximum(ratio, 1e-300)))
    return np.minimum(1.0, _ALLOWANCE / (1 + far))


def _sound_part(
    alone: Logs, tree: KinematicTree | None, clock: Clock
) -> tuple[Estimate, Features] | None:
    """An estimate that explains most of a part of a log, and the log's poses in order of time.

    Args:
        alone: one log.
        tree: that of an estimate from all logs; joints that change their sense leave it right.
        clock: runs the stages.
    """
    s = _visited(alone.sampled[0])
    alone = alone.of([s])
    features = take_features(alone, clock)
    length = np.ptp(features.span, axis=1)
    half = int(np.searchsorted(np.cumsum(length), length.sum() / 2))
    border = float(features.span[half, 1])
    parts = [part for late in (False, True) if (part := _Part.of(alone, border, late, clock))]
    sound = []
    if tree:
        sound = [e for part in parts if (e := _explanation(part, tree, clock))]
    if tree and not sound:
        moved = [(part, named_as_felt(tree, part.seen(clock))) for part in parts]
        new = [(part, other) for part, other in moved if not alike(other, tree)]
        sound = [e for part, other in new if (e := _explanation(part, other, clock))]
    if not sound:
        shown = [(part, other) for part in parts if (other := part.structure(clock).tree)]
        new = [(part, other) for part, other in shown if not (tree and alike(other, tree))]
        sound = [e for part, other in new if (e := _explanation(part, other, clock, certain=False))]
    if not sound:
        return None
    best, latency = min(sound, key=lambda e: e[0].cost_per_dof)
    return best, take_features(alone, clock, latency=latency)


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a log.

    Attributes:
        logs: the part.
        features: its first features.
    """

    logs: Logs
    features: Features

    @classmethod
    def of(cls, alone: Logs, border: float, late: bool, clock: Clock) -> _Part | None:
        """What a log holds before a time [s], or after it; None where that is too little."""
        logs = alone.of([_cut(alone.sampled[0], border, late)])
        try:
            return cls(logs, take_features(logs, clock))
        except InsufficientDataError:
            return None

    def structure(self, clock: Clock) -> Structure:
        """What it shows of the structure."""
        return find_structure(self.logs, self.features, clock)

    def seen(self, clock: Clock) -> Activity:
        """What its SUs felt."""
        return self.structure(clock).seen


def _explanation(
    part: _Part, tree: KinematicTree, clock: Clock, *, certain: bool = True
) -> tuple[Estimate, F64] | None:
    """The estimate from a part of a log and the SUs' latencies, where it explains the part.

    Args:
        part: the part.
        tree: its structure.
        clock: runs the stages.
        certain: False to look at the structure again where it does not explain the part.
    """
    try:
        found, seen = relinearise(part.logs, tree, part.features, clock, hopeless=_leads_nowhere)
        if not certain:
            found, seen = settle(part.logs, found, seen, clock)
    except InsufficientDataError:
        return None
    return (found, seen.latency) if found.cost_per_dof <= GOOD_FIT else None


def _leads_nowhere(found: Estimate) -> bool:
    """Whether an estimate is worse than any that became an explanation, its outliers aside."""
    return found.cost_per_dof > BAD_FIT


def _visited(s: Sampled) -> Sampled:
    """A log with each visit to a pose as a pose of its own, in the order of time."""
    visits = [replace(pose, windows=(w,)) for pose in s.neighbourhoods for w in pose.windows]
    return replace(s, neighbourhoods=tuple(sorted(visits, key=lambda visit: visit.windows[0])))


def _cut(s: Sampled, border: float, late: bool) -> Sampled:
    """What a log holds before a time [s], or after it."""
    grid = s.motion.grid
    at = (border - grid.start) * grid.rate

    def here(begin: int, end: int) -> bool:
        return bool(begin + end > 2 * at) == late

    return replace(
        s,
        neighbourhoods=tuple(n for n in s.neighbourhoods if here(*n.windows[0])),
        rests=tuple(rest for rest in s.rests if here(rest.begin, rest.end)),
    )


def _exchange(
    known: Estimate, poses: Features
) -> tuple[list[str], list[str], tuple[float, float]] | None:
    """SUs, the names they have from some time on, and the times between which they got them."""
    names = known.tree.su_names
    P = poses.n_poses
    called = np.array([names_in(known, poses.of_poses(np.array([p]))) for p in range(P)])
    differs = np.array([list(row) != list(range(len(names))) for row in called])
    heard = np.asarray(poses.valid.any(axis=1))
    change = _Change.of(poses, differs, heard, np.ones(P))
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
