"""Compile-time switches of the kernel."""

from dataclasses import dataclass, fields

LANE_COUNTS = (1, 2, 4, 8, 16, 32)
"""Samples that can be advanced side by side, in whole registers: other numbers would be written beyond their ends."""

ABREAST = 8
"""Pairs of one sample that are computed side by side."""


@dataclass(frozen=True, slots=True)
class Features:
    """Switches that are constants during compilation, so a scene pays only for what it needs."""

    lanes: int = 1
    """Samples advanced side by side, one of `LANE_COUNTS`."""
    linear: bool = False
    """Contact law `linear`: normals and stiffnesses are those of the reference geometry, and Hertz contacts are
    replaced by their tangent there. Contacts neither slip nor open, and bonds do not break. Forces are changes from the
    reference state. No contact has a history. Otherwise law `finite`: normals and overlaps follow the displacements.
    """
    rotation: bool = True
    """Disks turn."""
    bonds: bool = False
    """Some pairs are cemented."""
    linear_group: bool = False
    """Cemented pairs carry the linear group of 'linearpbond' beside the bond."""
    breakage: bool = False
    """Bonds are checked against their strengths."""
    slip: bool = True
    """Shear forces are checked against Coulomb friction."""
    rescaling: bool = True
    """Shear rescaling mode 1 (see `laws.rescale_shear`)."""
    damping: bool = True
    """Local damping."""
    servo: bool = False
    """Some walls are moved to hold a force."""
    search: bool = False
    """The pair list is checked and renewed."""
    recording: bool = False
    """A wall is driven, and signals are recorded."""
    driven: bool = False
    """Some disks move with the drive of the recording."""
    loads: bool = True
    """Constant external forces act on some disks."""
    account: bool = False
    """Work and losses are summed for an energy balance."""
    bundles: bool = False
    """Eight pairs of one sample are computed at once, unless the order of an account forbids it; bits are the same.
    This pays from some hundred disks on.
    """
    midpoint: bool = False
    """The shear stiffness of a step is that of its middle instead of its end. Then contacts that stick during loading
    are of second order in the step. Impacts need it; loaded contacts that a wave meets do not.
    """

    def __post_init__(self) -> None:
        """Refuse combinations that contradict each other."""
        if self.lanes not in LANE_COUNTS:
            raise ValueError(f"lanes = {self.lanes}: choose 1, 2, 4, 8, 16 or 32")
        if self.linear:
            needless = [
                name for name in ("breakage", "slip", "servo", "search", "account", "midpoint") if getattr(self, name)
            ]
            if needless:
                raise ValueError(
                    f"linear = True excludes {', '.join(needless)}: its contacts keep their stiffness; switch them off"
                )
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
