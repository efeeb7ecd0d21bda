"""The semantic graph network in all its forms: by hand, by enumeration, under masks and orders."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import combinations, permutations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.graph import CONTEXT, CONTEXT_SIZE
from hatn_sim.hatn.anchors import anchors_of_context_m, anchors_of_features_m
from hatn_sim.hatn.sgn import (
    OF_THE_PAST,
    GraphBatch,
    Intention,
    Repeats,
    SemanticGraphNetwork,
)
from hatn_sim.hatn.sgn_program import frozen_sgn
from hatn_sim.hatn.sgn_settings import SgnSettings, best_sgn, paper_sgn, paper_variants
from hatn_sim.hatn.slots import race_log_probability
from hatn_sim.hatn.travel import HORIZON_S, PROFILE_S, constant_acceleration_steps, profile_m
from hatn_sim.learn.dataset import PROFILE_EVERY
from hatn_sim.learn.sgn_loss import Targets, sgn_loss

FORMS = {
    f"{name} of {form}": replace(settings, width=8)
    for form, base in {"the paper": paper_sgn(), "ours": best_sgn()}.items()
    for name, settings in paper_variants(base).items()
} | {
    "softmax with context": replace(best_sgn(), width=8, slots="softmax", slot_modes=False),
    "race without context": replace(best_sgn(), width=8, context=False, profile=False),
    "all at once": replace(
        best_sgn(), width=8, sequential=True, heads=3, graph_layers=2, attend_absolute=True
    ),
    "goals from speed": replace(best_sgn(), width=8, goal_base="speed", goal_by_slots=True),
    "as it ships": replace(SgnSettings(), width=8),
}


def outputs(intention: Intention) -> dict[str, Tensor]:
    """All that the network says, by name."""
    found = {f.name: getattr(intention, f.name) for f in fields(intention) if f.name != "modes"}
    if intention.modes is not None:
        found |= {
            f"mode {f.name}": getattr(intention.modes, f.name) for f in fields(intention.modes)
        }
    return found


def truth_of(batch: GraphBatch) -> Targets:
    """Something to learn from for every graph; what there is of slots: yield and pass by turns."""
    egos, nodes = batch.node_mask.shape
    last = batch.focus_mask.int().cumsum(-1).argmax(-1)
    return Targets(
        goal_m=torch.full((egos, nodes), 5.0),
        goal_mask=batch.node_mask.clone(),
        profile_m=torch.linspace(0.5, 5.0, 6).expand(egos, nodes, 6),
        slot=torch.where(torch.arange(egos) % 2 == 0, 0, last),
        crossing_s=torch.full((egos,), 4.0),
        crossing_mask=torch.ones(egos, dtype=torch.bool),
    )


def batch_of(egos: int = 4, nodes: int = 5, seed: int = 0) -> GraphBatch:
    random = torch.Generator().manual_seed(seed)
    node_mask = torch.rand((egos, nodes), generator=random) < 0.7
    node_mask[:, 0] = True
    focus = node_mask & (torch.rand((egos, nodes), generator=random) < 0.7)
    focus[:, 0] = True
    return GraphBatch(
        x=torch.randn((egos, nodes, 11, 7), generator=random) * 10 * node_mask[:, :, None, None],
        context=torch.rand((egos, nodes, CONTEXT_SIZE), generator=random) * node_mask[..., None],
        node_mask=node_mask,
        focus_mask=focus,
        history_mask=node_mask[:, :, None].expand(-1, -1, 11),
    )


def network() -> SemanticGraphNetwork:
    torch.manual_seed(1)
    return SemanticGraphNetwork(SgnSettings(width=16)).eval()


@given(st.lists(st.floats(-4.0, 4.0), min_size=2, max_size=5))
def test_the_race_by_enumeration(utilities: list[float]) -> None:
    """Plackett and Luce: draw the order one by one; sum over all orders of crossing."""
    weight = np.exp(utilities)
    expected = np.zeros(len(utilities))
    for order in permutations(range(len(utilities))):
        chance, left = 1.0, weight.sum()
        for runner in order:
            chance *= weight[runner] / left
            left -= weight[runner]
        expected[0 if order[0] != 0 else order[1]] += chance
    mask = torch.ones((1, len(utilities)), dtype=torch.bool)
    found = race_log_probability(torch.tensor([utilities], dtype=torch.float64), mask).exp()
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


def test_slots_outside_the_focus_have_no_probability_and_the_rest_sums_to_one() -> None:
    batch = batch_of(64)
    with torch.no_grad():
        chance = network()(batch).slot_logit.exp()
    assert (chance[~batch.focus_mask] == 0).all()
    np.testing.assert_allclose(chance.sum(-1), 1.0, atol=1e-5)
    alone = batch.focus_mask.sum(-1) == 1
    assert alone.any()
    assert (chance[alone, 0] == 1).all()


@pytest.mark.parametrize("settings", FORMS.values(), ids=FORMS)
def test_padding_and_the_order_of_nodes_do_not_matter(settings: SgnSettings) -> None:
    batch = batch_of(32)
    torch.manual_seed(1)
    model = SemanticGraphNetwork(settings).eval()
    order = torch.tensor([0, 3, 1, 4, 2])
    shuffled = GraphBatch(**{name: value[:, order] for name, value in vars(batch).items()})
    wider = GraphBatch(
        **{
            name: torch.cat((value, torch.zeros_like(value[:, :2])), 1)
            for name, value in vars(batch).items()
        }
    )
    with torch.no_grad():
        plain, mixed, padded = model(batch), model(shuffled), model(wider)
    for name, value in outputs(plain).items():
        torch.testing.assert_close(outputs(mixed)[name], value[:, order])
        torch.testing.assert_close(outputs(padded)[name][:, :5], value)


@pytest.mark.parametrize("settings", FORMS.values(), ids=FORMS)
def test_what_is_masked_is_not_read(settings: SgnSettings) -> None:
    """Anything may stand in the rows of nodes that are not there."""
    batch = batch_of(32)
    noise = torch.randn(batch.x.shape) * 100.0
    strange = replace(
        batch,
        x=torch.where(batch.node_mask[:, :, None, None], batch.x, noise),
        context=torch.where(batch.node_mask[..., None], batch.context, noise[:, :, 0, :1]),
    )
    torch.manual_seed(1)
    model = SemanticGraphNetwork(settings).eval()
    with torch.no_grad():
        plain, other = outputs(model(batch)), outputs(model(strange))
    for name, value in plain.items():
        there = batch.node_mask.expand_as(value[..., 0] if value.ndim == 3 else value)
        torch.testing.assert_close(other[name][there], value[there])


@pytest.mark.parametrize("settings", FORMS.values(), ids=FORMS)
def test_every_weight_learns(settings: SgnSettings) -> None:
    """No gradient is missing, none infinite where nodes are masked."""
    batch = batch_of(64)
    torch.manual_seed(1)
    model = SemanticGraphNetwork(settings).train()
    parts = sgn_loss(model(batch), batch, truth_of(batch), settings)
    assert set(parts) == {"goal", "slot"} | ({"profile"} if settings.profile else set()) | (
        {"modes"} if settings.slot_modes else set()
    )
    torch.stack(list(parts.values())).sum().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        # One frame has no frame before it to remember.
        unused = not settings.temporal and "weight_hh" in name
        # Where all scores have one sign, what is added to all of them changes no softmax.
        unused |= name.endswith("attend_sender.bias")
        assert unused or parameter.grad.abs().sum() > 0, name


def test_every_setting_of_the_ablations_changes_what_is_predicted() -> None:
    batch = batch_of(16)
    goals = []
    for name, settings in paper_variants(replace(paper_sgn(), width=8)).items():
        if name != "Single-Agent":  # the same network, learnt otherwise
            torch.manual_seed(1)
            with torch.no_grad():
                goals.append(SemanticGraphNetwork(settings).eval()(batch).goal_m())
    for one, other in combinations(goals, 2):
        assert not torch.allclose(one, other)


def test_single_agent_learns_the_egos_goal_alone() -> None:
    batch = batch_of(64)
    settings = replace(paper_sgn(), width=8, ego_only=True)
    truth = truth_of(batch)
    with torch.no_grad():
        intention = SemanticGraphNetwork(settings).eval()(batch)
        loss = sgn_loss(intention, batch, truth, settings)["goal"]
        truth.goal_m[:, 1:] = 99.0
        assert sgn_loss(intention, batch, truth, settings)["goal"] == loss
        truth.goal_m[:, 0] = 99.0
        assert sgn_loss(intention, batch, truth, settings)["goal"] != loss


@pytest.mark.parametrize(
    "form", [paper_sgn(), SgnSettings(), best_sgn()], ids=["paper", "context", "best"]
)
def test_without_time_only_the_present_is_read(form: SgnSettings) -> None:
    batch = batch_of(16)
    past = OF_THE_PAST if form.context else ()
    other = replace(batch, x=batch.x.clone(), context=batch.context.clone())
    other.x[:, :, :-1] += 5.0
    other.context[..., past] += 5.0
    for temporal in (True, False):
        torch.manual_seed(1)
        model = SemanticGraphNetwork(replace(form, width=8, temporal=temporal)).eval()
        with torch.no_grad():
            same = torch.equal(model(batch).goal_m(), model(other).goal_m())
        assert same is not temporal


def test_anchors_by_hand() -> None:
    """10 m/s; front boundary 10 m, gate 12 m, conflict 45 m ahead; a leader 20 m ahead, 4 m/s."""
    now = torch.tensor([35.0, 0.0, 0.0, 45.0, 10.0, 0.0, 10.0])
    assert anchors_of_features_m(now).tolist() == pytest.approx([30.0, 10.0, 30.0 - 5.0])
    context = torch.zeros(CONTEXT_SIZE)
    for name, value in {
        "free_travel_m": 36.0,
        "acceleration": -1.0,
        "distance_m": 20.0,
        "speed_mps of the leader": 4.0,
        "leader there": 1.0,
        "gate_m": 12.0,
    }.items():
        context[next(k for k, entry in enumerate(CONTEXT) if entry.startswith(name))] = value
    assert anchors_of_context_m(now, context).tolist() == pytest.approx([25.5, 36.0, 32.0, 12.0])
    context[CONTEXT.index("leader there")] = 0.0
    assert anchors_of_context_m(now, context).tolist() == pytest.approx([25.5, 36.0, 36.0, 12.0])


def test_the_papers_form_reads_the_papers_features_alone() -> None:
    batch = batch_of(16)
    model = SemanticGraphNetwork(replace(paper_sgn(), width=8)).eval()
    other = replace(batch, context=torch.rand_like(batch.context))
    with torch.no_grad():
        plain, changed = outputs(model(batch)), outputs(model(other))
    assert all(torch.equal(changed[name], value) for name, value in plain.items())


def test_profiles_never_fall_and_end_at_the_goal() -> None:
    batch = batch_of(64)
    torch.manual_seed(0)
    with torch.no_grad():
        settings = replace(best_sgn(), width=8, goal_by_slots=True)
        model = SemanticGraphNetwork(settings).eval()
        found, weights = model(batch), model.state_dict()
    assert found.modes is not None
    for profile, goal in (
        (found.profile_m, found.goal_m()),
        (found.modes.profile_m, found.modes.goal_m),
    ):
        assert (torch.diff(profile, dim=-1, prepend=torch.zeros_like(profile[..., :1])) >= 0).all()
        torch.testing.assert_close(profile[..., -1], goal)
    closed = ~batch.focus_mask
    assert (found.modes.goal_m[closed] == 0).all()
    alone = batch.focus_mask.sum(-1) == 1
    torch.testing.assert_close(found.modes.goal_m[alone, 0], found.goal_m()[alone, 0])
    expected = (found.slot_logit.exp() * found.modes.goal_m).sum(-1)
    with torch.no_grad():
        model = SemanticGraphNetwork(replace(best_sgn(), width=8, goal_by_slots=False)).eval()
        model.load_state_dict(weights)
        plain = model(batch).goal_m()[:, 0]
    torch.testing.assert_close(found.goal_m()[:, 0], 0.5 * (plain + expected))
    assert (found.modes.crossing_s[alone] == 0).all()
    assert (found.modes.crossing_s[~alone, 0] > 0).all()


@pytest.mark.parametrize(
    ("speed_mps", "goal_m", "acceleration_mps2"),
    [
        (10.0, 30.0, 0.0),
        (10.0, 39.0, 2.0),
        (0.0, 9.0, 2.0),
        (10.0, 21.0, -2.0),
        (8.0, 12.0, -8 / 3),
    ],
)
def test_the_way_at_one_acceleration(
    speed_mps: float, goal_m: float, acceleration_mps2: float
) -> None:
    t = np.array(PROFILE_S)
    expected = speed_mps * t + 0.5 * acceleration_mps2 * t**2
    goal, speed = torch.tensor(goal_m), torch.tensor(speed_mps)
    share = constant_acceleration_steps(goal, speed).double().numpy()
    even = np.full(6, 1 / 6)
    np.testing.assert_allclose(
        share, 0.95 * np.diff(expected, prepend=0.0) / goal_m + 0.05 * even, atol=1e-6
    )
    found = profile_m(goal, speed, torch.zeros(6))
    np.testing.assert_allclose(found, goal_m * np.cumsum(share), rtol=1e-5)


def test_who_stops_earlier_stays() -> None:
    """8 m/s and 4 m to go: braking at 8 m/s2, standing after 1 s."""
    share = constant_acceleration_steps(torch.tensor(4.0), torch.tensor(8.0)).numpy()
    np.testing.assert_allclose(share, 0.95 * np.array([3, 1, 0, 0, 0, 0]) / 4 + 0.05 / 6, atol=1e-6)


def test_the_labels_and_the_profile_speak_of_the_same_moments() -> None:
    ahead = np.arange(PROFILE_EVERY, HORIZON_FRAMES + 1, PROFILE_EVERY)
    np.testing.assert_allclose(ahead * DT_S, PROFILE_S)
    assert PROFILE_S[-1] == HORIZON_S


@pytest.mark.parametrize("settings", FORMS.values(), ids=FORMS)
def test_the_traced_network_is_the_network(settings: SgnSettings) -> None:
    """One program for any number of egos, which change from frame to frame."""
    torch.manual_seed(1)
    model = SemanticGraphNetwork(settings).eval()
    program = frozen_sgn(model)
    for egos in (1, 7, 40):
        batch = batch_of(egos, 8, seed=egos)
        with torch.inference_mode():
            expected = outputs(model(batch, egos_only=True))
            every, found = outputs(model(batch)), outputs(program(batch))
        assert found.keys() == expected.keys() == every.keys()
        for name, value in expected.items():
            of_egos = every[name] if name.startswith(("slot", "mode")) else every[name][:, :1]
            torch.testing.assert_close(value, of_egos, rtol=1e-5, atol=1e-5)
            torch.testing.assert_close(found[name], value, rtol=1e-5, atol=1e-5)


def test_a_history_in_several_graphs_is_encoded_once() -> None:
    """Nodes of two vehicles in turn: with what repeats told, the same is said of every node."""
    batch = batch_of(6, 8, seed=2)
    vehicle = torch.arange(int(batch.node_mask.sum())) % 2
    batch.x[batch.node_mask] = (
        batch.x[0, :1].expand(2, -1, -1)[vehicle] * (vehicle + 1)[:, None, None]
    )
    repeats = Repeats(torch.tensor([0, 1]), vehicle)
    model = network()
    with torch.inference_mode():
        expected, found = outputs(model(batch)), outputs(model(batch, repeats))
        traced = outputs(frozen_sgn(model)(batch, repeats))
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=1e-5, atol=1e-5)
        of_egos = value if name.startswith(("slot", "mode")) else value[:, :1]
        torch.testing.assert_close(traced[name], of_egos, rtol=1e-5, atol=1e-5)


def test_the_loss_by_hand() -> None:
    """One ego, one component: the density of a normal distribution and -log p of the slot."""
    batch = batch_of(1, 2, seed=3)
    batch.node_mask[:] = batch.focus_mask[:] = True
    settings = SgnSettings(width=8, components=1)
    truth = replace(truth_of(batch), goal_m=torch.tensor([[5.0, 7.0]]), slot=torch.tensor([1]))
    truth.goal_mask[0, 1] = False
    with torch.no_grad():
        intention = SemanticGraphNetwork(settings).eval()(batch)
        parts = sgn_loss(intention, batch, truth, settings)
    mean = float(intention.goal_mean_m[0, 0, 0])
    std = float(intention.goal_std_m[0, 0, 0])
    density = -0.5 * ((5.0 - mean) / std) ** 2 - np.log(std)
    assert float(parts["goal"]) == pytest.approx(abs(5.0 - mean) * 0.4 - density, rel=1e-4)
    log_p = intention.slot_logit[0].numpy()
    assert float(parts["slot"]) == pytest.approx(
        -2.0 * (0.95 * log_p[1] + 0.05 * log_p.mean()), rel=1e-5
    )
