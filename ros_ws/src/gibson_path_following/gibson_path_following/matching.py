"""Compares normalised panoramas: how alike they are, and by how many columns one is shifted against the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.preprocessing import F32, Preprocessor

F64 = NDArray[np.float64]
_Number = TypeVar("_Number", np.float32, np.complex64)


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """How far panoramas are shifted against each other."""

    max_shift: float = math.radians(30.0)
    """Largest shift, radians of azimuth."""
    max_rows: int = 2
    """Largest vertical shift, rows: what pitch and height of the camera change."""
    least_overlap: float = 0.4
    """Share of the columns that must overlap."""

    def __post_init__(self) -> None:
        if not 0.0 < self.max_shift <= math.pi:
            raise SettingError(f"max_shift is {self.max_shift:g} rad, must be above 0, at most pi; was it given in degrees?")
        if not 0 <= self.max_rows <= 100:
            raise SettingError(f"max_rows is {self.max_rows}, must be 0 to 100")
        if not 0.05 <= self.least_overlap <= 1.0:
            raise SettingError(f"least_overlap is {self.least_overlap:g}, must be 0.05 to 1")


@dataclass(frozen=True, slots=True)
class Matches:
    """A view compared with a number of nodes."""

    scores: F64
    """(nodes,) normalised cross-correlation at the best shift, -1 to 1."""
    turns: F64
    """(nodes,) radians that the robot must turn to the left to look as at the node."""
    curves: F64
    """(nodes, shifts) normalised cross-correlation over all shifts."""
    angles: F64
    """(shifts,) radians to the left, which a shift stands for."""


class Matcher:
    """Compares views with the nodes of a path by normalised cross-correlation over columns, through a Fourier transform of the rows."""

    def __init__(self, preprocessor: Preprocessor, patterns: Sequence[F32], settings: MatchingSettings | None = None) -> None:
        """Transforms the nodes.

        Args:
            preprocessor: of the path's camera.
            patterns: of the nodes, each (channels, rows, columns), as ``Preprocessor.pattern`` returns it, or (rows, columns).
            settings: limits of the shift; None = the defaults.
        """
        self.settings = settings or MatchingSettings()
        self.preprocessor = preprocessor
        columns = preprocessor.columns
        reach = min(math.ceil(self.settings.max_shift / preprocessor.radians_per_column), columns - 1)
        if not preprocessor.is_closed:
            reach = min(reach, int((1.0 - self.settings.least_overlap) * columns))
        elif reach > (columns - 1) // 2:
            reach = (columns - 1) // 2
        self._shifts = np.arange(-reach, reach + 1)  # columns that a pixel moves to the right from the node to the view
        # A scene that moved to the right is faced again by a turn to the right.
        self.angles: F64 = np.asarray(-self._shifts * preprocessor.radians_per_column, dtype=np.float64)
        """Radians to the left that the robot must turn, for each shift."""
        self._size = columns if preprocessor.is_closed else _fast(columns + reach)
        stack = np.stack([np.asarray(g, dtype=np.float32) for g in patterns])
        stack = stack.reshape(len(stack), -1, columns)  # (nodes, rows of all channels, columns)
        spectra = np.fft.rfft(stack, self._size, axis=2).astype(np.complex64).conj()
        self._spectra = np.ascontiguousarray(spectra.transpose(2, 0, 1))  # (frequencies, nodes, rows)
        energy = (stack.astype(np.float64) ** 2).sum(axis=1)  # (nodes, columns)
        self._energies = self._overlapping(energy, -self._shifts)

    def match(self, pattern: F32, first: int = 0, end: int | None = None) -> Matches:
        """Returns the comparison of a pattern with the nodes from ``first`` to before ``end`` (None = the last)."""
        most = self.settings.max_rows
        energies = self._energies[first:end]
        shifts = range(-most, most + 1)
        energy = np.stack(
            [(_moved(pattern, rows).astype(np.float64) ** 2).sum(axis=tuple(range(pattern.ndim - 1))) for rows in shifts]
        )
        spectrum = np.fft.rfft(pattern, self._size, axis=-1).astype(np.complex64)  # (channels, rows, frequencies)
        spectrum = np.stack([_moved(spectrum, rows).reshape(-1, spectrum.shape[-1]) for rows in shifts])
        # For each frequency: (nodes, rows) @ (rows, vertical shifts).
        product = self._spectra[:, first:end] @ spectrum.transpose(2, 1, 0)
        correlation = np.fft.irfft(product, self._size, axis=0)[self._shifts % self._size].transpose(2, 1, 0)
        energy = self._overlapping(energy, self._shifts)  # of each vertical shift
        best: F64 = (correlation / np.sqrt(np.maximum(energy[:, None] * energies[None], 1e-9))).max(axis=0)
        at = best.argmax(axis=1)
        scores, turns = _peaks(best, at, self.angles)
        return Matches(scores, turns, best, self.angles)

    def _overlapping(self, energy: F64, shifts: NDArray[np.intp]) -> F64:
        """Returns the sum of column energies (N, columns) over those that overlap at each shift, (N, shifts)."""
        columns = energy.shape[1]
        if self.preprocessor.is_closed:
            return np.repeat(energy.sum(axis=1, keepdims=True), len(shifts), axis=1)
        sums = np.concatenate([np.zeros((len(energy), 1)), energy.cumsum(axis=1)], axis=1)
        low = np.clip(shifts, 0, columns)
        high = np.clip(columns + shifts, 0, columns)
        return np.asarray(sums[:, high] - sums[:, low], dtype=np.float64)


def _peaks(curves: F64, at: NDArray[np.intp], angles: F64) -> tuple[F64, F64]:
    """Returns value and angle of the parabola's vertex through each peak and its neighbours."""
    rows = np.arange(len(curves))
    middle = np.clip(at, 1, curves.shape[1] - 2)
    left, centre, right = curves[rows, middle - 1], curves[rows, middle], curves[rows, middle + 1]
    bend = left - 2.0 * centre + right
    inner = (at == middle) & (bend < -1e-12)
    offset = np.where(inner, 0.5 * (left - right) / np.where(inner, bend, 1.0), 0.0)
    step = angles[1] - angles[0] if len(angles) > 1 else 0.0
    scores = np.where(inner, centre - 0.25 * (left - right) * offset, curves[rows, at])
    return np.clip(scores, -1.0, 1.0), angles[at] + np.where(at == middle, offset, 0.0) * step


def _moved(pattern: NDArray[_Number], rows: int) -> NDArray[_Number]:
    """Returns the rows moved down, with zeros where there were none."""
    if rows == 0:
        return pattern
    moved = np.zeros_like(pattern)
    if rows > 0:
        moved[..., rows:, :] = pattern[..., :-rows, :]
    else:
        moved[..., :rows, :] = pattern[..., -rows:, :]
    return moved


def _fast(size: int) -> int:
    """Returns the next length whose Fourier transform is fast."""
    while True:
        rest = size
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return size
        size += 1
