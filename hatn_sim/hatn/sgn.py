"""The semantic graph network (the paper's section 4.2): which slot, and how far in three seconds.

Two recurrent encoders read the absolute and the relative history of every node, attention over
ordered pairs relates them, and each node gets a score and a Gaussian mixture over the distance that
its rear vehicle will travel. `sgn_settings.py` tells the paper's form, its variants and ours apart.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import HISTORY_FRAMES, MAX_NODES
from hatn_sim.graph import CONTEXT, CONTEXT_SIZE, ROAD_CONTEXT
from hatn_sim.hatn.anchors import ANCHORS, anchors_m
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.slots import race_log_probability, softmax_log_probability, tempered
from hatn_sim.hatn.travel import HORIZON_S, PROFILE_S, profile_m
from hatn_sim.speed_profile import ACCELERATION_MPS2

# Fixed scales, never fitted to a scene: d_f, v_f, phi_f, d_r, v_r, phi_r, l.
FEATURE_SCALE = (30.0, 10.0, 1.0, 30.0, 10.0, 1.0, 30.0)
REAR_M, REAR_MPS = 3, 4  # d_r and v_r among them
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
OF_THE_PAST = (
    CONTEXT.index("waited_s of the rear vehicle"),
    CONTEXT.index("waited_s of the ego"),
    CONTEXT.index("acceleration_mps2 of the rear vehicle"),
)
"""What one frame does not tell."""
QUEUED = CONTEXT.index("front is a vehicle of the focus group")
QUEUED_PENALTY = 6.0
"""Who queues behind another is not first; finite, since lines and leaders may be wrong."""
RACE_PER_S = 1.0
"""A prior that holds on any road: each second of earliest arrival costs this much utility. It is
added when predicting only. In training it would be unlearned: who is far from one scene's focus is
also told by how that scene looks, and on another scene only the time is left."""
GOAL_SCALE_M = 10.0
CROSSING_SCALE_S = 3.0
MIN_GOAL_STD_M = 0.1
NODE_FEATURES = len(FEATURE_SCALE) + 1  # and whether both ends were seen


@dataclass(frozen=True, eq=False)
class GraphBatch:
    """Semantic graphs as float32 tensors: what the network reads."""

    x: Tensor  # [E, M, T, 7]
    context: Tensor  # [E, M, CONTEXT_SIZE]
    node_mask: Tensor  # [E, M]
    focus_mask: Tensor  # [E, M]
    history_mask: Tensor  # [E, M, T]


@dataclass(frozen=True, eq=False)
class SlotModes:
    """What the ego does for each slot it may take; 0 outside the focus group."""

    goal_m: Tensor  # [E, M]
    profile_m: Tensor  # [E, M, P]
    crossing_s: Tensor  # [E, M] from now until the ego crosses its focus; 0 if it has none


@dataclass(frozen=True, eq=False)
class Intention:
    """What the network says of every node."""

    slot_logit: Tensor  # [E, M] log probability, -inf outside the focus group
    goal_log_weight: Tensor  # [E, M, C]
    goal_mean_m: Tensor  # [E, M, C]
    goal_std_m: Tensor  # [E, M, C]
    profile_m: Tensor  # [E, M, P] travelled after `PROFILE_S`; ends at `goal_m`
    modes: SlotModes | None  # with the setting `slot_modes`

    def goal_m(self) -> Tensor:
        """Mean of the mixture [E, M] in metres."""
        return (self.goal_log_weight.exp() * self.goal_mean_m).sum(-1)


class SemanticGraphNetwork(nn.Module):
    """f_rec, f_enc, f_att, f_out of the paper's table of layers, on all egos at once."""

    feature_scale: Tensor
    context_scale: Tensor
    slot_temperature: Tensor
    goal_temperature: Tensor

    def __init__(self, settings: SgnSettings) -> None:
        super().__init__()
        if len(CONTEXT_SCALE) != CONTEXT_SIZE:
            raise ValueError("CONTEXT_SCALE must name every entry of graph.CONTEXT")
        width = settings.width
        self.settings = settings
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE), persistent=False)
        self.register_buffer("context_scale", torch.tensor(CONTEXT_SCALE), persistent=False)
        # Fitted after training, see `learn.calibration`.
        self.register_buffer("slot_temperature", torch.ones(()))
        self.register_buffer("goal_temperature", torch.ones(()))
        beside = CONTEXT_SIZE - ROAD_CONTEXT if settings.context else 0
        encoded = NODE_FEATURES if settings.sequential else width
        if settings.sequential:
            self.evolution_gru = nn.GRU(width, width, batch_first=True)
        else:
            self.absolute_gru = nn.GRU(NODE_FEATURES, width, batch_first=True)
            self.relative_gru = nn.GRU(NODE_FEATURES, width, batch_first=True)
        self.absolute_encoder = _dense(encoded + beside, width)
        self.relative_encoder = _dense(encoded + beside, width)
        self.combine = nn.Linear(2 * width, width)
        self.relations = nn.ModuleList(
            Relations(width, settings.heads) for _ in range(settings.graph_layers)
        )
        self.dropout = nn.Dropout(settings.dropout)
        # No bias: the same for all nodes, it changes no order.
        self.race_head = nn.Sequential(
            nn.Dropout(settings.race_dropout),
            _dense(width, width),
            nn.Linear(width, 1, bias=False),
        )
        if settings.context:
            # The road ahead says how far, not who goes first: it is kept from the slots, where
            # it would only tell one place from another.
            self.road_encoder = _dense(ROAD_CONTEXT + 1, width)
            self.race_skip = nn.Linear(len(RACE_FEATURES), 1, bias=False)
        if settings.slots == "race":
            self.ego_bias = nn.Parameter(torch.zeros(()))
        known = (2 if settings.context else 1) * width + 2 * settings.goal_knows_slots
        steps = len(PROFILE_S) if settings.profile else 0
        # Of every mean: how it is told from its base.
        self.per_mean = 1 + (ANCHORS if settings.goal_base == "anchors" else 0)
        self.goal_head = nn.Sequential(
            _dense(known, width),
            nn.Linear(width, (2 + self.per_mean) * settings.components + steps),
        )
        if settings.slot_modes:
            # The ego's node, the slot's, and whether to yield -> goal, crossing, profile.
            self.mode_head = nn.Sequential(
                _dense(known + width + 1, width), nn.Linear(width, 1 + self.per_mean + steps)
            )

    def forward(self, batch: GraphBatch) -> Intention:
        mask = batch.node_mask
        absolute, relative = self._histories(batch)  # [N, T, 8] of the N nodes there are
        context = self._context(batch)
        z = self.dropout(self._evolve(absolute, relative, context[:, ROAD_CONTEXT:], mask))
        known = z
        if self.settings.context:
            speed = absolute[:, -1, REAR_MPS : REAR_MPS + 1]
            ahead = self.road_encoder(torch.cat((context[:, :ROAD_CONTEXT], speed), -1))
            known = torch.cat((z, ahead), -1)
        utility = self._utility(z, context, batch)
        if self.settings.goal_knows_slots:
            known = torch.cat((known, self._first(utility.detach(), batch)), -1)
        return self._intention(self._slots(utility, batch), z, known, batch)

    def _histories(self, batch: GraphBatch) -> tuple[Tensor, Tensor]:
        frames = batch.x.shape[2]
        # Now is always among the frames.
        every = self.settings.history_stride if self.settings.temporal else frames
        first = (frames - 1) % every
        x = batch.x[:, :, first::every] / self.feature_scale
        seen = batch.history_mask[:, :, first::every].unsqueeze(-1).to(x.dtype)
        mask = batch.node_mask
        return torch.cat((x, seen), -1)[mask], torch.cat((x - x[:, :1], seen), -1)[mask]

    def _context(self, batch: GraphBatch) -> Tensor:
        """Scaled [N, CONTEXT_SIZE], or [N, 0] without."""
        if not self.settings.context:
            return batch.context[batch.node_mask][:, :0]
        context = batch.context[batch.node_mask] / self.context_scale
        if not self.settings.temporal:
            context[:, OF_THE_PAST] = 0.0
        return context

    def _evolve(self, absolute: Tensor, relative: Tensor, beside: Tensor, mask: Tensor) -> Tensor:
        """The latent evolution z [N, width] of every node."""
        if self.settings.sequential:
            steps = [
                self._relate(absolute[:, step], relative[:, step], beside, mask)
                for step in range(absolute.shape[1])
            ]
            return self.evolution_gru(torch.stack(steps, 1))[1][0]
        h, h_rel = self.absolute_gru(absolute)[1][0], self.relative_gru(relative)[1][0]
        return self._relate(h, h_rel, beside, mask)

    def _relate(self, h: Tensor, h_rel: Tensor, beside: Tensor, mask: Tensor) -> Tensor:
        h = self.absolute_encoder(torch.cat((h, beside), -1))
        h_rel = self.relative_encoder(torch.cat((h_rel, beside), -1))
        own = self.combine(torch.cat((h, h_rel), -1))
        told = h if self.settings.attend_absolute else h_rel
        for relations in self.relations:
            own = told = relations(told, own, mask)
        return own

    def _utility(self, z: Tensor, context: Tensor, batch: GraphBatch) -> Tensor:
        """Of every node [E, M], in a race to the focus or as scores of slots."""
        utility = z.new_zeros(batch.node_mask.shape)
        score = self.race_head(z)
        if self.settings.context:
            score = score + self.race_skip(context[:, RACE_FEATURES])
        utility[batch.node_mask] = score[:, 0]
        if self.settings.slots == "softmax":
            return utility
        if self.settings.context:
            utility = utility - QUEUED_PENALTY * batch.context[..., QUEUED]
        return torch.cat((utility[:, :1] + self.ego_bias, utility[:, 1:]), 1)

    def _with_prior(self, utility: Tensor, batch: GraphBatch) -> Tensor:
        if self.settings.slots == "softmax" or not self.settings.context:
            return utility
        return utility - RACE_PER_S * batch.context[..., RACE_FEATURES[0]]

    def _first(self, utility: Tensor, batch: GraphBatch) -> Tensor:
        """[N, 2]: how probably each node's vehicle is the first to cross, if it may be."""
        chance = softmax_log_probability(self._with_prior(utility, batch), batch.focus_mask).exp()
        return torch.stack((chance, batch.focus_mask.to(chance.dtype)), -1)[batch.node_mask]

    def _slots(self, utility: Tensor, batch: GraphBatch) -> Tensor:
        """Log probabilities [E, M]."""
        if self.settings.slots == "softmax":
            found = softmax_log_probability(utility, batch.focus_mask)
        else:
            if not self.training:
                utility = self._with_prior(utility, batch)
            found = race_log_probability(utility, batch.focus_mask)
        return tempered(found, self.slot_temperature)

    def _intention(
        self, slot_logit: Tensor, z: Tensor, known: Tensor, batch: GraphBatch
    ) -> Intention:
        mask, count = batch.node_mask, self.settings.components
        of_node = self.goal_head(known)
        out = known.new_zeros((*mask.shape, of_node.shape[-1]))
        out[mask] = of_node
        speed = batch.x[:, :, -1, REAR_MPS]
        steps = out.shape[-1] - count * (2 + self.per_mean)
        weight, means, wide, change = out.split((count, count * self.per_mean, count, steps), -1)
        weight = weight.log_softmax(-1)
        mean = self._goal_m(
            batch.x[:, :, None, -1], batch.context[:, :, None], means.unflatten(-1, (count, -1))
        )
        std = MIN_GOAL_STD_M + GOAL_SCALE_M * nn.functional.softplus(wide - 2.0)
        goal = (weight.exp() * mean).sum(-1)
        return Intention(
            slot_logit=slot_logit,
            goal_log_weight=weight,
            goal_mean_m=mean,
            goal_std_m=std * self.goal_temperature,
            profile_m=profile_m(goal, speed, self._change(change)),
            modes=self._modes(z, known, goal, batch) if self.settings.slot_modes else None,
        )

    def _goal_m(self, now: Tensor, context: Tensor, out: Tensor) -> Tensor:
        """Goals [...] from features now [..., 7], context [..., C] and `per_mean` outputs."""
        base_m: Tensor | float = 0.0
        if self.settings.goal_base == "speed":
            base_m = HORIZON_S * now[..., REAR_MPS]
        elif self.settings.goal_base == "anchors":
            base_m = (out[..., 1:].softmax(-1) * anchors_m(now, context)).sum(-1)
        return nn.functional.softplus(base_m + GOAL_SCALE_M * out[..., 0])

    def _change(self, out: Tensor) -> Tensor:
        """Changes [..., P] of a profile; none without the setting."""
        return out if self.settings.profile else out.new_zeros((*out.shape[:-1], len(PROFILE_S)))

    def _modes(self, z: Tensor, known: Tensor, goal: Tensor, batch: GraphBatch) -> SlotModes:
        focus = batch.focus_mask
        several = focus & focus[:, 1:].any(-1, keepdim=True)
        ego, slot = several.nonzero(as_tuple=True)
        padded = z.new_zeros((*focus.shape, z.shape[-1]))
        padded[batch.node_mask] = z
        # Row by row of the mask: an ego's node comes first among its own.
        first = batch.node_mask.sum(-1).cumsum(0) - batch.node_mask.sum(-1)
        yields = (slot == 0).to(z.dtype).unsqueeze(-1)
        out = self.mode_head(torch.cat((known[first[ego]], padded[ego, slot], yields), -1))
        now = batch.x[ego, 0, -1]
        of_slot = self._goal_m(now, batch.context[ego, 0], out[:, 1 : 1 + self.per_mean])
        crossing = earliest_s(now[:, REAR_M], now[:, REAR_MPS]) + CROSSING_SCALE_S * out[:, 0]
        # Who has no choice has one mode, that of its own goal.
        goals = torch.zeros_like(goal)
        goals[:, 0] = goal[:, 0]
        changes = goal.new_zeros((*goal.shape, len(PROFILE_S)))
        crossings = torch.zeros_like(goal)
        goals[ego, slot] = of_slot
        changes[ego, slot] = self._change(out[:, 1 + self.per_mean :])
        crossings[ego, slot] = nn.functional.softplus(crossing)
        speeds = batch.x[:, :1, -1, REAR_MPS].expand_as(goals)
        return SlotModes(goals, profile_m(goals, speeds, changes), crossings)


def frozen_sgn(network: SemanticGraphNetwork) -> Callable[[GraphBatch], Intention]:
    """The network for prediction only, as one program: the same numbers in less time.

    For any number of graphs with as many nodes and frames as `graph.build_graphs` makes.
    """
    graphs = GraphBatch(
        x=torch.zeros(2, MAX_NODES, HISTORY_FRAMES, len(FEATURE_SCALE)),
        context=torch.zeros(2, MAX_NODES, CONTEXT_SIZE),
        node_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        focus_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        history_mask=torch.ones(2, MAX_NODES, HISTORY_FRAMES, dtype=torch.bool),
    )
    with warnings.catch_warnings():
        # Deprecated in favour of a compiler that a user's machine may not have.
        warnings.simplefilter("ignore")
        program = torch.jit.freeze(torch.jit.trace(_AsTuples(network).eval(), _tensors(graphs)))

    def predict(batch: GraphBatch) -> Intention:
        *of_nodes, modes = program(*_tensors(batch))
        return Intention(*of_nodes, modes=SlotModes(*modes) if modes else None)

    return predict


class _AsTuples(nn.Module):
    """The network as a function of tensors, to be traced."""

    def __init__(self, network: SemanticGraphNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *tensors: Tensor) -> tuple[Any, ...]:
        found = self.network(GraphBatch(*tensors))
        of_nodes = (getattr(found, one.name) for one in fields(found) if one.name != "modes")
        return *of_nodes, () if found.modes is None else _tensors(found.modes)


def _tensors(of: GraphBatch | SlotModes) -> tuple[Tensor, ...]:
    return tuple(getattr(of, one.name) for one in fields(of))


class Relations(nn.Module):
    """f_att and f^4_enc: what a node is told by all nodes, itself among them, and makes of it."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        # One dense layer on a concatenated pair is the sum of one on each of the two.
        self.attend_sender = nn.Linear(width, heads)
        self.attend_receiver = nn.Linear(width, heads, bias=False)
        self.evolve = _dense((heads + 1) * width, width)

    def forward(self, told: Tensor, own: Tensor, mask: Tensor) -> Tensor:
        """[N, width] from what nodes tell and have [N, width] each; `mask` [E, M] of the nodes."""
        padded = told.new_zeros((*mask.shape, told.shape[-1]))
        padded[mask] = told
        receiver = self.attend_receiver(padded).permute(0, 2, 1).unsqueeze(-1)  # [E, heads, M, 1]
        sender = self.attend_sender(padded).permute(0, 2, 1).unsqueeze(-2)
        score = nn.functional.leaky_relu(receiver + sender, 0.2)  # [E, heads, receiver, sender]
        score = score.masked_fill(~mask[:, None, None], float("-inf"))
        heard = score.softmax(-1) @ padded.unsqueeze(1)
        related = heard.permute(0, 2, 1, 3).flatten(2)[mask]
        return self.evolve(torch.cat((related, own), -1))


def earliest_s(distance_m: Tensor, speed_mps: Tensor) -> Tensor:
    """Time to a place at `ACCELERATION_MPS2` from now on; 0 behind it."""
    speed = speed_mps.clamp(min=0.0)
    ahead = distance_m.clamp(min=0.0)
    root = (speed**2 + 2.0 * ACCELERATION_MPS2 * ahead).clamp(min=1e-9).sqrt()
    return (root - speed).clamp(min=0.0) / ACCELERATION_MPS2


def _dense(inputs: int, width: int) -> nn.Sequential:
    """A dense layer with tanh, as in the paper's table of layers."""
    return nn.Sequential(nn.Linear(inputs, width), nn.Tanh())
