"""From a robot and settings to a recording, and the truth to hold a calibration against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import Recording
from skin2urdf.simulation.defects.flexible import move_flexibly
from skin2urdf.simulation.defects.records import Flexibility, Moved
from skin2urdf.simulation.mechanism import Mechanism, load_mechanism, read_urdf
from skin2urdf.simulation.motion import Reference, plan_moves, plan_reference, plan_series
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.planned import follow_plan
from skin2urdf.simulation.plant import actual_motion
from skin2urdf.simulation.robots import RobotSpec, SkinLayout, Vector3
from skin2urdf.simulation.sensors import Sensor, draw_sensor
from skin2urdf.simulation.settings import SimulationSettings
from skin2urdf.simulation.skins import PlacedSu, place_skin
from skin2urdf.simulation.streams import Draw, draw_for, record_joints, record_sus, shift_clock
from skin2urdf.simulation.trajectory import JointMotion, Phase
from skin2urdf.simulation.truth_urdf import truth_urdf

EPOCH = 1_750_000_000.0
"""When simulated recordings start [s since the Unix epoch]."""

_MOVED = 0.3
"""Share of the work that is done once it is known how everything moves."""


@dataclass(frozen=True, eq=False)
class Truth(Record):
    """What a calibration must find, and must not be told.

    Attributes:
        urdf: the robot and its SUs as a URDF that loads without any other file.
        joint_names: D joint names in the order of ``poses`` and ``motion``.
        poses: (P, D) commanded poses in the order visited [rad or m].
        phases: what the reference does when, on the motion's clock.
        motion: what the joints really do, on the motion's clock.
        start: the motion's clock at time 0 of the recording [s].
        gravity_base: (3,) gravity in the frame of the URDF's root link [m/s^2].
        sus: U SUs and their places, in the order of the recording.
        sensor_matrix: (U, 3, 3) sensitivities I + E.
        bias: (U, 3) offsets [m/s^2].
        lag: (U,) clock lags: stamp minus true time [s].
        gyros: U gyroscopes; none where the SUs have none.
    """

    urdf: str
    joint_names: tuple[str, ...]
    poses: F64
    phases: tuple[Phase, ...]
    motion: JointMotion
    start: float
    gravity_base: F64
    sus: tuple[PlacedSu, ...]
    sensor_matrix: F64
    bias: F64
    lag: F64
    gyros: tuple[Sensor, ...] = ()


@dataclass(frozen=True, eq=False)
class Simulation:
    """A recording and the truth behind it.

    Attributes:
        recording: what a robot would have logged.
        truth: what nobody on a real robot knows.
        moved: what moved how, bending bodies and all.
        joint_order: joint names in the shuffled order of a joint state message.
    """

    recording: Recording
    truth: Truth
    moved: Moved
    joint_order: tuple[str, ...]


def simulate(
    robot: RobotSpec,
    settings: SimulationSettings,
    tell: Callable[[float], None] = lambda _: None,
) -> Simulation:
    """Record a robot that moves its joints while SUs report what they feel.

    Args:
        robot: the robot.
        settings: everything else.
        tell: told the share of the work that is done.

    Returns:
        The recording and its truth; the same for the same arguments.

    Raises:
        UnreadableInputError: the robot's URDF can not be loaded.
        UsageError: the settings do not fit the robot.
    """
    draw = Draw(settings.seed)
    mechanism = load_mechanism(robot, base_rpy(robot, settings), _gravity(settings))
    sus = place_skin(mechanism, _layout(robot, settings), draw("skin"))
    reference = _plan(mechanism, sus, settings.motion or robot.motion, settings, draw("motion"))
    motor = actual_motion(mechanism, reference.motion, settings.plant, draw("plant"))
    flexibility = Flexibility.none(mechanism.n_joints)
    for defect in settings.defects:
        flexibility = defect.loosen(flexibility, mechanism, draw_for(draw, defect))
    tell(0.5 * _MOVED)
    moved = move_flexibly(mechanism, sus, motor, flexibility)
    tell(_MOVED)
    rng = draw("sensors")
    sensors = [draw_sensor(settings.sensor_grade, rng) for _ in sus]
    gyro_grade, rng = settings.gyro_grade, draw("gyroscopes")
    gyros = tuple(draw_sensor(gyro_grade, rng) for _ in sus) if gyro_grade else ()
    lag = draw("lag").uniform(0.0, settings.lag, len(sus))
    joint_streams = record_joints(mechanism, motor, settings, draw, moved.torque)
    for defect in settings.defects:
        joint_streams = defect.publish(joint_streams, draw_for(draw, defect))
    su_streams = record_sus(
        moved.mechanism, moved.motion, moved.sus, sensors, lag, settings, draw, gyros,
        lambda share: tell(_MOVED + (1 - _MOVED) * share),
    )  # fmt: skip
    times = [*(joint.time for joint in joint_streams), *(su.time for su in su_streams)]
    start = min(float(time[0]) for time in times)
    recording = Recording(
        joints=shift_clock(joint_streams, -start),
        sus=shift_clock(su_streams, -start),
        start=EPOCH,
        source=f"simulation of {robot.name}",
    )
    truth = Truth(
        urdf=truth_urdf(read_urdf(robot), mechanism, sus),
        joint_names=mechanism.joint_names,
        poses=reference.poses,
        phases=reference.phases,
        motion=moved.links,
        start=start,
        gravity_base=mechanism.gravity_base,
        sus=sus,
        sensor_matrix=np.array([sensor.matrix for sensor in sensors]),
        bias=np.array([sensor.bias for sensor in sensors]),
        lag=lag,
        gyros=gyros,
    )
    order = draw("joint order").permutation(mechanism.n_joints)
    return Simulation(recording, truth, moved, tuple(mechanism.joint_names[d] for d in order))


def _plan(
    mechanism: Mechanism,
    sus: Sequence[PlacedSu],
    motion: MotionSettings,
    settings: SimulationSettings,
    rng: np.random.Generator,
) -> Reference:
    """What the robot is commanded to do: as planned, or with patterns or without."""
    if settings.plan is not None:
        return follow_plan(mechanism, settings.plan)
    structural = settings.has_structural
    if settings.excite == "none":
        return plan_moves(mechanism, motion, settings.duration, rng, structural)
    if settings.excite == "series":
        return plan_series(mechanism, motion, settings.duration, rng)
    reach = _reach(mechanism, sus)
    return plan_reference(
        mechanism, reach, motion, settings.n_poses, settings.excite, rng, structural
    )


def _gravity(settings: SimulationSettings) -> float:
    """Size of gravity where the robot stands [m/s^2]."""
    gravity = GRAVITY
    for defect in settings.defects:
        gravity = defect.gravity(gravity)
    return gravity


def base_rpy(robot: RobotSpec, settings: SimulationSettings) -> Vector3:
    """Roll, pitch, yaw of the base in the world [rad]."""
    if settings.upright:
        return (0.0, 0.0, 0.0)
    return robot.base_rpy if settings.base_rpy is None else settings.base_rpy


def _layout(robot: RobotSpec, settings: SimulationSettings) -> SkinLayout:
    layout = robot.skin
    if settings.sus_per_segment is not None:
        layout = replace(layout, sus_per_segment=settings.sus_per_segment)
    if settings.sus_on_base is not None:
        layout = replace(layout, sus_on_base=settings.sus_on_base)
    return layout


def _reach(mechanism: Mechanism, sus: Sequence[PlacedSu]) -> F64:
    """(D,) length of the longest stretched chain from each joint to an SU beyond it [m]."""
    reach = np.zeros(mechanism.n_joints)
    slide = np.where(
        mechanism.prismatic & np.isfinite(mechanism.upper), np.abs(mechanism.upper), 0.0
    )
    for su in sus:
        length = float(np.linalg.norm(su.T_joint_su[:3, 3]))
        joint = su.joint
        while joint >= 0:
            length += slide[joint]
            reach[joint] = max(reach[joint], length)
            placement = mechanism.model.jointPlacements[joint + 1]
            length += float(np.linalg.norm(placement.translation))
            joint = int(mechanism.parent[joint])
    return reach
