"""Whole cells of a campaign, written down for another program, and what calcidem records of them.

A cell is exported as the kernel has it just before the pulse: disks, contacts with their forces, bonds, walls, loads.
An ingredient of the laws can be left out of a cell for all programs alike.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.assembly import lanes_of_bits
from calcidem.dem.engine.leapfrog import run_in_place
from calcidem.dem.engine.scene import Law
from calcidem.dem.kernels.layout import NORMAL, OVERLAP, SHEAR, Floats, Recording, X, Y
from calcidem.dem.wave.experiment import TRANSMITTER, Experiment
from calcidem.dem.wave.propagation import Recorder, prepare_recorder
from calcidem.dem.wave.reading import Reading, read_section
from calcidem.dem.wave.section import quantise

ROOT = Path(__file__).resolve().parents[2]
_ENDLESS_FRICTION = 1.0e9  # nothing slips
_LANES = 8  # of kernels that campaigns have compiled already


@dataclass(frozen=True)
class Ingredients:
    """Laws that a cell is computed with.

    Attributes
    ----------
    law
        ``linear``: constant stiffnesses, the preset's. ``finite``: Hertz-Mindlin contacts that open, close and turn.
    damping
        With local damping, in the sample and in the layers at floor and lid.
    slip
        With Coulomb's limit of the shear force; without it contacts stick for ever. The linear law knows no slip.
    cement
        With bonds.
    """

    law: Law
    damping: bool = True
    slip: bool = True
    cement: bool = True


@dataclass(frozen=True)
class Cell:
    """One sample with its laws and its step.

    Attributes
    ----------
    experiment
        What calcidem measures with.
    bonded
        (C,) contacts of the packing that are cemented.
    frequency
        Of the pulse, Hz.
    """

    experiment: Experiment
    bonded: npt.NDArray[np.bool_]
    frequency: float


@dataclass(frozen=True)
class Signals:
    """What the disks of the receiver and of the stations did.

    Attributes
    ----------
    times
        (T,) s.
    motion
        (2, X, T) mean velocities of the groups across and along the path, m/s.
    """

    times: Floats
    motion: Floats

    @property
    def received(self) -> Floats:
        """(T,) velocity of the receiver across the path, m/s."""
        return np.asarray(self.motion[0, -1])


def preset_experiment(preset: str) -> Experiment:
    """Experiment of an example, with the packing that comes with calcidem."""
    configuration = load_configuration(ROOT / "examples" / f"{preset}.toml")
    return configuration.experiment(provide_packing(configuration, None))


def cell_of(experiment: Experiment, content: float, seed: int, ingredients: Ingredients, finer: float = 1.0) -> Cell:
    """Cell with the given laws and a step that is ``finer`` times smaller."""
    wave = replace(experiment.wave, law=ingredients.law, step_fraction=experiment.wave.step_fraction / finer)
    sand = experiment.sand
    if not ingredients.damping:
        wave = replace(wave, damping=0.0, boundary_damping=0.0)
    if not ingredients.slip:
        wave, sand = replace(wave, band_friction=_ENDLESS_FRICTION), replace(sand, friction=_ENDLESS_FRICTION)
    chosen = replace(experiment, wave=wave, sand=sand)
    # The peers keep the shear force of an unloading contact: PFC's mode 0, where campaigns have mode 1.
    vars(chosen)["bare_scene"] = replace(chosen.bare_scene, rescaling=False)
    bonded = np.asarray(experiment.ordering(seed).at(content).bonded)
    return Cell(chosen, bonded & ingredients.cement, experiment.frequency(content))


def recorder_of(cell: Cell) -> Recorder:
    """The cell, just before its pulse."""
    return prepare_recorder(cell.experiment, [cell.bonded], cell.frequency, _LANES, lambda: None)


def calcidem_signals(cell: Cell, duration: float) -> Signals:
    """What calcidem records of a cell."""
    recorder = recorder_of(cell)
    state = recorder.state
    step, stride = float(state.time_step[0]), recorder.stride
    samples = int(duration / (stride * step))
    recorded = _run(recorder, samples)
    return Signals(_times(step, stride, samples), recorded)


def _run(recorder: Recorder, samples: int) -> Floats:
    """(2, X, T) velocities that the kernel wrote down, not quantised."""
    state, groups = recorder.state, recorder.listeners * 2
    middle = (np.arange(samples * recorder.stride)[:, None] + 0.5) * state.time_step
    recording = Recording(
        drive=np.ascontiguousarray(recorder.pulse.velocity(middle)),
        driven=TRANSMITTER,
        driven_disks=recorder.driven_disks,
        offset=0,
        stride=recorder.stride,
        listeners=np.concatenate(groups),
        groups=np.cumsum([0, *map(len, groups)]),
        axes=np.repeat([Y, X], len(recorder.listeners)),
        samples=np.zeros((samples, len(groups), _LANES)),
    )
    run_in_place(state, samples * recorder.stride, recording)
    return recording.samples[:, :, 0].T.reshape(2, len(recorder.listeners), samples)


def _times(step: float, stride: int, samples: int) -> Floats:
    """Times of the samples: velocities of the leapfrog belong to the middle of a step."""
    return (np.arange(1, samples + 1) * stride - 0.5) * step


def export_cell(cell: Cell, duration: float, path: Path) -> tuple[float, int, int]:
    """Write down everything another program needs; return step, stride and number of samples."""
    recorder = recorder_of(cell)
    state, assembly = recorder.state, recorder.state.assembly
    pairs, wall_pairs, walls, grains = assembly.pairs, assembly.wall_pairs, assembly.walls, assembly.grains
    order, sand = assembly.order, state.scene.sand
    cemented = lanes_of_bits(pairs.intact, 1)[:, 0]
    touching = cemented | (pairs.geometry[:, OVERLAP] > 0.0)
    at_wall = wall_pairs.overlap > 0.0
    step, stride = float(state.time_step[0]), recorder.stride
    samples = int(duration / (stride * step))
    linear = state.features.linear
    felt = 0.0 if linear else 1.0
    sand_stiffness = np.column_stack([pairs.tangent, np.zeros(len(pairs.hertz))])
    values: dict[str, Any] = {
        "law": "linear" if linear else "finite",
        "x": np.asarray(state.scene.x)[order],
        "y": np.asarray(state.scene.y)[order],
        "radius": np.asarray(state.scene.radius)[order],
        "mass": state.scene.mass[order],
        "free": grains.inverse_mass > 0.0,
        "damping": grains.damping,
        "load": grains.load,
        "time_step": step,
        "stride": stride,
        "samples": samples,
        "amplitude": recorder.pulse.amplitude,
        "frequency": recorder.pulse.frequency,
        "shear_modulus": sand.shear_modulus,
        "poisson_ratio": sand.poisson_ratio,
        "density": sand.density,
        "friction": sand.friction,
        "pairs": np.column_stack([pairs.first, pairs.second])[touching],
        "cemented": cemented[touching],
        "stiffness": np.where(cemented[:, None], pairs.bond, sand_stiffness)[touching],
        # The linear law knows only forces that are added to those of the reference state.
        "normal_force": felt * pairs.bond_force[touching, NORMAL, 0],
        "shear_force": felt * np.where(cemented, pairs.bond_force[:, SHEAR, 0], pairs.shear[:, 0])[touching],
        "wall_disk": wall_pairs.disk[at_wall],
        "wall_normal": walls.normal[wall_pairs.wall[at_wall]],
        "wall_overlap": wall_pairs.overlap[at_wall],
        "wall_hertz": wall_pairs.hertz[at_wall],
        "wall_shear_hertz": 1.5 * grains.shear_ratio * wall_pairs.hertz[at_wall],
        "wall_stiffness": wall_pairs.tangent[at_wall],
        "wall_friction": np.minimum(walls.friction[wall_pairs.wall[at_wall]], sand.friction),
        "wall_driven": wall_pairs.wall[at_wall] == TRANSMITTER,
        "listeners": np.concatenate(recorder.listeners),
        "groups": np.cumsum([0, *map(len, recorder.listeners)]),
    }
    np.savez(path, **values)
    return step, stride, samples


def read_signals(path: Path, step: float, stride: int) -> Signals:
    """What another program recorded."""
    motion = np.load(path)
    return Signals(_times(step, stride, motion.shape[2]), motion)


def velocity_of(cell: Cell, signals: Signals) -> float | None:
    """Vs that calcidem reads from anybody's signals of a cell, m/s."""
    recorder = recorder_of(cell)
    empty = recorder.section_of(0)
    across, along = (np.ascontiguousarray(quantise(motion, empty.amplitude).T) for motion in signals.motion)
    interval = float(signals.times[1] - signals.times[0])
    section = replace(empty, sampling_interval=interval, start_time=float(signals.times[0]), across=across, along=along)
    reading = read_section(section, cell.experiment.clamp, cell.experiment.pick)
    return reading.peak if isinstance(reading, Reading) else None
