"""The rigid half-plane y = 0, x > 0, its edge along z: the exact field, and what rays alone give. No project code.

Points are (x, y, z) in metres, the time factor is exp(+i w t), a source at distance r gives exp(-i k r) / (4 pi r).
"""

import numpy as np
from scipy.integrate import quad
from scipy.special import hankel2e


def at(distance_m, angle_deg, z_m=0.0):
    """Point at a distance from the edge; the half-plane's upper face is at 0 degrees, its lower at 360."""
    angle = np.radians(angle_deg)
    return np.array([distance_m * np.cos(angle), distance_m * np.sin(angle), z_m])


def exact(source, mic, frequencies_hz, speed_m_s):
    """Total field of a point source at a rigid half-plane by Macdonald's integral, complex, one per frequency.

    ``V(R, m) = i k / (8 pi) * integral of H1(k R cosh u) du up to m`` for the source (m from the difference of the
    angles) and its image (from their sum); the integral over all u gives exp(-i k R) / (4 pi R)
    (Bowman, Senior, Uslenghi, Electromagnetic and Acoustic Scattering by Simple Shapes, 8.3).
    """
    (rs, ts), (rr, tr) = [(np.hypot(p[0], p[1]), np.arctan2(p[1], p[0]) % (2.0 * np.pi)) for p in (source, mic)]
    total = []
    for k in 2.0 * np.pi * np.asarray(frequencies_hz) / speed_m_s:
        field = 0.0
        for angle in (ts - tr, ts + tr):
            r = np.sqrt(rs ** 2 + rr ** 2 + (source[2] - mic[2]) ** 2 - 2.0 * rs * rr * np.cos(angle))
            m = np.arcsinh(2.0 * np.sqrt(rs * rr) / r * np.cos(0.5 * angle))
            plane = np.exp(-1j * k * r) / (4.0 * np.pi * r)
            tail = _tail(k, r, abs(m))
            field += plane - tail if m > 0.0 else tail
        total.append(field)
    return np.array(total)


def _tail(k, r, m):
    """The integral from m > 0 to infinity, the way bent into the lower half-plane, where H1(2) dies out."""
    def value(s):
        u, slope = m + s - 0.5j * np.tanh(2.0 * s), 1.0 - 1j / np.cosh(2.0 * s) ** 2
        x = k * r * np.cosh(u)
        return -1j * k / (8.0 * np.pi) * hankel2e(1, x) * np.exp(-1j * x) * slope
    parts = [quad(lambda s, f=f: f(value(s)), 0.0, 14.0, limit=2000, epsabs=1e-9, points=[0.01, 0.1, 1.0])[0]
             for f in (np.real, np.imag)]
    return complex(*parts)


def geometric(source, mic, frequencies_hz, speed_m_s):
    """Direct sound and reflection at that half-plane, each where it exists."""
    k = 2.0 * np.pi * np.asarray(frequencies_hz) / speed_m_s
    field = np.zeros(len(k), dtype=complex)
    image = source * [1.0, -1.0, 1.0]
    for one, behind in ((source, mic[1] * source[1] < 0.0), (image, mic[1] * image[1] < 0.0)):
        share = one[1] / (one[1] - mic[1]) if one[1] != mic[1] else 0.0
        crosses = behind and one[0] + share * (mic[0] - one[0]) > 0.0
        if crosses == (one is image):
            r = np.linalg.norm(mic - one)
            field += np.exp(-1j * k * r) / (4.0 * np.pi * r)
    return field
