"""One line of a comparison with a paper."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal


@dataclass(frozen=True, kw_only=True)
class Row:
    """A figure as printed and as computed.

    Parameters
    ----------
    table
        Where it is printed.
    quantity
        What it is.
    printed
        The printed value; None where the paper gives none.
    ours
        What this program computes.
    agrees
        Whether the two agree within what the comparison allows, which `note` says; None where
        there is nothing to agree with.
    note
        What is compared and how closely.
    """

    table: str
    quantity: str
    printed: float | str | None
    ours: float | str
    agrees: bool | None
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Computed less printed; None where one of them is no number."""
        if isinstance(self.printed, str | None) or isinstance(self.ours, str):
            return None
        return self.ours - self.printed


def rounded(table: str, quantity: str, *, printed: float, ours: float, places: int) -> Row:
    """Compare a figure that should come out as printed, to half a unit of its last place."""
    # The second term lets a tie of decimal rounding, such as 0.00005, fall either way.
    allowed = 0.5 * 10.0**-places * (1.0 + 1e-6)
    return Row(
        table=table,
        quantity=quantity,
        printed=printed,
        ours=ours,
        agrees=abs(ours - printed) <= allowed,
        note=f"to {places} decimals",
    )


def counted(
    table: str, quantity: str, *, printed: str, ours: float, trials: int, remark: str = ""
) -> Row:
    """Compare a share that the paper counted in a number of random trials, in per cent.

    It agrees if the printed share lies in the central 95 % of what that number of trials gives
    when ours is the true one (normal approximation of the binomial), give or take half a unit of
    the last digit in print.

    Parameters
    ----------
    printed
        Per cent, with just the digits of the paper: "8" is any share from 7.5 to 8.5 %.
    ours
        Share. [1]
    """
    per_cent = Decimal(printed)
    share, half_unit = float(per_cent) / 100.0, float(last_digit(per_cent)) / 200.0
    half_width = 1.96 * (ours * (1.0 - ours) / trials) ** 0.5
    apart = abs(ours - share)
    said = (
        f"{ours:.2%} against {printed} %: within {half_width:.4f}, 95 % of {trials} trials, and"
        f" {half_unit:g}, half a unit of the last digit in print"
    )
    if half_width < apart <= half_width + half_unit:
        said += f"; at the edge: {apart:.4f} is more than the trials alone allow"
    return Row(
        table=table,
        quantity=quantity,
        printed=share,
        ours=ours,
        agrees=apart <= half_width + half_unit,
        note="; ".join(filter(None, [said, remark])),
    )


def last_digit(printed: Decimal) -> Decimal:
    """Return one unit of the last digit that a figure is printed with."""
    return Decimal(1).scaleb(int(printed.as_tuple().exponent))
