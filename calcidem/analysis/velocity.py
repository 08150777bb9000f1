"""Errors of velocities, quantities derived from a shear-wave velocity, dispersion, and advice about a campaign.

Phase velocity over frequency comes from the space-time sections of many samples of one content. One sample contains
one to three wavelengths, so its spectrum over frequency and wavenumber is broad. The mean spectrum of many samples
gives the dispersion of the content.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.intervals import is_in_doubt
from calcidem.ends import CellStatus
from calcidem.storage.records import MOST_PULSE_EFFECT, depends_on_pulse

if TYPE_CHECKING:
    import xarray as xr  # its import would delay a rank by half a second

BUDGET_QUANTITIES = ("vs", "reading_error", "numerical_error", "pulse_effect", "vs_error")
"""Quantities of each cell that `error_budget` needs, besides its content."""


def are_samples(vs: ArrayLike, content: ArrayLike) -> NDArray[np.bool_]:
    """Whether each cell is a distinct sample with a velocity: the population of all numbers about a campaign.

    Without cement all seeds give the same sample, so only the first of them counts. ``content``, percent, broadcasts to
    the shape of ``vs``; NaN where a cell has no velocity.
    """
    found: NDArray[np.bool_] = np.isfinite(np.asarray(vs, dtype=float))
    bare = found & (np.asarray(content, dtype=float) == 0.0)
    found[bare] = np.arange(np.count_nonzero(bare)) == 0
    return found


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Errors of the velocities of some cells."""

    total: float
    reading: float
    numerical: float
    pulse: float
    """Medians of the relative standard error of Vs and of its three parts, over the samples of which all are known, so
    that no part exceeds the whole. If there is no such sample, each over those of which it is known, else NaN.
    """
    scatter: float
    """Root mean square of the reading errors, m/s: their part of the standard deviation of Vs. NaN for one sample."""
    loud: int
    """Number of samples whose velocity depends on the pulse."""

    @property
    def texts(self) -> tuple[str, str]:
        """Texts on the standard error of a velocity, and on its parts."""
        if not np.isfinite(self.total):
            return "unknown", "no error of the reading is stored"
        parts = (self.total, self.reading, self.numerical, self.pulse)
        total, reading, numerical, pulse = (f"{100 * part:.2g} %" for part in parts)
        return total, f"median; reading {reading}, simulation {numerical}, pulse {pulse}"

    def __str__(self) -> str:
        """Return both in one text."""
        total, parts = self.texts
        return f"{total} ({parts})"


def error_budget(cells: Mapping[Any, ArrayLike]) -> ErrorBudget:
    """Summarise the errors of the distinct samples with a velocity among cells.

    ``cells`` has content, and `BUDGET_QUANTITIES` in arrays of one shape with NaN if missing.
    """
    counted = are_samples(cells["vs"], cells["content"])
    samples = {name: np.asarray(cells[name], dtype=float)[counted] for name in BUDGET_QUANTITIES}
    known = np.logical_and.reduce([np.isfinite(values) for values in samples.values()])
    median = {name: median_known(values[known] if known.any() else values) for name, values in samples.items()}
    absolute = samples["vs"] * samples["reading_error"]
    absolute = absolute[np.isfinite(absolute)]
    return ErrorBudget(
        total=median["vs_error"],
        reading=median["reading_error"],
        numerical=median["numerical_error"],
        pulse=median["pulse_effect"],
        scatter=float(np.sqrt(np.mean(absolute**2))) if np.count_nonzero(counted) > 1 and absolute.size else np.nan,
        loud=int(depends_on_pulse(samples["pulse_effect"]).sum()),
    )


def median_known(given: ArrayLike) -> float:
    """Median of the finite values; NaN if there are none."""
    values = np.asarray(given, dtype=float)
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


FEWEST_WAVELENGTHS = 2.0
"""Wavelengths from transmitter to receiver below which near field and shear wave arrive together (section 3.1.3)."""

Values = TypeVar("Values", float, NDArray[np.float64], "xr.DataArray")


SOIL_DENSITY = 1659.0
"""Of the paper's soil, kg/m3 (Table 1)."""


def small_strain_modulus(vs: Values, density: float | None = None) -> Values:
    """Shear modulus G0 = rho Vs^2 (Eq. 1), Pa; the default density of the sample is that of Table 1, 1659 kg/m^3.

    Examples
    --------
    >>> small_strain_modulus(200.0)
    66360000.0
    """
    return vs * vs * (SOIL_DENSITY if density is None else density)


def damping_ratio(local_damping: float) -> float:
    """Damping ratio D = alpha / pi of local damping (section 3.1.2).

    Examples
    --------
    >>> round(damping_ratio(0.3), 4)
    0.0955
    """
    return local_damping / math.pi


def median_diameter_by_mass(radius: ArrayLike) -> float:
    """Median diameter d50 by mass of disks (N,), in the unit of the radii.

    This is the median of soil mechanics: 2.632 mm for the paper's disks, uniform from 2.12 to 3 mm. Their median by
    number is 2.562 mm.
    """
    ascending = np.sort(np.asarray(radius, dtype=np.float64))
    passing = np.cumsum(ascending * ascending)
    return 2.0 * float(ascending[np.searchsorted(passing, 0.5 * passing[-1])])


def wavelengths(
    vs: float | None, frequency: float, distance: float, median_diameter: float
) -> tuple[float, float] | tuple[None, None]:
    """Wavelengths on a path (m), and wavelength over median diameter by mass (m); None and None without a velocity."""
    if vs is None:
        return None, None
    wavelength = vs / frequency
    return distance / wavelength, wavelength / median_diameter


NOTE_QUANTITIES = (
    "content", "status", "vs", "pulse_effect", "wavelengths_on_path", "wavelength_over_d50", "broken_bonds",
)  # fmt: skip
"""Quantities of each cell that `notes_on` needs."""

FEWEST_GRAINS = 6.0
"""Grains in a wavelength below which they scatter and slow the wave."""


def notes_on(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    """Advice from `NOTE_QUANTITIES` of all cells, columns (N,), a sentence each; empty if there is none."""
    content, vs, status = (columns[name] for name in ("content", "vs", "status"))
    counted, contents = are_samples(vs, content), np.unique(content).tolist()

    def medians(name: str) -> dict[float, float]:
        return {at: median_known(columns[name][counted & (content == at)]) for at in contents}

    def where(found: Mapping[float, bool]) -> str:
        return ", ".join(f"{at:g}" for at, is_so in found.items() if is_so)

    failed = ~np.isin(status, (CellStatus.DONE, CellStatus.PENDING))
    bare = np.flatnonzero(failed & (content == 0.0))  # one sample, which has failed only if no cell has its velocity
    failed[bare[0 if np.isfinite(vs[content == 0.0].astype(float)).any() else 1 :]] = False
    doubtful = {at: is_in_doubt(int(counted[content == at].sum()), int(failed[content == at].sum())) for at in contents}
    near = where({at: median < FEWEST_WAVELENGTHS for at, median in medians("wavelengths_on_path").items()})
    short = where({at: median < FEWEST_GRAINS for at, median in medians("wavelength_over_d50").items()})
    loud = where({at: bool(depends_on_pulse(median)) for at, median in medians("pulse_effect").items()})
    broken = int(np.count_nonzero(columns["broken_bonds"].astype(float) > 0))
    notes = {
        f"At {near} % fewer than two wavelengths lie between transmitter and receiver, so near field and shear wave "
        "arrive together: a higher wave.frequency or a wider packing separates them.": near,
        f"At {short} % a wavelength has fewer than {FEWEST_GRAINS:g} grains, which scatter and slow it: a lower "
        "wave.frequency measures the sand.": short,
        f"At {loud} % Vs depends on the pulse by more than {100 * MOST_PULSE_EFFECT:g} %: a smaller wave.amplitude "
        "measures the sample.": loud,
        f"Cells in which the pulse broke bonds: {broken}; a smaller wave.amplitude breaks none.": broken,
        f"Possible selection bias at {where(doubtful)} %: cells without velocity may shift the mean by more than its "
        "standard error.": where(doubtful),
        f"Cells without velocity: {failed.sum()}. 'calcidem status DB' has reasons and remedies.": failed.any(),
    }
    return [note for note, applies in notes.items() if applies]


@dataclass(frozen=True, slots=True, eq=False)
class Dispersion:
    """Dispersion of the shear waves of one content."""

    frequency: NDArray[np.float64]
    """(F,) Hz."""
    velocity: NDArray[np.float64]
    """(V,) m/s."""
    power: NDArray[np.float64]
    """(F, V) mean stacked power of the samples, from 0 to 1: 1 if all places move in phase."""
    phase_velocity: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    """(F,) velocity of the largest power and its jackknife standard error, m/s; NaN for fewer than three samples."""
    samples: int


@dataclass(frozen=True, slots=True)
class ContentDispersion:
    """Dispersion at one content."""

    content: float
    """Percent."""
    found: Dispersion
    vs: float
    static: float
    """Medians of Vs and of the static speed of the samples, m/s; NaN if the latter is unknown."""


def dispersion(
    sections: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]],
    frequency: float,
    velocities: tuple[float, float],
) -> Dispersion:
    """Return the phase velocity of shear waves from sections of samples of one content.

    `ValueError` without sections, or if the velocities are not an increasing pair of positive numbers.

    Parameters
    ----------
    sections
        Motion across the path of each sample, from the transmitted pulse to the end of the received one:
        times (T,), s, evenly spaced; places along the path (X,), m; and velocities (T, X) in any unit.
    frequency, velocities
        Frequency of the pulse, Hz, and the range of phase velocities to search, m/s.

    Notes
    -----
    At each frequency the spectra of all places are normalised to unit magnitude, shifted by the phase of a plane wave
    and summed (phase-shift method: Park, Miller and Xia 1998, SEG Expanded Abstracts 17:1377). The power of this sum is
    averaged over the samples. The velocities have no limit at frequency zero, since the damped layers hold the strip:
    they rise towards low frequencies, see `effective_vs`.
    """
    if not sections:
        raise ValueError("sections: none given; give that of a sample, or of three for a standard error")
    if not 0.0 < velocities[0] < velocities[1]:
        raise ValueError(f"velocities = {velocities}: give a slowest and a fastest positive velocity, m/s")
    wanted = frequency * np.arange(0.4, 1.81, 0.1).round(2)  # the spectrum of the pulse is zero at 2
    velocity = np.geomspace(*velocities, 400)
    waves: dict[bytes, NDArray[np.complex128]] = {}  # sections of one content share most times and places
    powers = np.array([_power(section, wanted, velocity, waves) for section in sections])
    total, count = powers.sum(axis=0), len(sections)
    found, left_out = _ridge(total, velocity), np.array([_ridge(total - power, velocity) for power in powers])
    return Dispersion(
        frequency=wanted,
        velocity=velocity,
        power=total / count,
        phase_velocity=found,
        standard_error=_jackknife(left_out),
        samples=count,
    )


def _power(
    section: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    frequency: NDArray[np.float64],
    velocity: NDArray[np.float64],
    waves: dict[bytes, NDArray[np.complex128]],
) -> NDArray[np.float64]:
    """(F, V) stacked power of one sample; `waves` caches the waves (F, T) and (F, V, X) at its times and places."""
    times, places, across = section
    at_times, at_places = times.tobytes(), places.tobytes()
    if at_times not in waves:
        waves[at_times] = np.exp(-2j * np.pi * frequency[:, None] * times)
    if at_places not in waves:
        waves[at_places] = np.exp(2j * np.pi * frequency[:, None, None] / velocity[:, None] * places)
    spectrum = waves[at_times] @ across
    spectrum = spectrum / np.maximum(np.abs(spectrum), np.finfo(float).tiny)
    stacked = (waves[at_places] @ spectrum[:, :, None])[:, :, 0] / len(places)
    return np.asarray(np.abs(stacked) ** 2)


def _ridge(power: NDArray[np.float64], velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,) velocity of the largest power, refined by a parabola over the logarithm."""
    best = np.clip(power.argmax(axis=1), 1, len(velocity) - 2)
    rows = np.arange(len(power))
    left, middle, right = (power[rows, best + shift] for shift in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    shift = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
    step = np.log(velocity[1] / velocity[0])
    return np.asarray(velocity[best] * np.exp(np.clip(shift, -1.0, 1.0) * step))


def _jackknife(left_out: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error from estimates (N, ...) that each leave out one sample."""
    count = len(left_out)
    if count < 3:
        return np.full_like(left_out[0], np.nan)
    return np.asarray(np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)))
