"""A small synthetic loop directory for tests of its readers: written by the real writers, with invented numbers."""

import numpy as np

from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.build import Build
from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import write_json
from roomeq.core.rng import rng_for
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import MODEL_FILE, Extension, Model, write_model
from roomeq.effects.response import RESPONSE_HZ
from roomeq.loop.acceptance import OTHER_DEVICES
from roomeq.loop.examples import DECAY_BANDS, EXAMPLES_FILE, KINDS, LENGTH_S, N_SAMPLES, STEP_S
from roomeq.loop.features import METRIC, N_FEATURES, REGION
from roomeq.loop.heldout_errors import SPLITS
from roomeq.loop.ledger import LEDGER_FILE, RESIDUALS_FILE
from roomeq.loop.ledger_checks import LEDGER_FORMAT
from roomeq.records.geometry import MARKED

LEFT_OUT = [dict(reason="the room's dimensions are unknown", rirs=7, rooms=2), dict(reason=MARKED, rirs=3, rooms=3)]
GEOMETRY = [dict(room="hall", quantity="height of the room", unit="m", prior=[2.86, 0.2], posterior=[2.73, 0.03],
                 documented=2.86, evidence=1.9, used=True),
            dict(room="hall", quantity="height of source s", unit="m", prior=[1.3, 0.35], posterior=[1.52, 0.04],
                 documented=None, evidence=0.4, used=True),
            dict(room="office", quantity="width of the room", unit="m", prior=[5.0, 0.15], posterior=[5.01, 0.02],
                 documented=5.0, evidence=-0.7, used=False)]
FACINGS = [dict(source="s", rirs=12, positions=3, hypothesis="fixed", evidence=dict(fixed=21.0, free=15.5),
                angle_deg=114.0)]
N_RIRS, ROOMS = 24, ("hall", "office", "<b>attic")
VECTORS = dict(source_response=5.0 * np.sin(np.arange(len(RESPONSE_HZ)) / 3.0),
               near_reflector=np.array([np.log(0.7), 0.6]))


def errors(mean):
    """Return an entry of held-out errors."""
    entry = dict(error=mean, ci=[mean - 0.3, mean + 0.3], by_metric={metric: mean for metric in dict.fromkeys(METRIC)},
                 by_band=[None, *[mean] * (len(BANDS_HZ) - 1)])
    return {split: dict(entry) for split in SPLITS}


def explained(share):
    """Return the explained share as of the ledger."""
    known = dict(share=share, ci=[share - 0.2, share + 0.2])
    entry = dict(**known, at_ceiling=["t30", "c50"], by_metric=dict.fromkeys(METRIC, known),
                 by_band=[dict(share=None, ci=None), *[known] * (len(BANDS_HZ) - 1)])
    return {split: dict(entry) for split in SPLITS}


def ranking(winner, gain):
    """Return a ranking whose winner helps."""
    return [dict(effect=name, gain=value, ci=[value / 3 - 2.0, value / 3 + 2.0], p=0.001 if name == winner else 0.6,
                 size_jnd=2.0) for name, value in ((winner, gain), ("noise_floor", 1.0), ("coupled_volume", -4.0))]


def undetected(winner, gain):
    """Return the last ranking, with the sizes that would have been found."""
    entries = [entry | dict(detectable_jnd=size_jnd,
                            would_show=CATALOGUE[entry["effect"]].DISCRIMINATING_MEASUREMENT)
               for entry, size_jnd in zip(ranking(winner, gain), (0.5, 0.7, None), strict=True)]
    entries[0]["rejected"] = dict(reason=OTHER_DEVICES, rendered=True, p=0.01, p_by_split=dict.fromkeys(SPLITS, 0.02),
                                  touched_fall=dict.fromkeys(SPLITS, 0.1), p_other_devices=0.4)
    return entries


def extension(name, units):
    """Return an effect with the same parameters for some units."""
    effect = CATALOGUE[name]
    return Extension(effect, {unit: effect.from_vector(VECTORS[name]) for unit in units}, VECTORS[name],
                     np.zeros(len(VECTORS[name])))


def iteration(added, before, after, **more):
    """Return the entry of an accepted effect."""
    rooms = added.effect.SCOPE == "room"
    best = {unit: {"best": vars(effect)} | ({} if rooms else {"low": vars(effect), "high": vars(effect)})
            for unit, effect in added.of.items()}
    whole = {"before": errors(before)[SPLITS[0]], "after": errors(after)[SPLITS[0]]}
    return dict(effect=added.effect.NAME, scope=added.effect.SCOPE, size_jnd=2.5, parameters=best,
                scored_on=SPLITS[0], heldout_error_before=before, heldout_error_after=after,
                heldout_error_ci=[after - 0.3, after + 0.3],
                fall_ci=[before - after - 0.2, before - after + 0.2], p=1e-4,
                p_by_split=dict.fromkeys(SPLITS, 1e-3), touched_fall=dict.fromkeys(SPLITS, 0.3), p_other_devices=None,
                ranking=ranking(added.effect.NAME, 90.0),
                by_metric={when: entry["by_metric"] for when, entry in whole.items()},
                by_band={when: entry["by_band"] for when, entry in whole.items()}) | more


def make_loop(out):
    """Make a loop directory as `roomeq close-loop` does."""
    added = [extension("source_response", ("spk1", "<i>spk2")), extension("near_reflector", ROOMS)]
    unexplained = dict(metric="ahead", time_region=REGION["ahead"], bands_hz=[125.0], varies_with="nothing",
                       size_jnd=3.5, p=0.01)
    ledger = dict(
        format=LEDGER_FORMAT, rirs=N_RIRS, rooms=len(ROOMS), scored_rirs=N_RIRS, scored_rooms=len(ROOMS),
        left_out=LEFT_OUT, geometry=GEOMETRY, facings=FACINGS, given=[],
        baseline=errors(3.4), final=errors(1.5), ceiling=errors(1.0), explained=explained(0.79),
        ranking=undetected("room_eq", 0.5),
        iterations=[iteration(added[0], 3.4, 1.9, cannot_tell=["source_response", "mic_response"],
                              would_tell=["a recording of the same room with another loudspeaker"]),
                    iteration(added[1], 1.9, 1.5)],
        unexplained=unexplained, unexplained_all=[unexplained],
        test=dict(rirs=8, rooms=1, scored_rirs=8, scored_rooms=1, left_out=LEFT_OUT[1:], geometry=[], facings=[],
                  measured=[], before=errors(3.6), after=errors(1.8), ceiling=errors(1.1), explained=explained(0.72)))
    for when in ("before", "after", "ceiling", "explained"):
        for entry in ledger["test"][when].values():
            entry["ci"] = None  # a test set of a single room
    rng = rng_for(0, "made-up residuals", "")
    before = 3.0 + rng.standard_normal((N_RIRS, N_FEATURES))
    before[rng.random(before.shape) < 0.2] = np.nan
    n_times = round(LENGTH_S / STEP_S)
    decay_db = np.tile(-60.0 * np.arange(n_times) * STEP_S / 0.6, (2, len(KINDS), len(DECAY_BANDS), 1))
    rirs = rng.standard_normal((2, len(KINDS), N_SAMPLES)) * np.exp(-np.arange(N_SAMPLES) / 1e3)
    build = Build(out, step="close-loop", options=dict(max_effects=4, seed=0), inputs=[])

    def assemble(directory, _):
        write_json(directory / LEDGER_FILE, ledger)
        write_model(directory / MODEL_FILE, Model(tuple(added[::-1])))
        np.savez_compressed(directory / RESIDUALS_FILE, before=before, after=0.5 * before)
        np.savez_compressed(directory / EXAMPLES_FILE, ids=np.array(["r1", "r<2>"]), rooms=np.array(ROOMS[1:]),
                            decay_db=decay_db, spectrum_db=rng.standard_normal((2, len(KINDS), len(SPECTRUM_HZ))),
                            rirs=rirs)

    build.run({}, lambda name, item: None)
    build.finish(assemble)
    return out
