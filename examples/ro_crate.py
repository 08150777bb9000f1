"""A campaign as an RO-Crate, one zip file with a description that repositories such as Zenodo read.

    pip install rocrate
    python examples/ro_crate.py results/quick.db calcidem.toml quick.zip --author "Ada Lovelace" results/quick.html

The crate has the numbers as NetCDF, the configuration, and further files that are named, such as the report or a file
of disks. `calcidem import campaign.nc --db copy.db` and `calcidem verify copy.db` compute cells again from it alone.
The description is that of https://w3id.org/ro/crate/1.2.
"""

import argparse
import mimetypes
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

from rocrate.model.contextentity import ContextEntity
from rocrate.model.person import Person
from rocrate.rocrate import ROCrate

import calcidem

PAPER = (
    "Sand Stiffness Variability Induced by Stochastic Distributions of Calcite Precipitates: A Monte Carlo-DEM Study"
)
SPDX = "https://spdx.org/licenses/"


def describe(crate: ROCrate, campaign: calcidem.Campaign, licence: str, authors: list[str]) -> None:
    """Describe a campaign: its identity, licence and authors; the licence is an SPDX identifier or an address."""
    record = campaign.record
    crate.name = f"Campaign {record.name}: shear-wave velocity of calcite-cemented sand"
    crate.description = (
        f"Monte-Carlo campaign of discrete-element simulations: {len(record.seeds)} seeds at {len(record.contents)} "
        f"calcite contents. Campaign hash {record.hash}."
    )
    crate.license = entity(crate, licence if "://" in licence else SPDX + licence, "CreativeWork", name=licence)
    crate.root_dataset["identifier"] = entity(crate, "#campaign", "PropertyValue", name="hash", value=record.hash)
    crate.root_dataset["creditText"] = f"Computed with calcidem {calcidem.__version__}, which repeats: {PAPER}"
    people = [crate.add(Person(crate, f"#author-{i}", {"name": name})) for i, name in enumerate(authors, 1)]
    if people:
        crate.root_dataset["author"] = people


def entity(crate: ROCrate, identity: str, kind: str, **properties: object) -> ContextEntity:
    """Add something that is not a file."""
    return crate.add(ContextEntity(crate, identity, properties={"@type": kind} | properties))


def add_file(crate: ROCrate, file: Path) -> ContextEntity:
    """Add a file with its checksum."""
    properties = {
        "name": file.name,
        "encodingFormat": mimetypes.guess_type(file)[0] or "application/octet-stream",
        "contentSize": str(file.stat().st_size),
        "sha256": sha256(file.read_bytes()).hexdigest(),
    }
    return crate.add_file(file, file.name, properties=properties)


def add_runs(crate: ROCrate, campaign: calcidem.Campaign, numbers: ContextEntity, configuration: ContextEntity) -> None:
    """Add the runs of the program, each with its version, source and libraries."""
    actions = []
    for number, run in campaign.runs():
        version = run.versions["calcidem"]
        # A commit is its own identifier, which Software Heritage resolves: https://www.swhid.org.
        source = f"https://archive.softwareheritage.org/swh:1:rev:{run.git_commit}"
        libraries = [f"{name} {found}" for name, found in run.versions.items() if name != "calcidem" and found]
        software = entity(
            crate,
            f"#calcidem-of-run-{number}",
            "SoftwareApplication",
            name="calcidem",
            version=version,
            license="MIT",
            url=source if run.git_commit else f"https://pypi.org/project/calcidem/{version}/",
            softwareRequirements=", ".join(libraries),
        )
        times = {"startTime": run.started.isoformat()} | ({"endTime": run.ended.isoformat()} if run.ended else {})
        action = entity(
            crate,
            f"#run-{number}",
            "CreateAction",
            name=f"Run {number} of {campaign.record.name}",
            description=f"{run.ranks} processes on {run.cpu}; ended as: {run.exit_state or 'unknown'}",
            instrument=software,
            object=configuration,
            result=numbers,
            **times,
        )
        actions.append(action)
    crate.root_dataset["mentions"] = actions


def main() -> None:
    """Write the crate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("configuration", type=Path)
    parser.add_argument("out", type=Path, help="zip file to write")
    parser.add_argument("files", type=Path, nargs="*", help="further files")
    parser.add_argument("--licence", default="CC-BY-4.0", help="SPDX identifier or address")
    parser.add_argument("--author", action="append", default=[], help="may be repeated")
    given = parser.parse_args()
    with calcidem.open_campaign(given.database) as campaign, TemporaryDirectory() as folder:
        if calcidem.load_configuration(given.configuration).hash != campaign.record.hash:
            sys.exit(f"{given.configuration} is not the configuration of {given.database}; give that one.")
        numbers = Path(folder) / "campaign.nc"
        subprocess.run([sys.executable, "-m", "calcidem", "export", given.database, numbers], check=True)
        crate = ROCrate(version="1.2")
        describe(crate, campaign, given.licence, given.author)
        main_file = crate.root_dataset["mainEntity"] = add_file(crate, numbers)
        add_runs(crate, campaign, main_file, add_file(crate, given.configuration))
        for file in given.files:
            add_file(crate, file)
        crate.write_zip(given.out)
    print(f"Wrote {given.out}, licence {given.licence}")


if __name__ == "__main__":
    main()
