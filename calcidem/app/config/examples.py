"""Configurations to start from: examples with the meaning of every key, and one for any sand (``calcidem init``).

In that of a sand each length is a multiple of the grain diameter d, and each stiffness a multiple of that of the
contact between two grains under the stress. So all sands with the same ratio of stress to modulus give scaled copies of
the same samples, with the same readings; docs/your-sand.md has the formulas.
"""

import inspect
import math
import os
import re
import textwrap
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Self, get_args, get_origin

import numpy as np

from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import problems_of_rows, read_configuration
from calcidem.app.config.schema import SECTIONS, TAKEN_FROM_ELSEWHERE, Configuration, ConfigurationError, Problem
from calcidem.dem.engine.fields import accepted_values, field_hints, quote, unit_of, written
from calcidem.dem.engine.scene import Sand
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.compaction import checked_disks
from calcidem.dem.sample.packing import PackingRule, expected_overlap
from calcidem.dem.wave.experiment import WAVELENGTHS, cutoff_frequency
from calcidem.input_file import UNITS, Table, parse_number, read_input, unit_in_name, value_of

CALIBRATED = ("sand.wave_stiffness_factor", "pattern.p_share", "pattern.p_patch_diameter", "pattern.cluster_area")
"""Keys that the comments of the examples call calibrated."""


@dataclass(frozen=True, slots=True)
class KeyReference:
    """One key of a configuration."""

    section: str
    name: str
    """Section and name of the key."""
    attribute: str
    """Attribute of `Configuration` that has it."""
    kind: str
    """Type in words: ``number``, ``list of numbers``, ``text``."""
    default: Any
    """Default; None without one."""
    unit: str
    """Unit, SI or percent; empty without one."""
    meaning: str
    """Meaning, from the docstring of its class."""
    accepted: str
    """Accepted values, in the words of the error message; empty if all values of its type are accepted."""


@cache
def key_references() -> tuple[KeyReference, ...]:
    """All keys in the order of their sections."""
    keys = []
    for section, kinds in SECTIONS.items():
        for attribute, kind in kinds.items():
            attributes = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
            meanings = {
                name: " ".join(words.replace("``", "`").split())
                for names, words in re.findall(r"^(\w[\w, ]*)\n((?: +.*\n?)+)", attributes, re.MULTILINE)
                for name in names.split(", ")
            }
            for entry in fields(kind):
                if f"{section}.{entry.name}" not in TAKEN_FROM_ELSEWHERE:
                    hint = field_hints(kind)[entry.name]
                    words = _kind_in_words(hint), entry.default, unit_of(hint), meanings[entry.name]
                    keys.append(KeyReference(section, entry.name, attribute, *words, accepted_values(hint)))
    return tuple(keys)


def _kind_in_words(hint: Any) -> str:  # noqa: ANN401 - a type hint has no type of its own
    """Name of a type in words."""
    if is_dataclass(hint):
        return "table"
    inner = [argument for argument in get_args(hint) if argument not in (NoneType, ...)]
    if get_origin(hint) is Annotated:
        return _kind_in_words(inner[0])
    if get_origin(hint) is tuple:
        count = f"{len(inner)} " if len(inner) > 1 else ""
        return f"list of {count}{_kind_in_words(inner[0])}s"
    words = {int: "whole number", float: "number", bool: "true or false", str: "text"}
    return words.get(hint) or " or ".join(
        dict.fromkeys(words.get(type(arm)) or _kind_in_words(arm) for arm in inner)  # choices are texts
    )


def full_text(preset: str) -> str:
    """Text of an example configuration with every key, its meaning and accepted values."""
    text = preset_text(preset)
    configuration = read_configuration(tomllib.loads(text))
    lines = [line for line in text.partition("\n\n")[0].splitlines() if "left out" not in line]
    lines.append("# Keys that are commented out are not set; the text above them describes the default.")
    for section in SECTIONS:
        lines += ["", f"[{section}]"]
        for key in (key for key in key_references() if key.section == section):
            value = getattr(getattr(configuration, key.attribute), key.name)
            words = key.meaning.replace("`", "") + (f" Accepted: {key.accepted}." if key.accepted else "")
            lines += textwrap.wrap(words, 110, initial_indent="# ", subsequent_indent="# ")
            lines.append(f"# {key.name} =" if value is None else f"{key.name} = {written(value)}")
    return "\n".join(lines) + "\n"


def calibration_note(configuration: Configuration) -> str:
    """Message about values of an example that were calibrated for another material; empty without any."""

    def values(owner: Configuration, *names: str) -> dict[str, Any]:
        """None where a later key has its default, which campaigns do not store."""
        return {name: owner.physics[name.split(".")[0]].get(name.split(".")[1]) for name in names}

    material = ("sand.shear_modulus", "sand.poisson_ratio", "cement.bond_modulus", "cement.linear_modulus")
    given, own = values(configuration, *CALIBRATED).items(), values(configuration, *material)
    for preset in PRESETS:
        fitted = read_configuration(tomllib.loads(preset_text(preset)))
        kept = given & values(fitted, *CALIBRATED).items() - values(Configuration(), *CALIBRATED).items()
        changed = values(fitted, *material).items() - own.items()
        if kept and changed:
            return (
                f"Note: {', '.join(f'{name} = {written(value)}' for name, value in sorted(kept))}: calibrated with "
                f"{', '.join(f'{name} = {written(value)}' for name, value in sorted(changed))} (preset {preset}), but "
                f"here that is {', '.join(written(own[name]) for name, _ in sorted(changed))}. Leave the calibrated "
                "values out, or fit them to measurements of this material with 'calcidem calibrate'."
            )
    return ""


MINERALS = {
    "quartz": Sand(shear_modulus=44e9, poisson_ratio=0.08, density=2650.0),
    "carbonate": Sand(shear_modulus=32e9, poisson_ratio=0.32, density=2710.0),
    "calcite": Sand(shear_modulus=32e9, poisson_ratio=0.32, density=2710.0),
    "glass": Sand(shear_modulus=29e9, poisson_ratio=0.2, density=2500.0),
}
"""Materials of the grains: Mavko, Mukerji and Dvorkin (2009), The Rock Physics Handbook, doi:10.1017/CBO9780511626753,
tables of mineral moduli; beads of glass: Makse, Gland, Johnson and Schwartz (1999), doi:10.1103/PhysRevLett.83.5070.
"""


class _Multiple(float):
    """A number that is written multiplied: ``{d:0.41}`` is 0.41 d with four significant digits."""

    def __format__(self, factor: str) -> str:
        """Write so many times the number."""
        return _short(float(factor) * self)


@dataclass(frozen=True, slots=True)
class OwnDisks:
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
        x, y, radius, _ = checked_disks(file)
        width = float(f"{np.max(x + radius):.6g}")
        # Below the lid, which compresses loose disks: at rest they cover 0.8 of their box.
        at_rest = float(np.pi * np.sum(radius**2)) / (0.8 * width)
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
    """Key of `MINERALS`, or shear modulus, Poisson's ratio and density, see `read_mineral`."""
    contents: Sequence[float]
    """Calcite contents, percent of the sand's mass."""
    disks: OwnDisks | None = None
    """Disks, if given."""
    limits: tuple[float, float] = (0.83, 1.17)
    """Smallest and largest diameter over the mean; by default those of the paper's sand."""
    grading: tuple[float, float, float] | None = None
    """d10, d50 and d90 by mass, m, if given."""

    @classmethod
    def of_words(
        cls, size: str | Path, stress: str, mineral: str, contents: str, folder: Path, option: str = "--grain-size"
    ) -> Self:
        """Understand the options of `calcidem init`: the size in words, or the file of the disks; the others in words.

        The size is the mean diameter, or d10, d50 and d90 with commas between them, and ``option`` gave it. Disks are
        named relative to the configuration's folder. `ConfigurationError` with everything that is wrong;
        `PackingFileError`, naming the line, if the file has no disks.
        """
        problems: list[Problem] = []

        def quantity(option: str, name: str, text: str) -> float:
            try:
                return parse_quantity(name, text)
            except ValueError as error:
                problems.append(Problem(f"{option}: {error}"))
                return math.nan

        disks = OwnDisks.read(size, folder) if isinstance(size, Path) else None
        graded: tuple[tuple[float, float], tuple[float, float, float]] | tuple[()] = ()
        sizes = [] if disks else [quantity(option, "grain size", part) for part in str(size).split(",")]
        if len(sizes) == 3 and sizes == sorted(set(sizes)):
            smallest, largest = uniform_limits(*sizes)
            mean = 0.5 * (smallest + largest)
            graded, sizes = ((smallest / mean, largest / mean), (sizes[0], sizes[1], sizes[2])), [mean]
        elif len(sizes) > 1:
            problems.append(Problem(f"{option} {size}: give the mean diameter, or increasing d10, d50 and d90"))
        diameter = float(f"{disks.diameters[1] if disks else sizes[0]:.3g}")
        pressure = quantity("--stress", "stress", stress)
        try:
            read_mineral(mineral)
        except ValueError as error:
            problems.append(Problem(f"--mineral {mineral}: {error}"))
        try:
            percentages = [float(part) for part in contents.split(",")]
        except ValueError:
            percentages = [math.nan]
        if not all(0.0 <= percentage <= 100.0 for percentage in percentages):  # percent
            problems.append(Problem(f"--contents {contents}: give percent of the sand's mass, from 0 to 100"))
        if problems:
            raise ConfigurationError("the sand", problems)
        return cls(diameter, pressure, mineral, percentages, disks, *graded)

    @property
    def box(self) -> tuple[float, float]:
        """Width and height, m.

        A width of 30 holds 2.5 wavelengths of 11 grains, with little dispersion and scattering. The side walls, with
        transmitter and receiver, are wider than the path.
        """
        if self.disks is not None:
            return self.disks.width, self.disks.height
        return 30.0 * self.grain_size, 50.0 * self.grain_size

    @property
    def sand(self) -> Sand:
        """Material of disks of unit thickness.

        A disk stands for a row of 1 m / d grains. Each of its contacts is as many contacts of spheres in parallel,
        which multiplies the modulus. So the overlap over the radius is that of grains under the stress.
        """
        mineral = read_mineral(self.mineral)
        return Sand(mineral.shear_modulus / self.grain_size, mineral.poisson_ratio, mineral.density)

    @property
    def overlap(self) -> float:
        """Expected mean overlap over the radius, ``(3 sqrt(2) (1 - nu) stress / G)^(2/3)``, for any grain size."""
        return expected_overlap(self.stress, self.grain_size, self.sand)

    @property
    def bond_modulus(self) -> float:
        """Modulus of a bond as stiff as a row of grains welded over the width of the cement, Pa.

        ``k_n = 4 G b / (1 - nu)`` for two spheres welded over the radius b: Digby (1981), The effective elastic moduli
        of porous granular rocks, J. Appl. Mech. 48, 803, doi:10.1115/1.3157738. With b = width / 2, a width of
        0.41 d, and 1 m / d grains.
        """
        mineral = read_mineral(self.mineral)
        return 2.0 * mineral.shear_modulus * 0.41 / (1.0 - mineral.poisson_ratio)

    @property
    def velocity(self) -> float:
        """Expected shear-wave velocity without cement, m/s.

        Half of that of the hexagonal lattice of such disks, ``V^2 = 3/8 (k_n + k_s) d^2 / m``, since random packings
        have fewer contacts and are softer: 0.48 to 0.53 from 20 kPa to 1 MPa, for both minerals. It increases with the
        power 1/6 of the stress, and does not depend on the grain size.
        """
        tangent = 1.5 * self.stress * self.grain_size / (0.5 * self.overlap * self.grain_size)
        mass = 0.25 * math.pi * self.sand.density * self.grain_size * self.grain_size
        stiffness = 3.0 / 8.0 * tangent * (1.0 + self.sand.shear_ratio)
        return 0.5 * math.pi * self.grain_size * cutoff_frequency(stiffness, mass)

    def text(self) -> str:
        """Text of the configuration of a sand, with the reason for each number.

        `ConfigurationError` if such a sand cannot be computed.
        """
        most = CementRule(sand_density=self.sand.density).pore_content(PackingRule().porosity)
        problems = [
            Problem(f"contents = {content:g}: calcite fills the pores at {most:.3g} %; leave it out")
            for content in self.contents
            if content > most
        ]
        if problems:
            raise ConfigurationError("the sand", problems)
        mineral, d, (width, height) = read_mineral(self.mineral), self.grain_size, self.box
        name = self.mineral if self.mineral in MINERALS else "own mineral"
        waves = WAVELENGTHS * self.velocity / (width - 2.0 * d)  # frequency, over half of the listening depth of 4 d
        template = files("calcidem.app.config").joinpath("own_sand.toml").read_text(encoding="utf-8")
        text = template.format(
            d=_Multiple(d),
            height=_Multiple(height),
            row=1.0 / d,
            mineral=name,
            grains=name.capitalize(),
            size=f"{d * 1e3:g} mm",
            stress=f"{self.stress / 1e3:g} kPa",
            name=f"{name.replace(' ', '-')}-{d * 1e3:g}mm-{self.stress / 1e3:g}kPa",
            contents=sorted(map(float, self.contents)),
            packing=self._packing(),
            pressure=_Multiple(self.stress),
            modulus=_Multiple(self.sand.shear_modulus),
            gigapascals=mineral.shear_modulus / 1e9,
            overlap=self.overlap,
            poisson_ratio=mineral.poisson_ratio,
            density=mineral.density,
            bond_modulus=_Multiple(self.bond_modulus),
            stiffness_ratio=_Multiple(1.0 / self.sand.shear_ratio),
            wavelengths=WAVELENGTHS,
            kilohertz=waves / 1e3,
            amplitude=_short(0.01 * 0.5 * self.overlap * d * waves, 1),
            slowest=_short(0.5 * self.velocity, 2),
            velocity=self.velocity,
        )
        text = re.sub(r"(?m)^(\S.*)  # ", lambda found: f"{found[1]:<40}# ", text)
        if self.disks is None:  # 'run --check' reports further problems of disks in a file
            read_configuration(tomllib.loads(text), "the sand")  # refuses a stress that would crush the grains
        return text

    def _packing(self) -> str:
        """Lines about box and disks, with their reasons."""
        d, (width, height), disks = _Multiple(self.grain_size), self.box, self.disks
        if disks is not None:
            smallest, _, largest = (1e3 * size for size in disks.diameters)
            return (
                f"file = {quote(disks.file)}  # {disks.count} disks of {smallest:.3g} to {largest:.3g} mm\n"
                f"width = {width!r}  # {width / d:.0f} d, and {height / d:.0f} d high at rest; 30 d x 50 d are good"
            )
        low, high = (float(f"{limit:.3g}") for limit in self.limits)
        reason = "equal disks would form a crystal"
        if self.grading is not None:
            below = [d * ((1.0 - share) * low**3 + share * high**3) ** (1 / 3) for share in (0.1, 0.5, 0.9)]
            has, given = (", ".join(f"{1e3 * size:.3g}" for size in sizes) for sizes in (below, self.grading))
            reason = f"d10, d50, d90 {has} mm by mass, {given} mm given"
        mean_square = (low * low + low * high + high * high) / 3.0
        count = round((1.0 - PackingRule().porosity) * width * height / (0.25 * math.pi * d * d * mean_square), -1)
        return (
            f"width = {d:30}  # 30 d: {WAVELENGTHS:g} wavelengths of path, each of 11 grains\n"
            f"height = {d:50}  # 50 d: side walls wider than the path; some {count:.0f} disks in all\n"
            f"diameter = [{format(d, str(low))}, {format(d, str(high))}]  # {low} d to {high} d: {reason}"
        )


def uniform_limits(d10: float, d50: float, d90: float) -> tuple[float, float]:
    """Smallest and largest of uniformly distributed diameters with such a grading by mass, in its unit.

    The mass below d is ``(d^3 - a^3) / (b^3 - a^3)`` for diameters of a to b: that of disks is their area, d^2 each.
    d10 and d90 fix both. If they need b above 2.5 a, d50 does with b = 2.5 a: smaller disks would
    be narrower than the cement in clusters, 0.52 of the mean.
    """
    spread = (d90**3 - d10**3) / 0.8
    smallest, largest = d10**3 - 0.1 * spread, d90**3 + 0.1 * spread
    if largest > 2.5**3 * smallest:
        smallest = 2.0 * d50**3 / (1.0 + 2.5**3)
        largest = 2.5**3 * smallest
    return float(smallest ** (1 / 3)), float(largest ** (1 / 3))


def read_grading(file: Path) -> tuple[float, float, float]:
    """d10, d50 and d90, m, of a table of sizes and percent finer by mass, linear in the logarithm of the size.

    `ConfigurationError` if it lacks a column, a unit or the range of 10 to 90 %; `InputFileError` if it is not text.
    """
    known = {
        "size": "(grain|particle|sieve|mesh)?(size|diameter|opening|aperture)|d|sieve"
        "|korn(grosse|durchmesser)|(sieb|maschen)(weite|offnung)",
        "finer": "(cumulative)?(percent)?(cumulative)?(finer|passing|undersize)(bymass|byweight)?|p|(sieb)?durchgang",
    }
    table = Table.read(read_input(file, 1_000_000), file, known, tuple(known))  # bytes; far more than a grading has
    columns, rows, problems, wrongs = table.places(known), [], list[Problem](), list[tuple[str, str, str]]()
    if missing := [name for name in known if name not in columns]:
        given = ", ".join(table.names) or "no names"
        problems.append(
            Problem(
                f"column {missing[0]}: is missing; there are {given}. Accepted are 'size (mm)', 'diameter', 'sieve' or "
                "'Korngröße', and 'finer (%)', 'passing' or 'Siebdurchgang'"
            )
        )
    else:
        unit, share = (
            unit_in_name(table.names[columns[n]], d)[1] for n, d in (("size", "length"), ("finer", "percent"))
        )
    for number, row in table.rows if not problems else ():
        texts = (*row, "", "")[columns["size"]], (*row, "", "")[columns["finer"]]
        rows.append((value_of(texts[0], "length", unit), value_of(texts[1], "percent", share or "%")))
        if not (0.0 < rows[-1][0] < math.inf and 0.0 <= rows[-1][1] <= 100.0):
            cure = "give a size with its unit, as in a column 'size (mm)', and percent from 0 to 100"
            wrongs.append((f"row {number} = {','.join(row)}", "", cure))
    problems += problems_of_rows(wrongs)
    sizes, finer = np.array(sorted(rows)).reshape(-1, 2).T
    if not problems and (not rows or (np.diff(finer) < 0.0).any() or finer[0] > 10.0 or finer[-1] < 90.0):
        cure = "give percent finer that grows with the size, from 10 or less to 90 or more"
        problems.append(Problem(f"finer = {finer[0]:g} to {finer[-1]:g}: {cure}" if rows else f"rows = 0: {cure}"))
    if problems:
        raise ConfigurationError(str(file), problems)
    d10, d50, d90 = np.exp(np.interp((10.0, 50.0, 90.0), finer, np.log(sizes)))
    return float(d10), float(d50), float(d90)


def read_mineral(text: str) -> Sand:
    """Mineral of a name, or of its shear modulus, Poisson's ratio and density, such as 30GPa,0.2,2500kg/m3.

    `ValueError` for another text.
    """
    if text in MINERALS:
        return MINERALS[text]
    parts = text.split(",")
    if len(parts) == 3:
        modulus, ratio, density = (
            value_of(parts[0], "stress", ""),
            parse_number(parts[1]),
            value_of(parts[2], "density", "kg/m3"),
        )
        if 1e6 <= modulus <= 1e12 and ratio and not ratio[1] and 0.0 <= ratio[0] <= 0.5 and 500.0 <= density <= 20e3:
            return Sand(modulus, ratio[0], density)
    cure = "or shear modulus, Poisson's ratio and density of your own, such as 30GPa,0.2,2500kg/m3"
    raise ValueError(f"give one of {', '.join(MINERALS)}, {cure}")


def parse_quantity(quantity: str, text: str) -> float:
    """Read a ``grain size`` or a ``stress`` with its unit, such as 0.3mm or 100 kPa; return SI units.

    `ValueError` without a known unit, or for an impossible value.
    """
    if quantity == "stress":
        dimension, unit, low, high, example = "stress", "Pa", 1.0, 1e9, "100kPa"
    else:  # beyond these limits a material is not sand
        dimension, unit, low, high, example = "length", "m", 1e-6, 1.0, "0.3mm"
    value = value_of(text, dimension, "")
    cure = f"give a number with one of the units {', '.join(UNITS[dimension])}, such as {example}"
    if math.isnan(value):
        raise ValueError(f"'{text}' is not a {quantity}: {cure}")
    if not low <= value <= high:
        raise ValueError(f"'{text}' is not between {low:g} {unit} and {high:g} {unit}: {cure}")
    return value


def _short(value: float, digits: int = 4) -> str:
    """Write a number of a configuration with this number of significant digits."""
    text = np.format_float_scientific(value, digits - 1, trim="0", exp_digits=1)
    return text if not 1e-4 <= value < 1e6 else repr(float(text))  # what is easy to read
