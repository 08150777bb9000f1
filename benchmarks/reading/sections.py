"""Sections of the signals of signals.py: what stations on the path record of the same waves.

Each station records at its own time, as far as the wave has come, with what swings at the receiver only near it, and scattered
arrivals that come along the same path, from elsewhere or back; ranges.toml says how much. judge.py judges a reading on them.
"""

from collections.abc import Iterable

import numpy as np
from section import Section
from signals import RANGES, Medium, draw_parts, draw_signal

from calcidem.dem.kernels.layout import Floats

_RULES = RANGES["stations"]


def drawn_sections(seeds: Iterable[int], count: int = _RULES["signals"]) -> list[Section]:
    """Sections of each seed, ``count`` of them."""
    return [draw_section(seed, index) for seed in seeds for index in range(count)]


def draw_section(seed: int, index: int) -> Section:
    """Draw one signal, and what the stations record of its waves."""
    (received, readable), drawn = draw_signal(seed, index), draw_parts(seed, index)
    generator = np.random.default_rng([seed, index, 1])
    medium, count = Medium(drawn, 4 * drawn.count), _RULES["count"]
    places = np.linspace(*_RULES["places"], count)
    growth = float(generator.uniform(*_RULES["p_growth"]))
    origins = [_draw_origin(generator) for _ in drawn.coda]
    near_ends = places * np.minimum(1.0, 5.0 * (1.0 - places))
    late = _RULES["lateness"] * drawn.delay * near_ends * generator.standard_normal(count)
    loud = np.exp(_RULES["loudness"] * generator.standard_normal(count))
    columns = []
    for place, lateness, loudness in zip(places.tolist(), late.tolist(), loud.tolist(), strict=True):
        waves = _first_waves(medium, place, lateness, growth) + _echoes(medium, place)
        for (later, height), origin in zip(drawn.coda, origins, strict=True):
            waves += height * _scattered(medium, place, later, origin)
        columns.append(loudness * (waves + drawn.noise(generator, drawn.count)))
    ends = np.append(places, 1.0)
    along = _draw_along(np.random.default_rng([seed, index, 2]), medium, ends, growth)
    return Section(
        kind=drawn.kind,
        group=index,
        times=drawn.interval * np.arange(drawn.count),
        places=ends,
        across=np.column_stack([*columns, received]).T,
        along=along.T,
        distance=RANGES["distance"],
        amplitude=1.0,
        frequency=drawn.frequency,
        delay=drawn.delay,
        delay_error=0.0,
        aperture=float("inf"),
        clamp=0.0,
        readable=readable,
    )


def _draw_along(generator: np.random.Generator, medium: Medium, places: Floats, growth: float) -> Floats:
    """Motion along the way at each place: that of the P wave, of what it leaves behind, and a part of all others."""
    drawn, rules = medium.drawn, _RULES["along"]
    parts, period = drawn.parts, 1.0 / drawn.frequency
    height = max(abs(parts["p_height"]) / generator.uniform(*rules["p_share"]), generator.uniform(*rules["p_height"]))
    p_width = parts["width"] * parts["p_width"] * float(generator.uniform(*rules["p_wider"]))
    behind = [
        (float(generator.exponential(rules["p_coda_spread"])), float(generator.uniform(-1.0, 1.0)))
        for _ in range(int(generator.uniform(*rules["p_coda_arrivals"])))
    ]
    coda = generator.uniform(*rules["p_coda"]) * height
    shares = generator.uniform(-1.0, 1.0, len(drawn.coda))
    columns = []
    for place in places.tolist():
        part, p_time = max(place, 0.08), place * drawn.delay / parts["p_ratio"]
        loudness, leak = np.exp(rules["loudness"] * generator.standard_normal()), rules["leak"]
        leak *= np.exp(rules["leak_spread"] * generator.standard_normal()) * generator.choice([-1.0, 1.0])
        p_late, s_late = rules["p_lateness"] * period * generator.standard_normal(2)
        waves = height * loudness * place**growth * medium.pulse(p_time + p_late, p_width, 0.0, part)
        waves += leak * medium.pulse(place * drawn.delay + s_late, parts["width"], parts["tail"], part)
        for later, share in behind:
            decay = np.exp(-later / rules["p_coda_decay"])
            waves += coda * share * decay * place**growth * medium.pulse(p_time + later * period, p_width, 0.0, part)
        for (later, high), share in zip(drawn.coda, shares.tolist(), strict=True):
            waves += high * share * medium.pulse(place * drawn.delay + later, parts["width"], 0.0, part)
        columns.append(waves + drawn.noise(generator, drawn.count))
    return np.column_stack(columns)


def _draw_origin(generator: np.random.Generator) -> tuple[int, float, float]:
    """Which of the four a scattered arrival is, where it begins, and its slowness over the S wave's."""
    return int(generator.integers(4)), *(float(generator.uniform(*_RULES[name])) for name in ("begins", "slowness"))


def _first_waves(medium: Medium, place: float, lateness: float, growth: float) -> Floats:
    """S and P wave, each as wide as it has become."""
    drawn = medium.drawn
    parts, delay, part = drawn.parts, place * drawn.delay, max(place, 0.08)
    swing = float(np.exp((place - 1.0) / _RULES["swing_reach"]))

    def width(whole: float) -> float:
        return float(np.sqrt(1.0 + max(0.0, whole**2 - 1.0) * place))

    shear = medium.pulse(delay + lateness, width(parts["width"]), parts["tail"], part, swing)
    p_width = width(parts["width"] * parts["p_width"])
    pressure = medium.pulse(delay / parts["p_ratio"], p_width, 0.0, part, swing)
    return np.asarray(shear + parts["p_height"] * place**growth * pressure)


def _echoes(medium: Medium, place: float) -> Floats:
    """What comes back from the receiver, and what crosses the sample a third time."""
    drawn = medium.drawn
    parts, trip = drawn.parts, drawn.parts["round_trip"]
    back = np.copysign(_RULES["reflected"] * np.sqrt(abs(trip)), trip)
    back *= np.exp((place - 1.0) / _RULES["reflected_reach"])
    first, second = (
        medium.pulse(ways * drawn.delay, parts["width"], parts["tail"]) for ways in (2.0 - place, 2.0 + place)
    )
    return np.asarray(back * first + trip * second)


def _scattered(medium: Medium, place: float, later: float, origin: tuple[int, float, float]) -> Floats:
    """One scattered arrival, of height 1 at the receiver."""
    (kind, begins, slowness), delay = origin, medium.drawn.delay
    away = 1.0 - place
    there = 1.0 if place > begins else 0.0
    lead = (0.0, -away, away * slowness, -away * slowness)[kind] * delay
    height = (
        np.exp(-away / _RULES["near_reach"]),
        there,
        np.exp(-away / _RULES["back_reach"]),
        max(there, _RULES["across_before"]),
    )[kind]
    if height < _RULES["least"]:
        return np.zeros(medium.drawn.count)
    return np.asarray(height * medium.pulse(delay + later + lead, medium.drawn.parts["width"], 0.0))
