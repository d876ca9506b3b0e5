"""Parts of a log that an estimate explains, where something changes in its middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import (
    Logs,
    Structure,
    find_structure,
    relinearise,
    settle,
    take_features,
)
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.hypotheses.names import named_as_felt
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.records import KinematicTree


def sound_part(
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
    border = middle(features)
    parts = [part for late in (False, True) if (part := _Part.of(alone, border, late, clock))]
    sound = list[_Fit]()
    if tree:
        named = [(part, named_as_felt(tree, part.structure(clock).seen)) for part in parts]
        named = [each for each in named if not each[1].is_like(tree)]
        sound, _ = _explanations(named, clock)
        if not sound:
            sound, fits = _explanations([(part, tree) for part in parts], clock)
            # Either part may show best which two were exchanged, and either may be pure.
            swapped = [_exchanged(tree, fit.worst_two()) for _, fit in fits]
            pairs = _new([(part, other) for other in swapped for part in parts], named)
            sound = sound or _explanations(pairs, clock)[0]
    if not sound:
        shown = [(part, other) for part in parts if (other := part.structure(clock).tree)]
        new = [(part, other) for part, other in shown if not (tree and other.is_like(tree))]
        sound, _ = _explanations(new, clock, certain=False)
    if not sound:
        return None
    best = min(sound, key=lambda fit: fit.found.cost_per_dof)
    return best.found, take_features(alone, clock, latency=best.latency)


def middle(features: Features) -> float:
    """The end of a pose with as much time in poses before it as after it, or nearly so [s].

    Whatever changes in a log once, the part before this time or the one after it is of one kind.
    Either may be it, so that neither may be much the smaller one: few poses leave several robots.

    Args:
        features: of one log, its poses in the order of time.
    """
    before = np.cumsum(np.ptp(features.span, axis=1))
    return float(features.span[np.argmin(np.abs(before - before[-1] / 2)), 1])


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


@dataclass(frozen=True, eq=False)
class _Fit:
    """What a tree makes of a part of a log.

    Attributes:
        found: the estimate, and
        latency: (U,) the SUs' [s].
    """

    found: Estimate
    latency: F64

    @classmethod
    def of(
        cls, part: _Part, tree: KinematicTree, clock: Clock, *, certain: bool = True
    ) -> _Fit | None:
        """The estimate of a part; None where it holds too little.

        Args:
            part: the part.
            tree: its structure.
            clock: runs the stages.
            certain: False to look at the structure again where it does not explain the part.
        """
        try:
            found, seen = relinearise(
                part.logs, tree, part.features, clock, hopeless=_leads_nowhere
            )
            if not certain:
                found, seen = settle(part.logs, found, seen, clock)
        except InsufficientDataError:
            return None
        return cls(found, seen.latency)

    def explains(self) -> bool:
        """Whether it explains the part."""
        return self.found.cost_per_dof <= GOOD_FIT

    def explains_all(self) -> bool:
        """Whether it explains the part with nothing weighed down."""
        return self.explains() and self.found.misfit <= GOOD_FIT

    def worst_two(self) -> list[str]:
        """The SUs that fit worst: others suffer from an exchange by what they share with them."""
        found = self.found
        each = found.chi2_by_block.sum(axis=0) / np.maximum(found.count.sum(axis=0), 1)
        return [found.tree.su_names[u] for u in np.argsort(-each)[:2]]


def _explanations(
    tried: Sequence[tuple[_Part, KinematicTree]], clock: Clock, *, certain: bool = True
) -> tuple[list[_Fit], list[tuple[_Part, _Fit]]]:
    """Of parts and trees that may be theirs the fits that explain the part, and all that were made.

    None is needed beside one that explains all of its part.
    """
    made: list[tuple[_Part, _Fit]] = []
    for part, tree in tried:
        fit = _Fit.of(part, tree, clock, certain=certain)
        if fit is None:
            continue
        made.append((part, fit))
        if fit.explains_all():
            break
    return [fit for _, fit in made if fit.explains()], made


def _new(
    pairs: Sequence[tuple[_Part, KinematicTree]], tried: Sequence[tuple[_Part, KinematicTree]]
) -> list[tuple[_Part, KinematicTree]]:
    """Parts and trees that are not among those that were tried, each once."""
    known = list(tried)
    for part, tree in pairs:
        if not any(of is part and other.is_like(tree) for of, other in known):
            known.append((part, tree))
    return known[len(tried) :]


def _exchanged(tree: KinematicTree, names: Sequence[str]) -> KinematicTree:
    """A tree in which each of two SUs is where the other was."""
    joint, both = np.array(tree.su_joint), places_of(names, tree.su_names)
    joint[both] = joint[both[::-1]]
    return replace(tree, su_joint=joint)


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
