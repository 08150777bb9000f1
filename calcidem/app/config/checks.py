"""Checks across sections: whether the parts of a configuration match each other and its packing."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calcidem.app.config.errors import ConfigurationError, Problem, quote
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.judgement import expected_overlap, judge_disks, judge_stress
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import refuse_unfit_pulse, refuse_unfit_samples
from calcidem.dem.wave.pulse import cutoff_frequency
from calcidem.dem.wave.rule import FEWEST_SAMPLES, refuse_long_stroke
from calcidem.dem.wave.scene import DEEPEST_LISTENING, driven_disks, listening_disks, wave_scene
from calcidem.storage.errors import StoreError
from calcidem.storage.sql.engine import Address

_SEEDS_ASKED_FIRST = 8

_MOST_DISKS = 10_000_000
"""Largest number of disks; they need some 10 GB during packing."""

_SHORT_WAVE = 0.5
"""Frequency over the cut-off at which a chain propagates waves at ``sin(x) / x = 0.95`` of the long-wave velocity."""

_BARE_STEP, _CEMENTED_STEP = 1.2, 1.7
"""Largest step limit over that of mean disks: up to 1.08 without cement and 1.61 with it, in 24 packings."""

_OVERLAPS_VARY = 1.5
"""Factor above the mean overlap of packings over the expected one, 0.7 to 1.2, so that later checks would refuse, too.
"""

_SAFE_PART = 0.8
"""Part of the largest content of these seeds that every other seed can certainly hold."""


def cross_check(configuration: Configuration) -> list[Problem]:
    """All contradictions of a configuration."""
    checks = (
        _check_size,
        _check_stress,
        _check_cement,
        _check_bands,
        _check_installation,
        _check_friction,
        _check_frequencies,
        _check_amplitude,
        _check_files,
        _check_part,
    )
    return [problem for check in checks for problem in check(configuration)]


def _check_part(configuration: Configuration) -> Iterator[Problem]:
    """Refuse parts with `until`, since parts are assigned before the numbers of seeds are known."""
    if configuration.run.part is not None and configuration.campaign.until is not None:
        yield Problem(
            f"run.part = {quote(configuration.run.part)}: campaign.until adds seeds during the run, which parts do not "
            "share; leave one of the two out",
            ("run.part", "campaign.until"),
        )


def _check_size(configuration: Configuration) -> Iterator[Problem]:
    """Refuse more disks than memory can hold."""
    rule = configuration.packing
    disks = disks_in_box(configuration)
    if disks > _MOST_DISKS:
        yield Problem(
            f"packing.width = {rule.width}: {disks:.3g} disks fit into the box of {rule.width} m x {rule.height} m, "
            f"more than {_MOST_DISKS:g}; make the box smaller, or packing.diameter larger",
            ("packing.width", "packing.height", "packing.diameter", "packing.porosity"),
        )


def disks_in_box(configuration: Configuration) -> float:
    """Number of disks of uniformly distributed diameters, from the porosity of the box."""
    rule = configuration.packing
    smallest, largest = rule.diameter
    area = np.pi / 12.0 * (smallest**2 + smallest * largest + largest**2)
    return float((1.0 - rule.porosity) * rule.width * rule.height / area)


def _check_stress(configuration: Configuration) -> Iterator[Problem]:
    """Refuse a stress that would crush the disks; for disks of a file the packing is checked later."""
    rule = configuration.packing
    if configuration.packing_draw.file is not None:
        return
    if fault := judge_stress(rule.stress, sum(rule.diameter) / 2.0, configuration.sand):
        yield Problem(f"packing.{fault.text}", ("packing.stress", "packing.diameter", "sand.shear_modulus"))


def _check_cement(configuration: Configuration) -> Iterator[Problem]:
    """Refuse cement wider than the smallest disk, and clusters larger than the box."""
    smallest = configuration.packing.diameter[0]
    for name in ("p_diameter", "c_diameter"):
        width = getattr(configuration.pattern, name)
        if width >= smallest:
            yield Problem(
                f"pattern.{name} = {width}: the cement is wider than the smallest disk, "
                f"packing.diameter[0] = {smallest}; make it narrower",
                (f"pattern.{name}", "packing.diameter"),
            )
    box = min(configuration.packing.width, configuration.packing.height)
    for name, what in (("cluster_diameter", "cluster"), ("p_patch_diameter", "patch of P")):
        diameter = getattr(configuration.pattern, name)
        if diameter >= box:
            yield Problem(
                f"pattern.{name} = {diameter}: a {what} is larger than the box, {box} m; make it smaller",
                (f"pattern.{name}", "packing.width", "packing.height"),
            )


def _check_bands(configuration: Configuration) -> Iterator[Problem]:
    """Check that transmitter, receiver and damped layers fit into the sample."""
    half = configuration.packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width", "boundary_thickness"):
        value = getattr(configuration.wave, name)
        if value >= half:
            yield Problem(
                f"wave.{name} = {value}: does not fit into the sample; give less than half of packing.height, {half} m",
                (f"wave.{name}", "packing.height"),
            )
    smallest = 0.5 * configuration.packing.diameter[0]
    for name in ("transmitter_half_width", "receiver_half_width"):
        value = getattr(configuration.wave, name)
        if value < smallest:
            yield Problem(
                f"wave.{name} = {value}: narrower than a grain; give at least the smallest radius, {smallest:.4g} m",
                (f"wave.{name}", "packing.diameter"),
            )
    depth, width = configuration.wave.listening_depth, configuration.packing.width
    largest = configuration.packing.diameter[1]
    deepest = DEEPEST_LISTENING * width
    if not largest < depth <= deepest:
        yield Problem(
            f"wave.listening_depth = {depth}: has to hold disks that do not touch the receiver; give more than the "
            f"largest diameter, {largest} m, and at most {DEEPEST_LISTENING:g} of packing.width, {deepest:.4g} m",
            ("wave.listening_depth", "packing.width", "packing.diameter"),
        )


def _check_installation(configuration: Configuration) -> Iterator[Problem]:
    """Check that bonds which change the contact forces have a regime with changing forces."""
    installation = configuration.bonding.installation
    if installation != "preserve" and configuration.wave.regime == "linear":
        yield Problem(
            f'cement.installation = "{installation}": changes the contact forces, which wave.regime = "linear" '
            'keeps constant; choose wave.regime = "small" or "finite"',
            ("cement.installation", "wave.regime"),
        )
    if installation == "pfc_absolute" and configuration.cement.linear_modulus == 0.0:
        yield Problem(
            'cement.installation = "pfc_absolute": it is the linear group that jumps, and there is none; '
            "give cement.linear_modulus in Pa",
            ("cement.installation", "cement.linear_modulus"),
        )


def _check_friction(configuration: Configuration) -> Iterator[Problem]:
    """Refuse a friction with which contacts slip before the wave, except in the linear regime."""
    friction, prepared = configuration.sand.friction, configuration.packing.friction_preparation
    if friction < prepared and configuration.wave.regime != "linear":
        yield Problem(
            f"sand.friction = {friction:g}: less than packing.friction_preparation = {prepared:g}, so that contacts at "
            "rest slip as soon as the wave is computed; give as much or more, or prepare with less",
            ("sand.friction", "packing.friction_preparation", "wave.regime"),
        )


def _check_frequencies(configuration: Configuration) -> Iterator[Problem]:
    """Check that every content has a frequency that propagates and that the time step resolves."""
    table = configuration.excitation.table
    if table is None:
        return
    contents = configuration.campaign.contents
    outside = [content for content in contents if not table.covers(content)]
    if outside:
        yield Problem(
            f"campaign.contents = {quote(outside)}: the excitation frequencies are known from {table.content[0]:g} to "
            f"{table.content[-1]:g} % only; give wave.frequency for these contents",
            ("campaign.contents", "wave.frequency"),
        )
    for content in contents:
        limit = cutoff_estimate(configuration, cemented=content > 0.0)
        if table.covers(content) and table.at(content) > limit:
            yield Problem(
                f"wave.frequency = {table.at(content):g}: at {content:g} % waves do not propagate above about "
                f"{limit:.3g} Hz (lattice cut-off); give at most half of that",
                ("wave.frequency", "campaign.contents", "sand.shear_modulus", "cement.bond_modulus"),
            )
            return
        resolved = 1.0 / (FEWEST_SAMPLES * configuration.wave.step_fraction * _longest_step(configuration, content))
        if table.covers(content) and table.at(content) > resolved:
            yield Problem(
                f"wave.frequency = {table.at(content):g}: at {content:g} % the pulse has fewer than {FEWEST_SAMPLES} "
                f"time steps, far above its cut-off; give at most {resolved:.2g} Hz",
                ("wave.frequency", "campaign.contents", "wave.step_fraction", "sand.shear_modulus"),
            )
            return


def _check_amplitude(configuration: Configuration) -> Iterator[Problem]:
    """Check that the regime suits the pulse, as far as known without a packing."""
    rule, table = configuration.packing, configuration.excitation.table
    if table is None:
        return
    diameter = float(np.mean(rule.diameter))
    overlap = 0.5 * diameter * expected_overlap(rule.stress, diameter, configuration.sand)
    lowest = min(table.at(content) for content in configuration.campaign.contents)
    try:
        refuse_long_stroke(configuration.wave, lowest, _OVERLAPS_VARY * overlap, 0.5 * diameter)
    except ValueError as error:
        yield Problem(f"wave.{error}", ("wave.amplitude", "wave.regime", "wave.frequency", "packing.stress"))


def _longest_step(configuration: Configuration, content: float) -> float:
    """Stability limit, s, that the step of a sample hardly exceeds; at low contents few contacts are cemented."""
    if content == 0.0:
        return _BARE_STEP * limit_of_mean_disks(configuration, cemented=False)
    few = content <= 2.0 * configuration.pattern.threshold
    return _CEMENTED_STEP * limit_of_mean_disks(configuration, cemented=True, single=few)


def limit_of_mean_disks(configuration: Configuration, *, cemented: bool, single: bool = False) -> float:
    """Stability limit of disks of the mean size, s, from a safe bound for each single disk.

    Their contacts are cemented or not. A disk has one contact if ``single``, and else the six of a hexagonal lattice.
    """
    diameter = float(np.mean(configuration.packing.diameter))
    normal, shear, twist = _contact_stiffness(configuration, cemented=cemented)
    turning = 2.0 * shear + 8.0 * twist / diameter**2  # of a rotation scaled by the radius over the root of 2
    stiffest = max(normal, shear + turning) if single else 6.0 * max(0.5 * (normal + shear), turning)
    wave = configuration.wave
    damping = max(wave.damping, wave.boundary_damping if wave.boundary_thickness > 0.0 else 0.0)
    mass = configuration.sand.density * np.pi * diameter**2 / 4.0
    return float(2.0 / np.sqrt(2.0 * stiffest / mass * (1.0 + damping)))


def _contact_stiffness(configuration: Configuration, *, cemented: bool) -> tuple[float, float, float]:
    """Normal, shear (N/m) and rotational (N m) stiffness of a contact of mean disks under the stress."""
    diameter = float(np.mean(configuration.packing.diameter))
    radius = np.array([diameter / 2.0])
    if cemented:
        normal, shear, twist = configuration.cement.bond_stiffness(radius, radius)[0].tolist()
        more_normal, more_shear = configuration.cement.linear_stiffness(radius, radius)[0].tolist()
        return normal + more_normal, shear + more_shear, twist
    sand, stress = configuration.sand, configuration.packing.stress
    overlap = 0.5 * diameter * expected_overlap(stress, diameter, sand)
    normal = 1.5 * stress * diameter / overlap * configuration.calibration.wave_stiffness_factor
    return normal, normal * sand.shear_ratio, 0.0


def cutoff_estimate(configuration: Configuration, *, cemented: bool) -> float:
    """Frequency above which no sample propagates waves, Hz: cut-off of a hexagonal lattice of mean disks.

    Its shear waves have ``V^2 = 3/8 (k_n + k_s) d^2 / m``, as a chain with the contact stiffness ``3/8 (k_n + k_s)``.
    All contacts are cemented or none, each with the force ``stress d``. Real packings have fewer contacts and are
    softer, so refused frequencies certainly fail.
    """
    diameter = float(np.mean(configuration.packing.diameter))
    mass = configuration.sand.density * np.pi * diameter**2 / 4.0
    normal, shear, _ = _contact_stiffness(configuration, cemented=cemented)
    return cutoff_frequency(3.0 / 8.0 * (normal + shear), mass)


def _check_files(configuration: Configuration) -> Iterator[Problem]:
    """Check that results can be written."""
    output = configuration.output
    wrong = ""
    if os.path.exists(output) and not output.is_dir():  # noqa: PTH110 - Path.exists raises where a name is too long
        wrong = "is a file; give the name of a folder"
    elif not can_make_files(output):
        wrong = "nothing can be written there; give a folder in which you may write"
    if wrong:
        yield Problem(f"run.output = {quote(str(output))}: {wrong}", ("run.output",))
    database = configuration.run.database
    if database is not None and (wrong := _what_is_wrong_with(database)):
        yield Problem(f"run.database = {quote(database)}: {wrong}", ("run.database",))


def _what_is_wrong_with(database: str) -> str:
    """Reason why results cannot be stored in a database, with a remedy; empty if they can."""
    try:
        path = Address.parse(database).path
    except StoreError as error:
        return str(error)
    if path is None:
        return ""
    if path.is_dir():
        return "is a folder; give a file name"
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        return "the file cannot be written; give one that you may write, or change its permissions"
    if not can_make_files(path.parent):
        return "its folder cannot be written; give a file in a folder in which you may write"
    return ""


def can_make_files(folder: Path) -> bool:
    """Whether files can be made in a folder, or, if it does not exist yet, in its first existing parent.

    This is tried with a file without name, since permissions do not show read-only file systems.
    """
    try:
        existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
        with tempfile.TemporaryFile(dir=existing):
            return True
    except OSError:  # also for a name that is too long
        return False


def check_against_packing(configuration: Configuration, packing: Packing) -> list[str]:
    """Refuse a plan that the packing cannot hold; return warnings about the packing and its waves, a sentence each.

    `ConfigurationError` with all problems.
    """
    faults = judge_disks(packing, configuration.sand)
    problems = [Problem(f"packing.{fault.text}") for fault in faults if fault.refused]
    if problems:
        raise ConfigurationError("configuration", problems)
    experiment, plan = configuration.experiment(packing), configuration.campaign
    try:
        wave_scene(packing, configuration.sand, configuration.wave, None)
        listening_disks(packing, configuration.wave)
        driven_disks(packing, configuration.wave)
    except ValueError as error:
        problems.append(Problem(f"wave.{error}"))
    for content in () if problems else plan.contents:
        try:
            refuse_unfit_pulse(experiment, experiment.frequency(content), cemented=content > 0.0)
        except ValueError as error:
            problems.append(Problem(f"at {content:g} % wave.{error}"))
            break
    seed, room = _tightest_seed(experiment, plan.seed_numbers, max(plan.contents))
    if max(plan.contents) > room:
        limit = f"the packing holds at most {room:.4g} % of calcite (seed {seed})"
        problems.append(Problem(f"campaign.contents = {quote(plan.contents)}: {limit}; leave larger contents out"))
    elif not problems:
        problems += _sample_problems(configuration, experiment)
    if problems:
        raise ConfigurationError("configuration", problems)
    doubts = [f"packing.{fault.text}" for fault in faults]
    cutoff = cutoff_estimate(configuration, cemented=False)
    frequency = experiment.frequency(0.0) if 0.0 in plan.contents else 0.0
    if frequency > _SHORT_WAVE * cutoff:
        doubts.append(
            f"wave.frequency = {frequency:g}: at 0 % a wavelength has fewer than {np.pi / _SHORT_WAVE:.0f} grains, "
            f"and dispersion slows the wave by 4 % and more; give at most {_SHORT_WAVE * cutoff:.2g} Hz"
        )
    return doubts


def _sample_problems(configuration: Configuration, experiment: Experiment) -> list[Problem]:
    """Problems of samples of the first seeds that would be refused before their wave."""
    plan, lanes = configuration.campaign, configuration.run.lanes
    orderings = [experiment.ordering(seed) for seed in plan.seed_numbers[:lanes]]
    for content in sorted(plan.contents):
        try:
            refuse_unfit_samples(experiment, content, orderings, lanes)
        except ValueError as error:
            return [Problem(f"at {content:g} % wave.{error}")]
    return []


def _tightest_seed(experiment: Experiment, seeds: Sequence[int], content: float) -> tuple[int, float]:
    """Seed whose sample holds the least calcite, and this content, percent.

    For a content far from this limit the first seeds suffice, since drawing the cement of thousands of seeds is slow.
    """
    few = seeds[:_SEEDS_ASKED_FIRST]
    room = {seed: experiment.ordering(seed).maximum_content for seed in few}
    if content > _SAFE_PART * min(room.values()):
        room |= {seed: experiment.ordering(seed).maximum_content for seed in seeds[_SEEDS_ASKED_FIRST:]}
    tightest = min(room, key=lambda seed: room[seed])
    return tightest, room[tightest]
