"""A campaign as an RO-Crate, with everything needed to read it, to cite it and to compute its cells again.

An RO-Crate is a folder, or a zip file of one, with a description of its files in JSON-LD:
https://w3id.org/ro/crate/1.2.
"""

import importlib.util
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from calcidem.app.campaign.opened import Campaign
from calcidem.app.campaign.stored_packing import stored_packing
from calcidem.app.config.errors import ConfigurationError
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.reference import stored_text
from calcidem.app.report.page import write_report
from calcidem.dem.sample.packing_file import write_packing_csv
from calcidem.storage.errors import DamagedStoreError, OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.export import export_netcdf
from calcidem.storage.netcdf.import_netcdf import import_netcdf
from calcidem.storage.records import CampaignRecord, RunRecord
from calcidem.storage.records.canonical import canonical_hash
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.version import __version__

_DESCRIPTOR = "ro-crate-metadata.json"
_NETCDF, _CONFIGURATION, _DISKS, _REPORT = "campaign.nc", "campaign.toml", "packing.csv", "report.html"
_FILES: Mapping[str, tuple[str, str]] = {
    _NETCDF: (
        "application/netcdf",
        "Vs(seed, content), errors, reasons, packing, cement, sections and runs; xarray.open_dataset reads it.",
    ),
    _CONFIGURATION: ("application/toml", "Configuration: 'calcidem run campaign.toml' computes the campaign again."),
    _DISKS: ("text/csv", "Disks of the packing at rest: x, y and radius, m."),
    _REPORT: ("text/html", "Report: figures, tables, and a map in which every cell can be opened."),
}
"""Media type and meaning of the files of a crate."""

_PAPER = (
    "Sand Stiffness Variability Induced by Stochastic Distributions of Calcite Precipitates: A Monte Carlo-DEM Study"
)
_ZIP = b"PK\x03\x04"
_SPDX = "https://spdx.org/licenses/"
_GET_IT_AGAIN = "Get the crate again from where it was published; nothing was computed."


def is_crate(path: str) -> bool:
    """Whether a path is a folder or a zip file, by its first bytes, since a database may contain an archive."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - Path raises where a name is too long
            return file.read(len(_ZIP)) == _ZIP
    except IsADirectoryError:
        return True
    except (OSError, ValueError):
        return False


def write_crate(
    database: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    campaign_name: str | None = None,
    licence: str = "CC-BY-4.0",
    authors: Sequence[str] = (),
    watch: Callable[[int, int], None] = lambda _, __: None,
) -> Path:
    """Write a campaign with its configuration, packing, report and description, and return the path of the crate.

    It is a zip file, which is replaced, or a new folder. The licence is an SPDX identifier or an address of its text.
    ``watch`` receives the numbers of finished and of all parts of the report. `OutputRefusedError` if the name of the
    crate is taken, or rocrate is not installed; `StoreError` if the database cannot be read.
    """
    if importlib.util.find_spec("rocrate") is None:
        raise OutputRefusedError(
            "A crate needs the package rocrate.", "Install it: pip install 'calcidem[crate]'; nothing was written."
        )
    target, is_zip = Path(out), Path(out).suffix == ".zip"
    if not is_zip and target.exists():
        raise OutputRefusedError(f"{target} is there already.", "Give a new name, or one that ends in .zip.")
    with read_campaign(database, campaign_name) as store, TemporaryDirectory(dir=target.absolute().parent) as name:
        folder = Path(name) / "crate"
        folder.mkdir()
        export_netcdf(store, folder / _NETCDF)
        (folder / _CONFIGURATION).write_text(stored_text(store.record, _DISKS), encoding="utf-8")
        write_packing_csv(stored_packing(store.packing()), folder / _DISKS)
        write_report(database, folder / _REPORT, campaign_name=store.record.name, watch=watch)
        _describe_crate(folder, store, licence, authors)
        if is_zip:
            with write_atomically(target) as temporary:
                shutil.move(shutil.make_archive(str(folder), "zip", folder), temporary)
        else:
            folder.rename(target)
    return target


def _describe_crate(folder: Path, store: Store, licence: str, authors: Sequence[str]) -> None:
    """Write the description of the files in a folder."""
    from rocrate.model.contextentity import ContextEntity  # noqa: PLC0415 - of an extra
    from rocrate.model.person import Person  # noqa: PLC0415
    from rocrate.rocrate import ROCrate  # noqa: PLC0415

    record = store.record
    crate = ROCrate(version="1.2")

    def add(identity: str, kind: str, **properties: object) -> ContextEntity:
        return crate.add(ContextEntity(crate, identity, properties={"@type": kind} | properties))

    mit = add(_SPDX + "MIT", "CreativeWork", name="MIT License", description="Of calcidem")
    mentioned = [add("#method", "ScholarlyArticle", name=_PAPER)]
    crate.name = f"Campaign {record.name}: shear-wave velocity of calcite-cemented sand"
    crate.description = _campaign_in_words(record)
    of_data = licence if "://" in licence else _SPDX + licence
    crate.license = add(of_data, "CreativeWork", name=licence, description="Of the data in this crate")
    root = crate.root_dataset
    root["identifier"] = add("#campaign", "PropertyValue", name="hash of the campaign", value=record.hash)
    root["creditText"] = f"Computed with calcidem {__version__}, which repeats: {_PAPER}"
    people = [crate.add(Person(crate, f"#author-{i}", {"name": name})) for i, name in enumerate(authors, 1)]
    if people:
        root["author"] = people[0] if len(people) == 1 else people
    files = {}
    for name, (media, meaning) in _FILES.items():
        content = (folder / name).read_bytes()
        properties = {
            "name": name,
            "description": meaning,
            "encodingFormat": media,
            "contentSize": str(len(content)),
            "sha256": sha256(content).hexdigest(),
        }
        files[name] = crate.add_file(folder / name, name, properties=properties)
    root["mainEntity"] = files[_NETCDF]
    for number, run in store.runs():
        software = add(f"#calcidem-of-run-{number}", "SoftwareApplication", license=mit, **_software(run))
        mentioned.append(
            add(
                f"#run-{number}",
                "CreateAction",
                name=f"Run {number} of {record.name}",
                description=f"{run.ranks} processes on {run.cpu}; ended as: {run.exit_state or 'unknown'}",
                instrument=software,
                object=files[_CONFIGURATION],
                result=files[_NETCDF],
                startTime=run.started.isoformat(),
                **({} if run.ended is None else {"endTime": run.ended.isoformat()}),
            )
        )
    root["mentions"] = mentioned
    crate.metadata.write(folder)


def _campaign_in_words(record: CampaignRecord) -> str:
    """Describe a campaign in a sentence or two."""
    return (
        f"Monte-Carlo campaign of discrete-element simulations: {len(record.seeds)} seeds at {len(record.contents)} "
        f"calcite contents. Physics version {record.parameters['physics_version']}, campaign hash {record.hash}. "
        "'calcidem verify' computes cells again from this crate alone."
    )


def _software(run: RunRecord) -> dict[str, object]:
    """Version of the program of a run, its source, and its libraries."""
    version = run.versions.get("calcidem", "")
    needed = ", ".join(f"{name} {found}" for name, found in run.versions.items() if name != "calcidem" and found)
    # A commit is its own identifier, which Software Heritage resolves: https://www.swhid.org.
    swhid = f"https://archive.softwareheritage.org/swh:1:rev:{run.git_commit}"
    url = f"https://pypi.org/project/calcidem/{version}/" if run.git_commit is None else swhid
    return {"name": "calcidem", "version": version, "url": url, "softwareRequirements": needed}


@contextmanager
def open_crate(path: str | os.PathLike[str]) -> Iterator[Campaign]:
    """Open the campaign of a crate, a folder or zip file, rebuilt from its files in a temporary folder.

    `DamagedStoreError` if it is not a crate of calcidem, a file was changed, or two files contradict each other.
    """
    crate = Path(path)
    with TemporaryDirectory() as name:
        folder = Path(name)
        _copy_files(crate, folder)
        with Store(folder / "campaign.db") as store:
            record = import_netcdf(folder / _NETCDF, store, stored_packing)
            store.use_campaign(record.name)
            _check_configuration(crate, folder, store)
            yield Campaign(store)


def _copy_files(crate: Path, folder: Path) -> None:
    """Copy the files of a crate, and compare each with its checksum."""
    described = _described_files(crate)
    for name in _FILES:
        if name not in described:
            raise DamagedStoreError(f"{crate}: {_DESCRIPTOR} does not describe {name}.", _GET_IT_AGAIN)
        content = _content_of_file(crate, name)
        if sha256(content).hexdigest() != described[name].get("sha256"):
            raise DamagedStoreError(f"{crate}: {name} is not the file that {_DESCRIPTOR} describes.", _GET_IT_AGAIN)
        (folder / name).write_bytes(content)


def _described_files(crate: Path) -> dict[str, dict[str, Any]]:
    """Entities of a crate's description by name."""
    try:
        entities = json.loads(_content_of_file(crate, _DESCRIPTOR))["@graph"]
        return {str(entity["@id"]): dict(entity) for entity in entities}
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedStoreError(
            f"{crate}: {_DESCRIPTOR} is not a description of a crate ({error}).", _GET_IT_AGAIN
        ) from error


def _content_of_file(crate: Path, name: str) -> bytes:
    """Content of a file of a crate."""
    try:
        if crate.is_dir():
            return (crate / name).read_bytes()
        with zipfile.ZipFile(crate) as archive:
            return archive.read(name)
    except (OSError, KeyError, zipfile.BadZipFile, NotImplementedError, EOFError) as error:
        raise DamagedStoreError(f"{crate}: {name} cannot be read ({error}).", _GET_IT_AGAIN) from error


def _check_configuration(crate: Path, folder: Path, store: Store) -> None:
    """Refuse a configuration or a packing other than that of the NetCDF file."""
    write_packing_csv(stored_packing(store.packing()), folder / "stored.csv")
    if (folder / "stored.csv").read_bytes() != (folder / _DISKS).read_bytes():
        raise DamagedStoreError(f"{crate}: {_DISKS} is not the packing of {_NETCDF}.", _GET_IT_AGAIN)
    try:
        configuration = load_configuration(folder / _CONFIGURATION)
    except ConfigurationError as error:
        raise DamagedStoreError(f"{crate}: {_CONFIGURATION} cannot be used: {error}", _GET_IT_AGAIN) from error
    # The identity of disks in a user's file depends on the bytes of that file, which crates do not contain.
    own_disks = configuration.packing_draw.file is not None
    found, stored = ({**physics, "packing": {}} for physics in (configuration.physics, store.record.parameters))
    same = canonical_hash(found) == canonical_hash(stored) if own_disks else configuration.hash == store.record.hash
    if not same:
        raise DamagedStoreError(f"{crate}: {_CONFIGURATION} is not the configuration of {_NETCDF}.", _GET_IT_AGAIN)
