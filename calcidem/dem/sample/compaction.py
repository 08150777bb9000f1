"""Packing by radius expansion in a box and compression by a servo-controlled lid (section 2.2.2 of the paper).

The radii grow stepwise to the initial porosity; then the lid applies its stress, and the right side its own if a ratio
of stresses is asked for. Both follow the PFC manual (radius
expansion, wall servo). Disks come to rest by the explicit scheme of Cundall and Strack (1979,
doi:10.1680/geot.1979.29.1.47) with local damping. Cemented samples settle alike, after the installation of bonds has
changed their forces.
Own disks of a CSV file are pressed alike; packings are exported as such files.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from time import perf_counter

import numpy as np

from calcidem.dem.engine.assembly import Assembly
from calcidem.dem.engine.leapfrog import State, duplicate, halt, no_recording, run_in_place
from calcidem.dem.engine.readout import contact_forces, overlaps, unbalanced_ratio, wall_overlaps, wall_reactions
from calcidem.dem.engine.scene import Preload, Sand, Scene, Wall
from calcidem.dem.engine.stability import critical_time_step, critical_time_step_of_disks, scaled_densities
from calcidem.dem.engine.state import SAFETY, SKIN, UnstableRunError, advance, choose_features, start, step_limit
from calcidem.dem.kernels.layout import NORMAL_PATH, Features, Floats, Integers
from calcidem.dem.sample.packing import (
    LARGEST_OVERLAP,
    LID,
    RIGHT,
    Packing,
    PackingError,
    PackingFileError,
    PackingReport,
    PackingRule,
    PackingStage,
    overlapping_pairs,
)
from calcidem.input_file import MOST_BYTES, Table, read_input, unit_in_name, value_of

_FILLING_RATIO = 1e-2  # unbalanced-force ratio at which the lid may start to press
_STRESS_TOLERANCE = 1e-3  # relative deviation of the stress on a pressing wall; ten times finer than promised


@dataclass(frozen=True, slots=True)
class _Manner:
    """Settings for bringing disks to rest."""

    steps: int = 400
    """Steps between two checks of the step limit and the unbalanced-force ratio."""
    fraction: float = 0.95
    """Step over its limit at the present overlaps."""
    skin: float = 0.25
    """Largest gap of listed pairs over the mean radius: large for flying disks, small for disks near rest."""
    steps_per_contact: float = 0.0
    """As in `start`: enough for impacts that damping ends, or 0."""
    apart: float = 0.0
    """Largest overlap over smallest radius at which the next radius step may start, since a loose gas of disks never
    balances; 0 while the lid presses.
    """
    halted: bool = False
    """Disks are halted at every check."""
    scaled: bool = False
    """Stiff disks become heavier, see `scaled_densities`. Under the lid this ends two decades of the unbalanced-force
    ratio above rest: there contacts stop sliding, and with other masses fewer of them do.
    """


_HALTED = _Manner(steps=100, fraction=0.9, skin=1.0, apart=1e-2, halted=True, scaled=True)
_FLYING = _Manner(steps=200, fraction=0.9, skin=1.0, apart=1e-3)
_CRUSHED = replace(_FLYING, steps=400, skin=0.7)
_PRESSED = _Manner(scaled=True)
OWN_DISKS = _Manner(fraction=0.8, skin=SKIN, steps_per_contact=4.0)
"""For imported disks, which may barely touch."""


@dataclass(slots=True)
class Cost:
    """Steps, wall time and radius step so far; reported to the watcher after every chunk."""

    steps: int = 0
    began: float = field(default_factory=perf_counter)
    watch: Callable[[PackingStage], None] = lambda _: None
    expansion_step: int = 0
    expansion_steps: int = 0

    def report(self, rule: PackingRule, ratios: list[float]) -> None:
        """Tell the watcher the progress, from the unbalanced-force ratios in the present stage."""
        lowest = min(_FILLING_RATIO, max(min(ratios, default=math.inf), rule.unbalanced_force_ratio))
        pressed = math.log(_FILLING_RATIO / lowest) / math.log(_FILLING_RATIO / rule.unbalanced_force_ratio)
        expansion = 0.3 if self.expansion_steps else 0.0  # share of the total time with 4,700 disks
        if self.expansion_step <= self.expansion_steps:
            fraction = expansion * (self.expansion_step - 1) / self.expansion_steps
        else:
            fraction = expansion + (1.0 - expansion) * pressed
        self.watch(PackingStage(self.expansion_step, self.expansion_steps, self.steps, fraction))


def make_packing(
    rule: PackingRule,
    sand: Sand,
    generator: np.random.Generator,
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Make a packing: sizes, loose placement, stepwise expansion, pressing by the lid.

    `PackingError` if it does not come to rest in ``rule.most_steps`` steps, or disks leave the box at any time step.

    Parameters
    ----------
    rule
        Rule of the packing.
    sand
        Material; the friction of preparation replaces its own during packing.
    generator
        Source of sizes and positions.
    raise_if_stopped
        Called every fraction of a second; may raise to end the work.
    watch
        Called as often with the progress.
    """
    cost = Cost(watch=watch, expansion_steps=rule.expansion_steps)
    radius = _draw_radii(rule, generator)
    slippery = replace(sand, friction=rule.friction_preparation)
    # Random sequential placement of equal disks jams at an area fraction of 0.547 (Hinrichsen, Feder and Jossang 1986,
    # doi:10.1007/BF01011908) and is slow near it.
    loose = float(np.sqrt(0.35 * rule.width * rule.height / (np.pi * np.sum(radius**2))))
    x, y = _place_apart(rule, radius * loose, generator)
    preload: Preload | None = None
    for factor in np.linspace(loose, 1.0, rule.expansion_steps + 1)[1:]:
        cost.expansion_step += 1
        scene = Scene(x, y, radius * factor, slippery, box_walls(rule.width, rule.height), damping=rule.damping)
        covered = (1.0 - rule.porosity) * _square(float(factor))
        manner = _HALTED if covered < 0.547 else _FLYING if cost.expansion_step < rule.expansion_steps else _CRUSHED
        state = relax(scene, preload, rule, cost, raise_if_stopped, manner)
        x, y, preload = _found(state)
    cost.expansion_step += 1
    scene = Scene(x, y, radius, slippery, box_walls(rule.width, rule.height), damping=rule.damping)
    return press(scene, preload, rule, cost, raise_if_stopped)


def press(
    scene: Scene,
    preload: Preload | None,
    rule: PackingRule,
    cost: Cost,
    raise_if_stopped: Callable[[], None],
    manner: _Manner = _PRESSED,
) -> Packing:
    """Packing of disks in a box under the stresses of a rule; `PackingError` as of `relax`."""
    box = _size_of(scene)
    while True:
        walls = box_walls(*box, rule.stress, rule.lateral_stress_ratio)
        state = relax(replace(scene, walls=walls), preload, rule, cost, raise_if_stopped, manner)
        held, box = box, _size_of(state.scene, state)
        # The walls hold forces, those of the stresses on the box before it gave way.
        apart = max(abs(before / after - 1.0) for before, after in zip(held, box, strict=True))
        if rule.lateral_stress_ratio is None or apart < _STRESS_TOLERANCE:
            return _packing_at_rest(state, rule, cost)
        x, y, preload = _found(state)
        scene = replace(scene, x=x, y=y)


def _found(state: State) -> tuple[Floats, Floats, Preload]:
    """Positions and shear forces with which another scene goes on."""
    x, y = state.position().T
    contacts = contact_forces(state)
    return x, y, Preload(contacts.pairs, contacts.shear)


def _draw_radii(rule: PackingRule, generator: np.random.Generator) -> Floats:
    """Radii of disks that fill the box to the porosity, slightly scaled to make their area exact."""
    area = (1.0 - rule.porosity) * rule.width * rule.height
    low, high = rule.diameter[0] / 2.0, rule.diameter[1] / 2.0
    mean_area = np.pi * (low * low + low * high + high * high) / 3.0
    radius = low + (high - low) * generator.random(round(area / mean_area))
    # The scale differs from 1 by the sampling error of the summed area, about 1e-3.
    scale = float(np.sqrt(area / (np.pi * np.sum(radius**2))))
    return scale * radius


def _place_apart(rule: PackingRule, radius: Floats, generator: np.random.Generator) -> tuple[Floats, Floats]:
    """Random positions without overlaps, by random sequential placement on a grid of cells."""
    cell = 2.0 * float(radius.max())
    columns, rows = int(rule.width / cell) + 1, int(rule.height / cell) + 1
    cells: dict[tuple[int, int], list[int]] = {}
    radii: list[float] = radius.tolist()  # NumPy scalars are three times slower
    x, y = [0.0] * len(radii), [0.0] * len(radii)
    for disk in np.argsort(-radius, kind="stable").tolist():
        own = radii[disk]
        for _ in range(10_000):
            # Not `Generator.uniform`, which a compiler may contract.
            px = own + (rule.width - own - own) * generator.random()
            py = own + (rule.height - own - own) * generator.random()
            column, row = int(px / cell), int(py / cell)
            near = [
                other
                for a in range(max(0, column - 1), min(columns, column + 2))
                for b in range(max(0, row - 1), min(rows, row + 2))
                for other in cells.get((a, b), ())
            ]
            if all(_square(px - x[o]) + _square(py - y[o]) >= _square(own + radii[o]) for o in near):
                break
        else:
            raise PackingError(f"no room for disk {disk}: raise the porosity or enlarge the box")
        x[disk], y[disk] = px, py
        cells.setdefault((column, row), []).append(disk)
    return np.array(x), np.array(y)


def _square(value: float) -> float:
    """Square, rounded once; ``**`` would call the C library."""
    return value * value


def box_walls(
    width: float, height: float, stress: float | None = None, lateral_ratio: float | None = None
) -> tuple[Wall, ...]:
    """Four frictionless walls; servos hold the stress, Pa, on the lid and its ratio on the right side, if given."""
    lid = None if stress is None else stress * width
    side = None if stress is None or lateral_ratio is None else lateral_ratio * stress * height
    return (
        Wall((0.0, 0.0), (1.0, 0.0)),
        Wall((width, 0.0), (-1.0, 0.0), servo_force=side, servo_gain=0.9),
        Wall((0.0, 0.0), (0.0, 1.0)),
        Wall((0.0, height), (0.0, -1.0), servo_force=lid, servo_gain=0.9),
    )


def _size_of(scene: Scene, state: State | None = None) -> tuple[float, float]:
    """Width and height of a box; given a state, those after the motion of its walls."""
    right, lid = (0.0, 0.0) if state is None else state.assembly.walls.motion[[RIGHT, LID], NORMAL_PATH, 0].tolist()
    return scene.walls[RIGHT].point[0] - right, scene.walls[LID].point[1] - lid


def relax(
    scene: Scene,
    preload: Preload | None,
    rule: PackingRule,
    cost: Cost,
    raise_if_stopped: Callable[[], None],
    manner: _Manner = _PRESSED,
) -> State:
    """Bring a scene to rest; `PackingError` if it does not come to rest or blows up."""
    state = start(
        scene,
        # One kernel serves filling and compression: an unloaded box has an idle servo.
        features=replace(choose_features(scene, "finite"), servo=True, midpoint=False),
        preload=preload,
        skin_fraction=manner.skin,
        steps_per_contact=manner.steps_per_contact,
    )
    ratios: list[float] = []
    limit: Floats | None = None
    # Loose disks of a file are compressed to a porosity of about 0.2, however high they were.
    width, height = _size_of(scene)
    at_rest = float(np.pi * np.sum(np.asarray(scene.radius) ** 2)) / (0.8 * width) if manner is OWN_DISKS else height
    box = width, min(height, at_rest)
    cost.report(rule, ratios)
    while True:
        raise_if_stopped()
        try:
            unrest = min(ratios, default=math.inf) / rule.unbalanced_force_ratio
            state, limit = _advance_to_look(state, manner, unrest, limit)
        except UnstableRunError as error:
            cure = "lower stress, raise damping, or move your own disks apart"
            raise PackingError(f"while the disks came to rest, {str(error).rsplit(': ', 1)[0]}: {cure}") from error
        cost.steps += manner.steps
        ratio = unbalanced_ratio(state)
        ratios.append(ratio)
        cost.report(rule, ratios)
        if cost.steps > rule.most_steps:
            cure = "raise most_steps, damping or porosity" if manner.apart else _cure_of_unrest(state, rule, ratios)
            raise PackingError(
                f"the packing is not at rest after {cost.steps} steps (unbalanced-force ratio {ratio:.2g}): {cure}"
            )
        if manner.apart:
            if ratio < _FILLING_RATIO or overlaps(state).max(initial=0.0) < manner.apart * scene.radius.min():
                return state
        elif ratio < rule.unbalanced_force_ratio and _stress_apart(state) < _STRESS_TOLERANCE:
            return state
        sizes = zip(_size_of(scene, state), box, (width, height), strict=True)
        if any(now < 0.8 * least or now > 1.2 * most for now, least, most in sizes):
            cures = ["more friction_preparation"]
            if rule.lateral_stress_ratio is not None:
                cures.append("a lateral_stress_ratio nearer to 1")
            if manner is not OWN_DISKS:
                cures.append("a porosity nearer to that at rest")
            raise PackingError(
                "the sample yields: a wall has moved by a fifth of the box under its stress; choose "
                f"{' or '.join(cures)}"
            )


def _advance_to_look(state: State, manner: _Manner, unrest: float, limit: Floats | None) -> tuple[State, Floats | None]:
    """State at the next check, with a step within the limit of its overlaps, and the limit there if known.

    If meanwhile overlaps have made the step too long, or disks have left the box, the steps are repeated with a shorter
    one. ``unrest`` is the unbalanced-force ratio over the one at rest, ``limit`` the step limit of ``state`` if known.
    """
    grains, scaled = state.assembly.grains, manner.scaled and unrest > 100.0  # see `_Manner`
    if scaled:
        # With a lower share of the squared frequency the mean disk becomes too heavy.
        heavier, limit = scaled_densities(*_present_contacts(state), 0.35)
        state = replace(state, assembly=replace(state.assembly, grains=heavier))
    elif limit is None:
        limit = step_limit(state)
    step = manner.fraction * limit
    later, found, shortened = advance(replace(state, time_step=step), manner.steps), None, 0
    while _left_box(later) or (
        manner is _PRESSED  # the bound of the step is a fifth below its limit
        and (step > 1.2 * (found := critical_time_step_of_disks(*_present_contacts(later), rings=scaled))).any()
    ):
        shortened += 1
        if shortened > 21:
            raise PackingError(
                f"disks leave the box at a step of {step.min():.3g} s, a hundredth of "
                "its bound: the stress is too high for this modulus; lower packing.stress or raise sand.shear_modulus"
            )
        step = 0.8 * step
        later = advance(replace(state, time_step=step), manner.steps)
    if manner.halted:
        later.motion.velocity[...] = 0.0
    return replace(later, assembly=replace(later.assembly, grains=grains)), None if scaled else found


def _left_box(state: State) -> bool:
    """Whether a disk's centre is behind a fixed wall, as happens when collisions make the step too long."""
    x, y = state.position().T
    standing = (wall for wall in state.scene.walls if wall.servo_force is None)
    return not all(bool((wall.distance(x, y) > 0.0).all()) for wall in standing)


def _present_contacts(state: State) -> tuple[Scene, Assembly, Features, Floats, Floats]:
    """Arguments of `critical_time_step_of_disks` for a state."""
    return state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state)


def _cure_of_unrest(state: State, rule: PackingRule, ratios: list[float]) -> str:
    """Remedy for a packing with these unbalanced-force ratios; more steps only if the ratio still decreases."""
    half = len(ratios) // 2
    if (apart := _stress_apart(state)) >= _STRESS_TOLERANCE:
        return f"a wall is {apart:.1%} off its part of stress = {rule.stress:g} Pa; raise most_steps or lower stress"
    if half and min(ratios[half:]) > 0.8 * min(ratios[:half]):
        return "raise damping or unbalanced_force_ratio; more steps will not help, since the ratio no longer falls"
    return "raise most_steps, damping or unbalanced_force_ratio"


def _stress_apart(state: State) -> float:
    """Largest relative departure of a servo's force from its target."""
    reactions = wall_reactions(state)[:, 0]
    return max(
        abs(float(found) / wall.servo_force - 1.0)
        for wall, found in zip(state.scene.walls, reactions, strict=True)
        if wall.servo_force is not None
    )


def _packing_at_rest(state: State, rule: PackingRule, cost: Cost) -> Packing:
    """Packing and report of a state at rest; `PackingError` if no disk touches another."""
    width, height = _size_of(state.scene, state)
    position = state.position()
    contacts = contact_forces(state)
    if not len(contacts.pairs):
        raise PackingError(f"no two disks touch under the lid: make the box narrower than width = {rule.width:g} m")
    backbone = _coordination_without_rattlers(contacts.pairs, state)
    reactions = wall_reactions(state)[:, 0]
    lengths = np.array([height, height, width, width])
    report = PackingReport(
        porosity=1.0 - float(np.pi * np.sum(state.scene.radius**2)) / (width * height),
        coordination_number=2.0 * len(contacts.pairs) / state.scene.count,
        coordination_number_without_rattlers=backbone[0],
        rattlers=backbone[1],
        wall_stress=tuple(float(value) for value in reactions / lengths),  # type: ignore[arg-type]
        mean_overlap=float(contacts.overlap.mean()),
        largest_overlap=float(contacts.overlap.max()),
        unbalanced_ratio=unbalanced_ratio(state),
        steps=cost.steps,
        seconds=perf_counter() - cost.began,
    )
    return Packing(
        x=position[:, 0].copy(),
        y=position[:, 1].copy(),
        radius=np.asarray(state.scene.radius, dtype=float).copy(),
        width=width,
        height=height,
        preload=Preload(contacts.pairs, contacts.shear),
        report=report,
    )


def _coordination_without_rattlers(pairs: Integers, state: State) -> tuple[float, int]:
    """Coordination number of the load-bearing disks, and the number of rattlers.

    A disk with fewer than two contacts (walls included) carries nothing; removing it may create further rattlers.
    """
    disk = np.repeat(np.arange(state.scene.count), np.diff(state.assembly.wall_pairs.start))
    pressed = wall_overlaps(state)[:, 0] > 0.0
    at_wall = np.bincount(state.assembly.order[disk[pressed]], minlength=state.scene.count)
    kept = np.ones(state.scene.count, dtype=bool)
    while True:
        alive = kept[pairs].all(axis=1)
        contacts = np.bincount(pairs[alive].ravel(), minlength=state.scene.count) + at_wall
        fewer = kept & (contacts < 2)  # a single force cannot balance
        if not fewer.any():
            return 2.0 * int(alive.sum()) / max(1, int(kept.sum())), int((~kept).sum())
        kept &= ~fewer


class SettlingError(RuntimeError):
    """A cemented sample did not come to rest."""


def settle(
    state: State, unbalanced_force_ratio: float, most_steps: int, raise_if_stopped: Callable[[], None] = lambda: None
) -> State:
    """Return the state with every lane at rest under the lid's servo; steps restart from zero.

    A balanced lane is frozen by a step of zero while the others continue, so its result does not depend on them.
    `SettlingError` if a lane does not come to rest.

    Parameters
    ----------
    state
        Newly started state.
    unbalanced_force_ratio
        Ratio to reach.
    most_steps
        Largest number of steps.
    raise_if_stopped
        Called every fraction of a second; may raise to end the run.
    """
    lanes = state.features.lanes
    open_lanes = np.ones(lanes, dtype=bool)
    grains = state.assembly.grains
    damped = grains._replace(damping=np.full_like(grains.damping, 0.7))  # local damping factor
    features = replace(state.features, servo=True, damping=True, recording=False, driven=False)
    assembly = replace(state.assembly, grains=damped)
    # A step for a scene with less damping may be above the limit of this one.
    step = np.minimum(state.time_step, SAFETY * critical_time_step(state.scene, assembly, features))
    current = duplicate(replace(state, assembly=assembly, features=features))
    while open_lanes.any():
        raise_if_stopped()
        if current.steps >= most_steps:
            raise SettlingError(
                f"a cemented sample is not at rest after {most_steps} steps: "
                "raise most_settling_steps or unbalanced_force_ratio"
            )
        current = replace(current, time_step=np.where(open_lanes, step, 0.0))
        current = run_in_place(current, 500, no_recording(current))  # steps between two checks
        current = replace(current, time_step=state.time_step)
        for lane in np.flatnonzero(open_lanes):
            open_lanes[lane] = not unbalanced_ratio(current, int(lane)) < unbalanced_force_ratio
    halt(current)
    assembly = replace(current.assembly, grains=grains)
    return replace(current, assembly=assembly, features=state.features, steps=0)


_CSV_COLUMNS = ("x", "y", "radius")
_KNOWN = {"x": "x", "y": "y", "radius": "r|radius"}
FEWEST_DISKS = 10
FARTHEST = 1e30
"""m; keeps distances of disks and their squares finite."""


def write_disks_csv(x: Floats, y: Floats, radius: Floats, file: Path) -> None:
    """Write disks: a header line, then x, y and radius (N,) of each in m, without loss of digits."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(_CSV_COLUMNS)
        writer.writerows(zip(x.tolist(), y.tolist(), radius.tolist(), strict=True))


def packing_from_csv(
    file: Path,
    sand: Sand,
    rule: PackingRule,
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Make a packing from the disks in a file.

    The disks are checked and put into a box of the rule's width with the lid on the highest disk. They are relaxed
    under the lid's stress like the last stage of `calcidem.dem.sample.compaction.make_packing`. A file has no contact
    forces, and its positions balance another contact law at best. `PackingFileError` if the file cannot be read as
    disks, they overlap or leave the box by more than a tenth of a radius, or the box is half empty; `PackingError` if
    they do not come to rest.

    Parameters
    ----------
    file
        Table with a header line naming the columns x, y and radius, in m unless their names have a unit; floor and left
        wall are at 0. Further columns and lines that begin with ``#`` are ignored.
    sand
        Material; the rule's friction of preparation replaces its own while the disks come to rest.
    rule
        Its width, stresses, damping and unbalanced-force ratio apply; the file determines sizes and porosity.
    raise_if_stopped
        Called every fraction of a second; may raise to end the work.
    watch
        Called as often with the progress.
    """
    x, y, radius, _ = checked_disks(file, rule.width)
    height = float(np.max(y + radius))
    sizes = 2.0 * float(radius.min()), 2.0 * float(radius.max())
    boxed = replace(rule, height=height, diameter=sizes)
    slippery = replace(sand, friction=rule.friction_preparation)
    cost = Cost(watch=watch, expansion_step=1)
    scene = Scene(x, y, radius, slippery, box_walls(rule.width, height), damping=rule.damping)
    return press(scene, None, boxed, cost, raise_if_stopped, OWN_DISKS)


def checked_disks(file: Path, width: float | None = None) -> tuple[Floats, Floats, Floats, str]:
    """Return x, y, radius (N,) of the disks in a file, and its SHA-256; refuse deep overlaps and boxes half empty.

    Without a width, m, the rightmost disk touches the right wall. `PackingFileError` names the line; `InputFileError`
    if the file cannot be read as text.
    """
    x, y, radius, lines, digest = _read_disks(file)
    width = float(np.max(x + radius)) if width is None else width
    for wall, gap in (("left wall", x), ("right wall", width - x), ("floor", y)):
        out = np.flatnonzero(gap < (1.0 - LARGEST_OVERLAP) * radius)
        if len(out):
            disk = out[0]
            beyond = radius[disk] - gap[disk]
            raise PackingFileError(
                f"{file}, line {lines[disk]}: the disk at ({x[disk]:g}, {y[disk]:g}) m reaches {beyond:.3g} m beyond "
                f"the {wall}; move the disks into 0 < x < {width:g} m, 0 < y, or change width"
            )
    refuse_deep_overlaps(file, lines, x, y, radius)
    top = int(np.argmax(y + radius))
    porosity = 1.0 - float(np.pi * np.sum(radius**2)) / (width * float(y[top] + radius[top]))
    if porosity > 0.5:  # a gas, or a single disk far above the others
        raise PackingFileError(
            f"{file}, line {lines[top]}: with the lid on this disk, the highest, the porosity is {porosity:.2f}; leave "
            "single disks far above the others out, give a smaller width, or disks closer together (at most 0.5)"
        )
    return x, y, radius, digest


def _read_disks(file: Path) -> tuple[Floats, Floats, Floats, list[int], str]:
    """Return x, y, radius (N,) and line of each disk in the file, and the file's SHA-256; as `checked_disks`."""
    content = read_input(file, MOST_BYTES)
    table = Table.read(content, file, _KNOWN, _CSV_COLUMNS)
    columns = table.places(_KNOWN)
    if missing := [name for name in _CSV_COLUMNS if name not in columns]:
        raise PackingFileError(f"{file} has no column {', '.join(missing)}; its first line must name x, y and radius")
    places = [(columns[name], unit_in_name(table.names[columns[name]], "length")[1] or "m") for name in _CSV_COLUMNS]
    disks = np.empty((len(table.rows), 3))
    for disk, (number, row) in zip(disks, table.rows, strict=True):
        try:
            disk[:] = [value_of(row[place], "length", unit) for place, unit in places]
        except IndexError:
            disk[:] = np.nan
        x, y, radius = disk.tolist()
        if np.isnan(disk).any():
            shown = ",".join(row)
            shown = f"{shown[:80]}{'...' if len(shown) > 80 else ''}"
            raise PackingFileError(f"{file}, line {number}: '{shown}' is not a disk; give three numbers in m")
        if not (abs(x) <= FARTHEST and abs(y) <= FARTHEST and 1.0 / FARTHEST <= radius <= FARTHEST):
            raise PackingFileError(
                f"{file}, line {number}: x = {x:g}, y = {y:g}, radius = {radius:g}; give finite numbers and a positive "
                f"radius, in m, up to {FARTHEST:g}"
            )
    if len(disks) < FEWEST_DISKS:
        raise PackingFileError(f"{file} has {len(disks)} disks; give at least {FEWEST_DISKS}")
    x, y, radius = (disks[:, place].copy() for place in range(3))
    return x, y, radius, [number for number, _ in table.rows], sha256(content).hexdigest()


def refuse_deep_overlaps(file: Path, lines: Sequence[int], x: Floats, y: Floats, radius: Floats) -> None:
    """Refuse disks that overlap by more than a tenth of a radius.

    `PackingFileError` names the lines of a pair.
    """
    pairs, overlap = overlapping_pairs(x, y, radius)
    deep = np.flatnonzero(overlap > LARGEST_OVERLAP * radius[pairs].min(axis=1))
    if len(deep):
        first, second = sorted(lines[disk] for disk in pairs[deep[0]])
        raise PackingFileError(
            f"{file}, lines {first} and {second}: the disks overlap by {overlap[deep[0]]:.3g} m, more than a tenth of "
            "a radius; move them apart, or make them smaller"
        )
