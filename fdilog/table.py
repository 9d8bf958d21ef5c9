"""The table of redundant gyro channels that every detector works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


# Cosine of the angle within which two axes count as one: mounting errors are a few degrees.
PARALLEL = float(np.cos(np.radians(10.0)))


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One scalar gyro.

    Parameters
    ----------
    axis
        Unit sensitivity axis in the body frame (a row of H).
    rate_hz
        Nominal rate at which it was logged. [Hz]
    samples
        How many readings of it the log holds.
    step_rad_s
        Quantisation step of its readings, 0 where none shows. [rad/s]
    batched
        Whether it comes in short batches, and is silent between them on purpose.
    apart_s
        How far from the instants of the table it was read, median of the modulus. [s]
    """

    name: str
    source: str
    axis: tuple[float, float, float]
    rate_hz: float
    samples: int
    step_rad_s: float = 0.0
    derived: bool = False
    batched: bool = False
    apart_s: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelTable:
    """Readings of all gyro channels on one time base.

    Parameters
    ----------
    time_s : (n_samples,)
        Flight time since the first gyro sample of the log, strictly increasing. [s]
    rate_rad_s : (n_samples, n_channels)
        Readings z. NaN where not valid. [rad/s]
    valid : (n_samples, n_channels) bool
        Whether a reading was really logged there; a gap is False, never filled.
    period_s
        Nominal step of the time base. [s]
    deviation_rad_s : (n_samples, n_channels) or None
        How far each reading lay from the mean of the two beside it when it was logged, NaN where
        that is not known. Readings interpolated to the time base are smoother than those they were
        made from; None if none is. [rad/s]
    """

    time_s: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    valid: NDArray[np.bool_]
    channels: tuple[Channel, ...]
    period_s: float = field(default=0.0)
    deviation_rad_s: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n_samples, n_channels = len(self.time_s), len(self.channels)
        if self.rate_rad_s.shape != (n_samples, n_channels):
            raise ValueError(
                f"rate_rad_s is {self.rate_rad_s.shape}, expected {(n_samples, n_channels)}"
            )
        if self.valid.shape != self.rate_rad_s.shape:
            raise ValueError(f"valid is {self.valid.shape}, expected {self.rate_rad_s.shape}")
        deviation = self.deviation_rad_s
        if deviation is not None and deviation.shape != self.rate_rad_s.shape:
            raise ValueError(
                f"deviation_rad_s is {deviation.shape}, expected {self.rate_rad_s.shape}"
            )
        if n_samples > 1 and not bool((np.diff(self.time_s) > 0).all()):
            raise ValueError("time_s must increase strictly")
        if not bool((np.isfinite(self.rate_rad_s) | ~self.valid).all()):
            raise ValueError("a valid reading must be finite")
        if self.period_s <= 0.0:
            step = float(np.median(np.diff(self.time_s))) if n_samples > 1 else 0.0
            object.__setattr__(self, "period_s", step)
        for array in (self.time_s, self.rate_rad_s, self.valid):
            array.flags.writeable = False

    @property
    def axes(self) -> NDArray[np.float64]:
        """Sensitivity axes H, (n_channels, 3)."""
        return np.array([channel.axis for channel in self.channels], float).reshape(-1, 3)

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names, in column order."""
        return tuple(channel.name for channel in self.channels)

    @property
    def duration_s(self) -> float:
        """From the first to the last sample. [s]"""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0

    def along(self, channel: int) -> NDArray[np.bool_]:
        """Tell which other channels sense along the axis of this one, either way."""
        axes = self.axes
        found: NDArray[np.bool_] = np.abs(axes @ axes[channel]) > PARALLEL
        found[channel] = False
        return found

    @property
    def gyros(self) -> ChannelTable:
        """The table without derived channels; itself if it holds none."""
        return self.columns([k for k, channel in enumerate(self.channels) if not channel.derived])

    def columns(self, kept: Sequence[int]) -> ChannelTable:
        """Return the table with some of its channels, in the order given.

        Neighbouring ones are a view: a long flight is not held in memory once again.
        """
        if list(kept) == list(range(len(self.channels))):
            return self
        neighbours = len(kept) > 0 and list(kept) == list(range(kept[0], kept[0] + len(kept)))
        chosen = slice(kept[0], kept[0] + len(kept)) if neighbours else list(kept)
        deviation = self.deviation_rad_s
        return replace(
            self,
            rate_rad_s=self.rate_rad_s[:, chosen],
            valid=self.valid[:, chosen],
            channels=tuple(self.channels[k] for k in kept),
            deviation_rad_s=None if deviation is None else deviation[:, chosen],
        )

    def beside(
        self,
        rate_rad_s: NDArray[np.float64],
        valid: NDArray[np.bool_],
        channels: Sequence[Channel],
    ) -> ChannelTable:
        """Return the table with more channels behind its own, as logged at its instants."""
        deviation = self.deviation_rad_s
        return replace(
            self,
            rate_rad_s=side_by_side([self.rate_rad_s, rate_rad_s]),
            valid=side_by_side([self.valid, valid]),
            channels=(*self.channels, *channels),
            deviation_rad_s=None
            if deviation is None
            else side_by_side([deviation, np.full_like(rate_rad_s, np.nan)]),
        )

    def between(self, start_s: float, end_s: float) -> ChannelTable:
        """Return the part with start_s <= time_s <= end_s; times stay flight times."""
        keep = (self.time_s >= start_s) & (self.time_s <= end_s)
        return self.only(keep)

    def only(self, keep: NDArray[np.bool_]) -> ChannelTable:
        """Return the rows where keep is true; the time between them becomes a gap."""
        deviation = self.deviation_rad_s
        return replace(
            self,
            time_s=self.time_s[keep],
            rate_rad_s=self.rate_rad_s[keep],
            valid=self.valid[keep],
            deviation_rad_s=None if deviation is None else deviation[keep],
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return a DataFrame indexed by time_s with one column per channel, NaN where invalid."""
        import pandas as pd

        index = pd.Index(self.time_s, name="time_s")
        return pd.DataFrame(self.rate_rad_s, index=index, columns=list(self.names))

    @classmethod
    def from_pandas(cls, frame: pd.DataFrame, axes: NDArray[np.float64]) -> ChannelTable:
        """Make a table from a frame of rates in rad/s.

        Parameters
        ----------
        frame
            One column per channel [rad/s], NaN where there is no reading; the index, or a column
            ``time_s``, holds strictly increasing seconds.
        axes : (n_channels, 3)
            Sensitivity axes H in column order; they are normalised.

        Raises
        ------
        ValueError
            If shapes disagree, time does not increase, or an axis is zero.
        """
        if "time_s" in frame.columns:
            frame = frame.set_index("time_s")
        rate = frame.to_numpy(dtype=float, copy=True)
        time = frame.index.to_numpy(dtype=float, copy=True)
        axes = np.asarray(axes, float)
        length = np.linalg.norm(axes, axis=1) if axes.ndim == 2 else np.zeros(1)
        if axes.shape != (rate.shape[1], 3) or not bool((length > 0).all()):
            raise ValueError(f"axes must be {(rate.shape[1], 3)} non-zero rows, got {axes.shape}")
        valid = np.isfinite(rate)
        rate[~valid] = np.nan
        step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        channels = tuple(
            Channel(
                name=str(name),
                source=str(name).rpartition(".")[0] or str(name),
                axis=(float(axis[0]), float(axis[1]), float(axis[2])),
                rate_hz=1.0 / step if step > 0 else 0.0,
                samples=int(valid[:, column].sum()),
            )
            for column, (name, axis) in enumerate(
                zip(frame.columns, axes / length[:, None], strict=True)
            )
        )
        return cls(time_s=time, rate_rad_s=rate, valid=valid, channels=channels, period_s=step)


def side_by_side(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Join arrays of columns, each column in one piece of memory."""
    return np.concatenate([part.T for part in columns]).T
