"""YAML 1.2 text to plain data with the position of every value; refuses what could hurt or mislead.

PyYAML's C parser gives the events, yamlcore the YAML 1.2 core rules (`on` stays text, `1e3` is a number). The tree is
built here with an explicit stack, because a recursive composer crashes the interpreter on deep nesting.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
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

_ASKED = {
    "tab": "blanks before a key, no tabs",
    "any token": "blanks before a key, no tabs; a text that begins with such a character in quotation marks",
    "never closed": "the same mark at the end of the text",
    "mapping values": "keys of one block that begin in the same column; a text with ': ' in quotation marks",
    "expected key": "keys of one block that begin in the same column",
    "expected '-'": "entries of one list that begin in the same column",
    "expected ':'": "key: value",
}
"""What the parser says → what it asks for."""

Where = tuple[str | int, ...]
"""Path of a value: keys and list positions."""


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
    """The part of the text that it stands in, for edits in place; of YAML, for plain values only."""


class Numbered(list[Any]):
    """A list that has lost items and remembers the places of the others."""

    numbers: list[int]


@dataclass(slots=True)
class Document:
    """A read YAML file, perhaps with parts left out; its methods take paths in what is left."""

    file: str
    """Path as the user gave it."""
    data: Any
    """Plain dicts, lists, texts, numbers."""
    root: Node
    """The same with positions."""
    sha256: str = ""
    overrides: dict[Where, str] = field(default_factory=dict)
    """Paths that the command line set, with the text given there."""
    prefix: str = ""
    """What the command line puts before this file's paths (``robot.``)."""
    shape: Any = None
    """What is left of `data` where parts were left out."""
    faulty: dict[Where, bool] = field(default_factory=dict)
    """Paths of the file that were told to be faulty (True) and those above them (False)."""

    def original(self, path: Sequence[str | int]) -> Where:
        """The path in the file of a path in what is left."""
        if self.shape is None:
            return tuple(path)
        result, data = [], self.shape
        for item in path:
            numbered = isinstance(data, Numbered) and isinstance(item, int) and item < len(data)
            result.append(data.numbers[item] if numbered else item)
            try:
                data = data[item]
            except (KeyError, IndexError, TypeError):
                data = None
        return tuple(result)

    def is_faulty(self, path: Sequence[str | int], *, below: bool = False) -> bool:
        """Whether a fault was told at a path or above it; or `below` it."""
        if not self.faulty:
            return False
        path = self.original(path)
        return any(self.faulty.get(path[:n]) for n in range(len(path) + 1)) or (below and path in self.faulty)

    def overridden(self, path: Sequence[str | int]) -> str | None:
        """Text given on the command line for this path or one above it, or None."""
        path = self.original(path) if self.overrides else ()
        return next((self.overrides[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.overrides), None)

    def node(self, path: Sequence[str | int]) -> Node:
        """Deepest node along a path."""
        node = self.root
        for item in self.original(path):
            children = node.children
            if isinstance(children, dict) and str(item) in children:
                node = children[str(item)]
            elif isinstance(children, list) and isinstance(item, int) and 0 <= item < len(children):
                node = children[item]
            else:
                break
        return node

    def names(self, *path: str | int) -> list[str]:
        """Keys of a mapping as the file has them, also those whose values are at fault."""
        data = self.data
        for item in path:
            data = data.get(item) if isinstance(data, dict) else None
        return [str(key) for key in data] if isinstance(data, dict) else []

    def position(self, path: Sequence[str | int], *, key: bool = False) -> tuple[int, int]:
        """1-based line and column of the value at `path` (of its key with `key`), or of the deepest one above it."""
        if self.overridden(path) is not None:
            return 0, 0
        node = self.node(path)
        if key and path:
            parent, last = self.node(path[:-1]), path[-1]
            if isinstance(parent.children, dict) and parent.children.get(str(last)) is node and last in parent.keys:
                return parent.keys[str(last)]
        return node.line, node.column

    def place(self, path: Sequence[str | int], *, key: bool = False) -> Place:
        """File, line, column and dotted path of a value (of its key); no file where the command line set it."""
        given = self.overridden(path) is not None
        where = (self.prefix if given else "") + dotted(self.original(path))
        return Place("" if given else self.file, *self.position(path, key=key), where)

    def fault(
        self,
        path: Sequence[str | int],
        message: str,
        got: str = "",
        allowed: str = "",
        hint: str = "",
        *,
        key: bool = False,
        warning: bool = False,
    ) -> Fault:
        """A fault at `path`, in the file or, where the command line set the value, there."""
        fault = self.place(path, key=key).fault(message, got=got, allowed=allowed, hint=hint)
        return replace(fault, severity="warning") if warning else fault


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


def read_document(path: str | Path) -> Document:
    """Read one YAML file. Raises InputError: missing, too large, not UTF-8, not YAML, duplicate keys, tags, too deep or
    too many values."""
    shown = str(path)
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
    faults: list[Fault] = []
    root = None
    loader: Any = CCoreLoader(io.StringIO(text))
    try:
        root = _tree(loader, name, faults)
    except yaml.YAMLError as problem:
        marked: Any = problem if isinstance(problem, yaml.MarkedYAMLError) else None
        mark = marked and (marked.problem_mark or marked.context_mark)
        told = ((marked.problem or marked.context) if marked else "") or str(problem).splitlines()[0]
        if marked and "quoted scalar" in (marked.context or "") and "end of stream" in told:
            mark, told = marked.context_mark, "this quotation mark is never closed"
        line, column = (mark.line + 1, mark.column + 1) if mark else (0, 0)
        allowed = next((words for sign, words in _ASKED.items() if sign in told), "")
        faults.append(Fault(name, line, column, f"not YAML: {told.strip()}", allowed=allowed))
    finally:
        loader.dispose()
    if faults or root is None:
        empty = Fault(name, 1, 1, "the file is empty", allowed="a mapping that starts with 'kind:'")
        raise InputError(faults or empty)
    return Document(name, root.data, root)


def _tree(loader: Any, name: str, faults: list[Fault]) -> Node | None:
    """Nodes of a parser's events, made with an explicit stack; `faults` is added to."""
    root: Node | None = None
    anchors: dict[str, Node] = {}
    stack: list[Node] = []
    pending: list[str | None] = []  # the key that waits for its value, per open mapping
    documents = total = 0

    def tell(message: str, got: str = "", allowed: str = "", stop: bool = True) -> None:
        mark = event.start_mark
        faults.append(Fault(name, mark.line + 1, mark.column + 1, message, got=got, allowed=allowed))
        if stop:
            raise InputError(faults)

    while loader.check_event():
        event = loader.get_event()
        kind = type(event)
        if kind is yaml.DocumentStartEvent:
            documents += 1
            if documents > 1:
                tell("a second document in the file", allowed="one document (no second '---')")
        if kind in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
            node = stack.pop()
            pending.pop()
            if stack:
                stack[-1].size += node.size
        if kind not in (yaml.AliasEvent, yaml.ScalarEvent, yaml.MappingStartEvent, yaml.SequenceStartEvent):
            continue
        parent = stack[-1] if stack else None
        line, column = event.start_mark.line + 1, event.start_mark.column + 1
        if kind is yaml.AliasEvent:
            if event.anchor not in anchors:
                tell(f"alias *{event.anchor} has no anchor before it")
            node = anchors[event.anchor]
            if any(node is item for item in stack):
                tell(f"alias *{event.anchor} stands inside its own anchor")
        else:
            if event.tag not in (None, "!", *_CORE_TAGS):
                allowed = "plain values without a '!' tag"
                tell("tags are not allowed", got=event.tag, allowed=allowed, stop=False)
            if kind is yaml.ScalarEvent:
                data = text = event.value
                if parent is None or not isinstance(parent.children, dict) or pending[-1] is not None:  # no key
                    tag = event.tag or loader.resolve(yaml.ScalarNode, text, event.implicit)
                    try:
                        data = _convert(tag, text)
                    except ValueError:
                        tell("not a value of its tag", as_written(text), tag.rsplit(":", 1)[-1], stop=False)
                node = Node(data, line, column, text, start=event.start_mark.index, end=event.end_mark.index)
            elif kind is yaml.MappingStartEvent:
                node = Node({}, line, column, children={})
            else:
                node = Node([], line, column, children=[])
            if event.anchor is not None:
                anchors[event.anchor] = node
        total += node.size
        if total > MAX_NODES:
            message = "too many values in the file (aliases counted as often as they are used)"
            tell(message, allowed=f"at most {MAX_NODES}")
        is_key = False
        if parent is None:
            root = node
        elif isinstance(parent.children, list):
            parent.children.append(node)
            parent.data.append(node.data)
        elif (key := pending[-1]) is not None and parent.children is not None:
            pending[-1] = None
            parent.children[key] = node
            parent.data[key] = node.data
        else:
            is_key = True
            if node.children is not None:
                tell("a key must be plain text", got=as_written(node.data))
            pending[-1] = node.text
            before = next(reversed(parent.children.values()), None) if isinstance(parent.children, dict) else None
            cut = before is not None and type(before.data) is int and node.text[:1].isdigit()
            if before and cut and (node.line, node.start) == (before.line, before.end + 1):
                got, allowed = f"{before.text},{node.text}", f"{before.text}.{node.text}"
                faults.append(Fault(name, before.line, before.column, "a decimal comma", got=got, allowed=allowed))
            elif node.text in parent.keys:
                first = parent.keys[node.text][0]
                tell(f"key '{node.text}' given twice; the first is in line {first}", stop=False)
            else:
                parent.keys[node.text] = (node.line, node.column)
        if kind in (yaml.MappingStartEvent, yaml.SequenceStartEvent):
            stack.append(node)
            pending.append(None)
            if len(stack) > MAX_DEPTH:
                tell("nested too deeply", allowed=f"at most {MAX_DEPTH} levels")
        elif parent is not None and not is_key:
            parent.size += node.size
    return root


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
