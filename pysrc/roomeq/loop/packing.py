"""Where each unknown of a model stands, and what features follow from them.

Conventions
-----------
A chain of room, source and microphone that several RIRs share has a gain of its own. Where it occurs once - some
corpora number places instead of devices - an RIR that is left out would know nothing of it: its gain is a sum of one
of the room, one of the source there and one of the microphone there.
"""

import numpy as np

from roomeq.loop.features import HAS_GAIN
from roomeq.loop.predict import N_BANDS, base_state, predict

OWN = ("room", "rir")  # scopes whose vectors belong to one room alone
N_SURFACE = 2 * N_BANDS
"""Unknowns of the surfaces: absorption per band, and the contrast of floor and ceiling to the walls."""


GAINS = ("whole", "source", "mic")
"""Kinds of gains: of a chain or a room, and by how much a source and a microphone differ from it."""


class ParameterIndex:
    """Where each unknown stands."""

    def __init__(self, data, effects):
        self.data, self.effects = data, tuple(effects)
        self.shared, start = [], N_SURFACE
        for effect in self.effects:
            names, unit = data.units(effect.SCOPE)
            size = len(effect.SPREAD)
            count = 1 if effect.SCOPE in OWN else len(names)
            self.shared.append((slice(start, start + count * size), count, unit, size))
            start += count * size
        self.n_shared = start
        self.own_slices = []
        self.members = [np.flatnonzero(data.room == r) for r in range(len(data.room_names))]
        self.gain_of, self.gain_kind = zip(*[_gains(data, members) for members in self.members], strict=True)
        for kinds, members in zip(self.gain_kind, self.members, strict=True):
            at, slices = N_SURFACE + len(kinds), []
            for effect in self.effects:
                size = len(effect.SPREAD) * {"room": 1, "rir": len(members)}.get(effect.SCOPE, 0)
                slices.append(slice(at, at + size))
                at += size
            self.own_slices.append((slices, at))

    def vectors(self, mean, local):
        """Vector of each effect for each unit: list of arrays, shape (n_units, n)."""
        found = []
        for k, effect in enumerate(self.effects):
            part, count, _, size = self.shared[k]
            if effect.SCOPE == "room":
                found.append(np.array([mean[part] + local[r][self.own_slices[r][0][k]]
                                       for r in range(len(local))]).reshape(len(local), size))
            elif effect.SCOPE == "rir":
                vectors = np.empty((len(self.data.rows), size))
                for r, members in enumerate(self.members):
                    vectors[members] = mean[part] + local[r][self.own_slices[r][0][k]].reshape(len(members), size)
                found.append(vectors)
            else:
                found.append(mean[part].reshape(count, size))
        return found

    def absorption(self, mean, local):
        """``-ln(1 - alpha)`` of walls, and of floor and ceiling, shape (n_rooms, 2, 8)."""
        unknown = np.array([mean[:N_SURFACE] + one[:N_SURFACE] for one in local])
        middle, contrast = unknown[:, :N_BANDS], unknown[:, N_BANDS:]
        return np.exp(np.stack([middle - 0.5 * contrast, middle + 0.5 * contrast], axis=1))

    def gains(self, local):
        """Gain of each RIR [dB], shape (n_rirs,)."""
        found = np.empty(len(self.data.rows))
        for members, parts, one in zip(self.members, self.gain_of, local, strict=True):
            found[members] = parts @ one[N_SURFACE:N_SURFACE + parts.shape[1]]
        return found

    def state(self, absorption, vectors):
        """What is assumed of each RIR."""
        state = base_state(self.data, absorption)
        for k, effect in enumerate(self.effects):
            unit = self.shared[k][2]
            for u, vector in enumerate(vectors[k]):
                rows = np.flatnonzero(unit == u)
                if len(rows):
                    effect.from_vector(vector).apply_to_prediction(state, self.data, rows)
        return state

    def predict(self, absorption, vectors, gains, correction, reflected=None):
        """Features, shape (n_rirs, n_features); `reflected` as for `roomeq.loop.predict.predict`."""
        return predict(self.data, self.state(absorption, vectors), reflected) + correction + np.outer(gains, HAS_GAIN)


def _gains(data, members):
    """Gains of a room: which stand in each RIR, shape (n_rirs, n_gains) of 0 and 1, and the kind of each."""
    chain = data.chain[members]
    columns = [(chain == one, 0) for one in np.unique(chain) if np.sum(chain == one) > 1]
    alone = np.array([np.sum(chain == one) == 1 for one in chain])
    if alone.any():
        columns.append((alone, 0))
    for kind in (1, 2):
        names = np.array([data.rows[n][f"{GAINS[kind]}_id"] for n in members])
        several = sorted(set(names[alone]))
        columns += [(alone & (names == name), kind) for name in several if len(several) > 1]
    return np.array([one for one, _ in columns], dtype=float).T, np.array([kind for _, kind in columns])
