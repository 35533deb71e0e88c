"""One scene in other units of length, time and mass, and at another origin.

Units: lengths times s, time times t and mass times m turn density into m / s^3, stress and Young's
modulus into m / (s t^2), kn and ks into m / (s t)^2, acceleration into s / t^2. If s, t and m are powers
of two every rounding stays what it was, so the bits must be the same.
"""

from __future__ import annotations

import numpy as np

import fdem


class Units:
    """Factors that turn SI numbers into those of other units of length, time and mass."""

    def __init__(self, length=1.0, time=1.0, mass=1.0, origin=(0.0, 0.0, 0.0)):
        self.length, self.time, self.mass = length, time, mass
        self.velocity, self.acceleration = length / time, length / time**2
        self.force = mass * self.acceleration
        self.stress, self.density = self.force / length**2, mass / length**3
        self.stiffness, self.energy, self.spin = self.stress / length, self.force * length, 1.0 / time
        self.origin = np.array(origin)

    def place(self, x):
        """Place in these units."""
        return self.length * np.asarray(x, float) + self.origin

    def brick(self, lower, upper):
        """Brick given in SI."""
        return fdem.brick(self.place(lower), self.place(upper))

    def elastic(self, density=2500.0, young=1e9, poisson=0.2):
        """Material given in SI."""
        return fdem.Elastic(density * self.density, young * self.stress, poisson)

    def coulomb(self, kn=5e8, ks=3e8, friction=20.0, cohesion=1e3, **given):
        """Joint given in SI."""
        return fdem.Coulomb(
            kn=kn * self.stiffness, ks=ks * self.stiffness, friction=friction, cohesion=cohesion * self.stress, **given
        )


SI = Units()
