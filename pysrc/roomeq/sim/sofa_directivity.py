"""Measured directivities from SOFA files (AES69), read with `sofar`."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import Array, FloatArray
from roomeq.corpora.sofa_file import axes_of, open_sofa, vector_of
from roomeq.sim.directivity import DirectivityTable

_THIRDS_HZ = tuple(1000.0 * 10.0 ** (0.1 * k) for k in range(-13, 14))
"""Exact mid-band frequencies of the third octaves that make up the octaves from 62.5 Hz to 16 kHz."""


def read_directivity(path: str | PathLike[str], facing: Sequence[float], *, up: Sequence[float] = (0.0, 0.0, 1.0),
                     measurement: int = 0) -> DirectivityTable:
    """Read a directivity from a SOFA file: transfer functions or impulse responses at receivers around a source.

    Energy is averaged over each third octave: of the highest octave, not all may be recorded. Gains are relative to the
    receiver that is nearest to the main axis, so that the table holds the directivity alone, without the device's
    response.

    Parameters
    ----------
    path
        Of the convention FreeFieldDirectivityTF, or any other of data type TF or FIR with one receiver per direction.
    facing, up
        Direction of the main axis in the room, and one in the plane of the device's x and z axes, shape (3,).
    measurement
        Which of the file's measurements, counted from 0.

    Returns
    -------
    DirectivityTable

    Raises
    ------
    ValueError
        The file is not SOFA, has other data, fewer than four directions, or no such measurement.
    """
    path = Path(path)
    sofa = open_sofa(path)
    spectra, frequencies_hz = _spectra(sofa, path)
    if not 0 <= measurement < len(spectra):
        raise ValueError(f"{path}: measurement {measurement} of {len(spectra)}: count from 0")
    directions = _directions(sofa, path, measurement)
    energy = np.abs(spectra[measurement]) ** 2
    if len(directions) != len(energy) or len(directions) < 4:
        raise ValueError(f"{path}: {len(energy)} receivers at {len(directions)} positions must be at least 4, with one "
                         "position each: export it as FreeFieldDirectivityTF")
    bands_hz, means = [], []
    for band_hz in _THIRDS_HZ:
        inside = (frequencies_hz >= band_hz * 10.0 ** -0.05) & (frequencies_hz <= band_hz * 10.0 ** 0.05)
        if inside.any():
            bands_hz.append(band_hz)
            means.append(energy[:, inside].mean(axis=1))
    if not bands_hz:
        raise ValueError(f"{path}: no frequency lies in an octave from 62.5 Hz to 16 kHz: correct N")
    axis = int(np.argmax(directions[:, 0]))
    gains_db = 10.0 * np.log10(np.maximum(np.stack(means, axis=1), 1e-30))
    return DirectivityTable(directions, np.array(bands_hz), gains_db - gains_db[axis], facing, up)


def _spectra(sofa: Any, path: Path) -> tuple[Array, FloatArray]:
    """Return the transfer functions, shape (n_measurements, n_receivers, n), and their frequencies [Hz]."""
    kind = str(sofa.GLOBAL_DataType)
    try:
        if kind == "TF":
            spectra = np.asarray(sofa.Data_Real, float) + 1j * np.asarray(sofa.Data_Imag, float)
            frequencies_hz = np.asarray(sofa.N, float).ravel()
        elif kind == "FIR":
            irs = np.asarray(sofa.Data_IR, float)
            spectra = np.fft.rfft(irs, axis=-1)
            frequencies_hz = np.fft.rfftfreq(irs.shape[-1], 1.0 / float(np.ravel(sofa.Data_SamplingRate)[0]))
        else:
            raise ValueError(f"data type {kind!r} must be TF or FIR")
        if spectra.ndim != 3 or spectra.shape[2] != len(frequencies_hz) or not np.all(np.isfinite(spectra)):
            raise ValueError(f"transfer functions of shape {spectra.shape} must be finite, with one of the "
                             f"{len(frequencies_hz)} frequencies in each place of the last dimension")
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: {error}: export it as FreeFieldDirectivityTF") from None
    return spectra, frequencies_hz


def _directions(sofa: Any, path: Path, measurement: int) -> FloatArray:
    """Return unit vectors from the source to the receivers, shape (n_receivers, 3): ahead of it, to its left, up.

    What is ahead and up, the file states as SourceView and SourceUp.
    """
    receivers = [vector_of(sofa, "ReceiverPosition", n, measurement) for n in range(len(sofa.ReceiverPosition))]
    if any(position is None for position in receivers):
        raise ValueError(f"{path}: ReceiverPosition must hold finite vectors in Cartesian or spherical coordinates: "
                         "correct it, or its Type")
    positions = np.array(receivers, dtype=float)
    distance = np.linalg.norm(positions, axis=1, keepdims=True)
    if not np.all(distance > 0.0):
        raise ValueError(f"{path}: a receiver lies at the source, in no direction: correct ReceiverPosition")
    axes = axes_of(*(vector_of(sofa, name, 0, measurement) for name in ("SourceView", "SourceUp")))
    if axes is None:
        raise ValueError(f"{path}: SourceView and SourceUp must point in two different directions: correct them")
    return positions / distance @ axes
