from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import load_mechanism, read_urdf
from skin2urdf.simulation.specific_force import felt_motions, specific_forces

EXACT = SimulationSettings(
    n_poses=1,
    excite="all",
    grade="ideal",
    encoder_bits=None,
    jitter=0.0,
    stagger=False,
    imu_rate=100.0,
    sus_per_segment=2,
)


def mujoco_twin(robot: str, simulation: Simulation) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot's original URDF in MuJoCo, with an accelerometer for every SU."""
    urdf = read_urdf(load_robot(robot))
    for link in urdf.findall("link"):
        for tag in ("visual", "collision"):
            for mesh in link.findall(tag):
                link.remove(mesh)
    # The dynamics are not asked for, so fixing up inertias that MuJoCo refuses does no harm.
    ET.SubElement(
        ET.SubElement(urdf, "mujoco"),
        "compiler",
        fusestatic="false",
        balanceinertia="true",
        boundmass="0.01",
        boundinertia="0.0001",
    )
    spec = mujoco.MjSpec.from_string(ET.tostring(urdf, encoding="unicode"))
    for su in simulation.truth.sus:
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, su.T_link_su[:3, :3].ravel())
        body = spec.body(su.link) or spec.worldbody
        body.add_site(name=su.name, pos=su.T_link_su[:3, 3], quat=quaternion)
        spec.add_sensor(
            name=su.name,
            type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=su.name,
        )
    model = spec.compile()
    model.opt.gravity[:] = simulation.truth.gravity_base
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("robot", ["panda", "kinova", "xarm7"])
def test_mujoco_feels_the_same(robot: str) -> None:
    simulation = simulate(load_robot(robot), EXACT)
    truth, sus = simulation.truth, simulation.recording.sus
    model, data = mujoco_twin(robot, simulation)
    for k in range(0, sus[0].time.size, 37):
        state = truth.motion.at(sus[0].time[[k]] + truth.start)
        for name, q, v, a in zip(truth.joint_names, *(x[0] for x in state), strict=True):
            joint = model.joint(name)
            data.qpos[joint.qposadr[0]] = q
            data.qvel[joint.dofadr[0]] = v
            data.qacc[joint.dofadr[0]] = a
        mujoco.mj_inverse(model, data)
        for su in sus:
            np.testing.assert_allclose(
                su.specific_force[k], data.sensor(su.name).data, rtol=0, atol=1e-9
            )


def position_and_rotation(model: pin.Model, q: F64, frame: int) -> tuple[F64, F64]:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.array(data.oMf[frame].translation), np.array(data.oMf[frame].rotation)


def test_finite_differences_of_the_truth_urdf_agree(panda_exact: Simulation) -> None:
    truth = panda_exact.truth
    model = pin.buildModelFromXML(truth.urdf)
    order = [truth.joint_names.index(name) for name in list(model.names)[1:]]
    h = 5e-4
    for su in panda_exact.recording.sus:
        frame = model.getFrameId(su.name)
        for k in range(500, su.time.size - 500, 3001):
            around = su.time[k] + truth.start + h * np.arange(-2, 3)
            q = truth.motion.at(around)[0][:, order]
            states = [position_and_rotation(model, row, frame) for row in q]
            p = np.array([state[0] for state in states])
            acceleration = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h**2)
            expected = states[2][1].T @ (acceleration - truth.gravity_base)
            np.testing.assert_allclose(su.specific_force[k], expected, rtol=0, atol=1e-5)


def test_at_rest_it_feels_gravity(panda_exact: Simulation) -> None:
    phase = next(p for p in panda_exact.truth.phases if p.kind == "rest" and p.pose == 1)
    for su in panda_exact.recording.sus:
        time = su.time + panda_exact.truth.start
        rest = su.specific_force[(time > phase.start + 0.4) & (time < phase.end)]
        np.testing.assert_allclose(np.linalg.norm(rest, axis=1), GRAVITY, atol=1e-5)


def test_long_recordings_are_cut_without_a_seam(
    panda_exact: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot("panda")
    mechanism = load_mechanism(robot, robot.base_rpy)
    time = np.linspace(3.0, 4.0, 101)
    arguments = (mechanism, panda_exact.truth.motion, panda_exact.truth.sus, time)
    whole = specific_forces(*arguments)
    monkeypatch.setattr("skin2urdf.simulation.specific_force.SAMPLES_AT_ONCE", 17)
    np.testing.assert_array_equal(specific_forces(*arguments), whole)


def test_staggered_samples_are_as_true_as_the_others() -> None:
    robot = load_robot("ur10")
    settings = SimulationSettings(n_poses=1, grade="ideal", jitter=0.0, tracking="soft")
    simulation = simulate(robot, settings)
    mechanism = load_mechanism(robot, robot.base_rpy)
    truth = simulation.truth
    starts = {round(su.time[0], 6) for su in simulation.recording.sus}
    assert len(starts) == 7
    for u, su in enumerate(simulation.recording.sus):
        time = su.time[200:-200:13] + truth.start
        expected = specific_forces(mechanism, truth.motion, [truth.sus[u]], time)[0]
        np.testing.assert_allclose(su.specific_force[200:-200:13], expected, rtol=0, atol=1e-5)


def test_gyroscopes_feel_how_pinocchios_frames_turn() -> None:
    robot = load_robot("ur3")
    settings = SimulationSettings(
        n_poses=1, excite="all", grade="ideal", gyro="ideal", jitter=0.0, stagger=False,
        imu_rate=100.0,
    )  # fmt: skip
    simulation = simulate(robot, settings)
    truth = simulation.truth
    mechanism = load_mechanism(robot, robot.base_rpy)
    time = np.arange(0.5, 20.0, 0.37)
    step = 1e-4
    _, rates = felt_motions(mechanism, truth.motion, truth.sus, time)
    model, data = mechanism.model, mechanism.model.createData()

    def rotations(at: F64) -> F64:
        out = np.empty((len(at), len(truth.sus), 3, 3))
        for n, q in enumerate(mechanism.configuration(truth.motion.at(at)[0])):
            pin.forwardKinematics(model, data, q)
            for u, su in enumerate(truth.sus):
                out[n, u] = data.oMi[su.joint + 1].rotation @ su.T_joint_su[:3, :3]
        return out

    before, after = rotations(time - step), rotations(time + step)
    for u in range(len(truth.sus)):
        turned = [
            pin.log3(b.T @ a) / (2 * step) for b, a in zip(before[:, u], after[:, u], strict=True)
        ]
        np.testing.assert_allclose(rates[u], turned, atol=1e-5)
    stream = simulation.recording.sus[-1]
    assert stream.angular_velocity is not None
    sampled = stream.time + truth.start
    _, felt = felt_motions(mechanism, truth.motion, truth.sus[-1:], sampled)
    np.testing.assert_allclose(stream.angular_velocity, felt[0], atol=1e-6)
