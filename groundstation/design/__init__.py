"""Gain design, offline: from a formation to certified gain matrices, and their files.

The package can be called like its function ``designer.design``, so that ``gs.design(formation)`` is the same for those
who ``import groundstation as gs``, whatever was imported before.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what it works with is loaded when it works
    from groundstation.core.formation import Formation
    from groundstation.design.designer import DesignResult
    from groundstation.design.problem import Watch


class _Callable(ModuleType):
    def __call__(
        self,
        formation: Formation,
        *,
        method: str = "auto",
        gap: float | None = None,
        spectral_norm: float | None = None,
        watch: Watch | None = None,
    ) -> DesignResult:
        """See ``designer.design``."""
        from groundstation.design.designer import design
        from groundstation.design.problem import SPECTRAL_NORM

        norm = SPECTRAL_NORM if spectral_norm is None else spectral_norm
        return design(formation, method=method, gap=gap, spectral_norm=norm, watch=watch)


sys.modules[__name__].__class__ = _Callable
