"""The semantic graph network (the paper's section 4.2): which slot, and how far in three seconds.

Two recurrent encoders read the absolute and the relative history of every node, attention over
ordered pairs relates them, and each node gets a score and a Gaussian mixture over the distance that
its rear vehicle will travel.

The slot an ego takes is decided by the order in which vehicles cross the focus. So a node's score
is the utility of its rear vehicle in a race (Plackett 1975, Luce 1959): the probability that one is
the first of some to cross is the softmax of their scores. To yield is that the ego is not first; to
pass before j is that the ego is first and j is first of the others. A plain softmax over nodes, the
paper's form, has to learn this composition from data, and loses it on a scene it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hatn_sim.graph import CONTEXT, CONTEXT_SIZE, ROAD_CONTEXT

# Fixed scales, never fitted to a scene: d_f, v_f, phi_f, d_r, v_r, phi_r, l.
FEATURE_SCALE = (30.0, 10.0, 1.0, 30.0, 10.0, 1.0, 30.0)
CONTEXT_SCALE = (
    *(10.0,) * 11,
    *(0.1,) * 11,
    10.0,
    *(4.0, 4.0, 10.0),
    *(1.0,) * 4,
    *(3.0, 2.0, 30.0, 10.0, 1.0),
    *(5.0, 5.0),
    1.0,
)
RACE_FEATURES = (
    CONTEXT.index("earliest_s of the rear vehicle at the conflict, up to FAR_S"),
    CONTEXT.index("gate ahead of the rear vehicle before the conflict"),
    CONTEXT.index("waited_s of the rear vehicle"),
)
"""What tells who is first anywhere: it goes to the score directly, besides through the network."""
QUEUED = CONTEXT.index("front is a vehicle of the focus group")
QUEUED_PENALTY = 6.0
"""Who queues behind another is not first; finite, since lines and leaders may be wrong."""
RACE_PER_S = 1.0
"""A prior that holds on any road: each second of earliest arrival costs this much utility. It is
added when predicting only. In training it would be unlearned: who is far from one scene's focus is
also told by how that scene looks, and on another scene only the time is left."""
LABEL_SMOOTHING = 0.05
GOAL_SCALE_M = 10.0
MIN_GOAL_STD_M = 0.1
HORIZON_S = 3.0


@dataclass(frozen=True)
class SgnSettings:
    """The shape of the network, stored in the card of its weights."""

    width: int = 64
    components: int = 3
    class_weight: float = 2.0  # beta of the paper's loss
    dropout: float = 0.1
    race_dropout: float = 0.5
    history_stride: int = 2  # every second frame tells as much, in half the time; 1 is the paper's


@dataclass(frozen=True, eq=False)
class GraphBatch:
    """Semantic graphs as float32 tensors: what the network reads."""

    x: Tensor  # [E, M, T, 7]
    context: Tensor  # [E, M, CONTEXT_SIZE]
    node_mask: Tensor  # [E, M]
    focus_mask: Tensor  # [E, M]
    history_mask: Tensor  # [E, M, T]


@dataclass(frozen=True, eq=False)
class Intention:
    """What the network says of every node."""

    slot_logit: Tensor  # [E, M] log probability, -inf outside the focus group
    goal_log_weight: Tensor  # [E, M, C]
    goal_mean_m: Tensor  # [E, M, C]
    goal_std_m: Tensor  # [E, M, C]

    def goal_m(self) -> Tensor:
        """Mean of the mixture [E, M] in metres."""
        return (self.goal_log_weight.exp() * self.goal_mean_m).sum(-1)


class SemanticGraphNetwork(nn.Module):
    """f_rec, f_enc, f_att, f_out of the paper's table of layers, on all egos at once."""

    feature_scale: Tensor
    context_scale: Tensor

    def __init__(self, settings: SgnSettings) -> None:
        super().__init__()
        width = settings.width
        self.settings = settings
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE), persistent=False)
        self.register_buffer("context_scale", torch.tensor(CONTEXT_SCALE), persistent=False)
        if len(CONTEXT_SCALE) != CONTEXT_SIZE:
            raise ValueError("CONTEXT_SCALE must name every entry of graph.CONTEXT")
        self.absolute_gru = nn.GRU(8, width, batch_first=True)
        self.relative_gru = nn.GRU(8, width, batch_first=True)
        self.absolute_encoder = _dense(width + CONTEXT_SIZE - ROAD_CONTEXT, width)
        self.relative_encoder = _dense(width + CONTEXT_SIZE - ROAD_CONTEXT, width)
        # One dense layer on a concatenated pair is the sum of one on each of the two.
        self.attend_sender = nn.Linear(width, 1)
        self.attend_receiver = nn.Linear(width, 1, bias=False)
        self.combine = nn.Linear(2 * width, width)
        self.evolve = _dense(2 * width, width)
        self.dropout = nn.Dropout(settings.dropout)
        # Who goes first is soon known by heart for one scene: half of what it may rest on is
        # hidden in training, so that it also holds elsewhere.
        self.race_head = nn.Sequential(
            nn.Dropout(settings.race_dropout), _dense(width, width), nn.Linear(width, 1)
        )
        self.race_skip = nn.Linear(len(RACE_FEATURES), 1, bias=False)
        self.ego_bias = nn.Parameter(torch.zeros(()))
        # The road ahead says how far, not who goes first: it is kept from the slots, where it
        # would only tell one place from another.
        self.road_encoder = _dense(ROAD_CONTEXT + 1, width)
        self.goal_head = nn.Sequential(
            _dense(2 * width, width), nn.Linear(width, 3 * settings.components)
        )

    def forward(self, batch: GraphBatch) -> Intention:
        mask = batch.node_mask
        every = self.settings.history_stride
        first_frame = (batch.x.shape[2] - 1) % every  # now is always among the frames
        x = batch.x[:, :, first_frame::every] / self.feature_scale
        seen = batch.history_mask[:, :, first_frame::every].unsqueeze(-1).to(x.dtype)
        absolute = torch.cat((x, seen), -1)[mask]
        relative = torch.cat((x - x[:, :1], seen), -1)[mask]
        context = batch.context[mask] / self.context_scale
        road, interaction = context[:, :ROAD_CONTEXT], context[:, ROAD_CONTEXT:]
        _, h = self.absolute_gru(absolute)
        _, h_rel = self.relative_gru(relative)
        h = self.absolute_encoder(torch.cat((h[0], interaction), -1))
        h_rel = self.relative_encoder(torch.cat((h_rel[0], interaction), -1))
        related = self._attend(h_rel, mask)
        z = self.evolve(torch.cat((related, self.combine(torch.cat((h, h_rel), -1))), -1))
        z = self.dropout(z)
        speed = absolute[:, -1, 4:5]
        road = self.road_encoder(torch.cat((road, speed), -1))
        first = context[:, RACE_FEATURES]
        utility = z.new_zeros(mask.shape)
        utility[mask] = (self.race_head(z) + self.race_skip(first))[:, 0]
        utility = utility - QUEUED_PENALTY * batch.context[..., QUEUED]
        if not self.training:
            utility = utility - RACE_PER_S * batch.context[..., RACE_FEATURES[0]]
        utility[:, 0] = utility[:, 0] + self.ego_bias
        return self._intention(utility, torch.cat((z, road), -1), x, batch)

    def _attend(self, h_rel: Tensor, mask: Tensor) -> Tensor:
        padded = h_rel.new_zeros((*mask.shape, h_rel.shape[-1]))
        padded[mask] = h_rel
        score = self.attend_receiver(padded) + self.attend_sender(padded).transpose(1, 2)
        score = nn.functional.leaky_relu(score, 0.2)  # [E, receiver, sender]
        score = score.masked_fill(~mask.unsqueeze(1), float("-inf"))
        return (score.softmax(-1) @ padded)[mask]

    def _intention(
        self, utility: Tensor, for_goals: Tensor, x: Tensor, batch: GraphBatch
    ) -> Intention:
        mask = batch.node_mask
        out = for_goals.new_zeros((*mask.shape, 3, self.settings.components))
        out[mask] = self.goal_head(for_goals).view(len(for_goals), 3, -1)
        # The goal's means start from the distance at today's speed.
        base_m = x[:, :, -1, 4:5] * (10.0 * HORIZON_S)
        return Intention(
            slot_logit=race_log_probability(utility, batch.focus_mask),
            goal_log_weight=out[:, :, 0].log_softmax(-1),
            goal_mean_m=nn.functional.softplus(base_m + GOAL_SCALE_M * out[:, :, 1]),
            goal_std_m=MIN_GOAL_STD_M + GOAL_SCALE_M * nn.functional.softplus(out[:, :, 2] - 2.0),
        )


def race_log_probability(utility: Tensor, focus_mask: Tensor) -> Tensor:
    """Log probabilities [E, M] of the slots from the utilities [E, M] of a race to the focus.

    Node 0: the ego is not first. Node j: the ego is first, and j the first of the others. An ego
    that is alone has its own slot for certain. -inf outside the focus group.
    """
    lowest = float("-inf")
    own = utility[:, :1]
    others = utility.masked_fill(~focus_mask, lowest)[:, 1:]
    alone = ~focus_mask[:, 1:].any(-1, keepdim=True)
    # An ego that is alone would meet only -inf here; its row is overwritten below.
    of_others = others.masked_fill(alone, 0.0).logsumexp(-1, keepdim=True)
    of_all = torch.logaddexp(own, of_others)
    not_first = (of_others - of_all).masked_fill(alone, 0.0)
    passing = ((own - of_all) + (others - of_others)).masked_fill(~focus_mask[:, 1:], lowest)
    return torch.cat((not_first, passing), -1)


def _dense(inputs: int, width: int) -> nn.Sequential:
    """A dense layer with tanh, as in the paper's table of layers."""
    return nn.Sequential(nn.Linear(inputs, width), nn.Tanh())


def sgn_loss(
    intention: Intention,
    batch: GraphBatch,
    goal_m: Tensor,
    goal_mask: Tensor,
    slot: Tensor,
    class_weight: float,
) -> tuple[Tensor, Tensor]:
    """Negative log likelihood of all nodes' goals, and cross-entropy of the slot (paper, eq. 11).

    `goal_m`, `goal_mask` [E, M]; `slot` [E] with -1 where there is none to learn from. Returns
    (regression, class_weight * classification).
    """
    # The ego's own goal counts once more: its trajectory hangs on it.
    weight = goal_mask * 1.0
    weight[:, 0] = weight[:, 0] * 3.0
    deviation = (goal_m.unsqueeze(-1) - intention.goal_mean_m) / intention.goal_std_m
    log_density = intention.goal_log_weight - intention.goal_std_m.log() - 0.5 * deviation**2
    likelihood = log_density.logsumexp(-1)
    error = (goal_m - intention.goal_m()).abs() / GOAL_SCALE_M
    regression = ((error * 4.0 - likelihood) * weight).sum() / weight.sum().clamp(min=1.0)
    several = (slot >= 0) & (batch.focus_mask.sum(-1) > 1)
    if not bool(several.any()):
        return regression, regression.new_zeros(())
    log_probability = intention.slot_logit[several]
    classes = nn.functional.nll_loss(log_probability, slot[several])
    # A little of every admissible slot: certainty learned on one scene is too much on another.
    open_slots = batch.focus_mask[several]
    spread = -log_probability.masked_fill(~open_slots, 0.0).sum(-1) / open_slots.sum(-1)
    return regression, class_weight * (
        (1.0 - LABEL_SMOOTHING) * classes + LABEL_SMOOTHING * spread.mean()
    )
