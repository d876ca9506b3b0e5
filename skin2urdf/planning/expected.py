"""What a calibration from a recording of a motion will be worth, before anything is recorded.

The motion is sampled as encoders and accelerometers will, with their noise and rounding, put on the
grid and low-passed by the program's own way from a recording to samples. The fit of all samples
starts at the truth, and its information, disturbed by that noise, gives the covariance that a
calibration will state (Cramer-Rao, and what encoders add that all SUs feel). A calibration does not
know how good the sensors are. What it will learn of that, from errors of their size seen through
the noise, is part of what it states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU, State, identifiable
from skin2urdf.estimation.solve.spread import learnt_hidden, narrowed
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.information import MotionInformation
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.uncertainty.observability import (
    Observability,
    Subject,
    aligned_deviations,
    observability_along,
)
from skin2urdf.geometry.earth import ANOMALY
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.sampling import sample_recording
from skin2urdf.signals.trajectory import in_order, trajectory
from skin2urdf.structure.ordering import places_of

_CONFIGURATIONS = 200
"""Random poses over which errors are averaged, as in what a calibration states."""
_ELSEWHERE = 0.02
"""How well the size of gravity is known where nobody tells the place [m/s^2]."""
_ITERATIONS = 2
"""Linearisations of a fit that starts at the truth."""
_SAMPLED, _FITTED = 0.3, 0.9
"""Share of the work that is done once the recording is sampled, and once it is fitted."""
_SLOWEST_POLE = 8e-3
"""Time constant of a sensor's low-pass that is slow, but not rare [s]: that of 20 Hz."""


@dataclass(frozen=True)
class Sensors:
    """The sensors of a recording.

    Attributes:
        name: name of the grade of accelerometers.
        noise: white noise of every sample and axis, standard deviation [m/s^2].
        step: size of one digit of an accelerometer [m/s^2].
        bias: standard deviation of biases over a production [m/s^2].
        scale: of relative scale errors.
        cross: of cross-axis sensitivities.
        rate: readings per second [Hz].
        joint_rate: joint states per second [Hz].
        encoder_step: (revolute, prismatic) size of one count [rad, m].
    """

    name: str
    noise: float
    step: float = 0.0
    bias: float = 0.0
    scale: float = 0.0
    cross: float = 0.0
    rate: float = 500.0
    joint_rate: float = 250.0
    encoder_step: tuple[float, float] = (2 * np.pi / 2**17, 1e-6)


class Grade(Protocol):
    """How good accelerometers of a production are: largest errors, as in a data sheet [unit]."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def noise_rms(self) -> float:
        """White noise of every sample and axis [unit]."""

    @property
    def bias(self) -> float:
        """Largest bias [unit]."""

    @property
    def scale(self) -> float:
        """Largest relative scale error."""

    @property
    def cross(self) -> float:
        """Largest cross-axis sensitivity."""

    @property
    def step(self) -> float:
        """Size of one digit [m/s^2]."""

    @property
    def unit(self) -> float:
        """Size of the unit [m/s^2]."""


def sensors_of(grade: Grade) -> Sensors:
    """Accelerometers of a grade, drawn from a production as its data sheet says."""
    spread = 3**-0.5  # standard deviation of what is drawn evenly from -1 to 1
    return Sensors(
        name=grade.name,
        noise=grade.noise_rms * grade.unit,
        step=grade.step,
        bias=spread * grade.bias * grade.unit,
        scale=spread * grade.scale,
        # Symmetric terms are means of two; what is left of these turns the sensor's frame.
        cross=spread * grade.cross / 2**0.5,
    )


@dataclass(frozen=True, eq=False)
class Expected:
    """The accuracy to expect.

    Attributes:
        sensors: with these sensors.
        position: (U,) of each SU after alignment, over the joints' ranges [m]; NaN where nothing is
            observable, and on the base.
        orientation: (U,) likewise [rad].
        position_elsewhere: (U,) as ``position`` where the size of gravity is not told.
        observability: covariances and verdicts where it is.
    """

    sensors: Sensors
    position: F64
    orientation: F64
    position_elsewhere: F64
    observability: Observability

    @property
    def determined(self) -> Bool:
        """(U,) the SUs that are determined."""
        return np.array([verdict == "determined" for verdict in self.observability.su_verdict])


def expected(
    motions: JointTrajectory | tuple[JointTrajectory, ...],
    model: KinematicModel,
    sensors: Sensors,
    *,
    ups: F64 | None = None,
    seed: int = 0,
    tell: Callable[[float], None] = lambda _: None,
) -> Expected:
    """The accuracy of a calibration from recordings of motions.

    Args:
        motions: what the robot does, one for each log.
        model: the robot, its base upright in the first log.
        sensors: what it carries.
        ups: (G, 3) unit vectors opposite to gravity in the base frame in each log.
        seed: noise is drawn from it.
        tell: told the share of the work that is done.
    """
    motions = motions if isinstance(motions, tuple) else (motions,)
    ups = np.tile([0.0, 0.0, 1.0], (len(motions), 1)) if ups is None else ups
    rng = np.random.default_rng(seed)
    tree, U = model.tree, model.tree.n_sus
    order = tuple(sorted(tree.su_names)), tuple(sorted(tree.joint_names))
    logs, seen = [], []
    for g, (motion, up) in enumerate(zip(motions, ups, strict=True)):
        recording = _recorded(motion, model, sensors, up, rng)
        sampled = sample_recording(recording, order[1], order[0])
        dofs, sus = places_of(tree.joint_names, order[1]), places_of(tree.su_names, order[0])
        logs.append(in_order(trajectory(sampled, g), dofs, sus))
        seen.append(logs[-1].q[logs[-1].kept])
        tell(_SAMPLED * (g + 1) / len(motions))
    state = State(model.T_parent_joint, model.T_joint_su, ups, np.zeros((U, 3)), np.zeros((U, 6)))
    given = Priors()
    front = np.zeros(2), np.full(2, _SLOWEST_POLE**2)
    priors = motion_priors(given, gravity=_ELSEWHERE, front=front)
    along = estimate_along(
        logs, tree, state, priors, np.zeros(U),
        lambda share: tell(_SAMPLED + (_FITTED - _SAMPLED) * share),
        look_further=False, iterations=_ITERATIONS,
    )  # fmt: skip
    tell(_FITTED)
    q = np.concatenate(seen)
    subject = Subject(
        tree=tree,
        state=along.state,
        free=identifiable(tree, len(motions), True),
        q=q,
        priors=given,
        given=given,
    )
    subject = replace(subject, priors=_learnt(subject, along.information, sensors))
    elsewhere = _with(along.information, subject.priors, given, _ELSEWHERE)
    here = _with(along.information, subject.priors, given, ANOMALY)
    low, high = q.min(axis=0), q.max(axis=0)
    far = low + (high - low) * np.random.default_rng(0).random((_CONFIGURATIONS, len(low)))
    found = observability_along(subject, here)
    position, orientation = aligned_deviations(subject, found, far)
    less, _ = aligned_deviations(subject, observability_along(subject, elsewhere), far)
    return Expected(sensors, position, orientation, less, found)


def _learnt(subject: Subject, information: MotionInformation, sensors: Sensors) -> Priors:
    """What a calibration will learn of sensors whose errors are of a size that is typical."""
    covariance = observability_along(subject, information).covariance.su()
    variance = np.einsum("uii->ui", covariance)
    noise, free = variance[:, N_PLACEMENT:], subject.free
    size = np.repeat([sensors.bias, sensors.scale, sensors.cross], 3)
    typical = np.sqrt(size**2 + noise)
    learnt = narrowed(subject.given, typical, noise, free.sus[:, N_PLACEMENT:])
    seen = replace(subject.state, shape=typical[:, 3:])
    return replace(learnt, hidden=learnt_hidden(learnt, seen, variance, free))


def _with(
    information: MotionInformation, sensors: Priors, given: Priors, gravity: float
) -> MotionInformation:
    """The same with more that is known before.

    Args:
        information: of a fit.
        sensors: what is known of sensors, and
        given: what was known in the fit.
        gravity: how well its size is known [m/s^2].
    """
    shared, before = np.array(information.shared), np.array(information.prior_joint)
    more = (GRAVITY / gravity) ** 2 - (GRAVITY / _ELSEWHERE) ** 2
    shared[0, 0] += more
    before[information.shared_joint.shape[1]] += more
    su = np.array(information.equations.su)
    own = np.zeros(N_SU)
    own[N_PLACEMENT:] = sensors.deviations**-2 - given.deviations**-2
    su[:, range(N_SU), range(N_SU)] += own
    U, _, both = information.prior_xz.shape
    return replace(
        information,
        equations=replace(information.equations, su=su),
        shared=shared,
        prior_joint=before,
        prior_xz=np.concatenate([information.prior_xz, np.zeros((U, N_SU, both))], axis=1),
        prior_y=np.concatenate(
            [information.prior_y, np.tile(np.diag(np.sqrt(own)), (U, 1, 1))], axis=1
        ),
    )


def _recorded(
    motion: JointTrajectory,
    model: KinematicModel,
    sensors: Sensors,
    up: F64,
    rng: np.random.Generator,
) -> Recording:
    """What is recorded of a motion.

    Stamps do not scatter: that is smoothed when a log is read.
    """
    tree = model.tree
    columns = places_of(tree.joint_names, motion.joint_names)
    end = motion.duration
    t = np.arange(int(end * sensors.rate) + 1) / sensors.rate
    q, qd, qdd, _ = (x[:, columns] for x in motion.at(t))
    read = specific_forces(model, q, qd, qdd, up * GRAVITY)
    read += sensors.noise * rng.standard_normal(read.shape)
    if sensors.step:
        read = np.round(read / sensors.step) * sensors.step
    joint_time = np.arange(int(end * sensors.joint_rate) + 1) / sensors.joint_rate
    step = np.where(tree.prismatic, sensors.encoder_step[1], sensors.encoder_step[0])
    # Where counts begin is anywhere, so that a joint at rest in 0 is as rounded as any other.
    zero = rng.uniform(0.0, step)
    counted = np.round((motion.at(joint_time)[0][:, columns] + zero) / step) * step - zero
    return Recording(
        joints=tuple(
            JointStream(name, joint_time, counted[:, d]) for d, name in enumerate(tree.joint_names)
        ),
        sus=tuple(SuStream(name, t, read[:, u]) for u, name in enumerate(tree.su_names)),
        source="the plan",
    )
