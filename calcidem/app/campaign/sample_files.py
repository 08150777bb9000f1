"""Samples as files for other programs: ParaView, spreadsheets."""

from pathlib import Path

import numpy as np

from calcidem.app.campaign.opened import Sample
from calcidem.dem.sample.packing_file import write_packing_csv
from calcidem.storage.errors import StoreError
from calcidem.storage.netcdf.export import replaced_atomically

SUFFIXES = (".vtu", ".vtk", ".csv")


def write_sample(sample: Sample, file: Path) -> Path:
    """Write a sample in the format that the file's ending names.

    Parameters
    ----------
    sample
        From `calcidem.app.campaign.opened.OpenedCampaign.sample`.
    file
        ``.vtu`` or ``.vtk`` for ParaView, ``.csv`` for its disks alone; replaced in one step.

    Raises
    ------
    ValueError
        For another ending.
    StoreError
        If the library for VTK isn't installed.
    """
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{file} ends with '{suffix}': give it one of the endings {', '.join(SUFFIXES)}")
    with replaced_atomically(file.absolute()) as temporary:
        if suffix == ".csv":
            write_packing_csv(sample.packing, temporary)
        else:
            write_vtk(sample, temporary, "vtu" if suffix == ".vtu" else "vtk")
    return file


def write_vtk(sample: Sample, file: Path, file_format: str) -> None:
    """Write disks as points and contacts as lines.

    The points have `radius` (m); show them with the filter Glyph, scaled by it. The lines have `kind` (0 sand, 1 P,
    2 C); vertices have the kind -1, so that a threshold parts them from the contacts.
    """
    try:
        import meshio  # type: ignore[import-untyped]  # noqa: PLC0415 - an optional library, without types
    except ModuleNotFoundError as error:
        raise StoreError(
            "Files for ParaView need the library meshio.", "Install it: pip install 'calcidem[paraview]'."
        ) from error
    packing = sample.packing
    count = len(packing.radius)
    cells = [("vertex", np.arange(count)[:, None]), ("line", packing.pairs.astype(np.int64))]
    mesh = meshio.Mesh(
        np.column_stack([packing.x, packing.y, np.zeros(count)]),
        cells,
        point_data={"radius": packing.radius},
        cell_data={"kind": [np.full(count, -1, dtype=np.int32), sample.kind.astype(np.int32)]},
    )
    mesh.write(file, file_format=file_format)
