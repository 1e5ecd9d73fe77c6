"""Matches descriptors of panoramas by normalised cross-correlation: their score, and the column shift between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.images.preprocessing import F32, Preprocessor

F64 = NDArray[np.float64]
_Number = TypeVar("_Number", np.float32, np.complex64)


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """Limits of the shift between two panoramas."""

    max_shift: float = math.radians(30.0)
    """Largest column shift, radians of azimuth."""
    max_row_shift: int = 2
    """Largest row shift, rows: pitch and height of the camera cause it."""
    min_overlap: float = 0.4
    """Least share of the columns that overlap."""

    def __post_init__(self) -> None:
        if not 0.0 < self.max_shift <= math.pi:
            raise SettingError(f"max_shift is {self.max_shift:g} rad, must be above 0, at most pi; was it given in degrees?")
        if not 0 <= self.max_row_shift <= 100:
            raise SettingError(f"max_row_shift is {self.max_row_shift}, must be 0 to 100")
        if not 0.05 <= self.min_overlap <= 1.0:
            raise SettingError(f"min_overlap is {self.min_overlap:g}, must be 0.05 to 1")


@dataclass(frozen=True, slots=True)
class Matches:
    """Scores and column shifts of a view against some nodes."""

    scores: F64
    """(nodes,), float64: normalised cross-correlation at the best shift, -1 to 1."""
    turns: F64
    """(nodes,), float64: turn after which the view would match the node, radians, positive to the left."""
    correlations: F64
    """(nodes, shifts), float64: normalised cross-correlation at all shifts."""
    angles: F64
    """(shifts,), float64: turn that each shift stands for, radians, positive to the left."""


class Matcher:
    """Matches views with the nodes of a path: normalised cross-correlation over columns, computed by the FFT of each row."""

    def __init__(self, preprocessor: Preprocessor, descriptors: Sequence[F32], settings: MatchingSettings | None = None) -> None:
        """Computes the spectra of the nodes.

        Args:
            preprocessor: of the path's camera.
            descriptors: of the nodes, each (channels, rows, columns), float32, as ``Preprocessor.descriptor`` returns it, or (rows, columns).
            settings: limits of the shift; None = the defaults.
        """
        self.settings = settings or MatchingSettings()
        self.preprocessor = preprocessor
        columns = preprocessor.columns
        reach = min(math.ceil(self.settings.max_shift / preprocessor.radians_per_column), columns - 1)
        if not preprocessor.is_closed:
            reach = min(reach, int((1.0 - self.settings.min_overlap) * columns))
        elif reach > (columns - 1) // 2:
            reach = (columns - 1) // 2
        self._shifts = np.arange(-reach, reach + 1)  # columns to the right, from the node to the view
        # A turn to the right compensates a shift to the right.
        self.angles: F64 = np.asarray(-self._shifts * preprocessor.radians_per_column, dtype=np.float64)
        """(shifts,), float64: turn that each shift stands for, radians, positive to the left."""
        self._size = columns if preprocessor.is_closed else _next_fast_length(columns + reach)
        stack = np.stack([np.asarray(each, dtype=np.float32) for each in descriptors])
        stack = stack.reshape(len(stack), -1, columns)  # (nodes, rows of all channels, columns)
        spectra = np.fft.rfft(stack, self._size, axis=2).astype(np.complex64).conj()
        self._spectra = np.ascontiguousarray(spectra.transpose(2, 0, 1))  # (frequencies, nodes, rows)
        energy = (stack.astype(np.float64) ** 2).sum(axis=1)  # (nodes, columns)
        self._energies = self._overlap_energy(energy, -self._shifts)

    def match(self, descriptor: F32, first: int = 0, end: int | None = None) -> Matches:
        """Returns the matches of a descriptor with nodes.

        Args:
            descriptor: (channels, rows, columns), float32, of the view.
            first: first node.
            end: node after the last one; None = all.
        """
        most = self.settings.max_row_shift
        energies = self._energies[first:end]
        shifts = range(-most, most + 1)
        energy = np.stack(
            [
                (_shifted_rows(descriptor, rows).astype(np.float64) ** 2).sum(axis=tuple(range(descriptor.ndim - 1)))
                for rows in shifts
            ]
        )
        spectrum = np.fft.rfft(descriptor, self._size, axis=-1).astype(np.complex64)  # (channels, rows, frequencies)
        spectrum = np.stack([_shifted_rows(spectrum, rows).reshape(-1, spectrum.shape[-1]) for rows in shifts])
        # For each frequency: (nodes, rows) @ (rows, vertical shifts).
        product = self._spectra[:, first:end] @ spectrum.transpose(2, 1, 0)
        correlation = np.fft.irfft(product, self._size, axis=0)[self._shifts % self._size].transpose(2, 1, 0)
        energy = self._overlap_energy(energy, self._shifts)  # of each vertical shift
        best: F64 = (correlation / np.sqrt(np.maximum(energy[:, None] * energies[None], 1e-9))).max(axis=0)
        at = best.argmax(axis=1)
        scores, turns = _peaks(best, at, self.angles)
        return Matches(scores, turns, best, self.angles)

    def _overlap_energy(self, energy: F64, shifts: NDArray[np.intp]) -> F64:
        """Returns (N, shifts), float64: sums of column energies (N, columns) over the columns that overlap at each shift."""
        columns = energy.shape[1]
        if self.preprocessor.is_closed:
            return np.repeat(energy.sum(axis=1, keepdims=True), len(shifts), axis=1)
        sums = np.concatenate([np.zeros((len(energy), 1)), energy.cumsum(axis=1)], axis=1)
        low = np.clip(shifts, 0, columns)
        high = np.clip(columns + shifts, 0, columns)
        return np.asarray(sums[:, high] - sums[:, low], dtype=np.float64)


def _peaks(correlations: F64, at: NDArray[np.intp], angles: F64) -> tuple[F64, F64]:
    """Returns scores (nodes,) and turns (nodes,), radians: vertices of the parabolas through each peak and its neighbours.

    Args:
        correlations: (nodes, shifts).
        at: (nodes,), shift of each peak.
        angles: (shifts,), turns of the shifts, radians.
    """
    rows = np.arange(len(correlations))
    middle = np.clip(at, 1, correlations.shape[1] - 2)
    left, centre, right = correlations[rows, middle - 1], correlations[rows, middle], correlations[rows, middle + 1]
    bend = left - 2.0 * centre + right
    inner = (at == middle) & (bend < -1e-12)
    offset = np.where(inner, 0.5 * (left - right) / np.where(inner, bend, 1.0), 0.0)
    step = angles[1] - angles[0] if len(angles) > 1 else 0.0
    scores = np.where(inner, centre - 0.25 * (left - right) * offset, correlations[rows, at])
    return np.clip(scores, -1.0, 1.0), angles[at] + np.where(at == middle, offset, 0.0) * step


def _shifted_rows(values: NDArray[_Number], rows: int) -> NDArray[_Number]:
    """Returns values (..., rows, columns), shifted down by a number of rows, with zeros in the others."""
    if rows == 0:
        return values
    moved = np.zeros_like(values)
    if rows > 0:
        moved[..., rows:, :] = values[..., :-rows, :]
    else:
        moved[..., :rows, :] = values[..., -rows:, :]
    return moved


def _next_fast_length(size: int) -> int:
    """Returns the next length of which 2, 3 and 5 are the only prime factors."""
    while True:
        rest = size
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return size
        size += 1
