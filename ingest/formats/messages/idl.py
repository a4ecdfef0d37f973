"""Definitions in IDL (ros2idl, omgidl) as trees of types.

Read are modules, structs (also derived ones), typedefs, enumerations, constants, sequences, arrays and
strings, with the annotation `@unit`. Other annotations, comments and includes are passed over. Names are
looked for from the innermost module outwards. Unions, bit sets, maps and optional members are laid out in
ways of their own, and end in DefinitionError, as do types that contain themselves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from flysid.ingest.formats.messages.definitions import (
    MAX_ARRAY,
    MAX_DEPTH,
    MAX_LEAVES,
    Array,
    DefinitionError,
    MessageType,
    Number,
    Text,
    Type,
)

MAX_BYTES = 1 << 20
_NEXT = re.compile(r"^={3,}[ \t]*$|^IDL: .*$|^[ \t]*#.*$", re.MULTILINE)
_TOKEN = re.compile(
    r'//[^\n]*|/\*.*?\*/|(?P<text>L?"(?:[^"\\]|\\.)*")|(?P<name>(?:::)?[A-Za-z_]\w*(?:\s*::\s*[A-Za-z_]\w*)*)'
    r"|(?P<number>[-+]?[\d.][\w.]*)|(?P<mark>[^\s\w])",
    re.DOTALL,
)
_NUMBERS: Mapping[str, str] = {
    "boolean": "b1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "unsigned short": "u2",
    "uint16": "u2",
    "long": "i4",
    "int32": "i4",
    "unsigned long": "u4",
    "uint32": "u4",
    "long long": "i8",
    "int64": "i8",
    "unsigned long long": "u8",
    "uint64": "u8",
    "float": "f4",
    "double": "f8",
}
_WORDS = frozenset(word for name in _NUMBERS for word in name.split())
_ENUM = Number("u4")


@dataclass(frozen=True)
class _Named:
    """A type by its name, as seen from a module."""

    name: str
    scope: tuple[str, ...]


@dataclass(frozen=True)
class _Many:
    """A sequence, or an array of `size`."""

    element: _Kind
    size: int | None


_Kind = Number | Text | _Named | _Many


@dataclass
class _Struct:
    base: _Named | None
    scope: tuple[str, ...]
    members: list[tuple[str, _Kind, str]] = field(default_factory=list)


def parse_idl(name: str, text: str) -> MessageType:
    """The layout of message `name` from IDL that defines it and all that it needs.

    Parameters
    ----------
    name : "geometry_msgs/msg/Pose" or "geometry_msgs::msg::Pose".

    Raises
    ------
    DefinitionError : a type is missing, recursive or too large, or the text is not read.
    """
    if len(text) > MAX_BYTES:
        raise DefinitionError(f"an IDL definition of {len(text):,} bytes")
    parser = _Parser(_NEXT.sub("", text))
    parser.body(())
    wanted = tuple(part for part in re.split(r"::|/", name) if part)
    found = _Resolver(parser.known).resolve(_Named("::".join(wanted), ()), ())
    if not isinstance(found, MessageType):
        raise DefinitionError(f"{name} is no struct")
    return found


class _Parser:
    """Fills `known`: structs and types by their full names."""

    def __init__(self, text: str) -> None:
        self.known: dict[tuple[str, ...], _Struct | _Kind] = {}
        self._constants: dict[str, int] = {}
        self._tokens = [found for found in _TOKEN.finditer(text) if found.lastgroup is not None]
        self._at = 0
        self._unit = ""

    def body(self, scope: tuple[str, ...]) -> None:
        """The definitions up to the end of a module, or of the text."""
        if len(scope) > MAX_DEPTH:
            raise DefinitionError(f"modules are nested more than {MAX_DEPTH} deep")
        while self._peek() not in ("", "}"):
            self._definition(scope)

    def _definition(self, scope: tuple[str, ...]) -> None:
        word = self._word()
        if word == "module":
            inner = (*scope, self._word())
            self._expect("{")
            self.body(inner)
            self._expect("}")
        elif word == "struct":
            self._struct(scope)
        elif word == "typedef":
            kind = self._kind(scope)
            for name, whole in self._declared(kind):
                self.known[(*scope, name)] = whole
        elif word == "enum":
            self.known[(*scope, self._word())] = _ENUM
            self._pass_over("}")
        elif word == "const":
            self._constant(scope)
        elif word != ";":
            raise DefinitionError(f"{word!r} in IDL is not read")
        if self._peek() == ";":
            self._word()

    def _struct(self, scope: tuple[str, ...]) -> None:
        name = self._word()
        base = None
        if self._peek() == ":":
            self._word()
            base = _Named(self._word(), scope)
        if self._peek() == ";":
            return  # declared ahead of its definition
        struct = _Struct(base, scope)
        self._expect("{")
        while self._peek() != "}":
            kind = self._kind(scope)
            unit = self._unit
            struct.members += [(member, whole, unit) for member, whole in self._declared(kind)]
            self._unit = ""
            self._expect(";")
        self._expect("}")
        self.known[(*scope, name)] = struct

    def _constant(self, scope: tuple[str, ...]) -> None:
        self._kind(scope)
        name = self._word()
        self._expect("=")
        value = self._word()
        if value.isdigit():
            self._constants[name] = int(value)
        while self._peek() not in (";", ""):
            self._word()

    def _kind(self, scope: tuple[str, ...]) -> _Kind:
        word = self._word()
        if word in _WORDS:
            while self._peek() in _WORDS:
                word += " " + self._word()
            if word not in _NUMBERS:
                raise DefinitionError(f"{word} has no agreed layout")
            return Number(_NUMBERS[word])
        if word in ("string", "wstring"):
            self._bound()
            return Text(is_wide=word == "wstring")
        if word == "sequence":
            self._expect("<")
            element = self._kind(scope)
            if self._peek() == ",":
                self._word()
                self._word()
            self._expect(">")
            return _Many(element, None)
        if word in ("map", "union", "bitset", "bitmask", "fixed", "any", "wchar"):
            raise DefinitionError(f"{word} in IDL is not read")
        return _Named(word, scope)

    def _bound(self) -> None:
        if self._peek() == "<":
            self._word()
            self._word()
            self._expect(">")

    def _declared(self, kind: _Kind) -> list[tuple[str, _Kind]]:
        """The names of a declaration, each with the dimensions of its array."""
        found = []
        while True:
            name = self._word()
            sizes = []
            while self._peek() == "[":
                self._word()
                sizes.append(self._size(self._word()))
                self._expect("]")
            whole = kind
            for size in reversed(sizes):
                whole = _Many(whole, size)
            found.append((name, whole))
            if self._peek() != ",":
                return found
            self._word()

    def _size(self, word: str) -> int:
        size = int(word) if word.isdigit() else self._constants.get(word.rpartition("::")[2], 0)
        if not 0 < size <= MAX_ARRAY:
            raise DefinitionError(f"an array of {word} elements")
        return size

    def _peek(self) -> str:
        """The next word, annotations passed over; "" at the end."""
        while self._at < len(self._tokens) and self._tokens[self._at][0] == "@":
            self._annotation()
        return re.sub(r"\s", "", self._tokens[self._at][0]) if self._at < len(self._tokens) else ""

    def _word(self) -> str:
        word = self._peek()
        if not word:
            raise DefinitionError("the IDL definition ends in the middle")
        self._at += 1
        return word

    def _expect(self, mark: str) -> None:
        if (word := self._word()) != mark:
            raise DefinitionError(f"{word[:40]!r} in IDL where {mark!r} is expected")

    def _pass_over(self, last: str) -> None:
        while self._word() != last:
            pass

    def _annotation(self) -> None:
        """An annotation, with what stands in its parentheses."""
        at = self._at + 1
        name = self._tokens[at][0] if at < len(self._tokens) else ""
        at += 1
        texts = []
        if at < len(self._tokens) and self._tokens[at][0] == "(":
            depth = 0
            for at in range(at, len(self._tokens)):  # noqa: B020 - it goes on from there
                token = self._tokens[at]
                depth += (token[0] == "(") - (token[0] == ")")
                texts += [token["text"].strip('L"')] if token["text"] else []
                if not depth:
                    break
            at += 1
        self._at = at
        if name == "optional":
            raise DefinitionError("optional members in IDL are not read")
        if name == "unit" and texts:
            self._unit = texts[0]


class _Resolver:
    """Turns what was parsed into types, within bounds."""

    def __init__(self, known: Mapping[tuple[str, ...], _Struct | _Kind]) -> None:
        self._known = known
        self._leaves = 0

    def resolve(self, kind: _Kind, above: tuple[tuple[str, ...], ...]) -> Type:
        """The type that a name, a sequence or an array comes to; `above` are the types that contain it."""
        self._leaves += 1
        if self._leaves > MAX_LEAVES:
            raise DefinitionError(f"more than {MAX_LEAVES} fields")
        if isinstance(kind, Number | Text):
            return kind
        if isinstance(kind, _Many):
            return Array(self.resolve(kind.element, above), kind.size)
        name = self._full_name(kind)
        if name in above:
            raise DefinitionError(f"type {'/'.join(name)} contains itself")
        if len(above) >= MAX_DEPTH:
            raise DefinitionError(f"types are nested more than {MAX_DEPTH} deep")
        found = self._known[name]
        if not isinstance(found, _Struct):
            return self.resolve(found, (*above, name))
        return self._record(name, found, (*above, name))

    def _record(
        self, name: tuple[str, ...], struct: _Struct, above: tuple[tuple[str, ...], ...]
    ) -> MessageType:
        fields: list[tuple[str, Type]] = []
        units: dict[str, str] = {}
        if struct.base is not None:
            base = self.resolve(struct.base, above)
            if not isinstance(base, MessageType):
                raise DefinitionError(f"{'/'.join(name)} is derived from what is no struct")
            fields += base.fields
            units |= base.units
        for member, kind, unit in struct.members:
            fields.append((member, self.resolve(kind, above)))
            units[member] = unit
        if not fields:
            raise DefinitionError(f"struct {'/'.join(name)} has no member")
        return MessageType("/".join(name), tuple(fields), units)

    def _full_name(self, kind: _Named) -> tuple[str, ...]:
        parts = tuple(part for part in kind.name.split("::") if part)
        scopes = [kind.scope[:k] for k in range(len(kind.scope), -1, -1)]
        if kind.name.startswith("::"):
            scopes = [()]
        for scope in scopes:
            if (*scope, *parts) in self._known:
                return (*scope, *parts)
        raise DefinitionError(f"type {'/'.join(parts)} is not defined")
