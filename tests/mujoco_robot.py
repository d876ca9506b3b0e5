"""Recordings of torque-driven robots from MuJoCo, and their geometry as a URDF.

An independent witness: geometry is written down here, dynamics and accelerometers are MuJoCo's.
Joints are driven by springs and dampers (position control with finite gains), so they sag under
gravity, lag, stick, and pull each other along; what the encoders say is what they really did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from joint_paths import JointPath
from mujoco import rollout
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording, SuStream

STEP = 1e-3
"""Time step of the physics [s]; semi-implicit Euler, so that q's second difference is qdd."""
G = 9.81
SLIDE = 0.15
"""How far a sliding joint moves where a revolute one moves by 1 rad [m]."""
SLIDE_STIFFNESS = 30.0
"""Stiffness of sliding drives over that of turning ones [1 / m^2]."""
_CROSSED = 0.3
"""Force by which a drive crosses the gap of its gear [N m]."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ArmJoint:
    """A joint and the segment it carries.

    Attributes:
        xyz: origin in the parent segment [m].
        rpy: orientation there [rad].
        axis: axis in the joint's own frame.
        su_xyz: place of the SU on the segment [m].
        su_rpy: its orientation [rad].
        mass: of the segment [kg].
        parent: number of the joint it stands on, -1 for the base; None for the one before.
        slides: True for a prismatic joint.
    """

    xyz: Vector
    rpy: Vector
    axis: Vector
    su_xyz: Vector
    su_rpy: Vector
    mass: float
    parent: int | None = None
    slides: bool = False


@dataclass(frozen=True)
class Arm:
    """An arm, or a tree of them, on a tilted base.

    Attributes:
        joints: D joints, each after the one it stands on.
        base_su: place and orientation of an SU on the base.
        base_rpy: tilt of the base in the world [rad].
        stiffness: of the joints' drives [N m / rad]; of sliding ones as many times
            `SLIDE_STIFFNESS` [N / m].
        friction: dry friction of every joint [N m or N].
        slab: mass [kg] of a slab below that slides on springs in its plane, and at how many hertz
            it would swing alone; None for a base that stands.
        rocks: stiffness about two level axes [N m / rad] of what carries the slab, and how far
            below the base these lie [m]; None where the slab does not rock.
    """

    joints: tuple[ArmJoint, ...]
    base_su: tuple[Vector, Vector]
    base_rpy: Vector
    stiffness: float = 3000.0
    friction: float = 0.4
    slab: tuple[float, float] | None = None
    rocks: tuple[float, float] | None = None

    @property
    def n_slides(self) -> int:
        """Joints below the base."""
        return 0 if self.slab is None else 2 if self.rocks is None else 4

    @property
    def n_joints(self) -> int:
        """Number of DoFs D."""
        return len(self.joints)

    @property
    def parent(self) -> tuple[int, ...]:
        """Number of the joint that each joint stands on, -1 for the base."""
        return tuple(d - 1 if j.parent is None else j.parent for d, j in enumerate(self.joints))

    @property
    def span(self) -> F64:
        """(D,) how far joints move where a revolute one moves by 1 rad [rad or m]."""
        return np.array([SLIDE if joint.slides else 1.0 for joint in self.joints])

    @property
    def gravity_base(self) -> F64:
        """(3,) gravity in the base frame [m/s^2]."""
        R_world_base = Rotation.from_euler("xyz", self.base_rpy).as_matrix()
        return np.asarray(R_world_base.T @ np.array([0.0, 0.0, -G]))


def random_arm(seed: int, n_joints: int) -> Arm:
    """An arm of about a metre with neighbouring axes about square to each other, no DH in sight."""
    rng = np.random.default_rng(seed)
    joints = []
    for d in range(n_joints):
        # A quarter turn to the last axis, give or take; any direction along the segment.
        turn = (np.pi / 2 * rng.choice([-1, 1]) + 0.2 * rng.standard_normal(), 0.3, 0.5)
        rpy = tuple(np.array(turn) + 0.2 * rng.standard_normal(3)) if d else (0.05, -0.03, 0.4)
        joints.append(
            ArmJoint(
                xyz=tuple(rng.uniform([-0.05, -0.05, 0.1], [0.05, 0.05, 0.25])),
                rpy=rpy,
                axis=((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 1.0, 0.0))[int(rng.integers(3))],
                su_xyz=tuple(rng.uniform([-0.08, -0.08, 0.0], [0.08, 0.08, 0.16])),
                su_rpy=tuple(rng.uniform(-3.0, 3.0, 3) * [1.0, 0.5, 1.0]),
                mass=float(4.0 * 0.7**d),
            )
        )
    return Arm(tuple(joints), ((0.1, 0.05, 0.02), (0.3, -1.0, 2.0)), (0.44, 0.26, 0.0))


def truth_urdf(arm: Arm, su_names: Sequence[str], joint_names: Sequence[str]) -> str:
    """The arm as a URDF; the SU on the base comes first."""
    parts = ['<robot name="arm"><link name="base"/>']
    places = [("base", *arm.base_su)]
    for d, (joint, name) in enumerate(zip(arm.joints, joint_names, strict=True)):
        parent = f"link{arm.parent[d]}" if arm.parent[d] >= 0 else "base"
        parts.append(
            f'<link name="link{d}"/>'
            f'<joint name="{name}" type="{"prismatic" if joint.slides else "revolute"}">'
            f'<parent link="{parent}"/><child link="link{d}"/>{_origin(joint.xyz, joint.rpy)}'
            f'<axis xyz="{_text(joint.axis)}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="5"/></joint>'
        )
        places.append((f"link{d}", joint.su_xyz, joint.su_rpy))
    for su, (link, xyz, rpy) in zip(su_names, places, strict=True):
        parts.append(
            f'<link name="{su}"/><joint name="{su}_mount" type="fixed"><parent link="{link}"/>'
            f'<child link="{su}"/>{_origin(xyz, rpy)}</joint>'
        )
    return "".join([*parts, "</robot>"])


def excitation(arm: Arm, n_poses: int, at_once: bool, rng: np.random.Generator) -> JointPath:
    """Structural moves of one joint at a time, then rests in random poses and patterns there."""
    D = arm.n_joints
    path = JointPath([0.0] * D).rest(1.0)
    for joint in range(D):
        away = np.zeros(D)
        away[joint] = 0.8 * arm.span[joint]
        path.move(away, 1.6).rest(0.7).move(np.zeros(D), 1.6).rest(0.7)
    for pose in rng.uniform(-1.4, 1.4, (n_poses, D)) * arm.span:
        path.move(pose, 2.5).rest(1.2)
        if at_once:
            size = dict(zip(range(D), rng.choice([-1, 1], D) * 0.12 * arm.span, strict=True))
            path.swing(dict.fromkeys(range(D), 0.0) | size, seconds=14.0, hertz=1.1).rest(0.8)
        else:
            for joint in range(D):
                size = 0.12 * arm.span[joint] * rng.choice([-1, 1])
                path.swing({joint: size}, seconds=2.2).rest(0.6)
    return path


def record(
    arm: Arm,
    path: JointPath,
    su_names: Sequence[str],
    joint_names: Sequence[str],
    rng: np.random.Generator,
    noise: float = 1e-3 * G,
    bias: float = 5e-3 * G,
    bits: int = 17,
    lag: float = 0.01,
    gaps: Sequence[float] | None = None,
) -> Recording:
    """Drive the arm along a path and record it.

    Args:
        arm: the arm.
        path: what its drives are told.
        su_names: D + 1 names, the SU on the base first.
        joint_names: D names.
        rng: source of noise, biases, jitter and lags.
        noise: standard deviation of a reading [m/s^2].
        bias: biases are drawn within +- this [m/s^2].
        bits: resolution of the encoders [bits per revolution, or per metre].
        lag: clock lags of the SUs are drawn from 0 to this [s].
        gaps: D gaps of the gears behind the encoders [rad]: a drive is ahead of its link by half of
            one to the side that it pushes to, and crosses it while it pushes by little.
    """
    model = mujoco.MjModel.from_xml_string(_mjcf(arm))
    data = mujoco.MjData(model)
    command = path.at(np.arange(0.0, path.time[-1], STEP))
    data.qpos[arm.n_slides :] = command[0]
    start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states, sensors = rollout.rollout(model, data, start[None], command[None])
    # A step returns the state it leads to and the readings of the state it came from.
    time, first = states[0, :-1, 0], 1 + arm.n_slides
    q, readings = states[0, :-1, first : first + arm.n_joints], sensors[0, 1:]
    settled = time > 0.5

    joint_at = np.flatnonzero(settled)[::4]
    step = np.array([1.0 if joint.slides else 2 * np.pi for joint in arm.joints]) / 2**bits
    stamps = _stamps(time[joint_at], 0.0, rng)
    ahead = arm.stiffness * (command[: len(q)] - q)
    drive = q + 0.5 * np.array(gaps or [0.0] * arm.n_joints) * np.tanh(ahead / _CROSSED)
    joints = [
        JointStream(name, stamps, np.round(drive[joint_at, d] / step[d]) * step[d])
        for d, name in enumerate(joint_names)
    ]
    sus = []
    for u, name in enumerate(su_names):
        at = np.flatnonzero(settled)[int(rng.integers(2)) :: 2]
        clean = readings[at, 3 * u : 3 * u + 3]
        felt = clean + rng.uniform(-bias, bias, 3) + noise * rng.standard_normal(clean.shape)
        sus.append(SuStream(name, _stamps(time[at], rng.uniform(0, lag), rng), felt, f"/{name}"))
    return Recording(
        tuple(sorted(joints, key=lambda j: j.name)), tuple(sorted(sus, key=lambda s: s.name)),
        source="MuJoCo",
    )  # fmt: skip


def tracking_errors(arm: Arm, recording: Recording, path: JointPath, names: Sequence[str]) -> F64:
    """(D,) rms distance between what the drives were told and what the encoders say [rad]."""
    del arm
    by_name = {j.name: j for j in recording.joints}
    return np.array(
        [
            np.sqrt(np.mean((by_name[n].position - path.at(by_name[n].time)[:, d]) ** 2))
            for d, n in enumerate(names)
        ]
    )


def two_arms() -> Arm:
    """A waist that lifts and turns, and on it two arms, one with a telescope as its last joint.

    Joints are numbered depth first, as MuJoCo orders them.
    """
    left, right = random_arm(5, 4).joints[1:], random_arm(6, 4).joints[1:]
    lift, turn = random_arm(7, 2).joints
    telescope = replace(left[2], slides=True, axis=(0.0, 0.6, 0.8))
    return replace(
        random_arm(7, 2),
        joints=(
            replace(lift, slides=True, axis=(0.0, 0.0, 1.0), mass=6.0),
            replace(turn, rpy=(0.1, -0.2, 0.3), axis=(0.0, 0.0, 1.0)),
            replace(left[0], xyz=(0.1, 0.2, 0.1)), left[1], telescope,
            replace(right[0], xyz=(-0.05, -0.25, 0.15), parent=1), *right[1:],
        ),
    )  # fmt: skip


def upright(arm: Arm) -> Arm:
    """The same arm with its base level."""
    return replace(arm, base_rpy=(0.0, 0.0, 0.0))


def _stamps(time: F64, lag: float, rng: np.random.Generator) -> F64:
    """Stamps with 0.1 ms of jitter, strictly increasing."""
    jitter = np.clip(1e-4 * rng.standard_normal(time.size), -4e-4, 4e-4)
    return np.asarray(time + lag + jitter)


def _mjcf(arm: Arm) -> str:
    """The arm in MuJoCo's language."""
    body, actuators, sensors = "", [], ['<accelerometer site="su0"/>']
    depth: list[int] = []
    for d, joint in enumerate(arm.joints):
        children = [j for j, parent in zip(arm.joints, arm.parent, strict=True) if parent == d]
        tip = children[0].xyz if children else (0.0, 0.0, 0.12)
        inertia = max(0.05, joint.mass * np.linalg.norm(tip) ** 2)
        stiffness = arm.stiffness
        if joint.slides:
            stiffness, inertia = stiffness * SLIDE_STIFFNESS, inertia + 2 * joint.mass
        damping = 1.6 * np.sqrt(stiffness * inertia)
        depth.append(depth[arm.parent[d]] + 1 if arm.parent[d] >= 0 else 0)
        # Bodies stay open until a joint comes that does not stand on them.
        body += "</body>" * (depth[d - 1] + 1 - depth[d] if d else 0)
        body += (
            f'<body pos="{_text(joint.xyz)}" quat="{_quat(joint.rpy)}">'
            f'<joint name="j{d}" type="{"slide" if joint.slides else "hinge"}"'
            f' axis="{_text(joint.axis)}" armature="0.08" damping="0"'
            f' frictionloss="{arm.friction}"/>'
            f'<geom type="capsule" size="0.04" fromto="0 0 0 {_text(tip)}" mass="{joint.mass}"'
            ' contype="0" conaffinity="0"/>'
            f'<site name="su{d + 1}" pos="{_text(joint.su_xyz)}" quat="{_quat(joint.su_rpy)}"/>'
        )
        actuators.append(
            f'<general joint="j{d}" gainprm="{stiffness}" biastype="affine"'
            f' biasprm="0 {-stiffness} {-damping}"/>'
        )
        sensors.append(f'<accelerometer site="su{d + 1}"/>')
    body += "</body>" * (depth[-1] + 1)
    (xyz, rpy) = arm.base_su
    base = f'<site name="su0" pos="{_text(xyz)}" quat="{_quat(rpy)}"/>'
    if arm.slab is not None:
        rocks = "" if arm.rocks is None else _rocks(arm.slab[0], *arm.rocks)
        base, body = f"<body>{_slides(*arm.slab)}{rocks}{base}", f"{body}</body>"
    return (
        f'<mujoco><option timestep="{STEP}" gravity="{_text(arm.gravity_base)}"'
        ' integrator="Euler"><flag eulerdamp="disable"/></option>'
        f"<worldbody>{base}{body}</worldbody>"
        f"<actuator>{''.join(actuators)}</actuator><sensor>{''.join(sensors)}</sensor></mujoco>"
    )


def _slides(mass: float, hertz: float) -> str:
    """A slab that slides in its plane, on springs with a tenth of the critical damping."""
    stiffness = mass * (2 * np.pi * hertz) ** 2
    damping = 0.2 * np.sqrt(stiffness * mass)
    joints = [
        f'<joint name="slide {axis}" type="slide" axis="{axis}" stiffness="{stiffness}"'
        f' damping="{damping}"/>'
        for axis in ("1 0 0", "0 1 0")
    ]
    geom = f'<geom type="box" size="0.3 0.3 0.05" mass="{mass}" contype="0" conaffinity="0"/>'
    return "".join([*joints, geom])


def _rocks(mass: float, stiffness: float, depth: float) -> str:
    """Two level hinges below a slab, with a thirtieth of the critical damping."""
    damping = 2 / 30 * depth * np.sqrt(stiffness * mass)
    return "".join(
        f'<joint name="rock {axis}" type="hinge" pos="0 0 {-depth}" axis="{axis}"'
        f' stiffness="{stiffness}" damping="{damping}"/>'
        for axis in ("1 0 0", "0 1 0")
    )


def _quat(rpy: Sequence[float]) -> str:
    return _text(np.roll(Rotation.from_euler("xyz", rpy).as_quat(), 1))


def _origin(xyz: Sequence[float], rpy: Sequence[float]) -> str:
    return f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'


def _text(values: Sequence[float] | F64) -> str:
    return " ".join(repr(float(v)) for v in values)
