"""The file of measured velocities on its way into a report."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calcidem.analysis.measured import Target
from calcidem.app.config.reader import read_targets
from calcidem.app.config.schema import ConfigurationError
from calcidem.app.report import page


def test_the_report_is_given_what_the_file_holds(
    small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, invoke: Callable[..., str]
) -> None:
    """A file as calibrate takes reaches the report; one with mistakes is refused before anything is drawn."""
    given: list[tuple[Target, ...]] = []

    def remember(_database: object, out: Path, *, measured: tuple[Target, ...], **_: object) -> Path:
        given.append(measured)
        return out

    monkeypatch.setattr(page, "write_report", remember)
    file = tmp_path / "measured.csv"
    file.write_text("content,vs,sd\n0.66,375,20\n", encoding="utf-8")
    invoke("report", small_database, "--measured", file)
    assert given == [(Target(0.66, 375.0, 20.0),)]
    file.write_text("content,vs2\n0.66,375\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="column vs: is missing"):
        invoke("report", small_database, "--measured", file)
    assert len(given) == 1


SPECIMENS = (Target(2.0, 480.0, samples=1, stress=50e3), Target(4.4, 910.0, samples=1, stress=50e3))


@pytest.mark.parametrize(
    "text",
    [
        b"content,vs,confining\n2,480,50\n4.4,910,50\n",
        b"specimen,CaCO3 content (%),operator,Confining stress (bar),Vs (m/s)\nA1,2,N,0.5,480\nA2,4.4,N,0.5,910\n",
        "\ufeffContent;Vs;confining pressure [kPa]\r\n2,0;480;50\r\n4,4;910;50\r\n".encode(),
        b"content (-)\tVs in km/s\tp\n0.02\t0.48\t50\n0.044\t0.91\t50\n",
        b"content,vs,p\n2%,480 m/s,50 kPa\n4.4%,0.91 km/s,0.05 MPa\n",
        b"Probe;Calcitgehalt (%);Zelldruck (kPa);Wellengeschwindigkeit (m/s)\nA1;2;50;480\nA2;4,4;50;910\n",
        b"content;G0 (MPa);density (g/cm3);p\n2;460.8;2;50\n4.4;1656.2;2;50\n",
        "CaCO3-Content / %;Shear-wave velocity / (m/s);\u03c3 in \u00b0;p (kPa)\n2;480;1;50\n4,4;910;1;50\n".encode(),
    ],
)
def test_tables_of_laboratories_are_read(text: bytes, tmp_path: Path) -> None:
    """A row for each specimen, in any units, separators and order of columns; G0 and density give Vs."""
    (tmp_path / "lab.csv").write_bytes(text)
    found = read_targets(tmp_path / "lab.csv")
    assert [(row.content, row.vs, row.sd, row.samples, row.stress) for row in found] == [
        (pytest.approx(row.content), pytest.approx(row.vs), None, 1, row.stress) for row in SPECIMENS
    ]


def test_rows_with_scatter_are_means_unless_they_name_specimens(tmp_path: Path) -> None:
    """The standard deviation of a specimen is that of its readings, in the unit of its velocity; others are told."""
    (tmp_path / "lab.csv").write_text("content,Vs (km/s),Std,by\n2,0.48,0.02,N\n", encoding="utf-8")
    told: list[str] = []
    assert read_targets(tmp_path / "lab.csv", told.append) == (Target(2.0, 480.0, 20.0),)
    assert told[0].endswith("1 measurements; content in 'content', vs in 'Vs (km/s)', sd in 'Std'; not used: by")
    (tmp_path / "lab.csv").write_text("specimen,content,vs,sd\nA,2,480,20\nA,2,490,20\n", encoding="utf-8")
    assert read_targets(tmp_path / "lab.csv") == (Target(2.0, 480.0, 20.0, 1), Target(2.0, 490.0, 20.0, 1))


def test_a_deviation_in_another_unit_than_the_velocity_is_asked_for(tmp_path: Path) -> None:
    """It takes that of the velocity, which makes 20 m/s 20 km/s."""
    (tmp_path / "lab.csv").write_text("content (%),Vs (km/s),sd\n1,0.5,20\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"sd = 20000 m/s at Vs = 500 m/s: is it in the unit of the velocity"):
        read_targets(tmp_path / "lab.csv")
    (tmp_path / "lab.csv").write_text("content (%),Vs (km/s),sd (m/s)\n1,0.5,20\n", encoding="utf-8")
    assert read_targets(tmp_path / "lab.csv") == (Target(1.0, 500.0, 20.0),)


def test_one_mistake_in_many_rows_is_one_line(tmp_path: Path) -> None:
    """With the first row and the number of the others."""
    (tmp_path / "lab.csv").write_text("content,vs\n1,-3\n2,-4\n3,-5\n4,400\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"1 problem.*\n.*row 2, vs = '-3' and 2 more rows: give a positive"):
        read_targets(tmp_path / "lab.csv")
