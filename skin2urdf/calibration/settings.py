"""Choices of a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skin2urdf.estimation.solve.estimate import EstimationSettings
from skin2urdf.structure.activity import STATIC_THRESHOLD

Method = Literal["default", "paper"]


@dataclass(frozen=True)
class CalibrationSettings:
    """Choices of a calibration.

    Attributes:
        method: ``default``, or ``paper`` for the paper's own estimator (Algorithm 2), which stops
            far above the noise and is there for comparison.
        estimation: priors, refinement, robustness.
        static_threshold: change of a static reading that makes an SU active [m/s^2].
        relinearisations: how often, at most, the features are taken again with the estimate's
            prediction of what lies beyond first order.
    """

    method: Method = "default"
    estimation: EstimationSettings = field(default_factory=EstimationSettings)
    static_threshold: float = STATIC_THRESHOLD
    relinearisations: int = 6
