"""`gain` and `Loop`: a linear feedback, its cost, and what it was made for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels, weight
from .._base.records import SavedRecord, trusted
from .._base.types import ArrayLike, Floats, NDArray
from ..exceptions import InputError, NonFiniteError, SolverError
from ..export.header import believed, evidence, write
from ..identification.changes import source_of
from ..identification.identified import Identified
from ..identification.model import Model, in_states
from ..identification.region import Region
from ..system.system import System
from .certificate import LoopCertificate, judged, more_logs, sentence, unmoved
from .watch import Watch

GainMethod: TypeAlias = Literal["least squares", "guaranteed cost", "widest margin"]


class Loop(SavedRecord):
    """A linear feedback ``u = K x``.

    Made by `gain`; call it with a state for the input.

    Attributes
    ----------
    A : ndarray, shape (n, n)
        The state matrix of the system, or of the centre of the model.
    B : ndarray, shape (n, m)
        Its input matrix.
    K : ndarray, shape (m, n)
        The gain: ``u = K x``.
    S : ndarray, shape (n, n), or None
        ``x'Sx`` is the cost ``sum_k x(k)'Qx(k) + u(k)'Ru(k)`` from ``x(0) = x``; with a guarantee
        a bound of it for all systems of the region. None without weights.
    method : {"least squares", "guaranteed cost", "widest margin"}
        What K minimises.
    parameter : float or None
        With a guarantee the multiplier of the proof; for the widest margin how many times larger
        the region may be at most, 0 where nothing was proved. Else None.
    labels : Labels
        The names of states and inputs.
    dt : float or None
        The time between two steps [s].
    model : Model, FusedModel or None
        The model from data it was made for.
    R : ndarray, shape (m, m), or None
        The weights of the inputs, where the cost is S.
    given : tuple of str
        Inputs that are measured and not chosen: their rows of K and R are 0.
    """

    A: Annotated[Floats, "state state"]
    B: Annotated[Floats, "state input"]
    K: Annotated[Floats, "input state"]
    S: Annotated[Floats, "state state"] | None
    method: GainMethod
    parameter: float | None
    labels: Labels
    dt: float | None = None
    model: Identified | None = None
    R: Annotated[Floats, "input input"] | None = None
    given: tuple[str, ...] = ()

    @property
    def E(self) -> NDArray[np.complex128]:
        """The eigenvalues of ``A + B K``, shape (n,)."""
        return _core.loop_eigenvalues(self.A, self.B, self.K)

    def __call__(self, x: ArrayLike) -> Floats:
        """Return ``u = K x``, shape (m,), for a state x, shape (n,); what is not finite raises."""
        state = validation.measured("x", x, self.labels.states)
        with np.errstate(all="ignore"):
            u = np.asarray(self.K @ state)
        if not np.isfinite(u).all():
            why = validation.broken(state, np.inf, self.labels.states)
            raise NonFiniteError(f"`x` must be finite: {why or 'K x overflows'}")
        return u

    def certificate(self, delta: float | Region = 0.05) -> LoopCertificate:
        """Check whether all systems of a region are stable, with a proof, under ``u = K x``.

        Parameters
        ----------
        delta : float or Region, default 0.05
            The probability that the true system is not in the region of the model; or a region of
            it, which may have been made with other options.

        Returns
        -------
        LoopCertificate
            The verdict with its proof or a counterexample. All that follows, such as
            `LoopCertificate.tube`, holds in the same event.

        Raises
        ------
        InputError, InputTypeError
            If there is no model from data, or it has no region.

        Notes
        -----
        With ``Theta = C + D G W``, ``||G|| <= rho``, all loops ``A0 + D G E`` have one quadratic
        Lyapunov function exactly if ``rho g < 1``, ``g = max_|z|=1 ||E (zI - A0)^-1 D||``. The
        proof is a matrix Q with ``[Q - rho^2 S, 0; 0, I] - F Q F' > 0``, ``F = [A0; E]``, checked
        with all of its rounding (Rump 2006). For regions of several parts the condition is
        sufficient only. The rounding of the least squares themselves is covered by a radius that
        is larger by 1e-8 and more for data that are nearly dependent.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.status, round(proof.margin, 2)
        ('certified', 6.07)
        """
        if self.model is None:
            raise InputError("`certificate` needs a loop for a model from data: gain(model, ...)")
        own = region_of("delta", self.model, delta)
        region = in_states(self.model, own)
        squares = _squares(self.model) if region.noise is None else (None, 0)
        source = source_of(self.model, own)
        return judged(region, self.K, self.labels, self.model, squares, source=source)

    def to_c(
        self,
        path: Any,
        *,
        name: str = "controller",
        proof: LoopCertificate | None = None,
        watch: Watch | None = None,
    ) -> None:
        """Write the feedback as one C99 header.

        Parameters
        ----------
        path : path
            The file, ``controller.h``.
        name : str, default "controller"
            What its names begin with: ``controller s; controller_start(&s);`` and then, once a
            step, ``controller_step(&s, y, u)`` with the states y for the input u.
        proof : LoopCertificate, optional
            Of this gain: its sentence stands in the head. Default: `certificate` at 5 %, where
            there is a model from data.
        watch : Watch, optional
            An alarm, which is written along: ``controller_look(&alarm, y, u)``.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, the proof is of another gain, or the watch of other
            signals.

        Notes
        -----
        Nothing is allocated, nothing is called. A state that no sensor can have read (nan, inf, a
        million times the largest in the data) holds the last input, and the code that is returned
        says so. ``-DCONTROLLER_FLOAT`` makes it single precision: the head says how far from the
        loop of the proof that is at most, without noise, by `LoopCertificate.rounding`.

        Examples
        --------
        >>> import pathlib, tempfile, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "controller.h"
        >>> se.gain(([[1.2]], [[1.0]]), Q=1.0, R=1.0).to_c(path)
        >>> "static inline int controller_step(" in path.read_text()
        True
        """
        if watch is not None:
            validation.instance("watch", watch, Watch)._require(self.labels)
        if proof is None and self.model is not None:
            proof = self.certificate()
        signals = evidence(self.labels, self.dt, self.model, self.labels.states)
        about = {"law": f"u = K y, {self.method}", **signals, **sentence(self.K, proof)}
        m, n = self.K.shape
        seen = None if self.model is None else self.model.largest
        if proof is not None and seen is not None:
            try:
                off = repr(proof.rounding(seen[:n]))[11:-1]
                first = ", ".join(f"{size:.3g}" for size in seen[:n])
                about["single precision"] = f"{off}, for all time from x = ({first})"
            except InputError as error:
                about["single precision"] = f"nothing is proved: {error}"
        tables = {"K": self.K, "most": believed(np.zeros(n) if seen is None else seen[:n])}
        write(path, name, ["gain"], {"N": n, "M": m}, tables, about, watch=watch)

    def matrices(self) -> dict[str, Floats]:
        """Return the matrices for other tools.

        Returns
        -------
        dict
            "A", "B", "K", and "closed", ``A + B K``, shape (n, n).

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.gain(([[1.2]], [[1.0]]), Q=1.0, R=1.0).matrices()["closed"].round(2)
        array([[0.41]])
        """
        return {"A": self.A, "B": self.B, "K": self.K, "closed": self.A + self.B @ self.K}

    def to_control(self) -> Any:
        """Return the closed loop as a ``control.StateSpace`` with the same names.

        Returns
        -------
        control.StateSpace
            From what is added to each input to the states: ``x+ = (A + B K) x + B v``.

        Raises
        ------
        ImportError
            If python-control is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.gain(([[1.2]], [[1.0]]), Q=1.0, R=1.0)
        >>> loop.to_control().dt  # doctest: +SKIP
        True
        """
        closed, of = self.A + self.B @ self.K, self.labels
        return System(closed, self.B, dt=self.dt, states=of.states, inputs=of.inputs).to_control()

    def __repr__(self) -> str:
        radius = np.abs(self.E).max()
        m, n = self.K.shape
        return f"<Loop: n={n} m={m}, {self.method}, spectral radius {radius:.4g}>"

    def _repr_html_(self) -> str:
        across, down, K, below = self.labels.states, self.labels.inputs, self.K, "K below"
        if len(across) > 8:  # of a window: a row for each of its signals
            across, down, K, below = down, across, K.T, "K' below"
        rows = [[name, *(f"{v:.4g}" for v in row)] for name, row in zip(down, K, strict=True)]
        return show.card(self, [("u = K x with", below)], show.grid(["", *across], rows))


def _squares(model: Identified) -> tuple[Floats | None, int]:
    """``S ~ W_n(nu, Sigma)`` of the residuals and nu, where the regressors are no part of it."""
    if not isinstance(model, Model) or model.pilot is not None:
        return None, 0
    given = model.assumptions
    if (given.noise, given.design) != ("gaussian", "independent") or len(model.blocks) > 1:
        return None, 0
    return validation.frozen(model.blocks[0].S.copy()), model.blocks[0].nu


def region_of(name: str, model: Identified, value: object) -> Region:
    """Return a region of the regressors: as given, or that of the model with this probability."""
    if not isinstance(value, Region):
        return model.region(validation.probability(name, value))
    own = model.region(value.delta).centre
    if value.centre.shape != own.shape:
        raise InputError(f"`{name}` must be a region of this model, got one of another size")
    if not np.array_equal(value.centre, own):
        raise InputError(f"`{name}` must be a region of this model, got one of another centre")
    return value


def gain(
    system: System | Identified | Any,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    *,
    guarantee: float | Region | None = None,
    given: Sequence[str] = (),
) -> Loop:
    """Compute a linear feedback ``u = K x``, with the plus sign.

    Parameters
    ----------
    system : System or model
        A System, anything `System.from_any` takes, or a model from data.
    Q : float or array_like, shape (n,) or (n, n), optional
        Weight of the states, >= 0: a number, a diagonal or a matrix. Q and R together, or neither.
        For a model of outputs also of these alone, of shape (n_outputs,) or (n_outputs,
        n_outputs): of the readings now, or of the first filters; a number is that, too.
    R : float or array_like, shape (m,) or (m, m), optional
        Weight of the inputs, > 0; with `given` of all, or of those that are chosen.
    guarantee : float or Region, optional
        For a model, with Q and R: the least cost that is guaranteed for all systems of
        ``model.region(guarantee)``, in place of the least cost of the model. Without Q and R, where
        the default is 0.05: the widest margin in that region.
    given : sequence of str, optional
        Inputs that are measured and not chosen, such as the outdoor temperature: R is of the
        others. What their past does is weighed by K; nothing is assumed of what they will be, but
        that they do not react to the noise.

    Returns
    -------
    Loop
        K with its cost and eigenvalues; `Loop.certificate` says what is certain of it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; or the region is that of a system without weights.
    SolverError
        If there is none: the inputs do not move a mode of A that does not decay, or Q gives no
        weight to one on the unit circle; it is named with its largest states. Or rounding decides.

    Notes
    -----
    Without `guarantee`: ``K = -(R + B'SB)^-1 B'SA`` with ``S = Q + A'S (I + B R^-1 B'S)^-1 A``, the
    least cost of all gains that stabilise, by a structure-preserving doubling and steps of Newton
    (Hewer 1971) in balanced units. ``control.dlqr`` has the other sign, ``u = -K x``.

    With it: ``x'Sx`` bounds the cost of every system in the region from x; S has the least sum of
    ``S_ii / Q_ii``, over states with a weight, of all that a quadratic Lyapunov function and one
    multiplier prove, and by the matrix S-lemma no such function proves less (Petersen and McFarlane
    1994; van Waarde, Camlibel and Mesbahi 2022). The widest margin is that at 9/10 of the largest
    region for which there is a gain.

    Examples
    --------
    >>> import stochens_rs as se
    >>> loop = se.gain(([[1.2]], [[1.0]]), Q=1.0, R=1.0)
    >>> loop.K.round(4), abs(loop.E[0]).round(4)
    (array([[-0.7935]]), np.float64(0.4065))
    """
    model = system if isinstance(system, Identified) else None
    known = System.from_any(system) if model is None else model
    A, B = (np.ascontiguousarray(matrix) for matrix in (known.A, known.B))
    n, m = B.shape
    if (Q is None) != (R is None):
        raise InputError("`Q` and `R` must be given both or neither")
    if model is None and (guarantee is not None or Q is None):
        raise InputError(
            "`guarantee` and a gain without `Q` and `R` need a model from data, which has a region"
        )
    names, region = known.labels, None
    fixed = sorted(set(names.places("given", given, inputs=True)))
    chosen = np.setdiff1d(np.arange(m), fixed)
    if fixed and not len(chosen):
        raise InputError(
            "`given` must leave an input to choose, got "
            f"{'the only one' if m == 1 else 'all of them'}, {show.listed(names.inputs)}"
        )
    if fixed and Q is None:
        raise InputError("`given` needs `Q` and `R`: there is no widest margin with given inputs")
    if fixed and guarantee is not None:
        raise InputError(
            "`guarantee` must be left out with `given`: the certificate of the loop holds for all "
            "systems of the region"
        )
    method: GainMethod = "least squares"
    of_inputs = None
    if model is not None and (guarantee is not None or Q is None):
        region = in_states(
            model, region_of("guarantee", model, 0.05 if guarantee is None else guarantee)
        )
    free = [names.inputs[j] for j in chosen]
    if fixed and isinstance(R, (list, tuple, np.ndarray)) and np.shape(R)[-1:] == (m,):
        R = np.array(R)[(np.ix_(chosen, chosen) if np.ndim(R) == 2 else chosen)]
    try:
        if Q is None or R is None:
            assert region is not None
            K, S, parameter = _core.widest_gain(region.core)
            method = "widest margin"
        else:
            weights = (
                weight("Q", for_outputs(model, Q), n, labels=names.states),
                weight("R", R, len(free), positive=True, labels=free),
            )
            if region is None:
                own = np.ascontiguousarray(B[:, chosen])
                part, S, parameter = _core.feedback_gain(A, own, *weights, names.states)
                K, of_inputs = np.zeros((m, n)), np.zeros((m, m))
                K[chosen], of_inputs[np.ix_(chosen, chosen)] = part, weights[1]
                of_inputs = validation.frozen(of_inputs)
            else:
                K, S, parameter = _core.guaranteed_gain(region.core, *weights, states=names.states)
                method = "guaranteed cost"
    except SolverError as error:
        raise SolverError(_why(str(error), model, region)) from None
    return trusted(
        Loop,
        A=validation.frozen(A),
        B=validation.frozen(B),
        K=validation.frozen(K),
        S=None if S is None else validation.frozen(S),
        method=method,
        parameter=None if method == "least squares" else parameter,
        labels=known.labels,
        dt=known.dt,
        model=model,
        R=of_inputs,
        given=tuple(names.inputs[j] for j in fixed),
    )


def _why(found: str, model: Identified | None, region: Region | None) -> str:
    """Why there is no gain, with what to do: doubts, inputs that act late or not, or few logs."""
    if model is not None and model.doubts:
        return f"{found if region is None else 'no gain was found'}: {model.doubts[0]}"
    if model is None or region is None:
        return found
    window = model.window if isinstance(model, Model) else None
    if window is not None and window.delay:
        return (
            f"no gain was found: inputs act {show.number_of(window.delay, 'step')} late; pass Q and"
            " R, and no `guarantee`: the certificate of that gain holds for all systems of the "
            "region"
        )
    reason = unmoved(model, region.delta)
    if reason is not None:
        return f"{found}: {reason}"
    try:
        widest = _core.widest_gain(region.core)[2]
    except SolverError:
        return found
    if not 0.0 < widest < 1.0:
        return found

    def holds(later: Region) -> bool:
        return _core.widest_gain(in_states(model, later).core)[2] >= 1.0

    more = more_logs(model, region.delta, holds)
    return f"{found}: it is {1.0 / widest:.3g} times as large as can be; {more}"


def for_outputs(model: object, value: ArrayLike) -> ArrayLike:
    """Return a weight of the outputs of a model as one of its states, others as they are."""
    if not isinstance(model, Model) or model.window is None:
        return value
    if np.ndim(value) and validation.read("Q", value).shape[-1] == model.n:
        return value
    return np.pad(weight("Q", value, model.n_outputs), (0, model.n - model.n_outputs))
