"""A file of another tool as values that know their line: JSON, YAML and XML read alike, all faults told at once."""

from __future__ import annotations

import json
import json.scanner
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from missionsim.errors import Fault, InputError
from missionsim.files import Json
from missionsim.inputs.tree import Document, Node, as_written, decoded, dotted, parse_document, read_bytes

MAX_BYTES = 32_000_000
MAX_DEPTH = 64
_MOST_FAULTS = 20
_ENCODING = re.compile(rb"""^<\?xml[^>]*encoding=["']([A-Za-z0-9._-]+)["']""")


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

    Raises InputError: cannot be read, too large, not text; with the line of the first bad byte.
    """
    raw = read_bytes(path, str(path), MAX_BYTES)
    text = decoded(raw, _encoding(raw), str(path))
    if not text.strip():
        raise InputError(Fault(str(path), 1, 1, "the file is empty"))
    return text


def rewritten(path: str | Path, text: str, edits: Iterable[tuple[int, int, str]]) -> bytes:
    """A file, whose text `read_text` gave, with other words from one place to another (a mark at its start not
    counted), in the encoding that it has."""
    mark = text[: text.startswith("\ufeff")]
    text = text.removeprefix(mark)
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    with open(path, "rb") as handle:
        return (mark + text).encode(_encoding(handle.read(200)))


def _encoding(raw: bytes) -> str:
    declared = _ENCODING.match(raw[:200])
    for mark, name in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if raw.startswith(mark):
            return name
    return declared.group(1).decode() if declared else "utf-8"


def parse_json(text: str, name: str) -> Document:
    """JSON text as a document whose nodes know their `start` and `end` in it. Raises InputError: the first place where
    the text is not JSON, values nested deeper than 64, or a key that stands twice."""
    starts = [0, *(match.end() for match in re.finditer("\n", text))]
    depth = 0

    def wrong(at: int, message: str) -> InputError:
        line = bisect_right(starts, at)
        got = as_written(text[at : at + 12]) if at < len(text) else "the end of the file"
        return InputError(Fault(name, line, at - starts[line - 1] + 1, f"not JSON: {message}", got=got))

    def node_at(_: str, at: int) -> tuple[Node, int]:
        nonlocal depth
        if (depth := depth + 1) > MAX_DEPTH:
            raise wrong(at, f"nested too deeply, more than {MAX_DEPTH} levels")
        if text.startswith(("NaN", "Infinity", "-Infinity"), at):
            raise StopIteration(at)
        data, end = scan(text, at)
        depth -= 1
        line = bisect_right(starts, at)
        node = Node(data, line, at - starts[line - 1] + 1, text[at:end], start=at, end=end)
        if isinstance(data, dict):
            node.text, node.children, node.data = "", data, {key: child.data for key, child in data.items()}
        elif isinstance(data, list):
            node.text, node.children, node.data = "", data, [child.data for child in data]
        elif isinstance(data, str):
            node.data = node.text = writable(data)
        return node, end

    def writable(word: str) -> str:  # without lone halves of surrogate pairs
        return word.encode("utf-8", "replace").decode()

    def one_each(pairs: list[tuple[str, Node]]) -> dict[str, Node]:
        found: dict[str, Node] = {}
        for key, node in ((writable(key), node) for key, node in pairs):
            if key in found:
                raise wrong(node.start, f"key '{key}' stands twice")
            found[key] = node
        return found

    def whole(word: str) -> float:
        return int(word) if len(word) <= 300 else float(word)

    decoder: Any = json.decoder
    scanner: Any = json.scanner
    rules: Any = json.JSONDecoder(object_pairs_hook=one_each, parse_int=whole)
    rules.parse_object = lambda at, strict, _, *hooks: decoder.JSONObject(at, strict, node_at, *hooks)
    rules.parse_array = lambda at, _: decoder.JSONArray(at, node_at)
    scan: Callable[[str, int], tuple[Any, int]] = scanner.py_make_scanner(rules)
    begin = len(text) - len(text.lstrip(" \t\n\r"))
    try:
        root, end = node_at(text, begin)
    except json.JSONDecodeError as problem:
        raise wrong(problem.pos, problem.msg[:1].lower() + problem.msg[1:]) from None
    except StopIteration:
        raise wrong(begin, "expecting value") from None
    if rest := text[end:].strip(" \t\n\r"):
        raise wrong(text.index(rest[0], end), "more text after the end")
    return Document(name, root.data, root)


def parse_xml(text: str, name: str) -> Element:
    """XML text as elements with lines; document type declarations are refused, since entities can blow up."""
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


def finite(raw: object) -> float | None:
    """A finite number, also one in a text; None for all else."""
    try:
        number = float(raw) if isinstance(raw, (int, float, str)) and not isinstance(raw, bool) else math.nan
    except ValueError:
        return None
    return number if math.isfinite(number) else None


@dataclass(slots=True)
class Faults:
    """Faults of one file, collected until `stop`."""

    file: str
    found: list[Fault] = field(default_factory=list)

    def add(self, line: int, message: str, got: str = "", allowed: str = "") -> None:
        """Note one at a line."""
        self.found.append(Fault(self.file, line, 0, message, "", got, allowed))

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
    def data(self) -> object:
        """As plain data."""
        return self.node.data

    @property
    def fields(self) -> Json:
        """Plain data of a mapping; empty for all else."""
        return self.node.data if isinstance(self.node.data, dict) else {}

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
        return self.fields.get(key) is not None

    def get(self, *keys: str) -> Value | None:
        """Value at the first key that is there and not null."""
        if isinstance(self.node.children, dict):
            for key in keys:
                if self.has(key):
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
        return [value for _, value in self._inside(list, "a list", keys)]

    def items(self, *keys: str) -> list[tuple[str, Value]]:
        """Keys and values of the mapping at a key; none where it is not there."""
        return self._inside(dict, "a mapping", keys)

    def _inside(self, kind: type, called: str, keys: Sequence[str]) -> list[tuple[Any, Value]]:
        found = self.get(*keys) if keys else self
        inside = None if found is None else found.node.children
        if found is None or not isinstance(inside, kind):
            if found is not None and found.data not in ({}, []):  # an empty block of YAML is written {} for a list too
                found.fault(f"must be {called}", allowed=called)
            return []
        pairs = inside.items() if isinstance(inside, dict) else enumerate(inside or ())
        return [(key, Value(self.document, self.faults, child, (*found.path, key))) for key, child in pairs]

    def named(self, names: Mapping[str, str]) -> str | None:
        """What `names` holds for the id that stands here (nothing for a node that is at fault itself); None and a fault
        where it knows none."""
        if (found := names.get(str(self.data))) is None:
            self.fault("no node has this id", "the id of a node")
        return found

    def number(self, low: float = -1e12, high: float = 1e12) -> float | None:
        """A number between limits; None and a fault where it is none."""
        raw = self.data
        if isinstance(raw, bool) or not isinstance(raw, (int, float)):
            self.fault("must be a number", allowed="a number")
        elif not math.isfinite(raw) or not low <= raw <= high:
            self.fault("impossible value", allowed=f"{low:g} to {high:g}")
        else:
            return float(raw)
        return None

    def whole(self) -> int | None:
        """A whole number from 0; None and a fault where it is none."""
        if type(self.data) is int and self.data >= 0:
            return self.data
        self.fault("must be a whole number", "0, 1, 2 …")
        return None

    def truth(self) -> bool:
        """True or false; false and a fault where it is neither."""
        if not isinstance(self.data, bool):
            self.fault("must be true or false", "true, false")
        return self.data is True

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
