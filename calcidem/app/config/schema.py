"""Frozen `Configuration` of a campaign, read from a TOML file, the error with its problems, and its stored campaign.

Each section of the file corresponds to one or two dataclasses, whose fields are its keys. If there are two, one is from
`calcidem.dem` and the other has additional keys of campaigns.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Interval, Predicate, Unit

from calcidem.dem.engine.fields import Positive, checked, field_hints, quote, require, table_of
from calcidem.dem.engine.fields import Problem as Problem  # noqa: PLC0414 - for all who raise the error
from calcidem.dem.engine.scene import Cement, Installation, Sand
from calcidem.dem.kernels.layout import LANE_COUNTS
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import EXCITATION, Experiment, WaveRule, suitable_frequency
from calcidem.dem.wave.reading import PickRule
from calcidem.storage.errors import CampaignMismatchError, StoreError
from calcidem.storage.records import LARGEST_SEED, CampaignRecord, canonical_content, canonical_hash, canonical_json

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only

    from calcidem.storage.sql.store import Store  # which the ranks do not need


class ConfigurationError(ValueError):
    """A configuration that cannot be computed; the message lists all its problems.

    Attributes
    ----------
    source
        Origin of the configuration, such as a file name.
    problems
        All problems, at least one.
    """

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        lines = "".join(f"\n  {problem.message}" for problem in problems)
        super().__init__(f"{source}: {count}, nothing was computed{lines}")
        self.source = source
        self.problems = problems

    def __reduce__(self) -> tuple[type["ConfigurationError"], tuple[str, Sequence[Problem]]]:
        """Pickle with both arguments."""
        return type(self), (self.source, self.problems)


PHYSICS_VERSION = 5
"""Part of the campaign's hash; increase it with each change of results or defaults."""


@checked
@dataclass(frozen=True, slots=True)
class WantedIntervals:
    """Table ``until`` of section ``[campaign]``: relative half-widths of 95 % intervals.

    Attributes
    ----------
    mean, sd
        Half-widths for mean and standard deviation of Vs at each content; None for any width.
    """

    mean: Annotated[float, Interval(gt=0.0, lt=1.0)] | None = None
    sd: Annotated[float, Interval(gt=0.0, lt=1.0)] | None = None

    def __post_init__(self) -> None:
        """Refuse a table without a value."""
        asked = self.mean is not None or self.sd is not None
        require(asked, "mean", self.mean, "give mean or sd, for instance mean = 0.02", "sd")


@checked
@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """Section ``[campaign]``: cells to compute.

    Attributes
    ----------
    name
        Name of the campaign and its files.
    seeds
        Seeds of the cement patterns.
    contents
        Calcite contents, percent of the sand's mass.
    root_seed
        Root of all random numbers.
    until
        Relative half-widths of the 95 % intervals of mean and standard deviation: each content begins with `seeds`
        seeds and gets more until they are reached.
    most_seeds
        Most seeds of a content with `until`.
    """

    name: Annotated[
        str,
        Predicate(lambda name: name.strip() == name != "" and not set(name) & set("/\\\0\n")),
        Predicate(lambda name: len(name.encode()) <= 200),  # of the 255 bytes of file systems, endings need some
        "a name that can be part of a file name, of at most 200 bytes",
    ] = "campaign"
    seeds: Annotated[
        Annotated[int, Interval(ge=1, le=1_000_000)]
        | Annotated[
            tuple[Annotated[int, Interval(ge=0, le=LARGEST_SEED)], ...],
            Predicate(lambda seeds: 0 < len(seeds) == len(set(seeds)) <= 1_000_000),
        ],
        "a number n for the seeds 1 to n, or a list such as [1, 2, 5] that has every seed once; "
        "at most 1000000 seeds of 0 to 2^63 - 1",
    ] = 4
    contents: Annotated[
        tuple[Annotated[float, Interval(ge=0.0, le=100.0)], ...],
        Predicate(lambda contents: 0 < len(contents) == len(set(map(canonical_content, contents)))),  # as stored
        Unit("percent"),
        "a list of percentages of 0 to 100 such as [0.0, 0.66, 5.0] that has every content once",
    ] = tuple(content for content, _ in EXCITATION)
    root_seed: Annotated[int, Interval(ge=0)] = 0
    until: Annotated[
        WantedIntervals | None,
        table_of(WantedIntervals),
        "a table { mean = 0.02, sd = 0.10 } of one or both, or leave the key out",
    ] = None
    most_seeds: Annotated[int, Interval(ge=1, le=1_000_000)] = 1000

    def __post_init__(self) -> None:
        """Refuse a list of seeds with `until`, and fewer than 8: their standard deviation is too uncertain.

        Contents are those of cells, to 1e-9 percent.
        """
        object.__setattr__(self, "contents", tuple(map(canonical_content, self.contents)))
        if self.until is not None:
            cure = f"give a number of 8 to campaign.most_seeds, {self.most_seeds}: until adds to it"
            fits = isinstance(self.seeds, int) and 8 <= self.seeds <= self.most_seeds
            require(fits, "seeds", quote(self.seeds), cure, "until", "most_seeds")

    @property
    def seed_numbers(self) -> tuple[int, ...]:
        """All seeds."""
        return tuple(range(1, self.seeds + 1)) if isinstance(self.seeds, int) else self.seeds


@checked
@dataclass(frozen=True, slots=True)
class PackingDraw:
    """Further keys of section ``[packing]``: seed of the packing, or the user's file of disks.

    Attributes
    ----------
    seed
        Seed of the random sizes and positions.
    file
        CSV file of disks (`calcidem.dem.sample.compaction`), relative to the configuration's folder.
    file_sha256
        SHA-256 of the file's content, 64 hexadecimal digits; the campaign's identity depends on the content, not the
        name.
    """

    seed: Annotated[int, Interval(ge=0)] = 1
    file: Annotated[str, Predicate(bool), "the name of a CSV file, or leave the key out"] | None = None
    file_sha256: str | None = None


SETTLED_BY_FILE = ("seed", "height", "diameter", "porosity", "expansion_steps")
"""Keys of ``[packing]`` without meaning if the disks are in a file."""


@checked
@dataclass(frozen=True, slots=True)
class Calibration:
    """Further keys of section ``[sand]``.

    Attributes
    ----------
    wave_stiffness_factor
        Factor on the grains' modulus and the confining stress during the wave.
    """

    wave_stiffness_factor: Annotated[Positive, "a positive factor, 1 for none"] = 1.0


@checked
@dataclass(frozen=True, slots=True)
class Bonding:
    """Further keys of section ``[cement]``.

    Attributes
    ----------
    installation
        How bonds start on loaded contacts, see `calcidem.dem.Bonds`.
    """

    installation: Installation = "preserve"


@checked
@dataclass(frozen=True, slots=True)
class FrequencyTable:
    """Section ``[wave.frequency]``: excitation frequencies, linear between the contents given.

    Attributes
    ----------
    content
        Increasing contents, percent.
    frequency
        One for each content, Hz.
    """

    content: Annotated[
        tuple[float, ...],
        Predicate(
            lambda content: () != content == tuple(sorted(set(content))) and 0.0 <= content[0] <= content[-1] <= 100.0
        ),
        Unit("percent"),
        "increasing contents in percent, from 0 to 100",
    ]
    frequency: Annotated[tuple[Positive, ...], Unit("Hz"), "a list of positive frequencies in Hz"]

    def __post_init__(self) -> None:
        """Refuse tables that cannot be interpolated."""
        cure = f"give one positive frequency in Hz for each of the {len(self.content)} contents"
        require(len(self.frequency) == len(self.content), "frequency", quote(self.frequency), cure, "content")

    def covers(self, content: float) -> bool:
        """Whether a content lies within the table."""
        return self.content[0] <= content <= self.content[-1]

    def at(self, content: float) -> float:
        """Frequency at a content, Hz."""
        return float(np.interp(content, self.content, self.frequency))


@checked
@dataclass(frozen=True, slots=True)
class Excitation:
    """Further keys of section ``[wave]``.

    Attributes
    ----------
    frequency
        Excitation frequency, Hz; Table 2 of the paper by default. ``"auto"`` chooses it for each content from the
        static stiffness of three samples, so that the path is 2.5 wavelengths.
    """

    frequency: Annotated[
        Positive | FrequencyTable | Literal["auto"] | None,
        table_of(FrequencyTable),
        Unit("Hz"),
        'a positive frequency in Hz, a table { content = [...], frequency = [...] }, or "auto"',
    ] = None

    @property
    def table(self) -> FrequencyTable | None:
        """Frequencies as a table; None if they are chosen from the samples."""
        if self.frequency == "auto":
            return None
        if isinstance(self.frequency, FrequencyTable):
            return self.frequency
        if self.frequency is None:
            contents, frequencies = zip(*EXCITATION, strict=True)
            return FrequencyTable(contents, frequencies)
        return FrequencyTable((0.0, 100.0), (self.frequency, self.frequency))


def _is_part(text: str) -> bool:
    """Whether a text has the form K/N of a part's number and the number of parts."""
    found = re.fullmatch("([0-9]{1,6})/([0-9]{1,6})", text)
    return found is not None and 1 <= int(found[1]) <= int(found[2])


@checked
@dataclass(frozen=True, slots=True)
class RunOptions:
    """Section ``[run]``: settings that do not change the physics.

    Attributes
    ----------
    lanes
        Cells computed side by side.
    store_sections
        Whether sections are stored, about 10 kB a cell.
    static_speed
        Whether static speeds are computed.
    gpu
        Whether NVIDIA GPUs propagate the waves; `lanes` of 32 use them best.
    time_limit
        Largest time of a batch, s.
    output
        Folder for the database and the NetCDF file.
    database
        SQLite file or database URL; ``<output>/<name>.db`` by default, ``<output>/<name>-part-3-of-8.db`` for a part.
    part
        Part of the cells to compute, of about equal effort. `calcidem merge` joins the databases.
    """

    lanes: Annotated[int, Predicate(LANE_COUNTS.__contains__), "1, 2, 4, 8, 16 or 32"] = 8
    store_sections: bool = True
    static_speed: bool = False
    gpu: bool = False
    time_limit: (
        Annotated[
            float,
            Interval(gt=0.0, le=1e9),  # some clocks end at 2^31 s
            Unit("s"),
            "seconds above 0 and up to 1e9, or leave the key out",
        ]
        | None
    ) = None
    output: Annotated[str, Predicate(bool), 'the name of a folder, "." for the present one'] = "results"
    database: Annotated[str, Predicate(bool), "a file name, or leave the key out"] | None = None
    part: (
        Annotated[
            str,
            Predicate(_is_part),
            '"3/8" for the third of eight parts, counted from 1 (of a Slurm array: --array=1-8)',
        ]
        | None
    ) = None

    @property
    def part_numbers(self) -> tuple[int, int]:
        """Number of the part, from 1, and of all parts."""
        number, _, parts = (self.part or "1/1").partition("/")
        return int(number), int(parts)


@checked
@dataclass(frozen=True)
class Configuration:
    """Configuration of a campaign; `calcidem.app.config.reader` reads it.

    Attributes
    ----------
    campaign, run
        Planned cells, and settings of computing and storing; neither changes the result of a cell.
    packing, packing_draw
        Rule of the packing, and its seed or file.
    sand, calibration, cement, bonding
        Materials, and initial state of bonds.
    pattern
        Distribution of the cement.
    wave, excitation
        Transmitted wave, and its frequency.
    pick
        Method and criteria of a reading.
    """

    campaign: CampaignPlan = field(default_factory=CampaignPlan)
    packing: PackingRule = field(default_factory=PackingRule)
    packing_draw: PackingDraw = field(default_factory=PackingDraw)
    sand: Sand = field(default_factory=Sand)
    calibration: Calibration = field(default_factory=Calibration)
    cement: Cement = field(default_factory=Cement)
    bonding: Bonding = field(default_factory=Bonding)
    pattern: CementRule = field(default_factory=CementRule)
    wave: WaveRule = field(default_factory=WaveRule)
    excitation: Excitation = field(default_factory=Excitation)
    pick: PickRule = field(default_factory=PickRule)
    run: RunOptions = field(default_factory=RunOptions)

    @classmethod
    def from_physics(cls, physics: Mapping[str, Any]) -> Self:
        """Rebuild the physics of cells, without the making of the packing and the planned cells.

        `StoreError` if a section of `physics` is missing, `ValueError` if this version refuses a value.
        """
        sections = ("sand", "cement", "pattern", "wave", "pick")
        if missing := [name for name in ("root_seed", *sections) if name not in physics]:
            raise StoreError(
                f"The stored configuration lacks {', '.join(missing)}: its cells can't be computed again.",
                "Only campaigns that 'calcidem run' made have a complete one.",
            )
        parts: dict[str, Any] = {
            part: kind(**{name: physics[section][name] for name in field_hints(kind) if name in physics[section]})
            for section in sections
            for part, kind in SECTIONS[section].items()
        }
        return cls(CampaignPlan(root_seed=physics["root_seed"]), **parts)

    @cached_property
    def physics(self) -> dict[str, Any]:
        """All settings that change the result of a cell, by section, ready for JSON."""
        table = self.excitation.table
        return {
            "physics_version": PHYSICS_VERSION,
            "root_seed": self.campaign.root_seed,
            "packing": self.packing_origin,
            "sand": _to_stored(self.sand, self.calibration),
            "cement": _to_stored(self.cement, self.bonding),
            "pattern": _to_stored(self.pattern),
            "wave": _to_stored(self.wave) | {"frequency": "auto" if table is None else _to_stored(table)},
            "pick": _to_stored(self.pick),
        }

    @property
    def packing_origin(self) -> dict[str, Any]:
        """Settings that determine the packing, ready for JSON, without irrelevant keys and file names."""
        values = _to_stored(self.packing, self.packing_draw)
        left_out = ("file", *(SETTLED_BY_FILE if values["file"] is not None else ()))
        return {name: value for name, value in values.items() if name not in left_out and value is not None}

    @cached_property
    def hash(self) -> str:
        """Identity of the campaign's physics: SHA-256 of the values other than defaults, 64 hexadecimal digits.

        A key at its default is not hashed, so a new key does not change the identity of campaigns. Keys that only
        choose cells or machines are not part of `physics`.
        """
        return canonical_hash({"physics_version": PHYSICS_VERSION} | _departures(self.physics, Configuration().physics))

    @cached_property
    def packing_hash(self) -> str:
        """Identity of the packing's rule: hash of its settings that differ from the defaults."""
        departures = _departures(self._packing_maker, Configuration()._packing_maker)  # noqa: SLF001 - the same class
        return canonical_hash({"identity_of": "packing", "physics_version": PHYSICS_VERSION} | departures)

    @property
    def _packing_maker(self) -> dict[str, Any]:
        """Settings that determine the packing, without the sand's friction, which the packing does not use."""
        sand = _to_stored(replace(self.sand, friction=self.packing.friction_preparation))
        maker = {"packing": self.packing_origin, "sand": sand}
        # Disks from a file are not random.
        return maker if self.packing_draw.file is not None else maker | {"root_seed": self.campaign.root_seed}

    @property
    def output(self) -> Path:
        """Folder for the results."""
        return Path(self.run.output)

    @property
    def database(self) -> str:
        """File name or URL of the database."""
        number, parts = self.run.part_numbers
        part = "" if self.run.part is None else f"-part-{number}-of-{parts}"
        return self.run.database or str(self.output / f"{self.campaign.name}{part}.db")

    @property
    def netcdf(self) -> Path:
        """File name of the export: beside the database, or in the output folder for a database on a server."""
        from calcidem.storage.sql.engine import Address  # noqa: PLC0415 - ranks need no database

        path = Address.parse(self.database).path
        if path is None:
            return self.output / f"{self.campaign.name}.nc"
        known = path.suffix in {".db", ".sqlite", ".sqlite3"}  # others may tell two databases apart
        return path.with_suffix(".nc") if known else path.with_name(f"{path.name}.nc")

    def record(self) -> CampaignRecord:
        """Return the record of the campaign, without its plan."""
        return CampaignRecord(
            hash=self.hash,
            name=self.campaign.name,
            config=canonical_json(self.physics),
            contents=(),
            seeds=(),
            created=datetime.now(UTC),
        )

    def experiment(self, packing: Packing) -> Experiment:
        """Common settings of all cells, with their packing."""
        table = self.excitation.table
        return Experiment(
            packing=packing,
            sand=self.sand,
            cement=self.cement,
            cement_rule=self.pattern,
            wave=self.wave,
            pick=self.pick,
            root_seed=self.campaign.root_seed,
            stiffness_factor=self.calibration.wave_stiffness_factor,
            installation=self.bonding.installation,
            frequencies=suitable_frequency if table is None else (table.content, table.frequency),
            gpu=self.run.gpu,
        )


def _departures(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Keys, at all levels, with values other than the defaults."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        default = defaults.get(key)
        departing = _departures(value, default) if isinstance(value, dict) and isinstance(default, dict) else value
        if value != default:
            found[key] = departing
    return found


def _to_stored(*parts: "DataclassInstance") -> dict[str, Any]:
    """Keys and values of a section for stored configurations, ready for JSON."""
    values = {name: value for part in parts for name, value in asdict(part).items()}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


SECTIONS: dict[str, dict[str, type["DataclassInstance"]]] = {
    "campaign": {"campaign": CampaignPlan},
    "packing": {"packing": PackingRule, "packing_draw": PackingDraw},
    "sand": {"sand": Sand, "calibration": Calibration},
    "cement": {"cement": Cement, "bonding": Bonding},
    "pattern": {"pattern": CementRule},
    "wave": {"wave": WaveRule, "excitation": Excitation},
    "pick": {"pick": PickRule},
    "run": {"run": RunOptions},
}
"""Sections of the file, with the attributes of `Configuration` from each, and their types."""

TAKEN_FROM_ELSEWHERE = {"pattern.sand_density": "sand.density", "packing.file_sha256": "packing.file"}
"""Keys that files do not have, since another key has the same meaning."""


def refuse_other_physics(record: CampaignRecord, configuration: Configuration | None = None) -> None:
    """Raise `CampaignMismatchError` unless a campaign was computed with this program's `PHYSICS_VERSION`.

    If a configuration is given, the physics must be the same, too.
    """
    stored = record.physics_version
    if stored != PHYSICS_VERSION:
        raise CampaignMismatchError(
            f"The campaign '{record.name}' was computed with physics version {stored}, this calcidem has version "
            f"{PHYSICS_VERSION}: the same cells get other bits.",
            "Its results can be read, reported and exported as before. Use the calcidem that computed it for more "
            "cells or to verify it, or begin a new database.",
        )
    if configuration is not None:
        record.refuse_other(configuration.record())


def choose_campaign(store: "Store", configuration: Configuration) -> bool:
    """Choose the configuration's campaign in a store; return whether the store has it.

    `CampaignMismatchError` if it has another campaign of that name, or this campaign under another name.
    """
    name = configuration.campaign.name
    for record in store.campaigns():
        if record.name == name:
            refuse_other_physics(record, configuration)
            store.use_campaign(name)
            return True
    for record in store.campaigns():
        if record.hash == configuration.hash:
            raise CampaignMismatchError(
                f"campaign.name = '{name}': the database has this campaign under the name '{record.name}'.",
                f"Set campaign.name to '{record.name}', or give another database.",
            )
    return False
