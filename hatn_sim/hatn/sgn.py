"""The semantic graph network (the paper's section 4.2): which slot, and how far in three seconds.

Two recurrent encoders read the absolute and the relative history of every node, attention over
ordered pairs relates them, and each node gets a score and a Gaussian mixture over the distance that
its rear vehicle will travel. `sgn_settings.py` tells the paper's form, its variants and ours apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from hatn_sim.graph import CONTEXT, CONTEXT_SIZE, ROAD_CONTEXT
from hatn_sim.hatn.anchors import (
    ANCHORS,
    ANCHORS_OF_FEATURES,
    anchors_of_context_m,
    anchors_of_features_m,
)
from hatn_sim.hatn.sgn_layers import Relations, dense
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.slots import race_log_probability, softmax_log_probability, tempered
from hatn_sim.hatn.travel import HORIZON_S, PROFILE_S, earliest_s, profile_m

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
    *(1.0, 20.0),
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
RACE_PER_GATE = 0.5
"""A prior that holds on any road: each second of earliest arrival costs this much utility, and so
does a stop line, give-way line or closed signal that is still to be passed. It is added when
predicting only. In training it would be unlearned: who is far from one scene's focus is also told
by how that scene looks, and on another scene only the time is left."""
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

    def of_egos(self) -> GraphBatch:
        """The same with the egos' own nodes only."""
        return GraphBatch(
            self.x[:, :1],
            self.context[:, :1],
            self.node_mask[:, :1],
            self.focus_mask[:, :1],
            self.history_mask[:, :1],
        )


@dataclass(frozen=True, eq=False)
class Repeats:
    """Which of the N nodes there are, row by row, have the same history as another one."""

    first: Tensor  # [U] a node for each history
    history: Tensor  # [N] which of these is its own


@dataclass(frozen=True, eq=False)
class SlotModes:
    """What the ego does for each slot it may take; 0 outside the focus group."""

    goal_m: Tensor  # [E, M]
    profile_m: Tensor  # [E, M, P]
    crossing_s: Tensor  # [E, M] from now until the ego crosses its focus; 0 if it has none


@dataclass(frozen=True, eq=False)
class Intention:
    """What the network says of every node; M of the goals and profiles is 1 if of egos only."""

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
    of_now: Tensor
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
        of_now = torch.ones(CONTEXT_SIZE)
        of_now[list(OF_THE_PAST)] = 0.0
        self.register_buffer("of_now", of_now, persistent=False)
        # Fitted after training, see `learn.calibration`.
        self.register_buffer("slot_temperature", torch.ones(()))
        self.register_buffer("goal_temperature", torch.ones(()))
        self.context_size = CONTEXT_SIZE if settings.context else 0
        beside = max(self.context_size - ROAD_CONTEXT, 0)
        encoded = NODE_FEATURES if settings.sequential else width
        if settings.sequential:
            self.evolution_gru = nn.GRU(width, width, batch_first=True)
        else:
            self.absolute_gru = nn.GRU(NODE_FEATURES, width, batch_first=True)
            self.relative_gru = nn.GRU(NODE_FEATURES, width, batch_first=True)
        self.absolute_encoder = dense(encoded + beside, width)
        self.relative_encoder = dense(encoded + beside, width)
        self.combine = nn.Linear(2 * width, width)
        self.relations = nn.ModuleList(
            Relations(width, settings.heads) for _ in range(settings.graph_layers)
        )
        self.dropout = nn.Dropout(settings.dropout)
        # No bias: the same for all nodes, it changes no order.
        self.race_head = nn.Sequential(
            nn.Dropout(settings.race_dropout),
            dense(width, width),
            nn.Linear(width, 1, bias=False),
        )
        if settings.context:
            # The road ahead says how far, not who goes first: it is kept from the slots, where
            # it would only tell one place from another.
            self.road_encoder = dense(ROAD_CONTEXT + 1, width)
            self.race_skip = nn.Linear(len(RACE_FEATURES), 1, bias=False)
        if settings.slots == "race":
            self.ego_bias = nn.Parameter(torch.zeros(()))
        known = (2 if settings.context else 1) * width + 2 * settings.goal_knows_slots
        steps = len(PROFILE_S) if settings.profile else 0
        bases = 1
        if settings.goal_base == "anchors":
            bases = ANCHORS if settings.context else ANCHORS_OF_FEATURES
        # Of every mean: how far it is from its base, and which base.
        self.per_mean = 1 + (bases if bases > 1 else 0)
        self.goal_head = nn.Sequential(
            dense(known, width),
            nn.Linear(width, (2 + self.per_mean) * settings.components + steps),
        )
        if settings.slot_modes:
            # The ego's node, the slot's, and whether to yield -> crossing, goal, profile. Its own
            # goal is one more base.
            self.per_mode = 2 + (1 + bases if bases > 1 else 0)
            self.mode_head = nn.Sequential(
                dense(known + width + 1, width), nn.Linear(width, self.per_mode + steps)
            )

    def forward(
        self, batch: GraphBatch, repeats: Repeats | None = None, egos_only: bool = False
    ) -> Intention:
        """With `repeats`, a history is encoded once; with `egos_only`, goals are of node 0 only."""
        if not self.settings.temporal:
            batch = replace(batch, context=batch.context * self.of_now)
        mask = batch.node_mask
        context = self._context(batch)
        z = self._evolve(batch, context[:, ROAD_CONTEXT:], repeats)
        z = self.dropout(z)  # [N, width] of the N nodes there are
        utility = self._utility(z, context, batch)
        # Row by row of the mask: an ego's node comes first among its own.
        ego = mask.sum(-1).cumsum(0) - mask.sum(-1)
        asked, row = (batch.of_egos(), ego) if egos_only else (batch, slice(None))
        known = z[row]
        if self.settings.context:
            speed = asked.x[:, :, -1, REAR_MPS : REAR_MPS + 1][asked.node_mask]
            scaled = speed / self.feature_scale[REAR_MPS]
            ahead = self.road_encoder(torch.cat((context[row, :ROAD_CONTEXT], scaled), -1))
            known = torch.cat((known, ahead), -1)
        if self.settings.goal_knows_slots:
            known = torch.cat((known, self._first(utility.detach(), batch)[row]), -1)
        known_of_ego = known if egos_only else known[ego]
        return self._intention(self._slots(utility, batch), z, known, known_of_ego, asked, batch)

    def _histories(self, batch: GraphBatch) -> tuple[Tensor, Tensor]:
        """Absolute, and relative to the ego's node: [N, T, NODE_FEATURES] each."""
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
        return (batch.context[batch.node_mask] / self.context_scale)[:, : self.context_size]

    def _evolve(self, batch: GraphBatch, beside: Tensor, repeats: Repeats | None) -> Tensor:
        """The latent evolution z [N, width] of every node."""
        absolute, relative = self._histories(batch)
        mask = batch.node_mask
        if self.settings.sequential:
            steps = [
                self._relate(absolute[:, step], relative[:, step], beside, mask)
                for step in range(absolute.shape[1])
            ]
            return self.evolution_gru(torch.stack(steps, 1))[1][0]
        if repeats is None:
            h = self.absolute_gru(absolute)[1][0]
        else:
            h = self.absolute_gru(absolute[repeats.first])[1][0][repeats.history]
        return self._relate(h, self.relative_gru(relative)[1][0], beside, mask)

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
        earliest_s, gate = (batch.context[..., column] for column in RACE_FEATURES[:2])
        return utility - RACE_PER_S * earliest_s - RACE_PER_GATE * gate

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
        self,
        slot_logit: Tensor,
        z: Tensor,
        known: Tensor,
        known_of_ego: Tensor,
        asked: GraphBatch,
        batch: GraphBatch,
    ) -> Intention:
        """Goals of the nodes of `asked`, of which so much is `known` [N, width]."""
        mask, count = asked.node_mask, self.settings.components
        of_node = self.goal_head(known)
        out = known.new_zeros((*mask.shape, of_node.shape[-1]))
        out[mask] = of_node
        now, speed = asked.x[:, :, -1], asked.x[:, :, -1, REAR_MPS]
        steps = out.shape[-1] - count * (2 + self.per_mean)
        weight, means, wide, change = out.split((count, count * self.per_mean, count, steps), -1)
        weight = weight.log_softmax(-1)
        bases = self._bases_m(now, asked.context)
        mean = _goal_m(bases.unsqueeze(-2), means.unflatten(-1, (count, -1)))
        std = MIN_GOAL_STD_M + GOAL_SCALE_M * nn.functional.softplus(wide - 2.0)
        goal = (weight.exp() * mean).sum(-1)
        change = self._change(change)
        found = Intention(
            slot_logit=slot_logit,
            goal_log_weight=weight,
            goal_mean_m=mean,
            goal_std_m=std * self.goal_temperature,
            profile_m=profile_m(goal, speed, change),
            modes=self._modes(z, known_of_ego, goal[:, 0], change[:, 0], batch)
            if self.settings.slot_modes
            else None,
        )
        return by_slots(found) if self.settings.goal_by_slots and not self.training else found

    def _bases_m(self, now: Tensor, context: Tensor) -> Tensor:
        """What goals are a change of [..., B], from features now [..., 7] and context [..., C]."""
        if self.settings.goal_base == "anchors":
            seen = anchors_of_features_m(now)
            if not self.context_size:
                return seen
            return torch.cat((seen, anchors_of_context_m(now, context)), -1)
        even = HORIZON_S * now[..., REAR_MPS : REAR_MPS + 1]
        return even if self.settings.goal_base == "speed" else torch.zeros_like(even)

    def _change(self, out: Tensor) -> Tensor:
        """Changes [..., P] of a profile; none without the setting."""
        return out if self.settings.profile else out.new_zeros((*out.shape[:-1], len(PROFILE_S)))

    def _modes(
        self, z: Tensor, known: Tensor, goal: Tensor, change: Tensor, batch: GraphBatch
    ) -> SlotModes:
        """From what is `known` [E, width] of egos, their goal [E] and the change of its profile."""
        focus = batch.focus_mask
        several = focus & focus[:, 1:].any(-1, keepdim=True)
        ego, slot = several.nonzero(as_tuple=True)
        padded = z.new_zeros((*focus.shape, z.shape[-1]))
        padded[batch.node_mask] = z
        yields = (slot == 0).to(z.dtype).unsqueeze(-1)
        out = self.mode_head(torch.cat((known[ego], padded[ego, slot], yields), -1))
        now = batch.x[ego, 0, -1]
        bases = goal[ego].unsqueeze(-1).detach()
        if self.settings.goal_base == "anchors":
            bases = torch.cat((bases, self._bases_m(now, batch.context[ego, 0])), -1)
        crossing = earliest_s(now[:, REAR_M], now[:, REAR_MPS]) + CROSSING_SCALE_S * out[:, 0]
        # Who has no choice has one mode: its own goal, and way to it.
        goals = goal.new_zeros(focus.shape)
        goals[:, 0] = goal
        changes = change.new_zeros((*focus.shape, change.shape[-1]))
        changes[:, 0] = change
        crossings = torch.zeros_like(goals)
        goals[ego, slot] = _goal_m(bases, out[:, 1 : self.per_mode])
        changes[ego, slot] = change[ego].detach() + self._change(out[:, self.per_mode :])
        crossings[ego, slot] = nn.functional.softplus(crossing)
        speeds = batch.x[:, :1, -1, REAR_MPS].expand_as(goals)
        return SlotModes(goals, profile_m(goals, speeds, changes), crossings)


def _goal_m(bases_m: Tensor, out: Tensor) -> Tensor:
    """Goals [...] from their bases [..., B] and outputs: how far from them, and which of them."""
    chosen = (out[..., 1:].softmax(-1) * bases_m).sum(-1) if out.shape[-1] > 1 else bases_m[..., 0]
    return nn.functional.softplus(chosen + GOAL_SCALE_M * out[..., 0])


def by_slots(found: Intention) -> Intention:
    """The same, with every ego's goal and profile half way to those expected over its slots.

    What one does for each slot, and which slot one takes, hold elsewhere better than how far one
    gets here: two opinions are better than one.
    """
    if found.modes is None:
        return found
    chance = found.slot_logit.exp().unsqueeze(-1)
    expected = (chance * found.modes.profile_m).sum(1)  # [E, P]
    profile = 0.5 * (found.profile_m[:, 0] + expected)
    shift = profile[:, -1:] - found.profile_m[:, 0, -1:]
    mean = torch.cat((found.goal_mean_m[:, :1] + shift[:, None], found.goal_mean_m[:, 1:]), 1)
    profiles = torch.cat((profile[:, None], found.profile_m[:, 1:]), 1)
    return replace(found, goal_mean_m=mean, profile_m=profiles)
