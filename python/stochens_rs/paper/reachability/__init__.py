"""The paper's notions of reachability for random realizations, and where its lemmas on them fail.

*Reachable* (`stochens_rs.control`): some control takes the exact system from ``x0`` to ``xf``.
The paper adds:

- *sample reachable* (Definition 2.4, `sample_reachability`): every realization of ``x0``, ``A``
  and ``xf`` has a control that takes it there in one step. With fewer inputs than states it fails
  generically, even if ``xf`` is reachable;
- *approximately reachable* (Definition 2.3, `approximately`): with one open-loop control for all
  runs, the average of the runs approaches ``xf``: an experiment with a verdict.

`lemma_3_1`, `lemma_3_2` and `remark_3_2` compute, in rational numbers, the counterexamples to the
two lemmas and the remark that connect these notions. All three are true for unbiased realizations,
as `sample` draws them.
"""

from .approximate import ApproximateReachability, approximately
from .counterexamples import Counterexample, lemma_3_1, lemma_3_2, remark_3_2
from .samples import SampleReachability, sample_reachability

__all__ = [
    "ApproximateReachability",
    "Counterexample",
    "SampleReachability",
    "approximately",
    "lemma_3_1",
    "lemma_3_2",
    "remark_3_2",
    "sample_reachability",
]
