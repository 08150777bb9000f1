"""Random numbers of a sample: one stream for each purpose, apart from all others."""

from enum import IntEnum

import numpy as np


class RandomPurpose(IntEnum):
    """What a stream of random numbers is for; the numbers belong to a sample's identity and never change."""

    DISKS = 0
    P_CONTACTS = 1
    CLUSTERS = 2


def random_generator(root_seed: int, seed: int, purpose: RandomPurpose) -> np.random.Generator:
    """Return the generator of a stream, the same wherever and in whatever order it is asked for.

    Root, seed and purpose span a tree of NumPy's `SeedSequence`, whose branches are independent of one another.
    """
    sequence = np.random.SeedSequence(root_seed, spawn_key=(seed, purpose.value))
    return np.random.Generator(np.random.PCG64(sequence))
