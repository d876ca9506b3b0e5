"""What a sensor makes of the truth: biases that wander, a bent scale, and digits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import SuStream
from skin2urdf.simulation.defects.records import Defect, Felt


@dataclass(frozen=True)
class WarmUp(Defect):
    """Biases, and scales, that drift while the sensors warm up.

    Attributes:
        size: how far each axis has drifted at the end of the recording, up or down [g].
        constant: time constant of the warming up, as a part of the recording.
        scale: by how much an axis then reads more or less, as a part of what it does.
    """

    size: float = 2e-3
    constant: float = 0.5
    scale: float = 0.0

    def sense(self, felt: Felt, rng: np.random.Generator) -> F64:
        """With the drifts of a body that warms up exponentially."""
        sign = rng.choice([-1.0, 1.0], 3)
        part = (felt.time - felt.time[0]) / (self.constant * (felt.time[-1] - felt.time[0]))
        warm = np.expm1(-part) / np.expm1(-1.0 / self.constant)
        force = felt.force
        if self.scale:
            force = force * (1.0 + self.scale * warm[:, None] * rng.choice([-1.0, 1.0], 3))
        return np.asarray(force + self.size * GRAVITY * warm[:, None] * sign)


@dataclass(frozen=True)
class BiasWalk(Defect):
    """Biases that walk at random.

    Attributes:
        size: rms of what an axis has walked after one minute [g]; it grows like the root of time.
    """

    size: float = 0.5e-3

    def sense(self, felt: Felt, rng: np.random.Generator) -> F64:
        """With a random walk from 0."""
        step = (felt.time[1] - felt.time[0]) / 60.0
        walk = np.cumsum(rng.standard_normal(felt.force.shape), axis=0)
        return np.asarray(felt.force + self.size * GRAVITY * step**0.5 * (walk - walk[0]))


@dataclass(frozen=True)
class Nonlinearity(Defect):
    """Axes whose readings bend.

    Attributes:
        size: departure from the straight line at full scale, as a part of it; up or down.
        full_scale: [g].
    """

    size: float = 5e-3
    full_scale: float = 4.0

    def sense(self, felt: Felt, rng: np.random.Generator) -> F64:
        """With a square in every axis."""
        sign = rng.choice([-1.0, 1.0], 3)
        full = self.full_scale * GRAVITY
        return np.asarray(felt.force + sign * self.size * felt.force**2 / full)


@dataclass(frozen=True)
class CoarseDigits(Defect):
    """Sensors of few bits, as many cells of skins have.

    Attributes:
        size: of a digit [g].
    """

    size: float = 16e-3

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """Each reading, noise included, at the nearest digit."""
        digit = self.size * GRAVITY
        return replace(stream, specific_force=np.round(stream.specific_force / digit) * digit)
