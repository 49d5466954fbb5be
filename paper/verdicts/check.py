"""The paper's statements checked one by one.

`claims` makes a table with one row for every definition, lemma, algorithm, figure and remark: what
the paper says, whether that holds, the corrected statement, and the evidence. The verdicts are
fixed (``statements.ini``); every call computes the evidence anew and says whether it supports them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from stochens_rs.rng import as_key

from ..common import Floats, PathLike, Progress, RngLike, progress_bar
from ..repeating import Where
from . import algorithm_1 as streams
from . import definitions, tails
from . import lemmas_on_reachability as reachability
from . import lemmas_on_sampling as sampling
from . import lemmas_on_tails as tail_bounds
from . import lemmas_on_weights as weights
from .comparison import Comparison, compare
from .printed_figures import section_5
from .records import Claim, Claims


def claims(
    rng: RngLike = 1,
    *,
    quick: bool = False,
    progress: Progress = None,
    executor: Any = None,
    path: PathLike | None = None,
) -> Claims:
    """Check the statements of the paper.

    Parameters
    ----------
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 1
        Source of randomness for the Monte Carlo part; the exact part has none.
    quick : bool, default False
        Fewer runs: a second or two instead of ten.
    progress : None, bool or callable, optional
        True: a bar on a terminal or in a notebook. A callable is called as
        ``progress(done, total)`` after each statement.
    executor : optional
        Where simulations run, as in :meth:`stochens_rs.Study.run`; the results are the same bits
        with any.
    path : path, optional
        A folder, made if missing, with a file for each simulation, which keep the numbers as they
        are found. What is exact is computed again by a call that continues.

    Returns
    -------
    Claims
        One row per statement; printed it is a table. ``.confirmed`` says whether the evidence
        supports every verdict; ``.plot()`` draws the tail bounds and SLSE against uniform weights.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used.
    KeyboardInterrupt
        After Ctrl-C or SIGTERM, when what is done is in `path`: the same call continues.
    StateError, StateIOError
        A file is of another run, damaged, in use, or cannot be written.

    Examples
    --------
    >>> import paper
    >>> found = paper.claims(quick=True)
    >>> found["Lemma 3.2"].verdict, found.confirmed
    ('false', True)
    """
    key, quick = as_key(rng), bool(quick)
    folder = None if path is None else Path(path)
    where = Where(executor, folder)

    # each is computed by the first statement that needs it
    @cache
    def measured() -> tails.Tails:
        return tails.measure(key.child("tails"), runs=1000 if quick else 10_000, where=where)

    @cache
    def compared() -> Comparison:
        return compare(_vector(), key.child("comparison"), 400 if quick else 2000, 1000, where)

    @cache
    def streamed() -> streams.Streamed:
        return streams.measure(key.child("algorithm 1"), where=where)

    checks: list[Callable[[], Claim]] = [
        lambda: streams.variance(streamed()),
        definitions.solution_formula,
        definitions.index_maps,
        lambda: definitions.approximate_reachability(key.child("2.3")),
        lambda: definitions.sample_reachability(key.child("2.4")),
        reachability.lemma_31,
        reachability.remark_31,
        reachability.lemma_32,
        reachability.remark_32_reachable,
        reachability.remark_32_any,
        sampling.lemma_41,
        sampling.rows_or_columns,
        sampling.sparsity,
        sampling.bernoulli,
        lambda: tail_bounds.lemma_42(measured()),
        tail_bounds.proof_of_lemma_42,
        lambda: tail_bounds.lemma_43(key.child("4.3")),
        weights.lemma_44,
        lambda: weights.exact_recovery(key.child("recovery")),
        streams.lines_3_and_16,
        lambda: streams.algorithm_1(streamed()),
        weights.recursion,
        lambda: weights.first_inequality(key.child("4.5")),
        lambda: weights.second_inequality(compared()),
        weights.norms,
        *section_5(key.child("figures"), *((4, 300) if quick else (20, 1000)), where),
    ]
    rows = []
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    with progress_bar(progress, len(checks), "claims") as done:
        for check in checks:
            rows.append(check())
            done(len(rows))
    return Claims(tuple(rows), measured(), compared(), key.hex)


def _vector() -> Floats:
    """A vector with large and small entries, so that the smallest is drawn late."""
    return np.array([5.0, -3.0, 2.0, -1.0, 1.0, 0.5, -0.2, 0.1])
