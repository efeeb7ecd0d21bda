"""Scores of nodes -> probabilities of the slots that an ego may take.

The slot an ego takes is decided by the order in which vehicles cross the focus. So a node's score
is the utility of its rear vehicle in a race (Plackett 1975, Luce 1959): the probability that one is
the first of some to cross is the softmax of their scores. To yield is that the ego is not first; to
pass before j is that the ego is first and j is first of the others. A plain softmax over nodes, the
paper's form, has to learn this composition from data, and loses it on a scene it has not seen.
"""

from __future__ import annotations

from torch import Tensor, cat, logaddexp

LOWEST = float("-inf")


def softmax_log_probability(score: Tensor, focus_mask: Tensor) -> Tensor:
    """Log probabilities [E, M] of the slots by a softmax of their scores [E, M].

    -inf outside the focus group.
    """
    return score.masked_fill(~focus_mask, LOWEST).log_softmax(-1)


def race_log_probability(utility: Tensor, focus_mask: Tensor) -> Tensor:
    """Log probabilities [E, M] of the slots from the utilities [E, M] of a race to the focus.

    Node 0: the ego is not first. Node j: the ego is first, and j the first of the others. An ego
    that is alone has its own slot for certain. -inf outside the focus group.
    """
    own = utility[:, :1]
    others = utility.masked_fill(~focus_mask, LOWEST)[:, 1:]
    alone = ~focus_mask[:, 1:].any(-1, keepdim=True)
    # An ego that is alone would meet only -inf here; its row is overwritten below.
    of_others = others.masked_fill(alone, 0.0).logsumexp(-1, keepdim=True)
    of_all = logaddexp(own, of_others)
    not_first = (of_others - of_all).masked_fill(alone, 0.0)
    passing = ((own - of_all) + (others - of_others)).masked_fill(~focus_mask[:, 1:], LOWEST)
    return cat((not_first, passing), -1)


def tempered(log_probability: Tensor, temperature: Tensor) -> Tensor:
    """Log probabilities [E, M] flattened (temperature above 1) or sharpened (below), sum 1."""
    # Where nothing is possible, -inf stays what it is.
    return (log_probability / temperature).log_softmax(-1)
