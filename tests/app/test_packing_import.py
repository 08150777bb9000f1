"""Disks of other programs as packings: every format gives the same disks, and what is left out or wrong is said."""

import gzip
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.run import run
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.app.disks import ImportedPacking, import_packing
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.compaction import _read_disks
from calcidem.dem.sample.packing import Packing, PackingFileError
from calcidem.input_file import InputFileError

PEERS = Path(__file__).parents[2] / "benchmarks" / "peers"
sys.path.append(str(PEERS))

from programs import HOW_TO, LAMMPS_ENVIRONMENT, environment, has_lammps  # noqa: E402 - the folder has to be on the path

COLUMN, ROW = (numbers.ravel() for numbers in np.meshgrid(np.arange(9), np.arange(12)))
LATTICE = np.column_stack(
    [
        0.0022 * (COLUMN + 0.5 * (ROW % 2)) + 0.0011,
        0.0022 * 0.87 * ROW + 0.0011,
        np.where(ROW > 0, 0.0011 - 5e-6 * ((3 * COLUMN + 5 * ROW) % 7), 0.001101),
    ]
)
"""(108, 3) x, y and radius of disks in a loose lattice of 9 x 12; those of the lowest row touch, and lie on y = 0."""


def lines_of(rows: Floats | list[tuple[object, ...]], separator: str = " ") -> str:
    """Lines of a table."""
    return "".join(separator.join(map(str, row)) + "\n" for row in (rows.tolist() if hasattr(rows, "tolist") else rows))


def atoms(*columns: str) -> list[tuple[object, ...]]:
    """Rows of a LAMMPS file, last disk first."""
    x, y, radius = LATTICE.T
    values = {"type": np.ones(108, int), "density": 2650 + 0 * x, "x": x, "y": y, "z": 0 * x, "radius": radius}
    values |= {"id": np.arange(1, 109), "molecule": np.arange(108), "diameter": 2 * radius, "image": 0 * COLUMN}
    values |= {"xs": (x + 0.01) / 0.05, "ys": (y + 0.01) / 0.05}
    return list(zip(*(values[name].tolist() for name in columns), strict=True))[::-1]


def data_file(style: str, *columns: str) -> str:
    """LAMMPS data file as write_data makes it."""
    box = "0 0.02095 xlo xhi\n0 0.05 ylo yhi\n-0.01 0.01 zlo zhi\n"
    head = f"LAMMPS data file via write_data, timestep = 0, units = si\n\n108 atoms\n1 atom types\n\n{box}\n"
    return head + f"Atoms # {style}\n\n{lines_of(atoms(*columns))}\nVelocities\n\n1 0 0 0 0 0 0\n"


def dump(*columns: str) -> str:
    """Dump of two snapshots, of which the first has other radii."""
    snapshot = (
        "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n108\nITEM: BOX BOUNDS ff ff pp\n-0.01 0.04\n-0.01 0.04\n-1 1\n"
    )
    rows = f"ITEM: ATOMS {' '.join(columns)}\n{lines_of(atoms(*columns))}"
    return snapshot.format(0) + rows.replace("0.001101\n", "0.001\n") + snapshot.format(5000) + rows


def pfc_list() -> str:
    """Listing with numbers of contacts, fixity, and places as vectors."""
    rows = "".join(f"  {i + 1}  {r!r}  3/5  ---  ({x!r}, {y!r})\n" for i, (x, y, r) in enumerate(LATTICE.tolist()))
    return f"Ball list\n  ID  Radius  Contacts  Fixity  Position\n ---- ---- ---- ---- ----\n{rows}\nListed 108 balls\n"


def spreadsheet() -> str:
    """Table in millimetres, centred, with diameters and decimal commas."""
    x, y, radius = LATTICE.T
    columns = [x * 1e3 - 10.6, y * 1e3 - 20, 2e3 * radius]
    return "Nr;x [mm];y [mm];Diameter [mm]\n" + lines_of(
        [
            (i, *(f"{value:.12g}".replace(".", ",") for value in row))
            for i, row in enumerate(zip(*columns, strict=True))
        ],
        ";",
    )


def extended_xyz(disks: Floats, of_cell: str = "0.02095 0 0 0 0.05 0 0 0 1") -> str:
    """Frame of an extended XYZ file."""
    head = f'{len(disks)}\nLattice="{of_cell}" Properties=species:S:1:pos:R:3:radius:R:1 Time=0.5 pbc="F F T"\n'
    return head + lines_of([("Si", x, y, 0.0, r) for x, y, r in disks.tolist()])


FILES: dict[str, tuple[str, Callable[[], str | bytes]]] = {
    "data": ("LAMMPS data file", lambda: data_file("sphere", "id", "type", "diameter", "density", "x", "y", "z")),
    "data with images": (
        "LAMMPS data file",
        lambda: data_file("sphere", "id", "type", "diameter", "density", "x", "y", "z", "image", "image", "image"),
    ),
    "data of bonded particles": (
        "LAMMPS data file",
        lambda: data_file("bpm/sphere", "id", "molecule", "type", "diameter", "density", "x", "y", "z"),
    ),
    "dump": ("LAMMPS dump", lambda: dump("id", "type", "x", "y", "z", "radius") + "\n \n"),
    "scaled dump": ("LAMMPS dump", lambda: dump("id", "xs", "ys", "diameter", "radius")),
    "YADE": (
        "YADE text export",
        lambda: "#format x_y_z_r\n" + lines_of(np.insert(LATTICE, 2, 0.0, axis=1), "\t"),
    ),
    "YADE with materials": (
        "YADE text export",
        lambda: (
            "# a comment\n#format id_x_y_z_r_matId\n# another\n"
            + lines_of([(i, x, y, 0.0, r, 0) for i, (x, y, r) in enumerate(LATTICE.tolist())], "\t")
        ),
    ),
    "PFC": ("PFC ball list", pfc_list),
    "PFC with components": (
        "PFC ball list",
        lambda: "Ball information\nBall ID  Pos-X  Pos-Y  Ball radius\n" + lines_of(np.insert(LATTICE, 0, ROW, axis=1)),
    ),
    "spreadsheet": ("table", spreadsheet),
    "spreadsheet in Latin-1": (
        "table",
        lambda: spreadsheet().replace("Nr", "Gr\u00f6\u00dfe in \u00b0").encode("latin-1"),
    ),
    "columns in units of their own": (
        "table",
        lambda: "x (mm)|radius/\u00b5m|y_m\n" + lines_of(LATTICE[:, [0, 2, 1]] * (1e3, 1e6, 1.0), "|"),
    ),
    "ParaView": (
        "table",
        lambda: '"Points:0","Points:1","Points:2","radius"\n' + lines_of(np.insert(LATTICE, 2, 0.0, axis=1), ","),
    ),
    "OVITO": ("extended XYZ", lambda: extended_xyz(LATTICE * (1.0, 1.0, 0.5)) + extended_xyz(LATTICE)),
    "YADE in x and z": ("YADE text export", lambda: "#format x_y_z_r\n" + lines_of(np.insert(LATTICE, 1, 0.7, axis=1))),
    "a line of units": ("table", lambda: "x;y;r\n[mm];[mm];[mm]\n" + lines_of(LATTICE * 1e3, ";")),
    "commented names": ("table", lambda: "# made by hand\n# x y r\n" + lines_of(LATTICE)),
}


def bring(folder: Path, text: str | bytes, **choices: object) -> ImportedPacking:
    """Import a text."""
    (folder / "source").write_bytes(text if isinstance(text, bytes) else text.encode())
    return import_packing(folder / "source", folder / "disks.csv", **choices)  # type: ignore[arg-type]  # what a test wants


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_disks(name: str, tmp_path: Path) -> None:
    """Whatever wrote them, their unit and frame, the same disks are in the file for `[packing]`, in one order."""
    form, text = FILES[name]
    found = bring(tmp_path, text())
    assert found.form == form
    x, y, radius, *_ = _read_disks(tmp_path / "disks.csv")
    np.testing.assert_allclose(np.column_stack([x, y, radius]), LATTICE, rtol=0, atol=1e-15)
    np.testing.assert_array_equal((x, y, radius), (found.x, found.y, found.radius))
    assert found.height == pytest.approx(0.0022 * 0.87 * 11 + 0.0011 + 0.0011, abs=5e-5)
    area = np.pi * np.sum(LATTICE[:, 2] ** 2)
    assert found.porosity == pytest.approx(1.0 - area / (found.width * found.height))
    assert (found.pairs, found.largest_overlap) == (8, pytest.approx(2e-6))


def test_walls_are_where_disks_the_file_or_the_user_say(tmp_path: Path) -> None:
    """The outermost disks touch the walls; a box in the file that fits comes first, and walls given before all."""
    table = FILES["commented names"][1]()
    by_disks, by_file = bring(tmp_path, table), bring(tmp_path, FILES["data"][1]())
    right = np.max(LATTICE[:, 0] + LATTICE[:, 2])
    assert (by_disks.width, by_file.width) == (pytest.approx(right, abs=1e-5), 0.02095)
    inner = bring(tmp_path, table, walls=(0.0022, 0.0132, 0.0, 1.0))
    inside = (LATTICE[:, 0] > 0.003) & (LATTICE[:, 0] < 0.0125)
    assert (len(inner.x), inner.width, inner.origin) == (inside.sum(), pytest.approx(0.011), (0.0022, 0.0))
    assert f"left out: {108 - inside.sum()} disks that reach beyond the walls" in str(inner)
    np.testing.assert_allclose(inner.x, LATTICE[inside, 0] - 0.0022)


def test_what_is_no_disk_of_the_packing_is_left_out_and_said(tmp_path: Path) -> None:
    """Other types, points, disks beside the plane and lines without numbers are counted; the rest stays."""
    disks = [(x, y, 0.5, r, 1) for x, y, r in LATTICE.tolist()]
    others = [(0.1, 0.1, 0.5, 0.001, "wall"), (0.0, 0.0, 0.5, 0.0, 1), (0.01, 0.01, 0.6, 0.001, 1)]
    text = "x y z r type\n" + lines_of([*disks, *others]) + "mean of all disks in this list\n"
    found = bring(tmp_path, text, types=["1"])
    report = str(found)
    assert len(found.x) == 108
    wanted = ("1 disks of type wall", "1 points without", "1 disks out of the plane", "1 lines that are no disks")
    assert all(f"left out: {sentence}" in report for sentence in wanted)


def test_the_plane_of_the_disks_can_be_any(tmp_path: Path) -> None:
    """Disks that lie in x and z become x and y."""
    text = "x,y,z,radius\n" + lines_of(np.insert(LATTICE, 1, 0.7, axis=1), ",")
    np.testing.assert_allclose(bring(tmp_path, text, plane="xz").y, LATTICE[:, 1])


def test_names_of_columns_can_be_given(tmp_path: Path) -> None:
    """A file without names, compressed, in an own unit is read as it is told; names may have the unit."""
    text = gzip.compress(lines_of(np.insert(LATTICE * 1e6, 1, 7.0, axis=1), "\t").encode())
    found = bring(tmp_path, text, columns=["x", "weight", "y", "radius"], unit="um")  # type: ignore[arg-type]  # compressed
    np.testing.assert_allclose(found.radius, LATTICE[:, 2])
    again = bring(tmp_path, text, columns=["x (um)", "weight", "y (um)", "radius (um)"])
    np.testing.assert_array_equal(again.radius, found.radius)


def test_a_chosen_snapshot_is_read(tmp_path: Path) -> None:
    """Of a dump with several snapshots, that of the timestep asked for."""
    assert bring(tmp_path, FILES["dump"][1](), timestep=0).radius[0] == 0.001


SPREAD = "x,y,z,radius\n" + lines_of(np.insert(LATTICE, 2, LATTICE[:, 1], axis=1), ",")


@pytest.mark.parametrize(
    ("text", "choices", "words"),
    [
        ("", {}, ("is empty",)),
        ("nothing here\n", {}, ("no line of numbers", "x, y and radius")),
        ("1 2 3\n" * 20, {}, ("no column x, y, radius or diameter", "columns, such as x,y,radius")),
        ("x y r\n" + lines_of(LATTICE) + "0.1 0.1 0.1x\n", {}, ("line 110", "'0.1 0.1 0.1x' is not a disk")),
        ("x y r\n" + lines_of(LATTICE) + "0.1 nan 0.1\n", {}, ("line 110", "finite")),
        ("x y r\n" + lines_of(LATTICE) + "0.1 1e99 0.1\n", {}, ("line 110", "finite")),
        ("x y r\n" + lines_of(LATTICE) + "0.1 0.1 -0.1\n", {}, ("line 110", "negative")),
        ("x y r\n" + lines_of(LATTICE[:5]), {}, ("has 5 disks", "at least 10")),
        ("x y r\n" + lines_of(LATTICE) * 2, {}, (", lines ", "overlap by 0.00219")),
        ("x y r\n" + lines_of(LATTICE), {"unit": "inch"}, ("unit = 'inch'", "m, cm, mm")),
        (spreadsheet(), {"unit": "m"}, ("unit = 'm'", "its own unit, mm", "leave unit out")),
        ("x y r\n" + lines_of(LATTICE), {"plane": "xx"}, ("plane = 'xx'", "xz")),
        ("x y r\n" + lines_of(LATTICE), {"types": ["1"]}, ("type = '1'", "its types are none")),
        ("x y r\n" + lines_of(LATTICE), {"walls": (1, 0, 0, 1)}, ("walls = [1, 0, 0, 1]", "ascending")),
        ("x y r\n" + lines_of(LATTICE), {"walls": (0, 1, 0)}, ("walls = [0, 1, 0]", "four finite")),
        ("x y r\n" + lines_of(LATTICE), {"walls": (0, float("inf"), 0, 1)}, ("walls = [0", "four finite")),
        (SPREAD, {}, ("no layer in the chosen plane", "with plane")),
        (FILES["dump"][1](), {"timestep": 7}, ("timestep = 7", "0, 5000")),
        (FILES["dump"][1]().replace("ff ff pp", "xy xz yz pp pp pp"), {}, ("line 122", "tilted")),
        (FILES["data"][1]().replace("sphere", "atomic"), {}, ("'Atoms # atomic'", "atom_style sphere")),
        (FILES["data"][1]().replace(" # sphere", ""), {}, ("'Atoms'", "name its style, as in 'Atoms # sphere'")),
        (FILES["data"][1]().replace("zhi\n", "zhi\n0.1 0 0 xy xz yz\n"), {}, ("tilted",)),
    ],
)
def test_what_is_wrong_names_the_place_and_the_cure(
    text: str, choices: dict[str, object], words: tuple[str, ...], tmp_path: Path
) -> None:
    """A file that is no packing is bad input, and nothing is written."""
    with pytest.raises(PackingFileError) as caught:
        bring(tmp_path, text, **choices)
    assert not [word for word in words if word not in str(caught.value)], caught.value
    assert _exit_code_of(caught.value) == 2
    assert not (tmp_path / "disks.csv").exists()


PERIODIC = LATTICE - (0.0011, 0.0, 0.0)


@pytest.mark.parametrize(
    "text",
    [
        dump("id", "type", "x", "y", "z", "radius").replace("BOUNDS ff ff pp\n-0.01", "BOUNDS pp ff pp\n0.0011"),
        extended_xyz(PERIODIC).replace("F F T", "T F T"),
    ],
)
def test_a_packing_across_a_periodic_boundary_gets_no_walls_in_silence(text: str, tmp_path: Path) -> None:
    """Its boundary is named; walls that the user gives cut it."""
    with pytest.raises(
        PackingFileError, match=r"the boundary in x is periodic, and [0-9]+ disks reach across"
    ) as caught:
        bring(tmp_path, text)
    assert "Give walls" in str(caught.value)
    cut = bring(tmp_path, text, walls=(0.003, 0.018, -0.001, 1.0))
    assert cut.width == pytest.approx(0.015)
    assert "reach beyond the walls" in str(cut)


def test_a_periodic_box_that_no_disk_leaves_is_a_box(tmp_path: Path) -> None:
    """Walls of disks inside a periodic box keep them from its sides."""
    text = dump("id", "type", "x", "y", "z", "radius").replace("ff ff pp", "pp pp pp")
    assert len(bring(tmp_path, text).x) == 108


def test_the_plane_of_a_layer_is_found_and_said(tmp_path: Path) -> None:
    """Disks that lie in x and z need no option; what is no layer in the plane asked for is said to be none there."""
    text = FILES["YADE in x and z"][1]()
    assert "plane xz, in which the disks lie" in str(bring(tmp_path, text))
    with pytest.raises(PackingFileError, match="no layer in the chosen plane"):
        bring(tmp_path, text, plane="xy")


def test_a_table_without_known_names_is_told_its_own(tmp_path: Path) -> None:
    """Its names are listed, not denied."""
    text = "east,north,rad\n" + lines_of(LATTICE, ",")
    with pytest.raises(PackingFileError, match=r"no column x, y; it has east, north, rad\. Name them"):
        bring(tmp_path, text)


def test_a_tilted_cell_is_refused(tmp_path: Path) -> None:
    """In extended XYZ as in LAMMPS' files."""
    with pytest.raises(PackingFileError, match="line 2: the box is tilted"):
        bring(tmp_path, extended_xyz(LATTICE, "0.02095 0 0 0.01 0.05 0 0 0 1"))


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_was_cut_off_is_refused(name: str, tmp_path: Path) -> None:
    """Wherever it ends, a file is bad input or a table with fewer disks; LAMMPS says how many there should be."""
    form, text = FILES[name][0], FILES[name][1]()
    text = text if isinstance(text, str) else text.decode("latin-1")
    text = text[max(0, text.rfind("ITEM: TIMESTEP")) :]
    for length in range(0, len(text) - 30, len(text) // 60):
        with suppress(PackingFileError, InputFileError):
            assert len(bring(tmp_path, text[:length]).x) < 108
            assert "LAMMPS" not in form
            assert "XYZ" not in form


def test_strange_sizes_are_remarked(tmp_path: Path) -> None:
    """Millimetres read as metres, and diameters read as radii the other way round, are named."""
    metres = "x y r\n" + lines_of(LATTICE * 1e3)
    assert "Check the unit" in str(bring(tmp_path, metres, unit="m"))
    with pytest.raises(
        PackingFileError, match=r"has no unit.*2\.17 m is not that of a sand; unit: mm if it is 2\.17 mm"
    ):
        bring(tmp_path, metres)
    assert "Few disks touch" in str(bring(tmp_path, "x y r\n" + lines_of(LATTICE * (1.0, 1.0, 0.5))))
    assert "is above 0.3" in str(bring(tmp_path, "x y r\n" + lines_of(LATTICE * (1.0, 1.0, 0.5))))


CAMPAIGN = """
[campaign]
name = "imported"
seeds = 1
contents = [0.66]
{section}
unbalanced_force_ratio = 1e-3
[sand]
wave_stiffness_factor = 13.0
[wave]
transmitter_half_width = 0.01
receiver_half_width = 0.012
boundary_thickness = 0.012
listening_depth = 0.006
frequency = 24000.0
[run]
lanes = 2
"""


@pytest.mark.full
def test_a_campaign_computes_on_an_imported_packing(
    small_packing: Packing, invoke: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lines that the command ends with make a campaign, whose packing has the disks of the source."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    disks = np.column_stack([small_packing.x - 0.015, small_packing.y, 0 * small_packing.x, small_packing.radius])
    np.savetxt("sand.txt", disks, fmt="%g", delimiter="\t", header="format x_y_z_r", comments="#")
    shown = invoke("import", "sand.txt", "--out", "disks.csv")
    section = shown[shown.index("[packing]") :]
    assert "width = 0.03\n" in section
    Path("c.toml").write_text(CAMPAIGN.format(section=section), encoding="utf-8")
    run("c.toml", output="results").close()
    with open_campaign("results/imported.db") as campaign:
        np.testing.assert_allclose(sorted(campaign.packing().radius), sorted(small_packing.radius), rtol=1e-5)
        assert campaign.cell(seed=1, content=0.66).status == "done"


TO_LAMMPS = """
from lammps_worker import import_lammps
program = import_lammps().lammps(cmdargs=["-screen", "none", "-log", "none"])
for line in '''units si
dimension 2
boundary f f p
newton off
atom_style sphere
read_data sand.data
write_data out.data
write_dump all custom out.dump id type x y z radius modify format float %.17g
write_dump all custom scaled.dump id xs ys diameter modify format float %.17g'''.splitlines():
    program.command(line)
"""


@pytest.mark.full
def test_disks_come_back_from_lammps(small_packing: Packing, tmp_path: Path) -> None:
    """LAMMPS reads the disks and writes them in three ways; each gives the same disks again."""
    python = str(LAMMPS_ENVIRONMENT / "bin" / "python")
    python = python if Path(python).exists() else sys.executable
    if not has_lammps(python):
        pytest.skip(HOW_TO["lammps"])
    disks = np.column_stack([small_packing.x, small_packing.y, small_packing.radius])
    rows = lines_of([(i, 1, 2 * r, 2650, x, y, 0) for i, (x, y, r) in enumerate(disks.tolist(), 1)])
    box = f"0 {small_packing.width} xlo xhi\n0 {small_packing.height} ylo yhi\n-0.01 0.01 zlo zhi"
    head = f"disks\n\n{len(disks)} atoms\n1 atom types\n\n{box}\n\nAtoms # sphere\n\n"
    (tmp_path / "sand.data").write_text(head + rows, encoding="utf-8")
    subprocess.run([python, "-c", TO_LAMMPS], cwd=tmp_path, env=environment(), check=True)
    for name in ("sand.data", "out.data", "out.dump", "scaled.dump"):
        found = import_packing(tmp_path / name, tmp_path / "disks.csv")
        again = np.column_stack([found.x, found.y, found.radius])
        # The last digit of a diameter and of a scaled place is LAMMPS' own.
        np.testing.assert_allclose(again, disks, rtol=0, atol=4e-16 * small_packing.height, err_msg=name)
        if name != "scaled.dump":
            assert found.width == small_packing.width


TO_YADE = """
from yade import export
O.materials.append(FrictMat())
for line in open("disks.csv").readlines()[1:]:
    x, y, radius = map(float, line.split(","))
    O.bodies.append(sphere((x, 0.0, y), radius))
O.bodies.append(wall(0.0, axis=2))
export.text("text.txt")
export.textExt("materials.txt", format="id_x_y_z_r_matId", comment="sand")
export.textExt("attributes.txt", format="x_y_z_r_attrs", comment="mass", attrs=["b.state.mass"])
"""


@pytest.mark.full
def test_disks_come_back_from_yade(small_packing: Packing, tmp_path: Path) -> None:
    """YADE's exports, which have six digits and lie in a plane of their own here, give the same disks."""
    yade = shutil.which("yade")
    if yade is None:
        pytest.skip(HOW_TO["yade"])
    disks = np.column_stack([small_packing.x, small_packing.y, small_packing.radius])
    (tmp_path / "disks.csv").write_text("x,y,radius\n" + lines_of(disks, ","), encoding="utf-8")
    (tmp_path / "to_yade.py").write_text(TO_YADE, encoding="utf-8")
    subprocess.run([yade, "-n", "-x", "-j1", "to_yade.py"], cwd=tmp_path, env=environment(), check=True)
    for name in ("text.txt", "materials.txt", "attributes.txt"):
        found = import_packing(tmp_path / name, tmp_path / "again.csv", plane="xz")
        again = np.column_stack([found.x, found.y, found.radius])
        np.testing.assert_allclose(again, disks, rtol=0, atol=5.1e-6 * 0.1, err_msg=name)
