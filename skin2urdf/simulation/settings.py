"""What can be chosen about a simulated recording: motion, plant, sensors, and their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from types import MappingProxyType
from typing import Literal, TypeVar, get_args

from skin2urdf.errors import UsageError, check_ranges, check_setting
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.simulation.defects.records import Defect
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.sensors import GRADES, GYROS, SensorGrade

Excitation = Literal["one", "all", "none", "series"]
"""Patterns of one DoF after the other, of all at once, ordinary moves without any pattern, or a
Fourier series of each DoF without a rest."""
WITHOUT_PATTERNS: tuple[Excitation, ...] = ("none", "series")
"""Those that go on for a time instead of from pose to pose with a pattern around each."""
_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "n_poses": (1, 10_000),
        "minutes": (1e-3, 24 * 60),
        "seed": (0, inf),
        # Twice what the fastest accelerometers give; an hour of it fits no machine.
        "imu_rate": (0.1, 5e4),
        "joint_rate": (0.1, 5e4),
        # Turns and a fraction of one, in double precision.
        "encoder_bits": (0, 48),
        "linear_resolution": (1e-12, 1.0),
        "torque_noise": (0, inf),
        "jitter": (0, inf),
        "lag": (0, inf),
        "sus_per_segment": (0, 1000),
        "sus_on_base": (0, 1000),
    }
)
"""What numbers may be, by fields of :class:`SimulationSettings`."""
T = TypeVar("T")


@dataclass(frozen=True)
class PlantSettings:
    """How far joints stray from their reference.

    Attributes:
        lag: shortest and longest tracking lag; each joint draws its own [s].
        damping: damping ratio of the second-order servo response.
        sag: largest deflection of a revolute joint under gravity [rad].
        coupling: largest deflection of a revolute joint under inertial torque, its own and
            that of the others' motion [rad].
        linear_scale: metres of deflection of a prismatic joint for each rad of a revolute one.
    """

    lag: tuple[float, float] = (0.010, 0.030)
    damping: float = 0.8
    sag: float = 4e-3
    coupling: float = 3e-3
    linear_scale: float = 0.1

    @property
    def is_exact(self) -> bool:
        """True where joints follow their reference without any error."""
        return max(*self.lag, self.sag, self.coupling) == 0.0


PLANTS: Mapping[str, PlantSettings] = MappingProxyType(
    {
        "none": PlantSettings(lag=(0.0, 0.0), sag=0.0, coupling=0.0),
        "servo": PlantSettings(),
        "soft": PlantSettings(lag=(0.020, 0.040), damping=0.7, sag=15e-3, coupling=10e-3),
    }
)


@dataclass(frozen=True)
class SimulationSettings:
    """Everything that can be chosen about one recording; the robot itself is a `RobotSpec`.

    Attributes:
        n_poses: number P of random poses to rest and excite in; without patterns the time counts.
        excite: "one" DoF after the other (paper eq. 10-13), "all" at once at different
            frequencies, or "none": moves between random poses, as any robot makes them, or
            "series": all DoFs on and on without a rest, each along a Fourier series.
        minutes: how long it moves without patterns [min]; None for 3.
        structural: begin with a move of each DoF alone; None for yes where there are patterns.
        upright: stand the base upright instead of tilting it as the robot's file says.
        base_rpy: roll, pitch, yaw of the base in the world [rad]; None for the robot's own.
        seed: the recording is a function of the robot, these settings, and this number.
        grade: accelerometer grade, by name ("ideal", "mems", "bma150") or in full.
        gyro: gyroscopes of the SUs, by name ("ideal", "mems", "cheap"), as "mems" with noise of so
            many deg/s, or in full; None for SUs without.
        tracking: how joints follow their reference, by name ("none", "servo", "soft") or in full.
        imu_rate: samples per second of each SU [Hz].
        joint_rate: joint state messages per second [Hz].
        encoder_bits: resolution of revolute encoders [bits per revolution]; 0 or None for exact
            ones.
        linear_resolution: resolution of prismatic encoders [m]; without effect where others are
            exact.
        torque_noise: rms noise of the torque that every gear bears, measured on the link's side and
            sent as effort with the positions [N m or N]; None for no efforts.
        jitter: rms noise of the time stamps on regular samples [s].
        lag: clock lag of each SU is drawn uniformly from [0, lag] [s].
        stagger: True gives each SU its own sampling phase; False samples all at the same instants.
        sus_per_segment: SUs on every moving segment; None for the robot's own number.
        sus_on_base: SUs on the reference segment; None for the robot's own number.
        motion: shape of the motion; None for the robot's own.
        defects: what is not ideal beyond all that, in any number and combination.
        plan: a trajectory to follow in place of random poses; poses, patterns and minutes are its
            own then.
    """

    n_poses: int = 12
    excite: Excitation = "one"
    minutes: float | None = None
    structural: bool | None = None
    upright: bool = False
    base_rpy: tuple[float, float, float] | None = None
    seed: int = 0
    grade: str | SensorGrade = "mems"
    gyro: str | float | SensorGrade | None = None
    tracking: str | PlantSettings = "servo"
    imu_rate: float = 500.0
    joint_rate: float = 250.0
    encoder_bits: int | None = 17
    linear_resolution: float = 1e-6
    torque_noise: float | None = None
    jitter: float = 1e-4
    lag: float = 0.0
    stagger: bool = True
    sus_per_segment: int | None = None
    sus_on_base: int | None = None
    motion: MotionSettings | None = None
    defects: tuple[Defect, ...] = ()
    plan: JointTrajectory | None = None

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        choices = get_args(Excitation)
        check_setting("excite", f"must be one of {', '.join(choices)}", self.excite in choices)
        check_setting(
            "minutes",
            f"is for motion without patterns (excite {' or '.join(WITHOUT_PATTERNS)}); with "
            "patterns, poses say how long it is",
            self.minutes is None or self.excite in WITHOUT_PATTERNS,
        )
        check_setting(
            "upright",
            "and a tilt of the base exclude each other",
            not (self.upright and self.base_rpy),
        )

    @property
    def duration(self) -> float:
        """How long it moves where there are no patterns [s]."""
        return 60.0 * (3.0 if self.minutes is None else self.minutes)

    @property
    def has_structural(self) -> bool:
        """Whether every DoF moves alone first."""
        return self.excite not in WITHOUT_PATTERNS if self.structural is None else self.structural

    @property
    def sensor_grade(self) -> SensorGrade:
        """The accelerometer grade in full.

        Raises:
            UsageError: no grade of that name.
        """
        return _named(self.grade, GRADES, "sensor grade")

    @property
    def gyro_grade(self) -> SensorGrade | None:
        """The gyroscopes' grade in full; None for SUs without.

        Raises:
            UsageError: no grade of that name, or noise that is negative.
        """
        if self.gyro is None or isinstance(self.gyro, SensorGrade):
            return self.gyro
        if isinstance(self.gyro, str):
            return _named(self.gyro, GYROS, "grade of gyroscopes")
        if not self.gyro >= 0:
            raise UsageError(f"no gyroscope has noise of {self.gyro} deg/s", "give 0 or more")
        return replace(GYROS["mems"], name=f"{self.gyro:g} deg/s", noise_rms=self.gyro)

    @property
    def plant(self) -> PlantSettings:
        """How joints follow their reference, in full.

        Raises:
            UsageError: no plant of that name.
        """
        return _named(self.tracking, PLANTS, "tracking")


def _named(value: str | T, table: Mapping[str, T], what: str) -> T:
    if not isinstance(value, str):
        return value
    if value not in table:
        raise UsageError(f'no {what} is named "{value}"', f"use one of: {', '.join(table)}")
    return table[value]
