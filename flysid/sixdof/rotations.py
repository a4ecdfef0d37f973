"""Quaternions w, x, y, z, a row each: products, turns, and the way to and from rotation vectors."""

from __future__ import annotations

import numpy as np

from flysid.stretch import FloatArray

_SMALL = 1e-12


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """(..., 4) p then, in p's axes, q."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    parts = (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )
    return np.stack(parts, axis=-1)


def inverse(q: FloatArray) -> FloatArray:
    """(..., 4) the way back, of unit quaternions."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def matrices(q: FloatArray) -> FloatArray:
    """(..., 3, 3) from body to world axes."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_world(q: FloatArray, vectors: FloatArray) -> FloatArray:
    """(..., 3) vectors of the body in world axes."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices(q), vectors))


def to_body(q: FloatArray, vectors: FloatArray) -> FloatArray:
    """(..., 3) vectors of the world in body axes."""
    return np.asarray(np.einsum("...ji,...j->...i", matrices(q), vectors))


def from_vector(turn: FloatArray) -> FloatArray:
    """(..., 4) the turn by rotation vectors, rad."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2.0 * np.pi)) * turn], axis=-1)


def to_vector(q: FloatArray) -> FloatArray:
    """(..., 3) rotation vectors, rad, of the shorter way."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    factor = np.where(sine > _SMALL, angle / np.maximum(sine, _SMALL), 2.0)
    return np.asarray(factor * q[..., 1:])


def body_rates(q: FloatArray, dt_s: float) -> FloatArray:
    """(N - 1, 3) rad/s, mean body rates from sample to sample."""
    return to_vector(product(inverse(q[:-1]), q[1:])) / dt_s


def unit(q: FloatArray) -> FloatArray:
    """(..., 4) of length 1."""
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))
