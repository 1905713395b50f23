# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Modules of one nodelet's own, beside those that the process shares.

Code that is executed with ``__builtins__`` of its own imports by the ``__import__`` in there.
Functions keep the globals that they were defined in, so every thread that runs such code finds
the same modules. An ``Importer`` is that ``__import__``: it executes copies of some modules, puts
*views* in place of some (rospy as one nodelet is to see it), and leaves the rest to Python.
"""

from __future__ import annotations

import builtins
import collections
import dataclasses
import importlib
import importlib.util
import sys
import threading
import types
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from typing import Any, Callable, Collection, Iterator, Mapping, MutableMapping, Sequence

from dyknow.locks import state_condition
from dyknow.nodelet.loading.module_files import forget_bytecode, is_standard, package_spec
from dyknow.periodic import current_frames

Module = types.ModuleType

#: Subpackages that hold messages, whose classes the whole process shares.
_MESSAGES = ("msg", "srv")


class View(Module):
    """A proxy module that overrides some members of a real module, or adds some."""

    def __init__(self, real: Module, members: Mapping[str, Any]) -> None:
        super().__init__(real.__name__, real.__doc__)
        public = getattr(real, "__all__", None)
        if public is None:
            public = [name for name in vars(real) if not name.startswith("_")]
        self.__dict__.update(members, __all__=sorted({*public, *members}), _real=real)
        if hasattr(real, "__path__"):
            self.__path__ = real.__path__

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_real"], name)


class Importer:
    """The modules of one owner."""

    def __init__(
        self,
        is_own: Callable[[str], bool],
        folders: Sequence[str] = (),
        views: Mapping[str, Callable[[], Module]] | None = None,
        blind: Collection[str] = (),
        functions: Mapping[str, Any] | None = None,
        search: Sequence[str] = (),
        is_alone: bool = False,
    ) -> None:
        """Make an importer without copies.

        Args:
            is_own: whether to copy a top-level module or, by its full name, one below a view.
            folders: their modules are copied; they are searched first.
            views: make a view, by the name of the module, when that is imported.
            blind: top-level names of copies that see the process's modules, not the views.
            functions: replacements of built-in functions.
            search: further folders, searched before those of the process.
            is_alone: the process is the owner's: copies are in ``sys.modules`` too, and the path
                is ``sys.path`` itself.
        """
        #: By name: views, copies, and modules of the process that these import.
        self.modules: dict[str, Module] = {}
        #: Where modules are searched; code may change it.
        self.path = [*folders, *search, *sys.path]
        self._search = frozenset(search)
        self._is_alone = is_alone
        self._shared_path: Sequence[str] = sys.path
        if is_alone:
            self._shared_path = list(sys.path)
            sys.path[:] = self.path
            self.path = sys.path
        self._folders = frozenset(folders)
        self._hidden = frozenset(views or ())  # from modules that are blind
        self._views = {
            "importlib": lambda: View(importlib, {"import_module": self.import_module}),
            "dataclasses": lambda: View(dataclasses, {"dataclass": self._dataclass}),
            **(views or {}),
        }
        self._is_own = is_own
        self._blind = frozenset(blind)
        self._found: dict[str, bool] = {}
        self._found_on: tuple[str, ...] = ()
        self._makers = _Makers()
        own = {**vars(builtins), **(functions or {})}
        self._seeing = {**own, "__import__": self._import_seeing}
        self._unseeing = {**own, "__import__": self._import_blindly}

    def prepare(self, name: str, file: str) -> Module:
        """Make the module in which a file is to be executed by the caller."""
        module = self.modules[name] = Module(name)
        module.__dict__.update(__file__=file, __builtins__=self._seeing)
        return module

    def import_module(self, name: str, package: str | None = None) -> Module:
        name = importlib.util.resolve_name(name, package) if name.startswith(".") else name
        return self._load(name) if self._concerns(name) else importlib.import_module(name)

    def everything(self) -> MutableMapping[str, Module]:
        """The ``sys.modules`` of its code."""
        return (_AllModules if self._is_alone else collections.ChainMap)(self.modules, sys.modules)

    def files(self) -> Iterator[str]:
        """List the source files of the copies."""
        for name, module in list(self.modules.items()):
            if name not in self._views and sys.modules.get(name) is not module:
                yield getattr(module, "__file__", None) or ""

    def clear(self) -> bool:
        """Empty the copies, whose parts refer to each other; False while a thread runs them."""
        copies = [
            vars(module)
            for name, module in self.modules.items()
            if name not in self._views and sys.modules.get(name) is not module
        ]
        if _is_running(frozenset(map(id, copies))):
            return False
        for space in copies:  # first the objects: their finalizers may need the code
            for name in [each for each in space if each != "__builtins__"]:
                if not isinstance(space[name], (type, Module, types.FunctionType)):
                    space[name] = None
        for space in copies:
            space.clear()
        self.modules.clear()
        return True

    # Inside

    def _dataclass(self, cls: type[Any] | None = None, **options: Any) -> Any:
        """Replace ``dataclass``, which needs its module, a copy here, in ``sys.modules``.

        It is there under a name of its own for so long: the process may have another of its name.
        """

        def make(cls: type[Any]) -> Any:
            name, lent = cls.__module__, f"{cls.__module__}, {id(cls)}"
            if name not in self.modules:
                return dataclasses.dataclass(**options)(cls)
            sys.modules[lent] = self.modules[name]
            cls.__module__ = lent
            try:
                made = dataclasses.dataclass(**options)(cls)
            finally:
                cls.__module__ = name
                del sys.modules[lent]
            made.__module__ = name  # with slots it is another class
            return made

        return make if cls is None else make(cls)

    def _import(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> Module:
        if level:
            name = importlib.util.resolve_name("." * level + name, _package(globals or {}))
        if not self._concerns(name):
            return builtins.__import__(name, globals, locals, fromlist or (), 0)
        module = self._load(name)
        if not fromlist:
            return self._load(name.partition(".")[0])
        if hasattr(module, "__path__"):
            wanted = getattr(module, "__all__", ()) if "*" in fromlist else fromlist
            for item in wanted:
                full_name = f"{name}.{item}"
                if not hasattr(module, item) or full_name in self.modules:  # maybe incomplete
                    try:
                        vars(module).setdefault(item, self._load(full_name))
                    except ModuleNotFoundError as error:
                        if error.name != full_name:
                            raise
        return module

    def _import_seeing(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> Module:
        """Import; ``*`` of a module of the process brings views along, not what they hide."""
        module = self._import(name, globals, locals, fromlist, level)
        if "*" not in (fromlist or ()):
            return module
        brought = {each: vars(module).get(each) for each in View(module, {}).__all__}
        views = {
            each: self._load(other.__name__)
            for each, other in brought.items()
            if isinstance(other, Module) and other.__name__ in self._views
        }
        return View(module, views) if views else module

    def _import_blindly(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> Module:
        hides = not level and name.partition(".")[0] in self._hidden
        load: Callable[..., Module] = builtins.__import__ if hides else self._import
        return load(name, globals, locals, fromlist or (), level)

    def _concerns(self, name: str) -> bool:
        top = name.partition(".")[0]
        if top in self.modules or top in self._views:
            return True
        if self._found_on != tuple(self.path):
            self._found, self._found_on = {}, tuple(self.path)  # in this order
        found = self._found  # another thread may replace it
        if top not in found:
            found[top] = self._is_own(top) or self._is_in_folders(top)
        return found[top]

    def _is_in_folders(self, top: str) -> bool:
        shared = self._search.union(self._shared_path) - self._folders
        folders = [each for each in self.path if each not in shared]
        return not is_standard(top) and PathFinder.find_spec(top, folders) is not None

    def _load(self, name: str) -> Module:
        above, _, child = name.rpartition(".")
        if above and not self._makers.has_made(name, self.modules):
            self._load(above)
        if self._makers.claim(name, self.modules):
            try:
                self._make(name, self.modules.get(above), child)
            finally:
                self._makers.give_up(name)
        return self.modules[name]

    def _make(self, name: str, parent: Module | None, child: str) -> None:
        spec = None if name in self._views else self._spec(name, parent)
        if name in self._views:
            self.modules[name] = self._views[name]()
        elif spec is None:
            self.modules[name] = importlib.import_module(name)
        else:
            module = self.modules[name] = importlib.util.module_from_spec(spec)
            if self._is_alone:
                sys.modules[name] = module
            if parent is not None:
                setattr(parent, child, module)  # first: modules of a package may need it
            try:
                self._execute(module, spec)
            except BaseException:
                self.modules.pop(name, None)
                if self._is_alone:
                    sys.modules.pop(name, None)
                if parent is not None:
                    vars(parent).pop(child, None)
                raise
        if parent is not None:
            setattr(parent, child, self.modules[name])

    def _spec(self, name: str, parent: Module | None) -> ModuleSpec | None:
        """Find the code of a module; None if it is to be that of the process."""
        if parent is None:
            spec = package_spec(name, self.path)
            is_ours = True
        else:
            spec = PathFinder.find_spec(name, getattr(parent, "__path__", ()))
            is_ours = name.split(".")[1] not in _MESSAGES
            if isinstance(parent, View):
                is_ours = self._is_own(name)
        if not is_ours:
            return None
        if spec is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if spec.loader is None or isinstance(spec.loader, SourceFileLoader):
            return spec
        # An extension: the process has it once, unless it is beside a script.
        is_known = importlib.util.find_spec(name.partition(".")[0]) is not None
        return None if is_known else spec

    def _execute(self, module: Module, spec: ModuleSpec) -> None:
        if not isinstance(spec.loader, SourceFileLoader):
            if spec.loader is not None:
                spec.loader.exec_module(module)
            return
        forget_bytecode([spec.loader.path])
        code = spec.loader.get_code(module.__name__)
        assert code is not None  # a source file has code
        is_blind = module.__name__.partition(".")[0] in self._blind
        module.__dict__["__builtins__"] = self._unseeing if is_blind else self._seeing
        exec(code, module.__dict__)


class _Makers:
    """Which thread makes which module; the others that import it wait, as in Python.

    Where they would wait for each other, one of them goes on with the incomplete module.
    """

    def __init__(self) -> None:
        self._changed = state_condition("makers of modules")
        self._makers: dict[str, int] = {}
        self._awaited: dict[int, str] = {}

    def claim(self, name: str, made: Collection[str]) -> bool:
        """Return whether this thread is to make a module, which may have to wait for others."""
        me = threading.get_ident()
        with self._changed:
            while name in self._makers:
                if self._awaits(name, me):
                    return False
                self._awaited[me] = name
                try:
                    self._changed.wait()
                finally:
                    del self._awaited[me]
            if name in made:
                return False
            self._makers[name] = me
            return True

    def has_made(self, name: str, made: Collection[str]) -> bool:
        with self._changed:
            return name in made and name not in self._makers

    def give_up(self, name: str) -> None:
        with self._changed:
            del self._makers[name]
            self._changed.notify_all()

    def _awaits(self, name: str | None, thread: int) -> bool:
        """Whether a module waits for a thread, or for a module that does."""
        while name in self._makers:
            maker = self._makers[name]
            if maker == thread:
                return True
            name = self._awaited.get(maker)
        return False


def _is_running(spaces: frozenset[int]) -> bool:
    """Whether a thread runs code with one of these global namespaces, by their identities."""
    frames: list[types.FrameType | None] = list(current_frames().values())
    while frames:
        frame = frames.pop()
        if frame is not None:
            if id(frame.f_globals) in spaces:
                return True
            frames.append(frame.f_back)
    return False


class _AllModules(collections.ChainMap):  # type: ignore[type-arg]
    """The modules of an owner in front of the process's, which follow every change."""

    def __setitem__(self, name: str, module: Any) -> None:
        for modules in self.maps:
            modules[name] = module

    def __delitem__(self, name: str) -> None:
        if name not in self:
            raise KeyError(name)
        for modules in self.maps:
            modules.pop(name, None)


def _package(namespace: Mapping[str, Any]) -> str:
    package = namespace.get("__package__")
    if package is not None:
        return str(package)
    name = str(namespace.get("__name__", ""))
    return name if "__path__" in namespace else name.rpartition(".")[0]
