"""What simpler ways to read the arrival make of the same signals: `python docs/reproduction/naive_readings.py DB`.

The signals are those of the sections that the campaign stored. Each rule looks at the received velocity after the
transmitted peak and takes

- first half: the first local maximum of at least half the largest value,
- first fifth: the first local maximum of at least a fifth of it,
- largest: the largest value of the record.
"""

import argparse
from collections import defaultdict

import numpy as np
from scipy.signal import find_peaks

from calcidem.analysis.normality import jarque_bera, kurtosis, skewness
from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.records import RecordedSection

SHARES = {"first half": 0.5, "first fifth": 0.2}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    with open_campaign(parser.parse_args().database) as campaign:
        velocities: defaultdict[tuple[float, str], list[float]] = defaultdict(list)
        for cell in campaign.select(status="done", with_arrays=True):
            if cell.section is None or cell.vs is None or cell.key.content == 0.0:
                continue
            velocities[cell.key.content, "the campaign's"].append(cell.vs)
            for rule, moment in readings(cell.section).items():
                velocities[cell.key.content, rule].append(cell.distance / moment)
    print("| content % | rule | mean, m/s | sd, m/s | skewness | kurtosis | p of Jarque-Bera |")
    print("|---|---|---|---|---|---|---|")
    for (content, rule), found in sorted(velocities.items()):
        values = np.array(found)
        shape = f"{skewness(values):.2f} | {kurtosis(values):.2f} | {jarque_bera(values).p_asymptotic:.2g}"
        print(f"| {content:g} | {rule} | {values.mean():.0f} | {values.std(ddof=1):.0f} | {shape} |")


def readings(section: RecordedSection) -> dict[str, float]:
    """Travel time by each rule, s."""
    sent = int(np.argmax(section.transmitted))
    received = section.received[sent + 1 :]
    peaks, _ = find_peaks(received)
    largest = int(np.argmax(received))
    places = {"largest": largest}
    for rule, share in SHARES.items():
        high = peaks[received[peaks] >= share * received[largest]]
        places[rule] = int(high[0]) if high.size else largest
    return {rule: (place + 1) * section.sampling_interval for rule, place in places.items()}


if __name__ == "__main__":
    main()
