"""Packing, cement and sections between simulation and store, as records and as bytes.

A packing comes from its database, from calcidem itself, from the cache, or is made. Cement that is not stored is drawn
again. Loads no kernel before a packing is made, so stored cells can be read and drawn without.
"""

import io
import json
import marshal
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, fields, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calcidem.app.config.presets import preset_packings
from calcidem.app.config.schema import PHYSICS_VERSION, Configuration
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.cement import (
    GIVEN,
    CementCapacityError,
    PlacedCement,
    RandomPurpose,
    UnknownPatternError,
    random_generator,
)
from calcidem.dem.sample.packing import (
    PACKING_METHOD,
    WALL_NAMES,
    Packing,
    PackingFileError,
    PackingReport,
    PackingStage,
    refuse_changed,
)
from calcidem.dem.wave.experiment import Experiment, WaveRule, clamp_of_layers
from calcidem.dem.wave.reading import PickRule, Reading, read_section
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.ends import Verdict
from calcidem.input_file import MOST_BYTES, InputFileError, read_input
from calcidem.storage.errors import DamagedStoreError, OutputRefusedError, StoreError
from calcidem.storage.files import write_atomically
from calcidem.storage.records import CellResult, CementPattern, PackingRecord, RecordedSection, unpack_arrays
from calcidem.wording import tell

if TYPE_CHECKING:
    from calcidem.storage.sql.store import Store  # which the ranks do not need


CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Variable with the folder of the cache, instead of ``$XDG_CACHE_HOME/calcidem``."""


class DamagedPackingError(ValueError):
    """Bytes that `packing_to_bytes` did not make for this configuration, or that were changed."""


def cache_folder() -> Path:
    """Folder of packings for later campaigns; it may not exist yet."""
    own, shared = os.environ.get(CACHE_VARIABLE), os.environ.get("XDG_CACHE_HOME")
    return Path(own) if own else Path(shared or Path.home() / ".cache") / "calcidem"


def _heading(packing_hash: str) -> bytes:
    return f"calcidem packing 1 {packing_hash}".rstrip().encode()


def packing_to_bytes(packing: Packing, packing_hash: str = "") -> bytes:
    """Heading, SHA-256 of the rest, and arrays and report in NumPy's npz format.

    The heading of a file states the configuration's `packing_hash`, for which a database has a column.
    """
    body = io.BytesIO()
    np.savez(
        body,
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        size=np.array([packing.width, packing.height]),
        pairs=packing.preload.pairs,
        shear=packing.preload.shear,
        report=np.frombuffer(json.dumps(asdict(packing.report)).encode(), dtype=np.uint8),
    )
    return b"\n".join((_heading(packing_hash), sha256(body.getvalue()).hexdigest().encode(), body.getvalue()))


def packing_from_bytes(archive: bytes, packing_hash: str = "") -> Packing:
    """Packing from the bytes of `packing_to_bytes`, bit for bit.

    `DamagedPackingError` if the bytes were changed or truncated, belong to another configuration, or are something
    else, and if the disks do not touch as they state.
    """
    if not archive or not isinstance(archive, bytes):  # a damaged database may give a text
        raise DamagedPackingError("it is empty, or a text")
    head, _, rest = archive.partition(b"\n")
    digest, _, body = rest.partition(b"\n")
    if head != _heading(packing_hash):
        raise DamagedPackingError("it is no packing, or that of another configuration")
    if digest != sha256(body).hexdigest().encode():
        raise DamagedPackingError("the checksum does not fit")
    try:
        arrays = {name: values.copy() for name, values in unpack_arrays(body).items()}  # kernels need writable ones
        report = json.loads(arrays["report"].tobytes())
        width, height = (float(length) for length in arrays["size"])
        packing = Packing(
            x=arrays["x"],
            y=arrays["y"],
            radius=arrays["radius"],
            width=width,
            height=height,
            preload=Preload(arrays["pairs"], arrays["shear"]),
            report=PackingReport(**report | {"wall_stress": tuple(report["wall_stress"])}),
        )
        refuse_changed(packing)
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise DamagedPackingError(f"its content is impossible: {error}") from error
    return packing


def packing_record(packing: Packing, *, index: int, packing_hash: str) -> PackingRecord:
    """Record of packing and report for the store, where overlaps are relative to the mean diameter."""
    report = packing.report
    diameter = 2.0 * float(packing.radius.mean())
    return PackingRecord(
        index=index,
        hash=packing_hash,
        x=packing.x.astype(float),
        y=packing.y.astype(float),
        radius=packing.radius.astype(float),
        width=packing.width,
        height=packing.height,
        porosity=report.porosity,
        coordination_number=report.coordination_number,
        coordination_number_without_rattlers=report.coordination_number_without_rattlers,
        wall_stress=dict(zip(WALL_NAMES, report.wall_stress, strict=True)),
        mean_relative_overlap=report.mean_overlap / diameter,
        largest_relative_overlap=report.largest_overlap / diameter,
        unbalanced_ratio=report.unbalanced_ratio,
        seconds=report.seconds,
        state=packing_to_bytes(packing),
        content_hash=packing.content_hash,
    )


def stored_packing(record: PackingRecord, packing_hash: str | None = None) -> Packing:
    """Packing of a record, bit for bit the stored one.

    `DamagedStoreError` if the record's state is missing or damaged, or belongs to another packing than the record, and
    if the record belongs to another configuration than that of `packing_hash`.
    """
    try:
        packing = packing_from_bytes(record.state)
        _check_record(record, packing, packing_hash)
    except DamagedPackingError as error:
        raise DamagedStoreError(
            f"The stored state of packing {record.index} can't be used: {error}.",
            "The results can be read as before. 'calcidem import' of an earlier export gets it back.",
        ) from error
    return packing


def _check_record(record: PackingRecord, packing: Packing, packing_hash: str | None) -> None:
    """Raise `DamagedPackingError` if a record contradicts the packing in its state or the configuration."""
    if packing_hash not in {None, record.hash}:
        raise DamagedPackingError("it is that of another configuration")
    for name in ("x", "y", "radius", "width", "height"):
        if not np.array_equal(getattr(packing, name), getattr(record, name)):
            raise DamagedPackingError(f"its {name} is not that of the record")
    if record.content_hash != packing.content_hash:
        raise DamagedPackingError(f"its content hash is {packing.content_hash}, not {record.content_hash}")


def provide_packing(
    configuration: Configuration,
    store: "Store | None",
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Packing of a campaign: from its database, from calcidem itself, or from the cache; made only if none has it.

    While a packing is made, ``raise_if_stopped`` is called every fraction of a second and may raise to end it, and
    ``watch`` receives the progress. `PackingError` if it has to be made and does not come to rest, `DamagedStoreError`
    if the stored one is damaged or belongs to another configuration.
    """
    if store is not None and 0 in store.packing_indices():
        return stored_packing(store.packing(), configuration.packing_hash)
    kept = kept_packing(configuration.packing_hash)
    packing = kept or new_packing(configuration, raise_if_stopped, watch)
    if kept is None:  # a cache that cannot be written only costs time later
        path = cache_folder() / _cached_name(configuration.packing_hash)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(path) as temporary:
                temporary.write_bytes(packing_to_bytes(packing, configuration.packing_hash))
        except (OSError, OutputRefusedError) as error:
            cure = f"set {CACHE_VARIABLE} to a folder that works"
            why = error.strerror if isinstance(error, OSError) else f"{path.name} is not a file of a packing"
            tell(f"Packing: not kept in the cache {path.parent} ({why}); {cure}.")
    return packing


def new_packing(
    configuration: Configuration,
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """New packing of a configuration, without search in storage; see `provide_packing`."""
    from calcidem.dem.sample.compaction import make_packing, packing_from_csv  # noqa: PLC0415 - loads the kernels

    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        disks = Path(draw.file)
        if sha256(read_input(disks, MOST_BYTES)).hexdigest() != draw.file_sha256:
            raise PackingFileError(f"{disks} was changed while the campaign began; run the command again")
        return packing_from_csv(disks, configuration.sand, configuration.packing, raise_if_stopped, watch)
    tell("Packing: being made; this is done once.")
    generator = random_generator(configuration.campaign.root_seed, draw.seed, RandomPurpose.DISKS)
    return make_packing(configuration.packing, configuration.sand, generator, raise_if_stopped, watch)


def kept_packing(packing_hash: str) -> Packing | None:
    """Packing from calcidem itself or the cache; None if neither has it."""
    archive = preset_packings().get(packing_hash[:32])
    if archive is not None:
        tell("Packing: comes with calcidem.")
        return packing_from_bytes(archive.read_bytes(), packing_hash)
    path = cache_folder() / _cached_name(packing_hash)
    try:
        packing = packing_from_bytes(read_input(path, MOST_BYTES), packing_hash) if path.exists() else None
    except (OSError, InputFileError, DamagedPackingError) as error:
        tell(f"Packing: the cached {path} is damaged ({error}); making it again.")
        return None
    if packing is not None:
        tell(f"Packing: taken from the cache, {path}.")
    return packing


def _cached_name(packing_hash: str) -> str:
    """File name in the cache of the packing with this `Configuration.packing_hash`, by the present version."""
    return f"packing-{PACKING_METHOD}-{packing_hash[:32]}.npz"


def stored_experiment(store: "Store", packing_index: int = 0) -> Experiment:
    """Experiment of the cells of a packing, as `calcidem.Campaign.experiment`, for modules that `Campaign` imports."""
    packing = stored_packing(store.packing(packing_index))
    return Configuration.from_physics(store.record.parameters).experiment(packing)


def with_patterns(store: "Store", outcomes: Iterable[CellResult]) -> Iterator[CellResult]:
    """Yield outcomes of a store; cement that is not stored is drawn again from the seed.

    An outcome has no cement if it was never drawn, or would differ now: with another physics version, or without the
    stored packing.
    """
    same_physics = store.record.physics_version == PHYSICS_VERSION
    experiment = lru_cache(lambda index: stored_experiment(store, index))
    # Cells are sorted by seed; without cement all seeds are the same sample, here that of seed 0.
    ordering = lru_cache(2)(lambda index, seed: experiment(index).ordering(seed))
    for outcome in outcomes:
        if not same_physics or outcome.cement is not None or outcome.bonded_contacts is None:
            yield outcome
            continue
        try:
            seed = outcome.key.seed if outcome.key.content else 0
            cement = ordering(outcome.packing_index, seed).at(outcome.key.content)
        except (StoreError, CementCapacityError, UnknownPatternError):
            yield outcome
            continue
        drawn = cement.content_reached, cement.p_contacts, cement.c_contacts, cement.clusters
        known = outcome.content_reached, outcome.p_contacts, outcome.c_contacts, outcome.clusters
        packing = experiment(outcome.packing_index).packing
        yield replace(outcome, cement=pattern_of(packing, cement)) if drawn == known else outcome


def pattern_of(packing: Packing, cement: PlacedCement) -> CementPattern:
    """Record of the cement for the store."""
    contacts = packing.pairs[cement.bonded].astype(np.int32)
    return CementPattern(contacts, cement.kind[cement.bonded], cement.centres.astype(float))


def stored_section(section: Section) -> RecordedSection:
    """Record of a section for the store."""
    return RecordedSection(
        sampling_interval=section.sampling_interval,
        start_time=section.start_time,
        pulse_frequency=section.frequency,
        resolution=section.amplitude * RESOLUTION,
        places=np.array(section.places),
        across=section.across,
        along=section.along,
    )


def check_path(configuration: Configuration, packing: Packing, content: float) -> Path:
    """File that keeps the check of a content."""
    name = f"check-{configuration.hash[:32]}-{packing.content_hash[:32]}-{content!r}"
    given = getattr(GIVEN.get(configuration.pattern.drawn_by or ""), "__code__", None)
    if given is not None:  # the hash has only its name, and the function may have been changed
        name += f"-{sha256(marshal.dumps(given)).hexdigest()[:16]}"
    return cache_folder() / f"{name}.json"


def section_of(stored: RecordedSection) -> Section:
    """Section from a record, with the same bits as recorded."""
    return Section(
        sampling_interval=stored.sampling_interval,
        start_time=stored.start_time,
        frequency=stored.pulse_frequency,
        amplitude=stored.resolution / RESOLUTION,
        places=tuple(stored.places.tolist()),
        across=stored.across,
        along=stored.along,
    )


def section_reader(store: "Store") -> Callable[[CellResult], Reading | Verdict]:
    """Return a function that reads the stored section of a cell again, with the configuration of its campaign.

    It raises a `ValueError` without a section, and takes each packing from the store once.
    """
    wave, pick = (store.record.parameters.get(name, {}) for name in ("wave", "pick"))
    rule = PickRule(**{field.name: pick[field.name] for field in fields(PickRule) if field.name in pick})
    layers = WaveRule(
        **{name: wave[name] for name in ("damping", "boundary_damping", "boundary_thickness") if name in wave}
    )
    clamp = lru_cache(lambda index: clamp_of_layers(store.packing(index).height, layers))

    def read(cell: CellResult) -> Reading | Verdict:
        if cell.section is None:
            raise ValueError(f"cell = {cell.key}: no section is stored")
        return read_section(section_of(cell.section), clamp(cell.packing_index), rule)

    return read
