"""What the samples around poses tell of the coefficients, kept once for SUs that share samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record


@dataclass(frozen=True, eq=False)
class Information(Record):
    """Information (n, n) on the n coefficients of every pose and SU.

    Around a pose all SUs feel the same motion, so that those that lack the same samples (mostly
    none) share a factor G; only the noise that they meet is their own. As an array (P, U, n, n) it
    would take gigabytes for a hundred DoFs and SUs.

    Attributes:
        factor: (K, n, n) factors G.
        which: (P, U) the factor of each pose and SU.
        gain: (P, U, n) what the columns of G count, and
        weight: (P, U, n) what its rows are scaled with: the information of pose p and SU u is
            ``W G diag(gain) G^T W`` with ``W = diag(weight)``; 0 without data.
    """

    factor: F64
    which: Int
    gain: F64
    weight: F64

    @staticmethod
    def of_products(products: F64, which: Int) -> Information:
        """Regressor products (K, n, n), met by noise that is white, and which (P, U) are whose."""
        size = np.sqrt(np.maximum(np.einsum("kii->ki", products), 0.0))
        inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
        lam, V = np.linalg.eigh(products * inverse[:, :, None] * inverse[:, None, :])
        factor = size[:, :, None] * V * np.sqrt(np.maximum(lam, 0.0))[:, None]
        ones = np.ones((*which.shape, products.shape[-1]))
        return Information(factor, which, ones, ones)

    @staticmethod
    def of(dense: F64) -> Information:
        """Information given as an array (P, U, n, n)."""
        P, U, n = dense.shape[:3]
        return Information.of_products(dense.reshape(P * U, n, n), np.arange(P * U).reshape(P, U))

    @staticmethod
    def joined(parts: Sequence[Information]) -> Information:
        """The poses of all parts, one part after the other."""
        first = np.cumsum([0, *(len(part.factor) for part in parts)])
        return Information(
            np.concatenate([part.factor for part in parts]),
            np.concatenate([part.which + k for part, k in zip(parts, first, strict=False)]),
            np.concatenate([part.gain for part in parts]),
            np.concatenate([part.weight for part in parts]),
        )

    def dense(self) -> F64:
        """(P, U, n, n)."""
        every = np.arange(self.which.shape[1])
        rows = np.tile(np.arange(self.weight.shape[-1]), (len(every), 1))
        return self.block(every, rows)

    def diagonal(self) -> F64:
        """(P, U, n) information on each coefficient, all others known."""
        gain = self.gain.reshape(-1, self.gain.shape[-1])
        out = np.empty_like(gain)
        for G, mine in self._users():
            out[mine] = gain[mine] @ (G**2).T
        return np.asarray(out.reshape(self.gain.shape) * self.weight**2)

    def block(self, su: Int, rows: Int) -> F64:
        """(P, u, m, m) information of SUs (u,) on some coefficients each, their rows (u, m)."""
        G = (
            self.factor[self.which[:, su, None], rows]
            * self.weight[:, su[:, None], rows][..., None]
        )
        return np.asarray((G * self.gain[:, su, None]) @ np.swapaxes(G, -1, -2))

    def times(self, x: F64) -> F64:
        """(P, U, n, c) product with vectors x (P, U, n, c)."""
        n, c = x.shape[2:]
        weighted = (self.weight[..., None] * x).reshape(self.which.size, n, c)
        gain = self.gain.reshape(-1, n, 1)
        out = np.empty_like(weighted)
        for G, mine in self._users():
            out[mine] = G @ (gain[mine] * (G.T @ weighted[mine]))
        return np.asarray(out.reshape(x.shape) * self.weight[..., None])

    def scaled(self, factor: F64) -> Information:
        """Information on the coefficients divided by factors (n,), or (P, U, n)."""
        return replace(self, weight=self.weight * factor)

    def of_poses(self, chosen: Int) -> Information:
        """That of some poses, by their indices."""
        return replace(
            self, which=self.which[chosen], gain=self.gain[chosen], weight=self.weight[chosen]
        )

    def of_sus(self, chosen: Int) -> Information:
        """That of some SUs, by their indices."""
        return replace(
            self, which=self.which[:, chosen], gain=self.gain[:, chosen],
            weight=self.weight[:, chosen],
        )  # fmt: skip

    def _users(self) -> Iterator[tuple[F64, Int]]:
        """Each factor that is used, and the flat indices of its poses and SUs."""
        order = np.argsort(self.which, axis=None, kind="stable")
        users, first = np.unique(self.which.ravel()[order], return_index=True)
        for k, mine in zip(users, np.split(order, first[1:]), strict=True):
            yield self.factor[k], mine
