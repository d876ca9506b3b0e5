"""Features restricted to each SU's chain and whitened, ready to be compared with a model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.model.prediction import Chains
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.records import Features
from skin2urdf.structure.ordering import Ordering
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.unknown_positions import usable

_RANK_TOLERANCE = 1e-9
"""Relative eigenvalue below which a regressor combination counts as not excited."""


@dataclass(frozen=True, eq=False)
class FeatureBlocks(Record):
    """Whitened features; the residual of a model's blocks Y is ``(W @ Y - target) / noise``.

    Attributes:
        chains: chains of the U SUs, L joints at most, m = 1 + 2 L rows.
        su_joint: (U,) joint each SU sits on.
        q: (P, D) joint positions of the poses, in the tree's joint order [rad or m].
        log: (P,) log each pose comes from.
        W: (P, U, m, m) square root of each block's information.
        target: (P, U, m, 3) whitened measured coefficients [m/s^2].
        noise: (P, U, 3) standard deviation of one sample; infinite where there is no data.
        count: (P, U) number of independent scalar measurements in each block.
        coefficients: (P, U, m, 3) measured coefficients given that only the chain moves the SU.
        variance: (P, U, m) their variances, per unit ``noise**2``; infinite where unexcited.
        encoders: what the encoders get wrong, in the tree's joint order; its errors at rest and
            what it hides are part of ``W``, its white noise is part of ``noise``.
        pull: (P, U, L, m) what an error of an SU's readings during the rests of a joint of its
            chain does to the coefficients, per its mean, given that only the chain moves the SU.
    """

    chains: Chains
    su_joint: Int
    q: F64
    log: Int
    W: F64
    target: F64
    noise: F64
    count: Int
    coefficients: F64
    variance: F64
    encoders: EncoderNoise
    pull: F64

    def reweighted(self, weight: F64) -> FeatureBlocks:
        """These blocks with the information of pose p and SU u multiplied by weight (P, U)."""
        root = np.sqrt(weight)[:, :, None, None]
        return replace(self, W=self.W * root, target=self.target * root)


def rows_of(dof: Int, n_dofs: int) -> Int:
    """(..., 1 + 2 L) rows of f0, s and tau of some DoFs (..., L)."""
    first = np.zeros((*dof.shape[:-1], 1), np.int64)
    return np.concatenate([first, 1 + dof, 1 + n_dofs + dof], axis=-1)


def _solved(info: F64, y: F64) -> F64:
    """(P, U, m, c) coefficients whose product with information (P, U, m, m) is y (P, U, m, c)."""
    size = np.sqrt(np.maximum(np.einsum("puii->pui", info), 0.0))[..., None]
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    unit = info * scale * np.swapaxes(scale, -1, -2)
    ridge = np.where(size[..., 0] > 0, _RANK_TOLERANCE, 1.0)[..., None] * np.eye(info.shape[-1])
    return np.asarray(scale * np.linalg.solve(unit + ridge, scale * y))


def _doubted(info: F64, eta: F64, along: F64, variance: F64) -> tuple[F64, F64]:
    """Information when the coefficients may be off along a vector (Sherman-Morrison update).

    Args:
        info: (P, U, m, m) information, and
        eta: (P, U, m, 3) its product with the coefficients.
        along: (P, U, m) the vector.
        variance: (P, U) of how far they are off along it.
    """
    seen = np.einsum("puij,puj->pui", info, along)
    share = (variance / (1 + variance * np.einsum("pui,pui->pu", along, seen)))[..., None, None]
    return (
        info - share * seen[..., :, None] * seen[..., None, :],
        eta - share * seen[..., :, None] * np.einsum("pui,puia->pua", along, eta)[..., None, :],
    )


def _blurred(
    info: F64, eta: F64, measured: F64, noise: F64, position_sd: F64, pull: F64
) -> tuple[F64, F64]:
    """Information with the coefficients blurred by what is not known of the positions at rest.

    A joint d whose encoder is off by a constant while it rests changes the readings by ``s_d``
    times that. Slopes that were not measured are taken as gravity's.

    Args:
        info: (P, U, m, m) information, and
        eta: (P, U, m, 3) its product with the coefficients.
        measured: (P, U, m, 3) coefficients of f0, s_d, tau_d of the chain.
        noise: (P, U, 3) standard deviation of one sample.
        position_sd: (P, U, n) standard deviation of the chain's positions.
        pull: (P, U, n, m) what such a change does to the coefficients.
    """
    n = position_sd.shape[-1]
    seen = np.einsum("puii->pui", info)[..., 1 : 1 + n] > 0
    largest = (measured[:, :, :1] ** 2).sum(axis=-1)
    slope2 = np.where(seen, (measured[:, :, 1 : 1 + n] ** 2).sum(axis=-1), largest * 2 / 3) / 3
    variance = np.where(np.isfinite(noise), noise, 1.0) ** 2
    ratio = slope2 * position_sd**2 / np.maximum(variance.mean(axis=-1), 1e-300)[..., None]
    for d in range(n):
        info, eta = _doubted(info, eta, pull[:, :, d], ratio[..., d])
    return info, eta


def _leaked(
    info: F64, eta: F64, measured: F64, noise: F64, hidden: F64, omega2: F64
) -> tuple[F64, F64]:
    """Information with tau_d blurred by motions that the encoders round away.

    Joint e moving by h in step with the pattern of d, unseen, changes the reading by
    ``(s_e - omega^2 tau_e) h``, which the regression takes for an effect of d.

    Args:
        info: (P, U, m, m), and
        eta: (P, U, m, 3), as in :func:`_blurred`.
        measured: (P, U, m, 3) coefficients of f0, s_d, tau_d of the chain.
        noise: (P, U, 3) standard deviation of one sample.
        hidden: (P, U, n, n) hidden motion of e per acceleration of d, at [d, e].
        omega2: (P, U, n) squared angular frequency of each DoF's pattern [rad^2/s^2].
    """
    n = hidden.shape[-1]
    s, tau = measured[:, :, 1 : 1 + n], measured[:, :, 1 + n :]
    effect = s[:, :, None] - omega2[..., None, None] * tau[:, :, None]
    variance = np.where(np.isfinite(noise), noise, 1.0) ** 2
    added = (hidden * (effect**2).sum(axis=-1)).sum(axis=-1) / 3
    added /= np.maximum(variance.mean(axis=-1), 1e-300)[..., None]
    tau_d = np.eye(1 + 2 * n)[1 + n :]
    for d in range(n):
        along = np.broadcast_to(tau_d[d], (*added.shape[:2], 1 + 2 * n))
        info, eta = _doubted(info, eta, along, added[..., d])
    return info, eta


def feature_blocks(features: Features, tree: KinematicTree) -> FeatureBlocks:
    """Restrict features to what the tree says can move each SU, and whiten them.

    That a DoF outside its chain does not move an SU is knowledge: the regression is re-solved
    without that DoF's columns, from the stored products alone.
    """
    chains = Chains.of(tree)
    order = Ordering.of(tree, features)
    dof, su = order.dof, order.su
    encoders = features.encoders.of_dofs(dof).with_unknown_positions_at_rest()
    P, U, D = features.n_poses, len(su), features.n_dofs
    m = chains.n_rows
    W = np.zeros((P, U, m, m))
    target = np.zeros((P, U, m, 3))
    coefficients, pull = np.zeros((P, U, m, 3)), np.zeros((P, U, (m - 1) // 2, m))
    variance = np.full((P, U, m), np.inf)
    count = np.zeros((P, U), dtype=np.int64)
    L = chains.joint.shape[1]
    valid = features.valid[:, su] & usable(features, tree)
    noise = np.where(valid[..., None], features.noise[:, su], np.inf)
    products = features.information.times(features.coefficients)
    for length in np.unique(chains.length):
        us = np.flatnonzero(chains.length == length)
        own = chains.joint[us, :length]
        rows = rows_of(dof[own], D)
        to = np.r_[0, 1 : 1 + length, 1 + L : 1 + L + length]
        eta = products[:, su[us, None], rows] * valid[:, us, None, None]
        info = features.information.block(su[us], rows) * valid[:, us, None, None]
        measured = features.coefficients[:, su[us, None], rows]
        # What it does to all coefficients, given that those of other joints are 0.
        everywhere = np.swapaxes(features.encoders.pull[:, dof[own]], -1, -2)
        onto = features.information.of_sus(su[us]).times(everywhere)
        onto = np.take_along_axis(onto, rows[None, :, :, None], axis=2) * valid[:, us, None, None]
        along = np.swapaxes(_solved(info, onto), -1, -2)
        pull[:, us[:, None, None], np.arange(length)[:, None], to] = along
        info, eta = _blurred(info, eta, measured, noise[:, us], encoders.position_sd[:, own], along)
        hidden = encoders.hidden[:, own[:, :, None], own[:, None, :]]
        info, eta = _leaked(info, eta, measured, noise[:, us], hidden, encoders.omega2[:, own])
        scale = np.sqrt(np.maximum(np.einsum("puii->pui", info), 0.0))
        inverse_scale = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        lam, V = np.linalg.eigh(info * inverse_scale[..., :, None] * inverse_scale[..., None, :])
        excited = lam > _RANK_TOLERANCE * max(1, int(length))
        root = np.where(excited, np.sqrt(np.abs(lam)), 0.0)
        inverse_root = np.divide(1.0, root, out=np.zeros_like(root), where=excited)
        Vt = np.swapaxes(V, -1, -2)
        white = root[..., None] * Vt * scale[..., None, :]
        unwhite = inverse_scale[..., :, None] * V * inverse_root[..., None, :]
        z = np.swapaxes(unwhite, -1, -2) @ eta
        W[:, us[:, None, None], to[:, None], to] = white
        target[:, us[:, None], to] = z
        coefficients[:, us[:, None], to] = unwhite @ z
        seen = np.einsum("puij,puj->pui", V**2, 1.0 * ~excited) < 1e-6
        spread = np.einsum("puij,puij->pui", unwhite, unwhite)
        variance[:, us[:, None], to] = np.where(seen & (scale > 0), spread, np.inf)
        count[:, us] = 3 * excited.sum(axis=-1)
    return FeatureBlocks(
        chains=chains,
        su_joint=tree.su_joint,
        q=features.q[:, dof],
        log=features.log,
        W=W,
        target=target,
        noise=noise,
        count=count,
        coefficients=coefficients,
        variance=variance,
        encoders=encoders,
        pull=pull,
    )
