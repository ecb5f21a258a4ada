"""As much of Houdini's `hou` as the asset's code uses, with nodes whose parameters are those of its DialogScript."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import build_houdini_asset
import pytest
from houdini_asset.files import DEFINITION

_PARM = re.compile(r'(multiparm|parm) \{\s+name +"([^"]+)"(.*?)\n\s*\}\n', re.DOTALL)
_DEFAULT = re.compile(r"default (?:\{ (.*?) \}|(\d+))\n")


def defaults() -> dict[str, list[Any]]:
    """The default of each parameter, as its type has it, from the committed DialogScript."""
    text = (build_houdini_asset.ASSET / DEFINITION / "DialogScript").read_text(encoding="utf-8")
    found = {}
    for kind, name, block in _PARM.findall(text):
        values = _DEFAULT.search(block)
        assert values is not None, name
        texts = re.findall(r'"((?:[^"\\]|\\.)*)"', values[1] or "") if kind == "parm" else [values[2]]
        type_of = re.search(r"type +(\w+)", block)
        found[name] = [_typed(each, "integer" if kind == "multiparm" else type_of[1]) for each in texts]
    return found


def _typed(text: str, kind: str) -> Any:
    if kind in ("float", "integer", "toggle", "button") and not text.startswith("$"):
        return float(text) if kind == "float" else int(text)
    return text


class FakeParm:
    """A parameter or a tuple of them, perhaps with keyframes: values by frame."""

    def __init__(self, values: list[Any]) -> None:
        self.values, self.keyframes = values, {}

    def __iter__(self) -> Iterator[FakeParm]:
        return iter([self])

    def isTimeDependent(self) -> bool:
        return bool(self.keyframes)

    def evalAtFrame(self, frame: float) -> tuple[Any, ...]:
        return tuple(self.keyframes.get(frame, self.values))

    def evalAsStringAtFrame(self, frame: float) -> str:
        return str(self.evalAtFrame(frame)[0])

    def evalAsIntAtFrame(self, frame: float) -> int:
        return int(self.evalAtFrame(frame)[0])

    def eval(self) -> Any:
        return self.values[0] if len(self.values) == 1 else tuple(self.values)


class FakeGeometry:
    """VDBs that are a file."""

    def __init__(self, file: Path | None, kinds: tuple[str, ...] = ("VDB",), save: Any = None) -> None:
        self.file, self.kinds, self.save = file, kinds, save

    def iterPrims(self) -> Iterator[Any]:
        return iter([SimpleNamespace(type=lambda kind=kind: kind) for kind in self.kinds])

    def saveToFile(self, path: str) -> None:
        assert self.file is not None
        if self.save is not None:
            self.save(self, path)
        shutil.copyfile(self.file, path)

    def loadFromFile(self, path: str) -> None:
        self.file = Path(path)


class FakeNode:
    """The asset's node, or one above it. What is set is set by `node["eta"] = 0.01`."""

    def __init__(self, files: dict[int, Path] | None = None, above: FakeNode | None = None) -> None:
        self.parms = {name: FakeParm(values) for name, values in defaults().items()}
        self.files, self.above, self.shown, self.cooked = files or {}, above, FakeGeometry(None), 0
        self.kinds: tuple[str, ...] = ("VDB",)
        self.save: Any = None

    def __setitem__(self, name: str, value: Any) -> None:
        if isinstance(value, list) and name in ("style", "tag", "semantic", "content", "match"):
            for number, each in enumerate(value, start=1):
                self.parms[f"{name}{number}"] = FakeParm([each])
            value = len(value)
        self.parms[name] = FakeParm(list(value) if isinstance(value, tuple) else [value])

    def parm(self, name: str) -> FakeParm:
        return self.parms[name]

    def parmTuple(self, name: str) -> FakeParm:
        return self.parms[name]

    def evalParm(self, name: str) -> Any:
        return self.parms[name].eval()

    def name(self) -> str:
        return "stylize1"

    def path(self) -> str:
        return "/obj/smoke/stylize1"

    def sessionId(self) -> int:
        return id(self)

    def inputs(self) -> tuple[FakeNode | None, ...]:
        return () if self.above is None else (self.above,)

    def geometryAtFrame(self, frame: float) -> FakeGeometry:
        return FakeGeometry(self.files[int(frame)], self.kinds, self.save)

    def geometry(self) -> FakeGeometry:
        return self.shown

    def cook(self, force: bool = False) -> None:
        self.cooked += 1


class _Operation:
    def __init__(self, name: str, open_interrupt_dialog: bool = False) -> None:
        self.shares: list[float] = []

    def __enter__(self) -> _Operation:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def updateProgress(self, share: float) -> None:
        self.shares.append(share)


class FakeUi:
    """The user interface: what it has shown, and what it calls while it is idle."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.status: list[str] = []
        self.callbacks: list[Any] = []
        self.addEventLoopCallback, self.removeEventLoopCallback = self.callbacks.append, self.callbacks.remove
        self.setStatusMessage = self.status.append

    def displayMessage(self, text: str, **_: Any) -> None:
        self.messages.append(text)


@pytest.fixture
def hou(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Houdini with a user interface, of which the asset's code gets hold anew."""
    module: Any = ModuleType("hou")
    for error in ("NodeError", "NodeWarning", "OperationFailed", "OperationInterrupted", "ObjectWasDeleted"):
        setattr(module, error, type(error, (Exception,), {}))
    module.ui, module.available = FakeUi(), True
    module.isUIAvailable = lambda: module.available
    module.severityType, module.primType = SimpleNamespace(Error="error"), SimpleNamespace(VDB="VDB")
    module.InterruptableOperation, module.fps = _Operation, lambda: 25.0
    module.hipFile, module.getenv = SimpleNamespace(path=lambda: "/shots/a.hip"), lambda name: None
    module.SopNode = FakeNode
    monkeypatch.setitem(sys.modules, "hou", module)
    monkeypatch.delitem(sys.modules, "tnst_mi_houdini.node", raising=False)
    yield module
    sys.modules.pop("tnst_mi_houdini.node", None)
