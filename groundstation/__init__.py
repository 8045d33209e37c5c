"""Ground station that flies teams of multirotors into 3D formations.

After Fathian, Safaoui, Summers and Gans, "Robust 3D Distributed Formation Control with Collision Avoidance".

``import groundstation as gs`` gives what ``groundstation.api`` names; each of it is loaded when it is first used.
"""

TYPE_CHECKING = False  # typing takes 10 ms to load, in which Ctrl-C is nobody's yet
if TYPE_CHECKING:
    from groundstation.api import (
        Comparison, DesignResult, Flown, Formation, Gains, Log, Mission, Seen, Tick, UserError, VerifyResult,
        compare, design, fly,
        load_formation, load_mission, read_log, report, save_gains, simulate, verify,
    )  # fmt: skip

__all__ = [
    "Comparison", "DesignResult", "Flown", "Formation", "Gains", "Log", "Mission", "Seen", "Tick", "UserError",
    "VerifyResult", "compare", "design", "fly", "load_formation", "load_mission", "read_log", "report",
    "save_gains", "simulate", "verify",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    if name == "design":  # the package of that name can be called
        return import_module("groundstation.design")
    value = globals()[name] = getattr(import_module("groundstation.api"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
