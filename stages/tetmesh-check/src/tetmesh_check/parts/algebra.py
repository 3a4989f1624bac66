"""The algebra of sets: parses expressions such as ``endo = lv_blood/lv_wall - caps``.

``+`` joins, ``-`` removes and ``&`` intersects; ``&`` binds tighter than the other two. An operand
is a name, an interface ``a/b``, ``*`` (everything) or an expression in parentheses. Names with
blanks or signs are quoted.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tetmesh_check.errors import StageError, file_error

EVERYTHING = "*"
Operand = tuple[str, ...]
"""One name, the two names of an interface, or :data:`EVERYTHING`."""
Members = frozenset[int]
"""Numbers of parts."""

_TOKEN = re.compile(r"""\s*(?:(?P<name>[A-Za-z0-9_.]+|"[^"]+"|'[^']+')|(?P<sign>[-+&()/*]))""")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,79}")
"""A name that every format accepts; 80 characters are the maximum of CalculiX and MED."""
_HOW = "write NAME = EXPRESSION with names, interfaces a/b, and + - & ( ), such as 'epi = wall/outside - caps'"


@dataclass(frozen=True)
class Node:
    """A parsed expression: an operand, or an operator with two expressions."""

    operator: str = ""
    children: tuple[Node, ...] = ()
    names: Operand = ()

    def evaluate(self, find: Callable[[Operand], Members]) -> Members:
        """Return the members of the expression.

        Parameters
        ----------
        find
            Returns the members of an operand.
        """
        if not self.operator:
            return find(self.names)
        first, second = (node.evaluate(find) for node in self.children)
        return {"+": first | second, "-": first - second, "&": first & second}[self.operator]

    def leaves(self) -> list[Operand]:
        """Return all operands, from the left."""
        return [self.names] if not self.operator else [own for node in self.children for own in node.leaves()]


@dataclass(frozen=True)
class Definition:
    """A named expression."""

    name: str
    text: str
    """The expression as given."""
    node: Node


def check_name(name: str) -> str:
    """Return a name for a set or tag; refuse one that a format does not accept."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"'{name}' is not a name: use up to 80 letters, digits and underscores, a letter first")
    return name


class _Reader:
    """Reads the tokens of one expression."""

    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, bool]] = []
        at = 0
        while text[at:].strip():
            found = _TOKEN.match(text, at)
            if found is None:
                raise ValueError(f"'{text.strip()}': '{text[at:].strip()[0]}' is not part of an expression")
            name = found["name"]
            self.tokens.append((name.strip("\"'") if name else found["sign"], bool(name)))
            at = found.end()
        self.at, self.text = 0, text.strip()

    def take(self, *signs: str) -> str | None:
        """Return the next token and move on if it is one of these signs."""
        if self.at < len(self.tokens) and self.tokens[self.at] in [(sign, False) for sign in signs]:
            self.at += 1
            return self.tokens[self.at - 1][0]
        return None

    def name(self) -> str:
        """Return the next token, which must be a name, and move on."""
        if self.at == len(self.tokens):
            raise ValueError(f"'{self.text}' ends where a name is expected")
        word, is_name = self.tokens[self.at]
        if not is_name:
            raise ValueError(f"'{self.text}': '{word}' stands where a name is expected")
        self.at += 1
        return word

    def operand(self) -> Node:
        if self.take("("):
            inner = self.expression()
            if not self.take(")"):
                raise ValueError(f"'{self.text}': a parenthesis is not closed")
            return inner
        if self.take(EVERYTHING):
            return Node(names=(EVERYTHING,))
        name = self.name()
        return Node(names=(name, self.name()) if self.take("/") else (name,))

    def chain(self, operand: Callable[[], Node], *signs: str) -> Node:
        node = operand()
        while sign := self.take(*signs):
            node = Node(sign, (node, operand()))
        return node

    def expression(self) -> Node:
        return self.chain(lambda: self.chain(self.operand, "&"), "+", "-")


def read_expression(text: str) -> Node:
    """Parse an expression; raise ``ValueError`` if it is malformed."""
    reader = _Reader(text)
    node = reader.expression()
    if reader.at < len(reader.tokens):
        raise ValueError(f"'{reader.text}': '{reader.tokens[reader.at][0]}' stands where + - or & is expected")
    return node


def read_definition(line: str) -> Definition:
    """Parse ``NAME = EXPRESSION``; raise ``ValueError`` if it is malformed."""
    name, equals, text = line.partition("=")
    if not equals:
        raise ValueError(f"'{line}' is not NAME = EXPRESSION")
    return Definition(check_name(name.strip()), text.strip(), read_expression(text))


def read_definitions(path: Path) -> list[Definition]:
    """Read a file with one definition per line; ``#`` starts a comment.

    Raises
    ------
    StageError
        If the file cannot be read or a line is malformed.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise file_error(path, "read", error, "check --sets") from error
    found = []
    for number, line in enumerate(lines, 1):
        if not (content := line.partition("#")[0].strip()):
            continue
        try:
            found.append(read_definition(content))
        except ValueError as error:
            raise StageError(f"{path}, line {number}: {error}", "this set cannot be formed", _HOW) from error
    return found
