"""Directions that upright ellipsoids and cylinders block: cones that are not round, and their nearest ways out.

As for caps the answer is one of finitely many. The edge of what is blocked consists of pieces of

- rims: curves u(t) = m + a cos t + b sin t. Scaled so that an ellipsoid is a ball, its edge is the rim of a round cap,
  and back in true space such a curve. The edge of a cylinder is made of the circles around its two faces,
- planes through the agent: the two vertical ones that touch a cylinder's side; and, inside of a region, the plane
  beyond which one does not part.

The nearest point of a plane is the projection. On a rim the angle to a direction w has its extrema where the
derivative of (w.u / |u|)^2 vanishes: a trigonometric polynomial of degree 2, so four roots of a quartic in exp(i t).
All of them are candidates, for the nearest may be blocked by another region. Two rims of ellipsoids cross where caps
do. A rim of a cylinder and a plane, and two rims of cylinders, give one equation A cos t + B sin t = C: seen through a
horizontal window all faces are circles.

Axes are level, z up. Knows no tilted regions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.caps import Caps, caps_of, dot, pairs, to_the_right
from groundstation.core.types import BoolArray, FloatArray, IntArray

_LARGER = 1e-8
"""How much larger the cylinders are that candidates are built around, so that rounding cannot put them inside."""
_PARTING = 1e-9
"""Inside of a region, sine of the angle by which a direction may fail to part."""
_TIE = 1e-9
"""What going to the right is worth, as a cosine, so that two agents head on pass each other."""
_NEWTON_STEPS = 4


@dataclass(frozen=True)
class EllipsoidCones:
    """Directions that ellipsoids of one shape block.

    Attributes:
        caps: of the balls that they are in space scaled vertically.
        squeeze: by how much that space is scaled, radius / half height.
    """

    caps: Caps
    squeeze: float

    @property
    def active(self) -> BoolArray:
        """Who blocks anything."""
        return self.caps.active

    def meets(self, direction: FloatArray) -> BoolArray:
        """A direction leads into an ellipsoid where the scaled direction leads into the ball."""
        return self.caps.meets(_unit(direction * np.array([1.0, 1.0, self.squeeze])))

    def candidates(self, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Points of each rim where the angle is extreme, and the crossings of rims."""
        back = np.array([1.0, 1.0, 1.0 / self.squeeze])
        cos_rim, sin_rim = self.caps.rims()
        centre = np.where(self.active[..., None], self.caps.centre, np.array([1.0, 0.0, 0.0]))
        first = _unit(to_the_right(centre))
        second = np.stack(
            [
                centre[..., 1] * first[..., 2] - centre[..., 2] * first[..., 1],
                centre[..., 2] * first[..., 0] - centre[..., 0] * first[..., 2],
                centre[..., 0] * first[..., 1] - centre[..., 1] * first[..., 0],
            ],
            axis=-1,
        )
        on_rims = extreme_on_rims(
            direction,
            cos_rim[..., None] * centre * back,
            sin_rim[..., None] * first * back,
            sin_rim[..., None] * second * back,
        )
        crossings, crossing = self.caps.rim_crossings()
        per_rim = on_rims.shape[1] // max(self.active.shape[1], 1)
        found = np.concatenate([on_rims, _unit(crossings * back)], axis=1)
        return found, np.concatenate([np.repeat(self.active, per_rim, axis=1), crossing], axis=1)

    def preference(self, candidates: FloatArray, direction: FloatArray) -> FloatArray:
        """To the right, all else being equal."""
        return _TIE * dot(candidates, to_the_right(direction)[:, None])

    def take(self, rows: IntArray, columns: IntArray) -> EllipsoidCones:
        """Keeps some."""
        return EllipsoidCones(self.caps.take(rows, columns), self.squeeze)

    @staticmethod
    def work(width: int) -> int:
        """Seven points a rim and the crossings, each held against all."""
        return (width + 6) * width**2


@dataclass(frozen=True)
class CylinderCones:
    """Directions that cylinders block.

    Attributes:
        offset_m: to the centres, level axes, shape (m, n, 3).
        radius_m: shape (m, n).
        half_m: half height, shape (m, n).
        inside: the agent is inside, shape (m, n).
        inward: unit vector against which it parts, level, shape (m, n, 3).
        active: who blocks anything, shape (m, n).
    """

    offset_m: FloatArray
    radius_m: FloatArray
    half_m: FloatArray
    inside: BoolArray
    inward: FloatArray
    active: BoolArray

    def meets(self, direction: FloatArray) -> BoolArray:
        """Where a ray passes through the side and between the faces at the same time; inside, where it does not part.

        A ray t u is inside of the endless cylinder between two roots t of |t u - p|^2 = r^2 (horizontal parts), and
        between the faces while |t u_z - p_z| < h. An agent outside of a convex region has it all ahead or all behind.
        """
        x, y, z = (direction[:, :, None, axis] for axis in range(3))
        px, py, pz = (self.offset_m[:, None, :, axis] for axis in range(3))
        radius, half = self.radius_m[:, None], self.half_m[:, None]
        flat = x * x + y * y
        along = x * px + y * py
        beside = px * px + py * py - radius * radius
        root_square = along * along - flat * beside
        root = np.sqrt(np.maximum(root_square, 0.0))
        level = flat > 0.0
        safe = np.where(level, flat, 1.0)
        # Straight up or down: within the side always, or never.
        through = np.where(level, root_square > 0.0, beside < 0.0)
        enters = np.where(level, (along - root) / safe, -np.inf)
        leaves = np.where(level, (along + root) / safe, np.inf)
        rising = z != 0.0
        safe = np.where(rising, z, 1.0)
        one, other = (pz - half) / safe, (pz + half) / safe
        between = np.where(rising, True, np.abs(pz) < half)
        enters = np.maximum(enters, np.where(rising, np.minimum(one, other), -np.inf))
        leaves = np.minimum(leaves, np.where(rising, np.maximum(one, other), np.inf))
        into = through & between & (enters < leaves) & (leaves > -enters)
        closing = dot(direction[:, :, None], self.inward[:, None]) > _PARTING
        return np.asarray(np.where(self.inside[:, None], closing, into), dtype=np.bool_)

    def candidates(self, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Extreme points of rims, projections on planes, and all crossings between them."""
        with np.errstate(invalid="ignore", divide="ignore"):
            centre, radius = self._rims()
            normals = self._planes()
            zero = 0.0 * radius
            a, b = np.stack([radius, zero, zero], axis=-1), np.stack([zero, radius, zero], axis=-1)
            along = dot(direction[:, None], normals)
            level = np.stack([-normals[..., 1], normals[..., 0], 0.0 * normals[..., 0]], axis=-1)
            upright = np.broadcast_to(np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]), (len(direction), 2, 3))
            found = np.concatenate(
                [
                    extreme_on_rims(direction, centre, a, b),
                    direction[:, None] - along[..., None] * normals,
                    upright,
                    level,
                    -level,
                    _rims_and_planes(centre, radius, normals),
                    _rims_and_rims(centre, radius),
                ],
                axis=1,
            )
            found = _unit(found)
        valid = np.asarray(np.isfinite(found).all(axis=-1), dtype=np.bool_)
        return np.where(valid[..., None], found, 0.0), valid

    def _rims(self) -> tuple[FloatArray, FloatArray]:
        """Centres (m, 2 n, 3) and radii (m, 2 n) of the faces seen from outside, NaN where there are none."""
        seen = self.active & ~self.inside
        radius = np.where(seen, self.radius_m * (1.0 + _LARGER), np.nan)
        half = self.half_m * (1.0 + _LARGER)
        up = np.stack([0.0 * half, 0.0 * half, half], axis=-1)
        return (
            np.concatenate([self.offset_m + up, self.offset_m - up], axis=1),
            np.concatenate([radius, radius], axis=1),
        )

    def _planes(self) -> FloatArray:
        """Normals (m, 2 n, 3) of the planes that touch the sides, or beyond which nobody parts; NaN where none is."""
        px, py = self.offset_m[..., 0], self.offset_m[..., 1]
        square = px * px + py * py
        radius = self.radius_m * (1.0 + _LARGER)
        # The line to where the side is touched, and the normal square to it: (p turned by the half angle), / |p|^2.
        touch = np.sqrt(np.where(self.active & ~self.inside, square - radius * radius, np.nan))
        zero = 0.0 * square
        left = np.stack([-(py * touch + px * radius) / square, (px * touch - py * radius) / square, zero], axis=-1)
        right = np.stack([-(py * touch - px * radius) / square, (px * touch + py * radius) / square, zero], axis=-1)
        within = np.asarray(self.active & self.inside)[..., None]
        return np.concatenate([np.where(within, self.inward, left), np.where(within, np.nan, right)], axis=1)

    def preference(self, candidates: FloatArray, direction: FloatArray) -> FloatArray:
        """To the right, all else being equal."""
        return _TIE * dot(candidates, to_the_right(direction)[:, None])

    def take(self, rows: IntArray, columns: IntArray) -> CylinderCones:
        """Keeps some."""
        pick = (rows, columns)
        return CylinderCones(
            self.offset_m[pick],
            self.radius_m[pick],
            self.half_m[pick],
            self.inside[pick],
            self.inward[pick],
            self.active[pick],
        )

    @staticmethod
    def work(width: int) -> int:
        """Points of rims and planes and the crossings of two of each, each held against all."""
        return (12 * width + 24) * width**2


def ellipsoid_cones(
    offset_m: FloatArray, visible: BoolArray, radius_m: FloatArray, within: FloatArray, *, squeeze: float
) -> EllipsoidCones:
    """What ellipsoids block for m agents.

    Args:
        offset_m: to their centres, level axes, shape (m, n, 3).
        visible: shape (m, n).
        radius_m: shape (m, n).
        within: how many times as large as an ellipsoid the one is inside of which it counts, shape (m, n).
        squeeze: radius over half height of all of them.
    """
    scaled = offset_m * np.array([1.0, 1.0, squeeze])
    length = np.sqrt(dot(scaled, scaled))
    active = visible & (length < radius_m * within) & (length > 1e-9)
    return EllipsoidCones(caps_of(scaled, length, radius_m, np.asarray(active, dtype=np.bool_)), squeeze)


def cylinder_cones(
    offset_m: FloatArray,
    active: BoolArray,
    size_m: tuple[FloatArray, FloatArray],
    distance: tuple[FloatArray, FloatArray],
) -> CylinderCones:
    """What cylinders block for m agents.

    Args:
        offset_m: to their centres, level axes, shape (m, n, 3); finite.
        active: those that count, shape (m, n).
        size_m: radius and half height, shape (m, n) each.
        distance: metres that the agents are outside, shape (m, n), and its gradient, shape (m, n, 3).
    """
    (radius_m, half_m), (distance_m, inward) = size_m, distance
    length = np.sqrt(dot(inward, inward))
    active = active & (length > 0.0)  # one at the very centre has no direction
    return CylinderCones(
        offset_m=offset_m,
        radius_m=radius_m,
        half_m=half_m,
        # On the surface the larger cylinders of the candidates are already entered.
        inside=np.asarray(distance_m < 2.0 * _LARGER * np.minimum(radius_m, half_m), dtype=np.bool_),
        inward=inward / np.where(length > 0.0, length, 1.0)[..., None],
        active=np.asarray(active, dtype=np.bool_),
    )


def extreme_on_rims(direction: FloatArray, m: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Points of rims u(t) = m + a cos t + b sin t where the angle to a direction is extreme.

    Args:
        direction: unit vectors w, shape (m, 3).
        m: shape (m, k, 3), NaN rows for rims that do not exist.
        a: shape (m, k, 3).
        b: shape (m, k, 3).

    Returns:
        Unit vectors, shape (m, 7 k, 3): per rim the four roots, started from the quartic's and made exact; two from
        the equation without its second harmonic, for rims that are nearly round; and the rightmost point, for rims
        of which all points are equally near.
    """
    w = direction[:, None]
    wm, wa, wb = dot(w, m), dot(w, a), dot(w, b)
    mm, aa, bb = dot(m, m), dot(a, a), dot(b, b)
    ma, mb, ab = dot(m, a), dot(m, b), dot(a, b)
    # g(t) = (w.u') (u.u) - (w.u) (u.u') at five instants gives its five coefficients.
    constant = np.zeros(wm.shape, dtype=np.complex128)
    single, double = constant.copy(), constant.copy()
    for step in range(5):
        t = 2.0 * np.pi * step / 5.0
        c, s = np.cos(t), np.sin(t)
        wu, wdu = wm + wa * c + wb * s, wb * c - wa * s
        uu = mm + aa * c * c + bb * s * s + 2.0 * (ma * c + mb * s + ab * c * s)
        udu = mb * c - ma * s + (bb - aa) * c * s + ab * (c * c - s * s)
        g = (wdu * uu - wu * udu) / 5.0
        constant += g
        single += g * np.exp(-1j * t)
        double += g * np.exp(-2j * t)
    size = np.abs(constant) + np.abs(single) + np.abs(double)
    usable = np.isfinite(size) & (size > 0.0)
    size = np.where(usable, size, 1.0)
    constant, single, double = (np.where(usable, value, 0.0) / size for value in (constant, single, double))
    starts = [_quartic_angles(constant, single, double)]
    turn = np.arccos(np.clip(-constant.real / np.maximum(2.0 * np.abs(single), 1e-300), -1.0, 1.0))
    starts += [(-np.angle(single) + sign * turn)[..., None] for sign in (1.0, -1.0)]
    angles: FloatArray = np.concatenate(starts, axis=-1)
    for _ in range(_NEWTON_STEPS):
        one, two = single[..., None] * np.exp(1j * angles), double[..., None] * np.exp(2j * angles)
        value = constant[..., None].real + 2.0 * (one + two).real
        slope = -2.0 * (one + 2.0 * two).imag
        step = value / np.where(np.abs(slope) > 1e-12, slope, np.inf)
        angles = angles - np.clip(step, -0.3, 0.3)
    right = to_the_right(direction)[:, None]
    angles = np.concatenate([angles, np.arctan2(dot(b, right), dot(a, right))[..., None]], axis=-1)
    u = m[..., None, :] + a[..., None, :] * np.cos(angles)[..., None] + b[..., None, :] * np.sin(angles)[..., None]
    return _unit(u.reshape(len(direction), -1, 3))


def _quartic_angles(constant: FloatArray, single: FloatArray, double: FloatArray) -> FloatArray:
    """Angles of the roots of double z^4 + single z^3 + constant z^2 + conj(single) z + conj(double), shape (..., 4)."""
    # Nearly round rims have no second harmonic; the other two starts find their roots.
    lead = np.where(np.abs(double) > 1e-9, double, 1.0)
    companion = np.zeros((*double.shape, 4, 4), dtype=np.complex128)
    companion[..., 0, 0] = -single / lead
    companion[..., 0, 1] = -constant / lead
    companion[..., 0, 2] = -np.conj(single) / lead
    companion[..., 0, 3] = -np.conj(double) / lead
    companion[..., 1, 0] = companion[..., 2, 1] = companion[..., 3, 2] = 1.0
    return np.asarray(np.angle(np.linalg.eigvals(companion)), dtype=np.float64)


def _rims_and_planes(centre: FloatArray, radius: FloatArray, normals: FloatArray) -> FloatArray:
    """Where faces (m, k) and planes (m, k) through the agent cross, shape (m, 2 k k, 3), NaN where they do not."""
    c, r, n = centre[:, :, None], radius[:, :, None], normals[:, None]
    across = np.hypot(n[..., 0], n[..., 1]) * np.ones_like(r)
    cosine = -dot(n, c) / (r * across)
    return _at_angles(c, r, np.arctan2(n[..., 1], n[..., 0]), cosine)


def _rims_and_rims(centre: FloatArray, radius: FloatArray) -> FloatArray:
    """Where two faces of cylinders hide behind each other, shape (m, k (k - 1), 3), NaN where they do not.

    With d = z2 p1 - z1 p2 (horizontal parts), points p1 + r1 e(t) of the first lie on the cone over the second where
    |d + z2 r1 e(t)| = r2 |z1|.
    """
    first, second = pairs(radius.shape[1])
    c1, c2, r1, r2 = centre[:, first], centre[:, second], radius[:, first], radius[:, second]
    z1, z2 = c1[..., 2], c2[..., 2]
    dx, dy = z2 * c1[..., 0] - z1 * c2[..., 0], z2 * c1[..., 1] - z1 * c2[..., 1]
    square = dx * dx + dy * dy
    cosine = (r2 * r2 * z1 * z1 - square - z2 * z2 * r1 * r1) / (2.0 * z2 * r1 * np.sqrt(square))
    return _at_angles(c1, r1, np.arctan2(dy, dx), cosine)


def _at_angles(centre: FloatArray, radius: FloatArray, middle: FloatArray, cosine: FloatArray) -> FloatArray:
    """Points of faces at an angle on both sides of a middle, shape (m, 2 ..., 3), NaN where the cosine is none."""
    turn = np.arccos(cosine)
    points = []
    for t in (middle + turn, middle - turn):
        x, y = centre[..., 0] + radius * np.cos(t), centre[..., 1] + radius * np.sin(t)
        points.append(np.stack([x, y, centre[..., 2] + 0.0 * t], axis=-1).reshape(len(radius), -1, 3))
    return np.concatenate(points, axis=1)


def _unit(vector: FloatArray) -> FloatArray:
    length = np.sqrt(dot(vector, vector))
    return np.asarray(vector / np.where(length > 0.0, length, 1.0)[..., None], dtype=np.float64)
