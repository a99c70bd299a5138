"""A model about a point: derivatives of all features, whitened, as the normal equations of each room."""

import numpy as np

from roomeq.loop.features import HAS_GAIN, METRIC, N_FEATURES
from roomeq.loop.packing import N_SURFACE
from roomeq.loop.predict import N_BANDS, Reflected

_STEP = 0.03  # of numerical derivatives, in units of a vector's spread
_HUBER = 3.0
_SIGMA = (0.7, 12.0)
_OMEGA = (0.2, 12.0)


def linearise(packing, mean, local, correction, by_band=None):
    """Predicted features and their derivatives: by surfaces (n_rirs, n_features, 16) and by each effect's vector."""
    absorption, vectors = packing.absorption(mean, local), packing.vectors(mean, local)
    gains = packing.gains(local)
    reflected = Reflected(packing.data, packing.state(absorption, vectors))
    centre = packing.predict(absorption, vectors, gains, correction, reflected)
    known = by_band is not None
    by_band = by_band if known else np.empty((*centre.shape, N_SURFACE))
    for n in range(0 if known else N_SURFACE):
        moved = absorption.copy()
        step = (1.0, 1.0) if n < N_BANDS else (-0.5, 0.5)
        moved[:, :, n % N_BANDS] *= np.exp(_STEP * np.array(step))
        by_band[:, :, n] = (packing.predict(moved, vectors, gains, correction) - centre) / _STEP
    by_effect = []
    for k, effect in enumerate(packing.effects):
        found = np.empty((*centre.shape, len(effect.SPREAD)))
        for p, spread in enumerate(effect.SPREAD):
            moved = [one.copy() for one in vectors]
            moved[k][:, p] += _STEP * spread
            same = None if effect.REFLECTIONS else reflected
            found[:, :, p] = (packing.predict(absorption, moved, gains, correction, same) - centre) / (_STEP * spread)
        by_effect.append(found)
    return centre, (by_band, by_effect)


def _derivatives(packing, r, slopes):
    """Derivatives of a room's RIRs by its own and by the shared unknowns."""
    index, (by_band, by_effect) = packing.members[r], slopes
    slices, size = packing.own_slices[r]
    own = np.zeros((len(index), N_FEATURES, size))
    shared = np.zeros((len(index), N_FEATURES, packing.n_shared))
    own[:, :, :N_SURFACE] = shared[:, :, :N_SURFACE] = by_band[index]
    parts = packing.gain_of[r]
    own[:, :, N_SURFACE:N_SURFACE + parts.shape[1]] = HAS_GAIN[:, None] * parts[:, None, :]
    for k, effect in enumerate(packing.effects):
        part, _, unit, n = packing.shared[k]
        if effect.SCOPE == "room":
            own[:, :, slices[k]] = shared[:, :, part] = by_effect[k][index]
        elif effect.SCOPE == "rir":
            shared[:, :, part] = by_effect[k][index]
            for i, rir in enumerate(index):
                at = slices[k].start + n * int(np.searchsorted(packing.members[r], rir))
                own[i, :, at:at + n] = by_effect[k][rir]
        else:
            for i, rir in enumerate(index):
                at = part.start + unit[rir] * n
                shared[i, :, at:at + n] = by_effect[k][rir]
    return own, shared


def _whiten(columns, valid, sigma, omega):
    """Make features of a room independent and of unit scatter, shape (n_rirs, n_features, n); invalid ones 0."""
    count = valid.sum(axis=0)
    columns = np.where(valid[:, :, None], columns, 0.0)
    mean = columns.sum(axis=0) / np.maximum(count, 1)[:, None]
    part = 1.0 - sigma / np.sqrt(sigma ** 2 + count * omega ** 2)
    return np.where(valid[:, :, None], columns - part[:, None] * mean, 0.0) / sigma[:, None]


def misfit(residual, valid, sigma, omega):
    """Sum of the squares of a room's whitened residual, shape (n_rirs, n_features); large ones count linearly (Huber)."""
    limit = _HUBER * np.sqrt(sigma ** 2 + omega ** 2)
    size = np.abs(np.where(valid, residual, 0.0))
    root = np.where(size < limit, size, np.sqrt(limit * np.maximum(2.0 * size - limit, 0.0)))
    return float(np.sum(_whiten((np.sign(residual) * root)[:, :, None], valid, sigma, omega) ** 2))


def normal_equations(packing, r, residual, valid, slopes, sigma, omega):
    index = packing.members[r]
    own, shared = _derivatives(packing, r, slopes)
    error, ok = residual[index], valid[index]
    spread = np.sqrt(sigma ** 2 + omega ** 2)
    weight = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(np.where(ok, error, 0.0)), 1e-9)))
    stacked = np.concatenate([own, shared, np.where(ok, error, 0.0)[:, :, None]], axis=2) * weight[:, :, None]
    white = _whiten(stacked, ok, sigma, omega).reshape(-1, stacked.shape[2])
    product = white.T @ white
    n = own.shape[2]
    count = ok.sum(axis=0)
    log_scale = np.sum(np.maximum(count - 1, 0) * np.log(sigma)
                       + np.where(count > 0, 0.5 * np.log(sigma ** 2 + count * omega ** 2), 0.0))
    return (product[:n, :n], product[:n, n:-1], product[n:-1, n:-1], product[:n, -1], product[n:-1, -1],
            product[-1, -1], log_scale)


def scatter(data, residual, valid):
    """Scatter of features within and between rooms, shape (n_features,) each, shrunk to what their metric has."""
    clipped = np.where(valid, np.clip(residual, -15.0, 15.0), np.nan)
    rooms = [clipped[data.room == r] for r in range(len(data.room_names)) if np.any(data.room == r)]
    count = np.array([np.isfinite(one).sum(axis=0) for one in rooms])
    total = np.array([np.nansum(one, axis=0) for one in rooms])
    square = np.array([np.nansum(one ** 2, axis=0) for one in rooms])
    mean = total / np.maximum(count, 1)
    within = np.maximum(np.sum(square - count * mean ** 2, axis=0), 0.0)  # rounding may take equal features below 0
    freedom = np.sum(np.maximum(count - 1, 0), axis=0)
    between = np.sum(count * mean ** 2, axis=0) - np.sum(count > 0, axis=0) * within / np.maximum(freedom, 1)
    sigma2, omega2 = np.empty(N_FEATURES), np.empty(N_FEATURES)
    for metric in np.unique(METRIC):
        at = METRIC == metric
        typical = within[at].sum() / max(freedom[at].sum(), 1.0)
        sigma2[at] = (within[at] + 8.0 * typical) / (freedom[at] + 8.0)
        usual = max(between[at].sum(), 0.0) / max(count[:, at].sum(), 1.0)
        omega2[at] = (np.maximum(between[at], 0.0) + 16.0 * usual) / (count[:, at].sum(axis=0) + 16.0)
    return np.clip(np.sqrt(sigma2), *_SIGMA), np.clip(np.sqrt(omega2), *_OMEGA)
