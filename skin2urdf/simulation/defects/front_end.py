"""The low-pass between what an accelerometer feels and what it reports."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.simulation.defects.records import Defect, Felt

_FINE = 5e-4
"""Step at which the filter follows what is felt [s]; between steps it takes straight lines."""


@dataclass(frozen=True)
class LowPass(Defect):
    """A sensor's own low-pass.

    Attributes:
        cutoff: where it has fallen to 1/sqrt(2) [Hz].
        order: 1 for one pole, 2 for a Butterworth of second order.
    """

    cutoff: float = 44.0
    order: int = 1

    def __post_init__(self) -> None:
        if self.cutoff <= 0 or self.order not in (1, 2):
            raise UsageError(
                f"no low-pass has a cutoff of {self.cutoff} Hz and order {self.order}",
                "give a positive cutoff and order 1 or 2",
            )

    def response(self, frequency: F64) -> F64:
        """Its transfer function (complex) at frequencies [Hz]."""
        s = 1j * np.asarray(frequency) / self.cutoff
        return np.asarray(1.0 / (1.0 + s) if self.order == 1 else 1.0 / (1.0 + 2**0.5 * s + s * s))

    def sense(self, felt: Felt, rng: np.random.Generator) -> F64:
        """The filtered force, settled in the beginning."""
        from scipy.interpolate import make_interp_spline
        from scipy.signal import cont2discrete, lfilter

        step = felt.time[1] - felt.time[0]
        times = max(1, round(step / _FINE))
        fine = felt.time[0] + step / times * np.arange(times * (len(felt.time) - 1) + 1)
        force = make_interp_spline(felt.time, felt.force, k=5)(fine)
        w = 2 * pi * self.cutoff
        poles = np.array([1.0, w] if self.order == 1 else [1.0, 2**0.5 * w, w * w])
        system = (poles[-1:], poles)
        numerator, denominator, _ = cont2discrete(system, float(step) / times, method="foh")
        start = force[0]
        filtered = start + lfilter(numerator.ravel(), denominator, force - start, axis=0)
        return np.asarray(filtered[::times])
