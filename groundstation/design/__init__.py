"""Gain design, offline: from a formation to certified gain matrices, and their files.

The package can be called like its function ``designer.design``, so that ``gs.design(formation)`` is the same for those
who ``import groundstation as gs``, whatever was imported before.
"""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    def __call__(self, *given: Any, **named: Any) -> Any:
        """See ``designer.design``."""
        from groundstation.design.designer import design

        return design(*given, **named)


sys.modules[__name__].__class__ = _Callable
