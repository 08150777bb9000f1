"""The packing of a campaign: kept, found again, and made anew when what was kept is damaged."""

import io
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.resources import as_file, files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calcidem.app.campaign import packing as packing_source
from calcidem.app.campaign.cells import _known_static_speed
from calcidem.app.campaign.packing import (
    DamagedPackingError,
    _cached_name,
    cache_folder,
    packing_from_bytes,
    packing_record,
    packing_to_bytes,
    provide_packing,
    stored_packing,
)
from calcidem.app.cli.run import Preset
from calcidem.app.config import presets
from calcidem.app.config.checks import _tightest_seed, check_against_packing
from calcidem.app.config.presets import preset_packings, preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, PackingDraw, RunOptions
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import station_disks
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.netcdf import import_netcdf
from calcidem.storage.records import CampaignRecord, canonical_json
from calcidem.storage.sql.store import Store
from calcidem.wording import listening

TINY = Configuration(packing=PackingRule(width=0.02, height=0.02, unbalanced_force_ratio=1e-3))
"""Some 60 disks, made in less than a second."""


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Give an empty cache folder, and the list of what the user is told."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "cache"))
    said: list[str] = []
    with listening(said.append):
        yield said


@pytest.fixture(scope="module")
def packing(tmp_path_factory: pytest.TempPathFactory) -> Packing:
    """Give a tiny packing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALCIDEM_CACHE", str(tmp_path_factory.mktemp("cache")))
        return provide_packing(TINY, None)


def same_bits(first: Packing, second: Packing) -> bool:
    """Tell whether two packings are equal to the last bit."""
    return packing_to_bytes(first) == packing_to_bytes(second)


def test_an_archive_gives_the_same_bits_back(packing: Packing) -> None:
    """Positions, radii, size, shear forces and report survive the way into bytes and back."""
    restored = packing_from_bytes(packing_to_bytes(packing))
    for name in ("x", "y", "radius", "width", "height"):
        assert np.array_equal(getattr(restored, name), getattr(packing, name))
    assert np.array_equal(restored.preload.pairs, packing.preload.pairs)
    assert np.array_equal(restored.preload.shear, packing.preload.shear)
    assert restored.report == packing.report


def test_a_record_gives_the_same_bits_back(packing: Packing) -> None:
    """What the database keeps of a packing is enough to restore it."""
    record = packing_record(packing, index=0, packing_hash="h")
    assert same_bits(stored_packing(record), packing)
    assert record.wall_stress["lid"] == packing.report.wall_stress[3]
    # The store's overlaps are relative to the mean diameter.
    assert record.mean_relative_overlap == pytest.approx(packing.report.mean_overlap / (2.0 * packing.radius.mean()))


@given(st.data())
def test_every_damage_of_an_archive_is_noticed(packing: Packing, data: st.DataObject) -> None:
    """Whichever byte is changed, or wherever it is cut off, an archive is refused."""
    archive = bytearray(packing_to_bytes(packing))
    place = data.draw(st.integers(0, len(archive) - 1))
    if data.draw(st.booleans()):
        damaged = bytes(archive[:place])
    else:
        archive[place] ^= data.draw(st.integers(1, 255))
        damaged = bytes(archive)
    with pytest.raises(DamagedPackingError):
        packing_from_bytes(damaged)


def test_a_packing_is_made_once(told: list[str], packing: Packing) -> None:
    """The second campaign with the same packing takes it from the cache, which then holds one file."""
    first = provide_packing(TINY, None)
    second = provide_packing(TINY, None)
    assert "being made" in told[0]
    assert "taken from the cache" in told[1]
    assert same_bits(first, second)
    # The report holds the seconds it took, which differ from one making to the next.
    assert same_bits(replace(first, report=packing.report), packing)
    assert len(list(cache_folder().iterdir())) == 1


def test_another_seed_is_another_packing(told: list[str], packing: Packing) -> None:
    """The cache does not mix packings up."""
    provide_packing(TINY, None)
    other = provide_packing(replace(TINY, packing_draw=PackingDraw(seed=2)), None)
    assert ["being made" in line for line in told] == [True, True]
    assert not np.array_equal(other.x, packing.x)


@pytest.mark.parametrize("preset", [*Preset])
def test_the_packing_of_a_preset_comes_with_calcidem(
    told: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, preset: Preset
) -> None:
    """Nobody has to make the packing of an example, so everybody has the same; nor is it put into the cache."""
    missing = f"no packing of {preset} in the package: run python scripts/preset_packings.py"
    monkeypatch.setattr("calcidem.dem.sample.compaction.make_packing", lambda *_: pytest.fail(missing))
    (tmp_path / "c.toml").write_text(preset_text(preset), encoding="utf-8")
    configuration = load_configuration(tmp_path / "c.toml")
    found = provide_packing(configuration, None)
    assert told == ["Packing: comes with calcidem."]
    assert not cache_folder().exists()
    check_against_packing(configuration, found)


def test_the_shipped_campaign_is_on_the_packing_of_its_preset(tmp_path: Path) -> None:
    """Whoever computes the preset gets the shipped numbers: its packing is the one that they were computed on."""
    with Store(tmp_path / "paper.db") as store, as_file(files(presets) / "paper.nc") as path:
        import_netcdf(path, store, stored_packing)
        record = store.packing()
    (tmp_path / "c.toml").write_text(preset_text("paper"), encoding="utf-8")
    key = load_configuration(tmp_path / "c.toml").packing_hash
    assert packing_from_bytes(preset_packings()[key[:32]].read_bytes(), key).content_hash == record.content_hash


@pytest.fixture
def store(packing: Packing, tmp_path: Path) -> Iterator[Store]:
    """Give a store that has the tiny packing."""
    with Store(tmp_path / "tiny.db") as opened:
        config = canonical_json(TINY.physics)
        opened.begin_campaign(CampaignRecord(TINY.hash, "tiny", config, (), (), datetime.now(UTC)))
        opened.save_packing(packing_record(packing, index=0, packing_hash=TINY.packing_hash))
        yield opened


def put_into_cache(packing: Packing) -> None:
    """Put a packing where the tiny one would be."""
    cache_folder().mkdir()
    (cache_folder() / _cached_name(TINY.packing_hash)).write_bytes(packing_to_bytes(packing, TINY.packing_hash))


def test_the_database_comes_before_the_cache(store: Store, told: list[str], packing: Packing) -> None:
    """A run goes on with the packing of its database, whatever the cache holds."""
    put_into_cache(replace(packing, x=packing.x * (1.0 + 1e-15)))
    assert provide_packing(TINY, store).content_hash == packing.content_hash
    assert told == []


@pytest.mark.usefixtures("told")
@pytest.mark.parametrize("column", ["grains", "width", "state"])
def test_a_stored_packing_that_was_changed_is_refused(store: Store, packing: Packing, column: str) -> None:
    """A packing whose row or state was changed is not used, nor replaced: the message names the remedy."""
    with store._connections._engine.begin() as connection:
        connection.exec_driver_sql(f"UPDATE packing SET {column} = '0.5'")  # noqa: S608 - a test's own
    put_into_cache(packing)
    with pytest.raises(DamagedStoreError, match="'calcidem import'"):
        provide_packing(TINY, store)


@pytest.mark.parametrize("damage", ["cut off", "changed", "emptied", "replaced by a folder"])
def test_a_damaged_cache_is_said_and_repaired(told: list[str], packing: Packing, damage: str) -> None:
    """A cached packing that is not whole any more is made anew, after a word about it."""
    provide_packing(TINY, None)
    path = next(cache_folder().iterdir())
    whole = path.read_bytes()
    path.unlink()
    if damage == "replaced by a folder":
        path.mkdir()
    else:
        content = {"cut off": whole[:-100], "changed": whole[:-1] + b"?", "emptied": b""}
        path.write_bytes(content[damage])
    made = provide_packing(TINY, None)
    assert f"{path} is damaged" in told[1]
    assert same_bits(replace(made, report=packing.report), packing)
    if path.is_file():
        assert same_bits(packing_from_bytes(path.read_bytes(), TINY.packing_hash), made)


def test_an_archive_is_refused_under_another_key(told: list[str], packing: Packing) -> None:
    """A file that was copied to the name of another packing is said to be that of another, and not computed on."""
    other = replace(TINY, packing_draw=PackingDraw(seed=2))
    put_into_cache(packing)
    next(cache_folder().iterdir()).rename(cache_folder() / _cached_name(other.packing_hash))
    made = provide_packing(other, None)
    assert "that of another configuration" in told[0]
    assert made.content_hash != packing.content_hash


@pytest.mark.usefixtures("told")
def test_a_stored_packing_is_refused_under_another_key(store: Store) -> None:
    """A database whose packing belongs to another configuration does not lend it."""
    with pytest.raises(DamagedStoreError, match="that of another configuration"):
        provide_packing(replace(TINY, packing_draw=PackingDraw(seed=2)), store)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: replace(p, x=np.where(np.arange(len(p.x)) == 3, np.nan, p.x)), "not in the box"),
        (lambda p: replace(p, y=np.where(np.arange(len(p.y)) == 3, 2.0 * p.height, p.y)), "not in the box"),
        (lambda p: replace(p, radius=-p.radius), "no size"),
        (lambda p: replace(p, x=p.x[:-1]), "differ in length"),
        (lambda p: replace(p, x=p.x + 1e-4 * np.sin(np.arange(len(p.x)))), "pairs are said to touch"),
        (lambda p: replace(p, y=p.y + 1e-9 * np.sin(np.arange(len(p.y)))), "mean overlap"),
        (lambda p: replace(p, preload=replace(p.preload, pairs=p.preload.pairs[1:])), "differ in length"),
        (
            lambda p: replace(p, preload=replace(p.preload, pairs=p.preload.pairs[1:], shear=p.preload.shear[1:])),
            "pairs are said to touch",
        ),
        (lambda p: replace(p, preload=replace(p.preload, pairs=p.preload.pairs + len(p.x))), "does not exist"),
        (
            lambda p: replace(p, preload=Preload(np.vstack([p.pairs, p.pairs[:1]]), np.append(p.preload.shear, 5.0))),
            "listed twice",
        ),
        (lambda p: replace(p, preload=replace(p.preload, shear=p.preload.shear * np.inf)), "not finite"),
    ],
)
def test_moved_grains_with_a_valid_checksum_are_refused(
    packing: Packing, change: Callable[[Packing], Packing], said: str
) -> None:
    """An archive that somebody wrote himself is taken only if its disks touch as it says."""
    with pytest.raises(DamagedPackingError, match=said):
        packing_from_bytes(packing_to_bytes(change(packing)))


def test_an_archive_that_unpacks_to_too_much_is_refused_before_it_does(packing: Packing) -> None:
    """Some megabytes that would become a gigabyte are refused, and so are those that state a smaller size."""
    bomb = io.BytesIO()
    packed = zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with packed as archive, archive.open("x.npy", "w") as member:
        for _ in range(64):
            member.write(bytes(2**24))
    honest = bomb.getvalue()
    liar = honest.replace((2**30).to_bytes(4, "little"), (10).to_bytes(4, "little"))
    for body in (honest, liar):
        heading = packing_to_bytes(packing).partition(b"\n")[0]
        tracemalloc.start()
        with pytest.raises(DamagedPackingError, match="the archive"):
            packing_from_bytes(b"\n".join((heading, sha256(body).hexdigest().encode(), body)))
        assert tracemalloc.get_traced_memory()[1] < 50e6
        tracemalloc.stop()


def test_the_small_packing_is_what_its_configuration_makes(
    small_packing: Packing, small_configuration: Configuration
) -> None:
    """The packing of most tests states the key of its configuration, and has the contacts that this makes."""
    made = packing_source.new_packing(small_configuration)
    assert np.array_equal(made.pairs, small_packing.pairs)
    assert made.content_hash == small_packing.content_hash


def test_a_cache_that_cannot_be_written_costs_only_time(
    told: list[str], packing: Packing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a folder for the cache the packing is made all the same, with advice."""
    monkeypatch.setenv("CALCIDEM_CACHE", "/proc/none")
    made = provide_packing(TINY, None)
    assert "set CALCIDEM_CACHE to a folder that works" in told[-1]
    assert same_bits(replace(made, report=packing.report), packing)


def test_the_cache_follows_the_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """CALCIDEM_CACHE comes before XDG_CACHE_HOME, and that before ~/.cache."""
    monkeypatch.setenv("HOME", "/h")
    monkeypatch.delenv("CALCIDEM_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert cache_folder() == Path("/h/.cache/calcidem")
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    assert cache_folder() == Path("/x/calcidem")
    monkeypatch.setenv("CALCIDEM_CACHE", "/c")
    assert cache_folder() == Path("/c")


def test_contents_are_checked_against_the_packing(packing: Packing) -> None:
    """A content that the packing cannot hold is refused with the largest that it can; so is a band too high for it."""
    campaign = replace(TINY.campaign, contents=(0.0, 90.0), seeds=(1, 2, 3))
    wide = replace(TINY.wave, receiver_half_width=0.05, boundary_thickness=0.001)
    with pytest.raises(ValueError, match="holds at most") as refused:
        check_against_packing(replace(TINY, campaign=campaign, wave=wide), packing)
    message = str(refused.value)
    assert "campaign.contents = [0.0, 90.0]" in message
    assert "wave.receiver_half_width = 0.05" in message


@pytest.mark.parametrize("mirrored", [False, True])
def test_bands_that_no_disk_touches_are_refused(packing: Packing, mirrored: bool) -> None:
    """The wave also comes from the other side, so they are refused there, too, and whatever transmits."""
    side = packing.mirrored() if mirrored else packing
    height = np.abs(side.y - 0.5 * side.height)
    least = float(height[side.x < side.radius].min())
    wave = replace(TINY.wave, boundary_thickness=0.001, listening_depth=0.005, receiver_half_width=0.008)
    for transmitter in ("wall", "driven"):
        narrow = replace(TINY, wave=replace(wave, transmitter=transmitter, transmitter_half_width=0.99 * least))
        with pytest.raises(
            ConfigurationError, match=r"wave\.transmitter_half_width = .*no disk touches the transmitter"
        ):
            check_against_packing(narrow, packing)
    beside = replace(wave, transmitter_half_width=0.008, receiver_half_width=0.99 * least)
    with pytest.raises(ConfigurationError, match=r"wave\.(receiver_half_width|listening_depth) = "):
        check_against_packing(replace(TINY, wave=beside), packing)


def test_what_is_too_narrow_to_measure_is_refused(packing: Packing) -> None:
    """A wave needs three groups of disks far from the transmitter, and a static speed an inner part."""
    wave = replace(TINY.wave, receiver_half_width=0.008, boundary_thickness=0.001, listening_depth=0.005)
    refused = 0
    for half in np.linspace(1.1e-3, 4e-3, 12).tolist():
        narrow = replace(wave, receiver_half_width=half)
        try:
            check_against_packing(replace(TINY, wave=narrow), packing)
        except ConfigurationError as error:
            refused += (is_it := f"receiver_half_width = {half}: fewer than 3 groups of disks record" in str(error))
            assert not is_it or station_disks(packing, narrow) == ()
    assert refused
    check_against_packing(replace(TINY, wave=wave), packing)
    with pytest.raises(ConfigurationError, match=r"run\.static_speed = true: packing\.width = 0\.02: too narrow"):
        check_against_packing(replace(TINY, wave=wave, run=RunOptions(static_speed=True)), packing)
    none = np.zeros(len(packing.pairs), dtype=bool)
    with pytest.raises(ValueError, match=r"packing\.width = 0\.02: too narrow for a static speed"):
        static_speed(TINY.experiment(packing), none)
    assert _known_static_speed(TINY.experiment(packing), none) is None  # which costs a cell nothing else


def test_every_seed_that_may_be_added_holds_the_content() -> None:
    """With ``until`` a content close to what samples hold is compared with the tightest of all, as far as needed."""
    room = {1: 9.0, 2: 8.0, **dict.fromkeys(range(3, 9), 9.5), **dict.fromkeys(range(9, 60), 8.5), 60: 7.0}
    experiment = SimpleNamespace(ordering=lambda seed: SimpleNamespace(maximum_content=room[seed]))
    assert _tightest_seed(experiment, range(1, 9), 7.5) == (2, 8.0)  # type: ignore[arg-type]
    assert _tightest_seed(experiment, range(1, 61), 7.5) == (60, 7.0)  # type: ignore[arg-type]
    assert _tightest_seed(experiment, range(1, 61), 5.9) == (2, 8.0)  # type: ignore[arg-type]


def test_a_pulse_is_checked_against_the_packing(packing: Packing) -> None:
    """A pulse too short for the packing is refused before anything is computed; of a loud one the user is warned."""
    wave = replace(TINY.wave, receiver_half_width=0.005, boundary_thickness=0.001, listening_depth=0.005)
    fit = replace(TINY, campaign=replace(TINY.campaign, contents=(0.0,)), wave=wave)
    short = replace(fit, excitation=replace(TINY.excitation, frequency=1e6))
    with pytest.raises(ValueError, match=r"at 0 % wave\.frequency = "):
        check_against_packing(short, packing)
    slow = replace(TINY.excitation, frequency=1e3)
    loud, quiet = (replace(fit, wave=replace(wave, amplitude=v), excitation=slow) for v in (10.0, 1e-6))
    assert any("wave.amplitude = 10: " in doubt for doubt in check_against_packing(loud, packing))
    assert not any("wave.amplitude" in doubt for doubt in check_against_packing(quiet, packing))
