"""Programs that take URDFs: each loads ours without a word and has every SU in its place.

Those that are not installed are skipped. `pip install '.[consumers]'` brings what is light enough;
Drake comes with `pip install --no-deps drake`, as its optional solver MOSEK is proprietary.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.model.poses import su_poses
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.limits import wide_limits
from skin2urdf.urdf.records import Remarks

Case = tuple[Path, KinematicModel, np.ndarray]
Poses = Callable[[Path, KinematicModel, np.ndarray], list[np.ndarray]]


@pytest.fixture(scope="session")
def case(
    random_robot: Callable[..., KinematicModel], tmp_path_factory: pytest.TempPathFactory
) -> Case:
    """A robot with branches, a slide, a wheel, two limbs and remarks; and joint positions."""
    parent, su_joint = (-1, 0, 1, 1, -1, 4), (-1, 0, 1, 2, 2, 3, 5)
    model = random_robot(np.random.default_rng(7), parent, su_joint, (2,))
    n = model.tree.n_joints
    limits = wide_limits(np.tile([0.2, 1.0], (n, 1)), np.ones(n), model.tree.prismatic)
    text = emit(
        model,
        name="robot",
        limits=limits,
        continuous=np.arange(n) == 4,
        collision=True,
        remarks=Remarks(("made by a test",), {"joint_1": ("OPEN: a -- b",)}, {"su_2": ("OPEN",)}),
    )
    path = tmp_path_factory.mktemp("consumers") / "robot.urdf"
    path.write_text(text)
    return path, model, np.random.default_rng(1).uniform(0.2, 1.0, (3, n))


def by_pinocchio(path: Path, model: KinematicModel, q: np.ndarray) -> list[np.ndarray]:
    pin = pytest.importorskip("pinocchio")
    read = pin.buildModelFromUrdf(str(path))
    data, poses = read.createData(), []
    for row in q:
        configuration = pin.neutral(read)
        for name, value in zip(model.tree.joint_names, row, strict=True):
            joint = read.joints[read.getJointId(name)]
            endless = joint.nq == 2
            configuration[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(value), np.sin(value)) if endless else value
            )
        pin.framesForwardKinematics(read, data, configuration)
        frames = [read.getFrameId(name) for name in model.tree.su_names]
        poses.append(np.stack([data.oMf[frame].homogeneous for frame in frames]))
    return poses


def by_yourdfpy(path: Path, model: KinematicModel, q: np.ndarray) -> list[np.ndarray]:
    yourdfpy = pytest.importorskip("yourdfpy")
    read = yourdfpy.URDF.load(io.BytesIO(path.read_bytes()))
    assert read.validate()
    poses = []
    for row in q:
        read.update_cfg(dict(zip(model.tree.joint_names, row, strict=True)))
        poses.append(np.stack([read.get_transform(name) for name in model.tree.su_names]))
    return poses


def by_mujoco(path: Path, model: KinematicModel, q: np.ndarray) -> list[np.ndarray]:
    mujoco = pytest.importorskip("mujoco")
    read = mujoco.MjModel.from_xml_path(str(path))
    data, poses = mujoco.MjData(read), []
    for row in q:
        for name, value in zip(model.tree.joint_names, row, strict=True):
            data.qpos[read.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(read, data)
        T = np.tile(np.eye(4), (model.tree.n_sus, 1, 1))
        for u, name in enumerate(model.tree.su_names):
            T[u, :3, :3] = data.body(name).xmat.reshape(3, 3)
            T[u, :3, 3] = data.body(name).xpos
        poses.append(T)
    return poses


def by_drake(path: Path, model: KinematicModel, q: np.ndarray) -> list[np.ndarray]:
    pytest.importorskip("pydrake", reason="needs drake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(time_step=0.0)
    parser = Parser(plant)
    parser.SetStrictParsing()  # warnings are errors
    parser.AddModels(str(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    context, poses = plant.CreateDefaultContext(), []
    for row in q:
        for name, value in zip(model.tree.joint_names, row, strict=True):
            joint = plant.GetJointByName(name)
            move = joint.set_translation if model_slides(model, name) else joint.set_angle
            move(context, value)
        poses.append(
            np.stack(
                [
                    plant.GetFrameByName(name).CalcPoseInWorld(context).GetAsMatrix4()
                    for name in model.tree.su_names
                ]
            )
        )
    return poses


def model_slides(model: KinematicModel, name: str) -> bool:
    return bool(model.tree.prismatic[model.tree.joint_names.index(name)])


def by_pybullet(path: Path, model: KinematicModel, q: np.ndarray) -> list[np.ndarray]:
    bullet = pytest.importorskip("pybullet", reason="needs pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        robot = bullet.loadURDF(str(path), useFixedBase=True)
        info = [bullet.getJointInfo(robot, i) for i in range(bullet.getNumJoints(robot))]
        joints = {row[1].decode(): i for i, row in enumerate(info)}
        links = {row[12].decode(): i for i, row in enumerate(info)}
        masses = [bullet.getDynamicsInfo(robot, links[su])[0] for su in model.tree.su_names]
        assert max(masses) < 0.01, "an SU without an inertia of its own would get 1 kg"
        poses = []
        for row in q:
            for name, value in zip(model.tree.joint_names, row, strict=True):
                bullet.resetJointState(robot, joints[name], value)
            T = np.tile(np.eye(4), (model.tree.n_sus, 1, 1))
            for u, name in enumerate(model.tree.su_names):
                state = bullet.getLinkState(robot, links[name], computeForwardKinematics=True)
                T[u, :3, 3] = state[4]
                T[u, :3, :3] = np.reshape(bullet.getMatrixFromQuaternion(state[5]), (3, 3))
            poses.append(T)
        return poses
    finally:
        bullet.disconnect(client)


EXACT, SINGLE = 1e-9, 1e-6
"""Largest error of an SU's pose [m, 1]; PyBullet computes in single precision."""


@pytest.mark.parametrize(
    ("consumer", "tolerance"),
    [
        (by_pinocchio, EXACT),
        (by_yourdfpy, EXACT),
        (by_mujoco, EXACT),
        (by_drake, EXACT),
        (by_pybullet, SINGLE),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_sus_are_where_the_model_has_them(
    case: Case, capfd: pytest.CaptureFixture[str], consumer: Poses, tolerance: float
) -> None:
    path, model, q = case
    got = consumer(path, model, q)
    for row, T in zip(q, got, strict=True):
        np.testing.assert_allclose(T, su_poses(model, row), atol=tolerance)
    said = "".join(capfd.readouterr()).lower()
    if consumer is by_pybullet:
        # It wants an inertia of the base, of which KDL, and with it ROS, warns in turn.
        assert said.count("b3warning") <= 2
        assert not any(name in said for name in (*model.tree.su_names, *model.tree.joint_names))
        said = said.replace("b3warning", "")
    assert "warn" not in said
    assert "error" not in said


def test_urdfdom_reads_it(case: Case) -> None:
    """The parser of ROS: robot_state_publisher, RViz and MoveIt stand on it."""
    path, model, _ = case
    program = shutil.which("check_urdf") or shutil.which(
        "check_urdf", path=str(Path(sys.executable).parent)
    )
    if program is None:
        pytest.skip("needs check_urdf (liburdfdom-tools, or cmeel-urdfdom)")
    done = subprocess.run(  # noqa: S603 - our own file
        [program, str(path)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert "rror" not in done.stdout
    assert all(name in done.stdout for name in model.tree.su_names)


def test_viser_shows_it(case: Case) -> None:
    viser = pytest.importorskip("viser")
    extras = pytest.importorskip("viser.extras")
    path, model, q = case
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        shown = extras.ViserUrdf(server, path)
        names = shown.get_actuated_joint_names()
        assert set(names) == set(model.tree.joint_names)
        rows = dict(zip(model.tree.joint_names, q[0], strict=True))
        shown.update_cfg(np.array([rows[name] for name in names]))
    finally:
        server.stop()
