"""A file of another tool as values that know their line: JSON, YAML and XML read alike, all faults told at once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from json.decoder import scanstring  # type: ignore[attr-defined]
from pathlib import Path
from typing import Any
from xml.parsers import expat

from missionsim.errors import Fault, InputError
from missionsim.inputs.tree import Document, Node, as_written, dotted, parse_document

MAX_BYTES = 32_000_000
MAX_DEPTH = 64
_MOST_FAULTS = 20
_SPACE = re.compile(r"[ \t\n\r]*")
_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = {"true": True, "false": False, "null": None}
_ENCODING = re.compile(rb"""^<\?xml[^>]*encoding=["']([A-Za-z0-9._-]+)["']""")


@dataclass(slots=True, eq=False)
class JsonNode(Node):
    """A JSON value with the part of the text that it stands in, for edits in place."""

    start: int = 0
    end: int = 0


@dataclass(slots=True)
class Element:
    """An XML element without namespaces."""

    tag: str
    attributes: dict[str, str]
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Children of a tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> str:
        """Text of the first child of a tag; empty where there is none."""
        return next((child.text.strip() for child in self.all(tag)), "")


def read_text(path: str | Path) -> str:
    """Text of a file: UTF-8, UTF-16 with its mark, or what an XML declaration names.

    Raises
    ------
    InputError
        Cannot be read, too large, not text; with the line of the first bad byte.
    """
    shown = str(path)
    try:
        if not Path(path).is_file():
            reason = (
                "is a folder" if Path(path).is_dir() else "no such file" if not Path(path).exists() else "is no file"
            )
            raise InputError(Fault(shown, 0, 0, f"cannot read this file: {reason}"))
        with open(path, "rb") as handle:
            raw = handle.read(MAX_BYTES + 1)
    except OSError as problem:
        raise InputError(Fault(shown, 0, 0, f"cannot read this file: {problem.strerror or problem}")) from None
    if len(raw) > MAX_BYTES:
        raise InputError(Fault(shown, 0, 0, "file too large", allowed=f"at most {MAX_BYTES // 10**6} MB"))
    encoding = _encoding(raw)
    try:
        text = raw.decode(encoding)
    except LookupError:
        raise InputError(Fault(shown, 1, 1, "an encoding that is not known", got=encoding, allowed="UTF-8")) from None
    except UnicodeError as problem:
        at = getattr(problem, "start", 0)
        line = raw.count(b"\n", 0, at) + 1
        raise InputError(
            Fault(shown, line, 0, f"not text in {encoding.upper()}", got=f"byte 0x{raw[at]:02x}", allowed="UTF-8")
        ) from None
    if not text.strip():
        raise InputError(Fault(shown, 1, 1, "the file is empty"))
    return text


def encoding_of(path: str | Path) -> str:
    """Encoding in which `read_text` read a file, for writing it again: a mark at its start stays in the text."""
    with open(path, "rb") as handle:
        return _encoding(handle.read(200))


def _encoding(raw: bytes) -> str:
    declared = _ENCODING.match(raw[:200])
    for mark, name in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if raw.startswith(mark):
            return name
    return declared.group(1).decode() if declared else "utf-8"


def parse_json(text: str, name: str) -> Document:
    """JSON text as a document whose nodes are `JsonNode`.

    Raises
    ------
    InputError
        The first place where the text is not JSON, values nested deeper than 64, or a key that stands twice.
    """
    return Document(name, (root := _Json(text, name).whole()).data, root)


class _Json:
    def __init__(self, text: str, name: str) -> None:
        self.text, self.name = text, name
        self.starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def place(self, at: int) -> tuple[int, int]:
        from bisect import bisect_right

        line = bisect_right(self.starts, at)
        return line, at - self.starts[line - 1] + 1

    def wrong(self, at: int, message: str, allowed: str = "") -> InputError:
        line, column = self.place(min(at, len(self.text)))
        got = "the end of the file" if at >= len(self.text) else as_written(self.text[at : at + 12])
        return InputError(Fault(self.name, line, column, f"not JSON: {message}", got=got, allowed=allowed))

    def skip(self, at: int) -> int:
        match = _SPACE.match(self.text, at)
        return match.end() if match else at

    def whole(self) -> JsonNode:
        node = self.value(self.skip(0), 0)
        if (at := self.skip(node.end)) < len(self.text):
            raise self.wrong(at, "more text after the end")
        return node

    def value(self, at: int, depth: int) -> JsonNode:
        text = self.text
        letter = text[at : at + 1]
        line, column = self.place(at)
        if letter in ("{", "[") and letter:
            if depth >= MAX_DEPTH:
                raise self.wrong(at, "nested too deeply", f"at most {MAX_DEPTH} levels")
            return self.container(at, depth, line, column)
        if letter == '"':
            data, end = self.string(at)
            return JsonNode(data, line, column, data, start=at, end=end)
        if match := _NUMBER.match(text, at):
            word = match.group()
            is_float = any(mark in word for mark in ".eE")
            number = float(word) if is_float or len(word) > 300 else int(word)
            return JsonNode(number, line, column, word, start=at, end=match.end())
        for word, constant in _WORDS.items():
            if text.startswith(word, at):
                return JsonNode(constant, line, column, word, start=at, end=at + len(word))
        raise self.wrong(at, "a value is expected here", 'an object, a list, "text", a number, true, false or null')

    def string(self, at: int) -> tuple[str, int]:
        try:
            data, end = scanstring(self.text, at + 1, True)
        except ValueError as problem:
            raise self.wrong(getattr(problem, "pos", at), getattr(problem, "msg", "bad text").lower()) from None
        return data.encode("utf-8", "replace").decode("utf-8"), end

    def container(self, at: int, depth: int, line: int, column: int) -> JsonNode:
        is_object = self.text[at] == "{"
        closing = "}" if is_object else "]"
        node = JsonNode({}, line, column, children={}) if is_object else JsonNode([], line, column, children=[])
        node.start, here = at, self.skip(at + 1)
        while not self.text.startswith(closing, here):
            key = ""
            if is_object:
                if not self.text.startswith('"', here):
                    raise self.wrong(here, "a key in quotes is expected here")
                key_at = here
                key, here = self.string(here)
                if key in node.keys:
                    raise self.wrong(key_at, f"key '{key}' stands twice")
                node.keys[key] = self.place(key_at)
                here = self.skip(here)
                if not self.text.startswith(":", here):
                    raise self.wrong(here, "':' is expected here")
                here = self.skip(here + 1)
            child = self.value(here, depth + 1)
            node.size += child.size
            if isinstance(node.children, dict):
                node.children[key], node.data[key] = child, child.data
            elif isinstance(node.children, list):
                node.children.append(child)
                node.data.append(child.data)
            here = self.skip(child.end)
            if self.text.startswith(",", here):
                here = self.skip(here + 1)
                if self.text.startswith(closing, here):
                    raise self.wrong(here, "a value is expected after the comma")
            elif not self.text.startswith(closing, here):
                raise self.wrong(here, f"',' or '{closing}' is expected here")
        node.end = here + 1
        return node


def parse_xml(text: str, name: str) -> Element:
    """XML text as elements with lines; document type declarations are refused, since entities can blow up.

    Raises
    ------
    InputError
    """
    parser = expat.ParserCreate("utf-8", namespace_separator=" ")
    parser.buffer_text = True
    root = Element("", {}, 0)
    stack = [root]

    def local(tag: str) -> str:
        return tag.rsplit(" ", 1)[-1]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > MAX_DEPTH:
            line = parser.CurrentLineNumber
            raise InputError(Fault(name, line, 0, "nested too deeply", allowed=f"at most {MAX_DEPTH} levels"))
        given = {local(key): value for key, value in attributes.items()}
        element = Element(local(tag), given, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def data(piece: str) -> None:
        stack[-1].text += piece

    def doctype(*_: Any) -> None:
        raise InputError(Fault(name, parser.CurrentLineNumber, 0, "document type declarations are not read"))

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: stack.pop()
    parser.CharacterDataHandler = data
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    except expat.ExpatError as problem:
        reason = expat.ErrorString(problem.code) or "bad text"
        raise InputError(Fault(name, problem.lineno, problem.offset + 1, f"not XML: {reason}")) from None
    return root.children[0]


def read_document(path: str | Path, text: str) -> Document:
    """JSON where the text begins like it, else YAML 1.2."""
    if text.lstrip("\ufeff \t\r\n")[:1] in ("{", "["):
        return parse_json(text.removeprefix("\ufeff"), str(path))
    return parse_document(text.removeprefix("\ufeff"), name=str(path))


@dataclass(slots=True)
class Faults:
    """Faults of one file, collected until `stop`."""

    found: list[Fault] = field(default_factory=list)

    def stop(self) -> None:
        """Raise what was found, if anything was."""
        if self.found:
            raise InputError(self.found[:_MOST_FAULTS])


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a document; what is asked of it and is not there becomes a fault with its line."""

    document: Document
    faults: Faults
    node: Node
    path: tuple[str | int, ...] = ()

    @property
    def data(self) -> Any:
        """As plain data."""
        return self.node.data

    @property
    def line(self) -> int:
        """1-based."""
        return self.node.line

    def fault(self, message: str, allowed: str = "", hint: str = "") -> None:
        """Note a fault of this value."""
        got = as_written(self.data)
        place = (self.document.file, self.node.line, self.node.column)
        self.faults.found.append(Fault(*place, message, dotted(self.path), got, allowed, hint))

    def has(self, key: str) -> bool:
        """Whether a mapping has a key whose value is not null."""
        return isinstance(self.data, dict) and self.data.get(key) is not None

    def get(self, *keys: str) -> Value | None:
        """Value at the first key that is there and not null."""
        if isinstance(self.node.children, dict):
            for key in keys:
                if self.data.get(key) is not None:
                    return Value(self.document, self.faults, self.node.children[key], (*self.path, key))
        return None

    def need(self, *keys: str) -> Value | None:
        """The same, and a fault where there is none."""
        found = self.get(*keys)
        if found is None:
            self.fault(f"'{keys[0]}' is missing", allowed=f"{keys[0]}: …")
        return found

    def entries(self, *keys: str) -> list[Value]:
        """Entries of the list at a key (of this value itself without keys); none where it is not there."""
        found = self.get(*keys) if keys else self
        if found is None:
            return []
        if not isinstance(found.node.children, list):
            if found.data != {}:  # an empty block of YAML is written {} for a list too
                found.fault("must be a list", allowed="a list")
            return []
        children = enumerate(found.node.children)
        return [Value(self.document, self.faults, child, (*found.path, index)) for index, child in children]

    def items(self, *keys: str) -> list[tuple[str, Value]]:
        """Keys and values of the mapping at a key; none where it is not there."""
        found = self.get(*keys) if keys else self
        if found is None:
            return []
        if not isinstance(found.node.children, dict):
            if found.data != []:
                found.fault("must be a mapping", allowed="a mapping")
            return []
        children = found.node.children.items()
        return [(key, Value(self.document, self.faults, child, (*found.path, key))) for key, child in children]

    def number(self, low: float = -1e12, high: float = 1e12) -> float | None:
        """A number between limits; None and a fault where it is none."""
        raw = self.data
        if type(raw) not in (int, float):
            self.fault("must be a number", allowed="a number")
        elif not math.isfinite(raw) or not low <= raw <= high:
            self.fault("impossible value", allowed=f"{low:g} to {high:g}")
        else:
            return float(raw)
        return None

    def optional(self, key: str, low: float = -1e12, high: float = 1e12) -> float | None:
        """Number at a key; None where it is not there."""
        found = self.get(key)
        return None if found is None else found.number(low, high)

    def word(self, key: str) -> str:
        """Text (or whole number as text) at a key; empty where there is none."""
        found = self.get(key)
        if found is None:
            return ""
        if type(found.data) not in (str, int):
            found.fault("must be text", allowed="text")
            return ""
        return str(found.data)
