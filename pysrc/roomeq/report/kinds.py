"""The kinds of RIRs that the report compares: their names, directories and EQs."""

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ
from roomeq.eq.fit import eq_row, usable_eq
from roomeq.eq.gmm import with_reference
from roomeq.report.load import Run
from roomeq.report.page import Html, Missing, join, tag

KINDS = {"measured": "measured", "simulated": "simulated", "compensated": "simulated + EQ",
         "looped": "simulated + loop"}
DIRECTORIES = {"measured": "rirs.real.train", "simulated": "rirs.sim.train", "compensated": "rirs.sim.EQ.train",
               "looped": "rirs.sim.loop.train"}
COLOURS = {kind: "drawn" if kind == "looped" else kind for kind in KINDS}
HELD_OUT = "rirs.real.test"
"""Measured RIRs that nothing was fitted to."""


def key(kind: str) -> Html:
    """Return a colour mark and the name of a kind of RIR."""
    return join([tag("span", class_=f"key {COLOURS[kind]}"), KINDS[kind]])


def unscreened(run: Run, name: str) -> list[dict]:
    """Return the RIRs of a directory that take part in EQ fits and distances."""
    return [row for row in run.rirs(name) if not row.get("screen")]


def eq_vectors(run: Run, name: str) -> np.ndarray:
    """Return the EQ of a directory's RIRs, shape (n_rirs, 8) [dB]; NaN where it is not valid.

    Raises
    ------
    Missing
        All of them were screened out.
    """
    def load():
        found = [with_reference(usable_eq(eq_row(run.path(name), row))) for row in unscreened(run, name)]
        if not found:
            raise Missing(f"any RIR in data/{name} that the screening leaves", "a larger measured corpus")
        return np.array(found)

    return run.once(("eq", name), load)


def direct_sample(run: Run, name: str, row: dict) -> float:
    """Return where the direct sound of an RIR is [samples]."""
    known = (row.get("acoustic_parameters") or row).get("direct_sample")
    return find_direct(run.rir(name, row), FS_HZ)[0] if known is None else known


def simulated_rows(run: Run) -> list[dict]:
    """Return the simulated RIRs that say what T60 they aimed at and have."""
    rows = [row for name in ("rirs.sim.train", "rirs.sim.dev") if run.has(name) for row in run.rirs(name)]
    return [row for row in rows if row.get("target_t60_s") and row.get("t30_s")]


def described(name: str, eq_db: np.ndarray) -> str:
    """Return an EQ in words, for who can't see the figure."""
    return f"{name}: " + ", ".join(f"{db:.0f} dB at {hz:g} Hz" for hz, db in zip(BANDS_HZ, eq_db, strict=True))


def reverberation_times(parameters: list[dict]) -> list[float]:
    """Return T30 at 1 kHz where it is valid, else T20; nothing for those without both [s]."""
    found = (next((p[f"{name}_s"][BAND_1KHZ] for name in ("t30", "t20") if p[f"{name}_valid"][BAND_1KHZ]), None)
             for p in parameters)
    return [value for value in found if value is not None]
