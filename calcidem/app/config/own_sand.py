"""Configuration of any sand from its grain size or disks, its stress and its mineral: ``calcidem init``.

Each length is a multiple of the grain diameter d, and each stiffness a multiple of that of the contact between two
grains under the stress. So all sands with the same ratio of stress to modulus give scaled copies of the same samples,
with the same readings; docs/your-sand.md has the formulas.
"""

import json
import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.reader import read_configuration
from calcidem.dem.engine.material import Sand
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.judgement import expected_overlap
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.sample.packing_file import checked_disks
from calcidem.dem.wave.experiment import WAVELENGTHS
from calcidem.dem.wave.pulse import cutoff_frequency

_CALCITE = Sand(shear_modulus=32e9, poisson_ratio=0.32, density=2710.0)
_MINERALS = {
    "quartz": Sand(shear_modulus=44e9, poisson_ratio=0.08, density=2650.0),
    "carbonate": _CALCITE,
    "calcite": _CALCITE,
}
"""Materials of the grains: Mavko, Mukerji and Dvorkin (2009), The Rock Physics Handbook, doi:10.1017/CBO9780511626753,
tables of mineral moduli.
"""

_UNIT_FACTORS = {
    "grain size": {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "stress": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6},
}
_LIMITS = {"grain size": (1e-6, 1.0), "stress": (1.0, 1e9)}  # beyond these limits a material is not sand
_EXAMPLES = {"grain size": "0.3mm", "stress": "100kPa"}

# In mean diameters, from the paper's sand: 0.1 m, 12 mm, 1.06 mm and 1.33 mm over 2.56 mm, and its sizes.
_SIZES = (0.83, 1.17)
_CLUSTER, _P_WIDTH, _C_WIDTH = 4.7, 0.41, 0.52
# A width of 30 holds 2.5 wavelengths of 11 grains, with little dispersion and scattering. The side walls, with
# transmitter and receiver, are wider than the path.
_BOX = (30.0, 50.0)
_LISTENING, _LAYER = 4.0, 5.0
_SOLID = 0.8  # area of disks at rest over area of their box
# Over the height of the box.
_TRANSMITTING, _RECEIVING = 0.45, 0.25

_REAL_OVER_LATTICE = 0.5  # velocity without cement: 0.48 to 0.53 from 20 kPa to 1 MPa, for both minerals
_GENTLE = 0.01  # stroke of the pulse over the overlap


@dataclass(frozen=True, slots=True)
class _OwnDisks:
    """Disks in a file, which replace the packing."""

    file: str
    """Name in the configuration."""
    width: float
    height: float
    """Size of the box, m: up to the rightmost disk, and the expected height of the disks at rest."""
    diameters: tuple[float, float, float]
    """Smallest, mean and largest diameter, m."""
    count: int
    """Number of disks."""

    @classmethod
    def read(cls, file: Path, folder: Path) -> Self:
        """Read disks for a configuration in a folder; `PackingFileError`, naming the line, for an invalid file."""
        x, y, radius = checked_disks(file)
        width = float(f"{np.max(x + radius):.6g}")
        at_rest = float(np.pi * np.sum(radius**2)) / (_SOLID * width)  # below the lid, which compresses loose disks
        return cls(
            file=os.path.relpath(file, folder),
            width=width,
            height=min(float(np.max(y + radius)), at_rest),
            diameters=(2.0 * float(radius.min()), 2.0 * float(radius.mean()), 2.0 * float(radius.max())),
            count=len(radius),
        )


@dataclass(frozen=True, slots=True)
class OwnSand:
    """A sand as described by the user."""

    grain_size: float
    """Mean diameter, m."""
    stress: float
    """Vertical confining stress, Pa."""
    mineral: str
    """Key of `_MINERALS`."""
    contents: Sequence[float]
    """Calcite contents, percent of the sand's mass."""
    disks: _OwnDisks | None = None
    """Disks, if given."""

    @classmethod
    def of_words(cls, size: str | Path, stress: str, mineral: str, contents: str, folder: Path) -> Self:
        """Understand the options of `calcidem init`: the size in words, or the file of the disks; the others in words.

        Disks are named relative to the configuration's folder. `ConfigurationError` with everything that is wrong;
        `PackingFileError`, naming the line, if the file has no disks.
        """
        problems: list[Problem] = []

        def quantity(option: str, name: str, text: str) -> float:
            try:
                return _parse_quantity(name, text)
            except ValueError as error:
                problems.append(Problem(f"{option}: {error}"))
                return math.nan

        disks = _OwnDisks.read(size, folder) if isinstance(size, Path) else None
        diameter = float(f"{disks.diameters[1]:.3g}") if disks else quantity("--grain-size", "grain size", str(size))
        pressure = quantity("--stress", "stress", stress)
        if mineral not in _MINERALS:
            known = ", ".join(_MINERALS)
            problems.append(Problem(f"--mineral {mineral}: give one of {known}, and change [sand] for another"))
        try:
            percentages = [float(part) for part in contents.split(",")]
        except ValueError:
            percentages = [math.nan]
        if not all(0.0 <= percentage <= 100.0 for percentage in percentages):  # percent
            problems.append(Problem(f"--contents {contents}: give percent of the sand's mass, from 0 to 100"))
        if problems:
            raise ConfigurationError("the sand", problems)
        return cls(diameter, pressure, mineral, percentages, disks)

    @property
    def box(self) -> tuple[float, float]:
        """Width and height, m."""
        if self.disks is not None:
            return self.disks.width, self.disks.height
        return _BOX[0] * self.grain_size, _BOX[1] * self.grain_size

    @property
    def sand(self) -> Sand:
        """Material of disks of unit thickness.

        A disk stands for a row of 1 m / d grains. Each of its contacts is as many contacts of spheres in parallel,
        which multiplies the modulus. So the overlap over the radius is that of grains under the stress.
        """
        mineral = _MINERALS[self.mineral]
        return Sand(mineral.shear_modulus / self.grain_size, mineral.poisson_ratio, mineral.density)

    @property
    def overlap(self) -> float:
        """Expected mean overlap over the radius, ``(3 sqrt(2) (1 - nu) stress / G)^(2/3)``, for any grain size."""
        return expected_overlap(self.stress, self.grain_size, self.sand)

    @property
    def bond_modulus(self) -> float:
        """Modulus of a bond as stiff as a row of grains welded over the width of the cement, Pa.

        ``k_n = 4 G b / (1 - nu)`` for two spheres welded over the radius b: Digby (1981), The effective elastic moduli
        of porous granular rocks, J. Appl. Mech. 48, 803, doi:10.1115/1.3157738. With b = width / 2 and 1 m / d grains.
        """
        mineral = _MINERALS[self.mineral]
        return 2.0 * mineral.shear_modulus * _P_WIDTH / (1.0 - mineral.poisson_ratio)

    @property
    def velocity(self) -> float:
        """Expected shear-wave velocity without cement, m/s.

        Half of that of the hexagonal lattice of such disks, ``V^2 = 3/8 (k_n + k_s) d^2 / m``, since random packings
        have fewer contacts and are softer. It increases with the power 1/6 of the stress, and does not depend on the
        grain size.
        """
        tangent = 1.5 * self.stress * self.grain_size / (0.5 * self.overlap * self.grain_size)
        mass = 0.25 * math.pi * self.sand.density * self.grain_size * self.grain_size
        stiffness = 3.0 / 8.0 * tangent * (1.0 + self.sand.shear_ratio)
        return _REAL_OVER_LATTICE * math.pi * self.grain_size * cutoff_frequency(stiffness, mass)

    def text(self) -> str:
        """Text of the configuration of a sand, with the reason for each number.

        `ConfigurationError` if such a sand cannot be computed.
        """
        if problems := _content_problems(self):
            raise ConfigurationError("the sand", problems)
        text = _commented(self)
        if self.disks is None:  # 'run --check' reports further problems of disks in a file
            read_configuration(tomllib.loads(text), "the sand")  # refuses a stress that would crush the grains
        return text


def _parse_quantity(quantity: str, text: str) -> float:
    """Read a ``grain size`` or a ``stress`` with its unit, such as 0.3mm or 100 kPa; return SI units.

    `ValueError` without a known unit, or for an impossible value.
    """
    units, (low, high) = _UNIT_FACTORS[quantity], _LIMITS[quantity]
    found = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z]+)\s*", text, re.ASCII)
    cure = f"give a number with one of the units {', '.join(units)}, such as {_EXAMPLES[quantity]}"
    if found is None or found[2] not in units:
        raise ValueError(f"'{text}' is not a {quantity}: {cure}")
    try:
        value = float(f"{float(found[1]) * units[found[2]]:.12g}")  # 0.0003 and not 0.00030000000000000003
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        unit = next(iter(units)) if quantity == "stress" else "m"
        raise ValueError(f"'{text}' is not between {low:g} {unit} and {high:g} {unit}: {cure}")
    return value


def _content_problems(own: OwnSand) -> list[Problem]:
    """Problems of the contents, which no section can detect."""
    most = CementRule(sand_density=own.sand.density).pore_content(PackingRule().porosity)
    return [
        Problem(f"contents = {content:g}: calcite fills the pores at {most:.3g} %; leave it out")
        for content in own.contents
        if content > most
    ]


def _commented(own: OwnSand) -> str:
    """The text, without checks."""
    mineral, d = _MINERALS[own.mineral], own.grain_size
    gigapascals, (width, height) = mineral.shear_modulus / 1e9, own.box
    waves = WAVELENGTHS * own.velocity / (width - 0.5 * _LISTENING * d)
    size, stress = f"{d * 1e3:g} mm", f"{own.stress / 1e3:g} kPa"
    rows = (
        f"# {own.mineral.capitalize()} grains of {size} under {stress}, written by 'calcidem init'; see",
        "# docs/your-sand.md for formulas and sources.",
        f"# d = {_short(d)} m is the mean diameter. A disk is 1 m thick: a row of 1 m / d = {1.0 / d:.4g} grains.",
        "# SI units; contents in percent of the sand's mass. Keys that are left out have their defaults.",
        "",
        "[campaign]",
        (f'name = "{own.mineral}-{d * 1e3:g}mm-{own.stress / 1e3:g}kPa"', "also of the database"),
        ("seeds = 4", "for a first look; raise it for the scatter: computed cells are kept"),
        (f"contents = {sorted(map(float, own.contents))}", ""),
        "",
        "[packing]",
        *_packing_rows(own),
        (f"stress = {_short(own.stress)}", f"{stress} on the lid"),
        "",
        "[sand]",
        (
            f"shear_modulus = {_short(own.sand.shear_modulus)}",
            f"G / d x 1 m, G = {gigapascals:g} GPa: the overlap is {own.overlap:.1e} of a radius, as of spheres",
        ),
        (f"poisson_ratio = {mineral.poisson_ratio:g}", f"of {own.mineral}"),
        (f"density = {mineral.density:g}", f"of {own.mineral}, kg/m3"),
        "",
        "[cement]",
        (f"bond_modulus = {_short(own.bond_modulus)}", "2 G / (1 - nu) x width / d: grains welded over the P width"),
        (
            f"bond_stiffness_ratio = {_short(1.0 / own.sand.shear_ratio)}",
            "(2 - nu) / (2 - 2 nu): the same weld, sheared",
        ),
        "",
        "[pattern]",
        (f"p_diameter = {_short(_P_WIDTH * d)}", f"{_P_WIDTH:g} d: width of the cement at single contacts (P)"),
        (f"c_diameter = {_short(_C_WIDTH * d)}", f"{_C_WIDTH:g} d: the same at contacts in clusters (C)"),
        (f"cluster_diameter = {_short(_CLUSTER * d)}", f"{_CLUSTER:g} d; above 0.66 % calcite comes in clusters"),
        "",
        "[wave]",
        (
            'frequency = "auto"',
            f"about {WAVELENGTHS:g} wavelengths of path at each content; 'run --check' lists them",
        ),
        (
            f"amplitude = {_short(_GENTLE * 0.5 * own.overlap * d * waves, 1)}",
            f"moves the grains by {_GENTLE:g} overlaps, so that none slips",
        ),
        ('transmitter = "driven"', "moves the grains at the left wall: nothing slips"),
        (
            f"transmitter_half_width = {_short(_TRANSMITTING * height)}",
            f"{_TRANSMITTING:g} of the height: a nearly plane wave",
        ),
        (
            f"receiver_half_width = {_short(_RECEIVING * height)}",
            f"{_RECEIVING:g} of the height: away from the damped layers",
        ),
        (f"listening_depth = {_short(_LISTENING * d)}", f"{_LISTENING:g} d: enough grains for a mean"),
        (f"boundary_thickness = {_short(_LAYER * d)}", f"{_LAYER:g} d at floor and lid absorb reflections"),
        (
            f"slowest = {_short(0.5 * own.velocity, 2)}",
            f"half of the {own.velocity:.2g} m/s that are expected without cement",
        ),
    )
    lines = (row if isinstance(row, str) else f"{row[0]:<40}# {row[1]}" if row[1] else row[0] for row in rows)
    return "\n".join((*lines, ""))


def _packing_rows(own: OwnSand) -> tuple[tuple[str, str], ...]:
    """Lines about box and disks, with their reasons."""
    d, (width, height) = own.grain_size, own.box
    if own.disks is not None:
        good = " x ".join(f"{length:g} d" for length in _BOX)
        sizes = " to ".join(f"{size * 1e3:.3g}" for size in own.disks.diameters[::2])
        return (
            (f"file = {json.dumps(own.disks.file, ensure_ascii=False)}", f"{own.disks.count} disks of {sizes} mm"),
            (f"width = {width!r}", f"{width / d:.0f} d, and {height / d:.0f} d high at rest; {good} are good"),
        )
    low, high = _SIZES
    mean_square = (low * low + low * high + high * high) / 3.0  # of the diameters over the square of their mean
    disks = round((1.0 - PackingRule().porosity) * width * height / (0.25 * math.pi * d * d * mean_square), -1)
    return (
        (f"width = {_short(width)}", f"{_BOX[0]:g} d: {WAVELENGTHS:g} wavelengths of path, each of 11 grains"),
        (f"height = {_short(height)}", f"{_BOX[1]:g} d: side walls wider than the path; some {disks:.0f} disks in all"),
        (
            f"diameter = [{_short(_SIZES[0] * d)}, {_short(_SIZES[1] * d)}]",
            f"{_SIZES[0]:g} d to {_SIZES[1]:g} d: equal disks would form a crystal",
        ),
    )


def _short(value: float, digits: int = 4) -> str:
    """Write a number of a configuration with this number of significant digits."""
    text = np.format_float_scientific(value, digits - 1, trim="0", exp_digits=1)
    return text if not 1e-4 <= value < 1e6 else repr(float(text))  # what is easy to read
