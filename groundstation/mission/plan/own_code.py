"""Finds the laws and the avoidance that a mission names: code of its author's own, by entry point or ``module:name``.

Running somebody's code is what is asked for here, and is done for nobody who does not ask: a mission file names it, and
of a log it is loaded only from where its reader says, and only when it is, byte by byte, what was flown.
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

from groundstation.core.errors import UserError
from groundstation.core.files import is_file
from groundstation.core.law import Answer, in_words

LAW, AVOIDANCE = "law", "avoidance.law"
"""Keys of a mission under which code of one's own is named."""
GROUPS = {LAW: "groundstation.laws", AVOIDANCE: "groundstation.avoidance"}
"""Entry points by which installed packages offer theirs."""


@dataclass(frozen=True)
class OwnCode:
    """A law, or avoidance, that is not ours.

    Attributes:
        use: how the mission names it.
        make: makes a new one, for one flight.
        version: as its package or module has it; "" without one.
        sha256: of the file it was read from; "" where there is none.
    """

    use: str
    make: Callable[[], Answer]
    version: str
    sha256: str

    def record(self) -> dict[str, str]:
        """What a manifest keeps of it."""
        return {"use": self.use, "version": self.version, "sha256": self.sha256}


@dataclass(frozen=True)
class CodeSource:
    """Where code is looked for.

    Attributes:
        folders: looked through for MODULE.py in this order, before what is installed.
        given: code that is there already, by the mission's key: classes and functions of a notebook.
        flown: what a flight's manifest says of its code, by key; another file is refused. None for a mission file.
    """

    folders: tuple[Path, ...] = ()
    given: Mapping[str, Answer] = field(default_factory=dict)
    flown: Mapping[str, object] | None = None

    def find(self, key: str, use: str, options: Mapping[str, object], source: str) -> OwnCode:
        """Loads what a mission names, and makes one to see that it can be made.

        Args:
            key: of the mission: ``law`` or ``avoidance.law``.
            use: ``module:name``, or the name of an entry point.
            options: handed to its constructor.
            source: the mission, for messages.

        Raises:
            UserError: there is none of that name, it cannot be loaded or made, or it is not what was flown.
        """
        where = f"{source}: {key}"
        made: object
        if key in self.given:
            made, version, content = self.given[key], "", _content_of(self.given[key])
            self._check(where, key, use, content)
        elif ":" in use:
            made, version, content = self._by_file(where, key, use)
        else:
            made, version, content = _by_entry_point(where, key, use)
            self._check(where, key, use, content)
        if not callable(made):
            raise UserError(f"{where}: {use} cannot be called; name a function, or a class whose objects can be called")
        code = OwnCode(use, partial(_make, where, use, made, dict(options)), version, _sha256(content))
        code.make()
        return code

    def _by_file(self, where: str, key: str, use: str) -> tuple[object, str, bytes]:
        """A name of a module in one of the folders, or of one that Python finds."""
        name, _, attribute = use.partition(":")
        if not all(part.isidentifier() for part in [*name.split("."), *attribute.split(".")]):
            raise UserError(f"{where}: {use} is no name; write MODULE:NAME, for example my_law:MyLaw")
        path = next((found for found in self._paths(name) if is_file(found)), None)
        if path is None:
            with _own_errors(where, use):
                try:
                    module = importlib.import_module(name)
                except ModuleNotFoundError as error:
                    if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                        raise
                    looked = ", ".join(str(found) for found in self._paths(name)) or "no folder"
                    remedy = "correct the name" if self.flown is None else "name its folder with --laws"
                    raise UserError(f"{where}: there is no module {name} (looked for {looked}); {remedy}") from None
            content = _content_of(module)
            self._check(where, key, use, content)
        else:
            content = path.read_bytes()
            self._check(where, key, use, content)  # before a line of it is run
            with _own_errors(where, use):
                module = _run(path, content)
        found: object = module
        for part in attribute.split("."):
            found = getattr(found, part, None)
        if found is None:
            near = difflib.get_close_matches(attribute, [item for item in vars(module) if item[0] != "_"], n=1)
            hint = f", did you mean {near[0]}?" if near else ""
            raise UserError(f"{where}: {use}: {getattr(module, '__file__', name)} has no {attribute}{hint}")
        return found, str(getattr(module, "__version__", "")), content

    def _paths(self, module: str) -> Iterator[Path]:
        return (folder / f"{module.replace('.', '/')}.py" for folder in self.folders)

    def _check(self, where: str, key: str, use: str, content: bytes) -> None:
        """Refuses other code than what a log was flown with."""
        if self.flown is None:
            return
        told = self.flown.get(key)
        if not isinstance(told, Mapping) or told.get("sha256") != _sha256(content):
            version = told.get("version") if isinstance(told, Mapping) else ""
            which = f"version {version} of it" if version else "another version of it"
            raise UserError(
                f"{where}: {use} is not the code that was flown ({which}, SHA-256"
                f" {str(told.get('sha256') if isinstance(told, Mapping) else None)[:12]}..., here"
                f" {_sha256(content)[:12]}...); name the folder of that one with --laws"
            )


def _by_entry_point(where: str, key: str, use: str) -> tuple[object, str, bytes]:
    """What an installed package offers under a name."""
    offered = {point.name: point for point in metadata.entry_points(group=GROUPS[key])}
    if use not in offered:
        known = f"installed are {', '.join(sorted(offered))}" if offered else "none is installed"
        raise UserError(
            f"{where}: no {use} is offered by the entry points {GROUPS[key]} ({known}); name one of those, or write"
            " MODULE:NAME for a file beside the mission"
        )
    point = offered[use]
    with _own_errors(where, use):
        found = point.load()
    content = _content_of(inspect.getmodule(found) or found)
    return found, point.dist.version if point.dist is not None else "", content


def _run(path: Path, content: bytes) -> ModuleType:
    """Runs a file as a module of its own; anew each time, so that it is what the file says now."""
    name = f"_own_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{path.stem}"
    spec = importlib.util.spec_from_loader(name, loader=None, origin=str(path))
    module = importlib.util.module_from_spec(spec) if spec is not None else ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses look their module up
    sys.path.append(str(path.parent))  # what lies beside it can be imported by it
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)  # noqa: S102 - what is asked for
    finally:
        sys.path.remove(str(path.parent))
    return module


@contextlib.contextmanager
def _own_errors(where: str, use: str) -> Iterator[None]:
    """Whatever loading somebody's code raises is told in a sentence."""
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise UserError(f"{where}: {use} cannot be loaded: {in_words(error)}") from None


def _make(where: str, use: str, found: Answer, options: Mapping[str, object]) -> Answer:
    """One for a flight: an object of a class, or the function with its options."""
    if not inspect.isclass(found):
        return partial(found, **options) if options else found
    try:
        made = found(**options)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        given = f" with options {dict(options)}" if options else ""
        raise UserError(f"{where}: {use} cannot be made{given}: {in_words(error)}") from None
    if not callable(made):
        raise UserError(f"{where}: {use}: its objects cannot be called; give it a method __call__(self, seen)")
    return made


def _content_of(thing: object) -> bytes:
    """The file that a module comes from, or the source of something in a notebook; empty where there is neither."""
    module = thing if inspect.ismodule(thing) else inspect.getmodule(thing)
    file = getattr(module, "__file__", None)
    if file is not None and is_file(Path(file)):
        return Path(file).read_bytes()
    if isinstance(thing, type | FunctionType | MethodType):
        with contextlib.suppress(OSError, TypeError):
            return inspect.getsource(thing).encode()
    return b""


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest() if content else ""


def name_of(thing: object) -> str:
    """``module:name`` of a class or function."""
    kind = thing if isinstance(thing, type | FunctionType | MethodType | BuiltinFunctionType) else type(thing)
    return f"{kind.__module__}:{kind.__qualname__}".replace(".<locals>", "")
