"""What the scenes of a campaign need, what is left out of them, and what leaving it out saves and costs.

Nothing here is taken on trust: each row is a measurement of the same cells with and without. Beside it stands the error
of both ways against a converged reference, where `calcidem accuracy` has measured that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from calcidem.app.studies.accuracy.findings import MeasuredErrors
from calcidem.app.studies.accuracy.reference import measure_and_time
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED, with_wave
from calcidem.app.studies.accuracy.study import ROUNDS
from calcidem.dem.wave.domain import domain_of
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement
from calcidem.dem.wave.rule import WHOLE_DOMAIN


@dataclass(frozen=True, slots=True)
class Alternative:
    """Something that the kernel does or leaves out, and the experiment that does the opposite.

    Attributes
    ----------
    what
        Its name.
    needed
        Whether the campaign does it.
    why
        Why it is needed, or why it is safe to leave it out.
    opposite
        The experiment with it if it is left out, without it if it is needed; None if there is no such thing.
    setting
        Name of the opposite among the settings of `calcidem accuracy`, empty if it is none of them.
    """

    what: str
    needed: bool
    why: str
    opposite: Experiment | None
    setting: str = ""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One row for one content.

    Attributes
    ----------
    content
        Percent of the sand's mass.
    alternative
        What is explained.
    time_ratio
        Processor time of the opposite over that of the campaign's own way, median of interleaved rounds.
    difference
        Largest relative difference in Vs between the two; None if no cell has a velocity both ways.
    error, other_error
        Largest relative error of Vs against a converged reference, the campaign's own way and the other; None where it
        has not been measured.
    """

    content: float
    alternative: Alternative
    time_ratio: float | None
    difference: float | None
    error: float | None = None
    other_error: float | None = None


def explain(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    lanes: int,
    measured: MeasuredErrors | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Explanation]:
    """Measure what each alternative saves and costs.

    Parameters
    ----------
    experiment
        Of the campaign.
    contents, seeds
        Cells to measure; at most ``lanes`` seeds, which share a batch.
    lanes
        Width of the kernel.
    measured
        Errors against a converged reference.
    progress
        Told what is being measured.
    """
    rows = []
    for content in contents:
        for alternative in _alternatives_of(experiment, content):
            progress(f"{content:g} %: {alternative.what}")
            rows.append(_with_errors(_measure_alternative(experiment, alternative, content, seeds, lanes), measured))
    return rows


def _with_errors(row: Explanation, measured: MeasuredErrors | None) -> Explanation:
    """Row with the errors of both ways, if they were measured."""
    if measured is None or not row.alternative.setting:
        return row
    own = measured.of(DEFAULT, row.content)
    return replace(row, error=own, other_error=measured.of(row.alternative.setting, row.content))


def _alternatives_of(experiment: Experiment, content: float) -> list[Alternative]:
    """What can be said about the scenes of one content."""
    found = [*_displacement_alternatives(experiment), _whole_domain(experiment)]
    found += [_early_stop(experiment), _precision(experiment)]
    bonds = None if content > 0.0 else with_wave(experiment, keep=("bonds",))
    why = "no contact is cemented" if bonds else "some contacts are cemented"
    found.append(Alternative("bonds", needed=content > 0.0, why=why, opposite=bonds))
    return [*found, _local_damping(experiment), _wall_or_disks(experiment)]


def _displacement_alternatives(experiment: Experiment) -> list[Alternative]:
    """How displacements and contact laws are treated."""
    wave = experiment.wave
    if wave.regime != "linear":
        why = f'the configuration asks for regime = "{wave.regime}"'
        return [
            Alternative("slip, opening and Hertz stiffening", needed=True, why=why, opposite=None),
            Alternative("new normals and overlaps", needed=wave.regime == "finite", why=why, opposite=None),
        ]
    small = "the pulse moves the grains by a small part of their overlaps"
    finite = with_wave(experiment, regime="finite")
    return [
        Alternative(
            "slip, opening and Hertz stiffening",
            needed=False,
            why=f"{small}, so contacts keep their stiffness",
            opposite=with_wave(experiment, regime="small"),
            setting="regime small",
        ),
        Alternative(
            "new normals and overlaps",
            needed=False,
            why=f"{small}, and far less of the radii",
            opposite=finite,
            setting="regime finite",
        ),
        Alternative(
            "contact search",
            needed=False,
            why=f"{small}, so no new contacts form",
            opposite=with_wave(finite, keep=("search",)),
        ),
    ]


def _whole_domain(experiment: Experiment) -> Alternative:
    """Disks deep in the damping layers, and disks without a contact."""
    wave, packing = experiment.wave, experiment.packing
    share = 1.0 - len(domain_of(packing, wave, experiment.installation).packing.x) / len(packing.x)
    if share == 0.0:
        why = "the layers at floor and lid are thin or damp by less than 1, or the sample settles as a whole"
        return Alternative("disks out of reach", needed=True, why=why, opposite=None)
    return Alternative(
        "disks out of reach",
        needed=False,
        why=f"{share:.0%} of the disks lie deep in the damping layers or touch nothing: no signal gets there",
        opposite=with_wave(experiment, keep=(*wave.keep, WHOLE_DOMAIN)),
    )


def _local_damping(experiment: Experiment) -> Alternative:
    """Local damping of the sample, which slows the front of a wave (docs/accuracy.md)."""
    alpha = experiment.wave.damping
    if alpha == 0.0:
        return Alternative("local damping", needed=False, why="alpha of the sample is 0", opposite=None)
    why = f"alpha of the sample is {alpha:g}: without it Vs is another one"
    return Alternative("local damping", True, why, with_wave(experiment, damping=0.0), UNDAMPED)


def _wall_or_disks(experiment: Experiment) -> Alternative:
    """Disks that the pulse drives, instead of a wall that rubs along them."""
    wall = experiment.wave.transmitter == "wall"
    why = "the configuration asks for a wall that rubs" if wall else "disks that are driven neither slip nor spin"
    return Alternative("driven disks", not wall, why, with_wave(experiment, transmitter="driven" if wall else "wall"))


def _early_stop(experiment: Experiment) -> Alternative:
    """The steps after the pick is settled."""
    why = "the reading looks no further than its horizon, so more steps change no bit of it"
    return Alternative(
        "steps after the pick",
        needed=False,
        why=why,
        opposite=replace(experiment, early_stop=not experiment.early_stop),
        setting=f"early_stop {not experiment.early_stop}",
    )


def _precision(experiment: Experiment) -> Alternative:
    """Single or double precision."""
    double = experiment.wave.precision == "float64"
    other = with_wave(experiment, precision="float32" if double else "float64")
    why = f"the configuration asks for {experiment.wave.precision}"
    setting = f"precision {other.wave.precision}"
    return Alternative("double precision", needed=double, why=why, opposite=other, setting=setting)


def _measure_alternative(
    experiment: Experiment, alternative: Alternative, content: float, seeds: Sequence[int], lanes: int
) -> Explanation:
    """Measure one alternative on one content."""
    if alternative.opposite is None:
        return Explanation(content, alternative, None, None)
    own_seconds, other_seconds = [], []
    own: tuple[Measurement, ...] = ()
    other: tuple[Measurement, ...] = ()
    for _ in range(ROUNDS):
        own, seconds = measure_and_time(experiment, content, seeds, lanes)
        own_seconds.append(seconds)
        other, seconds = measure_and_time(alternative.opposite, content, seeds, lanes)
        other_seconds.append(seconds)
    differences = [
        abs(b.vs / a.vs - 1.0) for a, b in zip(own, other, strict=True) if a.vs is not None and b.vs is not None
    ]
    ratio = median(np.array(other_seconds) / np.array(own_seconds))
    return Explanation(content, alternative, float(ratio), max(differences, default=None))
