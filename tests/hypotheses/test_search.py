"""One search: what pays stays, what does not come true goes, and a sound log costs no attempt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import simulation_of

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import (
    Logs,
    Solution,
    Structure,
    estimate_robot,
    find_structure,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.changes import Changes
from skin2urdf.hypotheses.corrected import Corrected
from skin2urdf.hypotheses.kinds import KINDS
from skin2urdf.hypotheses.measure import added, gain, price
from skin2urdf.hypotheses.mirrored import Mirrored, Negated
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.hypotheses.search import Kind, explain
from skin2urdf.hypotheses.slip import Moment, Slipped
from skin2urdf.hypotheses.structure import Known
from skin2urdf.recording.records import Recording
from skin2urdf.signals.records import EncoderError
from skin2urdf.simulation import Simulation


@cache
def simulation() -> Simulation:
    return simulation_of(small_arm(3), excite="all")


@dataclass(frozen=True)
class Recorded:
    """A recording, and what is known of it before any search."""

    recording: Recording
    logs: Logs
    structure: Structure
    first: Solution | None


@cache
def sound() -> Recorded:
    return looked_at(simulation().recording)


@cache
def negated() -> Recorded:
    """All readings of one SU, the last, are negated."""
    recording = simulation().recording
    *others, last = recording.sus
    wrong = replace(last, specific_force=-last.specific_force)
    return looked_at(replace(recording, sus=(*others, wrong)))


def looked_at(recording: Recording) -> Recorded:
    logs = sample_logs([recording], CalibrationSettings(), Clock())
    features = take_features(logs, Clock())
    structure = find_structure(logs, features, Clock())
    return Recorded(recording, logs, structure, estimate_robot(logs, features, structure, Clock()))


def searched(given: Recorded, kinds: Sequence[Kind]) -> tuple[Solution, Counter[str]]:
    """What a search finds in a recording, and how often it ran each stage; an attempt estimates."""
    runs = Counter[str]()
    clock = Clock(lambda stage, share: runs.update([stage] if share == 0.0 else []))
    begun = (given.logs, given.structure, given.first)
    return explain([given.recording], (), begun, kinds, clock), runs


@dataclass(frozen=True)
class Idle(Amendment):
    """Changes nothing."""


@dataclass
class Proposing:
    """Proposes the same whatever it sees, and tells which of it lasted."""

    amendments: tuple[Amendment, ...]
    drop: float = 1e9
    rank: Any = 0

    def propose(self, _: Search, now: Attempt | None) -> Sequence[Candidate]:
        """The same again and again, until it is there."""
        if now is not None and self.amendments[0] in now.amendments:
            return []
        return [Candidate("proposed", ("it",), self.amendments, self.drop)]

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """All that lasted, by its class."""
        return [Fault("noisy", type(a).__name__) for a in last.amendments]


def test_a_sound_log_costs_no_attempt() -> None:
    found, runs = searched(sound(), KINDS)
    assert runs["estimation"] == 0
    assert found.faults == ()


def test_a_promise_that_does_not_come_true_is_tried_once_and_dropped() -> None:
    """Of what explains less than before there is one estimate."""
    wrong = EncoderError("scale", sound().recording.joints[2].name, 3.0)
    found, runs = searched(sound(), [Proposing((Corrected(wrong),))])
    assert (runs["sampling"], runs["estimation"]) == (1, 1)
    assert found.faults == ()
    assert found.found.misfit < 1.3


def test_a_promise_below_its_price_is_not_tried() -> None:
    found, runs = searched(sound(), [Proposing((Idle(),), drop=1.0)])
    assert runs["estimation"] == 0
    assert found.faults == ()


def test_what_the_others_explain_goes_at_the_end() -> None:
    name = negated().recording.sus[-1].name
    found, _ = searched(negated(), [Proposing((Negated(name), Idle()))])
    assert [fault.subject for fault in found.faults] == ["Negated"]
    assert found.found.misfit < 1.3


def test_a_structure_that_was_found_beside_a_slip_is_one_without_it() -> None:
    """It has an SU for the earlier placement, which no log has."""
    name = negated().recording.sus[-1].name
    tree = negated().structure.certain_tree
    joint = tree.su_joint[tree.su_names.index(name)]
    known = replace(
        tree,
        su_names=(*tree.su_names, f"{name}_before"),
        su_joint=np.append(tree.su_joint, joint),
    )
    found, _ = searched(negated(), [Proposing((Negated(name), Known(known)))])
    assert found.found.tree.su_names == tree.su_names
    assert found.found.misfit < 1.3


def test_a_mirrored_su_is_found_and_one_that_only_looks_so_beside_it_is_not() -> None:
    name = negated().recording.sus[-1].name
    found, runs = searched(negated(), [Mirrored()])
    assert found.faults == (Fault("mirrored", name),)
    # The readings are negated on the grids that they are on.
    assert runs["sampling"] == 0


def estimate(misfit: float) -> Any:
    return SimpleNamespace(misfit=misfit, cost_per_dof=misfit, count=np.full((10, 5), 100))


@pytest.mark.parametrize(
    ("before", "after", "pays"),
    [
        # Noise as expected: some dozens of chi-squared among thousands of measurements tell.
        (1.01, 1.00, True),
        (1.002, 1.00, False),
        # Noise that is misjudged counts less.
        (1.51, 1.50, True),
        (1.504, 1.50, False),
        # Where nothing explains the readings, a part of the misfit means little.
        (4000.0, 3600.0, False),
        (4000.0, 400.0, True),
        (4000.0, 1.0, True),
    ],
)
def test_what_pays(before: float, after: float, pays: bool) -> None:
    a, b = estimate(before), estimate(after)
    assert (gain(a, b) > price(b, 1, 20)) == pays


def test_more_parameters_and_more_candidates_cost_more() -> None:
    found = estimate(1.0)
    assert price(found, 6, 20) > price(found, 1, 20) > price(found, 1, 2) > 0


def test_what_takes_the_place_of_something_adds_no_parameters() -> None:
    """A slip whose moment is known better has one placement more than none, as it had before."""
    early, late = (
        Slipped("su", "su_before", Moment((0, begin), (0, begin + 1))) for begin in (1.0, 5.0)
    )
    other = Slipped("su_before", "su_before_before", Moment((0, 0.5), (0, 0.7)))
    now = Attempt((early,), None, None)  # type: ignore[arg-type]
    assert added(now, Candidate("slip in a pose", ("su",), (late,), 1.0)) == 0
    assert added(now, Candidate("slip", ("su_before",), (other,), 1.0)) == other.parameters > 0


def test_what_changes_takes_the_place_of_what_imitates_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two poses after a joint has turned look much as if its zero had changed as well."""
    leap, imitation, other = (
        Corrected(EncoderError("offset", name, 1.0, 0, begin))
        for name, begin in (("j", 40.0), ("j", 60.0), ("k", 60.0))
    )
    turn = Corrected(EncoderError("sign", "j", -1.0, 0, 40.0))
    attempts = []

    def attempt(_: Search, amendments: tuple[Amendment, ...], *__: float) -> Attempt:
        attempts.append(amendments)
        misfit = {0: 1e4, 1: 500.0}.get(len(set(amendments) - {leap, imitation}), 5.0)
        return Attempt(amendments, Solution(None, None, estimate(misfit), None), None)  # type: ignore[arg-type]

    monkeypatch.setattr(Search, "attempt", attempt)
    monkeypatch.setattr(Search, "once", lambda *_: [("encoder turn", ["j"], (turn,))])
    first = Solution(None, None, estimate(1e5), None)  # type: ignore[arg-type]
    kinds = [Proposing((imitation, other)), Changes()]
    explain([], (leap,), (SimpleNamespace(settings=None), None, first), kinds, Clock())  # type: ignore[arg-type]
    assert attempts[:2] == [(leap, imitation, other), (leap, other, turn)]
