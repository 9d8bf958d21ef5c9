"""Cutting a table into windows, and what every comparison needs to know of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import Windows
from fdilog.maths.noise import WindowedMean, windowed_mean
from fdilog.sources.clocks import hole_threshold_s
from fdilog.sources.shocks import Shocks
from fdilog.sources.signals import Signal
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

# A channel takes part in a window if it holds at least half of the readings its rate promises;
# below that the mean over what is left may belong to another time than that of the others.
FEWEST_PRESENT = 0.5
# Windows whose spread tells anything, and the degrees of freedom each must have.
FEWEST_COMPARED, FEWEST_DOF = 30, 5.0
# Evenly spaced ones of so many windows tell what is typical as well as all of them.
MOST_LAID = 100
# Twice the standard error of the spread of half-overlapping windows by their median, times the root
# of their number.
SIGMAS_OF_RATIO = 2.8
# A variance below this part of another is none.
ROUNDING = 1e-12
# Vibration aliased to next to nothing stands still for a second or two now and then.
SWELL_S = 5.0


def stretches(table: ChannelTable, config: Config) -> list[tuple[int, int]]:
    """Split the table at its holes: (first sample, one past the last) of each part."""
    limit = hole_threshold_s(table.period_s, config.tolerance.dropout_s)
    breaks = np.flatnonzero(np.diff(table.time_s) > limit) + 1
    edges = [0, *breaks.tolist(), len(table.time_s)]
    return [(a, b) for a, b in pairwise(edges) if b > a]


def cut(table: ChannelTable, config: Config) -> list[Windows]:
    """Cut a table into windows of every configured length; none bridges a hole.

    Windows of one length advance by ``1 - overlap`` of it; the last one ends with its stretch. A
    stretch that is too short for a length, but longer than the next shorter one, is one window.
    """
    lengths = sorted(config.windows.lengths_s)
    sizes = [max(1, round(length / table.period_s)) if table.period_s else 1 for length in lengths]
    parts = stretches(table, config)
    family = []
    shorter = 0
    for length, size in zip(lengths, sizes, strict=True):
        if size == shorter:
            continue  # at this rate it holds the same samples as the length before
        stride = max(1, round(size * (1.0 - config.windows.overlap)))
        starts: list[NDArray[np.int64]] = []
        stops: list[NDArray[np.int64]] = []
        for a, b in parts:
            if b - a >= size:
                first = np.arange(a, b - size + 1, stride)
                if first[-1] + size < b:
                    first = np.append(first, b - size)
                starts.append(first)
                stops.append(first + size)
            elif b - a > shorter:
                starts.append(np.array([a]))
                stops.append(np.array([b]))
        shorter = size
        if starts:
            family.append(spans(table, np.concatenate(starts), np.concatenate(stops), length))
    return family


def spans(
    table: ChannelTable, start: NDArray[np.int64], stop: NDArray[np.int64], length_s: float = 0.0
) -> Windows:
    """Make windows of given sample ranges."""
    return Windows(
        length_s=length_s,
        start=start,
        stop=stop,
        start_s=table.time_s[start],
        end_s=table.time_s[stop - 1],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Means over windows in which the same channels were recorded.

    Parameters
    ----------
    windows : (n,) int64
        Which of the survey's windows.
    channels
        Columns of the table that are compared here: members of one block of redundancy.
    mean : (n, k)
        Mean reading of each channel. [rad/s]
    slope : (n, k)
        Mean rate of change of each reading. [rad/s^2]
    parity : (q, k)
        Parity matrix V of these channels. [1]
    parity_mean
        Mean parity vector p, (n, q), with its covariance and degrees of freedom. [rad/s]
    typical : (q, q)
        Covariance of the mean parity vector in the middlemost of all windows of this length, for
        as many samples. [rad^2/s^2]
    restless
        By how much more than they are known to the means of all windows of this length differ from
        one another, at least; one or more. [1]
    swell, usual_swell : (n, q, q), (q, q)
        Covariance of a sample of the parity vector in windows shorter than `SWELL_S`, and in the
        middlemost of them; else zero. What of it is vibration near the logging rate may stand still
        for as long. [rad^2/s^2]
    """

    windows: NDArray[np.int64]
    channels: tuple[int, ...]
    mean: Floats
    slope: Floats
    parity: Floats
    parity_mean: WindowedMean
    typical: Floats
    restless: float
    swell: Floats
    usual_swell: Floats

    def at(self, rows: NDArray[np.int64]) -> Moments:
        """Return the moments of some of these windows."""
        return replace(
            self,
            windows=self.windows[rows],
            mean=self.mean[rows],
            slope=self.slope[rows],
            parity_mean=self.parity_mean.at(rows),
            swell=self.swell[rows],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """A table with its windows of one length: what a detector is shown.

    Parameters
    ----------
    signals
        What else of the log the configuration names, by name; for detectors of the stage `model`.
    derived
        The rates of the attitude at the instants of the table, for detectors of the stage `alone`:
        none of these is a gyro, but they show whether the vehicle turned.
    shocks
        What the accelerometers of the sources feel, for the same.
    """

    table: ChannelTable
    windows: Windows
    config: Config
    signals: Mapping[str, Signal] = field(default_factory=dict)
    derived: ChannelTable | None = None
    shocks: Shocks | None = None

    @cached_property
    def moments(self) -> tuple[Moments, ...]:
        """Means of every block of channels that can be compared with one another."""
        from fdilog.maths.geometry import blocks

        found: list[Moments] = []
        for block in blocks(self.table.axes):
            found.extend(self._block_moments(block))
        return tuple(found)

    def moments_of(self, channels: frozenset[int]) -> Moments | None:
        """Means of the block that holds some channels, where all of them were recorded."""
        from fdilog.maths.geometry import blocks

        return next(
            (
                moments
                for block in blocks(self.table.axes)
                if channels <= set(block)
                for moments in self._block_moments(block)
                if channels <= set(moments.channels)
            ),
            None,
        )

    def together(self, moments: Moments) -> tuple[NDArray[np.bool_], NDArray[np.int64], int]:
        """Find the samples that hold a reading of every channel of a block.

        Returns
        -------
        together : (n_samples,)
            Which samples of the table.
        start : (n,)
            Where each of the moments' windows begins among these.
        size
            How many of them a window holds; 0 if there is no window.
        """
        together = np.asarray(self.table.valid[:, list(moments.channels)].all(axis=1), bool)
        before = np.concatenate([[0], np.cumsum(together)])
        start = before[self.windows.start[moments.windows]]
        stop = before[self.windows.stop[moments.windows]]
        return together, start, int(stop[0] - start[0]) if len(start) else 0

    def _block_moments(self, block: tuple[int, ...]) -> Iterator[Moments]:
        from fdilog.maths.geometry import blocks

        columns = np.array(block)
        present = self._present(columns)
        patterns, which = np.unique(present, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            here = np.flatnonzero(which == number)
            channels = columns[pattern]
            # Without some of its channels a block may fall apart.
            parts = blocks(self.table.axes[channels]) if len(channels) > 1 else []
            for part in parts:
                yield from self._pattern_moments(tuple(channels[list(part)].tolist()), here)

    def _present(self, columns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which channels hold enough readings in each window, (n_windows, n_columns)."""
        valid = self.table.valid[:, columns]
        if bool(valid.all()):
            return np.ones((len(self.windows), len(columns)), bool)
        counts = np.zeros((len(valid) + 1, len(columns)))
        np.cumsum(valid, axis=0, out=counts[1:])
        held = counts[self.windows.stop] - counts[self.windows.start]
        rates = np.array([self.table.channels[c].rate_hz for c in columns])
        promised = np.minimum(1.0, rates * self.table.period_s) if self.table.period_s else 1.0
        size = (self.windows.stop - self.windows.start)[:, None]
        enough: NDArray[np.bool_] = held >= np.maximum(FEWEST_PRESENT * size * promised, 1.0)
        return enough

    def _pattern_moments(
        self, channels: tuple[int, ...], here: NDArray[np.int64]
    ) -> Iterator[Moments]:
        from fdilog.maths.geometry import parity_matrix

        columns = list(channels)
        together = np.asarray(self.table.valid[:, columns].all(axis=1), bool)
        rows = np.flatnonzero(together)
        readings = self.table.rate_rad_s[:, columns]
        time_s = self.table.time_s
        start, stop = self.windows.start[here], self.windows.stop[here]
        if len(rows) < len(together):
            before = np.concatenate([[0], np.cumsum(together)])
            start, stop = before[start], before[stop]
            readings, time_s = readings[rows], time_s[rows]
        parity = parity_matrix(self.table.axes[columns])
        residuals = readings @ parity.T
        sums = np.zeros((len(readings) + 1, len(columns)))
        np.cumsum(readings, axis=0, out=sums[1:])
        sizes = stop - start
        looks: dict[int, WindowedMean] = {}
        for size in np.unique(sizes[sizes > 0]).tolist():
            looks[size] = _looks(residuals, start[sizes == size], size)
        swell = np.zeros((len(here), len(parity), len(parity)))
        for size in looks:
            swell[sizes == size] = self._swell(residuals, start[sizes == size], size)
        usual_swell = _median(swell[sizes > 0], parity)
        for alike, family in self._families(looks, residuals):
            typical = _middlemost(family, parity)
            restless = _restless(list(family.values()), parity)
            for size in alike:
                of_size = np.flatnonzero(sizes == size)
                first, last = start[of_size], stop[of_size] - 1
                elapsed = np.maximum(time_s[last] - time_s[first], self.table.period_s)[:, None]
                rise = readings[last] - readings[first]
                yield Moments(
                    windows=here[of_size],
                    channels=channels,
                    mean=(sums[last + 1] - sums[first]) / size,
                    slope=np.divide(rise, elapsed, out=np.zeros_like(rise), where=elapsed > 0),
                    parity=parity,
                    parity_mean=looks[size],
                    typical=typical / size,
                    restless=restless,
                    swell=swell[of_size],
                    usual_swell=usual_swell,
                )

    def _families(
        self, looks: Mapping[int, WindowedMean], residuals: Floats
    ) -> Iterator[tuple[list[int], Mapping[int, WindowedMean]]]:
        """Tell which sizes of windows are held against which windows of the flight."""
        if self.windows.length_s == 0.0:
            for size in looks:
                yield [size], {size: _evenly_laid(residuals, size)}
        elif looks:
            # Windows of one length hold a few samples more or less.
            yield list(looks), looks

    def _swell(self, residuals: Floats, first: NDArray[np.int64], size: int) -> Floats:
        """Covariance of the samples in some windows, if they are short."""
        q = residuals.shape[1]
        if not 0.0 < self.windows.length_s < SWELL_S:
            return np.zeros((len(first), q, q))
        view = np.lib.stride_tricks.sliding_window_view(residuals, size, axis=0)[first]
        apart = view - view.mean(axis=2, keepdims=True)
        return np.asarray(apart @ np.swapaxes(apart, 1, 2) / size, np.float64)


def evenly_spaced(n: int, most: int) -> NDArray[np.int64]:
    """Choose so many of n windows, or fewer, from the first to the last."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


def _looks(residuals: Floats, first: NDArray[np.int64], size: int) -> WindowedMean:
    """Look at windows of so many samples."""
    view = np.lib.stride_tricks.sliding_window_view(residuals, size, axis=0)
    return windowed_mean(view[first].transpose(0, 2, 1))


def _evenly_laid(residuals: Floats, size: int) -> WindowedMean:
    """Look at the quieter half of windows of so many samples laid evenly over a flight.

    Windows that are laid to fit are held against them; most of a short flight's may hold a part of
    the fault.
    """
    starts = np.arange(0, len(residuals) - size + 1, max(1, size // 2))
    looks = _looks(residuals, starts[evenly_spaced(len(starts), MOST_LAID)], size)
    loudness = np.einsum("wii->w", looks.covariance)
    quiet = loudness <= np.median(loudness)
    return looks.at(quiet)


def _restless(family: Sequence[WindowedMean], parity: Floats) -> float:
    """Ratio of the spread of the means of windows to what each window says of it; one or more.

    Vibration near the logging rate comes back as a swell of seconds, of which a shorter window sees
    no more than a constant. Only a comparison of windows shows it. Faults of less than half of the
    flight do not: the median is taken of squared distances from the median.
    """
    mean = np.concatenate([looks.mean[looks.dof > FEWEST_DOF] for looks in family])
    covariance = np.concatenate([looks.covariance[looks.dof > FEWEST_DOF] for looks in family])
    n, q = len(mean), len(parity)
    strength = np.linalg.eigvalsh(covariance)
    # Readings that never change leave nothing to compare with.
    if n < FEWEST_COMPARED or not bool((strength[:, 0] > ROUNDING * strength[:, -1]).all()):
        return 1.0
    apart = mean - parity @ np.median(mean @ parity, axis=0)
    distance = np.einsum("wi,wij,wj->w", apart, np.linalg.inv(covariance), apart)
    # Median of chi-square by E. B. Wilson and M. M. Hilferty, PNAS 17, 1931, 684-688.
    ratio = np.sqrt(float(np.median(distance)) / (q * (1.0 - 2.0 / (9.0 * q)) ** 3))
    return float(max(1.0, ratio * (1.0 - SIGMAS_OF_RATIO / np.sqrt(n))))


def _middlemost(family: Mapping[int, WindowedMean], parity: Floats) -> Floats:
    """Median of the covariances of windows, each times its samples."""
    known = [size * looks.covariance[looks.dof > 0] for size, looks in family.items()]
    empty = np.zeros((0, len(parity), len(parity)))
    return _median(np.concatenate([empty, *known]), parity)


def _median(covariance: Floats, parity: Floats) -> Floats:
    """Median of covariances (n, q, q) in the space of the channels.

    There it does not depend on the basis of the parity space.
    """
    if not len(covariance):
        return np.zeros((len(parity), len(parity)))
    median = np.median(parity.T @ covariance @ parity, axis=0)
    return np.asarray(parity @ median @ parity.T, np.float64)
