"""Features: what a log says about every SU in every pose, and nothing of the log's length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record, frozen
from skin2urdf.faults import Fault
from skin2urdf.notes import Noted
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.information import Information


@dataclass(frozen=True, eq=False)
class StaticMoves(Record):
    """Rests before and after one DoF moved, by and large (paper II-B.1, the static effect).

    Attributes:
        dof: (S,) index of the DoF that moved.
        distance: (S,) how far it moved [rad or m].
        change: (S, U, 3) change of each SU's static reading [m/s^2]; NaN where it has none.
        doubt: (S,) what the small motions of the other joints can have changed [m/s^2].
        moved: (D,) False for DoFs that kept still in all logs; empty where that is not known.
    """

    dof: Int
    distance: F64
    change: F64
    doubt: F64 = field(default_factory=lambda: np.zeros(()))
    moved: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "doubt", frozen(np.broadcast_to(self.doubt, self.distance.shape)))


@dataclass(frozen=True, eq=False)
class Turns(Record):
    """How joints turn SUs, as gyroscopes tell.

    Attributes:
        length: (U, D) length of the axis that an SU turns about per velocity of a DoF, 1 for a
            revolute joint that carries it and 0 for any other; NaN where it is not known.
        deviation: (U, D) its standard deviation.
    """

    length: F64
    deviation: F64


@dataclass(frozen=True, eq=False)
class Features(Record):
    """Regression coefficients of the readings around each pose on the motion of all DoFs.

    Around pose p the reading of SU u is, to first order (design: what an accelerometer measures)::

        f(t) = f0 + sum_d [ s_d dq_d(t) + tau_d qdd_d(t) ]

    Rows of the regression, n = 1 + 2 D: ``f0``, then ``s_1 .. s_D``, then ``tau_1 .. tau_D``.
    Coefficients, information and noise are sufficient statistics: the cost of a model is a
    quadratic form in them.

    Attributes:
        su_names: U SU names.
        dof_names: D DoF (joint) names.
        q: (P, D) reference joint positions of each pose [rad or m].
        log: (P,) index of the log each pose comes from.
        coefficients: (P, U, n, 3) least-squares coefficients in the SU's frame
            [m/s^2, m/s^2/rad, m/rad; per metre for prismatic DoFs].
        information: (n, n) for each of P poses and U SUs: regressor products with nuisance
            regressors projected out, as far as the noise's spectrum lets them count; the
            coefficients' covariance per axis is ``noise**2 * pinv(information)``.
        noise: (P, U, 3) standard deviation of one independent sample per axis [m/s^2];
            infinite where an SU has no samples around a pose.
        encoders: what the encoders get wrong around each pose; nothing where not given.
        span: (P, 2) begin of the first and end of the last interval around each pose, on the clock
            of its log [s].
        left: (P,) True for poses that the robot leaves and comes back to, as with a pattern; True
            for all where not given.
        latency: (U,) time by which each SU's stamps lag the joints' [s].
        latency_sd: (U,) its standard deviation [s]; infinite where nothing moved the SU.
        moves: static evidence from larger single-DoF moves.
        notes: what was found and mended; what the reader says is in words.
        faults: what is wrong with the streams.
        turns: which joints turn which SUs; None where no SU has a gyroscope.
    """

    su_names: tuple[str, ...]
    dof_names: tuple[str, ...]
    q: F64
    log: Int
    coefficients: F64
    information: Information
    noise: F64
    latency: F64
    latency_sd: F64
    moves: StaticMoves
    encoders: EncoderNoise = field(default_factory=EncoderNoise)
    span: F64 = field(default_factory=lambda: np.zeros(()))
    left: Bool = field(default_factory=lambda: np.ones((), dtype=bool))
    notes: tuple[Noted, ...] = field(default=())
    faults: tuple[Fault, ...] = field(default=())
    turns: Turns | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        P, D = self.q.shape
        object.__setattr__(self, "encoders", self.encoders.of_size(P, D))
        object.__setattr__(self, "span", frozen(np.broadcast_to(self.span, (P, 2))))
        object.__setattr__(self, "left", frozen(np.broadcast_to(self.left, (P,)), np.bool_))

    def of_poses(self, chosen: Int) -> Features:
        """The features of some poses of one log, as of a first one."""
        return replace(
            self,
            q=self.q[chosen],
            log=np.zeros(len(chosen), dtype=np.int64),
            coefficients=self.coefficients[chosen],
            information=self.information.of_poses(chosen),
            noise=self.noise[chosen],
            encoders=self.encoders.of_poses(chosen),
            span=self.span[chosen],
            left=self.left[chosen],
        )

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return int(self.q.shape[0])

    @property
    def n_dofs(self) -> int:
        """Number of DoFs D."""
        return len(self.dof_names)

    @property
    def n_sus(self) -> int:
        """Number of SUs U."""
        return len(self.su_names)

    @property
    def valid(self) -> Bool:
        """(P, U) True where an SU has samples around a pose."""
        return np.asarray(np.isfinite(self.noise).all(axis=-1))

    @property
    def f0(self) -> F64:
        """(P, U, 3) static gravity readings (paper eq. 15, 16) [m/s^2]."""
        return self.coefficients[:, :, 0]

    @property
    def s(self) -> F64:
        """(P, U, D, 3) change of the reading with each DoF's position [m/s^2/rad]."""
        return self.coefficients[:, :, 1 : 1 + self.n_dofs]

    @property
    def tau(self) -> F64:
        """(P, U, D, 3) reading per acceleration of each DoF (paper eq. 1) [m/rad]."""
        return self.coefficients[:, :, 1 + self.n_dofs :]


@dataclass(frozen=True)
class EncoderError:
    """What one encoder reports wrongly.

    Attributes:
        kind: ``offset``, added to what it reports from a time on; ``scale``, reported per true
            position in all logs; ``sign``, the sense of motion from a time on.
        dof: name of the DoF.
        size: the offset [rad or m], or the scale [1]; -1 for a sign.
        log: index of the log in which an offset or a sign holds.
        begin: time from which an offset or a sign holds, on the clock of its log [s]; -inf for the
            whole log. Positions go on smoothly where a sign changes inside of a log.
        deviation: standard deviation of ``size``; infinite where the readings do not show it.
        spread: time before and after ``begin`` within which an offset arises [s]: what the encoder
            reports there is neither the one nor the other. 0 where the sample is known.
    """

    kind: Literal["offset", "scale", "sign"]
    dof: str
    size: float
    log: int = 0
    begin: float = -np.inf
    deviation: float = np.inf
    spread: float = 0.0


class Clock:
    """A clock that runs differently from the joints', or from those of most joints.

    A sample stamped ``t`` was taken at the joints' time ``t'`` with
    ``t - t' = latency + drift (t' - middle)``.
    """

    latency: float
    drift: float
    middle: float

    def undone(self, time: F64) -> F64:
        """(M,) times on the joints' clock [s] of times on this one."""
        return self.middle + (time - self.latency - self.middle) / (1.0 + self.drift)

    def stamped(self, time: F64) -> F64:
        """(M,) times on this clock [s] of times on the joints'."""
        return self.middle + self.latency + (1.0 + self.drift) * (time - self.middle)


@dataclass(frozen=True)
class SuClock(Clock):
    """How an SU's clock runs against the joints' in one log.

    Attributes:
        su: name of the SU.
        latency: by how much its stamps are late in the middle of the log [s].
        latency_sd: standard deviation of it [s].
        drift: by how much its clock is too fast [s/s].
        drift_sd: standard deviation of it [s/s].
        middle: the middle of the log, on the joints' clock [s].
        shared: True where the SU shows nothing of it itself, and has what all others share.
    """

    su: str
    latency: float
    latency_sd: float
    drift: float
    drift_sd: float
    middle: float
    shared: bool = False


@dataclass(frozen=True)
class JointClock(Clock):
    """How the clock of a publisher of joint states runs against that of most joints in one log.

    Attributes:
        joints: names of the joints that it publishes.
        latency: by how much its stamps are late in the middle of the log [s].
        latency_sd: standard deviation of it [s].
        drift: by how much its clock is too fast [s/s].
        drift_sd: standard deviation of it [s/s].
        middle: the middle of the log, on the clock of most joints [s].
    """

    joints: tuple[str, ...]
    latency: float
    latency_sd: float
    drift: float
    drift_sd: float
    middle: float
