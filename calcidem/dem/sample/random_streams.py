"""Random numbers of a sample: an independent stream for each purpose."""

from enum import IntEnum

import numpy as np


class RandomPurpose(IntEnum):
    """Purpose of a random stream; the values belong to a sample's identity and never change."""

    DISKS = 0
    P_CONTACTS = 1
    CLUSTERS = 2


def random_generator(root_seed: int, seed: int, purpose: RandomPurpose) -> np.random.Generator:
    """Return the generator of a stream, independent of the order of calls.

    Root, seed and purpose span a tree of NumPy's `SeedSequence` with independent branches.
    """
    sequence = np.random.SeedSequence(root_seed, spawn_key=(seed, purpose.value))
    return np.random.Generator(np.random.PCG64(sequence))
