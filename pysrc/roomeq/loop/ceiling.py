"""The noise ceiling: the held-out error that remains if the model is right, and how much of the rest is explained.

Recordings are simulated with the model itself: the same rooms, loudspeakers and microphones with their fitted
parameters, but another random realisation of everything that no model of this kind knows - the phases of reflections
and of the diffuse tail, the exact positions, the noise of the recording. The model is then fitted to these twins of the
recordings and scored on them like on the recordings (parametric bootstrap; Efron and Tibshirani, An Introduction to
the Bootstrap, 1993, sec. 6.5). What remains is interference, decays of finite bandwidth and length (Davy, Dunn and
Dubout, Acustica 43 (1979) 12), the noise of the rendered tails, the uncertainty of geometry, and what half of a room or
the other rooms cannot tell about a room. The twins have the rays of the model that scores them: with other rays, the
ceiling of five generated rooms was 0.01 and 0.03 JND higher.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from roomeq.acoustics.octaves import OCTAVE_WIDTH_HZ
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.rng import rng_for
from roomeq.effects.base import Effect, octave_energies
from roomeq.effects.noise_floor import NOISE_S
from roomeq.loop.data import Data, measured_fields
from roomeq.loop.features import BAND_OF_FEATURE, HAS_GAIN, METRIC, Features, measure_features
from roomeq.loop.fit import fit
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors, heldout_errors, score_test_set, transferred
from roomeq.loop.rendering import RawRir, finished_rir, map_rendered, on_recording_time, row_models
from roomeq.loop.session import Session
from roomeq.loop.splitters import EVERY_FEATURE
from roomeq.records.schema import is_timed
from roomeq.sim.scene import check_positions

POSITION_SPREAD_M = 0.02
"""Standard deviation of each coordinate of a source and of a microphone about the stated one."""
MIN_EXPLAINABLE_JND = 0.25
"""Errors that exceed the ceiling by less leave nothing to explain."""
_TRIES = 100  # to move a microphone within its room


def ceiling_errors(session: Session) -> HeldOutErrors:
    """Return the held-out errors that a session's model would have if the recordings followed it."""
    data, index, fitted = session.data, session.index, session.fit
    twins = twin_recordings(data, index.absorption(fitted.mean, fitted.local), session.by_row,
                            index.gains(fitted.local), seed=session.seed, nj=session.nj)
    refitted = fit(twins, session.correction, session.effects, initial=fitted)
    return heldout_errors(replace(session, data=twins, fit=refitted))


def ceiling_of_test_set(data: Data, session: Session) -> HeldOutErrors:
    """Return the errors that a session's model would have on rooms held out of every fit if they followed it."""
    data, calibrated = transferred(data, session)
    every: list[IntArray] = [np.flatnonzero(data.room == r) for r in range(len(data.room_names))]
    absorption, by_row, gains = calibrated(every, EVERY_FEATURE)
    twins = twin_recordings(data, absorption, by_row, gains, seed=session.seed, nj=session.nj)
    return score_test_set(twins, session)


def twin_recordings(data: Data, absorption: FloatArray, effects: list[list[Effect]], gains: FloatArray, *, seed: int,
                    nj: int) -> Data:
    """Return data with simulated recordings in place of the measured ones.

    Parameters
    ----------
    data : Data
    absorption, effects
        As for `roomeq.loop.rendering.row_models`.
    gains : ndarray, shape (n_rirs,)
        Of the recordings [dB].
    seed, nj : int

    Returns
    -------
    Data
        A feature is valid if it is valid in the recording as well as in its twin.
    """
    moved = replace(data, places=[replace(place, mic_pos_m=_moved(data, n, seed))
                                  for n, place in enumerate(data.places)])
    twin_seed = int(rng_for(seed, "loop twins", "seed").integers(2 ** 31))
    measured = map_rendered(lambda model, raw: _recorded(moved, model.n, raw, model.effects, twin_seed), moved,
                            row_models(moved, absorption, effects), seed=twin_seed, nj=nj)
    twins = replace(data, **measured_fields(measured))
    return replace(twins, features=twins.features + np.outer(gains, HAS_GAIN), valid=data.valid & twins.valid)


def _moved(data: Data, n: int, seed: int) -> tuple[float, ...]:
    """Return a microphone's position with the uncertainty of both positions, since only their difference matters."""
    place, rng = data.places[n], rng_for(seed, "loop twins", data.rows[n]["id"])
    for _ in range(_TRIES):
        position_m = np.add(place.mic_pos_m, np.sqrt(2.0) * POSITION_SPREAD_M * rng.standard_normal(3))
        try:
            check_positions(place.room, place.source_pos_m, position_m)
        except ValueError:
            continue
        return tuple(float(x) for x in position_m)
    return place.mic_pos_m


def _recorded(data: Data, n: int, raw: RawRir, effects: Sequence[Effect], seed: int) -> Features:
    """Measure a rendered RIR like a recording of the same length with the same white noise."""
    whole = finished_rir(data, n, raw, effects, seed)
    density = data.white[n] * octave_energies(whole) / (NOISE_S * FS_HZ) / (OCTAVE_WIDTH_HZ / (0.5 * FS_HZ))
    rir, direct_sample, end = on_recording_time(data, n, raw, whole)
    recording = np.sqrt(np.median(density)) * rng_for(seed, "loop twins noise", data.rows[n]["id"]).standard_normal(end)
    recording[:len(rir)] += rir[:end]
    try:
        return measure_features(recording, direct_sample, timed=is_timed(data.rows[n]))
    except ValueError:  # noise that happens to be larger than the recording's hides the direct sound
        features = measure_features(rir[:end], direct_sample, timed=is_timed(data.rows[n]))
        return replace(features, valid=np.zeros_like(features.valid))


def explained(before: HeldOutErrors, after: HeldOutErrors, ceiling: HeldOutErrors) -> dict:
    """Return the share of the explainable error that is explained, ``(before - after) / (before - ceiling)``.

    Returns
    -------
    dict
        By split: `share`, None where `before` exceeds `ceiling` by less than `MIN_EXPLAINABLE_JND`; `ci`, its interval
        of 95 % over rooms (that of a ratio of means; Cochran, Sampling Techniques, 3rd ed., sec. 6.4), None for fewer
        than three rooms; `by_metric` and `by_band`, the same of each metric and octave band; `at_ceiling`, the metrics
        whose error cannot fall further.
    """
    entries = {}
    for split in SPLITS:
        known = np.isfinite(ceiling.by_split[split])
        three = [replace(errors, by_split={split: np.where(known, errors.by_split[split], np.nan)})
                 for errors in (before, after, ceiling)]
        metrics = [*three[2].by_metric(split)]
        in_metrics = {metric: [errors.of_rooms_in(split, METRIC == metric) for errors in three] for metric in metrics}
        in_bands = [[errors.of_rooms_in(split, BAND_OF_FEATURE == band) for errors in three]
                    for band in range(len(BANDS_HZ))]
        entries[split] = dict(
            **_share(*(errors.of_rooms(split) for errors in three)),
            by_metric={metric: _share(*errors) for metric, errors in in_metrics.items()},
            by_band=[_share(*errors) for errors in in_bands],
            at_ceiling=[metric for metric, (_, new, least) in in_metrics.items()
                        if np.nanmean(new - least) < MIN_EXPLAINABLE_JND])
    return entries


def _share(before: FloatArray, after: FloatArray, ceiling: FloatArray) -> dict:
    """Return the explained share and its interval, from errors of rooms, (n_rooms,), NaN where nothing was measured."""
    measured = np.isfinite(before) & np.isfinite(after) & np.isfinite(ceiling)
    fallen, explainable = (before - after)[measured], (before - ceiling)[measured]
    if not len(fallen) or explainable.mean() < MIN_EXPLAINABLE_JND:
        return dict(share=None, ci=None)
    share = float(fallen.mean() / explainable.mean())
    if len(fallen) < 3:
        return dict(share=share, ci=None)
    deviation = (fallen - share * explainable).std(ddof=1) / np.sqrt(len(fallen)) / explainable.mean()
    half = float(stdtrit(len(fallen) - 1, 0.975) * deviation)
    return dict(share=share, ci=[share - half, share + half])


def describe_explained(entry: dict) -> str:
    """Return the explained share of one split as text."""
    if entry["share"] is None:
        return "nothing left to explain"
    interval = f" [{100 * entry['ci'][0]:.0f}, {100 * entry['ci'][1]:.0f}]" if entry["ci"] else ""
    return f"{100 * entry['share']:.0f} %{interval} of the explainable error"
