"""Write one cell after the other into a store and say each one on standard output once it is stored.

Usage: writer.py DATABASE SEEDS
"""

import sys
from datetime import UTC, datetime

import numpy as np

from calcidem.ends import CellStatus
from calcidem.storage.records import CampaignRecord, CellResult, RecordedSection, canonical_hash
from calcidem.storage.sql.store import Store

SAMPLES = 1000  # about 24 kB of noise, so that a write takes many pages


def main(database: str, seeds: int) -> None:
    """Continue the campaign as its master until no cell is pending."""
    campaign = CampaignRecord(canonical_hash({}), "endurance", "{}", (0.0, 5.0), tuple(range(seeds)), datetime.now(UTC))
    with Store(database) as store:
        store.begin_campaign(campaign)
        sys.stdout.write(f"lease {' '.join(store.acquire_lease()) or 'free'}\n")
        sys.stdout.flush()
        for key in store.pending():
            noise = np.random.default_rng((key.seed, int(key.content))).integers(-(2**30), 2**30, size=(2, SAMPLES, 3))
            result = CellResult(
                key,
                CellStatus.DONE,
                vs=100.0 + key.seed,
                frequency=1e4,
                time_step=1e-7,
                stability_limit=2e-7,
                steps=100,
                section=RecordedSection(1e-6, 0.5e-6, 1e4, 1e-9, [0.03, 0.06, 0.09], *noise),
            )
            store.record_results([result])
            sys.stdout.write(f"{key.seed} {key.content}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
