"""The ledger of a loop, `ledger.json`: what each entry holds, written and validated.

`residuals.npz`, with the residuals before and after the loop, is validated here as well.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.special import ndtri, stdtrit

from roomeq.core.arrays import FloatArray
from roomeq.core.files import read_json
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.mic_response import MicResponse
from roomeq.effects.model import MODEL_FILE, read_model
from roomeq.effects.source_response import SourceResponse
from roomeq.loop.acceptance import Trial
from roomeq.loop.data import Data
from roomeq.loop.examples import EXAMPLES_FILE, read_arrays, read_examples
from roomeq.loop.features import N_FEATURES
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors
from roomeq.loop.ledger_checks import InvalidEntryError, check_ledger
from roomeq.loop.packing import OWN_SCOPES
from roomeq.loop.selection import Candidate
from roomeq.loop.session import Session
from roomeq.loop.splitters import leave_rooms_out
from roomeq.loop.usable import LeftOut

LEDGER_FILE, RESIDUALS_FILE = "ledger.json", "residuals.npz"
_REMEDY = "run roomeq close-loop again"


def error_entry(errors: HeldOutErrors) -> dict:
    """Return the entry of held-out errors, by split; an error is null where no feature is valid."""
    means = {split: errors.mean(split) for split in SPLITS}
    return {split: dict(error=means[split] if np.isfinite(means[split]) else None, ci=errors.interval(split),
                        by_metric=errors.by_metric(split), by_band=errors.by_band(split)) for split in SPLITS}


def count_entries(data: Data) -> dict[str, int]:
    """Return the numbers of RIRs and rooms that took part, and of those that are scored: errors are of these."""
    scored = data.is_scored
    return dict(rirs=len(data.rows), rooms=len(data.room_names), scored_rirs=int(scored[data.room].sum()),
                scored_rooms=int(scored.sum()))


def left_out_entries(left_out: Sequence[LeftOut]) -> list[dict]:
    """Return the entries of the RIRs that took no part, by reason."""
    return [entry._asdict() for entry in left_out]


def ranking_entry(candidate: Candidate, rejected: Trial | None) -> dict:
    """Return the entry of a candidate in a ranking, with its trial if it was tried and rejected."""
    entry = dict(effect=candidate.effect.NAME, gain=candidate.total, ci=candidate.interval, p=candidate.p,
                 size_jnd=candidate.size_jnd)
    return entry if rejected is None else entry | dict(
        rejected=dict(reason=rejected.reason, rendered=rejected.rendered, **_trial_entry(rejected)))


def undetected_entry(candidate: Candidate, detectable_jnd: float | None, rejected: Trial | None) -> dict:
    """Return the entry of a candidate that was not added: with the smallest size that would have been found."""
    return ranking_entry(candidate, rejected) | dict(detectable_jnd=detectable_jnd,
                                                     would_show=candidate.effect.DISCRIMINATING_MEASUREMENT)


def _trial_entry(trial: Trial) -> dict:
    return dict(p=trial.joint_p, p_by_split=trial.p, touched_fall=trial.falls, p_other_devices=trial.other_devices_p)


def iteration_entry(winner: Candidate, rivals: list[Candidate], ranking: list[Candidate], session: Session,
                    before: HeldOutErrors, after: HeldOutErrors, trial: Trial, rejected: dict[type[Effect], Trial]
                    ) -> dict:
    """Return the entry of an accepted effect.

    Parameters
    ----------
    winner : Candidate
    rivals : list of Candidate
        Those that cannot be distinguished from the winner.
    ranking : list of Candidate
    session : Session
        Of the model with the effect.
    before, after : HeldOutErrors
        Of all features. The entry has those on the split on which the error of the touched ones has the lowest p.
    trial : Trial
        Of the winner.
    rejected : dict
        Trials of effects that were tried before it and rejected.
    """
    split = min(trial.p, key=lambda name: (trial.p[name], name))
    entry = dict(
        effect=winner.effect.NAME, scope=winner.effect.SCOPE, size_jnd=winner.size_jnd,
        parameters=_parameter_intervals(session, winner.effect), scored_on=split,
        heldout_error_before=before.mean(split), heldout_error_after=after.mean(split),
        heldout_error_ci=after.interval(split), fall_ci=before.fall_interval(after, split), **_trial_entry(trial),
        by_metric={"before": before.by_metric(split), "after": after.by_metric(split)},
        by_band={"before": before.by_band(split), "after": after.by_band(split)},
        ranking=[ranking_entry(candidate, rejected.get(candidate.effect)) for candidate in ranking])
    if rivals:
        entry["cannot_tell"] = [winner.effect.NAME, *(candidate.effect.NAME for candidate in rivals)]
        entry["would_tell"] = sorted({candidate.effect.DISCRIMINATING_MEASUREMENT for candidate in (winner, *rivals)})
    return entry


def update_errors(entry: dict, before: HeldOutErrors, errors: HeldOutErrors, eliminated: list[str]) -> None:
    """Enter the held-out errors at the end of an iteration: with refined axes, and without `eliminated` effects."""
    split = entry["scored_on"]
    entry |= dict(eliminated=eliminated, heldout_error_after=errors.mean(split),
                  heldout_error_ci=errors.interval(split), fall_ci=before.fall_interval(errors, split),
                  by_metric={**entry["by_metric"], "after": errors.by_metric(split)},
                  by_band={**entry["by_band"], "after": errors.by_band(split)})


def update_parameters(iterations: list[dict], session: Session) -> None:
    """Enter the parameters of the final model: each later effect has changed those of the earlier ones."""
    for entry in iterations:
        effect = CATALOGUE[entry["effect"]]
        if effect in session.effects:
            entry["parameters"] = _parameter_intervals(session, effect)
            if other := _in_sum_with(session, effect):
                entry["sum_with"] = other.NAME


def _in_sum_with(session: Session, effect: type[Effect]) -> type[Effect] | None:
    """Return the effect of the model of which recordings determine only the sum with another.

    A filter on all loudspeakers and its inverse on all microphones give the same recordings.
    """
    others: dict[type[Effect], type[Effect]] = {SourceResponse: MicResponse, MicResponse: SourceResponse}
    other = others.get(effect)
    return other if other in session.effects else None


def added_effects(ledger: dict) -> list[dict]:
    """Return the iterations whose effects are in the final model: later ones may have made earlier ones superfluous."""
    eliminated = {name for entry in ledger["iterations"] for name in entry.get("eliminated", [])}
    return [entry for entry in ledger["iterations"] if entry["effect"] not in eliminated]


def _parameters_of(effect: type[Effect], vector: FloatArray) -> dict:
    return asdict(effect.from_vector(vector))  # type: ignore[call-overload]


def _parameter_intervals(session: Session, effect: type[Effect]) -> dict:
    """Return the parameters of each unit, those of shared effects with 95 % intervals.

    They are from a jackknife over the rooms that have the unit; of one or two rooms, which is too few, from the
    posterior covariance. Rooms that do not have the unit say nothing of it. The jackknife does not see what no room
    determines, as `_in_sum_with` tells: all fits share the same prior there, whose width is that of the posterior.
    """
    index, k = session.index, session.effects.index(effect)
    best = index.vectors(session.fit.mean, session.fit.local)[k]
    entry = {name: {"best": _parameters_of(effect, vector)}
             for name, vector in zip(session.data.units(effect.SCOPE)[0], best, strict=True)}
    if effect.SCOPE in OWN_SCOPES:
        return entry
    left_out = leave_rooms_out(session.data, session.fit)
    held_out = np.array([index.vectors(room.mean, session.fit.local)[k] for room in left_out])
    part, n_vectors, unit_of_row, size = index.shared[k]
    deviation = np.sqrt(np.diag(np.linalg.inv(left_out[0].of_all))[part]).reshape(n_vectors, size)
    for u, of_unit in enumerate(entry.values()):
        rooms = np.unique(session.data.room[unit_of_row == u])
        half = (_jackknife_half_interval(held_out[rooms, u]) if len(rooms) > 2 and not _in_sum_with(session, effect)
                else ndtri(0.975) * deviation[u])
        of_unit |= {"low": _parameters_of(effect, best[u] - half), "high": _parameters_of(effect, best[u] + half)}
    return entry


def _jackknife_half_interval(without: FloatArray) -> FloatArray:
    """Return half the 95 % interval of estimates from those without each observation, shape (n_observations, n)."""
    n = len(without)
    return np.asarray(stdtrit(n - 1, 0.975) * np.sqrt((n - 1) / n * np.sum((without - without.mean(axis=0)) ** 2,
                                                                               axis=0)))


def validate_loop(directory: Path) -> int:
    """Validate a loop directory, and return the number of effects that the loop added.

    Raises
    ------
    ValueError
        The first error of the directory.
    """
    directory = Path(directory)
    ledger, model = read_ledger(directory / LEDGER_FILE), read_model(directory / MODEL_FILE)
    added = added_effects(ledger)
    names = sorted([*ledger["given"], *(entry["effect"] for entry in added)])
    if names != sorted(model.names):
        raise ValueError(f"{directory / MODEL_FILE}: effects {', '.join(sorted(model.names)) or 'none'} are not those "
                         f"of {LEDGER_FILE} ({', '.join(names) or 'none'}): {_REMEDY}")
    by_name = {extension.effect.NAME: extension for extension in model.extensions}
    for entry in added:
        units = sorted(by_name[entry["effect"]].of)
        if sorted(entry["parameters"]) != units:
            raise ValueError(f"{directory / LEDGER_FILE}: parameters of {entry['effect']} must be of "
                             f"{', '.join(units)}, as in {MODEL_FILE}: {_REMEDY}")
    read_residuals(directory / RESIDUALS_FILE, ledger["rirs"])
    read_examples(directory / EXAMPLES_FILE)
    return len(added)


def read_residuals(path: Path, n_rirs: int) -> dict[str, FloatArray]:
    """Read the residuals "before" and "after" the loop: ndarray, shape (n_rirs, n_features) each [JND].

    Raises
    ------
    ValueError
        The file is invalid, or holds another number of RIRs.
    """
    arrays = read_arrays(path, ("before", "after"))
    for key, values in arrays.items():
        if values.shape != (n_rirs, N_FEATURES) or values.dtype.kind != "f" or np.any(np.isinf(values)):
            raise ValueError(f"{path}: {key!r} must hold {n_rirs} x {N_FEATURES} finite numbers or gaps, as "
                             f"{LEDGER_FILE} says: {_REMEDY}")
    return arrays


def read_ledger(path: Path) -> dict:
    """Read a ledger and validate it.

    Raises
    ------
    ValueError
        The ledger is invalid or has another format; the message names the file and the first invalid entry.
    """
    ledger = read_json(path)
    try:
        check_ledger(ledger)
    except InvalidEntryError as error:
        raise ValueError(f"{path}: {error}: {_REMEDY}") from None
    return ledger
