"""YAML 1.2 text to plain data with the position of every value; refuses what could hurt or mislead.

PyYAML's C parser gives the events, yamlcore the YAML 1.2 core rules (`on` stays text, `1e3` is a number). The tree is
built here with an explicit stack, because a recursive composer crashes the interpreter on deep nesting.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

import yaml
from yamlcore import CCoreLoader

from missionsim.errors import Fault, InputError
from missionsim.expressions import Place

MAX_BYTES = 10_000_000
MAX_NODES = 200_000
"""Values after the aliases are expanded; a shipped robot has about 600."""
MAX_DEPTH = 64

_STR, _INT, _FLOAT, _BOOL, _NULL = (f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null"))
_CORE_TAGS = {_STR, _INT, _FLOAT, _BOOL, _NULL, "tag:yaml.org,2002:map", "tag:yaml.org,2002:seq"}
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")

Path_ = tuple[str | int, ...]


@dataclass(slots=True, eq=False)
class Node:
    """One value of a YAML file: its data, its 1-based position, its children and how many values lie inside it."""

    data: Any
    line: int
    column: int
    text: str = ""
    children: dict[str, Node] | list[Node] | None = None
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    size: int = 1
    _: KW_ONLY
    start: int = 0
    end: int = 0
    """Of JSON: the part of the text that it stands in, for edits in place."""


@dataclass(slots=True)
class Document:
    """A read YAML file."""

    file: str
    """Path as the user gave it."""
    data: Any
    """Plain dicts, lists, texts, numbers."""
    root: Node
    """The same with positions."""
    sha256: str = ""
    overrides: dict[Path_, str] = field(default_factory=dict)
    """Paths that the command line set, with the text given there."""
    prefix: str = ""
    """What the command line puts before this file's paths (``robot.``)."""

    def original(self, path: Sequence[str | int]) -> Path_:
        """The path in the file; a document with parts left out translates it."""
        return tuple(path)

    def overridden(self, path: Sequence[str | int]) -> str | None:
        """Text given on the command line for this path or one above it, or None."""
        path = self.original(path)
        for end in range(len(path), 0, -1):
            text = self.overrides.get(tuple(path[:end]))
            if text is not None:
                return text
        return None

    def node(self, path: Sequence[str | int]) -> Node:
        """Deepest node along a path."""
        path = self.original(path)
        node = self.root
        for item in path:
            child = _child(node, item)
            if child is None:
                break
            node = child
        return node

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, int]:
        """1-based line and column of the value at `path` (of its key with `key`), or of the deepest one above it."""
        if self.overridden(path) is not None:
            return 0, 0
        path = self.original(path)
        node = self.root
        where = (node.line, node.column)
        for item in path:
            child = _child(node, item)
            if child is None:
                break
            where = (child.line, child.column)
            if key and item == path[-1] and isinstance(item, str) and item in node.keys:
                where = node.keys[item]
            node = child
        return where

    def place(self, path: Sequence[str | int], *, key: bool = False) -> Place:
        """File, line, column and dotted path of a value (of its key); no file where the command line set it."""
        given = self.overridden(path) is not None
        line, column = self.position(path, key=key)
        where = (self.prefix if given else "") + dotted(self.original(path))
        return Place("" if given else self.file, line, column, where)

    def fault(
        self,
        path: Sequence[str | int],
        message: str,
        *,
        got: str = "",
        allowed: str = "",
        hint: str = "",
        key: bool = False,
        severity: str = "error",
    ) -> Fault:
        """A fault at `path`, in the file or, where the command line set the value, there."""
        file, line, column, where = self.place(path, key=key)
        return Fault(file, line, column, message, where, got, allowed, hint, severity)


def dotted(path: Sequence[str | int]) -> str:
    """``("segments", 0, "drive")`` as ``segments.0.drive``."""
    return ".".join(str(item) for item in path)


def as_written(value: object) -> str:
    """A value as short text for a message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"a mapping with {', '.join(list(map(str, value))[:4]) or 'no keys'}"[:80]
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    text = f"'{value}'" if isinstance(value, str) else repr(value)
    return text if len(text) <= 80 else text[:76] + "…" + text[-1]


def read_document(path: str | Path, *, name: str | None = None) -> Document:
    """Read one YAML file. `path`: the file. `name`: how messages call it; default the path. Raises InputError: missing,
    too large, not UTF-8, not YAML, duplicate keys, tags, too deep or too many values."""
    shown = name or str(path)
    raw = read_bytes(path, shown, MAX_BYTES)
    document = parse_document(decoded(raw, "utf-8-sig", shown), name=shown)
    document.sha256 = hashlib.sha256(raw).hexdigest()
    return document


def read_bytes(path: str | Path, name: str, most: int) -> bytes:
    """What a file holds; InputError where it cannot be read, or is larger than `most` bytes."""
    if Path(path).is_fifo():  # opening it would wait for a writer
        raise InputError.single("cannot read this file: is a pipe", file=name)
    try:
        with open(path, "rb") as handle:
            raw = handle.read(most + 1)
    except OSError as problem:
        reason = "is a folder" if isinstance(problem, IsADirectoryError) else str(problem.strerror or problem).lower()
        raise InputError.single(f"cannot read this file: {reason}", file=name) from None
    if len(raw) > most:
        size = f"{most // 10**6} MB"
        raise InputError.single("file too large", file=name, got=f"more than {size}", allowed=f"at most {size}")
    return raw


def decoded(raw: bytes, encoding: str, name: str) -> str:
    """Bytes as text; InputError at the first that is none."""
    try:
        return raw.decode(encoding)
    except LookupError:
        raise InputError(Fault(name, 1, 1, "an encoding that is not known", got=encoding, allowed="UTF-8")) from None
    except UnicodeError as problem:
        at = getattr(problem, "start", 0)
        line, column = raw.count(b"\n", 0, at) + 1, at - (raw.rfind(b"\n", 0, at) + 1) + 1
        message, got = f"not {encoding.removesuffix('-sig').upper()} text", f"byte 0x{raw[at]:02x}"
        raise InputError(Fault(name, line, column, message, got=got, allowed="UTF-8")) from None


def parse_document(text: str, *, name: str = "text") -> Document:
    """Read YAML text; see `read_document`."""
    control = _CONTROL.search(text)
    if control:
        line = text.count("\n", 0, control.start()) + 1
        column = control.start() - text.rfind("\n", 0, control.start())
        raise InputError(Fault(name, line, column, "control character in the text", got=repr(control.group())))
    builder = _Builder(name)
    loader: Any = CCoreLoader(io.StringIO(text))
    try:
        root = builder.build(loader)
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        message = (problem.problem or problem.context or "not YAML").strip()
        builder.faults.append(
            Fault(name, mark.line + 1 if mark else 0, mark.column + 1 if mark else 0, f"not YAML: {message}")
        )
        root = None
    except yaml.YAMLError as problem:
        builder.faults.append(Fault(name, 0, 0, f"not YAML: {str(problem).splitlines()[0]}"))
        root = None
    finally:
        loader.dispose()
    if builder.faults or root is None:
        raise InputError(
            builder.faults or [Fault(name, 1, 1, "the file is empty", allowed="a mapping that starts with 'kind:'")]
        )
    return Document(name, root.data, root)


def _child(node: Node, item: str | int) -> Node | None:
    if isinstance(node.children, dict):
        return node.children.get(str(item))
    if isinstance(node.children, list) and isinstance(item, int) and 0 <= item < len(node.children):
        return node.children[item]
    return None


class _Builder:
    """Turns parser events into nodes with an explicit stack."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.faults: list[Fault] = []
        self.anchors: dict[str, Node] = {}
        self.open_anchors: set[str] = set()

    def build(self, loader: Any) -> Node | None:
        root: Node | None = None
        stack: list[Node] = []
        pending: list[str | None] = []  # the key that waits for its value, per open mapping
        names: list[str | None] = []
        documents = 0
        total = 0
        while loader.check_event():
            event = loader.get_event()
            kind = type(event)
            if kind is yaml.DocumentStartEvent:
                documents += 1
                if documents > 1:
                    self._stop(event, "a second document in the file", allowed="one document (no second '---')")
                continue
            if kind in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
                node = stack.pop()
                pending.pop()
                anchor = names.pop()
                if anchor is not None:
                    self.open_anchors.discard(anchor)
                if stack:
                    stack[-1].size += node.size
                continue
            if kind is yaml.AliasEvent:
                node = self._alias(event)
            elif kind is yaml.ScalarEvent:
                is_key = bool(stack) and isinstance(stack[-1].children, dict) and pending[-1] is None
                node = self._scalar(loader, event, is_key)
            elif kind in (yaml.MappingStartEvent, yaml.SequenceStartEvent):
                self._check_tag(event)
                mapping = kind is yaml.MappingStartEvent
                mark = event.start_mark
                node = Node({} if mapping else [], mark.line + 1, mark.column + 1, children={} if mapping else [])
                if event.anchor is not None:
                    self.anchors[event.anchor] = node
                    self.open_anchors.add(event.anchor)
            else:
                continue
            total += node.size
            if total > MAX_NODES:
                self._stop(
                    event,
                    "too many values in the file (aliases counted as often as they are used)",
                    allowed=f"at most {MAX_NODES}",
                )
            if stack:
                self._attach(event, stack[-1], pending, node)
            else:
                root = node
            if kind in (yaml.MappingStartEvent, yaml.SequenceStartEvent):
                stack.append(node)
                pending.append(None)
                names.append(event.anchor)
                if len(stack) > MAX_DEPTH:
                    self._stop(event, "nested too deeply", allowed=f"at most {MAX_DEPTH} levels")
        return root

    def _attach(self, event: Any, parent: Node, pending: list[str | None], node: Node) -> None:
        if isinstance(parent.children, list):
            parent.children.append(node)
            parent.data.append(node.data)
        else:
            assert isinstance(parent.children, dict)
            key = pending[-1]
            if key is None:
                if node.children is not None:
                    self._stop(event, "a key must be plain text", got=as_written(node.data))
                pending[-1] = node.text
                if node.text in parent.keys:
                    first = parent.keys[node.text][0]
                    self._add(event, f"key '{node.text}' given twice; the first is in line {first}")
                else:
                    parent.keys[node.text] = (node.line, node.column)
                return
            pending[-1] = None
            parent.children[key] = node
            parent.data[key] = node.data
        if node.children is None or type(event) is yaml.AliasEvent:
            parent.size += node.size

    def _alias(self, event: Any) -> Node:
        node = self.anchors.get(event.anchor)
        if node is None:
            self._stop(event, f"alias *{event.anchor} has no anchor before it")
        if event.anchor in self.open_anchors:
            self._stop(event, f"alias *{event.anchor} stands inside its own anchor")
        assert node is not None
        return node

    def _scalar(self, loader: Any, event: Any, is_key: bool) -> Node:
        self._check_tag(event)
        text = event.value
        if is_key:
            data: Any = text
        else:
            tag = event.tag or loader.resolve(yaml.ScalarNode, text, event.implicit)
            try:
                data = _convert(tag, text)
            except ValueError:
                self._add(event, "not a value of its tag", got=as_written(text), allowed=tag.rsplit(":", 1)[-1])
                data = text
        node = Node(data, event.start_mark.line + 1, event.start_mark.column + 1, text)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node

    def _check_tag(self, event: Any) -> None:
        if event.tag is not None and event.tag not in _CORE_TAGS and event.tag != "!":
            self._add(event, "tags are not allowed", got=event.tag, allowed="plain values without a '!' tag")

    def _add(self, event: Any, message: str, *, got: str = "", allowed: str = "") -> None:
        mark = event.start_mark
        self.faults.append(Fault(self.name, mark.line + 1, mark.column + 1, message, got=got, allowed=allowed))

    def _stop(self, event: Any, message: str, *, got: str = "", allowed: str = "") -> None:
        self._add(event, message, got=got, allowed=allowed)
        raise InputError(self.faults)


def _convert(tag: str, text: str) -> Any:
    if tag == _INT:
        if len(text.lstrip("+-")) > 300:
            raise ValueError(text[:20])
        return int(text, 0 if text.lstrip("+-")[:2] in ("0x", "0o") else 10)
    if tag == _FLOAT:
        word = text.lower()
        if word.lstrip("+-") == ".inf":
            return float("-inf") if word.startswith("-") else float("inf")
        return float("nan") if word == ".nan" else float(text)
    if tag == _BOOL:
        if text.lower() not in ("true", "false"):
            raise ValueError(text)
        return text.lower() == "true"
    return None if tag == _NULL else text
