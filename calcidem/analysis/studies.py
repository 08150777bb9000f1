"""Sensitivity studies: how reading, damping and excitation frequency change Vs (section 3.1 of the paper)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from scipy.signal import peak_widths

from calcidem.dem.arrival import read_arrival
from calcidem.dem.measurement import Experiment, Measurement, measure, signals_of
from calcidem.dem.wave import WaveRecord, send_waves

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

METHODS = ("peak", "first_arrival", "cross_correlation")
FREQUENCIES = (2e3, 4e3, 8e3, 12e3, 16e3, 20e3, 25e3, 30e3)
DAMPING_FACTORS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
TIMES = 600
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
        Samples of each content, at most eight.
    check
        Called every fraction of a second; may raise to end the study.

    Returns
    -------
    xarray.Dataset
        `vs_peak`, `vs_first_arrival`, `vs_cross_correlation` (m/s) and `received_frequency` (Hz) along (content,
        frequency, seed), NaN where nothing trustworthy was read; `campaign_frequency` (Hz) along content: what
        the experiment itself would send.
    """
    shape = (len(contents), len(frequencies), len(seeds))
    values = {name: np.full(shape, np.nan) for name in (*(f"vs_{m}" for m in METHODS), "received_frequency")}
    for row, content in enumerate(contents):
        for column, frequency in enumerate(frequencies):
            single = replace(experiment, frequencies=(WHOLE_RANGE, (frequency, frequency)))
            for place, measurement in enumerate(measure(single, content, seeds, check=check)):
                for name, value in readings(single, measurement).items():
                    values[name][row, column, place] = value
    dimensions = ("content", "frequency", "seed")
    study = xr.Dataset(
        {name: (dimensions, numbers) for name, numbers in values.items()},
        coords={"content": list(contents), "frequency": list(frequencies), "seed": list(seeds)},
    )
    study["campaign_frequency"] = "content", [experiment.frequency(content) for content in contents]
    for name in study.variables:
        study[name].attrs["units"] = _unit(str(name))
    return study


def damping_study(
    experiment: Experiment,
    *,
    contents: Sequence[float] = (0.11, 0.66),
    factors: Sequence[float] = DAMPING_FACTORS,
    seed: int = 1,
    duration: float = 1.0e-3,
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
    duration
        Length of the record, s.
    check
        Called every fraction of a second; may raise to end the study.

    Returns
    -------
    xarray.Dataset
        `received` (the signal that the experiment reads, in its unit) along (content, damping, time), and
        `vs_peak` (m/s) along (content, damping), NaN where nothing trustworthy was read.
    """
    time = np.linspace(0.0, duration, TIMES)
    received = np.zeros((len(contents), len(factors), TIMES))
    velocity = np.full(received.shape[:2], np.nan)
    for row, content in enumerate(contents):
        for column, factor in enumerate(factors):
            damped = replace(experiment, wave=replace(experiment.wave, damping=factor))
            record = long_record(damped, content, seed, duration, check)
            if record.problem:
                received[row, column] = np.nan
                continue
            signals = signals_of(record, damped)
            received[row, column] = np.interp(time, np.arange(len(record.sent)) * record.interval, signals.received)
            peak = read_arrival(signals, damped.pick).peak
            if peak.velocity is not None and peak.quality >= damped.least_quality:
                velocity[row, column] = peak.velocity
    study = xr.Dataset(
        {"received": (("content", "damping", "time"), received), "vs_peak": (("content", "damping"), velocity)},
        coords={"content": list(contents), "damping": list(factors), "time": time},
        attrs={"seed": seed},
    )
    for name in study.variables:
        study[name].attrs["units"] = _unit(str(name))
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
        )
    return found


def pulse_frequency(signal: NDArray[np.float64], interval: float, moment: float) -> float:
    """Give the frequency of the pulse that peaks at a moment: one over twice its width at half height.

    For ``v0 (1 - cos 2 pi f t)`` this is exactly f. A spectrum would not do: a pulse of one sign has its largest
    amplitude at frequency zero.

    Parameters
    ----------
    signal
        Any unit, shape (t,).
    interval
        Between its samples, s.
    moment
        Time of the peak, s; the largest value within two samples of it is taken.
    """
    near = round(moment / interval)
    begin = max(1, near - 2)
    top = begin + int(np.argmax(signal[begin : near + 3]))
    # Counted from zero, not from the trough before: that is what the height of a pulse means.
    width = float(peak_widths(np.maximum(signal, 0.0), [top], rel_height=0.5)[0][0])
    return 1.0 / (2.0 * width * interval)


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


def _unit(name: str) -> str:
    known = {"content": "%", "seed": "1", "damping": "1", "time": "s", "received": "1"}
    return known.get(name, "Hz" if "frequency" in name else "m/s")
