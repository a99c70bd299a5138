"""Close the loop: find the effects that a simulation lacks, add them, and report the held-out error."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.build import Build
from roomeq.core.files import write_json
from roomeq.core.workers import on_one_thread, return_large_arrays
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import MODEL_FILE, Extension, Model, read_model, write_model
from roomeq.effects.source_directivity import SourceDirectivity, unit_facing
from roomeq.loop.acceptance import RISES, Trial, describe_rejection, judge, judge_predicted
from roomeq.loop.ceiling import ceiling_errors, ceiling_of_test_set, describe_explained, explained
from roomeq.loop.data import Data, load_data
from roomeq.loop.descriptions import describe_facing, describe_residual, describe_scored, effect_names
from roomeq.loop.examples import EXAMPLES_FILE, read_recordings, write_examples
from roomeq.loop.facing import unknown_facings, with_estimated_facings
from roomeq.loop.geometry import unknown_heights_m
from roomeq.loop.held_out import held_out_rirs
from roomeq.loop.heldout_errors import (
    SPLITS,
    HeldOutErrors,
    heldout_errors,
    measurable_rooms,
    one_sided_p,
    p_lower,
    predicted_errors,
    score_test_set,
    transferred,
)
from roomeq.loop.ledger import (
    LEDGER_FILE,
    RESIDUALS_FILE,
    count_entries,
    error_entry,
    iteration_entry,
    left_out_entries,
    undetected_entry,
    update_errors,
    update_parameters,
)
from roomeq.loop.ledger_checks import LEDGER_FORMAT
from roomeq.loop.power import detectable_sizes
from roomeq.loop.refined_facing import refined_facings
from roomeq.loop.selection import LEVEL, Candidate, choose, helps_beside, rank, weights_of
from roomeq.loop.session import (
    Session,
    effects_lacking,
    fit_base_model,
    refit,
    refit_rendered,
    with_measured_effects,
)
from roomeq.loop.shared_devices import warn_of_shared_devices
from roomeq.loop.splitters import rooms_by_devices
from roomeq.loop.unexplained import find_unexplained
from roomeq.loop.usable import UsableRirs, require_enough_rooms, usable_rirs
from roomeq.sim.geometry import towards_microphone

logger = logging.getLogger(__name__)
_FEWEST_ROOMS = 2
"""Rooms with an error from which on a mean has an interval."""
_NOTABLE_JND = 0.1
_REMEDY = "record until the decay ends in the noise"
SCATTERING = 0.3
"""Scattering coefficient of all surfaces: measured RIRs do not state it."""


class Accepted(NamedTuple):
    """An accepted effect: its entry in the ledger, and the model with it and its held-out errors."""

    entry: dict
    session: Session
    errors: HeldOutErrors


@on_one_thread
def make(build: Build, directories: list[Path], test: list[Path], model: Path | None, max_effects: int, seed: int,
         nj: int) -> dict:
    """Make the loop directory of a build and return the ledger.

    Raises
    ------
    ValueError
        See `roomeq.loop.step.close_loop`.
    """
    if not 0 <= max_effects <= len(CATALOGUE):
        raise ValueError(f"max_effects={max_effects} must lie in [0, {len(CATALOGUE)}]")
    return_large_arrays()
    base = Model() if model is None else read_model(model)
    usable = require_enough_rooms(directories, nj)
    for entry in usable.left_out:
        logger.info("left out %s", entry)
    # read before the loop, so that an invalid test set is reported at once and not after hours
    usable_test = _usable_test_set(test, usable, nj) if test else None
    warn_of_shared_devices(rir.row for of_set in (usable, usable_test) if of_set for rir in of_set.rirs)
    data = load_data(usable, scattering=SCATTERING, seed=seed, model=base, nj=nj)
    _require_errors(data, directories[0])
    test_data = load_data(usable_test, scattering=SCATTERING, seed=seed, model=base, nj=nj) if usable_test else None
    test_data = _with_errors(test_data, test[0]) if test_data else None
    ledger: dict = {}
    if build.run({"loop": None}, lambda _, __: {}):
        build.finish(lambda directory, _: ledger.update(_run(data, directories, directory, test_data, base,
                                                               max_effects, seed, nj)))
    return ledger


def _usable_test_set(directories: Sequence[Path], rirs: UsableRirs, nj: int) -> UsableRirs | None:
    """Return the usable RIRs of the test set, or None where no room can be scored.

    Raises
    ------
    ValueError
        See `usable_rirs`; or the test set shares recordings with the RIRs that the loop is closed on.
    """
    usable = held_out_rirs(usable_rirs(directories, nj), rirs.rirs, nj)
    for entry in usable.left_out:
        logger.info("test set: left out %s", entry)
    if not usable.n_scored:
        logger.warning("%s: no room has usable RIRs of two places, one to calibrate it and one to score: the test set "
                       "is not scored", directories[0])
        return None
    return usable


def _require_errors(data: Data, directory: Path) -> None:
    """Refuse data of which the loop could state no error with an interval."""
    n_rooms, n_scored = len(measurable_rooms(data)), int(data.is_scored.sum())
    if n_rooms < _FEWEST_ROOMS:
        raise ValueError(f"{directory}: a feature that is scored is valid in {n_rooms} of {n_scored} rooms, and must "
                         f"be in {_FEWEST_ROOMS}: recordings are too short or too noisy; {_REMEDY}")


def _with_errors(test_data: Data, directory: Path) -> Data | None:
    """Return the data of a test set, or None where nothing of it can be scored."""
    if len(measurable_rooms(test_data)):
        return test_data
    logger.warning("%s: no feature that is scored is valid in any of %d RIRs, as recordings are too short or too "
                   "noisy: the test set is not scored; %s", directory, len(test_data.rows), _REMEDY)
    return None


def _run(data: Data, directories: list[Path], work: Path, test_data: Data | None, base: Model, max_effects: int,
         seed: int, nj: int) -> dict:
    """Run the loop, write its files below `work` and return the ledger.

    What the loop has found is written before anything else is computed.
    """
    start = time.monotonic()
    recordings = read_recordings(directories, data)  # which may be elsewhere when the loop ends
    unknown = unknown_facings(data)
    first = _faced_base_model(data, unknown, seed=seed, nj=nj)
    _log_facings(first.data)
    first_errors, counts = heldout_errors(first), count_entries(data)
    logger.info("base model: held-out error %.2f JND (leave-positions-out), %.2f JND (leave-room-out)%s",
                *(first_errors.mean(split) for split in SPLITS), _of_scored(counts))
    session, errors, iterations, ranking, rejected = _add_effects(first, first_errors, unknown, max_effects)
    model = _model_of(session, base)
    write_model(work / MODEL_FILE, _with_places_of(session.data, model))
    np.savez_compressed(work / RESIDUALS_FILE, before=first.residual, after=session.residual)
    write_examples(work / EXAMPLES_FILE, recordings, first, session)
    update_parameters(iterations, session)
    unexplained = find_unexplained(session)
    for residual in unexplained[:1]:
        logger.info("unexplained: %s", describe_residual(residual))
    sizes = detectable_sizes(session, ranking, rejected)
    logger.info("effects that were not found would have been from a size of: %s", "; ".join(
        f"{candidate.effect.NAME} {'unknown' if size_jnd is None else f'{size_jnd:.1f} JND'}"
        for candidate, size_jnd in zip(ranking, sizes, strict=True)))
    ceiling = ceiling_errors(session)
    shares = explained(first_errors, errors, ceiling)
    _log_rises("final model", first_errors, errors)
    _log_explained("final model", ceiling, shares)
    ledger = dict(
        format=LEDGER_FORMAT, **counts, left_out=left_out_entries(data.left_out),
        geometry=[estimate.as_dict() for estimate in data.estimates], given=base.names,
        facings=[facing.as_dict() for facing in session.data.facings], baseline=error_entry(first_errors),
        iterations=iterations,
        ranking=[undetected_entry(candidate, size_jnd, rejected.get(candidate.effect))
                 for candidate, size_jnd in zip(ranking, sizes, strict=True)],
        unexplained=unexplained[0].as_dict() if unexplained else None,
        unexplained_all=[residual.as_dict() for residual in unexplained], final=error_entry(errors),
        ceiling=error_entry(ceiling), explained=shares)
    write_json(work / LEDGER_FILE, ledger)
    if test_data:
        try:
            ledger["test"], faced = _test_entry(test_data, first, session)
            write_json(work / LEDGER_FILE, ledger)
            write_model(work / MODEL_FILE, _with_places_of(session.data, _with_places_of(faced, model)))
        except Exception:
            logger.error("the test set could not be scored; what the loop found is in %s", work)
            raise
    logger.info("closed the loop on %d RIRs in %.0f s%s", len(data.rows), time.monotonic() - start, _of_scored(counts))
    return ledger


class _Extended(NamedTuple):
    """A base model with all effects that were accepted: its held-out errors, and the ledger's entries of the effects.

    The last ranking is of the effects that it lacks, with the trials of those that were rejected.
    """

    session: Session
    errors: HeldOutErrors
    iterations: list[dict]
    ranking: list[Candidate]
    rejected: dict[type[Effect], Trial]


def _add_effects(session: Session, errors: HeldOutErrors, unknown: IntArray, max_effects: int) -> _Extended:
    """Add one effect after the other to a model until none is accepted, or there are `max_effects`.

    With each, facings of the RIRs `unknown` are refined, and effects that it makes superfluous are taken out.
    """
    iterations: list[dict] = []
    eliminated: set[type[Effect]] = set()
    predicted = cache(partial(predicted_errors, session))  # once for all that compare with them
    while True:
        ranking = rank(session, eliminated)
        accepted, rejected = (_accept(session, errors, predicted, ranking, unknown) if len(iterations) < max_effects
                              else (None, {}))
        if accepted is None:
            return _Extended(session, errors, iterations, ranking, rejected)
        before = errors
        entry, session, errors = accepted
        newest = CATALOGUE[entry["effect"]]
        predicted = cache(partial(predicted_errors, session))
        session, errors, superfluous = _eliminate(session, errors, predicted, newest)
        if superfluous:
            eliminated.update(superfluous)
            predicted = cache(partial(predicted_errors, session))
        if errors is not accepted.errors:
            update_errors(entry, before, errors, [effect.NAME for effect in superfluous])
        iterations.append(entry)
        logger.info("added %s: held-out error %.2f -> %.2f JND, a fall of %.2f to %.2f; of what it touches, by %.0f %% "
                    "(%s)", effect_names(entry), entry["heldout_error_before"], entry["heldout_error_after"],
                    *entry["fall_ci"], 100.0 * entry["touched_fall"][entry["scored_on"]],
                    entry["scored_on"].replace("_", "-"))
        if superfluous:
            logger.info("took out %s, which no longer lowers the held-out error", ", ".join(entry["eliminated"]))


def _faced_base_model(data: Data, unknown: IntArray, *, seed: int, nj: int) -> Session:
    """Return the fitted base model with estimated facings of the RIRs `unknown`.

    A directivity of the base model acts only where a facing is known: the model is fitted again with the estimated
    facings, which it then tells better, and with those.
    """
    how: dict[str, Any] = dict(seed=seed, nj=nj, measured=effects_lacking(data))  # all that may be added
    session = with_estimated_facings(fit_base_model(data, **how))
    if not len(unknown) or SourceDirectivity not in data.given_kinds:
        return session
    session = refit_rendered(session.data, session.fit, **how)
    again = with_estimated_facings(session, unknown)
    if _same_facings(again, session, unknown):
        return session
    return refit_rendered(again.data, session.fit, **how)


def _same_facings(one: Session, other: Session, rirs: IntArray) -> bool:
    return all(one.data.rows[n]["source_dir"] == other.data.rows[n]["source_dir"] for n in rirs)


def _faced_as_fitted(session: Session, unknown: IntArray, newest: type[Effect]) -> Data:
    """Return a session's data whose sources face as its model, with a new effect, says.

    With a new directivity, the facings of the RIRs `unknown` are estimated anew; with it and with each later effect,
    their axes are refined.
    """
    if not len(unknown) or SourceDirectivity not in session.effects:
        return session.data
    return refined_facings(with_estimated_facings(session, unknown) if newest is SourceDirectivity else session)


def _log_facings(data: Data) -> None:
    for facing in data.facings:
        logger.info("%s", describe_facing(facing))


def _accept(session: Session, errors: HeldOutErrors, predicted: Callable[[], HeldOutErrors], ranking: list[Candidate],
            unknown: IntArray) -> tuple[Accepted | None, dict[type[Effect], Trial]]:
    """Return the best candidate that is accepted when it is rendered, or None, and the trials of rejected effects.

    The session has held-out errors as rendered and as predicted. A candidate whose predicted one hardly falls is
    rejected without being rendered. In a rendering, the sources of the RIRs `unknown` face as the model with the
    candidate says (`_faced_as_fitted`).

    A worse-fitting candidate replaces a rejected one only if the rejected one raised the error, or if it explains
    something else. If the error merely did not fall, the rejected candidate may still be the cause, and a significantly
    worse one must not stand in for it.
    """
    pool = ranking
    rejected: dict[type[Effect], Trial] = {}
    while True:
        winner, rivals = choose(pool, len(ranking))
        if winner is None:
            return None, rejected
        fitted = refit(session, winner.fit)
        trial = judge_predicted(winner.effect, predicted, fitted)
        if trial is None:
            after = refit_rendered(_faced_as_fitted(fitted, unknown, winner.effect), winner.fit, seed=session.seed,
                                   nj=session.nj, measured=[winner.effect])
            errors_after = heldout_errors(after)
            trial = judge(winner.effect, session, after, errors, errors_after)
        if trial.reason is None:
            entry = iteration_entry(winner, rivals, ranking, after, errors, errors_after, trial, rejected)
            if not _same_facings(after, session, unknown):
                _log_facings(after.data)
            return Accepted(entry, after, errors_after), rejected
        rejected[winner.effect] = trial
        logger.info("rejected %s: %s", winner.effect.NAME, describe_rejection(trial))
        pool = [candidate for candidate in pool if candidate is not winner
                and (trial.reason == RISES or one_sided_p(winner.gain - candidate.gain) > LEVEL
                     or (candidate.helps(len(ranking)) and helps_beside(fitted, candidate, len(ranking))))]


def _eliminate(session: Session, errors: HeldOutErrors, predicted: Callable[[], HeldOutErrors], newest: type[Effect]
               ) -> tuple[Session, HeldOutErrors, list[type[Effect]]]:
    """Take out effects that a newer one makes superfluous: the held-out error is not significantly higher without.

    The session has held-out errors as rendered and as predicted.

    What was read off the recordings themselves remains: no other effect explains it.

    Returns the session without them, its held-out errors, and the effects.
    """
    superfluous: list[type[Effect]] = []
    left, errors_left = session, errors
    earlier = [effect for effect in session.effects if effect is not newest and not effect.MEASURED]
    for effect in earlier:
        without = refit(session, session.fit, [other for other in left.effects if other is not effect])
        weights, predicted_without = weights_of(effect, session), predicted_errors(without)
        # most effects are known to be needed without rendering the model that lacks them
        if any(p_lower(predicted_without, predicted(), split, weights) < LEVEL for split in SPLITS):
            continue
        without = refit_rendered(session.data, without.fit, seed=session.seed, nj=session.nj)
        errors_without = heldout_errors(without)
        if all(p_lower(errors_without, errors, split, weights) >= LEVEL for split in SPLITS):
            superfluous.append(effect)
            left, errors_left = without, errors_without
    return left, errors_left, superfluous


def _test_entry(data: Data, first: Session, last: Session) -> tuple[dict, Data]:
    """Return the ledger's entry of the test set, with errors of the base and the final model and ceiling, and the set.

    In the set that is returned, facings are estimated. What is read off the recordings of a room is part of the final
    model there, whether the other rooms have it or not.
    """
    found, last = last.effects, with_measured_effects(last)
    data, _ = transferred(data, last)  # whose facings are estimated once
    _log_facings(data)
    before, after = (score_test_set(data, session) for session in (first, last))
    counts = count_entries(data)
    logger.info("test set: held-out error %.2f -> %.2f JND (leave-positions-out), %.2f -> %.2f JND (leave-room-out)%s",
                *(errors.mean(split) for split in SPLITS for errors in (before, after)), _of_scored(counts))
    ceiling = ceiling_of_test_set(data, last)
    shares = explained(before, after, ceiling)
    _log_rises("test set", before, after)
    _log_explained("test set", ceiling, shares)
    return dict(**counts, left_out=left_out_entries(data.left_out),
                geometry=[estimate.as_dict() for estimate in data.estimates],
                facings=[facing.as_dict() for facing in data.facings],
                measured=[effect.NAME for effect in last.effects if effect not in found],
                before=error_entry(before), after=error_entry(after), ceiling=error_entry(ceiling),
                explained=shares), data


def _of_scored(counts: dict[str, int]) -> str:
    return f", scored on {scored}" if (scored := describe_scored(counts)) else ""


def _log_rises(name: str, before: HeldOutErrors, after: HeldOutErrors) -> None:
    """Log the metrics whose error rises, which the mean hides."""
    for split in SPLITS:
        earlier, later = before.by_metric(split), after.by_metric(split)
        rises = [f"{metric} {earlier[metric]:.2f} -> {later[metric]:.2f} JND" for metric in earlier
                 if metric in later and later[metric] - earlier[metric] > _NOTABLE_JND]
        if rises:
            logger.info("%s: the held-out error of some metrics rises: %s (%s)", name, "; ".join(rises),
                        split.replace("_", "-"))


def _log_explained(name: str, ceiling: HeldOutErrors, shares: dict) -> None:
    for split in SPLITS:
        if np.isnan(level_jnd := ceiling.mean(split)):
            logger.info("%s: the explainable error is unknown (%s): in no simulated recording is a feature valid", name,
                        split.replace("_", "-"))
            continue
        logger.info("%s: %s (%s, ceiling %.2f JND); no further fall possible: %s", name,
                    describe_explained(shares[split]), split.replace("_", "-"), level_jnd,
                    ", ".join(shares[split]["at_ceiling"]) or "none")


def _model_of(session: Session, base: Model) -> Model:
    """Return the model for the simulator: the base model, with its places, and the effects that a session has added."""
    extensions = list(base.extensions)
    vectors = session.index.vectors(session.fit.mean, session.fit.local)
    group = rooms_by_devices(session.data)[session.data.room]
    for effect, of_units in zip(session.effects, vectors, strict=True):
        names, unit = session.data.units(effect.SCOPE)
        _, first = np.unique(unit, return_index=True)
        extensions.append(Extension(effect, {name: effect.from_vector(vector) for name, vector
                                             in zip(names, of_units, strict=True)}, *_moments(of_units, group[first])))
    return replace(base, extensions=tuple(
        sorted(extensions, key=lambda extension: list(CATALOGUE).index(extension.effect.NAME))))


def _moments(vectors: FloatArray, group: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of vectors, shape (n_units, n), where each group of units counts alike.

    Groups share no device, and are mostly laboratories: the microphones of an array would otherwise outweigh those of
    all others.
    """
    _, number, size = np.unique(group, return_inverse=True, return_counts=True)
    weight = 1.0 / (len(size) * size[number])
    mean = weight @ vectors
    if len(vectors) == 1:
        return mean, np.zeros_like(mean)
    # unbiased if units vary independently
    return mean, np.sqrt(weight @ (vectors - mean) ** 2 / (1.0 - weight @ weight))


def _with_places_of(data: Data, model: Model) -> Model:
    """Return a model that has the heights and facings of some RIRs, with which they can be simulated."""
    heights_m = dict(model.heights_m)
    for room, of_room in unknown_heights_m(data.estimates).items():
        heights_m[room] = {**heights_m.get(room, {}), **of_room}
    if not model.is_directive:
        return replace(model, heights_m=heights_m)
    rirs = {row["id"] for row in data.rows}
    of_others = {rir: facing for rir, facing in model.facings.items() if rir not in rirs}
    return replace(model, heights_m=heights_m, facings=of_others | _facings(data))


def _facings(data: Data) -> dict[str, list[float]]:
    """Return the facings of sources that do not face their microphone, by RIR."""
    facings = {}
    for row, place in zip(data.rows, data.places, strict=True):
        facing = unit_facing(row.get("source_dir"))
        if facing is not None and not np.allclose(facing, towards_microphone(place), atol=1e-6):
            facings[row["id"]] = facing.tolist()
    return facings
