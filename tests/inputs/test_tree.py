"""YAML 1.2 rules, positions, and files that must not hurt."""

from __future__ import annotations

import pytest

from missionsim.errors import InputError
from missionsim.inputs.tree import MAX_BYTES, parse_document, read_document


def faults_of(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        parse_document(text, name="f.yaml")
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"), ("off", "off"), ("yes", "yes"), ("No", "No"), ("1:30", "1:30"), ("1e3", 1000.0),
        ("1_000", "1_000"), ("012", 12), ("0o17", 15), ("0x1F", 31), ("2024-01-01", "2024-01-01"), ("true", True),
        ("~", None), ("", None), ("-1.5e-3", -0.0015), ("'1'", "1"), ("<<", "<<"), ("=", "="), (".5", 0.5),
    ],
)  # fmt: skip
def test_scalars_follow_yaml_1_2(text: str, value: object) -> None:
    data = parse_document(f"a: {text}\n").data["a"]
    assert data == value
    assert type(data) is type(value)


def test_keys_stay_text() -> None:
    assert list(parse_document("on: 1\nyes: 2\n1: 3\nnull: 4\n1.0: 5\n").data) == ["on", "yes", "1", "null", "1.0"]


def test_positions_of_values_and_keys() -> None:
    document = parse_document("a: 1\nb:\n  - c: x\n    d: [1,  22]\n")
    assert document.position(("b", 0, "d", 1)) == (4, 13)
    assert document.position(("b", 0, "d"), key=True) == (4, 5)
    assert document.position(("b", 0, "missing")) == (3, 5)


def test_duplicate_key_is_refused_with_both_lines() -> None:
    assert faults_of("a: 1\nb: {c: 1, c: 2}\na: 3\n") == [
        "f.yaml:2:11: error: key 'c' given twice; the first is in line 2",
        "f.yaml:3:1: error: key 'a' given twice; the first is in line 1",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: !!python/object/apply:os.system ['true']", "f.yaml:1:4: error: tags are not allowed"),
        ("a: !thing 3", "f.yaml:1:4: error: tags are not allowed"),
        ("a: 1\n---\nb: 2\n", "f.yaml:2:1: error: a second document in the file"),
        ("a: *x", "f.yaml:1:4: error: alias *x has no anchor before it"),
        ("a: &x [*x]", "f.yaml:1:8: error: alias *x stands inside its own anchor"),
        ("[1]: 2", "f.yaml:1:1: error: a key must be plain text"),
        ("", "f.yaml:1:1: error: the file is empty"),
        ("# only a comment\n", "f.yaml:1:1: error: the file is empty"),
        ("a: 'x", "f.yaml:1:4: error: not YAML: this quotation mark is never closed"),
        ('a: 1\nb: "x\nc: 2\n', "f.yaml:2:4: error: not YAML: this quotation mark is never closed"),
        ("a: {b: 3,5 m, c: 0,5 m/s}", "f.yaml:1:8: error: a decimal comma"),
        ("a: b: c", "f.yaml:1:5: error: not YAML: mapping values are not allowed in this context"),
        ("a:\n\tb: 1", "f.yaml:2:1: error: not YAML: found character that cannot start any token"),
        ("a: \x07", "f.yaml:1:4: error: control character in the text"),
    ],
)
def test_refused(text: str, message: str) -> None:
    assert faults_of(text)[0].splitlines()[0] == message


@pytest.mark.parametrize("text", ["[" * 100_000, "- " * 100_000 + "a", "{a: " * 100_000, "? " * 100_000])
def test_deep_nesting_is_refused_and_does_not_crash(text: str) -> None:
    assert any(
        "nested too deeply" in fault or "not YAML" in fault or "a key must be" in fault for fault in faults_of(text)
    )


def test_billion_laughs_are_refused() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    assert "too many values in the file" in faults_of("\n".join(lines))[0]


def test_decimal_commas_are_told_each_with_what_was_meant() -> None:
    told = faults_of("a: {b: 3,5 m, c: -0,5 m/s, d: 1, e: 2}\n")
    assert [fault.splitlines()[0] for fault in told] == [f"f.yaml:1:{at}: error: a decimal comma" for at in (8, 18)]
    assert "allowed: 3.5 m" in told[0]
    assert "allowed: -0.5 m/s" in told[1]


def test_anchors_are_allowed() -> None:
    document = parse_document("a: &s {laser: 2}\nb: *s\n")
    assert document.data == {"a": {"laser": 2}, "b": {"laser": 2}}
    assert document.position(("b", "laser")) == (1, 15)


def test_file_of_100_mb_is_refused_before_parsing(tmp_path) -> None:
    path = tmp_path / "large.yaml"
    with open(path, "wb") as handle:
        handle.truncate(100_000_000)
    with pytest.raises(InputError, match="file too large"):
        read_document(path)
    assert MAX_BYTES < 100_000_000


def test_not_utf8_is_located(tmp_path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"a: 1\nb: caf\xe9\n")
    with pytest.raises(InputError) as caught:
        read_document(path)
    assert str(caught.value).splitlines()[0] == f"{path}:2:7: error: not UTF-8 text"


def test_byte_order_mark_is_read_over(tmp_path) -> None:
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_document(path).data == {"a": 1}


@pytest.mark.parametrize("name", ["missing.yaml", "."])
def test_unreadable_file(tmp_path, name: str) -> None:
    with pytest.raises(InputError, match="cannot read this file"):
        read_document(tmp_path / name)
