"""Make the small real database of the tutorial, from the configuration beside it.

    python docs/tutorial/make_database.py

Signals are kept of seed 1 only, so that the file stays small.
"""

from dataclasses import replace
from pathlib import Path

from calcidem.app.campaign.run import run
from calcidem.app.config.reader import load_configuration

HERE = Path(__file__).parent


def main() -> None:
    """Compute all cells."""
    database = HERE / "quick.db"
    database.unlink(missing_ok=True)
    whole = load_configuration(HERE / "quick.toml", {})
    first = replace(whole, campaign=replace(whole.campaign, seeds=(1,)), run=replace(whole.run, store_sections=True))
    for configuration in (first, whole):
        run(configuration, db=database).close()


if __name__ == "__main__":
    main()
