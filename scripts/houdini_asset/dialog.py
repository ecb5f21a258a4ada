"""The syntax of Houdini's DialogScript: parameters, menus and folders as text.

The format is not documented; it is as in the expanded assets that are published with their sources (SideFX Labs, AWS
Deadline Cloud for Houdini).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

_INDENT = "    "


def quoted(text: str) -> str:
    """A text in double quotes."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def parm(
    name: str,
    label: str,
    type: str,
    default: Sequence[str],
    *,
    help: str = "",
    bounds: str = "",
    menu: Mapping[str, str] | None = None,
    suggestions: Sequence[str] = (),
    hidden: str = "",
    join: bool = False,
    tags: Mapping[str, str] | None = None,
) -> str:
    """A parameter.

    Args:
        name: of the parameter.
        label: what the artist reads.
        type: such as "float", "integer", "toggle", "ordinal", "string", "file", "button".
        default: of each component.
        help: shown when the mouse rests on it.
        bounds: the range of its slider, such as "0! 1"; a bound with ! cannot be passed.
        menu: labels by token, one of which is the value.
        suggestions: values that a menu beside a text offers.
        hidden: the condition under which it is not shown, such as "gamma_choice != number".
        join: whether the next parameter is in the same line.
        tags: further properties.
    """
    lines = [f"name    {quoted(name)}", f"label   {quoted(label)}", f"type    {type}"]
    lines += ["joinnext"] if join else []
    lines += [f"size    {len(default)}"] if len(default) > 1 else []
    lines += [f"default {{ {' '.join(map(quoted, default))} }}"]
    lines += [f"hidewhen {quoted(f'{{ {hidden} }}')}"] if hidden else []
    lines += [f"range   {{ {bounds} }}"] if bounds else []
    if menu:
        lines += _menu("menu", menu)
    if suggestions:
        lines += _menu("menureplace", {text: text for text in suggestions})
    lines += [f"parmtag {{ {quoted(key)} {quoted(value)} }}" for key, value in (tags or {}).items()]
    lines += [f"help    {quoted(help)}"] if help else []
    return _block("parm", lines)


def several(name: str, label: str, each: str) -> str:
    """A list of parameters that the artist makes longer: `each` is one, with # in its name for the number."""
    lines = [f"name    {quoted(name)}", f"label    {quoted(label)}", "default 0", ""]
    return _block("multiparm", lines + each.splitlines())


def folder(name: str, label: str, parms: Sequence[str], kind: str = "group") -> str:
    """A folder: a tab ("group"), or one that opens within its tab ("groupcollapsible")."""
    lines = [f"name    {quoted(name)}", f"label   {quoted(label)}"]
    if kind == "groupcollapsible":
        lines += ['grouptag { "group_type" "collapsible" }']
    lines += ["", *(line for text in parms for line in text.splitlines())]
    return _block(kind, lines)


def script(operator: str, label: str, inputs: Sequence[str], parms: Sequence[str]) -> str:
    """The DialogScript of an operator."""
    lines = [f"name\t{operator}", f"script\t{operator}", f"label\t{quoted(label)}", "", "help {", '\t""', "}", ""]
    lines += [f"inputlabel\t{number}\t{quoted(text)}" for number, text in enumerate(inputs, start=1)]
    lines += ["", *(line for text in parms for line in text.splitlines())]
    return f"# Dialog script for {operator} automatically generated\n\n{_block('', lines)}"


def _menu(kind: str, entries: Mapping[str, str]) -> list[str]:
    pairs = [f"{_INDENT}{quoted(token)} {quoted(label)}" for token, label in entries.items()]
    return [f"{kind} {{", *pairs, "}"]


def _block(kind: str, lines: Sequence[str]) -> str:
    inside = "".join(f"{_INDENT}{line}\n" if line else "\n" for line in lines)
    return f"{kind} {{\n{inside}}}\n".lstrip()
