"""Seeds of any size -> those that simulators take."""

from __future__ import annotations

import numpy as np

from hatn_sim.simulators.sumo_config import MAX_SEED


def number_of(seed: int) -> int:
    """The seed (0 ... MAX_SEED) that a simulator is given for one of an environment, from 0 on.

    SUMO's go up to 2^31 - 1, and are taken as they are; trainers draw theirs up to 2^32. A larger
    one is hashed by numpy's `SeedSequence`, so that it has an episode of its own: always the same,
    and one that another seed has only by a chance of 1 in 2^31.
    """
    if seed <= MAX_SEED:
        return seed
    return int(np.random.SeedSequence(seed).generate_state(1)[0]) & MAX_SEED
