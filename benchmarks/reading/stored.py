"""What the readings of a stored campaign say, content by content.

    python benchmarks/reading/stored.py results/paper.db [--again]

For each content: share of cells with a velocity, mean (m/s), sd and IQR / 1.349 over mean and median, and the share of
velocities on which peak and cross-correlation disagree: they differ by more than 5 %, or the correlation was refused for
differing by more than 10 %. With ``--again`` stored signals are read anew by the present rule; velocities that changed by
more than 0.1 %, appeared or went are listed. A record that ended early may then be too short, which is counted as refused.
What stations recorded is not stored: a campaign with `wave.stations` cannot be read again.
"""

import argparse
from collections import defaultdict

import numpy as np

import calcidem
from calcidem.dem.wave.arrival import read_travel_times
from calcidem.dem.wave.pick import Picks, Signals

_DISAGREES, _CHANGED = 0.05, 1e-3  # of the velocity


def read_again(campaign: calcidem.OpenedCampaign, seed: int, content: float, distance: float) -> Picks:
    """Readings of a stored signal by the present rule."""
    stored, experiment = campaign.signal(seed=seed, content=content), campaign.experiment()
    sent, received = np.asarray(stored.sent_velocity, float), np.asarray(stored.received_velocity, float)
    floor = 1e-3 * experiment.wave.amplitude
    return read_travel_times(Signals(stored.sampling_interval, sent, received, distance, floor), experiment.pick)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("--again", action="store_true")
    chosen = parser.parse_args()
    rows, changed = defaultdict(list), []
    with calcidem.open_campaign(chosen.database) as campaign:
        if chosen.again and (stations := campaign.experiment().wave.stations):
            parser.error(
                f"wave.stations = {stations}: their signals are not stored; leave out --again, or run the campaign anew"
            )
        for cell in campaign.select():
            peak, correlation = cell.vs, cell.vs_cross_correlation
            if chosen.again and cell.distance is not None:
                picks = read_again(campaign, cell.key.seed, cell.key.content, cell.distance)
                peak, correlation = picks.peak.velocity, picks.cross_correlation.velocity
                if (peak is None) != (cell.vs is None) or (peak and cell.vs and abs(peak / cell.vs - 1.0) > _CHANGED):
                    changed.append((cell.key.content, cell.key.seed, cell.vs, peak, picks.peak.failure))
            rows[cell.key.content].append((peak or np.nan, correlation or np.nan))
    print(
        "| content % | cells | velocity % | mean | sd / mean | robust | readings disagree % |\n|---|---|---|---|---|---|---|"
    )
    for content in sorted(rows):
        peak, correlation = np.array(rows[content], float).T
        read = np.isfinite(peak)
        vs = peak[read]
        low, median, high = np.percentile(vs, [25, 50, 75]) if len(vs) else [np.nan] * 3
        differ = ~(np.abs(correlation[read] / vs - 1.0) <= _DISAGREES)  # also where there is none
        spread = vs.std(ddof=1) / vs.mean() if len(vs) > 1 else np.nan
        print(
            f"| {content:g} | {len(peak)} | {100.0 * read.mean():.1f} | {vs.mean() if len(vs) else np.nan:.0f} | {spread:.3f} "
            f"| {(high - low) / 1.349 / median:.3f} | {100.0 * differ.mean() if len(vs) else np.nan:.1f} |"
        )
    for content, seed, before, after, failure in changed:
        print(f"{content:g} %, seed {seed}: {before or 0.0:.0f} -> {after or 0.0:.0f} m/s {failure or ''}")


if __name__ == "__main__":
    main()
