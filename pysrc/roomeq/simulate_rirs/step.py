"""The step that simulates an RIR directory. What it simulates with is imported where there is work to do."""

import logging
from dataclasses import asdict
from pathlib import Path

from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.records.rir_dir import decay_range_s, read_rirs
from roomeq.records.schema import RirRow
from roomeq.sim.defaults import DEFAULT_TABLE, ISM_ORDER, NUM_RAYS, ORDER
from roomeq.sim.published import published_file
from roomeq.simulate_rirs.options import RenderOptions, check_options

logger = logging.getLogger(__name__)


def simulate(measured_dir: Path | str, out: Path | str, *, t60_range_s: tuple[float, float] | str = (0.2, 2.0),
             num_rays: int = NUM_RAYS, ism_order: int = ISM_ORDER, order: int = ORDER, noise_rirs: int = 1,
             materials: Path | str | None = None, model: Path | str | None = None, diffraction: bool = True,
             fs_hz: int = FS_HZ, seed: int = 0, part: str | None = None, nj: int = 1) -> None:
    """Simulate one RIR per measured RIR, in its room and from its source to its microphone.

    The materials of each RIR are drawn and then scaled until T30 at 1 kHz of the rendered RIR meets a target drawn
    uniformly from a range. RIRs of noise sources elsewhere in the room share the microphone and the materials.

    The effects of a model act on all RIRs, except that those of loudspeakers do not act on noise sources. The key
    `t30_s` of a row holds T30 before effects that act on the whole RIR (filters, a second decay, noise); it is what
    meets the target. The acoustic parameters are those of the RIR as written, with all effects.

    Parameters
    ----------
    measured_dir
        RIR directory (`roomeq.records.rir_dir`). Unknown coordinates are drawn. A row may state `materials`: the
        material of the mesh, the wall of the shoebox or ``"default"``, each with what
        `roomeq.sim.materials.find_surface` accepts. They are used instead of drawn ones. If its `target_t60_s` is
        null as well, they are not scaled.
    out
        RIR directory to make.
    t60_range_s
        Range of the targets [s]; ``"measured"``: the range of the measured rooms
        (`roomeq.records.rir_dir.decay_range_s`).
    num_rays
        Rays per source and per distinct column of scattering coefficients.
    ism_order
        Order of the exact image sources.
    order
        Least number of reflections that rays are followed for; RIRs that decay slowly need more.
    noise_rirs
        RIRs of noise sources per RIR.
    materials
        Table of materials; the one of the package by default.
    model
        File of effects to add to the simulation (`roomeq.effects.model`), as `roomeq close-loop` writes it.
    diffraction
        Render sound that comes around the edges of meshes.
    fs_hz
        Sample rate of the RIRs, 8 to 48 kHz. The effects of a model are defined at 16 kHz alone.
    part
        ``"2/5"``: do the second of five shares only.
    nj
        Number of processes.

    Raises
    ------
    ValueError
        An option is out of range, a position lies outside its room, the model file is malformed, or a target cannot
        be met.
    """
    measured_dir = Path(measured_dir)
    low_s, high_s = _t60_range_s(t60_range_s, measured_dir)
    options = RenderOptions((low_s, high_s), num_rays, ism_order, order, noise_rirs, bool(diffraction), fs_hz, seed)
    check_options(options)
    if model and fs_hz != FS_HZ:
        raise ValueError(f"fs={fs_hz} must be {FS_HZ} with model={model}, whose effects are defined at that rate: "
                         "leave one of them out")
    rows = read_rirs(measured_dir)
    files = [Path(materials or DEFAULT_TABLE), *([Path(model)] if model else []), *_published_table(rows),
             *sorted({measured_dir / mesh for row in rows if (mesh := row.get("mesh"))})]
    build = Build(Path(out), step="simulate", options=asdict(options),
                  # a file that is absent is refused by its reader, which names what refers to it
                  inputs=[measured_dir, *(file for file in files if file.exists())])
    if build.done:
        return
    from roomeq.simulate_rirs.directory import make

    make(build, measured_dir, rows, materials, model, options, part, nj)


def _t60_range_s(t60_range_s: tuple[float, float] | str, measured_dir: Path) -> tuple[float, float]:
    """Return the range of the targets: as stated, or that of the measured rooms."""
    if isinstance(t60_range_s, str):
        if t60_range_s != "measured":
            raise ValueError(f"t60_range={t60_range_s!r} must be two times [s] or 'measured'")
        try:
            t60_range_s = decay_range_s(read_rirs(measured_dir))
        except ValueError as error:
            raise ValueError(f"{measured_dir}: t60_range=measured: {error}") from None
        logger.info("%s: T60 of the rooms lies between %.2f and %.2f s at 1 kHz", measured_dir, *t60_range_s)
    if len(t60_range_s) != 2 or not 0.05 <= t60_range_s[0] <= t60_range_s[1] <= 10.0:
        raise ValueError(f"t60_range={t60_range_s} must be two times in [0.05, 10] s, the smaller first")
    return float(t60_range_s[0]), float(t60_range_s[1])


def _published_table(rows: list[RirRow]) -> list[Path]:
    """Return the published table of materials if it is installed and a row may refer to it."""
    path = published_file() if any(row.get("materials") for row in rows) else None
    return [path] if path else []
