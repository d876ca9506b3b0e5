"""What the samples around poses tell of the coefficients, kept once for SUs that share samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, frozen


@dataclass(frozen=True, eq=False)
class Information:
    """Information (n, n) on the n coefficients of every pose and SU.

    Around a pose all SUs feel the same motion, so that those that lack the same samples (mostly
    none) have the same regressor products; only the noise that each row meets is their own. As an
    array (P, U, n, n) it would take gigabytes for a hundred DoFs and SUs.

    Attributes:
        products: (K, n, n) regressor products with nuisance regressors projected out.
        which: (P, U) the products of each pose and SU.
        weight: (P, U, n) what they are scaled with: the information of pose p and SU u is
            ``weight[p, u, i] * products[which[p, u], i, j] * weight[p, u, j]``; 0 without data.
    """

    products: F64
    which: Int
    weight: F64

    def __post_init__(self) -> None:
        object.__setattr__(self, "products", frozen(self.products))
        object.__setattr__(self, "which", frozen(self.which, np.int64))
        object.__setattr__(self, "weight", frozen(self.weight))

    @staticmethod
    def of(dense: F64) -> Information:
        """Information given as an array (P, U, n, n)."""
        P, U, n = dense.shape[:3]
        which = np.arange(P * U).reshape(P, U)
        return Information(dense.reshape(P * U, n, n), which, np.ones((P, U, n)))

    @staticmethod
    def joined(parts: Sequence[Information]) -> Information:
        """The poses of all parts, one part after the other."""
        first = np.cumsum([0, *(len(part.products) for part in parts)])
        return Information(
            np.concatenate([part.products for part in parts]),
            np.concatenate([part.which + k for part, k in zip(parts, first, strict=False)]),
            np.concatenate([part.weight for part in parts]),
        )

    def dense(self) -> F64:
        """(P, U, n, n)."""
        whole = self.products[self.which]
        return np.asarray(whole * self.weight[..., :, None] * self.weight[..., None, :])

    def diagonal(self) -> F64:
        """(P, U, n) information on each coefficient, all others known."""
        return np.asarray(np.einsum("kii->ki", self.products)[self.which] * self.weight**2)

    def block(self, su: Int, rows: Int) -> F64:
        """(P, u, m, m) information of SUs (u,) on some coefficients each, their rows (u, m)."""
        which = self.which[:, su, None, None]
        weight = self.weight[:, su[:, None], rows]
        block = self.products[which, rows[:, :, None], rows[:, None, :]]
        return np.asarray(block * weight[..., :, None] * weight[..., None, :])

    def times(self, x: F64) -> F64:
        """(P, U, n, c) product with vectors x (P, U, n, c)."""
        n, c = x.shape[2:]
        weighted = (self.weight[..., None] * x).reshape(-1, n, c)
        out = np.empty_like(weighted)
        order = np.argsort(self.which, axis=None, kind="stable")
        users, first = np.unique(self.which.ravel()[order], return_index=True)
        for k, mine in zip(users, np.split(order, first[1:]), strict=True):
            out[mine] = self.products[k] @ weighted[mine]
        return np.asarray(out.reshape(x.shape) * self.weight[..., None])

    def scaled(self, factor: F64) -> Information:
        """Information on the coefficients divided by factors (n,), or (P, U, n)."""
        return replace(self, weight=self.weight * factor)

    def of_poses(self, chosen: Int) -> Information:
        """That of some poses, by their indices."""
        return replace(self, which=self.which[chosen], weight=self.weight[chosen])
