"""Choices of a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skin2urdf.estimation.solve.estimate import EstimationSettings
from skin2urdf.structure.activity import STATIC_THRESHOLD

Method = Literal["default", "paper"]
Motion = Literal["all", "patterns"]


@dataclass(frozen=True)
class CalibrationSettings:
    """Choices of a calibration.

    Attributes:
        method: ``default``, or ``paper`` for the paper's own estimator (Algorithm 2), which stops
            far above the noise and is there for comparison.
        estimation: priors, refinement, robustness.
        motion: ``all`` samples of the logs count, or those of ``patterns`` around poses alone.
        gyro: whether gyroscopes count, where SUs have them.
        effort: whether torques of the joints count, where logs hold them.
        gravity_deviation: standard deviation of gravity's magnitude where the logs were recorded
            [m/s^2]; on Earth it is 9.764 to 9.834. Every length rests on it.
        bandwidth: cutoff [Hz] and order (1 or 2) of the sensors' low-pass, where it is known.
        slowest_pole: time constant of a sensor's low-pass that is slow, but not rare [s]: that of
            20 Hz. 0 where sensors have none.
        static_threshold: change of a static reading that makes an SU active [m/s^2].
        relinearisations: how often, at most, the features are taken again with the estimate's
            prediction of what lies beyond first order.
        without: names or topics of SUs that are left out, or patterns of these with ``*``.
    """

    method: Method = "default"
    estimation: EstimationSettings = field(default_factory=EstimationSettings)
    motion: Motion = "all"
    gyro: bool = True
    effort: bool = True
    gravity_deviation: float = 0.02
    bandwidth: tuple[float, int] | None = None
    slowest_pole: float = 8e-3
    static_threshold: float = STATIC_THRESHOLD
    relinearisations: int = 6
    without: tuple[str, ...] = ()
