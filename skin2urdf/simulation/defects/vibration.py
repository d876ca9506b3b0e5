"""Vibration of the structure while the drives turn."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.defects.records import Defect, Felt


@dataclass(frozen=True)
class Vibration(Defect):
    """A structure that hums while joints move, and is still at rest.

    Attributes:
        size: rms in each axis at 1 rad/s, summed over the joints that carry an SU [m/s^2].
        frequency: of the structure [Hz].
        damping: its damping ratio, which sets the width of the band.
    """

    size: float = 0.5
    frequency: float = 40.0
    damping: float = 0.05

    def shake(self, felt: Felt, rng: np.random.Generator) -> F64:
        """White torque noise through a resonance, as loud as the joints are fast."""
        from scipy.signal import cont2discrete, lfilter

        step = felt.time[1] - felt.time[0]
        w = 2 * pi * self.frequency
        # The acceleration of a mass on a spring that is pushed at random.
        system = (np.array([1.0, 0.0, 0.0]), np.array([1.0, 2 * self.damping * w, w * w]))
        numerator, denominator, _ = cont2discrete(system, float(step), method="bilinear")
        push = rng.standard_normal(felt.force.shape)
        hum = np.asarray(lfilter(numerator.ravel(), denominator, push, axis=0))
        hum /= hum.std(axis=0)
        return np.asarray(felt.force + self.size * felt.speed[:, None] * hum)
