"""Sums of products of lagged signals: what every regression on past samples is made of.

Lagged columns are shifts of each other, so only the products with lag 0 are summed over the data; the others
follow from a segment's edges (displacement structure; Kailath, Kung, Morf, 1979, J. Math. Anal. Appl. 68).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from flysid.dataset import FloatArray

CHUNK_ROWS = 16_384
"""Samples that are worked on together: they stay in a cache."""


def lagged_gram(pieces: Iterable[tuple[int, FloatArray]], depth: int) -> FloatArray:
    """Gram of all lags 0..depth of some signals and of a constant, rows `depth`.. of every segment.

    Parameters
    ----------
    pieces : the segment's number and a (s, n) window of the signals, in rows, each behind its `depth` samples
        before.

    Returns
    -------
    (s (depth + 1) + 1, same) Gram; column a (depth + 1) + p is signal a at lag p, the last is the constant.
    (1, 1) zero where no segment is long enough.
    """
    total: FloatArray | None = None
    for _, segment in itertools.groupby(pieces, key=lambda piece: piece[0]):
        part = _segment_gram((window for _, window in segment), depth)
        total = part if total is None else total + part
    return np.zeros((1, 1)) if total is None else total


def _segment_gram(pieces: Iterator[FloatArray], depth: int) -> FloatArray:
    """The Gram of one segment: products with lag 0 summed over all rows, the rest from its two ends."""
    window = next(pieces)
    count = len(window)
    rows = 0
    head = window[:, :depth].copy()
    now = np.zeros((count, count, depth + 1))  # sum over k of x_a(k) x_b(k - q)
    sums = np.zeros(count)
    while True:
        for start in range(0, window.shape[1] - depth, CHUNK_ROWS):
            block = window[:, start : start + CHUNK_ROWS + depth]
            sums += block[:, depth:].sum(axis=1)
            for a, b in np.ndindex(count, count):
                now[a, b] += np.correlate(block[b], block[a, depth:], "valid")[::-1]
        rows += window.shape[1] - depth
        tail = window[:, window.shape[1] - depth :]
        following = next(pieces, None)
        if following is None:
            return _displace(now, sums, rows, head, tail)
        window = following


def _displace(now: FloatArray, sums: FloatArray, rows: int, head: FloatArray, tail: FloatArray) -> FloatArray:
    """All products of lags from those with lag 0 and the segment's first and last samples."""
    count, depth = head.shape
    lags = depth + 1
    gram = np.zeros((lags, lags, count, count))
    gram[0] = now.transpose(2, 0, 1)
    means = np.zeros((lags, count))
    means[0] = sums
    for p in range(1, lags):  # one sample enters at the segment's start, one leaves at its end
        enters = head[:, depth - p]
        leaves = tail[:, depth - p]
        gram[p, p:] = gram[p - 1, p - 1 : -1]
        gram[p, p:] += np.einsum("a,bq->qab", enters, head[:, : depth - p + 1][:, ::-1])
        gram[p, p:] -= np.einsum("a,bq->qab", leaves, tail[:, : depth - p + 1][:, ::-1])
        means[p] = means[p - 1] + enters - leaves
    full = np.empty((count * lags + 1,) * 2)
    body = gram.transpose(2, 0, 3, 1).reshape(count * lags, count * lags)
    later = np.tril(np.ones((lags, lags), dtype=bool), -1)  # q < p: the transposed pair
    mirrored = np.tile(later, (count, count))
    full[:-1, :-1] = np.where(mirrored, body.T, body)
    full[-1, :-1] = full[:-1, -1] = means.T.ravel()
    full[-1, -1] = rows
    return full
