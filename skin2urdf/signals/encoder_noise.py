"""What the encoders get wrong around every pose, from the features to the covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record


def _nothing() -> F64:
    return np.zeros(())


@dataclass(frozen=True, eq=False)
class EncoderNoise(Record):
    """Errors of the encoders of D joints around P poses; n = 1 + 2 D rows of a feature block.

    What is not given is without error, and takes its shape from :meth:`of_size`.

    Attributes:
        position_sd: (P, D) standard deviation of the positions at rest: an encoder that rests is
            off by a constant up to half a step; infinite for joints that a log lacks [rad or m].
        pull: (P, D, n) what a change of the readings during the rests of joint d does to all
            coefficients, per its mean over the pose's samples: 1 to f0 and 0 to the others where
            the joint only rests.
        hidden: (P, D, D) mean square motion of joint e that its encoder rounds away in step with
            the pattern of joint d, per mean square acceleration of d, at [d, e].
        omega2: (P, D) squared angular frequency of each joint's pattern; 0 where it has none
            [rad^2/s^2].
        tones: (P, D, 2) squared angular frequencies of two tones that stand for each joint's
            pattern [rad^2/s^2].
        products: (P, 2 D, 2 D) products of the joints' positions and accelerations while their
            patterns run, summed over independent samples; 0 for joints without a pattern.
        white: (P, D, D) variance of the noise of joint e's encoder in an independent sample while
            the pattern of joint d runs, at [d, e]; the features' ``noise`` contains it, and SUs
            share it.
    """

    position_sd: F64 = field(default_factory=_nothing)
    pull: F64 = field(default_factory=_nothing)
    hidden: F64 = field(default_factory=_nothing)
    omega2: F64 = field(default_factory=_nothing)
    tones: F64 = field(default_factory=_nothing)
    products: F64 = field(default_factory=_nothing)
    white: F64 = field(default_factory=_nothing)

    @staticmethod
    def joined(poses: Sequence[EncoderNoise]) -> EncoderNoise:
        """That of all poses, from records of one pose each, without their first axis."""
        return EncoderNoise(
            position_sd=np.array([p.position_sd for p in poses]),
            pull=np.array([p.pull for p in poses]),
            hidden=np.array([p.hidden for p in poses]),
            omega2=np.array([p.omega2 for p in poses]),
            tones=np.array([p.tones for p in poses]),
            products=np.array([p.products for p in poses]),
            white=np.array([p.white for p in poses]),
        )

    def of_size(self, n_poses: int, n_dofs: int) -> EncoderNoise:
        """The same with every array in its full shape, for P poses and D joints.

        Raises:
            ValueError: an array is of another size.
        """
        P, D = n_poses, n_dofs
        return EncoderNoise(
            position_sd=np.broadcast_to(self.position_sd, (P, D)),
            pull=np.broadcast_to(
                self.pull if self.pull.ndim else np.eye(1 + 2 * D)[0], (P, D, 1 + 2 * D)
            ),
            hidden=np.broadcast_to(self.hidden, (P, D, D)),
            omega2=np.broadcast_to(self.omega2, (P, D)),
            tones=np.broadcast_to(self.tones, (P, D, 2)),
            products=np.broadcast_to(self.products, (P, 2 * D, 2 * D)),
            white=np.broadcast_to(self.white, (P, D, D)),
        )

    def of_poses(self, chosen: Int) -> EncoderNoise:
        """That of some poses, by their indices."""
        return EncoderNoise(
            position_sd=self.position_sd[chosen],
            pull=self.pull[chosen],
            hidden=self.hidden[chosen],
            omega2=self.omega2[chosen],
            tones=self.tones[chosen],
            products=self.products[chosen],
            white=self.white[chosen],
        )

    def of_dofs(self, chosen: Int) -> EncoderNoise:
        """That of some joints in a given order, by their indices."""
        D = self.position_sd.shape[1]
        both = np.concatenate([chosen, D + chosen])
        rows = np.concatenate([np.zeros(1, np.int64), 1 + both])
        return EncoderNoise(
            position_sd=self.position_sd[:, chosen],
            pull=self.pull[:, chosen[:, None], rows],
            hidden=self.hidden[:, chosen[:, None], chosen],
            omega2=self.omega2[:, chosen],
            tones=self.tones[:, chosen],
            products=self.products[:, both[:, None], both],
            white=self.white[:, chosen[:, None], chosen],
        )

    def rescaled(self, scale: F64) -> EncoderNoise:
        """That of encoders whose positions are divided by factors (D,), of either sign."""
        size, both = np.abs(scale), np.concatenate([scale, scale])
        return replace(
            self,
            position_sd=self.position_sd / size,
            pull=self.pull * np.concatenate([[1.0], both]),
            hidden=self.hidden * (size[:, None] / size) ** 2,
            products=self.products / both / both[:, None],
            white=self.white / size**2,
        )

    def with_unknown_positions_at_rest(self) -> EncoderNoise:
        """The same where positions that a log lacks count as known.

        Of such a log only those SUs are used to which these positions do not matter.
        """
        known = np.isfinite(self.position_sd)
        return replace(self, position_sd=np.where(known, self.position_sd, 0.0))
