"""What the exact system can reach, in one step and in several.

`one_step` and `several_steps` say whether some control takes it from ``x0`` to ``xf``;
`controllability_matrix` and `gramian` say which targets are within reach at all. The paper's other
two notions are in :mod:`stochens_rs.paper.reachability`.
"""

from .steps import StepsReachability, controllability_matrix, gramian, one_step, several_steps

__all__ = [
    "StepsReachability",
    "controllability_matrix",
    "gramian",
    "one_step",
    "several_steps",
]
