"""Records of a fit of all samples: a log held against a state, and normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record


@dataclass(frozen=True, eq=False)
class Predicted:
    """One log held against a state.

    Attributes:
        residual: (K, U, 3) readings less prediction [m/s^2].
        measured: (K, U) where there is something to compare.
        felt: (P, 6, M) specific force [m/s^2] at the points of all links and its derivative in time
            [m/s^3], in the links' frames, low-passed, at the rate of the samples that are compared.
        rates: (3, K, U, 3) derivatives of predicted readings in time, and in the coordinates of the
            sensors' front ends; None where what is felt tells them.
        turned: the same of gyroscopes; None where the log has none.
    """

    residual: F64
    measured: Bool
    felt: F64
    rates: F64 | None = None
    turned: Turned | None = None


@dataclass(frozen=True, eq=False)
class Turned:
    """What gyroscopes read in one log, held against a state.

    Attributes:
        residual: (K, U, 3) readings less prediction [rad/s]; 0 where nothing is measured.
        measured: (K, U) where there is something to compare.
        slope: (K, U, 3) derivative of the predicted readings in time [rad/s^2], and
        bend: (K, U, 3) that of second order [rad/s^3].
    """

    residual: F64
    measured: Bool
    slope: F64
    bend: F64


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations in arrow form: a joint part, and one part per SU.

    Attributes:
        joint: (J, J), and
        su: (U, n, n), and
        mixed: (U, n, J) information.
        joint_gradient: (J,), and
        su_gradient: (U, n): half the slope of chi-squared, with its sign turned.
    """

    joint: F64
    su: F64
    mixed: F64
    joint_gradient: F64
    su_gradient: F64

    def of_joint(self, which: Int) -> Equations:
        """Those in some of the joint part's coordinates, as if all others were known."""
        return Equations(
            joint=self.joint[np.ix_(which, which)],
            su=self.su,
            mixed=self.mixed[:, :, which],
            joint_gradient=self.joint_gradient[which],
            su_gradient=self.su_gradient,
        )


@dataclass(frozen=True, eq=False)
class Spans:
    """Contributions of S spans of time to the normal equations.

    Attributes:
        joint: (S, J, J), and
        su: (S, U, n, n), and
        mixed: (S, U, n, C) information, in the joint columns that an SU depends on.
        columns: per SU (C,) these columns, padded with -1.
    """

    joint: F64
    su: F64
    mixed: F64
    columns: Int


@dataclass(frozen=True, eq=False)
class Gyros(Record):
    """What was found of the gyroscopes of U SUs.

    Attributes:
        heard: (U,) SUs that have a gyroscope.
        used: (U,) those that count in the fit; none that nothing turns.
        contradict: (U,) those that turn otherwise than their SU, and were left out.
        scale: (U, 3) scale errors [1].
        misalignment: (U, 6) what axis x reads of a turn about y and z, y of x and z, z of x and y,
            per unit [rad]; with it the axes' directions in the accelerometer's frame.
        bias: (G, U, 3) in each log [rad/s].
        delay: (U,) by how much they are later than the accelerometers [s].
        noise: (U,) noise of a low-passed sample while the SU moves [rad/s]; NaN where not used.
        scale_sd: (U, 3) standard deviations, and
        misalignment_sd: (U, 6) and
        bias_sd: (G, U, 3) and
        delay_sd: (U,).
    """

    heard: Bool
    used: Bool
    contradict: Bool
    scale: F64
    misalignment: F64
    bias: F64
    delay: F64
    noise: F64
    scale_sd: F64
    misalignment_sd: F64
    bias_sd: F64
    delay_sd: F64
