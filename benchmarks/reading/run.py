"""How often the travel times of synthetic signals with a known delay are read wrong in silence, and how often not at all.

    python benchmarks/reading/run.py [--seed 2] [--signals 2500]

A signal is the sent pulse after a chain of grains (dispersion), with a line source's tail, a P pulse of either sign,
scattered arrivals, a third crossing and noise; ranges.toml says how much of each. A signal counts as readable if somebody
who may see it without its noise finds the S pulse: the largest value up to 1.5 travel times is a top within 5 % of the
known delay, and the noise is below a tenth of it. *Wrong* is a reading off by more than 10 %, of all signals; *refused* is
no reading, of those that are readable.
"""

import argparse
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.arrival import read_travel_times
from calcidem.dem.wave.pick import Signals
from calcidem.dem.wave.pulse import Pulse

RANGES = tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))
KINDS = tuple(name for name, value in RANGES.items() if isinstance(value, dict) and name != "common")
METHODS = ("peak", "first_arrival", "cross_correlation")


@dataclass(frozen=True)
class Known:
    """A signal and what is known of it.

    Attributes
    ----------
    kind
        Table of ranges.toml that it was drawn from.
    signals
        As the reading gets them.
    delay
        Travel time of the S pulse, s.
    readable
        See above.
    """

    kind: str
    signals: Signals
    delay: float
    readable: bool


def draw_signal(seed: int, index: int) -> Known:
    """Draw one signal; it depends on seed and index alone."""
    generator = np.random.default_rng([seed, index])
    kind = KINDS[index % len(KINDS)]
    ranges = RANGES["common"] | RANGES[kind]
    drawn = {name: float(generator.uniform(*value)) for name, value in ranges.items() if isinstance(value, list)}
    low, high = ranges["velocity"]
    velocity, distance = float(np.exp(generator.uniform(np.log(low), np.log(high)))), RANGES["distance"]
    delay = distance / velocity
    frequency = drawn["wavelengths"] / delay
    interval = 1.0 / (frequency * RANGES["samples_per_period"])
    count = int((3.0 * delay + 4.0 / frequency) / interval)
    sent = Pulse(1.0, frequency).velocity(np.arange(16 * count) * interval)
    spectrum = np.fft.rfft(sent)
    f = np.fft.rfftfreq(16 * count, interval)

    ring = _ringing(f / frequency, sent, drawn["ringing"], drawn["resonance"], drawn["sharpness"])

    def pulse(late: float, width: float, tail: float) -> Floats:
        """Pulse of height 1 that a wave of this travel time brings."""
        passed = _chain(f, late, drawn["grains"]) * _widening(f, frequency, width) * _tail(f, frequency, tail) * ring
        received = np.fft.irfft(spectrum * passed, 16 * count)[:count]
        return np.asarray(received / np.abs(received).max())

    shear = pulse(delay, drawn["width"], drawn["tail"])
    clean = shear + drawn["p_height"] * pulse(delay / drawn["p_ratio"], drawn["width"] * drawn["p_width"], 0.0)
    clean += drawn["round_trip"] * pulse(3.0 * delay, drawn["width"], drawn["tail"])
    for _ in range(int(drawn["coda_arrivals"])):
        later = ranges["coda_first"] + float(generator.exponential(ranges["coda_spread"]))
        height = drawn["coda"] * generator.uniform(-1.0, 1.0) * np.exp(-later / ranges["coda_decay"])
        clean += height * pulse(delay + later / frequency, drawn["width"], 0.0)
    noise = np.fft.irfft(
        np.fft.rfft(generator.standard_normal(16 * count)) * np.exp(-((f / (drawn["noise_band"] * frequency)) ** 2)),
        16 * count,
    )[:count]
    received = clean + drawn["noise"] * noise / noise.std()
    signals = Signals(interval, sent[:count], received, distance, floor=1e-3)
    return Known(kind, signals, delay, _is_readable(clean, signals, delay, drawn["noise"]))


def _chain(f: Floats, delay: float, grains: float) -> Floats:
    """Transfer function of a chain of grains, with a little loss: ``sin(q d / 2) = omega d / (2 V)``."""
    half = np.pi * f * delay / grains * (1.0 - 0.003j)
    step = 2.0 * np.arcsin(half)
    return np.asarray(np.exp(-1j * (step.real - 1j * np.abs(step.imag)) * grains))


def _widening(f: Floats, frequency: float, width: float) -> Floats:
    """Transfer function of a Gaussian that makes a pulse wider by a factor about its middle."""
    # A pulse 1 - cos has a variance of (1 / 12 - 1 / (2 pi^2)) / f^2.
    variance = (1.0 / 12.0 - 0.5 / np.pi**2) * max(0.0, width**2 - 1.0) / frequency**2
    return np.asarray(np.exp(-0.5 * variance * (2.0 * np.pi * f) ** 2))


def _tail(f: Floats, frequency: float, share: float) -> Floats:
    """Transfer function of an impulse and of a tail ``exp(-f t / 2) / sqrt(t)`` behind it, by shares."""
    return np.asarray((1.0 - share) + share / np.sqrt(1.0 + 4j * np.pi * f / frequency))


def _ringing(x: Floats, sent: Floats, share: float, resonance: float, sharpness: float) -> Floats:
    """Transfer function of a resonance passed twice, at frequencies over the sent one; the first top stays in place."""
    if not share:
        return np.ones(1)
    over = x / resonance
    through = 1j * over / sharpness / (1.0 - over**2 + 1j * over / sharpness)
    passed = 1.0 - share + share * through**2
    rung = np.fft.irfft(np.fft.rfft(sent) * passed, len(sent))
    first = int(
        np.flatnonzero((rung[1:-1] > rung[:-2]) & (rung[1:-1] >= rung[2:]) & (rung[1:-1] > 0.1 * rung.max()))[0]
    )
    late = first + 1 - int(np.argmax(sent))
    return np.asarray(passed * np.exp(2j * np.pi * np.arange(len(x)) / len(sent) * late))


def _is_readable(clean: Floats, signals: Signals, delay: float, noise: float) -> bool:
    """Whether somebody who sees the signal without its noise finds the S pulse."""
    sent = int(np.argmax(signals.sent)) * signals.sampling_interval
    top = int(np.argmax(clean[: int((sent + RANGES["readable_until"] * delay) / signals.sampling_interval)]))
    within = abs(top * signals.sampling_interval - sent - delay) <= RANGES["readable_within"] * delay
    return bool(within and clean[top] >= clean[top + 1] and noise <= RANGES["readable_noise"] * clean[top])


def read_all(seed: int, count: int) -> tuple[list[Known], dict[str, Floats]]:
    """Signals, and for each method the relative errors (count,) of the travel times; NaN where there is none."""
    known = [draw_signal(seed, index) for index in range(count)]
    errors = {name: np.full(count, np.nan) for name in METHODS}
    for index, signal in enumerate(known):
        picks = read_travel_times(signal.signals)
        for name in METHODS:
            reading = getattr(picks, name)
            if reading.travel_time is not None:
                errors[name][index] = reading.travel_time / signal.delay - 1.0
    return known, errors


def main() -> None:
    """Print a table: kind by reading."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=RANGES["judged_seed"])
    parser.add_argument("--signals", type=int, default=RANGES["signals"])
    chosen = parser.parse_args()
    known, errors = read_all(chosen.seed, chosen.signals)
    kinds, readable = np.array([one.kind for one in known]), np.array([one.readable for one in known])
    print(f"{len(known)} signals of seed {chosen.seed}, {readable.sum()} of them readable\n")
    print("| kind | readable % | " + " | ".join(f"{name}: wrong % | refused %" for name in METHODS) + " |")
    print("|---|---|" + "---|---|" * len(METHODS))
    for kind in (*KINDS, "all"):
        chosen_ones = kinds == kind if kind != "all" else np.ones(len(known), dtype=bool)
        cells = [f"{100.0 * readable[chosen_ones].mean():.0f}"]
        for name in METHODS:
            error = errors[name][chosen_ones]
            wrong = np.abs(error) > RANGES["wrong"]  # NaN is not
            cells += [f"{100.0 * wrong.mean():.1f}", f"{100.0 * np.isnan(error[readable[chosen_ones]]).mean():.1f}"]
        print(f"| {kind} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
