"""The step that closes the loop. What it computes with is imported where there is work to do."""

from collections.abc import Sequence
from pathlib import Path

from roomeq.core.build import Build, check_jobs
from roomeq.core.files import paths
from roomeq.records.rir_dir import mesh_files


def close_loop(rir_dirs: Sequence[Path], out: Path, *, test: Sequence[Path] = (), model: Path | None = None,
               max_effects: int = 4, seed: int = 0, nj: int = 1) -> dict | None:
    """Find the effects that a simulation of measured RIRs lacks, and extend the model by them.

    Parameters
    ----------
    rir_dirs : sequence of Path, or one
        RIR directories (`roomeq.records.rir_dir`), together of at least three rooms or conditions with two usable RIRs
        each. RIRs whose geometry cannot be used (`roomeq.records.geometry.geometry_usability`) are left out.
    out : path
        Loop directory to create: `ledger.json`, `model.json`, `residuals.npz`, `examples.npz`.
    test : sequence of Path, or one
        RIR directories that are only scored; they take no part in any fit.
    model : path, optional
        Model to start from (`roomeq.effects.model`). Its effects are part of the base model with their parameters and
        are not candidates. The effects that the loop finds are added to them.
    max_effects : int
        Largest number of effects to add.
    seed : int
    nj : int
        Number of processes; results do not depend on it.

    Returns
    -------
    dict or None
        The ledger; None if `out` is up to date.

    Raises
    ------
    ValueError
        Too few rooms have usable RIRs, or a directory or the model is invalid.
    """
    directories, test_directories = paths(rir_dirs), paths(test)
    check_jobs(nj)
    build = Build(Path(out), step="close-loop",
                  # the inputs are one list: the options say which of them is what
                  options=dict(max_effects=max_effects, seed=seed, n_train=len(directories),
                               n_test=len(test_directories), model=bool(model)),
                  # a model or mesh that is absent is refused by its reader
                  inputs=[*directories, *test_directories,
                          *sorted({mesh for directory in (*directories, *test_directories)
                                   for mesh in mesh_files(directory) if mesh.exists()}),
                          *([Path(model)] if model and Path(model).exists() else [])])
    if build.done:
        return None
    from roomeq.loop.close import make

    return make(build, directories, test_directories, Path(model) if model else None, max_effects, seed, nj)
