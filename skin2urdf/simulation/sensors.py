"""What sensors make of the truth: accelerometers, gyroscopes, encoders, and stamping clocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry.units import GRAVITY

MIN_STAMP_STEP = 1e-6
"""Smallest step between two stamps of a stream [s]; jitter can not turn the order round."""


_DEG = np.pi / 180


@dataclass(frozen=True)
class SensorGrade:
    """How good an accelerometer or a gyroscope is, as in a data sheet.

    Attributes:
        name: name of the grade.
        noise_rms: white noise of every sample and axis [unit].
        bias: the constant offset of each axis is drawn from +-bias [unit].
        scale: the relative scale error of each axis is drawn from +-scale.
        cross: each of the six cross-axis sensitivities is drawn from +-cross.
        full_scale: the reading is clipped to +-full_scale [unit]; None for no limit.
        bits: the reading is rounded to 2**bits steps over +-full_scale; None for no rounding.
        unit: that of the data sheet: g [m/s^2], or a degree per second [rad/s].
    """

    name: str
    noise_rms: float = 0.0
    bias: float = 0.0
    scale: float = 0.0
    cross: float = 0.0
    full_scale: float | None = None
    bits: int | None = None
    unit: float = GRAVITY

    @property
    def step(self) -> float:
        """Size of one digit [m/s^2 or rad/s]; 0 where readings are not rounded."""
        if self.full_scale is None or self.bits is None:
            return 0.0
        return float(2 * self.full_scale * self.unit / 2**self.bits)


GYROS: Mapping[str, SensorGrade] = MappingProxyType(
    {
        "ideal": SensorGrade("ideal", unit=_DEG),
        "mems": SensorGrade("mems", noise_rms=0.1, bias=1.0, full_scale=500.0, bits=16, unit=_DEG),
        "cheap": SensorGrade(
            "cheap",
            noise_rms=0.4,
            bias=5.0,
            scale=0.03,
            cross=0.02,
            full_scale=2000.0,
            bits=16,
            unit=_DEG,
        ),
    }
)
"""Grades by name: perfect; trimmed, as ``mems`` accelerometers are; and untrimmed."""

GRADES: Mapping[str, SensorGrade] = MappingProxyType(
    {
        "ideal": SensorGrade("ideal"),
        "mems": SensorGrade("mems", noise_rms=1e-3, bias=5e-3, full_scale=4.0, bits=16),
        "bma150": SensorGrade(
            "bma150",
            noise_rms=8e-3,
            bias=60e-3,
            scale=0.03,
            cross=0.01,
            full_scale=2.0,
            bits=10,
        ),
    }
)


@dataclass(frozen=True, eq=False)
class Sensor(Record):
    """One accelerometer or gyroscope out of the production of a grade.

    Attributes:
        grade: its grade.
        matrix: (3, 3) sensitivity I + E, 1 where the sensor is perfect.
        bias: (3,) constant offset [m/s^2 or rad/s].
    """

    grade: SensorGrade
    matrix: F64
    bias: F64

    def read(self, true: F64, rng: np.random.Generator) -> F64:
        """Readings quantise(clip((I + E) x + bias + noise)).

        Args:
            true: (N, 3) true specific force or angular velocity x in the SU's frame
                [m/s^2 or rad/s].
            rng: source of the noise.

        Returns:
            (N, 3) readings [m/s^2 or rad/s].
        """
        reading = true @ self.matrix.T + self.bias
        reading += self.grade.noise_rms * self.grade.unit * rng.standard_normal(reading.shape)
        if self.grade.full_scale is None:
            return np.asarray(reading)
        limit = self.grade.full_scale * self.grade.unit
        step = self.grade.step
        if not step:
            return np.clip(reading, -limit, limit)
        # Two's complement has one step less above zero than below.
        return np.asarray(np.round(np.clip(reading, -limit, limit - step) / step) * step)


def draw_sensor(grade: SensorGrade, rng: np.random.Generator) -> Sensor:
    """Draw one sensor of a grade."""
    errors = rng.uniform(-grade.cross, grade.cross, (3, 3))
    np.fill_diagonal(errors, rng.uniform(-grade.scale, grade.scale, 3))
    bias = rng.uniform(-grade.bias, grade.bias, 3) * grade.unit
    return Sensor(grade, np.eye(3) + errors, bias)


def encode(position: F64, resolution: F64) -> F64:
    """Positions as encoders report them.

    Args:
        position: (N, D) true positions [rad or m].
        resolution: (D,) size of one count [rad or m]; 0 for an exact encoder.

    Returns:
        (N, D) positions rounded to whole counts [rad or m].
    """
    exact = resolution == 0
    step = np.where(exact, 1.0, resolution)
    return np.where(exact, position, np.round(position / step) * step)


def stamp(time: F64, jitter: float, lag: float, rng: np.random.Generator) -> F64:
    """Stamps that a clock gives to samples.

    Args:
        time: (N,) increasing true times of the samples [s].
        jitter: rms noise of the stamps [s].
        lag: how much later than the truth the clock stamps [s].
        rng: source of the jitter.

    Returns:
        (N,) strictly increasing stamps [s]. A stamp that jitter puts before its predecessor is
        raised to `MIN_STAMP_STEP` behind it.
    """
    noisy = time + lag + jitter * rng.standard_normal(time.shape)
    ramp = MIN_STAMP_STEP * np.arange(len(time))
    return np.asarray(np.maximum.accumulate(noisy - ramp) + ramp)
