"""Compile-time switches of the kernel."""

from dataclasses import dataclass, fields

LANE_COUNTS = (1, 2, 4, 8, 16, 32)
"""Samples that can be advanced side by side, in whole registers: other numbers would be written beyond their ends."""

ABREAST = 8
"""Pairs of one sample that are computed side by side."""


@dataclass(frozen=True, slots=True)
class Features:
    """Switches that are constants during compilation, so a scene pays only for what it needs.

    Attributes
    ----------
    lanes
        Samples advanced side by side, one of `LANE_COUNTS`.
    finite
        Normals and overlaps follow the displacements; otherwise they are those of the reference geometry.
    linear
        Small displacement with constant stiffness: Hertz contacts are replaced by their tangent at the
        reference overlap. Contacts neither slip nor open, and bonds do not break. Forces are changes from the
        reference state. No contact has a history.
    rotation
        Disks turn.
    bonds
        Some pairs are cemented.
    linear_group
        Cemented pairs carry the linear group of 'linearpbond' beside the bond.
    breakage
        Bonds are checked against their strengths.
    slip
        Shear forces are checked against Coulomb friction.
    rescaling
        Shear rescaling mode 1 (see `laws.rescale_shear`).
    damping
        Local damping.
    servo
        Some walls are moved to hold a force.
    search
        The pair list is checked and renewed.
    recording
        A wall is driven, and signals are recorded.
    driven
        Some disks move with the drive of the recording.
    loads
        Constant external forces act on some disks.
    account
        Work and losses are summed for an energy balance.
    bundles
        Eight pairs of one sample are computed at once, unless the order of an account forbids it; bits are the same.
        This pays from some hundred disks on.
    midpoint
        The shear stiffness of a step is that of its middle instead of its end. Then contacts that stick during loading
        are of second order in the step. Impacts need it; loaded contacts that a wave meets do not.
    """

    lanes: int = 1
    finite: bool = True
    linear: bool = False
    rotation: bool = True
    bonds: bool = False
    linear_group: bool = False
    breakage: bool = False
    slip: bool = True
    rescaling: bool = True
    damping: bool = True
    servo: bool = False
    search: bool = False
    recording: bool = False
    driven: bool = False
    loads: bool = True
    account: bool = False
    bundles: bool = False
    midpoint: bool = False

    def __post_init__(self) -> None:
        """Refuse combinations that contradict each other."""
        if self.lanes not in LANE_COUNTS:
            raise ValueError(f"lanes = {self.lanes}: choose 1, 2, 4, 8, 16 or 32")
        if self.linear:
            needless = [
                name
                for name in ("finite", "breakage", "slip", "servo", "search", "account", "midpoint")
                if getattr(self, name)
            ]
            if needless:
                raise ValueError(
                    f"linear = True excludes {', '.join(needless)}: its contacts keep their stiffness; switch them off"
                )
        if self.search and not self.finite:
            raise ValueError("search = True needs finite = True: other regimes keep their contacts")
        if self.driven and not self.recording:
            raise ValueError("driven = True needs recording = True: it is a recording that has the drive")
        if not self.bonds and (self.linear_group or self.breakage):
            raise ValueError("linear_group and breakage belong to cemented pairs: set bonds = True or switch them off")

    def items(self) -> tuple[tuple[str, int | bool], ...]:
        """Names and values, in the order of declaration, and of what follows from them."""
        names = [field.name for field in fields(self)]
        return tuple((name, getattr(self, name)) for name in (*names, "bundled", "width"))

    @property
    def bundled(self) -> bool:
        """Whether pairs of one sample are computed side by side."""
        return self.bundles and self.lanes == 1 and not self.account

    @property
    def width(self) -> int:
        """Numbers in a vector of a pair."""
        return ABREAST if self.bundled else self.lanes
