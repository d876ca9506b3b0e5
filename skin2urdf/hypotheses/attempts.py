"""Attempts to explain the raw logs with amendments."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from skin2urdf.calibration.clock import Clock, Tell
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
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.hypotheses.measure import explains
from skin2urdf.hypotheses.records import Amendment, Attempt
from skin2urdf.recording.records import Recording
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

T = TypeVar("T")
StandsOut = Callable[[int, float, float], bool]
"""Of a log, a time and a later one [s]."""


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
        found, refined = settled(calm, found, refined, clock)
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

    def resized(self, last: Attempt, new: Attempt) -> Attempt:
        """An attempt whose amendments are of other sizes than before, in its logs as well.

        Args:
            last: with the sizes before.
            new: the same with others, and the logs as they were.
        """
        if new.amendments == last.amendments:
            return new
        whole, tree = self._mended(new.amendments), new.solution.found.tree
        for each in new.amendments:
            whole, _ = each.of_placements(whole, tree)
        logs = _calm(whole, new.amendments)
        return replace(new, solution=replace(new.solution, logs=logs), whole=whole)


def settled(
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


def imitations(
    search: Search, now: Attempt | None, subjects: Sequence[str]
) -> tuple[Amendment, ...]:
    """Amendments of an attempt that may imitate what is wrong with the same joints or SUs.

    Two poses after a joint has turned look as if its zero had changed as well.
    """
    known = () if now is None else now.amendments
    return tuple(a for a in known if a.subject in subjects and a not in search.evident)


def of_logs(tree: KinematicTree, logs: Logs) -> KinematicTree:
    """A tree without the SUs that logs do not have: those that stand for earlier placements."""
    own = np.flatnonzero([name in logs.su_names for name in tree.su_names])
    return replace(tree, su_names=tuple(tree.su_names[u] for u in own), su_joint=tree.su_joint[own])
