"""SUs that slip, or whose bias steps, in logs of moves without any pattern."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import held_against

from skin2urdf.arrays import F64
from skin2urdf.calibration import explanation
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.faults import FAULTS, Sound, recorded_after

WHEN = 0.6
"""Share of the log after which an SU is another."""


@cache
def sound() -> Sound:
    robot = small_arm(3)
    settings = SimulationSettings(
        excite="none", minutes=0.8, seed=3, imu_rate=250.0, joint_rate=125.0
    )
    return Sound(robot, settings, simulate(robot, settings))


def changed(names: tuple[str, ...], change: Callable[[F64], F64]) -> Recording:
    """The recording with some SUs whose readings (N, 3) are others from some time on."""
    recording = sound().recording

    def after(su: SuStream) -> SuStream:
        n = int(WHEN * len(su.time))
        force = su.specific_force
        return replace(su, specific_force=np.concatenate([force[:n], change(force[n:])]))

    sus = tuple(after(su) if su.name in names else su for su in recording.sus)
    return replace(recording, sus=sus)


def joint_of(found: Calibration, name: str) -> int:
    """Number of the joint that carries an SU, -1 for none."""
    tree = found.model.tree
    return int(tree.su_joint[tree.su_names.index(name)])


def last_names(n: int) -> tuple[str, ...]:
    """Names of some SUs, the last ones of the recording."""
    return tuple(su.name for su in sound().simulation.moved.sus[-n:])


def told(found: Calibration) -> list[tuple[str, str]]:
    return [(fault.kind, fault.subject) for fault in found.faults]


def error(found: Calibration, tmp_path_factory: pytest.TempPathFactory, but: str) -> float:
    """Largest root mean square error of the position of any SU but one [m]."""
    truth = sound().simulation.truth.urdf
    sus = held_against(found, truth, tmp_path_factory.mktemp("found"), ()).sus
    return max(su.position.rms for su in sus if su.name != but and su.position is not None)


@pytest.fixture(scope="module")
def clean() -> Calibration:
    return calibrate(retimed(sound().recording))


def test_a_sound_log_has_no_change(clean: Calibration) -> None:
    assert told(clean) == []
    assert clean.quality == "good"


def test_an_su_that_slips_is_two(
    clean: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> None:
    injected = FAULTS["loose"](sound(), np.random.default_rng(2))
    (name,) = injected.subjects
    found = calibrate(retimed(injected.recordings[0]))
    (fault,) = found.faults
    assert (fault.kind, fault.subject) == ("loose", name)
    angle = float(injected.words.split(", ")[1].split()[0])
    assert np.rad2deg(fault.turn) == pytest.approx(angle, abs=0.15)
    assert {name, fault.sus[1]} <= set(found.model.tree.su_names)
    assert error(found, tmp_path_factory, name) < 1.5 * error(clean, tmp_path_factory, name)


def test_a_small_turn_is_told_with_its_size_and_time() -> None:
    """Half a degree, which is 9 mg of gravity at most."""
    (name,) = last_names(1)
    turn = rotation_exp(np.deg2rad(0.5) * np.array([0.6, 0.0, 0.8]))
    (fault,) = calibrate(retimed(changed((name,), lambda force: force @ turn))).faults
    assert (fault.kind, fault.subject) == ("loose", name)
    assert np.rad2deg(fault.turn) == pytest.approx(0.5, abs=0.1)
    time = sound().recording.sus[0].time
    at = time[0] + WHEN * (time[-1] - time[0])
    assert fault.begin < at < fault.end < fault.begin + 10.0


@pytest.mark.parametrize("axis", [2, 0])
def test_a_slip_with_the_joint_is_not_told_for_certain(clean: Calibration, axis: int) -> None:
    """Alone beyond a joint, an SU that goes around its axis (z) is what a jump or slack makes."""
    tree = clean.model.tree
    name = max(tree.su_names, key=lambda n: len(tree.chain(joint_of(clean, n))))
    (su,) = (su for su in sound().simulation.moved.sus if su.name == name)
    moved = np.eye(4)
    moved[:3, :3] = rotation_exp(np.deg2rad(3.0) * np.eye(3)[axis])
    slip = np.linalg.inv(su.T_joint_su) @ moved @ su.T_joint_su
    slipped = recorded_after(sound(), su.name, slip).specific_force
    recording = changed((su.name,), lambda force: slipped[-len(force) :])
    found = calibrate(retimed(recording))
    told_for_certain = [(f.kind, f.subject) for f in found.faults if f.detail != "or its encoder"]
    assert told_for_certain == ([("loose", su.name)] if axis == 0 else [])
    assert found.quality != "good"


def test_a_bias_that_steps_is_no_slip(
    clean: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (name,) = last_names(1)
    step = np.array([0.1, -0.2, 0.2])
    found = calibrate(retimed(changed((name,), lambda force: force + step)))
    (fault,) = found.faults
    assert (fault.kind, fault.subject, fault.unit) == ("bias step", name, "g")
    assert fault.size == pytest.approx(0.3 / 9.81, abs=5 * fault.deviation)
    assert fault.deviation < 3e-3
    assert not fault.to_repair
    assert error(found, tmp_path_factory, name) < 1.5 * error(clean, tmp_path_factory, name)


def test_a_bias_that_drifts_does_not_step() -> None:
    """However much of that a step in its middle explains: three quarters."""
    recording, (name,) = sound().recording, last_names(1)

    def drifting(su: SuStream) -> SuStream:
        grown = (su.time - su.time[0]) / (su.time[-1] - su.time[0])
        return replace(su, specific_force=su.specific_force + grown[:, None] * [0.04, -0.02, 0.03])

    sus = tuple(drifting(su) if su.name == name else su for su in recording.sus)
    found = calibrate(retimed(replace(recording, sus=sus)))
    assert found.along is not None
    assert found.along.causes == ("drift",)
    assert told(found) == []


@dataclass(frozen=True)
class Watched:
    """A calibration of SUs whose biases step at one moment.

    Attributes:
        found: its result.
        tried: whether any physics was, in each fit of all samples.
    """

    found: Calibration
    tried: tuple[bool, ...]


@pytest.fixture(scope="module")
def stepped() -> Callable[[int], Watched]:
    """Calibrations with so many SUs that step, each done once."""

    @cache
    def stepped(n: int) -> Watched:
        tried: list[bool] = []

        def watched(*arguments: Any, **more: Any) -> MotionEstimate | None:
            along = fit_samples(*arguments, **more)
            tried.append(bool(along is not None and along.tried))
            return along

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(explanation, "fit_samples", watched)
            found = calibrate(retimed(changed(last_names(n), lambda force: force + 0.2)))
        return Watched(found, tuple(tried))

    return stepped


@pytest.mark.parametrize("n", [1, 2])
def test_no_physics_is_tried_for_what_one_su_alone_shows(
    n: int, stepped: Callable[[int], Watched]
) -> None:
    """As long as a single one is all that is left: two that changed at once may be a joint."""
    assert any(stepped(n).tried) == (n == 2)
    assert told(stepped(n).found) == [("bias step", *last_names(1))] * (n == 1)


def test_sus_that_change_at_one_moment_did_not_do_so_by_themselves(
    stepped: Callable[[int], Watched],
) -> None:
    found = stepped(2).found
    assert not {"loose", "bias step"} & {fault.kind for fault in found.faults}
    assert found.quality != "good"
