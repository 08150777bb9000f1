"""A folder with files of many kinds, in which commands are used up to where they would begin to compute."""

import io
import os
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import pytest
from places import TUTORIAL
from unchanged import digests

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.main import main
from calcidem.app.config.presets import preset_text
from calcidem.ends import CellStatus
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.records import CellKey, CellResult
from calcidem.storage.sql.store import Store

PLAN = b'configuration = "good.toml"\ncontents = [5.0]\nseeds = 2\n[[variant]]\nchoice="a"\nvalue="b"'
TARGETS = b"content,vs\n0.0,210\n0.66,640\n5.0,1300\n"

EVIL_STORED = "\x1b]0;title\x07\x1b[31m[/red]\x9b2J\r\b[bold]"

OWN_DISKS = """
[campaign]
contents = [0.66]
[packing]
file = "own.csv"
width = 0.021
[wave]
transmitter_half_width = 0.004
receiver_half_width = 0.005
listening_depth = 0.006
boundary_thickness = 0.004
"""
DISKS = "x,y,radius\n" + "".join(
    f"{0.0011 + 0.0022 * (k % 9):.4f},{0.0011 + 0.0022 * (k // 9):.4f},0.001\n" for k in range(90)
)


_CONTROL = {chr(code) for code in (*range(32), *range(127, 160))} - {"\n", "\t"}


class ComputingBeginsError(BaseException):
    """The command has accepted its input."""


def begin_computing(*_arguments: object, **_options: object) -> NoReturn:
    """Stand in the place of whatever takes long."""
    raise ComputingBeginsError


LONG = (
    "calcidem.app.campaign.launch.Launch.run",
    "calcidem.dem.sample.compaction.make_packing",
    "calcidem.dem.sample.compaction.packing_from_csv",
    "calcidem.app.campaign.preview._describe_ranks",
    "calcidem.app.campaign.run.CampaignRun.compute",
    "calcidem.app.studies.stability.stability",
    "calcidem.app.cli.results.time.sleep",
    "calcidem.app.campaign.plots.CampaignAnalysis",
    "calcidem.app.report.page.CampaignAnalysis",
    "calcidem.app.studies.sensitivity.send_waves",
    "calcidem.app.studies.study.ProcessPoolExecutor",
    "calcidem.app.studies.verify.measure",
    "calcidem.dem.wave.check.send_waves",
    "calcidem.dem.wave.measurement.send_waves",
)
"""Where computing begins."""


@dataclass(frozen=True)
class Workbench:
    """A folder with files of many kinds, good and bad, in which commands are used.

    Attributes
    ----------
    files
        Content of each file by its name: they are as at first before every command.
    """

    folder: Path
    files: dict[str, bytes]

    def restore(self) -> None:
        """Put everything back where it was."""
        for path in self.folder.iterdir():
            if path.is_dir() and (path.name != "folder" or any(path.iterdir())):
                shutil.rmtree(path)
            elif path.is_file() and path.name not in self.files:
                path.unlink()
        (self.folder / "folder").mkdir(exist_ok=True)
        for name, content in self.files.items():
            path = self.folder / name
            if not path.is_file() or path.read_bytes() != content:
                path.write_bytes(content)

    def judge(self, *words: str, **files: bytes) -> str:
        """Use a command on the files and some more; whatever happens is told in sentences."""
        os.chdir(self.folder)
        self.restore()
        for name, content in files.items():
            (self.folder / name.replace("_", ".")).write_bytes(content)
        output = io.TextIOWrapper(io.BytesIO(), "utf-8", newline="", write_through=True)
        sys.argv = ["calcidem", *words]
        code: object = 0
        before = digests([self.folder])
        with redirect_stdout(output), redirect_stderr(output), warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("always", FutureWarning)
            try:
                main()
            except SystemExit as ended:
                code = ended.code
            except ComputingBeginsError:
                pass
        is_binary = "parquet" in words and code in {0, None}
        text = "" if is_binary else output.buffer.getvalue().decode()
        log = next(self.folder.glob("calcidem-error-*"), None)
        assert log is None, log.read_text()
        verdicts = {1, 3} if "verify" in words[:2] else set()  # damaged or different, and same to rounding
        assert code in {0, None, 2, 75} | verdicts, text
        assert code not in {2} | verdicts or digests([self.folder]) == before, f"files changed, but: {text}"
        assert "Traceback" not in text
        assert not set(text) & _CONTROL, repr(text)
        assert code != 2 or ":" in text or "requires" in text, text  # the latter of an option that takes several
        return text


def make_databases(folder: Path) -> None:
    """Make a good database, its exported file, and a database whose texts try to control a terminal."""
    Store(shutil.copy(TUTORIAL, folder / "quick.db")).close()
    with open_campaign(folder / "quick.db") as good, Store(folder / "evil.db") as store:
        export_netcdf(good.store, folder / "quick.nc")
        store.begin_campaign(replace(good.record, name=f"evil{EVIL_STORED}"))
        store.begin_run(replace(good.runs()[0][1], host=EVIL_STORED, exit_state=EVIL_STORED))
        store.save_packing(good.packing())
        failed = CellResult(CellKey(1, 0.0), CellStatus.FAILED, f"why{EVIL_STORED}", host=EVIL_STORED)
        store.record_results([failed, *good.select(seed=2)])


@contextmanager
def open_workbench(folder: Path) -> Iterator[Workbench]:
    """Fill a folder with files, and give it as a workbench on which nothing is computed."""
    files = {
        "good.toml": preset_text("quick").encode(),
        "empty": b"",
        "noise": bytes(range(256)) * 8,
        "plan.toml": PLAN,
        "targets.csv": TARGETS,
        "good.csv": DISKS.encode(),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sys.argv", [])
        patch.setattr("warnings.formatwarning", warnings.formatwarning)
        patch.setenv("CALCIDEM_CACHE", str(folder / "cache"))
        for place in LONG:
            patch.setattr(place, begin_computing)
        make_databases(folder)
        names = ("quick.db", "quick.nc", "evil.db")
        files |= {name: (folder / name).read_bytes() for name in names}
        yield Workbench(folder, files)
