"""A Gaussian mixture over the seven free EQ gains: fit it, read it, draw from it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import read_json
from roomeq.core.rng import rng_for

FREE = tuple(k for k in range(len(BANDS_HZ)) if k != BAND_1KHZ)
"""Indices of the seven points that are free; 1 kHz is the reference."""

POINTS_HZ = [BANDS_HZ[k] for k in FREE]
MAX_DB = 200.0
"""Bound on the means of a mixture [dB]; no gain of a room comes near it."""

GMM_FILE = "gmm.json"
JND_DB = 1.0
"""Just noticeable difference of EQ [dB]. The standard deviation of a component is at least this large in any
direction."""

REPLICAS = 20  # rows per RIR when rooms are weighted by repeating rows: weights are exact to 5 %


class Gmm(TypedDict):
    """A Gaussian mixture as `gmm.json` holds it; k components."""

    points_hz: list[float]
    reference_hz: float
    n_rirs: int
    n_rooms: int
    weight_rooms: bool
    seed: int
    weights: list[float]
    """Shape (k,)."""
    means_db: list[list[float]]
    """Shape (k, 7)."""
    covariances_db2: list[list[list[float]]]
    """Shape (k, 7, 7)."""
    weights_of_room: dict[str, list[float]]
    """Mean responsibilities of the components for the RIRs of each room, shape (k,)."""


def fit_gmm(vectors_db: FloatArray, rooms: Sequence[str], *, n_components: int = 7, weight_rooms: bool = False,
            seed: int) -> Gmm:
    """Fit a mixture of full-covariance components by expectation-maximisation (scikit-learn), the best of ten starts.

    Parameters
    ----------
    vectors_db : ndarray, shape (n, 7)
    rooms
        Room of each vector.
    n_components, weight_rooms, seed
        See `roomeq.eq.steps.fit_eq`.

    Raises
    ------
    ValueError
        Fewer vectors than components.
    """
    vectors_db = np.asarray(vectors_db, dtype=np.float64)
    if len(vectors_db) < n_components:
        raise ValueError(f"{len(vectors_db)} measured RIRs must be at least the mixture's {n_components} "
                         "components: give more or ask for fewer")
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    rows = np.repeat(vectors_db, 2, axis=0) if len(vectors_db) == 1 else vectors_db  # scikit-learn refuses a single row
    if weight_rooms:
        n_rows = REPLICAS * len(vectors_db)
        edges = np.floor(np.concatenate([[0.0], np.cumsum(room_weights(rooms))]) * n_rows + 0.5)
        rows = np.repeat(vectors_db, np.diff(edges).astype(int), axis=0)
    random_state = int(rng_for(seed, "mixture", "start").integers(2 ** 31))
    model = GaussianMixture(n_components, covariance_type="full", reg_covar=JND_DB ** 2, n_init=10,
                            max_iter=500, random_state=random_state)
    with threadpool_limits(1):  # sums over threads differ in their last bits
        model.fit(rows)
        responsibilities = model.predict_proba(vectors_db)
    order = np.argsort(-model.weights_, kind="stable")
    room_of = np.asarray(rooms)
    weights_of_room = {str(room): responsibilities[room_of == room].mean(axis=0)[order].tolist()
                       for room in np.unique(room_of)}
    return Gmm(points_hz=POINTS_HZ, reference_hz=BANDS_HZ[BAND_1KHZ], n_rirs=len(vectors_db),
                n_rooms=len(weights_of_room), weight_rooms=bool(weight_rooms), seed=seed,
                weights=model.weights_[order].tolist(), means_db=model.means_[order].tolist(),
                covariances_db2=_with_floor(model.covariances_[order]).tolist(), weights_of_room=weights_of_room)


def _with_floor(covariances_db2: FloatArray) -> FloatArray:
    """Return covariances without what scikit-learn added to their diagonals, and with eigenvalues of at least JND².

    The addition keeps components from collapsing onto single RIRs, but would make every component wider.
    """
    values, vectors = np.linalg.eigh(covariances_db2)
    values = np.maximum(values - JND_DB ** 2, JND_DB ** 2)
    return np.einsum("kij,kj,klj->kil", vectors, values, vectors)


def read_gmm(path: Path | str) -> Gmm:
    """Read a mixture from `gmm.json` or from the directory that holds it.

    Raises
    ------
    ValueError
        The file is missing, or does not hold a mixture over the seven free points.
    """
    path = Path(path)
    path = path / GMM_FILE if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"{path}: no such mixture: run fit-eq first")
    gmm = read_json(path)
    try:
        weights, means, covariances = (np.array(gmm[key], dtype=float)
                                       for key in ("weights", "means_db", "covariances_db2"))
        weights_of_room = {room: np.array(values, dtype=float)
                           for room, values in gmm.get("weights_of_room", {}).items()}
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path}: not a mixture of fit-eq ({error!r}): run fit-eq again") from None
    k, size = weights.size, len(FREE)
    if weights.shape != (k,) or means.shape != (k, size) or covariances.shape != (k, size, size):
        raise ValueError(f"{path}: weights {weights.shape}, means {means.shape}, covariances {covariances.shape} must "
                         f"be (k,), (k, {size}), (k, {size}, {size}): run fit-eq again")
    for name, values in (("weights", weights), *((f"weights of room {room}", of_room)
                                                 for room, of_room in weights_of_room.items())):
        if values.shape != (k,) or not np.isclose(values.sum(), 1.0) or np.any(values < 0):
            raise ValueError(f"{path}: {name} must be {k} numbers from 0 that sum to 1: run fit-eq again")
    if gmm.get("points_hz", POINTS_HZ) != POINTS_HZ:
        raise ValueError(f"{path}: points_hz={gmm['points_hz']} must be {POINTS_HZ}: run fit-eq again")
    if not (np.all(np.abs(means) < MAX_DB) and np.all(np.abs(covariances) < MAX_DB ** 2)
            and _positive_definite(covariances)):
        raise ValueError(f"{path}: means must be below {MAX_DB:g} dB and covariances positive definite: "
                         "run fit-eq again")
    return gmm


def _positive_definite(covariances: FloatArray) -> bool:
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        return False
    return bool(np.allclose(covariances, covariances.transpose(0, 2, 1)))


def sample_eq(gmm: Gmm, n: int, rng: np.random.Generator, *, weights: Sequence[float] | None = None) -> FloatArray:
    """Draw `n` EQs from a mixture.

    Parameters
    ----------
    weights
        Weights of the components; the mixture's own by default.

    Returns
    -------
    vectors_db : ndarray, shape (n, 7)
    """
    cumulative = np.cumsum(gmm["weights"] if weights is None else weights)
    component = np.minimum(np.searchsorted(cumulative, rng.random(n), side="right"), len(cumulative) - 1)
    factors = np.linalg.cholesky(np.array(gmm["covariances_db2"]))
    noise = rng.standard_normal((n, len(FREE)))
    return np.array(gmm["means_db"])[component] + np.einsum("nij,nj->ni", factors[component], noise)


def draw_target(gmm: Gmm, seed: int, rir_id: str, room_id: str | None = None, *,
                purpose: str = "EQ target") -> FloatArray:
    """Draw the EQ target of one RIR. The draw depends on the seed, the purpose and `rir_id` alone.

    Parameters
    ----------
    room_id
        Weight the components as in the measured RIRs of this room. A room that was not measured has the mixture's own
        weights, and so has None.
    purpose
        Draws with different purposes are independent.

    Returns
    -------
    vector_db : ndarray, shape (7,)
    """
    weights = gmm.get("weights_of_room", {}).get(room_id) if room_id is not None else None
    return sample_eq(gmm, 1, rng_for(seed, purpose, rir_id), weights=weights)[0]


def with_reference(vector_db: FloatArray | Sequence[float]) -> FloatArray:
    """Insert 0 dB at 1 kHz into seven free gains; shape (8,)."""
    return np.insert(np.asarray(vector_db, dtype=np.float64), BAND_1KHZ, 0.0)


def room_weights(rooms: Sequence[str] | np.ndarray) -> FloatArray:
    """Return a weight for each RIR so that rooms weigh the same; the weights sum to 1."""
    names, index, counts = np.unique(np.asarray(rooms), return_inverse=True, return_counts=True)
    return 1.0 / (counts[index] * len(names))
