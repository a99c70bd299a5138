"""A Gaussian mixture over the seven free EQ gains: fitting, keeping, drawing.

A mixture is a dict that goes to JSON and back, never a pickle: `weights` (k,), `means_db` (k, 7),
`covariances_db2` (k, 7, 7), `points_hz` (7,), and `weights_of_room`, which says how the RIRs of each room
are spread over the components.
"""

from pathlib import Path

import numpy as np

from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import read_json
from roomeq.core.rng import rng_for

FREE = tuple(k for k in range(len(BANDS_HZ)) if k != BAND_1KHZ)
"""Indices of the seven points that are free; 1 kHz is the reference."""

POINTS_HZ = [BANDS_HZ[k] for k in FREE]
MAX_DB = 200.0
"""No gain of a mixture comes near it."""

GMM_FILE = "gmm.json"
JND_DB = 1.0
"""Just noticeable difference of EQ [dB]: no component of a mixture is narrower than that."""

REPLICAS = 20  # rows per RIR when rooms are weighted by repeating rows: weights are exact to 5 %


def fit_gmm(vectors_db, rooms, *, n_components=7, weight_rooms=False, seed):
    """Fit the mixture by expectation-maximisation (scikit-learn), the best of ten starts.

    Parameters
    ----------
    vectors_db : ndarray, shape (n, 7)
    rooms : sequence of str
        Room of each vector.
    n_components, weight_rooms, seed
        See `roomeq.eq.fit.fit_eq`.

    Returns
    -------
    dict
        The mixture, JSON-able.

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

    rows = vectors_db
    if weight_rooms:
        n_rows = REPLICAS * len(vectors_db)
        edges = np.floor(np.concatenate([[0.0], np.cumsum(room_weights(rooms))]) * n_rows + 0.5)
        rows = np.repeat(vectors_db, np.diff(edges).astype(int), axis=0)
    state = int(rng_for(seed, "mixture", "start").integers(2 ** 31))
    model = GaussianMixture(n_components, covariance_type="full", reg_covar=JND_DB ** 2, n_init=10,
                            max_iter=500, random_state=state)
    with threadpool_limits(1):  # the order in which threads add up changes the last bits
        model.fit(rows)
        member = model.predict_proba(vectors_db)
    order = np.argsort(-model.weights_, kind="stable")
    rooms = np.asarray(rooms)
    of_room = {str(room): member[rooms == room].mean(axis=0)[order].tolist() for room in np.unique(rooms)}
    return dict(points_hz=POINTS_HZ, reference_hz=BANDS_HZ[BAND_1KHZ], n_rirs=len(vectors_db),
                n_rooms=len(of_room), weight_rooms=bool(weight_rooms), seed=seed,
                weights=model.weights_[order].tolist(), means_db=model.means_[order].tolist(),
                covariances_db2=model.covariances_[order].tolist(), weights_of_room=of_room)


def read_gmm(path):
    """Read a mixture from `gmm.json` or from the directory that holds it.

    Raises
    ------
    ValueError
        The file is no mixture of this kind.
    """
    path = Path(path)
    path = path / GMM_FILE if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"{path}: no such mixture: run fit-eq first")
    gmm = read_json(path)
    try:
        weights, means, full = (np.array(gmm[key], dtype=float)
                                for key in ("weights", "means_db", "covariances_db2"))
        of_rooms = {room: np.array(values, dtype=float) for room, values in gmm.get("weights_of_room", {}).items()}
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path}: not a mixture of fit-eq ({error!r}): run fit-eq again") from None
    k, size = weights.size, len(FREE)
    if weights.shape != (k,) or means.shape != (k, size) or full.shape != (k, size, size):
        raise ValueError(f"{path}: weights {weights.shape}, means {means.shape}, covariances {full.shape} must be "
                         f"(k,), (k, {size}), (k, {size}, {size}): run fit-eq again")
    for name, values in (("weights", weights), *((f"weights of room {room}", of_rooms[room]) for room in of_rooms)):
        if values.shape != (k,) or not np.isclose(values.sum(), 1.0) or np.any(values < 0):
            raise ValueError(f"{path}: {name} must be {k} numbers from 0 that sum to 1: run fit-eq again")
    if gmm.get("points_hz", POINTS_HZ) != POINTS_HZ:
        raise ValueError(f"{path}: points_hz={gmm['points_hz']} must be {POINTS_HZ}: run fit-eq again")
    if not np.all(np.abs(means) < MAX_DB) or not np.all(np.abs(full) < MAX_DB ** 2) or not _positive(full):
        raise ValueError(f"{path}: means must be below {MAX_DB:g} dB and covariances positive definite: "
                         "run fit-eq again")
    return gmm


def _positive(covariances):
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        return False
    return np.allclose(covariances, covariances.transpose(0, 2, 1))


def sample_eq(gmm, n, rng, *, weights=None):
    """Draw EQs from a mixture.

    Parameters
    ----------
    gmm : dict
        See `fit_gmm`.
    n : int
    rng : numpy.random.Generator
    weights : sequence of float, optional
        Weights of the components, if not the mixture's own.

    Returns
    -------
    vectors_db : ndarray, shape (n, 7)
    """
    weights = np.array(gmm["weights"] if weights is None else weights)
    means, full = np.array(gmm["means_db"]), np.array(gmm["covariances_db2"])
    component = np.minimum(np.searchsorted(np.cumsum(weights), rng.random(n), side="right"), len(weights) - 1)
    factors = np.linalg.cholesky(full)
    noise = rng.standard_normal((n, len(FREE)))
    return means[component] + np.einsum("nij,nj->ni", factors[component], noise)


def draw_target(gmm, seed, rir_id, room_id=None, *, what="EQ target"):
    """Draw the EQ target of one RIR: the same whatever is drawn for others.

    Parameters
    ----------
    gmm : dict
        See `fit_gmm`.
    seed : int
    rir_id : str
    room_id : str, optional
        Choose among the components as this room's measured RIRs are spread over them. A room that was not measured
        has the mixture's own weights.
    what : str
        Purpose of the draw.

    Returns
    -------
    vector_db : ndarray, shape (7,)
    """
    weights = gmm.get("weights_of_room", {}).get(room_id)
    return sample_eq(gmm, 1, rng_for(seed, what, rir_id), weights=weights)[0]


def with_reference(vector_db):
    """The eight points of seven free gains: 0 dB at 1 kHz goes between them, shape (8,)."""
    return np.insert(np.asarray(vector_db, dtype=np.float64), BAND_1KHZ, 0.0)


def room_weights(rooms):
    """Weights that let rooms count equally; they sum to 1."""
    names, index, counts = np.unique(np.asarray(rooms), return_inverse=True, return_counts=True)
    return 1.0 / (counts[index] * len(names))
