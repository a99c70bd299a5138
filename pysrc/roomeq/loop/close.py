"""Close the loop: find what the model lacks, add it, simulate again, and say what it was worth on unseen rooms."""

import logging
import time
from pathlib import Path

import numpy as np

from roomeq.core.build import Build, check_jobs
from roomeq.core.files import write_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import MODEL_FILE, Extension, Model, read_model, write_model
from roomeq.loop.attribute import MIN_ROOMS, choose, one_sided_p, rank
from roomeq.loop.data import load_data
from roomeq.loop.examples import EXAMPLES_FILE, write_examples
from roomeq.loop.heldout import heldout_errors, p_lower
from roomeq.loop.ledger import LEDGER_FILE, iteration_entry, ranked, values_of
from roomeq.loop.session import begin
from roomeq.loop.test_set import score_test_set
from roomeq.loop.unexplained import find_unexplained
from roomeq.loop.words import names_of, of_residual

logger = logging.getLogger(__name__)

SCATTERING = 0.3  # of all surfaces; nobody declares it, and the error depends little on it
LEVEL = 0.05


def close_loop(rir_dirs, out, *, test=(), model=None, max_effects=4, seed=0, nj=1):
    """Find the effects that a simulation of measured RIRs lacks, and extend the model by them.

    Parameters
    ----------
    rir_dirs : sequence of Path
        RIR directories with geometry (`roomeq.records.rir_dir`), together of at least three rooms or conditions.
    out : Path
        Directory to make: `ledger.json`, `model.json`, `residuals.npz`.
    test : sequence of Path
        RIR directories that are only scored: no fit sees them.
    model : Path, optional
        Model to begin with (`roomeq.effects.model`): its effects are part of the base model, as they are there, and no
        candidates. What is found is added to them.
    max_effects : int
        At most so many effects are added.
    seed : int
    nj : int
        Processes; results do not depend on it.

    Returns
    -------
    dict or None
        The ledger; None if it was there already.

    Raises
    ------
    ValueError
        Too few rooms, or a directory or the model breaks its contract.
    """
    directories, test = [Path(one) for one in rir_dirs], [Path(one) for one in test]
    if not 0 <= max_effects <= len(CATALOGUE):
        raise ValueError(f"max_effects={max_effects} must lie in [0, {len(CATALOGUE)}]")
    check_jobs(nj)
    given = Model() if model is None else read_model(model)
    build = Build(Path(out), step="close-loop", options=dict(max_effects=max_effects, seed=seed),
                  inputs=[*directories, *test, *([Path(model)] if model else [])])
    if build.done:
        return None
    data = load_data(directories, scattering=SCATTERING, seed=seed, model=given, nj=nj)
    # before the loop: what is wrong there must not be said after hours
    test_data = load_data(test, scattering=SCATTERING, seed=seed, model=given, nj=nj) if test else None
    if data.n_scored < MIN_ROOMS:
        raise ValueError(f"{directories[0]}: RIRs of {len(data.room_names)} rooms, {data.n_scored} of them with two or "
                         f"more, and the loop leaves rooms out and scores them by halves: give at least {MIN_ROOMS} "
                         "rooms or conditions (room_id) with two RIRs")
    if test_data and not test_data.n_scored:
        logger.warning("%s: no room has two RIRs, one to calibrate it and one to score: not tested", test[0])
        test_data = None
    ledger = {}
    if build.run({"loop": None}, lambda _, __: {}):
        build.finish(lambda directory, _: ledger.update(_run(data, directories, directory, test_data, given,
                                                               max_effects, seed, nj)))
    return ledger


def _run(data, directories, work, test_data, given, max_effects, seed, nj):
    """The loop itself; writes its files below `work` and returns the ledger."""
    start = time.monotonic()
    session = begin(data, seed=seed, nj=nj)
    errors = first_errors = heldout_errors(session)
    first = session
    logger.info("base model: held-out error %.2f JND on unseen positions, %.2f in unseen rooms",
                errors.mean("positions"), errors.mean("rooms"))
    iterations = []
    while True:
        ranking = rank(session)
        found = _accepted(session, errors, ranking) if len(iterations) < max_effects else None
        if found is None:
            break
        entry, session, errors = found
        iterations.append(entry)
        logger.info("loop: %s: held-out error %.2f -> %.2f JND [%.2f, %.2f]", names_of(entry),
                    entry["heldout_error_before"], entry["heldout_error_after"], *entry["heldout_error_ci"])
    left = find_unexplained(session)
    for unexplained in left[:1]:
        logger.info("loop: unexplained: %s", of_residual(unexplained))
    ledger = dict(
        rirs=len(data.rows), rooms=len(data.room_names), given=given.names,
        baseline=_error_entry(first_errors), iterations=iterations,
        ranking=[ranked(one) for one in ranking], unexplained=left[0].as_dict() if left else None,
        unexplained_all=[one.as_dict() for one in left], final=_error_entry(errors))
    if test_data:
        ledger["test"] = _test_errors(test_data, first, session, seed, nj)
    logger.info("%d RIRs in %.0f s", len(data.rows), time.monotonic() - start)
    write_json(work / LEDGER_FILE, ledger)
    write_model(work / MODEL_FILE, model_of(session, given))
    np.savez_compressed(work / "residuals.npz", before=first.residual, after=session.residual)
    write_examples(work / EXAMPLES_FILE, directories, first, session)
    return ledger


def _accepted(session, errors, ranking):
    """The most helpful candidate that also lowers the error when everything is simulated again with it, or None.

    The error is to be lower on unseen positions or in unseen rooms, and higher on neither.

    What fits significantly worse than another takes its place only if that one raised the error: else the cause may
    still be the better one, and the data cannot prove it.
    """
    rendered_changes, pool = dict(session.data.rendered_changes), ranking
    while True:
        winner, rivals = choose(pool, len(ranking))
        if winner is None:
            return None
        after = begin(session.data, like=winner.fit, correction=session.correction, seed=session.seed, nj=session.nj)
        errors_after = heldout_errors(after)
        p = {way: p_lower(errors, errors_after, way) for way in errors.features}
        higher = any(p_lower(errors_after, errors, way) < LEVEL for way in errors.features)
        if min(p.values()) < LEVEL / len(p) and not higher:
            return iteration_entry(winner, rivals, ranking, after, errors, errors_after, p), after, errors_after
        logger.info("loop: %s fits, but simulated again it %s the error; left out", winner.effect.NAME,
                    "raises" if higher else "does not lower")
        session.data.rendered_changes.update(rendered_changes)  # those of the rejected model speak of its own RIRs
        pool = [one for one in pool if one is not winner
                and (higher or one_sided_p(winner.gain - one.gain) > LEVEL)]


def _error_entry(errors):
    return {way: dict(error=errors.mean(way), ci=errors.interval(way), by_metric=errors.by_metric(way),
                      by_band=errors.by_band(way)) for way in errors.features}


def _test_errors(data, first, last, seed, nj):
    """Errors on directories that took no part, before and after."""
    before, after = (score_test_set(data, session, seed=seed, nj=nj) for session in (first, last))
    logger.info("test set: held-out error %.2f -> %.2f JND on unseen positions, %.2f -> %.2f in unseen rooms",
                *(errors.mean(way) for way in ("positions", "rooms") for errors in (before, after)))
    return dict(rirs=len(data.rows), rooms=len(data.room_names), before=_error_entry(before),
                after=_error_entry(after))


def model_of(session, given):
    """What a session found and what it was given, for the simulator."""
    found = [*given.extensions, *(Extension(*one) for one in values_of(session))]
    return Model(tuple(sorted(found, key=lambda one: list(CATALOGUE).index(one.effect.NAME))))
