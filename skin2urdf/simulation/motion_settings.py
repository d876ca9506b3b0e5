"""Shape and size of the motion that a robot is made to do."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from skin2urdf.errors import UsageError


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
        series_band: lowest and highest frequency of a Fourier series [Hz].
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
    series_band: tuple[float, float] = (0.05, 0.4)

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
