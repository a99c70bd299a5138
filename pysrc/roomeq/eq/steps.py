"""The steps that fit EQs and compensate RIRs. What they compute with is imported where there is work to do."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from roomeq.core.build import Build
from roomeq.core.files import paths

if TYPE_CHECKING:
    from roomeq.eq.gmm import Gmm

MAX_TAPS = 4095
"""Longest filter: as many points as the response is sampled at in the design."""


def fit_eq(real_dir: Path | str, sim_dirs: Sequence[Path | str], out: Path | str, *, n_components: int = 7,
           weight_rooms: bool = False, seed: int, part: str | None = None, nj: int = 1) -> "Gmm | None":
    """Measure the EQ of measured and simulated RIRs and fit a Gaussian mixture to the measured ones.

    Screened RIRs (`roomeq.corpora.characterise`) are left out of the fit, and so are outliers: RIRs with a point more
    than 4 robust standard deviations from the median over rooms. Points that could not be measured are drawn from a
    Gaussian given the points that could. Where a response rolls off at 8 kHz, the level just below the roll-off is
    used.

    Parameters
    ----------
    real_dir
        Measured RIRs of the *training* set, with acoustic parameters or without.
    sim_dirs
        Simulated RIRs for comparison, one directory or several; may be empty.
    out
        Directory to make: `gmm.json`; `measured.jsonl` and `simulated.jsonl` (EQs); `resampled.jsonl` (one draw from
        the mixture per measured RIR that was fitted); `screening.json`.
    n_components
        Components of the mixture.
    weight_rooms
        Let rooms weigh the same. By default each RIR weighs the same, as in the paper.
    part
        ``"2/5"``: analyse the second of five shares only.
    nj
        Number of processes.

    Returns
    -------
    Gmm or None
        None if the result was up to date or only a part was analysed.

    Raises
    ------
    ValueError
        There are fewer measured RIRs than components, one of them is simulated, or an option is out of range.
    """
    if n_components < 1:
        raise ValueError(f"n_components={n_components} must be at least 1")
    directories = {"real": Path(real_dir)} | {f"sim{n}": path for n, path in enumerate(paths(sim_dirs))}
    options = dict(n_components=n_components, weight_rooms=bool(weight_rooms), seed=seed)
    build = Build(Path(out), step="fit-eq", options=options, inputs=list(directories.values()))
    if build.done:
        return None
    from roomeq.eq.fit import make

    return make(build, directories, n_components, weight_rooms, seed, part, nj)


def check_taps(taps: int) -> None:
    """Raise ValueError for a length that no compensation filter can have."""
    if not 3 <= taps <= MAX_TAPS or taps % 2 == 0:
        raise ValueError(f"taps={taps} must be odd and lie in [3, {MAX_TAPS}]: a linear-phase filter delays by half "
                         "of them")


def compensate(sim_dir: Path | str, eq_dir: Path | str, out: Path | str, *, taps: int = 511, match_rooms: bool = True,
               seed: int, part: str | None = None, nj: int = 1) -> dict | None:
    """Draw an EQ target for every simulated RIR and filter the RIR so that it meets the target.

    The RIRs of the noise sources of a simulated RIR (`noise_for`) pass through the same filter. It represents the
    room and the microphone, which they share.

    Parameters
    ----------
    sim_dir
        Simulated RIRs.
    eq_dir
        Output of `fit_eq`, or its `gmm.json`.
    out
        RIR directory to make. Rows hold `eq_target_db`, `eq_achieved_db`, `eq_error_db` and `eq_gain_db` (the gains
        the filter was designed for), 8 points each. `compensation.json` holds `summarise` of the rows.
    taps
        Length of the filter, odd.
    match_rooms
        Weight the components of the mixture as in the measured RIRs of the simulated RIR's room. False: draw all
        targets from the whole mixture. With one simulated RIR per measured one, as in the paper, the targets of all
        rooms together have the same distribution either way, unless the fit gave rooms the same weight: then they have
        it where rooms are drawn equally, too (`roomeq.augment.augment`).
    part
        ``"2/5"``: do the second of five shares only.
    nj
        Number of processes.

    Returns
    -------
    dict or None
        Content of `compensation.json`; None if the result was up to date or only a part was done.

    Raises
    ------
    ValueError
        An option is out of range, an RIR has no direct sound, or was compensated already.
    """
    check_taps(taps)
    sim_dir, eq_dir, out = Path(sim_dir), Path(eq_dir), Path(out)
    options = dict(taps=taps, match_rooms=bool(match_rooms), seed=seed)
    build = Build(out, step="compensate", options=options, inputs=[sim_dir, eq_dir], refers=True)
    if build.done:
        return None
    from roomeq.eq.compensation import make

    return make(build, sim_dir, eq_dir, taps, match_rooms, seed, part, nj)
