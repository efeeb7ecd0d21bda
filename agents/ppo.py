"""Drives by a policy that learnt it: PPO on the environments, its weights ship with their card.

It decides twice a second how hard to accelerate or to brake. Limits, stop lines, signals and the
leader are kept for it (`hatn_sim.policies.law`): what it has learnt is when to go. One of your own,
from `hatn-sim train-policy`: the same class with the path of its weights, as --agent module:Class.
"""

from __future__ import annotations

from hatn_sim.policies.driver import PolicyAgent
from hatn_sim.policies.network import shipped_policy


class Agent(PolicyAgent):
    """The policy that ships."""

    def __init__(self) -> None:
        super().__init__(shipped_policy("ppo"))
