"""A base that moves by itself turns gravity alike in all SUs while no joint moves."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.refusal import tell_what_streams_show
from skin2urdf.errors import BadFitError, Skin2UrdfError, StructureError, UsageError
from skin2urdf.notes import Note, NoteKind, of_kind
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.poses import Rest
from skin2urdf.signals.sampling import sample_recording
from skin2urdf.signals.standing import AtRest, changes_at_rest

RATE = 100.0
SUS = 5
TIME = np.arange(0, 4, 1 / RATE)
MOUNTED = Rotation.random(SUS, random_state=1)
REST = (Rest(0, len(TIME), np.zeros(1)),)
HEARD = np.ones((len(TIME), SUS), dtype=bool)


def readings(tilt: F64, rng: np.random.Generator) -> F64:
    """(N, U, 3) gravity in SUs that are tilted about a level axis by angles (N, U) [rad]."""
    out = np.empty((*tilt.shape, 3))
    for u in range(SUS):
        turned = Rotation.from_rotvec(tilt[:, u, None] * np.array([0.6, 0.8, 0.0]))
        out[:, u] = MOUNTED[u].apply(turned.apply([0.0, 0.0, 9.81]))
    return out + 0.03 * rng.standard_normal(out.shape)


def swayed(by: float) -> F64:
    """(N, U) tilt of a base that sways [rad]."""
    return np.tile(by * np.sin(2 * np.pi * 0.4 * TIME)[:, None], SUS)


STILL = np.zeros((len(TIME), 1))


def at_rest(x: F64, heard: Bool = HEARD, q: F64 = STILL) -> AtRest:
    return changes_at_rest(REST, x, heard, q, RATE)


@pytest.mark.parametrize("by", [0.015, 0.05])
def test_a_base_that_sways_turns_all_sus_at_rest(by: float) -> None:
    x = readings(swayed(by), np.random.default_rng(1))
    # Half a second of a sine of 0.4 Hz: 2 sin(0.2 pi) of the amplitude at most, 0.7 of it rms.
    assert at_rest(x).angle == pytest.approx(by, rel=0.4)


def test_a_loose_or_deaf_su_does_not_hide_it() -> None:
    x = readings(swayed(0.05), np.random.default_rng(2))
    x[150:, 1] = x[150:, 1] @ Rotation.from_rotvec([0.3, 0.1, 0.0]).as_matrix()
    heard = HEARD.copy()
    heard[100:, 4] = False
    assert at_rest(x, heard).angle == pytest.approx(0.05, rel=0.4)


@pytest.mark.parametrize("case", ["noise", "a joint creeps", "biases drift", "one slips"])
def test_what_stands_does_not_move(case: str) -> None:
    rng = np.random.default_rng(3)
    tilt = np.zeros((len(TIME), SUS))
    if case == "a joint creeps":
        tilt[:, 2:] = 0.02 * TIME[:, None]
    if case == "one slips":
        tilt[150:, 0] = 0.2
    x = readings(tilt, rng)
    if case == "biases drift":
        x += 0.05 * TIME[:, None, None] * rng.standard_normal((SUS, 3))
    assert at_rest(x).angle == 0.0


@pytest.mark.parametrize("how", ["drives", "turns"])
def test_a_base_that_moves_at_times_is_felt_at_rest(how: str) -> None:
    """In one second of four; where it turns, SUs feel as much as they are away from its axis."""
    x = readings(np.zeros((len(TIME), SUS)), np.random.default_rng(5))
    size = 0.4 * (np.ones(SUS) if how == "drives" else np.array([0.3, 0.6, 0.9, 1.2, 1.5]))
    for u in range(SUS):
        x[200:300, u] += size[u] * MOUNTED[u].apply([1.0, 0.0, 0.0])
    found = at_rest(x)
    assert found.angle == 0.0
    assert found.change == pytest.approx(np.median(size), rel=0.2)


@pytest.mark.parametrize("case", ["noise", "rings", "biases drift", "one slips"])
def test_a_base_that_stands_is_not_felt(case: str) -> None:
    rng = np.random.default_rng(6)
    x = readings(np.zeros((len(TIME), SUS)), rng)
    if case == "rings":
        ringing = np.exp(-TIME / 0.4) * np.sin(2 * np.pi * 5.3 * TIME)
        x += ringing[:, None, None] * rng.standard_normal((SUS, 3))
    if case == "biases drift":
        x += 0.01 * TIME[:, None, None] * rng.standard_normal((SUS, 3))
    if case == "one slips":
        x[150:, 0] = x[150:, 0] @ Rotation.from_rotvec([0.3, 0.1, 0.0]).as_matrix()
    assert at_rest(x).change == 0.0


def test_joints_that_creep_to_their_rest_are_no_base_that_moves() -> None:
    creep = 0.03 * np.exp(-TIME / 0.5)
    tilt = np.outer(creep, [0.0, 1.0, 1.0, 1.0, 1.0])
    x = readings(tilt, np.random.default_rng(7))
    assert at_rest(x).change > 0.0
    assert at_rest(x, q=creep[:, None]).change == 0.0


def test_a_joint_before_all_sus_that_creeps_turns_them_alike_and_is_no_base() -> None:
    creep = 0.04 * TIME
    x = readings(np.tile(creep[:, None], SUS), np.random.default_rng(6))
    assert at_rest(x).angle == pytest.approx(0.02, rel=0.2)  # as a base would
    assert at_rest(x, q=creep[:, None]).angle == 0.0
    # It turns nothing by more than it moves.
    assert at_rest(x, q=0.1 * creep[:, None]).angle == pytest.approx(0.02, rel=0.2)


def test_moments_that_stand_for_rests_tell_nothing_of_the_base() -> None:
    x = readings(swayed(0.05), np.random.default_rng(3))
    moving = (Rest(0, len(TIME), np.zeros(1), still=False),)
    assert changes_at_rest(moving, x, HEARD, STILL, RATE) == AtRest(0.0, 0.0)


@pytest.mark.parametrize("by", [0.0, 0.05])
def test_a_log_of_a_base_that_moves_says_so(by: float) -> None:
    position = 0.5 * np.clip(TIME - 2.0, 0.0, 0.3)
    x = readings(swayed(by), np.random.default_rng(4))
    sus = [SuStream(f"su_{u}", TIME, x[:, u], f"/su_{u}") for u in range(SUS)]
    log = Recording((JointStream("j", TIME, position),), tuple(sus), source="log")
    sampled = sample_recording(log, ["j"], [su.name for su in sus])
    assert bool(of_kind(sampled.notes, "base moves")) == (by > 0)


@pytest.mark.parametrize("kind", ["base moves", "felt at rest", "odd unit"])
@pytest.mark.parametrize("made", [StructureError, lambda *words: BadFitError(*words, 3.0)])
def test_a_refusal_begins_with_what_the_streams_show(
    made: Callable[[str, str], Skin2UrdfError], kind: NoteKind
) -> None:
    error = made("x", "y")
    still = cast(Any, SimpleNamespace(notes=()))
    moved = cast(Any, SimpleNamespace(notes=(Note(kind, joints=("j",), size=0.1),)))
    with pytest.raises(Skin2UrdfError) as caught, tell_what_streams_show([still]):
        raise error
    assert (str(caught.value), caught.value.remedy) == ("x", "y")
    with pytest.raises(Skin2UrdfError) as caught, tell_what_streams_show([still, moved]):
        raise error
    assert str(caught.value) != "x"
    assert str(caught.value).endswith("x")
    assert caught.value.remedy != "y"


def test_bad_usage_is_not_the_bases_fault() -> None:
    moved = cast(Any, SimpleNamespace(notes=(Note("base moves", size=0.1),)))
    with pytest.raises(UsageError) as caught, tell_what_streams_show([moved]):
        raise UsageError("x", "y")
    assert (str(caught.value), caught.value.remedy) == ("x", "y")
