"""Closed form of the torque-free top."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.special import ellipj, ellipk, ellipkinc


class Top:
    """Torque-free body with moments I1 < I2 < I3: Jacobi elliptic functions (Landau & Lifshitz, Mechanics, 37)."""

    def __init__(self, moments, w0):
        self.moments, w0 = np.asarray(moments, float), np.asarray(w0, float)
        i1, i2, i3 = self.moments
        energy, square = (self.moments * w0**2).sum(), (self.moments**2 * w0**2).sum()
        if square <= energy * i2:
            raise ValueError("the formulas hold for L^2 > 2 E I2")
        self.momentum = np.sqrt(square)
        self.amplitude = np.sqrt(
            [
                (energy * i3 - square) / (i1 * (i3 - i1)),
                (energy * i3 - square) / (i2 * (i3 - i2)),
                (square - energy * i1) / (i3 * (i3 - i1)),
            ]
        )
        self.rate = np.sqrt((i3 - i2) * (square - energy * i1) / (i1 * i2 * i3))
        self.m = (i2 - i1) * (energy * i3 - square) / ((i3 - i2) * (square - energy * i1))
        self.sign = np.sign(w0[2])
        phase = np.arctan2(self.sign * w0[1] / self.amplitude[1], w0[0] / self.amplitude[0])
        self.tau0 = ellipkinc(phase, self.m)
        self.period = 4 * ellipk(self.m) / self.rate

    def omega(self, t):
        """Angular velocity in body axes."""
        sn, cn, dn, _ = ellipj(self.rate * np.asarray(t) + self.tau0, self.m)
        return np.array(
            [self.amplitude[0] * cn, self.sign * self.amplitude[1] * sn, self.sign * self.amplitude[2] * dn]
        )

    def _frame(self, t, phi):
        w, moments = self.omega(t), self.moments
        ct = moments[2] * w[2] / self.momentum
        st = np.sqrt(1 - ct * ct)
        psi = np.arctan2(moments[0] * w[0], moments[1] * w[1])
        cp, sp, c, s = np.cos(phi), np.sin(phi), np.cos(psi), np.sin(psi)
        return np.array(
            [
                [cp * c - sp * ct * s, -cp * s - sp * ct * c, sp * st],
                [sp * c + cp * ct * s, -sp * s + cp * ct * c, -cp * st],
                [st * s, st * c, ct],
            ]
        )

    def rotation(self, t):
        """Rotation from the attitude at t = 0, by quadrature of the precession."""
        i1, i2, _ = self.moments

        def rate(tau):
            w = self.omega(tau)
            kinetic, square = i1 * w[0] ** 2 + i2 * w[1] ** 2, (i1 * w[0]) ** 2 + (i2 * w[1]) ** 2
            return self.momentum * kinetic / square

        cuts = np.linspace(0, t, int(np.ceil(t * self.rate)) + 1)
        phi = sum(quad(rate, a, b, epsabs=1e-13, epsrel=1e-13)[0] for a, b in pairwise(cuts))
        return self._frame(0.0, 0.0).T @ self._frame(t, phi)
