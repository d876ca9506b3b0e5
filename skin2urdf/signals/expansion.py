"""The clock of an SU by functions of the joints over the whole log: for motion that goes on and on.

Where all joints move at once by large angles, no stretch of seconds is linear in their motion. Over
a whole log, all the same, gravity in the SU's frame is a sum of products of the joints' sines and
cosines, and what is felt beside is linear in accelerations and in products of speeds, with factors
that are such sums. Whatever the tree is, the first terms of that expansion explain most of the
readings at the right lag, and less at any other. So the readings are regressed on them for every
offset and drift, and what explains them best is refined by Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.commotion import DEPENDENT, WINDOW, slope
from skin2urdf.signals.profiles import valley

_SEARCHED = 300.0
"""Time in the middle of the log [s] in which an offset and a drift are searched: what is found
there is near enough for the whole log to refine it."""
_IN_SEARCH = 40
"""Terms up to which the search takes more: its time grows with them, and the first tell enough."""
_VALUES_PER_TERM = 4.0
"""Independent values of a reading's axis for each term: as many terms as values explain all at any
lag."""
_CERTAIN = 20.0
"""Logarithm of the likelihood by which the best line is above any elsewhere: 10 for each of its
numbers, offset and drift, which chance does once in 20,000."""
_ALIKE = 0.1
"""Correlation of what the terms leave with what a lag makes, root of the mean square in 40 SUs of
nine logs of five kinds of motion: so far may errors that come back with the motion shift an offset
whatever the length of the log."""


_COMES_BACK = 0.01
"""Share of what joints are apart from any moment to another that they are apart after each round of
a motion that comes back: a tenth of its amplitude."""


class Expansion:
    """Terms in the joints' motion, in groups by how much they matter.

    Attributes:
        new: share of the log after which the motion comes back, 1 where it does not: what is read
            again tells nothing that any terms might explain by chance.

    Args:
        q: (n, D) joint positions [rad or m].
        rate: samples per second [Hz].
    """

    def __init__(self, q: F64, rate: float) -> None:
        D = q.shape[1]
        self.new = _until_it_comes_back(q)
        self._qd = slope(q, rate)
        self._qdd = slope(self._qd, rate)
        self._turns = [np.stack([np.sin(x), np.cos(x)], axis=1) for x in (q - q.mean(axis=0)).T]
        self._pairs = list(combinations(range(D), 2))
        # What few readings bear is not worked out: of many joints there are thousands of products.
        self._groups: list[tuple[int, Callable[[], F64]]] = [(1 + 4 * D, self._of_each)]
        if self._pairs:
            self._groups.append((len(self._pairs), self._of_speeds))
            self._groups.append((4 * len(self._pairs), self._of_turns))
        self._known: dict[int, F64] = {}

    def _of_each(self) -> F64:
        """(n, 1 + 4 D) a constant, and what each joint makes."""
        constant = np.ones((len(self._qd), 1))
        return np.concatenate([constant, *self._turns, self._qdd, self._qd**2], axis=1)

    def _of_speeds(self) -> F64:
        """(n, P) products of two joints' speeds."""
        return np.stack([self._qd[:, a] * self._qd[:, b] for a, b in self._pairs], axis=1)

    def _of_turns(self) -> F64:
        """(n, 4 P) products of two joints' sines and cosines."""
        products = [self._turns[a][:, :, None] * self._turns[b][:, None, :] for a, b in self._pairs]
        return np.concatenate([p.reshape(len(self._qd), 4) for p in products], axis=1)

    def _columns(self, group: int) -> F64:
        """(n, K) terms of a group, worked out once."""
        if group not in self._known:
            self._known[group] = self._groups[group][1]()
        return self._known[group]

    def terms(self, values: float, most: float = np.inf) -> F64 | None:
        """(n, K) the first groups, as many as some independent values of a reading bear.

        Args:
            values: how many these are.
            most: terms that there are at most beyond the first group.

        Returns:
            None where they do not bear the first: what a poorer expansion leaves is alike at other
            lags.
        """
        sizes = [size for size, _ in self._groups]
        if sizes[0] > values / _VALUES_PER_TERM:
            return None
        most = min(most, values / _VALUES_PER_TERM)
        taken = max(1, int((np.cumsum(sizes) <= most).sum()))
        columns = np.concatenate([self._columns(group) for group in range(taken)], axis=1)
        size = np.sqrt((columns**2).sum(axis=0))
        return np.asarray(columns[:, size > 0] / size[size > 0])


def _until_it_comes_back(q: F64) -> float:
    """Share of a log of joint positions (n, D) after which all of them come back; 1 if never.

    A motion of few frequencies spans few values whatever its length: any other of the same
    frequencies, as itself at another lag, is a sum of as many terms.
    """
    n = len(q)
    size = np.maximum(q.std(axis=0), 1e-12)
    x = (q - q.mean(axis=0)) / size
    fast = next_fast_len(2 * n, real=True)
    alike = irfft(np.abs(rfft(x, fast, axis=0)) ** 2, fast, axis=0)[:n].sum(axis=1)
    squares = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))])
    lags = np.arange(n // 2 + 1)
    both = squares[n - lags] + squares[n] - squares[lags]
    apart = (both - 2 * alike[lags]) / np.maximum(both, 1e-12)
    # Neighbouring moments are near each other in any motion: it has to go away before, at least
    # half as far as any two moments are apart.
    away = np.flatnonzero(apart > 0.5)
    back = np.flatnonzero(apart < _COMES_BACK)
    back = back[back > away[0]] if len(away) else back[:0]
    return float(back[0]) / n if len(back) else 1.0


def independent(values: F64, valid: Bool) -> float:
    """How many independent values each axis of (n, 3) samples has, as fast as they change."""
    both = valid[1:] & valid[:-1]
    steps = (np.diff(values, axis=0)[both] ** 2).sum()
    energy = ((values[valid] - values[valid].mean(axis=0)) ** 2).sum() if valid.any() else 0.0
    return float(valid.sum() / np.pi * np.sqrt(steps / max(energy, 1e-12)))


def searched(
    readings: F64, valid: Bool, expansion: Expansion, rate: float, reach: float, steep: float
) -> tuple[float, float] | None:
    """Offset [s] and drift at which the terms explain the readings best.

    Args:
        readings: (n, 3) means [m/s^2].
        valid: (n,) where they are whole.
        expansion: terms in the joints' motion.
        rate: samples per second [Hz].
        reach: largest offset [s].
        steep: largest drift.

    Returns:
        None where no line stands out.
    """
    found = best_line(readings, valid, expansion, rate, reach, steep)
    return None if found is None else (found.offset, found.drift)


@dataclass(frozen=True)
class Best:
    """A line of lags that stands out.

    Attributes:
        offset: in the middle of the log [s].
        drift: per time.
        left: share of the readings' energy that the terms leave.
    """

    offset: float
    drift: float
    left: float


def best_line(
    readings: F64, valid: Bool, expansion: Expansion, rate: float, reach: float, steep: float
) -> Best | None:
    """The line of lags at which the terms explain the readings best, as :func:`searched`.

    None where no line stands out.
    """
    length = int(WINDOW * rate)
    count = min(len(readings), int(_SEARCHED * rate)) // length
    if count < 2 or not valid.any():
        return None
    n, start = count * length, (len(readings) - count * length) // 2
    most = int(np.ceil((reach + steep * n / (2 * rate)) * rate)) + 2
    lags = np.arange(-most, most + 1)
    values = expansion.new * independent(readings, valid)
    terms = expansion.terms(values, _IN_SEARCH)
    if terms is None:
        return None
    basis = _basis(terms[start : start + n])
    centred = np.where(valid[:, None], readings - readings[valid].mean(axis=0), 0.0)
    padded = np.pad(centred, ((most, most), (0, 0)))[start:]
    segment = np.stack([padded[w * length : (w + 1) * length + 2 * most] for w in range(count)])
    fast = next_fast_len(segment.shape[1], real=True)
    shape = np.conj(rfft(basis.reshape(count, length, -1), fast, axis=1))
    spectrum = rfft(segment, fast, axis=1)
    products = np.concatenate(
        [irfft(axis[..., None] * shape, fast, axis=1)[:, : len(lags)] for axis in
         np.moveaxis(spectrum, 2, 0)], axis=2,
    )  # fmt: skip
    squares = np.pad(np.cumsum((segment**2).sum(axis=2), axis=1), ((0, 0), (1, 0)))
    energy = squares[:, length:] - squares[:, :-length]
    time = start + (np.arange(count) + 0.5) * length - len(readings) / 2
    inner = np.flatnonzero(np.abs(lags) <= reach * rate)
    rows, steps = np.arange(count)[:, None], max(int(np.ceil(steep * n / 2)), 1)
    best, found, profile = np.inf, (0.0, 0.0), np.full(len(inner), np.inf)
    for k in range(-steps, steps + 1):
        drift = steep * k / steps
        index = np.clip(inner + np.rint(drift * time).astype(int)[:, None], 0, len(lags) - 1)
        explained = (products[rows, index].sum(axis=0) ** 2).sum(axis=1)
        left = 1 - explained / np.maximum(energy[rows, index].sum(axis=0), 1e-12)
        profile = np.minimum(profile, left)
        i = int(left.argmin())
        if left[i] < best:
            best, found = float(left[i]), (float(lags[inner[i]] / rate), drift)
    first, last = valley(profile)
    elsewhere = float(np.delete(profile, np.s_[first : last + 1]).min(initial=np.inf))
    stands_out = 1.5 * values * np.log(elsewhere / max(best, 1e-12)) > _CERTAIN
    return Best(*found, best) if stands_out else None


def refined(
    readings: F64, valid: Bool, expansion: Expansion, rate: float
) -> tuple[F64, F64, int] | None:
    """Change of offset [s] and drift that explains more, their (2,) deviations, and those' freedom.

    Args:
        readings: (n, 3) means [m/s^2], taken at the lag found so far.
        valid: (n,) where they are whole.
        expansion: terms in the joints' motion.
        rate: samples per second [Hz].
    """
    n = len(readings)
    time = ((np.arange(n) - n / 2) / rate)[valid]
    terms = expansion.terms(expansion.new * independent(readings, valid))
    if terms is None:
        return None
    used = terms[valid]
    values, vectors = np.linalg.eigh(used.T @ used)
    kept = values > DEPENDENT * values[-1]
    whole = terms @ (vectors[:, kept] / np.sqrt(values[kept]))
    basis = whole[valid]
    y = readings[valid] - readings[valid].mean(axis=0)
    products = basis.T @ y
    residual = y - basis @ products
    # Of what the terms explain: the slope of readings is that of their noise as well.
    late = slope(whole @ products, rate)[valid]
    J = np.stack([late, late * time[:, None]], axis=2)
    J -= np.einsum("nk,kap->nap", basis, np.einsum("nk,nap->kap", basis, J))
    normal = np.einsum("nap,naq->pq", J, J)
    size = np.sqrt(np.diag(normal))
    if not size.all() or not np.linalg.cond(normal / np.outer(size, size)) < 1 / DEPENDENT:
        return None
    inverse = np.linalg.inv(normal)
    solution = inverse @ np.einsum("nap,na->p", J, residual)
    residual = residual - J @ solution
    starts = np.arange(0, len(time), int(WINDOW * rate))
    scores = np.add.reduceat(np.einsum("nap,na->np", J, residual), starts, axis=0)
    freedom = max(len(scores) - 4, 1)
    count = independent(residual, np.ones(len(residual), dtype=bool))
    loss = count / max(count - basis.shape[1], 1.0) * len(scores) / freedom
    variance = np.diag(inverse @ (scores.T @ scores) @ inverse) * loss
    alike = _ALIKE**2 * float((residual**2).sum()) * np.array([inverse[0, 0], 0.0])
    return -solution, np.sqrt(variance + alike), freedom


def _basis(columns: F64) -> F64:
    """(n, r) orthonormal columns that span the same as (n, K)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > DEPENDENT * values[-1]
    return np.asarray(columns @ (vectors[:, kept] / np.sqrt(values[kept])))
