"""The documentation of fields: the text below each in the source of its class, which nothing else of Python keeps."""

from __future__ import annotations

import ast
import inspect
import itertools


def paragraphs_below_fields(section: type) -> dict[str, str]:
    """The text below each field in the source of a class, one paragraph each."""
    nodes = ast.walk(ast.parse(inspect.getsource(section)))
    (statements,) = (node.body for node in nodes if isinstance(node, ast.ClassDef))
    paragraphs = {}
    for pair in itertools.pairwise(statements):
        match pair:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                paragraphs[name] = " ".join(text.split())
    return paragraphs
