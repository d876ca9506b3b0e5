"""What can be chosen about a simulated recording: motion, plant, sensors, and their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from types import MappingProxyType
from typing import Literal, TypeVar

from skin2urdf.errors import UsageError
from skin2urdf.simulation.sensors import GRADES, SensorGrade

Excitation = Literal["one", "all", "none"]
"""Patterns of one DoF after the other, of all at once, or ordinary moves without any pattern."""
T = TypeVar("T")


@dataclass(frozen=True)
class MotionSettings:
    """Shape and size of the reference motion; the defaults suit an arm of 0.3 to 1.5 m reach.

    Attributes:
        frequency: frequency of the pattern with one DoF at a time [Hz].
        frequency_band: lowest and highest frequency with all DoFs at once [Hz].
        pattern_time: duration of the pattern on one DoF, windows included [s].
        pattern_time_all: duration of the pattern on all DoFs at once [s]; longer where there are so
            many of them (30 and more in a band of 3 Hz) that this does not tell their tones apart.
        ramp: duration of either flank of the pattern's window [s].
        angular_acceleration: bounds of the pattern's peak acceleration 2 pi f A on a revolute
            DoF [rad/s^2]; the paper uses 2 pi.
        tip_acceleration: what the pattern of a revolute DoF should reach at the far end of the
            chain [m/s^2]; sets the acceleration inside its bounds, so that long arms stay inside
            the range of the sensors.
        linear_acceleration: the pattern's peak acceleration on a prismatic DoF [m/s^2].
        rest: time at rest after each move [s].
        angular_speed: fastest a revolute DoF moves between poses [rad/s].
        linear_speed: fastest a prismatic DoF moves between poses [m/s].
        step: shortest and longest structural move of a revolute DoF [rad].
        half_range: poses of a revolute DoF lie within this of the middle of its range (of 0 where
            it has no limits) [rad].
        half_stroke: the same for a prismatic DoF [m].
        ordinary_speed: slowest and fastest peak speed of a move without patterns, drawn for each
            move; the DoF that has farthest to go reaches it where the way is long enough [rad/s].
            A prismatic DoF moves by the linear speed where a revolute one does by the angular.
        ordinary_acceleration: lowest and highest peak acceleration of such a move [rad/s^2].
        ordinary_rest: time at rest after such a move [s].
    """

    frequency: float = 2.0
    frequency_band: tuple[float, float] = (1.0, 4.0)
    pattern_time: float = 2.0
    pattern_time_all: float = 12.0
    ramp: float = 0.4
    angular_acceleration: tuple[float, float] = (2 * pi, 4 * pi)
    tip_acceleration: float = 7.5
    linear_acceleration: float = 3.0
    rest: float = 1.0
    angular_speed: float = 1.5
    linear_speed: float = 0.3
    step: tuple[float, float] = (0.6, 1.0)
    half_range: float = 2.62
    half_stroke: float = 0.3
    ordinary_speed: tuple[float, float] = (0.5, 1.5)
    ordinary_acceleration: tuple[float, float] = (1.0, 4.0)
    ordinary_rest: float = 0.5

    def __post_init__(self) -> None:
        if not 0 < 2 * self.ramp <= min(self.pattern_time, self.pattern_time_all):
            raise UsageError(
                f"the pattern's window has flanks of {self.ramp} s in a pattern of "
                f"{min(self.pattern_time, self.pattern_time_all)} s",
                "make ramp positive and at most half the pattern's time",
            )
        if min(*self.ordinary_speed, *self.ordinary_acceleration) <= 0 or self.ordinary_rest < 0:
            raise UsageError(
                "moves without patterns need a speed and an acceleration",
                "make ordinary_speed and ordinary_acceleration positive",
            )


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
            frequencies, or "none": moves between random poses, as any robot makes them.
        minutes: how long it moves without patterns [min]; None for 3.
        structural: begin with a move of each DoF alone; None for yes where there are patterns.
        upright: stand the base upright instead of tilting it as the robot's file says.
        base_rpy: roll, pitch, yaw of the base in the world [rad]; None for the robot's own.
        seed: the recording is a function of the robot, these settings, and this number.
        grade: accelerometer grade, by name ("ideal", "mems", "bma150") or in full.
        tracking: how joints follow their reference, by name ("none", "servo", "soft") or in full.
        imu_rate: samples per second of each SU [Hz].
        joint_rate: joint state messages per second [Hz].
        encoder_bits: resolution of revolute encoders [bits per revolution]; None for exact ones.
        linear_resolution: resolution of prismatic encoders [m]; without effect where
            ``encoder_bits`` is None.
        jitter: rms noise of the time stamps on regular samples [s].
        lag: clock lag of each SU is drawn uniformly from [0, lag] [s].
        stagger: True gives each SU its own sampling phase; False samples all at the same instants.
        sus_per_segment: SUs on every moving segment; None for the robot's own number.
        sus_on_base: SUs on the reference segment; None for the robot's own number.
        motion: shape of the motion; None for the robot's own.
    """

    n_poses: int = 12
    excite: Excitation = "one"
    minutes: float | None = None
    structural: bool | None = None
    upright: bool = False
    base_rpy: tuple[float, float, float] | None = None
    seed: int = 0
    grade: str | SensorGrade = "mems"
    tracking: str | PlantSettings = "servo"
    imu_rate: float = 500.0
    joint_rate: float = 250.0
    encoder_bits: int | None = 17
    linear_resolution: float = 1e-6
    jitter: float = 1e-4
    lag: float = 0.0
    stagger: bool = True
    sus_per_segment: int | None = None
    sus_on_base: int | None = None
    motion: MotionSettings | None = None

    def __post_init__(self) -> None:
        checks = {
            "n_poses must be at least 1": self.n_poses >= 1,
            "seed must not be negative": self.seed >= 0,
            "imu_rate and joint_rate must be positive": min(self.imu_rate, self.joint_rate) > 0,
            "encoder_bits must be positive": self.encoder_bits is None or self.encoder_bits > 0,
            "linear_resolution must be positive": self.linear_resolution > 0,
            "jitter and lag must not be negative": min(self.jitter, self.lag) >= 0,
            "numbers of SUs must not be negative": min(
                self.sus_per_segment or 0, self.sus_on_base or 0
            )
            >= 0,
            'excite must be "one", "all" or "none"': self.excite in ("one", "all", "none"),
            "minutes must be positive": self.minutes is None or self.minutes > 0,
            'minutes are for excite "none"; patterns go by n_poses': self.minutes is None
            or self.excite == "none",
            "upright and base_rpy exclude each other": not (self.upright and self.base_rpy),
        }
        for message, holds in checks.items():
            if not holds:
                raise UsageError(f"simulation settings: {message}", "change the option named")

    @property
    def duration(self) -> float:
        """How long it moves where there are no patterns [s]."""
        return 60.0 * (3.0 if self.minutes is None else self.minutes)

    @property
    def has_structural(self) -> bool:
        """Whether every DoF moves alone first."""
        return self.excite != "none" if self.structural is None else self.structural

    @property
    def sensor_grade(self) -> SensorGrade:
        """The accelerometer grade in full.

        Raises:
            UsageError: no grade of that name.
        """
        return _named(self.grade, GRADES, "sensor grade")

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
