"""Models from resampled data: how an estimate scatters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.threads import get_num_threads
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError
from ..rng import Key, RngLike, as_key
from .assumptions import Assumptions
from .certifying import Block
from .estimate import Estimate
from .trajectories import Trajectories

if TYPE_CHECKING:
    from .._base.types import Floats


Bootstrap: TypeAlias = Literal["pairs", "residual", "wild", "trajectories"]
METHODS: tuple[Bootstrap, ...] = get_args(Bootstrap)


class Resampled(Estimate, listed=False):
    """Models from resampled data or from the law of the estimate."""

    def bootstrap(
        self, size: int, *, method: Bootstrap = "pairs", rng: RngLike = None
    ) -> SystemEnsemble:
        """Fit models to resampled data.

        Parameters
        ----------
        size : int
            The number of models.
        method : {"pairs", "residual", "wild", "trajectories"}, default "pairs"
            "pairs": N pairs drawn with replacement. "trajectories": whole runs, for data with
            feedback. "residual": the states and inputs are kept, residuals are drawn with
            replacement (centred, times ``sqrt(N / nu)``). "wild": each residual keeps its place
            and gets a random sign and the factor ``1 / sqrt(1 - h)``, for noise that is larger in
            some places (MacKinnon and White 1985).
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
            Source of randomness.

        Returns
        -------
        SystemEnsemble
            Models that scatter about the estimate: ``centre`` is "estimate". A resample that does
            not determine the model is left out; `about` says how many.

        Raises
        ------
        InputError, InputTypeError
            If the data do not determine the model, there are instruments, or an argument cannot be
            used.

        Notes
        -----
        An ensemble shows how the estimate scatters. It is not a region: no statement about the
        distance to the true system follows from it.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).bootstrap(100, rng=1)
        <SystemEnsemble: 100 models, n=1 m=1, about the estimate>
        """
        count = gate.size("size", size)
        kind = gate.choice("method", method, METHODS)
        self._refuse_resampling()
        found, key = self._blocks, as_key(rng).child("bootstrap")
        models = bootstrap_models(found, *self._pairs(), self._Theta, self.data, count, kind, key)
        return self._ensemble(models, f"bootstrap of {kind}", count)

    def draw(self, size: int, *, rng: RngLike = None) -> SystemEnsemble:
        """Draw models from the law that the region is made of.

        Parameters
        ----------
        size : int
            The number of models.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
            Source of randomness.

        Returns
        -------
        SystemEnsemble
            ``H + S^1/2 E^-1/2 G V^-1/2``, E ~ W_n(I, nu), G standard normal; for a known
            covariance ``H + Sigma^1/2 G V^-1/2``. With mean H: ``centre`` is "estimate".

        Raises
        ------
        InputError, InputTypeError
            As `bootstrap`; or single entries were declared as known, the noise is not Gaussian, or
            there are too few pairs.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).draw(100, rng=1)
        <SystemEnsemble: 100 models, n=1 m=1, about the estimate>
        """
        count = gate.size("size", size)
        self._refuse_resampling()
        if self.noise != "gaussian":
            raise InputError(f"draw() needs noise='gaussian', got '{self.noise}': use bootstrap()")
        if len(self._blocks) > 1:
            raise InputError("draw() knows no law with single known entries: use bootstrap()")
        block, key = self._blocks[0], as_key(rng).child("draw")
        models = drawn_models(block, self.assumptions, self._Theta, count, key)
        return self._ensemble(models, "draws of the law of the estimate", count)

    def _refuse_resampling(self) -> None:
        if not self.identifiable:
            raise InputError(f"the data do not determine the model along {'; '.join(self.missing)}")
        if self.assumptions.noisy_states:
            raise InputError(
                "models of noisy states cannot be resampled: the scatter is not theirs"
            )

    def _ensemble(self, models: Floats, about: str, asked: int) -> SystemEnsemble:
        n, m = self.n, self.m
        lost = asked - len(models)
        if not len(models):
            raise InputError("no resample determines the model: there are too few pairs")
        return SystemEnsemble(
            models[:, :, :n],
            models[:, :, n : n + m],
            models[:, :, -1] if self.intercept else None,
            centre="estimate",
            dt=self.dt,
            labels=self.labels if self.labels.given else None,
            about=about + (f", {lost} of {asked} left out: not determined" if lost else ""),
        )


def bootstrap_models(
    blocks: list[Block],
    Z: Floats,
    Y: Floats,
    Theta: Floats,
    data: Trajectories,
    size: int,
    method: Bootstrap,
    key: Key,
) -> Floats:
    """Models of `size` resamples, (size, n, d); fewer where a resample determines none.

    In whitened regressors ``q_t``, with ``sum q q' = I``, and residuals ``e_t`` a model is
    ``Theta + (sum k e q') (sum k q q')^-1 white`` with counts k, or ``Theta + (sum e* q') white``
    with drawn or signed residuals e*. A resample depends on the key and its number alone, so it is
    the same for all blocks of rows.
    """
    memory.need("the models", 3 * 8 * size * Theta.size)
    models, solved = np.repeat(Theta[None], size, axis=0), np.ones(size, dtype=bool)
    residuals = Y - Z @ Theta.T
    runs = None
    if method == "trajectories":
        runs = np.repeat(np.arange(len(data), dtype=np.uint32), data.lengths)
    kind = "pairs" if method == "trajectories" else method
    for block in blocks:
        if not len(block.columns):
            continue
        f = block.fitted
        q, e = Z[:, block.columns] @ f.white.T, residuals[:, block.rows]
        if method == "residual":
            if f.nu < 1:
                raise InputError("method='residual' needs more pairs than unknowns: use 'pairs'")
            e = (e - e.mean(axis=0)) * np.sqrt(f.N / f.nu)
        elif method == "wild":
            left = 1.0 - np.sum(q * q, axis=1)  # 0 where a pair is fitted exactly: so is e
            e = e / np.sqrt(np.where(left > 1e-12, left, np.inf))[:, None]
        place = np.ix_(block.rows, block.columns)
        H = np.ascontiguousarray(Theta[place])
        found = _core.bootstrap(
            np.hstack([q, e]), H, f.white, runs, kind, size, bytes(key), None, get_num_threads()
        )
        solved &= ~np.isnan(found[:, 0])
        models[:, place[0], place[1]] = found.reshape(size, *H.shape)
    return models[solved]


def drawn_models(block: Block, noise: Assumptions, Theta: Floats, size: int, key: Key) -> Floats:
    """``Theta + L E^-1/2 G white`` with the laws of the noise assumed, (size, n, d)."""
    f = block.fitted
    n = len(Theta)
    memory.need("the models", 3 * 8 * size * Theta.size)
    least = n if noise.covariance == "full" else 1
    if noise.known is None and f.nu < least:
        raise InputError(f"draw() needs at least {f.rank + least} pairs, got {f.N}")
    H = np.ascontiguousarray(Theta[:, block.columns])
    if noise.covariance == "full":
        values, vectors = np.linalg.eigh(f.S)
        root = np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0)))
        models = _core.region_draws(H, f.white, root, f.nu, size, bytes(key), get_num_threads())
        return _placed(models, block, Theta)
    gen = key.generator()
    G = gen.standard_normal((size, n, f.rank))
    if noise.known is not None:
        G = np.linalg.cholesky(noise.known) @ G
    elif noise.covariance == "scalar":
        G *= np.sqrt(np.trace(f.S) / gen.chisquare(n * f.nu, (size, 1, 1)))
    else:
        G *= np.sqrt(np.diag(f.S) / gen.chisquare(f.nu, (size, n)))[:, :, None]
    return _placed((H + G @ f.white).reshape(size, -1), block, Theta)


def _placed(models: Floats, block: Block, Theta: Floats) -> Floats:
    """The models with the columns that are known."""
    whole = np.repeat(Theta[None], len(models), axis=0)
    whole[:, :, block.columns] = models.reshape(len(models), len(Theta), len(block.columns))
    return whole
