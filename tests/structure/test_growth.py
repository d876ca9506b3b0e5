"""Trees grown from readings of gravity at rest, several joints having moved in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import axis_rotation, rotation_exp, wahba
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.gravity import GravityWindows, moments
from skin2urdf.structure.grown import Grown
from skin2urdf.structure.growth import Known, grow

PARENT = (-1, 0, 1, 0, 3)
"""Two limbs of two joints on one joint."""
SD = 0.02


def unit(x: F64) -> F64:
    return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True))


class Robot:
    """Random axes on the tree ``PARENT``, and an SU on every segment, the first one on the RS."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        n = len(PARENT)
        # Axes of neighbours differ, and the first is not vertical.
        self.axes = unit(self.rng.standard_normal((n, 3)))
        self.axes[0] = unit(np.array([0.6, -0.3, 0.8]))
        self.R_base_su = rotation_exp(self.rng.standard_normal((n + 1, 3)))

    def windows(self, n: int = 30, up: tuple[float, float, float] = (0, 0, 1)) -> GravityWindows:
        """What the SUs feel in n random poses."""
        q = self.rng.uniform(-1.2, 1.2, (n, len(PARENT)))
        R = [np.tile(np.eye(3), (n, 1, 1))]
        for d, p in enumerate(PARENT):
            R.append(R[p + 1] @ axis_rotation(self.axes[d], q[:, d]))
        g = GRAVITY * unit(np.array(up))
        felt = np.stack(
            [(r @ b).swapaxes(1, 2) @ g for r, b in zip(R, self.R_base_su, strict=True)], 1
        )
        reading = felt + SD * self.rng.standard_normal(felt.shape) + 0.05
        U = reading.shape[1]
        return GravityWindows(
            tuple(f"joint{d}" for d in range(q.shape[1])), tuple(f"su{u}" for u in range(U)),
            q, np.zeros(n, dtype=np.int64), reading, np.full((n, U), SD),
        )  # fmt: skip


def grown(windows: GravityWindows, known: Known | None = None) -> Grown:
    return grow(windows, range(windows.q.shape[1]), np.random.default_rng(0), known)


def chains(growth: Grown) -> dict[str, list[int]]:
    at, _ = growth.best()
    return {
        name: [growth.segments[s].dof for s in growth.chain(int(at[u]))]
        for u, name in enumerate(growth.windows.su_names)
    }


TRUE = {"su0": [], "su1": [0], "su2": [0, 1], "su3": [0, 1, 2], "su4": [0, 3], "su5": [0, 3, 4]}


@pytest.mark.parametrize("seed", [0, 1])
def test_a_tree_is_found_with_its_axes(seed: int) -> None:
    robot = Robot(seed)
    growth = grown(robot.windows())
    assert chains(growth) == TRUE
    axes = {s.dof: s.axis for s in growth.segments[1:]}
    found = np.array([*(axes[d] for d in range(len(PARENT))), (0.0, 0.0, 1.0)])
    true = np.array([*robot.axes, (0.0, 0.0, 1.0)])
    # Turning all about the vertical changes no reading.
    R, _ = wahba(found, true, np.ones(len(true)))
    angle = np.degrees(np.arccos(np.clip((found @ R.T * true).sum(axis=1), -1, 1)))
    assert angle.max() < 1.0


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_a_level_axis_is_told_from_a_bias_by_sus_further_out(seed: int) -> None:
    """An SU that a level joint alone turns feels its bias along the axis as a tilt of this."""
    robot = Robot(seed)
    robot.axes[0] = (1.0, 0.0, 0.0)
    windows = robot.windows(60)
    bias = robot.rng.uniform(-0.8, 0.8, windows.reading.shape[1:])
    growth = grown(replace(windows, reading=windows.reading + bias))
    assert chains(growth) == TRUE
    np.testing.assert_array_less(growth.left(), 1.5 * SD)


def test_two_joints_without_an_su_in_between() -> None:
    windows = Robot(2).windows()
    bare = [0, 1, 3, 4, 5]
    some = replace(
        windows,
        su_names=tuple(windows.su_names[u] for u in bare),
        reading=windows.reading[:, bare],
        sd=windows.sd[:, bare],
    )
    assert chains(grown(some)) == {k: v for k, v in TRUE.items() if k != "su2"}


def test_a_joint_that_creeps_is_no_part_of_the_tree() -> None:
    windows = Robot(3).windows()
    q = np.concatenate([windows.q, 2e-3 * windows.q[:, :1]], axis=1)
    creeping = replace(windows, dof_names=(*windows.dof_names, "creeps"), q=q)
    growth = grown(creeping)
    assert chains(growth) == TRUE
    assert growth.placed == set(range(5))


def test_the_base_may_stand_otherwise_in_another_log() -> None:
    robot = Robot(4)
    first, second = robot.windows(20), robot.windows(8, (0.3, 0.2, 0.9))
    both = replace(
        first,
        q=np.concatenate([first.q, second.q]),
        log=np.repeat([0, 1], [20, 8]),
        reading=np.concatenate([first.reading, second.reading]),
        sd=np.concatenate([first.sd, second.sd]),
    )
    growth = grown(both)
    assert chains(growth) == TRUE
    tilt = np.degrees(np.arccos(growth.up[1] @ growth.up[0]))
    assert tilt == pytest.approx(np.degrees(np.arctan2(np.hypot(0.3, 0.2), 0.9)), abs=0.5)


def test_an_upright_log_shows_no_upright_joint_and_a_tilted_one_does() -> None:
    """Of the first, which holds more of the motion, all is explained without that joint."""
    robot = Robot(7)
    robot.axes[0] = (0.0, 0.0, 1.0)
    upright, tilted = robot.windows(40), robot.windows(25, (0.3, -0.2, 0.9))
    both = replace(
        upright,
        q=np.concatenate([upright.q, tilted.q]),
        log=np.repeat([0, 1], [40, 25]),
        reading=np.concatenate([upright.reading, tilted.reading]),
        sd=np.concatenate([upright.sd, tilted.sd]),
    )
    motion = [np.ptp(both.q[both.log == g], axis=0).sum() for g in range(2)]
    assert motion[0] > motion[1]
    growth = grown(both)
    assert chains(growth) == TRUE
    tilt = np.arccos(np.clip(growth.up[0] @ growth.up[1], -1, 1))
    assert np.degrees(tilt) == pytest.approx(
        np.degrees(np.arctan2(np.hypot(0.3, 0.2), 0.9)), abs=0.5
    )


KNOWN = Known(dict(enumerate(PARENT)), {u + 1: u for u in range(len(PARENT))} | {0: -1})


@pytest.mark.parametrize("bare", [(), (2,), (1, 2)])
def test_a_known_tree_is_found_with_some_segments_bare(bare: tuple[int, ...]) -> None:
    windows = Robot(5).windows()
    weight = np.where(np.isin(np.arange(len(PARENT) + 1), bare), np.inf, windows.sd)
    found = chains(grown(replace(windows, sd=weight), KNOWN))
    assert {k: v for k, v in found.items() if int(k[2:]) not in bare} == {
        k: v for k, v in TRUE.items() if int(k[2:]) not in bare
    }


def test_a_known_tree_ends_at_a_joint_whose_encoder_is_wrong() -> None:
    """No rotation beyond it can be told; the other branch is as good as ever."""
    windows = Robot(5).windows()
    growth = grown(replace(windows, q=windows.q * np.array([1.0, 1.5, 1.0, 1.0, 1.0])), KNOWN)
    assert growth.placed == {0, 3, 4}


def test_the_first_joint_is_the_upright_one_that_gravity_does_not_show() -> None:
    """Of many SUs that many joints move it promises least, to gravity alone."""
    settings = SimulationSettings(
        seed=11, excite="series", minutes=0.5, upright=True, imu_rate=100.0, joint_rate=50.0,
        motion=MotionSettings(series_band=(0.1, 0.5)),
    )  # fmt: skip
    simulation = simulate(replace(load_robot("ur5"), skin=SkinLayout(2, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)], must_rest=False)
    growth = grown(moments(logs, names))
    joints = [growth.windows.dof_names[s.dof] for s in growth.segments[1:]]
    assert joints == list(simulation.truth.joint_names)
    assert [s.parent for s in growth.segments] == [-1, 0, 1, 2, 3, 4, 5]
    at, _ = growth.best()
    assert (at - 1).tolist() == [su.joint for su in simulation.truth.sus]
