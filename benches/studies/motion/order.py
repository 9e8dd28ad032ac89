"""Order of convergence: the slope of error against step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Number of steps for the fit of a slope.
FITTED = 3
#: Errors above this, rad or m, are excluded.
LARGEST = 0.1


def fitted(steps: Sequence[float], errors: Sequence[float]) -> float | None:
    """Slope over the finest steps, of errors that are known and small; None if there are too few."""
    chosen = sorted((h, e) for h, e in zip(steps, errors, strict=True) if 0.0 < e <= LARGEST)[:FITTED]
    if len(chosen) < FITTED:
        return None
    h, e = np.log([row[0] for row in chosen]), np.log([row[1] for row in chosen])
    return float(np.polyfit(h, e, 1)[0])


def local(coarse: float, fine: float) -> float | None:
    """Order from two errors, of a step and of half of it."""
    return float(np.log2(coarse / fine)) if coarse > 0.0 and fine > 0.0 and np.isfinite(coarse * fine) else None
