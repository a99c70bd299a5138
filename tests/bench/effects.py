"""Effects: the change of each feature that the loop predicts against the change that rendering shows.

    python tests/bench/effects.py --out exp/bench

Every effect of the catalogue is switched on, at a realistic size, in three rooms with four microphones each, drawn
three times: other positions, rays and tails, on which a median over twelve RIRs depends as much as on the prediction.
For each feature the deviation is |predicted change - rendered change| in just noticeable differences (JND).
`effects.json` holds the median over RIRs of each band, and for each metric the largest of these medians and the worst
single deviation.
`tests/integration/test_effects_contract.py` holds the medians to limits.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / name) for name in ("", "data")]

from rirmaker import DIRECT, coloured_rir  # noqa: E402

from bench.kit import machine, plain, table  # noqa: E402
from roomeq.core.arrays import FloatArray  # noqa: E402
from roomeq.core.audio import write_wav  # noqa: E402
from roomeq.core.constants import FS_HZ  # noqa: E402
from roomeq.effects.base import Effect  # noqa: E402
from roomeq.effects.catalogue import CATALOGUE  # noqa: E402
from roomeq.effects.response import RESPONSE_HZ  # noqa: E402
from roomeq.loop.data import Data, load_data  # noqa: E402
from roomeq.loop.features import BAND_HZ, METRIC  # noqa: E402
from roomeq.loop.predict import base_state, predict  # noqa: E402
from roomeq.loop.rendering import RawRir, measure_row, render_rows, row_models  # noqa: E402
from roomeq.loop.usable import Located, UsableRirs  # noqa: E402
from roomeq.records.rir_dir import write_rirs  # noqa: E402
from roomeq.sim.scene import Air  # noqa: E402

ROOMS_M = {"office": (4.2, 3.4, 2.6), "classroom": (8.3, 6.1, 3.1), "hall": (14.7, 10.2, 5.3)}
MICS = 4  # in each room
FACING_RAD = (0.0, 0.4, 0.9, 1.5)  # between the source's axis and the direct sound, in plan
DECAY_S = 0.8  # of the recordings that stand for measured ones; it sets how long rooms are traced
ABSORPTION = (0.12, 0.14, 0.16, 0.18, 0.2, 0.22, 0.25, 0.28)  # -ln(1 - alpha) of walls, per octave
FLOOR_FACTOR = 1.3  # absorption of floor and ceiling over that of walls
SCATTERING = 0.3
SEEDS = (0, 1, 2)  # each draws positions, rays and tails
MIN_RIRS = 12  # that have a feature, for its median to be taken
MIN_RMS_JND = 0.7  # predicted change of a metric from which its slope says something

_TILT_DB = np.linspace(-6.0, 6.0, len(RESPONSE_HZ))
_RIPPLE_DB = 6.0 * np.sin(np.linspace(0.0, 5.0, len(RESPONSE_HZ)))
VECTORS: dict[str, ArrayLike] = {
    "air_absorption": (1.0, np.log(20.0)),  # 10 degrees, 20 % humidity; declared are 20 degrees and 50 %
    "sound_speed": (3.2,),  # 32 degrees
    "source_directivity": (*np.log([0.12, 0.6]), *[0.0] * 24),  # a cabinet of 12 cm radius, a membrane of 7 cm
    "occlusion": (np.log(0.03),),  # a detour of 3 cm: a person's head
    "near_reflector": (np.log(0.35), 0.6),  # a desk 35 cm below
    "coupled_volume": (-2.1, np.log(1.8), 0.1),  # -21 dB, 1.8 s: a corridor
    "room_modes": (np.log2(1.1),),  # up to 110 Hz, between two points of the grid
    "source_response": _RIPPLE_DB,
    "mic_response": -_RIPPLE_DB,
    "room_eq": _TILT_DB,
    "noise_floor": (1.5,) * 22,  # 15 dB above what is inaudible
}
"""Vector of each effect, of realistic size."""


@dataclass(frozen=True)
class Change:
    """Change of the features by an effect.

    Attributes
    ----------
    predicted, rendered : ndarray, shape (n_rirs, n_features)
        In JND; `rendered` is NaN where a feature cannot be measured with or without the effect.
    """

    predicted: FloatArray
    rendered: FloatArray


class Deviation(NamedTuple):
    """Deviation of the predicted from the rendered change of a metric [JND]."""

    median: float
    """The largest of the medians over RIRs in each band; NaN where no band has `MIN_RIRS`."""
    worst: float
    """The largest of all RIRs and bands."""
    slope: float
    """Least-squares slope of rendered over predicted changes; NaN where less than `MIN_RMS_JND` is predicted."""
    by_band: dict[float, float]
    """Median over RIRs of each band, by its frequency [Hz]; 0 for the whole band."""


def make_data(directory: Path, seed: int) -> Data:
    """Write recordings of `ROOMS_M` and load them: the loop's data, in traced rooms."""
    rng, rows = np.random.default_rng(seed), []
    for room_id, dims_m in ROOMS_M.items():
        source_m = np.array(dims_m) * [0.28, 0.36, 0.0] + [0.0, 0.0, 1.4]
        for n in range(MICS):
            mic_m = source_m
            while np.linalg.norm(mic_m - source_m) < 1.0:
                mic_m = np.array([*rng.uniform(0.2, 0.85, 2) * dims_m[:2], rng.uniform(1.0, 1.8)])
            angle = np.arctan2(*(mic_m - source_m)[1::-1]) + FACING_RAD[n]
            rir, rir_id = coloured_rir(n, time_s=DECAY_S, length_s=1.5), f"{room_id}-{n}"
            flight = round(np.linalg.norm(mic_m - source_m) / Air(20.0, 50.0).speed_m_s * FS_HZ)
            rir = np.concatenate([np.zeros(max(0, flight - DIRECT)), rir[max(0, DIRECT - flight):]])
            write_wav(directory / f"{rir_id}.wav", 0.1 * rir)
            rows.append(dict(
                id=rir_id, wav=f"{rir_id}.wav", room_id=room_id, source_id="loudspeaker", mic_id="microphone",
                fs_hz=FS_HZ, n_samples=len(rir), room_dims_m=list(dims_m), source_pos_m=source_m.round(3).tolist(),
                mic_pos_m=mic_m.round(3).tolist(), source_dir=[float(np.cos(angle)), float(np.sin(angle)), 0.0],
                temperature_c=20.0, humidity_pct=50.0, tof_removed=False))
    rows.sort(key=lambda row: row["id"])
    write_rirs(directory, rows)
    # the rooms have the same recordings, which `usable_rirs` would take for copies
    return load_data(UsableRirs([Located(directory, row) for row in rows], []), scattering=SCATTERING, seed=seed)


def measure_changes(vectors: dict[str, ArrayLike] = VECTORS) -> dict[str, Change]:
    """Measure the predicted and the rendered change of the features by each effect, of the RIRs of all seeds."""
    of_seeds = []
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as directory:
            of_seeds.append(_measure_changes(make_data(Path(directory), seed), seed, vectors))
    return {name: Change(*(np.concatenate([getattr(changes[name], part) for changes in of_seeds])
                           for part in ("predicted", "rendered"))) for name in vectors}


def _measure_changes(data: Data, seed: int, vectors: dict[str, ArrayLike]) -> dict[str, Change]:
    absorption = np.tile([ABSORPTION, np.multiply(ABSORPTION, FLOOR_FACTOR)], (len(data.room_names), 1, 1))
    rows = np.arange(len(data.rows))

    def render(effects: list[Effect]) -> tuple[list[RawRir], FloatArray]:
        raw_rirs, _ = render_rows(data, row_models(data, absorption, [effects] * len(rows)), seed=seed)
        return raw_rirs, measure(raw_rirs, effects)

    def measure(raw_rirs: list[RawRir], effects: list[Effect]) -> FloatArray:
        measured = [measure_row(data, n, raw_rirs[n], effects, seed) for n in rows]
        return np.array([np.where(features.valid, features.values, np.nan) for features in measured])

    def predict_with(effects: list[Effect]) -> FloatArray:
        state = base_state(data, absorption)
        for effect in effects:
            effect.apply_to_prediction(state, data, rows)
        return predict(data, state)

    raw_rirs, plain_features = render([])
    for effect in (CATALOGUE[name] for name in vectors):
        # the prediction of an effect that acts on waves interpolates between renderings
        on_grid = [measure(raw_rirs, [effect.from_vector(point)]) for point in effect.INTERPOLATION_GRID]
        if on_grid:
            change = np.nan_to_num(np.array(on_grid) - plain_features)
            data = replace(data, rendered_changes={**data.rendered_changes, effect.NAME: change})
    changes = {}
    for name, vector in vectors.items():
        effects = [CATALOGUE[name].from_vector(vector)]
        changes[name] = Change(predict_with(effects) - predict_with([]), render(effects)[1] - plain_features)
    return changes


def deviation(change: Change, metric: str) -> Deviation:
    """Compare the predicted with the rendered change of a metric."""
    at = METRIC == metric
    predicted, rendered = change.predicted[:, at], change.rendered[:, at]
    seen = np.isfinite(rendered)
    enough = seen.sum(axis=0) >= MIN_RIRS
    seen &= enough
    size = np.abs(predicted - rendered)
    by_band = {float(hz): float(np.median(size[seen[:, n], n]))
               for n, hz in enumerate(BAND_HZ[at]) if enough[n]}
    if not by_band:
        return Deviation(np.nan, np.nan, np.nan, {})
    product, power = np.sum((predicted * rendered)[seen]), np.sum(predicted[seen] ** 2)
    slope = float(product / power) if np.sqrt(power / seen.sum()) >= MIN_RMS_JND else np.nan
    return Deviation(max(by_band.values()), float(size[seen].max()), slope, by_band)


METRICS = tuple(dict.fromkeys(METRIC.tolist()))


def print_table(deviations: dict[str, dict[str, Deviation]]) -> None:
    """Print median and worst deviation by effect and metric."""
    print("largest median over RIRs of a band / worst single deviation of the predicted from the rendered change [JND]")
    print(table(["effect", *METRICS], [
        [name, *("-" if np.isnan(one.median) else f"{one.median:.2f}/{one.worst:.1f}" for one in of_effect.values())]
        for name, of_effect in deviations.items()]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"), metavar="DIR", help="where effects.json goes")
    out = parser.parse_args().out
    changes = measure_changes()
    deviations = {name: {metric: deviation(change, metric) for metric in METRICS} for name, change in changes.items()}
    print_table(deviations)
    out.mkdir(parents=True, exist_ok=True)
    content = dict(bench="effects", machine=machine(), unit="JND", deviations={
        name: {metric: one._asdict() for metric, one in of_effect.items()} for name, of_effect in deviations.items()})
    (out / "effects.json").write_text(json.dumps(plain(content), indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
