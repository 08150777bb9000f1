"""Film of a wave: velocities of all disks at equal intervals, in addition to the signals of a measurement."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import prepare_recorder
from calcidem.dem.wave.section import Section


@dataclass(frozen=True, slots=True, eq=False)
class _WaveFilm:
    """Motion of the computed disks in a wave."""

    x: Floats
    y: Floats
    radius: Floats
    """(N,) m, of the disks at rest."""
    times: Floats
    """(F,) s."""
    velocity: Floats
    """(F, N) along y, the direction of the transmitter's motion, m/s."""
    section: Section
    """Signals, identical to those of a measurement."""


def film_wave(
    experiment: Experiment,
    bonded: Flags,
    frequency: float,
    *,
    frames: int,
    samples: int | None = None,
    lanes: int = 8,
    watch: Callable[[int, int], None] = lambda _done, _all: None,
) -> _WaveFilm:
    """Transmit a pulse through one sample, and record its disks at equal intervals.

    Parameters
    ----------
    experiment, bonded, frequency, lanes
        As for `calcidem.dem.wave.propagation.send_waves`; one sample's contacts.
    frames
        Largest number of frames.
    samples
        Length of the signals; by default the longest of a measurement.
    watch
        Called with the number of finished and of all frames; may raise to end the run.
    """
    recorder = prepare_recorder(experiment, [bonded], frequency, lanes, lambda: None)
    interval = recorder.stride * float(recorder.state.time_step[0])
    samples = samples or int(np.ceil(recorder.longest / interval))
    stride = -(-samples // frames)
    times, velocity = [], []
    for begin in range(0, samples, stride):
        recorder.record_chunk(min(stride, samples - begin))
        times.append(float(recorder.state.time[0]))
        velocity.append(recorder.state.velocity()[:, 1].astype(np.float32))
        watch(len(times), -(-samples // stride))
    scene = recorder.state.scene
    return _WaveFilm(scene.x, scene.y, scene.radius, np.array(times), np.array(velocity), recorder.section_of(0))
