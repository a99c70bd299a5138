"""The kinds of RIRs that the report compares, with their labels and colours."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A kind of RIRs.

    Parameters
    ----------
    name : str
        Part of directory names, e.g. ``"sim.EQ"`` of ``rirs.sim.EQ.train`` and ``train.sim.EQ.rvb``.
    label : str
        Name in figures and tables.
    colour : str
        Name of the colour (`roomeq.report.style`); also part of the ids of figures.
    """

    name: str
    label: str
    colour: str

    @property
    def train(self) -> str:
        """Name of the directory of training RIRs."""
        return f"rirs.{self.name}.train"


MEASURED = Kind("real", "measured", "measured")
SIMULATED = Kind("sim", "simulated", "simulated")
COMPENSATED = Kind("sim.EQ", "simulated + EQ", "compensated")
EXTENDED = Kind("sim.loop", "simulated + loop", "drawn")
FREE = Kind("sim.free", "drawn rooms", "extra")
KINDS = (MEASURED, FREE, SIMULATED, COMPENSATED, EXTENDED)
KIND_NAMES = tuple(kind.name for kind in KINDS)
