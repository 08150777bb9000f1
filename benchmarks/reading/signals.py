"""Synthetic signals with a known delay, of which sections.py makes sections.

A signal is the pulse after a chain of grains (dispersion), with a line source's tail, a P pulse of either sign, scattered
arrivals, a third crossing and noise; ranges.toml says how much of each. It counts as readable if somebody who may see it
without its noise finds the S pulse: the largest value up to 1.5 travel times is a peak within 5 % of the known delay, and the
noise is below a tenth of it.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.section import Pulse

RANGES = tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))
KINDS = tuple(name for name, value in RANGES.items() if isinstance(value, dict) and name not in {"common", "stations"})


@dataclass(frozen=True)
class Drawn:
    """What a signal is made of.

    Attributes
    ----------
    kind
        Table of ranges.toml.
    parts
        Its numbers.
    delay, frequency, interval
        Travel time of the S pulse (s), frequency of the sent one (Hz), time between two samples (s).
    count
        Number of samples.
    coda
        How much later than the S pulse (s) and how high each scattered arrival is.
    generator
        For the noise, which is drawn last.
    """

    kind: str
    parts: dict[str, float]
    delay: float
    frequency: float
    interval: float
    count: int
    coda: tuple[tuple[float, float], ...]
    generator: np.random.Generator

    def noise(self, generator: np.random.Generator, length: int) -> Floats:
        """Noise of the drawn rms and band; ``length`` numbers are drawn for it."""
        x = np.fft.rfftfreq(length, self.interval) / self.frequency
        spectrum = np.fft.rfft(generator.standard_normal(length)) * np.exp(-((x / self.parts["noise_band"]) ** 2))
        noise = np.fft.irfft(spectrum, length)[: self.count]
        return np.asarray(self.parts["noise"] * noise / noise.std())


class Medium:
    """The chain of grains that carries the sent pulse.

    Parameters
    ----------
    drawn
        What the signal is made of.
    length
        Samples of its spectra.
    """

    def __init__(self, drawn: Drawn, length: int) -> None:
        self.drawn, self.length = drawn, length
        self.sent = Pulse(1.0, drawn.frequency).velocity(np.arange(length) * drawn.interval)
        self._spectrum, self._f = np.fft.rfft(self.sent), np.fft.rfftfreq(length, drawn.interval)
        shape = (drawn.parts[name] for name in ("ringing", "resonance", "sharpness"))
        self._ring = _ringing(self._f / drawn.frequency, self.sent, *shape)

    def pulse(self, late: float, width: float, tail: float, part: float = 1.0, rung: float = 1.0) -> Floats:
        """Pulse of height 1 that a wave of this travel time brings, after this part of the grains and of the ringing."""
        grains = part * self.drawn.parts["grains"]
        passed = _chain(self._f, late, grains) * _widening(self._f, self.drawn.frequency, width)
        passed = passed * _tail(self._f, self.drawn.frequency, tail) * (1.0 + rung * (self._ring - 1.0))
        received = np.fft.irfft(self._spectrum * passed, self.length)[: self.drawn.count]
        return np.asarray(received / np.abs(received).max())


def draw_parts(seed: int, index: int) -> Drawn:
    """Draw what a signal is made of; it depends on seed and index alone."""
    generator = np.random.default_rng([seed, index])
    kind = KINDS[index % len(KINDS)]
    ranges = RANGES["common"] | RANGES[kind]
    drawn = {name: float(generator.uniform(*value)) for name, value in ranges.items() if isinstance(value, list)}
    low, high = ranges["velocity"]
    delay = RANGES["distance"] / float(np.exp(generator.uniform(np.log(low), np.log(high))))
    frequency = drawn["wavelengths"] / delay
    interval = 1.0 / (frequency * RANGES["samples_per_period"])
    coda = []
    for _ in range(int(drawn["coda_arrivals"])):
        later = ranges["coda_first"] + float(generator.exponential(ranges["coda_spread"]))
        height = drawn["coda"] * generator.uniform(-1.0, 1.0) * np.exp(-later / ranges["coda_decay"])
        coda.append((later / frequency, height))
    count = int((3.0 * delay + 4.0 / frequency) / interval)
    return Drawn(kind, drawn, delay, frequency, interval, count, tuple(coda), generator)


def draw_signal(seed: int, index: int) -> tuple[Floats, bool]:
    """The received signal over the peak of its S pulse, and whether it is readable; seed and index alone decide."""
    drawn = draw_parts(seed, index)
    parts, delay = drawn.parts, drawn.delay
    medium = Medium(drawn, 16 * drawn.count)
    shear = medium.pulse(delay, parts["width"], parts["tail"])
    clean = shear + parts["p_height"] * medium.pulse(delay / parts["p_ratio"], parts["width"] * parts["p_width"], 0.0)
    clean += parts["round_trip"] * medium.pulse(3.0 * delay, parts["width"], parts["tail"])
    for later, height in drawn.coda:
        clean += height * medium.pulse(delay + later, parts["width"], 0.0)
    sent = int(np.argmax(medium.sent)) * drawn.interval
    top = int(np.argmax(clean[: int((sent + RANGES["readable_until"] * delay) / drawn.interval)]))
    within = abs(top * drawn.interval - sent - delay) <= RANGES["readable_within"] * delay
    quiet = parts["noise"] <= RANGES["readable_noise"] * clean[top]
    return clean + drawn.noise(drawn.generator, 16 * drawn.count), bool(
        within and clean[top] >= clean[top + 1] and quiet
    )


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
