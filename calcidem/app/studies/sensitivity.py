"""Dependence of Vs on the choices of a campaign: variants from a file, and frequency or damping of stored samples.

The latter follow section 3.1 of the paper.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calcidem.analysis.distribution import Change, paired_changes
from calcidem.analysis.figures.registry import STUDY_FIGURES
from calcidem.analysis.measured import published_study
from calcidem.analysis.velocity import FEWEST_WAVELENGTHS
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import stored_experiment
from calcidem.app.campaign.run import run
from calcidem.app.config.reader import parse_file, put_values, read_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, Problem, refuse_other_physics
from calcidem.app.studies.study import Cells, StudyResult, markdown_table
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.check import check_content, with_check
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, interpret
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.reading import Method
from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.sql.store import read_campaign
from calcidem.wording import ABSENT, number, pluralize, tell

REFERENCE = "reference"
"""Name of the unchanged configuration."""


class _ListedVariant(BaseModel):
    """One ``[[variant]]`` of the file: the choice and its value in words, and the changed keys."""

    model_config = ConfigDict(strict=True, extra="forbid")

    choice: str
    value: str
    change: dict[str, Any] = Field(default_factory=dict, alias="set")
    """New values by ``section.key``."""
    without: list[str] = Field(default_factory=list)
    """Keys to omit, so that they have their defaults."""
    against: str = REFERENCE
    """Name of the variant to compare with, if it is not the reference."""
    contents: list[float] | None = None
    seeds: int | None = Field(default=None, ge=2)

    @property
    def name(self) -> str:
        """Name of the variant, and of its campaign in the database."""
        return f"{self.choice}: {self.value}" if self.choice != REFERENCE else REFERENCE


class _ListedPlan(BaseModel):
    """Whole file: path of the varied TOML file relative to it, contents in percent, number of seeds, variants."""

    model_config = ConfigDict(strict=True, extra="forbid")

    configuration: str
    contents: list[float]
    seeds: int = Field(ge=2)
    variant: list[_ListedVariant] = Field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Variant:
    """Variant ready for computation."""

    name: str
    """Name of the variant and of its campaign in the database."""
    choice: str
    value: str
    """Choice and its value in words."""
    against: str
    """Name of the variant to compare with."""
    configuration: Configuration
    """Configuration to compute."""


def read_variants(path: str | os.PathLike[str], database: str) -> tuple[Variant, ...]:
    """Read a file (`_ListedPlan`): the variants of a configuration, with the same seeds; the reference comes first.

    The database stores each variant as a separate campaign. `ConfigurationError` lists all problems of the file and of
    the resulting configurations.
    """
    source = os.fspath(path)
    try:
        listed = _ListedPlan.model_validate(parse_file(Path(path))[0])
    except ValidationError as error:
        words = {"missing": "is missing; add it", "extra_forbidden": "is not known; leave it out"}
        found = (
            (".".join(map(str, detail["loc"])), words.get(detail["type"], detail["msg"])) for detail in error.errors()
        )
        raise ConfigurationError(source, [Problem(f"{place}: {words}") for place, words in found]) from None
    base, _ = parse_file(Path(path).parent / listed.configuration)
    put_values(base, {"run.database": database, "run.store_sections": False})
    _omit(base, "run.part")
    known = {REFERENCE, *(variant.name for variant in listed.variant)}
    problems = [
        Problem(f'variant "{variant.name}": against = "{variant.against}" is none of the variants; correct it')
        for variant in listed.variant
        if variant.against not in known
    ]
    if len(known) != 1 + len(listed.variant):
        problems.append(Problem("two variants have the same choice and value; rename one"))
    if problems:
        raise ConfigurationError(source, problems)
    first = _ListedVariant(choice=REFERENCE, value="")
    variants = {entry.name: _variant(entry, base, listed, source) for entry in (first, *listed.variant)}
    if problems := list(_problems_of_variants(variants)):
        raise ConfigurationError(source, problems)
    return tuple(variants.values())


def _problems_of_variants(variants: Mapping[str, Variant]) -> Iterator[Problem]:
    """Variants that are no campaigns of their own, or have cells that the variant beside them lacks."""
    first: dict[str, str] = {}
    for name, variant in variants.items():
        if (same := first.setdefault(variant.configuration.hash, name)) != name:
            yield Problem(f'variant "{name}": changes no value of "{same}"; remove it, or change one')
        against = variants[variant.against].configuration.campaign
        if lacking := sorted(set(variant.configuration.campaign.contents) - set(against.contents)):
            listed = ", ".join(f"{content:g}" for content in lacking)
            yield Problem(f'variant "{name}": contents = {listed}: "{variant.against}" has no such cells; remove them')


def compute_variants(variants: Sequence[Variant], say: Callable[[str], None], executor: Executor | None = None) -> None:
    """Compute all cells that the database lacks, variant by variant; the same call continues after a stop.

    `CampaignMismatchError` if the database has a variant of that name with other parameters.
    """
    for place, variant in enumerate(variants, start=1):
        say(f"{place} of {len(variants)}: {variant.name}")
        run(variant.configuration, executor=executor).close()


def variant_changes(variants: Sequence[Variant]) -> dict[str, tuple[Change, ...]]:
    """Compare every computed variant with its reference variant, by its name; errors as `compute_variants`."""
    found: dict[str, xr.DataArray] = {}
    for variant in variants:
        plan = variant.configuration.campaign
        # None of its cells may be computed, and a database may contain more of them from an earlier plan.
        with suppress(UnknownCampaignError), open_campaign(variant.configuration.database, variant.name) as campaign:
            refuse_other_physics(campaign.record, variant.configuration)
            found[variant.name] = campaign.vs().reindex(seed=list(plan.seed_numbers), content=sorted(plan.contents))
    return {
        variant.name: paired_changes(found[variant.name], found[variant.against])
        for variant in variants
        if variant.name in found and variant.against in found
    }


def variant_table(variants: Sequence[Variant]) -> StudyResult:
    """Table of the `variant_changes`: a row for each variant, a column for each content of the reference.

    An entry has mean and standard deviation in m/s. Below them are the change of the mean, and the ratio of standard
    deviations with its 95 % interval, in bold if the interval excludes 1.
    """
    changes = variant_changes(variants)
    contents = [change.content for change in changes.get(REFERENCE, ())]
    rows = []
    former = ""
    for variant in variants:
        found = {change.content: change for change in changes.get(variant.name, ())}
        if not found:
            continue
        choice = variant.choice if variant.choice != former else ""
        former = variant.choice
        entries = [_table_entry(found.get(content), is_reference=variant.name == REFERENCE) for content in contents]
        value = variant.value if variant.against == REFERENCE else f"{variant.value} (against {variant.against})"
        rows.append((choice, value, *entries))
    header = ("choice", "value", *(f"{content:g} %" for content in contents))
    return StudyResult(markdown_table(header, rows) + "\n")


def _omit(document: dict[str, Any], *names: str) -> None:
    """Omit keys by section and key; entries that are not tables are left for the reader to refuse."""
    for name in names:
        section, _, key = name.partition(".")
        if isinstance(table := document.setdefault(section, {}), dict):
            table.pop(key, None)


def _variant(entry: _ListedVariant, base: Mapping[str, Any], plan: _ListedPlan, source: str) -> Variant:
    """Variant of the configuration ``base``."""
    document = put_values(deepcopy(dict(base)), entry.change)
    _omit(document, *entry.without, "campaign.until", "campaign.most_seeds")
    own = {"name": entry.name, "seeds": entry.seeds or plan.seeds, "contents": entry.contents or plan.contents}
    put_values(document, {f"campaign.{key}": value for key, value in own.items()})
    folder = (Path(source).parent / plan.configuration).parent
    configuration = read_configuration(document, f"{source}, {entry.name}", folder)
    return Variant(entry.name, entry.choice, entry.value, entry.against, configuration)


def _table_entry(change: Change | None, *, is_reference: bool) -> str:
    """One entry of the table."""
    if change is None or not change.measured:
        return ABSENT if change is None else f"none of {change.planned} read"
    text = f"{change.mean:.0f} ± {change.standard_deviation:.0f}"
    if not is_reference and math.isfinite(change.deviation_ratio):
        interval = change.deviation_ratio_interval
        scatter = f"x {change.deviation_ratio:.2f} ({interval.low:.2f} to {interval.high:.2f})"
        scatter = scatter if interval.contains(1.0) else f"**{scatter}**"
        text += f"<br>{100.0 * (change.mean_ratio - 1.0):+.1f} %, {scatter}"
    if change.measured < change.planned:
        text += f"<br>{change.measured} of {change.planned} read"
    return text


_METHODS: tuple[Method, ...] = get_args(Method)


def _frequency_study(
    experiment: Experiment,
    *,
    contents: Sequence[float] = (0.66, 3.17, 6.0, 8.0),
    frequencies: Sequence[float] = (4e3, 8e3, 12e3, 16e3, 20e3, 25e3),
    seeds: Sequence[int] = (1, 2, 3, 4),
) -> xr.Dataset:
    """Measure the same samples at contents (%) at several frequencies, Hz (Figs. 6 and 9 of the paper).

    Returns `vs_peak`, `vs_first_arrival`, `vs_cross_correlation` (m/s) and `received_frequency` (Hz) along (content,
    frequency, seed), NaN without a reliable reading. `campaign_frequency` (Hz) along content is that of the experiment
    itself. The attribute `distance` (m) is that between transmitter and receiver.
    """
    shape = (len(contents), len(frequencies), len(seeds))
    values = {name: np.full(shape, np.nan) for name in (*(f"vs_{m}" for m in _METHODS), "received_frequency")}
    cells = Cells(experiment, contents, seeds)
    for column, frequency in enumerate(frequencies):
        tell(f"Frequency {frequency:g} Hz")
        single = replace(experiment, frequencies=((0.0, 100.0), (frequency, frequency)))
        for (seed, content), measurement in cells.measure(single).items():
            for name, value in _readings(single, measurement).items():
                values[name][contents.index(content), column, seeds.index(seed)] = value
    dimensions = ("content", "frequency", "seed")
    study = xr.Dataset(
        {name: (dimensions, numbers) for name, numbers in values.items()},
        coords={"content": list(contents), "frequency": list(frequencies), "seed": list(seeds)},
        attrs={"distance": experiment.distance},
    )
    study["campaign_frequency"] = "content", [experiment.frequency(content) for content in contents]
    _set_units(study)
    return study


def _damping_study(
    experiment: Experiment,
    *,
    contents: Sequence[float] = (0.11, 0.66),
    factors: Sequence[float] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7),
    seed: int = 1,
    periods: float = 6.0,
) -> xr.Dataset:
    """Measure one sample of each content (%) with several local damping factors, 0 to 1 (Fig. 7 of the paper).

    The damping of boundary layers is kept; records are ``periods`` periods of the pulse long. Returns `received`
    (velocity of the receiver, m/s) along (content, damping, sample), `time` (s) along (content, sample), `vs_peak`
    (m/s) along (content, damping), NaN without a reliable reading, and `frequency` (Hz) along content. The attribute
    `distance` (m) is that between transmitter and receiver.
    """
    time = np.stack([np.linspace(0.0, periods / experiment.frequency(content), 600) for content in contents])
    received = np.zeros((len(contents), len(factors), time.shape[1]))
    velocity = np.full(received.shape[:2], np.nan)
    for row, content in enumerate(contents):
        for column, factor in enumerate(factors):
            tell(f"Damping {factor:g} at {content:g} %")
            damped = experiment.with_wave(damping=factor)
            found = _long_measurement(damped, content, seed, float(time[row, -1]))
            if found.section.problem:
                received[row, column] = np.nan
                continue
            received[row, column] = np.interp(time[row], found.section.times, found.section.received)
            velocity[row, column] = _readings(damped, found)["vs_peak"]
    study = xr.Dataset(
        {"received": (("content", "damping", "sample"), received), "vs_peak": (("content", "damping"), velocity)},
        coords={"content": list(contents), "damping": list(factors), "time": (("content", "sample"), time)},
        attrs={"seed": seed, "distance": experiment.distance},
    )
    study["frequency"] = "content", [experiment.frequency(content) for content in contents]
    _set_units(study)
    return study


def _readings(experiment: Experiment, measurement: Measurement) -> dict[str, float]:
    """Return reliable readings of a measurement: vs by each method in m/s, NaN without, and the received frequency, Hz.

    There is no frequency without a velocity by the peak.
    """
    section = measurement.section
    found = {}
    for method in _METHODS:  # what a campaign with this method would store
        read = interpret(replace(experiment, pick=replace(experiment.pick, method=method)), measurement)
        found[f"vs_{method}"] = read.vs or np.nan
    if np.isfinite(found["vs_peak"]):
        found["received_frequency"] = _pulse_frequency(
            section.received,
            section.sampling_interval,
            section.distance / found["vs_peak"] + 0.5 / section.frequency - section.start_time,
            reach=0.1 / section.frequency,
        )
    return found


def _pulse_frequency(signal: Floats, sampling_interval: float, moment: float, reach: float) -> float:
    """Return the frequency of the pulse that peaks at a moment: one over twice its width at half amplitude.

    For ``v0 (1 - cos 2 pi f t)`` this is exactly f. A spectrum fails, since a pulse of one sign has its largest
    amplitude at frequency zero. ``moment`` is the time of the peak after the first sample, ``reach`` the largest
    distance of the maximum from it, all in s. NaN if the signal does not fall to half its peak on both sides.
    """
    near, wide = round(moment / sampling_interval), max(1, round(reach / sampling_interval))
    begin = max(0, near - wide)
    top = begin + int(np.argmax(signal[begin : near + wide + 1]))
    half = signal[top] / 2
    before, after = np.flatnonzero(signal[:top] < half), np.flatnonzero(signal[top:] < half)
    if not (signal[top] > 0 and before.size and after.size):
        return float("nan")
    rise, fall = int(before[-1]), top + int(after[0])
    began = rise + (half - signal[rise]) / (signal[rise + 1] - signal[rise])
    ended = fall - (half - signal[fall]) / (signal[fall - 1] - signal[fall])
    return float(1.0 / (2.0 * (ended - began) * sampling_interval))


def _long_measurement(experiment: Experiment, content: float, seed: int, duration: float) -> Measurement:
    """Record one sample for a given time in s, regardless of arrivals."""
    found = experiment.once(check_content, content, 1)
    patient = with_check(experiment, found).with_wave(slowest=experiment.distance / duration)
    cement, frequency = experiment.ordering(seed).at(content), experiment.frequency(content)
    (section,) = send_waves(
        patient, [cement.bonded], frequency, stop_when=lambda section: section.duration >= duration, lanes=1
    )
    return Measurement(seed, content, cement, section, found)


def _set_units(study: xr.Dataset) -> None:
    units = {"content": "%", "seed": "1", "damping": "1", "time": "s"}
    for name, variable in study.variables.items():
        variable.attrs["units"] = units.get(str(name), "Hz" if "frequency" in str(name) else "m/s")


_STUDIES: dict[str, Callable[..., xr.Dataset]] = {"frequency": _frequency_study, "damping": _damping_study}


def run_studies(
    database: str | os.PathLike[str],
    names: Sequence[str] = ("frequency", "damping"),
    *,
    contents: Sequence[float] | None = None,
    campaign_name: str | None = None,
) -> dict[str, xr.Dataset]:
    """Run the studies "frequency" and "damping" on the samples of a campaign; nothing is written to its database.

    Contents are in percent, by default those of the study. `calcidem.app.report.page.write_report` accepts the results.
    The attribute `published` is 1 for the published sand, else 0.
    `ValueError` if a study is unknown, or the campaign cannot be recomputed from its stored data.
    """
    unknown = sorted(set(names) - set(_STUDIES))
    if unknown:
        raise ValueError(f"study {unknown[0]!r} does not exist; choose from {', '.join(_STUDIES)}")
    with read_campaign(database, campaign_name) as store:
        experiment = stored_experiment(store).with_wave(both_sides=False)  # Vs alone is read
        published = int(published_study().has_sand_of(store.record.parameters))
    chosen = {} if contents is None else {"contents": tuple(dict.fromkeys(contents))}
    return {name: _STUDIES[name](experiment, **chosen).assign_attrs(published=published) for name in names}


def vary_one(varied: str, database: str, contents: Sequence[float] | None, campaign_name: str | None) -> StudyResult:
    """Run one study; its table has the mean of Vs from peak to peak (m/s) over content and varied parameter."""
    study = run_studies(database, [varied], contents=contents, campaign_name=campaign_name)[varied]
    found, unit = study["vs_peak"], " Hz" if varied == "frequency" else ""
    frequency, distance = study.get("frequency", math.nan), study.attrs.get("distance", math.nan)
    near = FEWEST_WAVELENGTHS * found > distance * frequency

    def mean_of_seeds(vs: xr.DataArray) -> str:
        read = int(vs.notnull().sum())
        mark = " *" if bool(near.sel({name: vs[name] for name in ("content", varied)}).any()) else ""
        return number(float(vs.mean()), ".0f") + (f" ({read} of {vs.size} read)" if 0 < read < vs.size else "") + mark

    rows = [
        (f"{content:g}", *(mean_of_seeds(found.sel({"content": content, varied: value})) for value in study[varied]))
        for content in study["content"].values
    ]
    table = markdown_table(("content, %", *(f"{value:g}{unit}" for value in study[varied].values)), rows) + "\n"
    samples = pluralize(found.sizes.get("seed", 1), "sample")
    head = f"Mean Vs from peak to peak, m/s, of {samples}. * fewer than {FEWEST_WAVELENGTHS:g} wavelengths: near field."
    figures = {entry.name: partial(entry.draw, study) for entry in STUDY_FIGURES if entry.study == varied}
    return StudyResult(f"{head}\n\n{table}", dataset=study, figures=figures, formats=("png", "svg", "pdf"))
