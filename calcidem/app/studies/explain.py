"""Features that the scenes of a campaign need or omit, and the savings and errors of omitting them.

Each row measures the same cells with and without a feature. It also has the errors of both against a converged
reference if `calcidem accuracy` has measured them.
"""

from dataclasses import dataclass, replace

from calcidem.app.studies.accuracy.questions import MeasuredErrors
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED, with_wave
from calcidem.app.studies.cells import Cells, errors_of_vs
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.rule import WHOLE_DOMAIN
from calcidem.dem.wave.scene import domain_of


@dataclass(frozen=True, slots=True)
class _Alternative:
    """Feature that the kernel includes or omits, and the experiment that does the opposite."""

    what: str
    """Name."""
    needed: bool
    """Whether the campaign includes it."""
    why: str
    """Reason why it is needed, or can safely be omitted."""
    opposite: Experiment | None
    """Experiment with the feature if it is omitted, without it if it is needed; None if impossible."""
    setting: str = ""
    """Name of the opposite in the settings of `calcidem accuracy`; empty if it has none."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One row for one content."""

    content: float
    """Percent of the sand's mass."""
    alternative: _Alternative
    """Explained feature."""
    time_ratio: float | None
    """Processor time of the opposite over that of the campaign, medians of rounds in turns."""
    difference: float | None
    """Largest relative difference in Vs between the two; None if no cell has both velocities."""
    error: float | None = None
    other_error: float | None = None
    """Largest relative error of Vs against a converged reference, for the campaign and for the opposite; None if not
    measured.
    """


def explain(cells: Cells, measured: MeasuredErrors | None = None) -> list[Explanation]:
    """Measure savings and errors of each alternative; ``measured`` has errors against a converged reference."""
    rows = []
    for content in cells.contents:
        alternatives = _alternatives_of(cells.experiment, content)
        opposites = {one.what: one.opposite for one in alternatives if one.opposite is not None}
        found, seconds = cells.take_turns({DEFAULT: cells.experiment, **opposites}, content)
        for one in alternatives:
            row = Explanation(content, one, None, None)
            if one.what in found:
                changes = errors_of_vs(found[one.what], found[DEFAULT])
                ratio = seconds[one.what] / seconds[DEFAULT]
                row = Explanation(content, one, ratio, max(changes, default=None))
            rows.append(_with_errors(row, measured))
    return rows


def _with_errors(row: Explanation, measured: MeasuredErrors | None) -> Explanation:
    """Row with the errors of both alternatives, if measured."""
    if measured is None or not row.alternative.setting:
        return row
    own, other = (measured.worst.get((name, row.content)) for name in (DEFAULT, row.alternative.setting))
    return replace(row, error=own, other_error=other)


def _alternatives_of(experiment: Experiment, content: float) -> list[_Alternative]:
    """Alternatives for the scenes of one content."""
    wave = experiment.wave
    stop, double, wall = experiment.early_stop, wave.precision == "float64", wave.transmitter == "wall"
    other = "float32" if double else "float64"
    settles = "the reading uses no data beyond its horizon, so further steps do not change it"
    early = _Alternative(
        "steps after the pick", False, settles, replace(experiment, early_stop=not stop), f"early_stop {not stop}"
    )
    asked = f"the configuration sets {wave.precision}"
    precision = _Alternative(
        "double precision", double, asked, with_wave(experiment, precision=other), f"precision {other}"
    )
    cemented = content > 0.0
    why = "some contacts are cemented" if cemented else "no contact is cemented"
    bonds = _Alternative("bonds", cemented, why, None if cemented else with_wave(experiment, keep=("bonds",)))
    if wave.damping == 0.0:
        damping = _Alternative("local damping", needed=False, why="alpha of the sample is 0", opposite=None)
    else:  # it slows the front of a wave, see docs/accuracy.md
        why = f"alpha of the sample is {wave.damping:g}: without it Vs differs"
        damping = _Alternative("local damping", True, why, with_wave(experiment, damping=0.0), UNDAMPED)
    why = (
        "the configuration sets a wall with friction"
        if wall
        else "disks with prescribed motion neither slip nor rotate"
    )
    transmitter = with_wave(experiment, transmitter="driven" if wall else "wall")
    driven = _Alternative("driven disks", not wall, why, transmitter)
    return [*_displacements(experiment), _whole_domain(experiment), early, precision, bonds, damping, driven]


def _displacements(experiment: Experiment) -> list[_Alternative]:
    """Alternatives of displacements and contact laws."""
    regime, slip, turns = experiment.wave.regime, "slip, opening and Hertz stiffening", "new normals and overlaps"
    if regime != "linear":
        why = f'the configuration sets regime = "{regime}"'
        return [
            _Alternative(slip, needed=True, why=why, opposite=None),
            _Alternative(turns, needed=regime == "finite", why=why, opposite=None),
        ]
    tiny = "the pulse moves the grains by much less than their overlaps"
    small, finite = (with_wave(experiment, regime=other) for other in ("small", "finite"))
    search = with_wave(finite, keep=("search",))
    return [
        _Alternative(slip, False, f"{tiny}, so contacts keep their stiffness", small, "regime small"),
        _Alternative(turns, False, f"{tiny} and radii", finite, "regime finite"),
        _Alternative("contact search", False, f"{tiny}, so no new contacts form", search),
    ]


def _whole_domain(experiment: Experiment) -> _Alternative:
    """Alternative for disks deep in the damping layers or without a contact."""
    wave, packing = experiment.wave, experiment.packing
    share = 1.0 - len(domain_of(packing, wave, experiment.installation).packing.x) / len(packing.x)
    if share == 0.0:
        why = "the layers at floor and lid are thin or damp by less than 1, or the sample settles as a whole"
        return _Alternative("disks out of reach", needed=True, why=why, opposite=None)
    why = f"{share:.0%} of the disks lie deep in the damping layers or have no contacts: no signal reaches them"
    return _Alternative("disks out of reach", False, why, with_wave(experiment, keep=(*wave.keep, WHOLE_DOMAIN)))
