"""Make the small real database of the tutorial, from the configuration beside it.

    python docs/tutorial/make_database.py

Signals are kept of seed 1 only, so that the file stays small.
"""

from dataclasses import replace
from pathlib import Path

from calcidem.analysis.packing_graph import packing_graph
from calcidem.app.campaign.run import run
from calcidem.app.campaign.task import with_graph
from calcidem.app.config.reader import load_configuration
from calcidem.storage.sql.store import open_store

HERE = Path(__file__).parent


def main() -> None:
    """Compute all cells, then add what their contact graphs say."""
    database = HERE / "quick.db"
    database.unlink(missing_ok=True)
    whole = load_configuration(HERE / "quick.toml", {})
    first = replace(whole, campaign=replace(whole.campaign, seeds=(1,)), run=replace(whole.run, store_signals=True))
    for configuration in (first, whole):
        run(configuration, db=database).close()
    with open_store(database) as store:
        store.use_campaign()
        packing = store.load_packing()
        if packing is None:
            raise RuntimeError(f"{database} has no packing; delete it and start again.")
        wave = whole.wave
        graph = packing_graph(packing, wave.transmitter_half_width, wave.receiver_half_width)
        complete = [with_graph(result, graph) for result in store.results(with_arrays=True)]
        store.record_results(complete, replace_done=True)


if __name__ == "__main__":
    main()
