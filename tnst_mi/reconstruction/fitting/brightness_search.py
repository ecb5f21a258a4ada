"""The brightness of smoke as the root of a derivative, each value of which takes a descent.

Thin smoke shows the product c σ of brightness and extinction alone, so that c is decided by how pixels saturate, and by
whether all views agree on that: along a narrow valley, in which no descent gets far. So c is held while the extinction
is fitted, and then changed. Where the extinction fits best for a given c, the derivative of what it minimises with
respect to c is the partial one (the envelope theorem), which needs no further descent. Its root is found by secants in
1/c; once it lies between two values, by the Illinois method (Dowell and Jarratt 1971), since the derivative is much
steeper where smoke would have to be darker than its picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field

#: By what factor 1/c changes at most from one value to the next, and by what one changes where there is only one value.
_MOST, _FIRST = 1.7, 1.1


@dataclass
class BrightnessSearch:
    """Where the derivative has been taken on one grid.

    Attributes:
        points: inverse brightness and derivative with respect to it, in their order.
    """

    points: list[tuple[float, float]] = field(default_factory=list)

    def next(self, inverse: float, derivative: float) -> float:
        """The inverse brightness to go on with, by the derivative at the present one."""
        self.points.append((inverse, derivative))
        if derivative == 0:
            return inverse
        uphill = derivative > 0
        guess = inverse / _FIRST if uphill else inverse * _FIRST
        others = [number for number, (_, value) in enumerate(self.points) if (value > 0) != uphill]
        if others:
            # The end that stays is made less of each time, so that it does not stay for ever.
            place, value = self.points[others[-1]]
            other = place, value / 2 ** (len(self.points) - 2 - others[-1])
        else:
            other = self.points[max(0, len(self.points) - 2)]
        if other[0] != inverse and other[1] != derivative:
            root = inverse - derivative * (inverse - other[0]) / (derivative - other[1])
            # Where the derivative grows away from the root there is no valley: go downhill then.
            if (root < inverse) == uphill:
                guess = root
        return min(max(guess, inverse / _MOST), inverse * _MOST)
