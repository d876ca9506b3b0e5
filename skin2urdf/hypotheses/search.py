"""One search for what the logs do not say by themselves.

Encoders that jumped, SUs that slipped, names that were exchanged, joints that were hit: they mask
each other, so they compete in one place. Each kind looks at an attempt to explain the logs and
proposes candidates with the drop of chi-squared that it expects. The candidate that promises most
beyond its price is attempted from the raw logs, together with all amendments so far, and stays if
the drop comes true. The search ends when none pays; then every amendment is left out once, and what
the others explain as well goes.

One measure: chi-squared of everything, nothing weighed down. One price: each parameter costs the
logarithm of the number of measurements, as Schwarz (1978) has it, and the choice among candidates
twice the logarithm of their number, as Bonferroni has it for a maximum of chi-squared.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeVar, runtime_checkable

import numpy as np

from skin2urdf.calibration.clock import Clock, Tell
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import (
    Logs,
    Solution,
    Structure,
    find_structure,
    is_hopeless,
    leads_nowhere,
    relinearise,
    sample_logs,
    settle,
    take_features,
)
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import unlike_the_rest
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.recording.records import Recording
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

T = TypeVar("T")
StandsOut = Callable[[int, float, float], bool]
"""Of a log, a time and a later one [s]."""

_RANKS = (0, 1, 2, 3)
_MOST = 12
"""Attempts of a search: a log with more to amend is better recorded again."""
_LEFT = 0.1
"""Share of the misfit that may stay where its cause was found. Of two causes the larger one goes
first; what imitates another cause leaves a fifth or more of it."""

_PART = 0.4
"""Share of the misfit below which a candidate waits until all kinds have looked. It decides about
time alone: where no other kind explains more, the candidate is tried. In 93 recordings with one
fault (panda, z1, kinova) offsets took 0.72 to 0.99 of the misfit where they were the cause, slips
with the joints held 0.43 to 0.84; offsets that were not 0.16 to 0.59, slips 0.30 to 0.62, most of
these below 0.4."""
_HALVED = 0.5
"""Misfit that may stay for a candidate to be looked at again: it has a share in the cause, and its
size may be what is wrong with it still."""
_CHANCE = 3.0
"""Standard deviations of chi-squared of the measurements that one of two estimates lacks."""
_TINY = 1e-9
"""Share of chi-squared that any candidate leaves, however much it promises."""


class Kind(Protocol):
    """A kind of hypotheses.

    Attributes:
        rank: what looking costs: 0 for a score test, 1 for estimates from one log alone, 2 for
            estimates from parts of logs, 3 for estimates of other structures. Kinds of a higher
            rank look only at what nothing of a lower rank explains.
    """

    rank: Literal[0, 1, 2, 3]

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """Candidates that an attempt suggests.

        Args:
            search: has the recordings, and runs the stages.
            now: the attempt; None where the logs show no structure at all.
        """

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """What the amendments of this kind that lasted say, in numbers."""


@runtime_checkable
class Finishing(Protocol):
    """A kind whose amendments have sizes that the last estimate says best."""

    def finish(self, last: Attempt, clock: Clock) -> Attempt:
        """The attempt with its amendments as large as its estimate says."""


@dataclass
class Search:
    """A search under way.

    Attributes:
        recordings: the logs as read.
        settings: choices.
        clock: runs the stages.
        evident: amendments that need no estimate, such as leaps that no joint can make.
        plain: the logs with those alone, on their grids.
        tell: told how many of all ranks of kinds were looked at since the last finding.
        stands_out: whether all samples show more between two times of a log [s] than the play of
            gears makes; always, where they were not looked at.
        tried: number of hypotheses that were compared so far.
        attempts: number of attempts so far.
    """

    recordings: Sequence[Recording]
    settings: CalibrationSettings
    clock: Clock
    evident: tuple[Amendment, ...]
    plain: Logs
    tell: Tell = lambda _: None
    stands_out: StandsOut = lambda *_: True
    tried: int = 0
    attempts: int = 0

    def __post_init__(self) -> None:
        self._known: dict[Hashable, object] = {}

    def once(self, key: Hashable, work: Callable[[], T]) -> T:
        """What some work gives that is worth keeping for later looks, done once."""
        if key not in self._known:
            self._known[key] = work()
        return self._known[key]  # type: ignore[return-value]

    def attempt(self, amendments: tuple[Amendment, ...], beside: Attempt | None) -> Attempt:
        """Explain the raw logs with some amendments.

        Args:
            amendments: what is allowed for.
            beside: an attempt where this one may start if it is of the same structure.

        Raises:
            InsufficientDataError: the logs lack what a calibration needs.
            StructureError: the SUs' activity contradicts every kinematic tree.
        """
        self.attempts += 1
        clock = self.clock
        logs = self._mended(amendments)
        calm = _calm(logs, amendments)
        features, structure = self._first_look(calm)
        for each in amendments:
            structure = replace(structure, tree=each.of_structure(structure.tree))
        whole, tree = logs, structure.certain_tree
        for each in amendments:
            whole, tree = each.of_placements(whole, tree)
        # A structure that was found beside a slip knows SUs that are none without it.
        tree = of_logs(tree, whole)
        if whole is not logs:
            calm = _calm(whole, amendments)
            known = dict(zip(features.su_names, features.latency, strict=True))
            latency = np.array([known.get(name, 0.0) for name in calm.su_names])
            features = take_features(calm, clock, latency=latency)
        found, refined = relinearise(
            calm, tree, features, clock,
            start=None if beside is None else _start_for(tree, beside.solution.found),
            hopeless=leads_nowhere,
        )  # fmt: skip
        found, refined = _settled(calm, found, refined, clock)
        return Attempt(amendments, Solution(calm, structure.seen, found, refined), whole)

    def _mended(self, amendments: Sequence[Amendment]) -> Logs:
        """The recordings without what was wrong, on their grids."""
        recordings, changing = list(self.recordings), list[Amendment]()
        for each in amendments:
            changed = each.of_recordings(recordings)
            changing += [each] if changed is not recordings else []
            recordings = changed
        # Most kinds amend what was sampled: then the grids that the search began with will do.
        known = tuple(changing) == self.evident
        logs = self.plain if known else sample_logs(recordings, self.settings, self.clock)
        for each in amendments:
            logs = each.of_logs(logs)
        return logs

    def _first_look(self, logs: Logs) -> tuple[Features, Structure]:
        """First features of logs and what they show; where nothing is amended, taken once."""

        def look() -> tuple[Features, Structure]:
            features = take_features(logs, self.clock)
            return features, find_structure(logs, features, self.clock)

        return self.once("first look", look) if logs is self.plain else look()

    def finished(self, last: Attempt, kind: Finishing) -> Attempt:
        """An attempt with amendments as large as its estimate says, in its logs as well."""
        new = kind.finish(last, self.clock)
        if new.amendments == last.amendments:
            return new
        whole, tree = self._mended(new.amendments), new.solution.found.tree
        for each in new.amendments:
            whole, _ = each.of_placements(whole, tree)
        logs = _calm(whole, new.amendments)
        return replace(new, solution=replace(new.solution, logs=logs), whole=whole)


def _settled(
    logs: Logs, found: Estimate, features: Features, clock: Clock
) -> tuple[Estimate, Features]:
    """An estimate that explains the logs, with joints found that no SU seemed to feel."""
    return settle(logs, found, features, clock) if explains(found) else (found, features)


def _start_for(tree: KinematicTree, known: Estimate) -> State | None:
    """The state of an estimate that explains something, where it fits a tree."""
    return None if is_hopeless(known) or not _is_the_same(tree, known.tree) else known.state


def _is_the_same(a: KinematicTree, b: KinematicTree) -> bool:
    """Whether two trees are alike down to the order of joints and SUs, so that states fit both."""
    return a.is_like(b) and (a.joint_names, a.su_names) == (b.joint_names, b.su_names)


def _calm(logs: Logs, amendments: Sequence[Amendment]) -> Logs:
    for each in amendments:
        logs = each.left_out(logs)
    return logs


def explain(
    recordings: Sequence[Recording],
    evident: tuple[Amendment, ...],
    first: tuple[Logs, Structure, Solution | None],
    kinds: Sequence[Kind],
    clock: Clock,
    tell: Tell = lambda _: None,
    stands_out: StandsOut = lambda *_: True,
) -> Solution:
    """Search for what is wrong until nothing more pays.

    Args:
        recordings: the logs as read.
        evident: amendments that need no estimate.
        first: the logs with these, their structure, and the estimate of it where there is one.
        kinds: the kinds of hypotheses.
        clock: runs the stages.
        tell: told how many of all ranks of kinds were looked at since the last finding.
        stands_out: what all samples show, see :class:`Search`.

    Returns:
        The solution that explains the logs, with the findings as its faults.

    Raises:
        StructureError: the SUs' activity contradicts every kinematic tree, whatever is amended.
    """
    logs, structure, solution = first
    search = Search(recordings, logs.settings, clock, evident, logs, tell, stands_out)
    begin = None
    if solution is not None:
        found, features = _settled(logs, solution.found, solution.features, clock)
        begin = Attempt(evident, replace(solution, found=found, features=features), logs)
    last = _pruned(search, begin, _grown(search, begin, kinds))
    if last is None:
        raise structure.contradiction or StructureError("there is no tree", "record more moves")
    for kind in kinds:
        if isinstance(kind, Finishing):
            last = search.finished(last, kind)
    faults = [fault for kind in kinds for fault in kind.findings(last)]
    return replace(last.solution, faults=tuple(faults))


def _grown(search: Search, now: Attempt | None, kinds: Sequence[Kind]) -> Attempt | None:
    """The attempt with amendments added as long as one pays."""
    failed: set[Hashable] = set()
    while search.attempts < _MOST:
        after = _better(search, now, kinds, failed)
        if after is None:
            break
        now = after
    return now


def _better(
    search: Search, now: Attempt | None, kinds: Sequence[Kind], failed: set[Hashable]
) -> Attempt | None:
    """The attempt with the candidate that has brought most; None where none pays.

    Args:
        search: counts what is tried.
        now: the attempt so far.
        kinds: look at it, those that cost least first.
        failed: candidates that have not kept their promises; more are added.
    """
    best, most = None, 0.0
    waiting = list[Candidate]()
    for rank in _RANKS:
        proposed = []
        for i, kind in enumerate(kinds):
            if kind.rank == rank:
                search.tell((rank - _RANKS[0] + i / len(kinds)) / len(_RANKS))
                proposed += [c for c in kind.propose(search, now) if c.key not in failed]
        search.tried += sum(candidate.among for candidate in proposed)
        promised = {c: promise(now, c, search.tried) for c in (*waiting, *proposed)}
        waiting = []
        ahead: str | None = None
        for candidate in sorted(promised, key=lambda c: -promised[c]):
            if promised[candidate] <= 0 or search.attempts >= _MOST:
                break
            if candidate.kind == ahead:
                continue
            if rank < _RANKS[-1] and _only_a_part(now, candidate):
                waiting.append(candidate)
                continue
            after = _sharpened(search, now, _tried(search, now, candidate), candidate)
            worth = 0.0 if after is None else _worth(now, after, candidate, search.tried)
            if after is None or worth <= 0:
                failed.add(candidate.key)
                continue
            if worth > most:
                best, most = after, worth
            # What leaves much may imitate what the likeliest of another kind explains.
            if ahead is not None or _nearly_all(now, after):
                break
            ahead = candidate.kind
        if now is not None and explains(now.solution.found):
            break
        if best is not None and _nearly_all(now, best):
            break
    return best


def _only_a_part(now: Attempt | None, candidate: Candidate) -> bool:
    """Whether a candidate leaves so much to explain that another cause is to be looked for first.

    It then looks like something else that has to be looked for at a higher cost.
    """
    if now is None or explains(now.solution.found):
        return False
    return not candidate.apart and candidate.drop < _PART * excess(now.solution.found)


def _nearly_all(now: Attempt | None, after: Attempt) -> bool:
    """Whether an attempt leaves so little that nothing more costly need be looked for.

    What still leads nowhere is none to go on from: one SU may have most of any misfit.
    """
    found = after.solution.found
    much = now is not None and found.misfit < _LEFT * now.solution.found.misfit
    return (much and not leads_nowhere(found)) or explains(found)


def _tried(search: Search, now: Attempt | None, candidate: Candidate) -> Attempt | None:
    """The logs explained with one more candidate; None where they can not be."""
    new = candidate.amendments
    if candidate.sharpen is not None and now is not None:
        new = tuple(candidate.sharpen(now))
    after = _with(search, now, new, candidate.instead)
    return after if after is None or candidate.holds is None or candidate.holds(after) else None


def _sharpened(
    search: Search, now: Attempt | None, after: Attempt | None, candidate: Candidate
) -> Attempt | None:
    """An attempt with a candidate whose size is looked at again as long as that explains more.

    A size seen in features that a large error has spoilt is a few per cent off, which leaves far
    more than noise does. It need not be followed where the attempt is good enough to go on from
    before costlier looks.
    """
    if now is None or candidate.sharpen is None:
        return after
    before = now
    while after is not None and search.attempts < _MOST and not _nearly_all(now, after):
        if after.solution.found.misfit > _HALVED * before.solution.found.misfit:
            break
        further = _with(search, after, tuple(candidate.sharpen(after)))
        if further is None or further.solution.found.misfit > after.solution.found.misfit:
            break
        before, after = after, further
    return after


def _with(
    search: Search,
    now: Attempt | None,
    new: Sequence[Amendment],
    instead: Sequence[Amendment] = (),
) -> Attempt | None:
    """The logs explained with more amendments, instead of some; None where they can not be."""
    before = search.evident if now is None else now.amendments
    known = {a.key: a for a in before if a not in instead}
    known.update({a.key: a for a in new})
    amendments = tuple(known.values())
    if now is not None and amendments == before:
        return None
    try:
        return search.attempt(amendments, now)
    except (InsufficientDataError, StructureError):
        return None


def _pruned(search: Search, first: Attempt | None, last: Attempt | None) -> Attempt | None:
    """The attempt without the amendments that the others make needless."""
    if last is None or last is first:
        return last
    for each in last.amendments:
        if each in search.evident or each not in last.amendments:
            continue
        rest = tuple(a for a in last.amendments if a is not each)
        if rest == search.evident:
            without = first
        else:
            try:
                without = search.attempt(rest, last)
            except (InsufficientDataError, StructureError):
                continue
        if without is None:
            continue
        before, after = without.solution.found, last.solution.found
        worth = gain(before, after, of_poses=True) + each.apart
        if worth <= price(after, each.parameters, search.tried, of_poses=True):
            last = without
    return last


def of_logs(tree: KinematicTree, logs: Logs) -> KinematicTree:
    """A tree without the SUs that logs do not have: those that stand for earlier placements."""
    own = np.flatnonzero([name in logs.su_names for name in tree.su_names])
    return replace(tree, su_names=tuple(tree.su_names[u] for u in own), su_joint=tree.su_joint[own])


def promise(now: Attempt | None, candidate: Candidate, tried: int) -> float:
    """What a candidate promises beyond its price."""
    if now is None:
        return np.inf
    found = now.solution.found
    chi2 = found.misfit * _count(found)
    left = max(chi2 - candidate.drop, _TINY * chi2) / _count(found)
    expected = _gain(found.misfit, left, _count(found), _looks(found))
    looks = _count(found) if left <= GOOD_FIT else _looks(found)
    return expected + candidate.apart - _price(looks, added(now, candidate), tried)


def _worth(now: Attempt | None, after: Attempt, candidate: Candidate, tried: int) -> float:
    """What a candidate has brought beyond its price."""
    if now is None:
        return 1 / after.solution.found.misfit
    before, found = now.solution.found, after.solution.found
    return gain(before, found) + candidate.apart - price(found, added(now, candidate), tried)


def added(now: Attempt, candidate: Candidate) -> int:
    """Parameters that a candidate adds: none where it takes the place of what has as many."""
    known = {a.key for a in now.amendments}
    return sum(a.parameters for a in candidate.amendments if a.key not in known)


def gain(before: Estimate, after: Estimate, *, of_poses: bool = False) -> float:
    """How much better an estimate explains the logs than another, in chi-squared.

    What noise leaves is counted in measurements, over the noise that is left. What remains beyond
    it where nothing explains the readings is no noise: it is as if each SU in each pose were
    wrong as a whole, so that these are counted, each by the logarithm of the ratio (of a normal
    error whose variance is not known); at the end poses alone, which all SUs feel together.
    """
    looks = len(after.count) if of_poses else _looks(after)
    better = _gain(before.misfit, after.misfit, _count(after), looks)
    if after.misfit > GOOD_FIT:
        return better
    # What is measured no longer, or only then, differs from the rest by chance.
    other = abs(_count(after) - _count(before))
    return better - _CHANCE * float(np.sqrt(2 * other))


def _gain(before: float, after: float, count: int, looks: int) -> float:
    if after <= GOOD_FIT:
        return (before - after) * count / max(1.0, after)
    return looks * float(np.log(before / after))


def price(found: Estimate, parameters: int, tried: int, *, of_poses: bool = False) -> float:
    """Chi-squared that parameters and the choice among candidates cost."""
    looks = len(found.count) if of_poses else _looks(found)
    return _price(_count(found) if found.misfit <= GOOD_FIT else looks, parameters, tried)


def _price(looks: int, parameters: int, tried: int) -> float:
    return parameters * float(np.log(max(2, looks))) + 2 * float(np.log(max(1, tried)))


def _count(found: Estimate) -> int:
    """Measurements."""
    return max(1, int(found.count.sum()))


def _looks(found: Estimate) -> int:
    """SUs in poses."""
    return int((found.count > 0).sum())


def excess(found: Estimate) -> float:
    """Chi-squared beyond what noise makes of it: no hypothesis explains more."""
    return max(0.0, (found.misfit - 1) * _count(found))


def imitations(
    search: Search, now: Attempt | None, subjects: Sequence[str]
) -> tuple[Amendment, ...]:
    """Amendments of an attempt that may imitate what is wrong with the same joints or SUs.

    Two poses after a joint has turned look as if its zero had changed as well.
    """
    known = () if now is None else now.amendments
    return tuple(a for a in known if a.subject in subjects and a not in search.evident)


def explains(found: Estimate) -> bool:
    """Whether an estimate leaves nothing to explain, nor weighs down what it does not explain."""
    fits = found.cost_per_dof <= GOOD_FIT and found.misfit <= BAD_FIT
    return fits and not unlike_the_rest(found)
