"""What can be reached: by the exact system, by every realization, and on average.

Three notions, in the paper's order, each as a computation on given data:

- *reachable* (`one_step`, `several_steps`): some control takes the exact system from ``x0`` to
  ``xf``; with `controllability_matrix` and `gramian`;
- *sample reachable* (Definition 2.4, `sample_reachability`): every realization of ``x0``, ``A``
  and ``xf`` has a control that takes it there in one step. With fewer inputs than states it fails
  generically, even where ``xf`` is reachable;
- *approximately reachable* (Definition 2.3, `approximately`): with one open-loop control for all
  runs, the average of the runs approaches ``xf``: an experiment with a verdict.

`lemma_3_1`, `lemma_3_2` and `remark_3_2` compute, in rational numbers, the counterexamples to the
two lemmas and the remark that connect these notions. What they lack is that the realizations be
unbiased; `sample`'s are.
"""

from ...paper.reachability.approximate import ApproximateReachability, approximately
from ...paper.reachability.counterexamples import Counterexample, lemma_3_1, lemma_3_2, remark_3_2
from ...paper.reachability.samples import SampleReachability, sample_reachability
from .steps import StepsReachability, controllability_matrix, gramian, one_step, several_steps

__all__ = [
    "ApproximateReachability",
    "Counterexample",
    "SampleReachability",
    "StepsReachability",
    "approximately",
    "controllability_matrix",
    "gramian",
    "lemma_3_1",
    "lemma_3_2",
    "one_step",
    "remark_3_2",
    "sample_reachability",
    "several_steps",
]
