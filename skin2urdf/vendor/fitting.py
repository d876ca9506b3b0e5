"""All samples of the logs, fitted on a given model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.samples import sample_priors
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU, Free, State
from skin2urdf.estimation.solve.spread import narrowed
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.observability import (
    Observability,
    Subject,
    observability_along,
)
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree
from skin2urdf.vendor.matching import Chassis
from skin2urdf.vendor.placing import Placed
from skin2urdf.vendor.records import TURNED, Correction

LEVEL = 0.02
"""By how much a mount that is meant to be upright is off [rad]: tables and floors are level to a
degree."""
ANY_TILT = 1.0
"""The same where the readings show a turned mount [rad]: as good as nothing is known then."""
REACH = 0.05
"""How far readings may still be shifted in time [s]: clocks are set right to some milliseconds
before, where they can be at all."""
_CONFIGURATIONS = 50


@dataclass(frozen=True, eq=False)
class Bench:
    """What fits on one model share.

    Attributes:
        chassis: the model, D joints.
        logs: trajectories in its order, of U SUs.
        su_names: the SUs.
        settings: choices.
        inertials: (10 D,) of what the joints carry; None where the model does not say.
    """

    chassis: Chassis
    logs: Sequence[Trajectory]
    su_names: tuple[str, ...]
    settings: CalibrationSettings
    inertials: F64 | None = None

    def tree(self, placed: Placed) -> KinematicTree:
        """The joints with the SUs on their segments."""
        return self.chassis.tree(self.su_names, placed.su_joint)

    def blueprint(self, correction: Correction, up: F64) -> Blueprint:
        """What is known of the model before.

        Args:
            correction: what may deviate.
            up: (3,) direction opposite to gravity as it was found at first.
        """
        level = np.array([0.0, 0.0, 1.0])
        upright = float(up @ level) > np.cos(TURNED)
        return Blueprint(
            self.chassis.T_parent_joint,
            correction.deviations(self.chassis),
            level if upright else up,
            LEVEL if upright else ANY_TILT,
            self.inertials,
        )

    def fit(
        self,
        placed: Placed,
        blueprint: Blueprint,
        sensors: Priors,
        start: State | None = None,
        *,
        look_further: bool = False,
        only_known: bool = False,
        last: bool = False,
        tell: Callable[[float], None] = lambda _: None,
    ) -> MotionEstimate:
        """Fit all samples.

        Args:
            placed: where the SUs sit.
            blueprint: what is known of the model.
            sensors: what is known of the sensors.
            start: placements to begin with; those that were found at first by default.
            look_further: try what else may be in the readings;
            only_known: of that only joints that yield under the loads that the model knows.
            last: whether lengths count by tenths of a millimetre, and not only what is left.
            tell: told the share of the work that is done.
        """
        known = sample_priors(self.settings, sensors)
        priors = replace(known, blueprint=blueprint, lag=REACH)
        begin = start or placed.state(blueprint.T_parent_joint)
        return estimate_along(
            self.logs, self.tree(placed), begin, priors, placed.lags, tell,
            look_further=look_further, only_known=only_known, lengths=last,
        )  # fmt: skip

    def judged(self, along: MotionEstimate, sensors: Priors) -> Observability:
        """What a fit determines.

        Args:
            along: the fit.
            sensors: what was known of the sensors before any was seen.
        """
        problem = along.problem
        free = Free(
            joints=problem.free_joint[problem.layout.joints].reshape(-1, 4),
            logs=problem.free_joint[problem.layout.logs].reshape(-1, 2),
            sus=problem.free_su[:, :N_SU],
        )
        q = np.concatenate([log.q[log.kept] for log in self.logs])
        some = np.linspace(0, len(q) - 1, _CONFIGURATIONS).astype(int)
        subject = Subject(problem.tree, along.state, free, q[some], problem.priors.sensors, sensors)
        return observability_along(subject, along.information)

    def learnt(self, along: MotionEstimate, sensors: Priors) -> Priors:
        """Priors of the sensors narrowed to what they all show."""
        if not self.settings.estimation.intrinsics:
            return sensors
        variance = np.einsum("uii->ui", self.judged(along, sensors).covariance.su())
        error = np.concatenate([along.state.bias, along.state.shape], axis=1)
        estimated = along.problem.free_su[:, N_PLACEMENT:N_SU]
        return narrowed(sensors, error, variance[:, N_PLACEMENT:N_SU], estimated)
