"""Sensitivity studies: how reading, damping and excitation frequency change Vs (section 3.1 of the paper)."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.dem.wave.arrival import read_arrival
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure, signals_of
from calcidem.dem.wave.propagation import WaveRecord, send_waves

METHODS = ("peak", "first_arrival", "cross_correlation")
FREQUENCIES = (4e3, 8e3, 12e3, 16e3, 20e3, 25e3)
DAMPING_FACTORS = (0.1, 0.2, 0.3, 0.5, 0.7)
LANES = (4, 8, 16, 32)
SAMPLES = 600
UNITS = {"content": "%", "seed": "1", "damping": "1", "time": "s"}
WHOLE_RANGE = (0.0, 100.0)


def frequency_study(
    experiment: Experiment,
    *,
    contents: Sequence[float] = (0.66, 3.17, 6.0, 8.0),
    frequencies: Sequence[float] = FREQUENCIES,
    seeds: Sequence[int] = (1, 2, 3, 4),
    check: Callable[[], None] = lambda: None,
) -> xr.Dataset:
    """Measure the same samples with several excitation frequencies (Figs. 6 and 9 of the paper).

    Parameters
    ----------
    experiment
        What all samples share; its frequencies are replaced.
    contents
        Percent of the sand's mass.
    frequencies
        Hz, positive.
    seeds
        Samples of each content, at most 32.
    check
        Called every fraction of a second; may raise to end the study.

    Returns
    -------
    xarray.Dataset
        `vs_peak`, `vs_first_arrival`, `vs_cross_correlation` (m/s) and `received_frequency` (Hz) along (content,
        frequency, seed), NaN where nothing trustworthy was read; `campaign_frequency` (Hz) along content: what
        the experiment itself would send; the attribute `distance` (m) between transmitter and receiver.
    """
    shape = (len(contents), len(frequencies), len(seeds))
    values = {name: np.full(shape, np.nan) for name in (*(f"vs_{m}" for m in METHODS), "received_frequency")}
    lanes = next(width for width in LANES if width >= len(seeds))
    for row, content in enumerate(contents):
        for column, frequency in enumerate(frequencies):
            single = replace(experiment, frequencies=(WHOLE_RANGE, (frequency, frequency)))
            for place, measurement in enumerate(measure(single, content, seeds, lanes=lanes, check=check)):
                for name, value in readings(single, measurement).items():
                    values[name][row, column, place] = value
    dimensions = ("content", "frequency", "seed")
    study = xr.Dataset(
        {name: (dimensions, numbers) for name, numbers in values.items()},
        coords={"content": list(contents), "frequency": list(frequencies), "seed": list(seeds)},
        attrs={"distance": experiment.packing.width},
    )
    study["campaign_frequency"] = "content", [experiment.frequency(content) for content in contents]
    _set_units(study)
    return study


def damping_study(
    experiment: Experiment,
    *,
    contents: Sequence[float] = (0.11, 0.66),
    factors: Sequence[float] = DAMPING_FACTORS,
    seed: int = 1,
    periods: float = 5.0,
    check: Callable[[], None] = lambda: None,
) -> xr.Dataset:
    """Measure one sample of each content with several local damping factors (Fig. 7 of the paper).

    Parameters
    ----------
    experiment
        What all samples share; its damping is replaced, that of the boundary layers kept.
    contents
        Percent of the sand's mass.
    factors
        Local damping factors, 0 to 1.
    seed
        Which sample.
    periods
        Length of the records in periods of the pulse.
    check
        Called every fraction of a second; may raise to end the study.

    Returns
    -------
    xarray.Dataset
        `received` (the signal that the experiment reads, in its unit) along (content, damping, sample), `time`
        (s) along (content, sample), and `vs_peak` (m/s) along (content, damping), NaN where nothing trustworthy
        was read.
    """
    time = np.stack([np.linspace(0.0, periods / experiment.frequency(content), SAMPLES) for content in contents])
    received = np.zeros((len(contents), len(factors), SAMPLES))
    velocity = np.full(received.shape[:2], np.nan)
    for row, content in enumerate(contents):
        for column, factor in enumerate(factors):
            damped = replace(experiment, wave=replace(experiment.wave, damping=factor))
            record = long_record(damped, content, seed, float(time[row, -1]), check)
            if record.problem:
                received[row, column] = np.nan
                continue
            signals = signals_of(record, damped)
            received[row, column] = np.interp(
                time[row], np.arange(len(record.sent)) * record.interval, signals.received
            )
            peak = read_arrival(signals, damped.pick).peak
            if peak.velocity is not None and peak.quality >= damped.least_quality:
                velocity[row, column] = peak.velocity
    study = xr.Dataset(
        {"received": (("content", "damping", "sample"), received), "vs_peak": (("content", "damping"), velocity)},
        coords={"content": list(contents), "damping": list(factors), "time": (("content", "sample"), time)},
        attrs={"seed": seed},
    )
    _set_units(study)
    study["received"].attrs["units"] = "m/s" if experiment.signal == "velocity" else "N/m"
    return study


def readings(experiment: Experiment, measurement: Measurement) -> dict[str, float]:
    """Give what could be trusted of a measurement: vs by each method in m/s, and the received frequency in Hz."""
    found: dict[str, float] = {}
    if measurement.picks is None:
        return found
    for method in METHODS:
        reading = getattr(measurement.picks, method)
        if reading.velocity is not None and reading.quality >= experiment.least_quality:
            found[f"vs_{method}"] = reading.velocity
    peak = measurement.picks.peak
    if peak.travel_time is not None and "vs_peak" in found:
        found["received_frequency"] = pulse_frequency(
            signals_of(measurement.record, experiment).received,
            measurement.record.interval,
            peak.travel_time + 0.5 / measurement.frequency,
            reach=0.1 / measurement.frequency,
        )
    return found


def pulse_frequency(signal: NDArray[np.float64], interval: float, moment: float, reach: float) -> float:
    """Give the frequency of the pulse that peaks at a moment: one over twice its width at half height.

    For ``v0 (1 - cos 2 pi f t)`` this is exactly f. A spectrum would not do: a pulse of one sign has its largest
    amplitude at frequency zero.

    Parameters
    ----------
    signal
        Any unit, shape (t,).
    interval
        Between its samples, s.
    moment, reach
        Time of the peak, and how far from it the largest value may be, s.

    Returns
    -------
    float
        Hz; NaN if the signal does not fall to half its peak on both sides.
    """
    near, wide = round(moment / interval), max(1, round(reach / interval))
    begin = max(0, near - wide)
    top = begin + int(np.argmax(signal[begin : near + wide + 1]))
    half = signal[top] / 2
    before, after = np.flatnonzero(signal[:top] < half), np.flatnonzero(signal[top:] < half)
    if not (signal[top] > 0 and before.size and after.size):
        return float("nan")
    rise, fall = int(before[-1]), top + int(after[0])
    began = rise + (half - signal[rise]) / (signal[rise + 1] - signal[rise])
    ended = fall - (half - signal[fall]) / (signal[fall - 1] - signal[fall])
    return float(1.0 / (2.0 * (ended - began) * interval))


def long_record(
    experiment: Experiment, content: float, seed: int, duration: float, check: Callable[[], None]
) -> WaveRecord:
    """Record one sample for a given time in s, whatever arrives when."""
    packing, sand = experiment.stiffened()
    return send_waves(
        packing,
        sand,
        experiment.cement,
        [experiment.ordering(seed).at(content).bonded],
        experiment.frequency(content),
        replace(experiment.wave, slowest=packing.width / duration),
        heard_enough=lambda record: len(record.sent) * record.interval >= duration,
        lanes=1,
        installation=experiment.installation,
        check=check,
    )[0]


def _set_units(study: xr.Dataset) -> None:
    for name, variable in study.variables.items():
        variable.attrs["units"] = UNITS.get(str(name), "Hz" if "frequency" in str(name) else "m/s")
