"""Sections of waves that calcidem.dem sends through lattices of disks, with a delay that is known from elsewhere.

One seed is one simulation of eight samples side by side: a hexagonal or square lattice, as it is, tilted, with jittered
disks of unequal mass, with contacts cemented at random, or cemented in patches. A part of its left edge is driven, or
rubbed by a wall, and may move along the path, too. Each sample is listened to at three receivers, without and with noise.

The known delay is that of a *plane S wave in an endless lattice*: the whole edge moves across the path, and nothing comes
back. Near field, aperture and what a rigid end does to the peak are thus errors of the reading. The delay comes from an
independent solution (`plane_wave`): the same disks in a cell that repeats itself in height, with the stiffness matrix of
benchmarks/verification, without the kernel. Tilted lattices repeat themselves nowhere; the pulse's spectrum is
propagated with the exact dispersion of their quasi-shear branch instead (`bloch_delay`). In a disordered lattice a plane wave
arrives at different heights at different times. The delay is that of the receiver's band; a section is left out where the
mean over the whole height differs from it by more than 2 %, or the plane wave has a second peak of 0.75 of the first.
"""

import sys
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import eigsh
from scipy.spatial import cKDTree
from section import Section, peak_time

sys.path.append(str(Path(__file__).resolve().parents[1] / "verification"))

from reference import Grain, Springs, bloch_matrices, stiffness_matrix

from calcidem.dem.engine.leapfrog import run_in_place
from calcidem.dem.engine.scene import Bonds, Cement, Sand, Scene, Wall
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.layout import Flags, Floats, Integers, Recording
from calcidem.dem.wave.section import Pulse, clamp_of_strip

KINDS = ("hexagonal", "square", "tilted", "jittered", "mixed", "patches")
LANES = 8
RADIUS, OVERLAP = 1.0e-3, 2.0e-5  # m
SPACING = 2.0 * RADIUS - OVERLAP
SLICES = 30  # of the width, whose mean velocities are recorded
SAMPLES_PER_PERIOD = 100
_PATHS = 0.4, 4.5  # wavelengths
KNOWN_TO = 0.02  # of the delay
_RIVAL = 0.75  # height of a second peak of the plane wave over its first that leaves the delay unknown
_SOON = 1.7  # delays until when it counts
_LAYER = 4.0 * SPACING  # damped at floor and lid
_NOISY = 0.5  # of the sections have noise


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A cell of disks from a transmitter at the left to beyond the receivers, which repeats itself in height.

    Attributes
    ----------
    x, y, radius
        (N,) m; ``y`` from 0 to ``height``.
    width, height
        m; of the part that has receivers, and of the cell.
    driven
        (N,) first column.
    last
        (N,) last column, which is held.
    pairs, image
        (M, 2) neighbours, and (M,) by how many cells the second is higher.
    cemented
        (M, L) in each lane.
    grain, cement
        Materials.
    """

    x: Floats
    y: Floats
    radius: Floats
    width: float
    height: float
    driven: Flags
    last: Flags
    pairs: Integers
    image: Integers
    cemented: Flags
    grain: Grain
    cement: Cement
    square: bool


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """How waves are sent through one lattice.

    Attributes
    ----------
    kind
        One of `KINDS`.
    tilt
        Angle of the lattice, rad.
    slant
        Angle of the transmitter's motion to the normal of the path, rad.
    rubbed
        By a wall, instead of driven disks.
    closed
        Whether disks beyond the width are held: a rigid end right behind the receivers.
    half_aperture, half_band
        Half-heights of the transmitter and of stations and receiver, m.
    damping
        Local damping factor.
    frequencies
        (L,) Hz.
    copies
        Cells on top of one another; an odd number, in the middle one of which is the path.
    """

    kind: str
    tilt: float
    slant: float
    rubbed: bool
    closed: bool
    half_aperture: float
    half_band: float
    damping: float
    frequencies: tuple[float, ...]
    copies: int


def sections_of_seed(seed: int) -> list[Section]:
    """Sections of one simulation; they depend on the seed alone."""
    generator = np.random.default_rng([seed, 77])
    lattice, trial = draw_trial(generator, KINDS[seed % len(KINDS)])
    times, across, along, distances = simulate(lattice, trial)
    ranges = ((24, 27), (27, 30)) if trial.closed else ((13, 19), (19, 25), (25, 30))
    receivers = [int(generator.integers(*ends)) for ends in ranges]
    twins = plane_waves(lattice, trial)
    sections = []
    for lane, frequency in enumerate(trial.frequencies):
        for receiver in receivers:
            path = float(distances[receiver])
            if trial.kind == "tilted":
                delay, error = bloch_delay(lattice, trial, lane, path)
            else:
                delay, error = twins[lane].delay(receiver, path)
            stations = _draw_stations(generator, receiver)
            noise = _by_chance(generator, _NOISY)
            if not (error < KNOWN_TO and _PATHS[0] <= delay * frequency <= _PATHS[1]):
                continue
            rows = [*stations, receiver]
            even = np.arange(0.0, _duration(delay, frequency), 1.0 / (SAMPLES_PER_PERIOD * frequency))
            wavelength = path / (float(delay) * frequency)
            clean = Section(
                kind=trial.kind,
                group=seed,
                times=even,
                places=distances[rows] / path,
                across=_resampled(times, across[:, rows, lane], even),
                along=_resampled(times, along[:, rows, lane], even),
                distance=path,
                amplitude=float(np.cos(trial.slant)),
                frequency=frequency,
                delay=delay,
                delay_error=error,
                aperture=trial.half_aperture / wavelength,
                clamp=clamp_of_strip(trial.copies * lattice.height - 2.0 * _LAYER),
                readable=False,
            )
            sections.append(
                _disturbed(generator, clean) if noise else replace(clean, readable=_is_readable(clean, 0.0))
            )
    return sections


def draw_trial(generator: np.random.Generator, kind: str) -> tuple[Lattice, Trial]:
    """Draw a lattice of a kind, and how waves are sent through it."""
    square = kind == "square" or (kind != "hexagonal" and _by_chance(generator, 0.35))
    upright = not square and _by_chance(generator, 0.5)  # rows of touching disks up instead of along the path
    tilt = float(np.radians(generator.uniform(4.0, 26.0))) if kind == "tilted" else 0.0
    columns = int(generator.integers(46, 60)) if kind in KINDS[:3] else int(generator.integers(36, 46))
    cell_height = SPACING * (2.0 if kind in KINDS[:2] else columns * float(generator.uniform(0.7, 0.9)))
    path = 0.93 * columns * SPACING
    most = np.exp(generator.uniform(np.log(0.5), np.log(4.2)) + generator.uniform(-0.35, 0.35, LANES))
    wavelengths = path / np.minimum(most, path / (9.0 * SPACING))
    # So long that what its end throws back finds the peak gone.
    length = columns + int(0.5 * wavelengths.max() / SPACING)
    grain = Grain(1.0e12, float(generator.uniform(0.2 if square else -0.6, 0.49)), Sand().density, Sand().friction)
    lowest, highest = {"jittered": (1.0, 1.0), "mixed": (0.2, 10.0), "patches": (0.2, 25.0)}.get(kind, (0.5, 4.0))
    contrast = float(np.exp(generator.uniform(np.log(lowest), np.log(highest))))
    normal = 1.5 * grain.hertz(RADIUS, RADIUS) * np.sqrt(OVERLAP)
    ratio = float(generator.uniform(1.0, 2.4) if square else np.exp(generator.uniform(0.0, np.log(8.0))))
    cement = Cement(bond_modulus=contrast * float(normal), bond_stiffness_ratio=ratio)
    shape = {"square": square, "upright": upright, "tilt": tilt}
    whole = columns * SPACING * float(generator.uniform(1.7, 3.0))
    places = _places(length, whole if tilt else cell_height, **shape)
    copies = 1 if tilt else 1 + 2 * round(0.5 * (whole / places[2] - 1.0))
    lattice = _lattice_of(places, columns, grain, cement, square=square, periodic=not tilt)
    if kind == "jittered":
        lattice = _jittered(generator, lattice)
    lattice = replace(lattice, cemented=_draw_cement(generator, kind, lattice))
    whole = copies * lattice.height
    frequencies = long_wave_speeds(lattice) / wavelengths
    plane = _by_chance(generator, 0.35)
    narrow = float(wavelengths.mean() * np.exp(generator.uniform(np.log(0.08), np.log(1.5))))
    half_aperture = 0.48 * whole if plane else max(2.0 * SPACING, min(narrow, 0.45 * whole))
    rubbed = kind not in {"tilted", "jittered"} and _by_chance(generator, 0.3)
    slanted = not rubbed and _by_chance(generator, 0.35)
    lossy = kind != "tilted" and not slanted and _by_chance(generator, 0.6)
    return lattice, Trial(
        kind=kind,
        tilt=tilt,
        slant=float(np.radians(generator.uniform(-30.0, 30.0))) if slanted else 0.0,
        rubbed=rubbed,
        closed=_by_chance(generator, 0.4),
        half_aperture=half_aperture,
        half_band=float(generator.uniform(0.06, 0.3)) * lattice.width,
        damping=float(generator.uniform(0.0, 0.5)) if lossy else 0.0,
        frequencies=tuple(frequencies.tolist()),
        copies=copies,
    )


def _by_chance(generator: np.random.Generator, share: float) -> bool:
    """True in this share of the cases."""
    return bool(generator.uniform() < share)


def _places(columns: int, height: float, *, square: bool, upright: bool, tilt: float) -> tuple[Floats, Floats, float]:
    """Places of the disks of a lattice, and the height of the cell: an even number of its rows unless tilted."""
    rise = SPACING if square else SPACING * np.sqrt(0.75)
    if tilt:
        count = 2 * columns
        column, row = np.meshgrid(np.arange(-count, count), np.arange(-count, count))
        x, y = (column + (0.0 if square else 0.5) * (row % 2)) * SPACING, row * rise
        x, y = np.cos(tilt) * x - np.sin(tilt) * y, np.sin(tilt) * x + np.cos(tilt) * y
        inside = (x >= 0.0) & (x < columns * SPACING) & (y >= 0.0) & (y < height)
        return x[inside], y[inside], height
    step_x, step_y = (rise, SPACING) if upright else (SPACING, rise)
    across = round(columns * SPACING / step_x)
    rows = 2 * max(1, round(0.5 * height / step_y))
    column, row = (values.ravel() for values in np.meshgrid(np.arange(across), np.arange(rows)))
    shift = 0.0 if square else 0.5
    x = (column + (0.0 if upright else shift) * (row % 2)) * step_x
    y = (row + (shift if upright else 0.0) * (column % 2)) * step_y
    return x, y, rows * step_y


def _lattice_of(
    places: tuple[Floats, Floats, float], columns: int, grain: Grain, cement: Cement, *, square: bool, periodic: bool
) -> Lattice:
    """Equal disks at these places with all their neighbours, also in the next cell if periodic."""
    (x, y, height), reach = places, 1.2 * SPACING
    count = len(x)
    lower = np.flatnonzero(y < 2.0 * SPACING) if periodic else np.zeros(0, dtype=np.int64)
    points = np.column_stack([np.concatenate([x, x[lower]]), np.concatenate([y, y[lower] + height])])
    found = cKDTree(points).query_pairs(reach, output_type="ndarray")
    found = np.sort(found, axis=1)
    found = found[found[:, 0] < count]
    image = (found[:, 1] >= count).astype(np.int64)
    origin = np.concatenate([np.arange(count), lower])
    pairs = np.column_stack([found[:, 0], origin[found[:, 1]]])
    edge = 0.75 * SPACING
    return Lattice(
        x=x,
        y=y,
        radius=np.full(count, RADIUS),
        width=columns * SPACING,
        height=height,
        driven=x < edge,
        last=x > x.max() - edge,
        pairs=pairs,
        image=image,
        cemented=np.zeros((len(pairs), LANES), dtype=bool),
        grain=grain,
        cement=cement,
        square=square,
    )


def _jittered(generator: np.random.Generator, lattice: Lattice) -> Lattice:
    """The lattice with disks of unequal radii, and so masses, aside of their places."""
    count = len(lattice.x)
    aside = generator.uniform(0.01, 0.09) * SPACING * generator.uniform(-1.0, 1.0, (2, count))
    aside[:, lattice.driven | lattice.last] = 0.0
    radius = RADIUS * (1.0 - generator.uniform(0.0, 0.3) * generator.uniform(0.0, 1.0, count))
    return replace(lattice, x=lattice.x + aside[0], y=lattice.y + aside[1], radius=radius)


def _draw_cement(generator: np.random.Generator, kind: str, lattice: Lattice) -> Flags:
    """(M, L) pairs that are cemented in each lane."""
    count = len(lattice.pairs)
    if kind == "jittered":
        missing = np.where(np.arange(LANES) % 2, generator.uniform(0.0, 0.12, LANES), 0.0)
        return np.asarray(generator.uniform(size=(count, LANES)) >= missing)
    if kind == "mixed":
        return np.asarray(generator.uniform(size=(count, LANES)) < generator.uniform(0.1, 0.9, LANES))
    cemented = np.zeros((count, LANES), dtype=bool)
    if kind != "patches":
        cemented[:, 1::2] = True
        return cemented
    middle_x, middle_y = lattice.x[lattice.pairs[:, 0]], lattice.y[lattice.pairs[:, 0]]
    for lane in range(LANES):
        radius = 0.5 * generator.uniform(4.0, 14.0) * SPACING
        area = generator.uniform(0.1, 0.6) * lattice.width * lattice.height
        for _ in range(round(area / (np.pi * radius**2))):
            away = middle_y - generator.uniform(0.0, lattice.height)
            away = np.abs(away - lattice.height * np.round(away / lattice.height))
            cemented[:, lane] |= np.hypot(middle_x - generator.uniform(0.0, lattice.width), away) < radius
    return cemented


def springs_of(lattice: Lattice, cemented: Flags) -> Springs:
    """Contacts of a pattern of cement (M,)."""
    first, second = lattice.radius[lattice.pairs.T]
    apart = _apart(lattice)
    distance = np.hypot(*apart.T)
    overlap = first + second - distance
    sand = 1.5 * lattice.grain.hertz(first, second) * np.sqrt(np.maximum(overlap, 0.0))
    smaller = np.minimum(first, second)
    modulus = lattice.cement.bond_modulus / (first + second)
    bond = 2.0 * modulus * smaller
    stiffness = np.stack(
        [
            np.where(cemented, bond, sand),
            np.where(cemented, bond / lattice.cement.bond_stiffness_ratio, lattice.grain.shear_share * sand),
            np.where(cemented, 2.0 / 3.0 * modulus * smaller**3, 0.0),
        ]
    )
    arms = np.stack([first, second]) - 0.5 * overlap
    return Springs(*lattice.pairs.T, apart / distance[:, None], arms, stiffness, np.zeros(len(first)))


def _apart(lattice: Lattice) -> Floats:
    """(M, 2) from the first disk of each pair to the second, m."""
    first, second = lattice.pairs.T
    up = lattice.y[second] + lattice.image * lattice.height - lattice.y[first]
    return np.column_stack([lattice.x[second] - lattice.x[first], up])


def long_wave_speeds(lattice: Lattice) -> Floats:
    """(L,) speeds of S waves by closed forms, m/s, with the geometric mean of the stiffnesses where these differ."""
    speeds = []
    for cemented in lattice.cemented.T:
        known = springs_of(lattice, cemented).stiffness[:2]
        normal, shear = (np.exp(np.log(values[values > 0.0]).mean()) for values in known)
        mass = lattice.grain.mass(lattice.radius).mean()
        speeds.append(SPACING * np.sqrt(0.5 * shear / mass if lattice.square else 0.375 * (normal + shear) / mass))
    return np.array(speeds)


def _wall_overlap(lattice: Lattice) -> tuple[float, Flags]:
    """Where the left wall stands, m, and which disks touch it."""
    place = float(lattice.x.min()) - RADIUS + OVERLAP
    return place, np.asarray(lattice.x - lattice.radius < place + 1e-9)


def _slices(lattice: Lattice, inside: Flags) -> tuple[sparse.csr_array, Floats]:
    """(`SLICES`, N) averages over those disks of each slice that are inside, and their mean x, m."""
    number = (lattice.x / lattice.width * SLICES).astype(int)
    chosen = np.flatnonzero(inside & (number >= 0) & (number < SLICES))
    members = np.bincount(number[chosen], minlength=SLICES)
    average = sparse.csr_array(
        (1.0 / members[number[chosen]], (number[chosen], chosen)), shape=(SLICES, len(lattice.x))
    )
    return average, average @ lattice.x


def _receiver_band(lattice: Lattice, trial: Trial) -> Flags:
    """(N,) disks at the height of stations and receiver."""
    return np.asarray(np.abs(lattice.y - 0.5 * lattice.height) <= max(trial.half_band, 1.5 * SPACING))


def _origin(lattice: Lattice, trial: Trial) -> float:
    """Where the path begins: the wall, or the mean place of the driven disks, m."""
    return _wall_overlap(lattice)[0] if trial.rubbed else float(lattice.x[lattice.driven].mean())


def _longest(lattice: Lattice, trial: Trial) -> float:
    """Time that all sections of a trial need, s."""
    speeds = long_wave_speeds(lattice)
    return max(
        _duration(1.35 * lattice.width / speed, frequency)
        for speed, frequency in zip(speeds, trial.frequencies, strict=True)
    )


def _duration(delay: float, frequency: float) -> float:
    """Length of a section, s: until no P wave may be taken for an S wave that is still to come, and a period."""
    return 0.5 / frequency + max(2.4 * delay, delay + 1.5 / frequency) + 0.5 / frequency


def _stacked(lattice: Lattice, copies: int) -> Lattice:
    """Cells on top of one another as one; nothing touches its lid and floor."""
    count, number = len(lattice.x), np.arange(copies)
    first = (lattice.pairs[:, 0] + number[:, None] * count).ravel()
    second = (lattice.pairs[:, 1] + (number[:, None] + lattice.image) * count).ravel()
    inside = second < copies * count
    return replace(
        lattice,
        x=np.tile(lattice.x, copies),
        y=(lattice.y + number[:, None] * lattice.height).ravel(),
        radius=np.tile(lattice.radius, copies),
        height=copies * lattice.height,
        driven=np.tile(lattice.driven, copies),
        last=np.tile(lattice.last, copies),
        pairs=np.column_stack([first, second])[inside],
        image=np.zeros(int(inside.sum()), dtype=np.int64),
        cemented=np.tile(lattice.cemented, (copies, 1))[inside],
    )


def simulate(cell: Lattice, trial: Trial) -> tuple[Floats, Floats, Floats, Floats]:
    """What calcidem.dem computes: times (S,), motion across and along (S, `SLICES`, L), and distances (`SLICES`,)."""
    lattice = _stacked(cell, trial.copies)
    cosine, sine = np.cos(trial.slant), np.sin(trial.slant)
    driven = lattice.driven & (np.abs(lattice.y - 0.5 * lattice.height) <= trial.half_aperture) & (not trial.rubbed)
    middle = 0.5 * lattice.height
    near_rim = np.abs(lattice.y - middle) > middle - _LAYER
    bits = (lattice.cemented << np.arange(LANES, dtype=np.uint32)).sum(axis=1).astype(np.uint32)
    scene = Scene(
        x=cosine * lattice.x - sine * lattice.y,
        y=sine * lattice.x + cosine * lattice.y,
        radius=lattice.radius,
        sand=Sand(*astuple(lattice.grain)),
        walls=_walls(lattice, trial),
        bonds=Bonds(lattice.pairs, lattice.cement, bits),
        damping=np.where(near_rim, 1.0, trial.damping),
        held=driven | lattice.last | (trial.closed & (lattice.x > lattice.width)),
    )
    features = replace(choose_features(scene, "linear", LANES), recording=True, driven=not trial.rubbed, damping=True)
    limit = start(scene, features=features, steps_per_contact=0.0).critical_time_step.min()
    step = 0.9 * float(limit)
    state = start(scene, features=features, time_step=step, steps_per_contact=0.0)
    stride = max(1, int(1.0 / (50.0 * max(trial.frequencies) * step)))
    samples = int(np.ceil(_longest(lattice, trial) / (step * stride)))
    steps = samples * stride
    average, places = _slices(lattice, _receiver_band(lattice, trial) & ~lattice.driven)
    rank = np.argsort(state.assembly.order)
    groups = [np.sort(rank[disks]) for disks in np.split(average.indices, average.indptr[1:-1])]
    instants = (np.arange(steps) + 0.5) * step
    recording = Recording(
        drive=np.column_stack([Pulse(1.0, frequency).velocity(instants) for frequency in trial.frequencies]),
        driven=0 if trial.rubbed else -1,
        driven_disks=np.sort(rank[driven]),
        offset=0,
        stride=stride,
        listeners=np.concatenate(groups * 2),
        groups=np.cumsum([0, *map(len, groups * 2)]),
        axes=np.repeat([0, 1], SLICES),
        samples=np.zeros((samples, 2 * SLICES, LANES)),
    )
    run_in_place(state, steps, recording)
    lab_x, lab_y = recording.samples[:, :SLICES], recording.samples[:, SLICES:]
    times = ((np.arange(samples) + 1) * stride - 0.5) * step
    distances = places - _origin(lattice, trial)
    return times, cosine * lab_y - sine * lab_x, cosine * lab_x + sine * lab_y, distances


def _walls(lattice: Lattice, trial: Trial) -> tuple[Wall, ...]:
    """The wall that rubs, between smooth ones; far away where disks are driven."""
    if not trial.rubbed:
        return (Wall((-1.0, 0.0), (1.0, 0.0)),)
    point, half = (_wall_overlap(lattice)[0], 0.5 * lattice.height), trial.half_aperture
    return (
        Wall(point, (1.0, 0.0), friction=0.7, span=(-half, half)),
        Wall(point, (1.0, 0.0), span=(-np.inf, -half)),
        Wall(point, (1.0, 0.0), span=(half, np.inf)),
    )


def _step_of(matrix: sparse.csr_array, inverse: Floats, damping: float) -> float:
    """Nearly the largest step of the leapfrog with local damping, s: ``2 / (omega sqrt(1 + alpha))``."""
    root = sparse.diags_array(np.sqrt(inverse))
    highest = eigsh(root @ matrix @ root, k=1, tol=1e-2, v0=np.ones(len(inverse)), return_eigenvectors=False)[0]
    return 0.9 * 2.0 / float(np.sqrt(highest * (1.0 + damping)))


@dataclass(frozen=True, slots=True, eq=False)
class PlaneWave:
    """A plane S wave through a lattice that repeats itself in height.

    Attributes
    ----------
    times
        (S,) s.
    frequency
        Hz.
    band, whole
        (S, `SLICES`) motion across in the receiver's band and over the whole height.
    band_distances, whole_distances
        (`SLICES`,) m.
    """

    times: Floats
    frequency: float
    band: Floats
    whole: Floats
    band_distances: Floats
    whole_distances: Floats

    def delay(self, receiver: int, path: float) -> tuple[float, float]:
        """Delay of the peak over a path (m) to a slice, and its relative uncertainty; infinite where it is ambiguous."""
        found = []
        for signal, distances in ((self.band, self.band_distances), (self.whole, self.whole_distances)):
            pulse_peak = 0.5 / self.frequency
            time = _first_alone(self.times, signal[:, receiver], pulse_peak)
            found.append((time - pulse_peak) * path / distances[receiver])
        delay, other = found
        if not (np.isfinite(delay) and np.isfinite(other) and delay > 0.0):
            return float("nan"), float("inf")
        return float(delay), abs(float(other / delay) - 1.0)


def _first_alone(times: Floats, signal: Floats, pulse_peak: float) -> float:
    """Time of the first peak of nearly the largest height; NaN where another one soon follows it."""
    inner = signal[1:-1]
    tops = 1 + np.flatnonzero((inner > signal[:-2]) & (inner >= signal[2:]) & (inner > _RIVAL * inner.max()))
    if not len(tops):
        return float("nan")
    # Later ones have crossed the lattice three times.
    soon = times - pulse_peak < _SOON * (times[tops[0]] - pulse_peak)
    return peak_time(times, signal, soon) if soon[tops].sum() == 1 else float("nan")


def plane_waves(lattice: Lattice, trial: Trial) -> list[PlaneWave]:
    """The plane wave of each lane, from an independent solution; none in a tilted lattice."""
    if trial.kind == "tilted":
        return []
    waves: dict[int, PlaneWave] = {}
    patterns, inverse = np.unique(lattice.cemented, axis=1, return_inverse=True)
    for number, cemented in enumerate(patterns.T):
        lanes = np.flatnonzero(inverse.ravel() == number)
        frequencies = [trial.frequencies[lane] for lane in lanes]
        waves |= dict(zip(lanes.tolist(), plane_wave(lattice, trial, cemented, frequencies), strict=True))
    return [waves[lane] for lane in range(LANES)]


def plane_wave(cell: Lattice, trial: Trial, cemented: Flags, frequencies: list[float]) -> list[PlaneWave]:
    """Plane waves of several frequencies through one pattern of cement (M,).

    The edge moves across the path alone over the whole height, by the leapfrog and the local damping of the kernel, in
    plain NumPy.
    """
    count, shape = len(cell.x), (3 * len(cell.x), len(frequencies))
    matrix = stiffness_matrix(count, springs_of(cell, cemented))
    mass = cell.grain.mass(cell.radius)
    inverse = 1.0 / np.column_stack([mass, mass, 0.5 * mass * cell.radius**2]).ravel()
    rub = np.zeros((3 * count, 1))
    if trial.rubbed:
        wall = stiffness_matrix(count, _wall_springs(cell))
        matrix = sparse.csr_array(matrix + wall)
        rub = wall @ np.tile([[0.0], [1.0], [0.0]], (count, 1))  # forces for a motion of the wall by one metre
    step = _step_of(matrix, inverse, trial.damping)
    inverse[np.repeat(cell.last | (cell.driven & (not trial.rubbed)), 3)] = 0.0
    driven = 3 * np.flatnonzero(cell.driven) + 1
    stride = max(1, int(1.0 / (100.0 * max(frequencies) * step)))
    samples = int(0.75 * _longest(cell, trial) / (step * stride))
    instants = (np.arange(samples * stride) + 0.5) * step
    drive = np.column_stack([Pulse(1.0, frequency).velocity(instants) for frequency in frequencies])
    stroke = step * np.cumsum(drive, axis=0)  # of the wall, after each step
    free = ~cell.driven
    averages = [_slices(cell, free & _receiver_band(cell, trial)), _slices(cell, free)]
    motion, velocity = np.zeros(shape), np.zeros(shape)
    found = np.zeros((2, samples, SLICES, len(frequencies)))
    for number in range(samples * stride):
        force = -(matrix @ motion)
        if trial.rubbed and number:
            force += rub * stroke[number - 1]
        if trial.damping:
            force -= trial.damping * np.abs(force) * np.sign(velocity)
        velocity += step * inverse[:, None] * force
        if not trial.rubbed:
            velocity[driven] = drive[number]
        motion += step * velocity
        if (number + 1) % stride == 0:
            for kind, (average, _) in enumerate(averages):
                found[kind, number // stride] = average @ velocity[1::3]
    times = ((np.arange(samples) + 1) * stride - 0.5) * step
    distances = [places - _origin(cell, trial) for _, places in averages]
    return [
        PlaneWave(times, frequency, found[0, :, :, column], found[1, :, :, column], *distances)
        for column, frequency in enumerate(frequencies)
    ]


def _wall_springs(cell: Lattice) -> Springs:
    """Contacts with the wall."""
    place, touching = _wall_overlap(cell)
    disks = np.flatnonzero(touching)
    radius = cell.radius[disks]
    overlap = radius - (cell.x[disks] - place)
    normal = 1.5 * cell.grain.hertz(radius) * np.sqrt(np.maximum(overlap, 0.0))
    stiffness = np.stack([normal, cell.grain.shear_share * normal, 0.0 * normal])
    arms = np.tile(radius - 0.5 * overlap, (2, 1))
    return Springs(np.full(len(disks), -1), disks, np.tile([1.0, 0.0], (len(disks), 1)), arms, stiffness, 0.0 * normal)


def shear_branch(lattice: Lattice, tilt: float, cemented: bool, numbers: Floats) -> Floats:
    """Angular frequencies (K,) of the quasi-shear branch of an endless lattice for wave numbers (K,) along the path, 1/s."""
    pair = replace(
        lattice,
        x=np.array([0.0, SPACING]),
        y=np.zeros(2),
        radius=np.full(2, RADIUS),
        image=np.zeros(1),
        pairs=np.array([[0, 1]]),
    )
    stiffness = springs_of(pair, np.array([cemented])).stiffness[:, 0]
    neighbours = 4 if lattice.square else 6
    angles = tilt + 2.0 * np.pi * np.arange(neighbours) / neighbours
    waves = np.column_stack([numbers, 0.0 * numbers])
    matrices = bloch_matrices(waves, angles, SPACING, (*stiffness, 0.0), float(lattice.grain.mass(RADIUS)), RADIUS)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(matrices)[:, 0], 0.0))


def bloch_delay(lattice: Lattice, trial: Trial, lane: int, path: float) -> tuple[float, float]:
    """Delay of the peak after an undamped path through an endless lattice, s, and its relative uncertainty.

    The spectrum of the pulse is propagated with the exact dispersion. The place of the driven disks is known to a quarter
    of a spacing, as their edge is ragged.
    """
    frequency, cemented = trial.frequencies[lane], bool(lattice.cemented[0, lane])
    numbers = np.linspace(0.0, np.pi / SPACING, 2000)
    branch = shear_branch(lattice, trial.tilt, cemented, numbers)
    end = int(np.argmax(branch)) + 1
    rate = 200.0 * frequency
    count = 2 ** int(np.ceil(np.log2(rate * (20.0 / frequency + 20.0 * path / (branch[1] / numbers[1])))))
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, 1.0 / rate)
    passed = omega < branch[:end].max()
    number = np.interp(omega, branch[:end], numbers[:end])
    times = np.arange(count) / rate
    spectrum = np.fft.rfft(Pulse(1.0, frequency).velocity(times))
    signal = np.fft.irfft(np.where(passed, spectrum * np.exp(-1j * number * path), 0.0), count)
    delay = peak_time(times, signal, np.ones(count, dtype=bool)) - 0.5 / frequency
    return delay, 0.25 * SPACING / path


def _draw_stations(generator: np.random.Generator, receiver: int) -> list[int]:
    """Six to ten slices from an eighth of the path on, before that of the receiver."""
    first = max(2, round(0.14 * receiver))
    wanted = int(generator.integers(6, 11))
    return sorted({round(place) for place in np.linspace(first, receiver - 1, wanted).tolist()})


def _resampled(times: Floats, signals: Floats, even: Floats) -> Floats:
    """Signals (S, X) at other times: (X, T)."""
    # Nothing moves before the pulse.
    before = -times[0] + np.zeros(1), np.zeros((1, signals.shape[1]))
    spline = CubicSpline(np.concatenate([before[0], times]), np.concatenate([before[1], signals]), axis=0)
    return np.asarray(spline(np.minimum(even, times[-1]))).T


def _is_readable(section: Section, noise: float) -> bool:
    """See `Section.readable`; ``noise`` is its rms."""
    received = section.across[-1]
    inside = section.times <= section.transmitted_peak + 1.5 * section.delay
    time = peak_time(section.times, received, inside)
    near = abs(time - section.transmitted_peak - section.delay) <= 0.05 * section.delay
    return bool(near and noise <= 0.1 * received[inside].max())


def _disturbed(generator: np.random.Generator, clean: Section) -> Section:
    """A section with noise, and stations of unequal gain whose axes are not quite those of the path."""
    columns, samples = clean.across.shape
    loudest = float(np.abs(clean.across[-1]).max())
    frequency, interval = clean.frequency, float(clean.times[1] - clean.times[0])
    x = np.fft.rfftfreq(8 * samples, interval) / frequency
    low, high = (0.15, 0.6) if _by_chance(generator, 0.25) else (0.0, float(generator.uniform(1.0, 6.0)))
    spectrum = np.exp(-((x / high) ** 2)) * (x >= low)
    level = float(generator.uniform(0.0, 0.04)) * loudest
    common = _by_chance(generator, 0.3)  # the same hum everywhere
    both = []
    for signals in (clean.across, clean.along):
        white = generator.standard_normal((1 if common else columns, 8 * samples))
        noise = np.fft.irfft(np.fft.rfft(white, axis=1) * spectrum, 8 * samples, axis=1)[:, :samples]
        both.append(signals + level * noise / noise.std())
    gain = np.exp(0.2 * generator.standard_normal(columns))
    gain[-1] = 1.0
    angle = np.radians(3.0) * generator.standard_normal(columns)[:, None]
    across = gain[:, None] * (np.cos(angle) * both[0] + np.sin(angle) * both[1])
    along = gain[:, None] * (np.cos(angle) * both[1] - np.sin(angle) * both[0])
    return replace(clean, across=across, along=along, readable=_is_readable(clean, level))
