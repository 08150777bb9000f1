"""Calcite of the cemented contacts by Eq. 2, each counted once, against the nominal content; mean of eight seeds.

    python docs/reproduction/calcite.py [CONFIG]

For a configuration, the preset `paper` if none is given, and for Eq. 2 without the calibration of its pattern.
"""

import argparse
from dataclasses import replace

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.sample.cement import CementKind, CementRule, content_of_contacts

CONTENTS = (0.11, 0.34, 0.66, 1.24, 2.55, 4.0, 5.0, 7.0, 9.0)


def main() -> None:
    """Print the table, and what all contacts hold together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("configuration", nargs="?", default="examples/paper.toml")
    configuration = load_configuration(parser.parse_args().configuration, {})
    experiment = configuration.experiment(provide_packing(configuration, None))
    rules = (experiment.cement_rule, CementRule())
    print("| nominal, % | calcite, % | cemented contacts | calcite by plain Eq. 2, % | cemented contacts |")
    print("|---|---|---|---|---|")
    for content in CONTENTS:
        cells = []
        for rule in rules:
            drawn = replace(experiment, cement_rule=rule)
            placed = [drawn.ordering(seed).at(content) for seed in range(1, 9)]
            cells.append(f"{np.mean([content_of_contacts(drawn.packing, rule, one.kind) for one in placed]):.2f}")
            cells.append(f"{100.0 * np.mean([one.bonded.mean() for one in placed]):.0f} %")
        print(f"| {content:g} | {' | '.join(cells)} |")
    everywhere = np.full(len(experiment.packing.pairs), CementKind.C, dtype=np.uint8)
    most = content_of_contacts(experiment.packing, CementRule(), everywhere)
    print(f"\nAll {len(everywhere)} contacts at {1e3 * CementRule().c_diameter:g} mm hold {most:.2f} %.")


if __name__ == "__main__":
    main()
