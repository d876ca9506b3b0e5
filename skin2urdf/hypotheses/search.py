"""One search for what the logs do not say by themselves.

Encoders that jumped, SUs that slipped, names that were exchanged, joints that were hit: they mask
each other, so they compete in one place. Each kind looks at an attempt to explain the logs and
proposes candidates with the drop of chi-squared that it expects. The candidate that promises most
beyond its price is attempted from the raw logs, together with all amendments so far, and stays if
the drop comes true. The search ends when none pays; then every amendment is left out once, and what
the others explain as well goes.

What an attempt brings, and what it costs, is in :mod:`skin2urdf.hypotheses.measure`.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Literal, Protocol, runtime_checkable

from skin2urdf.calibration.clock import Clock, Tell
from skin2urdf.calibration.rounds import Logs, Solution, Structure, leads_nowhere
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.attempts import Search, StandsOut, settled
from skin2urdf.hypotheses.measure import brought, excess, explains, gain, price, promise
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.recording.records import Recording

_RANKS = (0, 1, 2)
_MOST = 12
"""Attempts of a search: a log with more to amend is better recorded again."""
_LEFT = 0.1
"""Share of the misfit that may stay where its cause was found. Of two causes the larger one goes
first; what imitates another cause leaves a fifth or more of it, or what leads nowhere."""
_PART = 0.4
"""Share of the misfit below which a candidate waits until all kinds have looked. It decides about
time alone: where no other kind explains more, the candidate is tried. In 93 recordings with one
fault (panda, z1, kinova) offsets took 0.72 to 0.99 of the misfit where they were the cause, slips
with the joints held 0.43 to 0.84; offsets that were not 0.16 to 0.59, slips 0.30 to 0.62, most of
these below 0.4."""
_HALVED = 0.5
"""Misfit that may stay for a candidate to be looked at again: it has a share in the cause, and its
size may be what is wrong with it still."""


class Kind(Protocol):
    """A kind of hypotheses.

    Attributes:
        rank: what looking costs: 0 for less than an attempt, which is a score test or what one log
            alone predicts of the others, 1 for estimates from parts of logs, 2 for estimates of
            other structures. Kinds of a higher rank look only at what nothing of a lower rank
            explains.
    """

    rank: Literal[0, 1, 2]

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
        found, features = settled(logs, solution.found, solution.features, clock)
        begin = Attempt(evident, replace(solution, found=found, features=features), logs)
    last = _pruned(search, begin, _grown(search, begin, kinds))
    if last is None:
        raise structure.contradiction or StructureError("there is no tree", "record more moves")
    for kind in kinds:
        if isinstance(kind, Finishing):
            last = search.resized(last, kind.finish(last, clock))
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
                search.tell((rank + i / len(kinds)) / len(_RANKS))
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
            worth = 0.0 if after is None else brought(now, after, candidate, search.tried)
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
