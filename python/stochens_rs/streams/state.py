"""The state of a stream, its trace, and its confidence."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import show
from .._base.records import trusted
from .._base.running import interruptible
from .._base.types import Floats, Status
from ..certificates.certificate import Certificate, radius_at
from ..exceptions import InputError
from ..plots.lines import draw_trace
from ..rng import Key
from ..theory.exact import EPS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from numpy.typing import NDArray


@dataclass(frozen=True)
class StreamRun:
    """The result of `Stream.run`.

    Attributes
    ----------
    status : {"converged", "max_steps", "time_limit", "interrupted"}
        How the run ended. "converged": the stopping rule is satisfied. "max_steps", "time_limit":
        this limit was reached first. "interrupted": Ctrl-C.
    steps : int
        Steps of this run.
    seconds : float
        Duration of this run [s].
    rule : str or None
        "certificate", "printed", or None if no tolerance was given.
    certificate : float or None
        The bound on ``||B (v - v*)||`` at the end.
    error : float
        ``||B (v - v*)||`` at the end.
    """

    status: Status
    steps: int
    seconds: float
    rule: str | None
    certificate: float
    error: float

    def _repr_html_(self) -> str:
        return show.record(self)


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Errors of a stream over its steps: the first 16, then 8 between k and 2 k.

    Attributes
    ----------
    steps : ndarray of int64, shape (k,)
        Number of steps taken.
    certificates : ndarray, shape (k,)
        The bound on ``||B (v - v*)||``.
    errors : ndarray, shape (k,)
        ``||B (v - v*)||`` without the rounding of v to doubles.
    step_sizes : ndarray, shape (k,)
        The step size t of each of these steps (1 at the start).
    """

    steps: NDArray[np.int64]
    certificates: Floats
    errors: Floats
    step_sizes: Floats

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the error and the certificate over the steps, both axes logarithmic.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure (``ax.figure``).

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Notes
        -----
        Step 0 and zeros cannot be drawn on logarithmic axes and are left out.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = ([[0.9, 0.2], [0.0, 1.0]], [[1.0], [0.5]])
        >>> stream = se.Stream(system, [1.0, 2.0], [0.0, 0.0], rng=1)
        >>> stream.step(100)
        >>> stream.trace.plot().get_xlabel()
        'step'
        """
        return draw_trace(self.steps, self.errors, self.certificates, ax)

    def _repr_html_(self) -> str:
        return show.card(self, [], show.errors(self.steps, self.errors))

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        last = f"{self.errors[-1]:.3g}" if len(self) else "none"
        end = int(self.steps[-1]) if len(self) else 0
        return f"<Trace: {len(self)} entries up to step {end}, last error {last}>"


_SUM = "the sum of the errors of the means"


def radii_of_means(
    core: _core.DataStream, ranges: Mapping[str, float], sizes: Mapping[str, int], delta: float
) -> Certificate:
    """Return the radii of the running means and of the state (see `DataStream.confidence`)."""
    counts, deviations, spreads, _ = core.statistics()
    apart, rounding = core.evidence()
    uncertain = sum(ranges.get(name, np.inf) > 0.0 for name in ENTITIES)
    radii, methods = [], []
    for k, name in enumerate(ENTITIES):
        given, size = ranges.get(name), sizes.get(name)
        if given is not None and apart[k] > given:
            raise InputError(
                f"`ranges['{name}']` must bound the distance of any two realizations: there "
                f"are two at least {apart[k]:.6g} apart, got {given:.6g}"
            )
        observed = 2.0 * spreads[k] if counts[k] > 1 else np.inf
        diameter = observed if given is None else given
        share = delta / max(uncertain, 1)
        radius = _core.mean_radius(counts[k], deviations[k], diameter, share, size)
        methods.append(_bound(radius, diameter, given, size))
        radii.append(radius + 2.0 * rounding[k])  # rounding of the mean and of the deviation
    x0, _, A = core.estimates()
    r0, rf, rA = radii
    norm = interruptible(lambda: float(np.linalg.norm(A, 2)))
    # r_f + (||FA|| + r_A) r_0 + r_A ||F0||, where inf * 0 counts as 0
    parts = [(norm + rA, r0), (rA, float(np.linalg.norm(x0)))]
    state = rf + sum(a * b if a != 0.0 and b != 0.0 else 0.0 for a, b in parts)
    # the control in doubles, and rounding of norms and sums
    state += core.control()[1] + len(x0) * 4.0 * EPS * state
    if np.isnan(state):
        state = np.inf
    single = [name for name, r in zip(ENTITIES, radii, strict=True) if not np.isfinite(r)]
    reason = "the radius of the state overflows"
    if single:
        reason = f"only one realization of {', '.join(single)}, and `ranges` does not bound it"
    said = [("state", state, "where the control from the exact means leads", _SUM)]
    means = (f"the mean of the law of {name}" for name in ENTITIES)
    said += zip(ENTITIES, radii, means, methods, strict=True)
    return trusted(
        Certificate,
        kind="guaranteed" if len(ranges) == len(ENTITIES) else "estimated",
        delta=delta,
        quantities={
            name: radius_at(radius, mean, delta, method, reason)
            for name, radius, mean, method in said
        },
        covers="all together, at all numbers of realizations at once",
        assumption="realizations of each entity independent, of one law, within its range; a bias "
        "of the realizations is not covered",
    )


def _bound(radius: float, diameter: float, given: float | None, size: int | None) -> str:
    """Say which bound gives the radius."""
    if diameter == np.inf:
        return "none"
    source = "observed range, an estimate" if given is None else "given range"
    if radius >= diameter:
        return source
    where = "epochs of sizes" if size is None else f"tightest at {size}"
    return f"empirical Bernstein for all sizes, {where}; {source}"


Slots: TypeAlias = Literal["random", "round-robin", "gain"]

SLOTS: tuple[Slots, ...] = get_args(Slots)
ENTITIES = ("x0", "xf", "A")


@dataclass(frozen=True)
class Identity:
    """Key, options and shape of a stream."""

    key: Key
    safeguard: bool
    slots: Slots
    n: int
    m: int

    def keys(self) -> list[bytes]:
        """Return the keys of the realizations of x0, xf and A, and of the choice of slots."""
        return [bytes(self.key.child(name)) for name in (*ENTITIES, "slots")]

    def digest(self, *arrays: Floats) -> str:
        """Return the SHA-256 of the key, the options, and the shapes and entries of the arrays."""
        options = (self.safeguard, str(self.slots))
        text = f"{options}{[array.shape for array in arrays]}"
        made = hashlib.sha256(b"stochens stream v3\0" + bytes(self.key) + text.encode() + b"\0")
        for array in arrays:
            made.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return made.hexdigest()


def to_sections(identity: Identity, digest: str, core: _core.Stream) -> dict[str, Any]:
    """Return the state as named arrays."""
    own = {"key": _bytes(bytes(identity.key)), "digest": _bytes(bytes.fromhex(digest))}
    return own | dict(core.to_sections())


def from_sections(sections: dict[str, Any]) -> tuple[Identity, str, _core.Stream]:
    """Check the arrays of `to_sections`, and return its arguments."""
    state = dict(sections)
    own = {name: np.asarray(state.pop(name, ())) for name in ("key", "digest")}
    for name, array in own.items():
        if array.dtype != np.uint8 or array.shape != (32,):
            raise InputError(f"`state` must have 32 bytes in '{name}'")
    core = _core.Stream.from_sections(list(state.items()))
    n, m, safeguard, order = (int(v) for v in state["format"][1:])
    key = Key(own["key"].tobytes())
    identity = Identity(key, bool(safeguard), SLOTS[order], n, m)
    if state["keys"].tobytes() != b"".join(identity.keys()):
        raise InputError("`state` must have the keys that follow from its key")
    arrays = (state["B"].reshape(n, m), state["x0"], state["xf"], state["A"].reshape(n, n))
    digest = identity.digest(*arrays)
    if own["digest"].tobytes().hex() != digest:
        raise InputError("`state` must have the digest of its problem")
    return identity, digest, core


def _bytes(value: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(value, dtype=np.uint8).copy()
