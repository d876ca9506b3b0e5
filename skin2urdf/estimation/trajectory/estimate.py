"""An estimate from features made better by all samples of the logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionPriors, MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.uncertainty import MotionInformation, motion_information
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SPAN = 2.0
"""Length of the spans of time whose errors count as independent [s]: far longer than the low-pass,
and than a pattern's period."""
_FEWEST, _MOST = 20, 200
"""Spans in a log, at least and at most."""


@dataclass(frozen=True, eq=False)
class MotionEstimate:
    """What all samples along the logs say.

    Attributes:
        problem: the logs and what was known before.
        fitted: the fit.
        information: what it is worth.
    """

    problem: MotionProblem
    fitted: Fitted
    information: MotionInformation

    @property
    def state(self) -> State:
        """Placements, gravity's directions, bias and shape."""
        return self.fitted.state.placements


def estimate_along(
    logs: Sequence[Trajectory],
    tree: KinematicTree,
    start: State,
    priors: MotionPriors,
    latency: F64,
    tell: Callable[[float], None] = lambda _: None,
) -> MotionEstimate:
    """Fit all samples of all logs.

    Args:
        logs: trajectories, with columns in the tree's order.
        tree: the structure.
        start: placements to begin with.
        priors: what is known before.
        latency: (U,) lag of each SU's clock to begin with [s].
        tell: told the share of the work that is done.
    """
    problem = MotionProblem(tree, logs, priors)
    U, G = tree.n_sus, len(logs)
    clock = np.zeros((G, U, 2))
    clock[:, :, 0] = latency
    begin = MotionState(
        placements=start,
        gravity=priors.sensors.gravity,
        front=np.zeros(U),
        clock=clock,
        knots=tuple(np.zeros((n, U, 3)) for n in problem.layout.n_knots),
        compliance=np.zeros(problem.layout.n_compliance),
    )
    seconds = max(float(log.time[-1] - log.time[0]) for log in logs)
    spans = int(np.clip(seconds / _SPAN, _FEWEST, _MOST))
    fitted = fit(problem, begin, tell=tell)
    return MotionEstimate(problem, fitted, motion_information(problem, fitted, spans))


def motion_priors(sensors: Priors, *, gravity: float, pole: float) -> MotionPriors:
    """What is commonly known before logs are read.

    Args:
        sensors: of bias, scale and cross-axis.
        gravity: standard deviation of its magnitude [m/s^2].
        pole: time constant of sensors' low-passes [s].
    """
    return MotionPriors(
        sensors=sensors,
        gravity=gravity,
        pole=pole,
        lag=1.0,
        drift=1e-2,
        bias_walk=0.0,
        compliance=np.zeros(0),
    )


def with_sensors(priors: MotionPriors, sensors: Priors) -> MotionPriors:
    """The same with other priors of the sensors."""
    return replace(priors, sensors=sensors)
