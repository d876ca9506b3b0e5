"""Several logs of one robot that hold different joints and SUs, its base turned in between."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from random_robots import chain, robot_of
from simulated import PATTERNS, changed_sus, features_of, held_against, tree_of

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.errors import InsufficientDataError
from skin2urdf.notes import of_kind
from skin2urdf.recording.records import Recording
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.simulation import Simulation, SimulationSettings, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.structure.unknown_positions import unknown_position_notes, usable

STEM = chain(4, turns=1.4)
BRANCH = tuple(
    replace(j, name=f"k{d}", parent=0 if d == 0 else 3 + d, xyz=(0.1, -0.1, 0.2))
    for d, j in enumerate(chain(2, turns=-1.3))
)
SKIN = SkinLayout(
    sus_per_segment=0,
    sus_on_base=0,
    given=tuple(
        GivenSu(f"link_{joint.name}", (0.05, 0.02 * d, 0.07), (0.3 * d, 0.2, 1.0))
        for d, joint in enumerate((*STEM, *BRANCH))
    ),
)
RESTING = 0.7
"""Where joints rest that a log does not name [rad]."""


@cache
def log(lacks: tuple[str, ...] = (), n_poses: int = 4) -> Simulation:
    """A log without some joints, which rest; SUs and sensors are the same in all of them."""
    robot = robot_of((*STEM, *BRANCH), Path(mkdtemp()), SKIN)
    robot = replace(robot, locked=dict.fromkeys(lacks, RESTING))
    rpy = (0.0, 0.4, 0.0) if lacks else robot.base_rpy
    settings = SimulationSettings(
        n_poses=n_poses, base_rpy=rpy, imu_rate=250.0, joint_rate=125.0, excite="all", seed=4
    )
    return simulate(robot, settings)


def with_sus_on(recording: Recording, links: Collection[str]) -> Recording:
    names = {su.name for su in log().truth.sus if su.link.removeprefix("link_") in links}
    return changed_sus(recording, lambda su: su if su.name in names else None)


def check(found: Calibration, folder: Path) -> None:
    comparison = held_against(found, log().truth.urdf, folder)
    assert comparison.tree_equal, comparison.tree_differences
    assert found.estimate.cost_per_dof < 2.0
    assert comparison.position.rms < 0.5e-3
    assert np.rad2deg(comparison.orientation.rms) < 0.05


@pytest.mark.parametrize(
    ("lacks", "unused"),
    [
        (("j0",), ()),  # it only turns the base of everything else
        (("j2",), ("j2", "j3")),  # behind j1, which moves
        (("j0", "j1"), ("j0", "k0", "k1")),  # the stem's tip and the branch are on two bases
    ],
)
def test_joints_that_a_log_lacks_may_rest_anywhere(
    lacks: tuple[str, ...], unused: tuple[str, ...], tmp_path: Path
) -> None:
    # Both ways through once: with all samples after the patterns where no SU is left out.
    settings = PATTERNS if unused else None
    found = calibrate([log().recording, log(lacks).recording], settings)
    check(found, tmp_path)
    tree, features = found.model.tree, found.features
    use = usable(features, tree)[features.log == 1].any(axis=0)
    for su in log().truth.sus:
        used = bool(use[tree.su_names.index(su.name)])
        assert used == (su.link.removeprefix("link_") not in unused)
    notes = unknown_position_notes(features, tree)
    assert len(notes) == bool(unused)
    assert set(notes) <= set(found.notes)


def test_each_log_may_hold_other_sus(tmp_path: Path) -> None:
    first, second = log().recording, log(("k0", "k1")).recording
    found = calibrate(
        [
            with_sus_on(first, {"j0", "j1", "j2", "k0", "k1"}),
            with_sus_on(second, {"j1", "j2", "j3"}),
        ],
        PATTERNS,
    )
    assert found.model.tree.n_sus == 6
    check(found, tmp_path)


def test_what_no_log_holds_together_is_said() -> None:
    """j0 moves in the first log alone, the branch's SUs are in the second alone."""
    first = with_sus_on(log().recording, {"j0", "j1", "j2", "j3"})
    second = with_sus_on(log(("j0",)).recording, {"j2", "j3", "k0", "k1"})
    found = calibrate([first, second], PATTERNS)
    assert found.estimate.cost_per_dof < 2.0
    sus = log().truth.sus
    told = [(set(note.sus), note.joints) for note in of_kind(found.notes, "never together")]
    assert ({su.name for su in sus if su.link.startswith("link_k")}, ("j0",)) in told


def test_an_su_that_no_log_can_place_is_an_error_in_words() -> None:
    """j2 is behind j1, which moves, and no log says where j2 is."""
    features = features_of(with_sus_on(log().recording, {"j0", "j1", "j2"}))
    tree = tree_of(features)
    unknown = np.where([name == "j2" for name in features.dof_names], np.inf, 0.0)
    with pytest.raises(InsufficientDataError) as caught:
        usable(replace(features, encoders=EncoderNoise(position_sd=unknown)), tree)
    (name,) = (su.name for su in log().truth.sus if su.link == "link_j2")
    assert (caught.value.lacks, caught.value.names) == ("positions", (name,))
    assert caught.value.remedy
