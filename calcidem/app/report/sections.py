"""Contents of a report: tables by name, and sections with tables and figures.

Here are the tables of what was run, and those that hold the campaign beside the published study and measured
velocities; `calcidem.app.report.tables` has those of what came out.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from scipy import stats

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError, published_velocities
from calcidem.analysis.measured import PUBLISHED_KEYS, is_covered, misfits, published_study
from calcidem.analysis.velocity import median_diameter_by_mass
from calcidem.app.report.tables import RESULT_TABLES, Table, with_bounds
from calcidem.storage.records import RunRecord, flat_parameters
from calcidem.wording import ABSENT, decimal, duration, significant

Data = TypeVar("Data")
Made = TypeVar("Made")

_UNKNOWN = "unknown"
_CHOSEN = {
    "sand.wave_stiffness_factor": (1.0, "multiplies grain modulus and confining stress in the wave stage"),
    "pattern.p_share": (1.0, "calcite of a P contact as a multiple of the toroid of Eq. 2"),
    "pattern.p_patch_diameter": (0.0, "diameter of the patches of P contacts, m; 0 for single contacts"),
    "pattern.cluster_area": (None, "calcite of a cluster in m²; without it the sum of Eq. 2 over its contacts"),
    "pattern.keep_p": (_UNKNOWN, "whether P contacts remain when clusters appear; the published text allows both"),
    "packing.friction_preparation": (_UNKNOWN, "friction during packing; determines the coordination number"),
    "wave.transmitter": (_UNKNOWN, "whether the wall drives the grains by friction, or their motion is prescribed"),
    "wave.transmitter_half_width": (_UNKNOWN, "half-width of the transmitter, m"),
    "wave.receiver_half_width": (_UNKNOWN, "half-width of the receiver, m"),
    "wave.boundary_thickness": (_UNKNOWN, "thickness of the strongly damped layers, m"),
    "wave.law": (_UNKNOWN, "whether geometry and stiffness change with the wave"),
    "wave.both_sides": (_UNKNOWN, "whether the wave comes from either side, and effective_vs is the mean of both"),
    "cement.bond_stiffness_ratio": (_UNKNOWN, "normal over shear stiffness of a bond"),
    "cement.installation": (_UNKNOWN, "treatment of a contact's force at cementing"),
}
"""Keys without a published value: value by a literal reading, if any, and meaning."""


def _published_table(analysis: CampaignAnalysis) -> Table | None:
    """Mean, deviation and normality compared with the published ones; None for other sands and contents."""
    published = published_velocities(analysis)
    if not published:
        return None
    here, seeds = {round(row.content, 6): row.vs for row in analysis.distributions}, published_study().seeds
    rows: list[dict[str, str]] = []
    marked: set[int] = set()
    for content, row in published:
        vs = here[round(content, 6)]
        p_value = vs.p_small_sample
        if vs.standard_deviation > 0:  # a mean without scatter can't be compared
            moments = (vs.mean, vs.standard_deviation, vs.n, row.mean, row.standard_deviation, seeds)
            if stats.ttest_ind_from_stats(*moments, equal_var=False).pvalue < 0.05:
                marked.add(len(rows))
        rows.append(
            {
                "content (%)": f"{content:g}",
                "mean (m/s)": with_bounds(vs.mean, vs.mean_interval),
                "published mean (m/s)": decimal(row.mean),
                "difference": f"{decimal(100 * (vs.mean / row.mean - 1), 1)} %" if vs.n else ABSENT,
                "standard deviation (m/s)": with_bounds(vs.standard_deviation, vs.standard_deviation_interval),
                "published deviation (m/s)": decimal(row.standard_deviation),
                "normal here": ABSENT if math.isnan(p_value) else "yes" if p_value >= 0.05 else "no",
                "printed as normal": "yes" if row.normal else "no",
            }
        )
    return Table.of(
        "This campaign and the published one. Marked: the two means differ by more than their errors explain "
        "(Welch's test at 5 %, with the published standard deviation and number of samples). Normal: not rejected by "
        "the Jarque-Bera test at 5 %. Some printed verdicts do not follow from the printed skewness and kurtosis, see "
        "docs/reproduction.md.",
        rows,
        marked,
    )


def _measured_table(analysis: CampaignAnalysis) -> Table | None:
    """Mean and scatter compared with measured ones; None without measurements."""
    if not analysis.measured:
        return None
    found = misfits(analysis.distributions, analysis.measured)
    rows = tuple(
        {
            "content (%)": f"{one.measured.content:g}{' (interpolated)' if one.interpolated else ''}",
            "confining stress (kPa)": ABSENT if one.measured.stress is None else f"{one.measured.stress / 1e3:g}",
            "samples": ABSENT if one.measured.samples is None else str(one.measured.samples),
            "mean (m/s)": decimal(one.mean),
            "measured mean (m/s)": decimal(one.measured.vs),
            "difference (%)": decimal(100 * one.difference, 1),
            "in standard errors": decimal(one.standard_errors, 1),
            "standard deviation (m/s)": decimal(one.standard_deviation),
            "measured deviation (m/s)": ABSENT if one.measured.sd is None else decimal(one.measured.sd),
            "ratio": decimal(one.deviation_ratio, 2),
            "outside 95 % of new samples": f"{one.outside} of {one.compared}" if one.compared else ABSENT,
        }
        for one in found
    )
    contents = [row.content for row in analysis.distributions if row.vs.n] or [math.inf]
    beyond = [row for row in analysis.measured if not is_covered(row, contents[0], contents[-1])]
    stresses = sorted({row.stress for row in analysis.measured if row.stress is not None})
    here = analysis.config.get("packing", {}).get("stress")
    named = ", ".join(f"{row.content:g} % ({decimal(row.vs)} m/s)" for row in beyond)
    said = [f"Measured beyond the campaign's contents, and not compared: {named}. Add contents for it."] * bool(beyond)
    if not rows:
        raise UnavailableError("no measured velocity is within the contents that have velocities here")
    if here is not None and any(abs(stress / here - 1.0) > 0.1 for stress in stresses):
        kilopascals = ", ".join(f"{stress / 1e3:g}" for stress in stresses)
        said.append(f"Measured under {kilopascals} kPa, computed under {here / 1e3:g} kPa.")
    off = math.sqrt(np.mean([one.difference**2 for one in found]))
    outside, compared = (sum(getattr(one, name) for one in found) for name in ("outside", "compared"))
    return Table.of(
        f"This campaign and measured velocities: root mean square of the differences of the means "
        f"{decimal(100 * off, 1)} %. {outside} of {compared} measured values are outside "
        "the interval of 95 % of new samples. Specimens of nearly one content are joined: a tenth of it and 0.1 %. "
        "Between the campaign's contents, means and intervals lie on straight lines. Without cement there is one "
        "sample, with the interval of its velocity. A standard error is that of the difference of both means. "
        f"Marked: more than two of them. {' '.join(said)}".strip(),
        rows,
        (i for i, one in enumerate(found) if abs(one.standard_errors) > 2.0),
    )


def _parameter_table(config: Mapping[str, Any]) -> Table | None:
    """Parameters of the published study, other values than published marked; None for other sands."""
    if not published_study().has_sand_of(config):
        return None
    flat, published = flat_parameters(config), published_study().parameters
    rows: list[tuple[str, ...]] = []
    marked: set[int] = set()
    known = {key: (published[name], name.replace("_", " ")) for key, name in PUBLISHED_KEYS.items()}
    for key, (expected, meaning) in (_CHOSEN | known).items():
        if key not in flat:
            continue
        if expected != _UNKNOWN and flat[key] != expected:
            marked.add(len(rows))
        rows.append((key, _value_text(flat[key]), _value_text(expected), meaning))
    return Table(
        "Parameters in SI units. Marked rows differ from what is published, or from a literal reading of it. Where "
        "nothing is published, a value had to be chosen.",
        ("parameter", "here", "published or literal", "meaning"),
        tuple(rows),
        frozenset(marked),
    )


def _configuration_table(analysis: CampaignAnalysis) -> Table:
    """Whole physical configuration, with automatically chosen frequencies."""
    texts = {key: _value_text(value) for key, value in flat_parameters(analysis.config).items()}
    if texts.get("wave.frequency") == "auto":
        chosen = analysis.cells["frequency"].max("seed").dropna("content")
        found = [f"{float(one) / 1e3:g} kHz at {float(one['content']):g} %" for one in chosen]
        texts["wave.frequency"] = f"auto: {', '.join(found) or 'no cell is computed yet'}"
    return Table("The whole physical configuration in SI units.", ("parameter", "value"), tuple(texts.items()))


def _value_text(value: object) -> str:
    """Return a value of a configuration for people."""
    match value:
        case None:
            return "none"
        case bool():
            return "yes" if value else "no"
        case int():
            return str(value)
        case float():
            return significant(value, 6)
        case list() | tuple():
            return ", ".join(_value_text(item) for item in value)
        case _:
            return str(value)


def _run_table(runs: tuple[tuple[int, RunRecord], ...]) -> Table | None:
    """Runs of the program on this campaign; None without any."""
    rows = [
        {
            "run": str(run_number),
            "started": f"{run.started:%Y-%m-%d %H:%M} UTC",
            "took": ABSENT if run.ended is None else duration((run.ended - run.started).total_seconds()),
            "ended": run.exit_state or "still running, or killed",
            "ranks": str(run.ranks),
            "host": f"{run.host} ({run.cpu})",
            "versions": ", ".join(f"{name} {version}" for name, version in run.versions.items()),
            "source": run.git_commit[:10] + (" with local changes" if run.git_dirty else "")
            if run.git_commit
            else "installed package",
        }
        for run_number, run in runs
    ]
    return (
        Table.of("Runs of the program on this campaign. The time includes packing, checks and compilation.", rows)
        if rows
        else None
    )


def _packing_table(analysis: CampaignAnalysis) -> Table:
    """Quality of the packings, one column each."""
    graphs, notes = analysis.graphs, ("in two dimensions", "")
    if published_study().has_sand_of(analysis.config):
        notes = (f"published {_value_text(published_study().parameters['porosity'])}", "published weights: 3.05")

    def stress_on(wall: str) -> Any:  # noqa: ANN401 - one of the functions of a graph
        return lambda graph: decimal(graph.packing.wall_stress[wall] / 1e3, 3)

    rows: list[tuple[str, ...]] = [
        (name, *(text(graph) for graph in graphs), note)
        for name, text, note in (
            ("grains", lambda g: str(g.graph.grain_count), ""),
            ("contacts", lambda g: str(g.graph.contact_count), ""),
            ("porosity", lambda g: decimal(g.packing.porosity, 4), notes[0]),
            ("coordination number", lambda g: decimal(g.packing.coordination_number, 3), notes[1]),
            (
                "coordination number without rattlers",
                lambda g: decimal(g.packing.coordination_number_without_rattlers, 3),
                "",
            ),
            (
                "width and height (mm)",
                lambda g: f"{1e3 * g.packing.width:.2f} \N{MULTIPLICATION SIGN} {1e3 * g.packing.height:.2f}",
                "the lid has moved",
            ),
            (
                "median diameter by mass (mm)",
                lambda g: decimal(1e3 * median_diameter_by_mass(g.packing.radius), 3),
                "d50",
            ),
            (
                "median diameter by count (mm)",
                lambda g: decimal(2e3 * float(np.median(g.packing.radius)), 3),
                "d50 of Eq. 9 here",
            ),
            *((f"stress on the {wall} wall (kPa)", stress_on(wall), "") for wall in graphs[0].packing.wall_stress),
            ("mean overlap / diameter", lambda g: significant(g.packing.mean_relative_overlap), ""),
            ("largest overlap / diameter", lambda g: significant(g.packing.largest_relative_overlap), ""),
            ("unbalanced-force ratio", lambda g: significant(g.packing.unbalanced_ratio), "at rest"),
            (
                "grains at transmitter, receiver",
                lambda g: f"{g.graph.transmitter.size}, {g.graph.receiver.size}",
                "ends of the paths",
            ),
            ("content hash", lambda g: g.packing.content_hash, "of all bits of disks, walls and forces"),
            ("time to make", lambda g: duration(g.packing.seconds), ""),
        )
    ]
    names = ("packing",) if len(graphs) == 1 else tuple(f"packing {graph.packing.index}" for graph in graphs)
    return Table("Packings that all cells share.", ("quantity", *names, "remark"), tuple(rows))


TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = RESULT_TABLES | {
    "measured": _measured_table,
    "published": _published_table,
    "parameters": lambda analysis: _parameter_table(analysis.config),
    "packing": _packing_table,
    "runs": lambda analysis: _run_table(analysis.store.runs()),
    "configuration": _configuration_table,
}
"""Functions that make tables, by name in files; they return None without data."""


@dataclass(frozen=True, slots=True)
class SectionPlan:
    """Section of the page."""

    anchor: str
    title: str
    """Name in links, and heading."""
    figures: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()
    folded: tuple[str, ...] = ()
    """Names of `CAMPAIGN_FIGURES` and of `TABLES` in order; folded tables open on a click."""


PAGE_SECTIONS = (
    SectionPlan(
        "velocities",
        "Shear-wave velocity",
        ("vs_range", "histograms"),
        ("velocities", "measured", "meaning", "outcomes"),
    ),
    SectionPlan("samples", "Samples and measurement", ("samples", "measurement", "signals", "methods", "dispersion")),
    SectionPlan(
        "paths",
        "Preferential paths and connectivity",
        ("paths", "correlations", "weight_scan", "laws", "network_correlations", "conductance"),
        ("features", "network_features", "own_features", "laws"),
    ),
    SectionPlan("errors", "Errors and run time", ("narrowing",), ("errors_and_cost", "two_velocities")),
    SectionPlan("published", "The published study", (), ("published",)),
    SectionPlan("provenance", "What was run", (), ("parameters", "packing", "runs"), ("configuration",)),
)


def make_or_explain(make: Callable[[Data], Made], data: Data) -> tuple[Made | None, str]:
    """Return the result of a function and no reason, or None and the reason why data are missing."""
    try:
        return make(data), ""
    except UnavailableError as error:
        return None, str(error)
