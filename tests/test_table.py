"""One reader for the tables of people and programs, on files that say the same in many ways."""

import math
from pathlib import Path

import pytest

from calcidem.input_file import InputFileError, Table, factor_of, meaning_of, parse_number, unit_in_name, value_of

KNOWN = {"size": "size|d", "finer": "(percent)?finer"}

SAME = {
    "commas": b"size,finer\n0.5,10\n1.5,90\n",
    "semicolons and decimal commas": b"Size;Finer\r\n0,5;10\r\n1,5;90\r\n",
    "tabs": b"size\tfiner\n0.5\t10\n1.5\t90\n",
    "blanks": b"size finer\n0.5 10\n1.5 90\n",
    "blanks and decimal commas": b"size finer\n0,5 10\n1,5 90\n",
    "bars": b"size|finer\n0.5|10\n1.5|90\n",
    "quotes": b'"size","finer"\n"0,5","10"\n"1,5","90"\n',
    "UTF-8 with a mark": "\ufeffsize,finer\n0.5,10\n1.5,90\n".encode(),
    "UTF-16": "size,finer\n0.5,10\n1.5,90\n".encode("utf-16"),
    "Windows": "# Korngr\u00f6\u00dfen, 20 \u00b0C\nsize,finer\n0.5,10\n1.5,90\n".encode("cp1252"),
    "a title and comments": b"Sieve analysis 2023\n\n# of sand 7\nsize,finer\n0.5,10\n# dry\n\n1.5,90\n",
    "the hint of a spreadsheet": b"sep=;\nsize;finer\n0.5;10\n1.5;90\n",
    "names in a comment": b"# size finer\n0.5 10\n1.5 90\n",
    "a line of units": b"size;finer\n(mm);[%]\n0.5;10\n1.5;90\n",
    "units in names": b"size / mm;% finer\n0.5;10\n1.5;90\n",
    "units at numbers": b"size,finer\n0.5 mm,10%\n1.5mm,90 %\n",
    "further columns": b"operator,size,remark,finer\nA. B.,0.5,wet,10\nC,1.5,,90\n",
}


def read(folder: Path, content: bytes) -> Table:
    """Read a table of sizes."""
    return Table.read(content, folder / "table", KNOWN, ("size", "finer"))


@pytest.mark.parametrize("name", SAME)
def test_every_way_of_writing_gives_the_same_numbers(name: str, tmp_path: Path) -> None:
    """Separators, decimal commas, encodings, marks, comments, units and further columns do not matter."""
    table = read(tmp_path, SAME[name])
    columns = table.places(KNOWN)
    found = [
        (value_of(row[columns["size"]], "length", "mm"), value_of(row[columns["finer"]], "percent", "%"))
        for _, row in table.rows
    ]
    assert found == [(0.5e-3, 10.0), (1.5e-3, 90.0)]


def test_rows_have_the_lines_of_an_editor(tmp_path: Path) -> None:
    """Comments and blank lines count; a row that is no pair of numbers is left to the caller, not lost."""
    table = read(tmp_path, b"# a\n\nsize,finer\nmean,\n1,2\n")
    assert (table.head, table.rows) == (3, [(4, ["mean", ""]), (5, ["1", "2"])])
    assert read(tmp_path, b"size,finer\nmean,\n").rows == [(2, ["mean", ""])]
    assert read(tmp_path, b"nothing").rows == []


def test_an_empty_first_entry_is_no_comment(tmp_path: Path) -> None:
    """A semicolon begins a comment only where it separates no columns."""
    assert [row for _, row in read(tmp_path, b"id;size;finer\n;1;2\n;3;4\n").rows] == [["", "1", "2"], ["", "3", "4"]]
    assert [row for _, row in read(tmp_path, b"; of the lab\nsize,finer\n1,2\n;3,4\n").rows] == [["1", "2"]]


def test_names_with_blanks_do_not_shift_columns(tmp_path: Path) -> None:
    """Of columns between blanks nobody knows where a name ends, so more names than columns are refused."""
    with pytest.raises(InputFileError, match="line 1 names 3 columns, and line 2 has 2 entries; separate the columns"):
        read(tmp_path, b"size of sieve finer\n1 2\n".replace(b"of sieve", b"sieve"))


@pytest.mark.parametrize("number", ["1,234", "-1,234,567.8", " 1,234 mm"])
def test_a_number_that_may_have_thousands_is_refused(number: str, tmp_path: Path) -> None:
    """Between commas; elsewhere a comma is decimal, and so it is where thousands are impossible."""
    with pytest.raises(InputFileError, match=r"line 3: 1,234.* may be a whole number or a fraction; write numbers"):
        read(tmp_path, f'size,finer\n0.5,10\n"{number}",90\n'.encode())
    rows = read(tmp_path, b'size,finer\n"0,500",10\n"1,5",90\n').rows
    assert rows == read(tmp_path, b"size;finer\n0.500;10\n1.5;90\n").rows


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("Vs (m/s)", "m/s"),
        ("Vs [km/s]", "km/s"),
        ("Vs, m s-1", "m s-1"),
        ("Vs in m s\u207b\u00b9", "m s\u207b\u00b9"),
        ("x_mm", "mm"),
        ("d / \u00b5m", "\u00b5m"),
        ("density (kg/m\u00b3)", "kg/m\u00b3"),
        ("Vs (ft/s)", ""),
        ("mm", ""),
        ("Vs (mean)", ""),
    ],
)
def test_a_unit_in_a_name_is_found(name: str, unit: str) -> None:
    """In any brackets or none; what is no unit stays a part of the name, so that the name is unknown."""
    assert unit_in_name(name)[1] == unit


def test_units_have_many_spellings() -> None:
    """Micro signs, superscripts, negative powers and capitals; a unit of another dimension is none."""
    assert factor_of("\u00b5m", "length") == factor_of("\u03bcm", "length") == factor_of("UM", "length") == 1e-6
    assert factor_of("m s\u207b\u00b9", "velocity") == factor_of("(m/s)", "velocity") == 1.0
    assert factor_of("g cm-3", "density") == factor_of("g/cm\u00b3", "density") == 1e3
    assert factor_of("bar", "stress") == 1e5
    assert math.isnan(factor_of("bar", "length"))
    assert math.isnan(value_of("5 ft", "length", "m"))
    assert value_of("0.3", "length", "mm") == value_of("300\u00b5m", "length", "m") == 0.3e-3
    assert meaning_of("Percent Finer (%)", KNOWN) == "finer"
    assert parse_number("-1.5e3 kPa") == (-1500.0, "kPa")
    assert parse_number("A1") is None
