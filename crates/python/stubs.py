"""Writes the stubs of the package, from the signatures in its Rust sources.

    python crates/python/stubs.py

PyO3 takes the types of Python in `#[pyo3(signature = (x: "int" = 1) -> "str")]`. Those of properties follow from Rust's; an array is of the
type that its documentation names. What functions return as dictionaries is written by hand in `stubs/`, as the stubs' beginning.
`tests/test_stubs.py` holds the stubs to this script, and to what the built module has.
"""

import re
from pathlib import Path

HERE = Path(__file__).parent
WIDTH = 120
NOTE = '"""Types of the functions; their documentation is in the module. Written by crates/python/stubs.py."""\n\n'
MODULES = {
    "_srflow.pyi": ["avatar", "camera", "dataset", "face", "fields", "gaussians", "jobs", "methods", "rasterize", "lib"],
    "mer.pyi": ["mer", "model"],
}
# Python's own methods that take no signature.
SLOTS = {"__len__": "(self) -> int", "__getitem__": "(self, index: int, /) -> Pair"}
HIDDEN = {"__repr__", "__reduce__"}
TYPES = {
    "bool": "bool",
    "usize": "int",
    "f64": "float",
    "String": "str",
    "Option<String>": "str | None",
    "Option<&str>": "str | None",
    "Vec<u32>": "list[int]",
    "Vec<String>": "list[str]",
}


def items(source):
    """Functions of a file in their order: class or None, attributes, documentation, name, Rust's type of what it returns."""
    found, of, attributes, documentation = [], None, "", ""
    lines = iter(source.splitlines())
    for line in lines:
        text = line.strip()
        if text.startswith("///"):
            documentation += text[3:]
        elif text.startswith("#["):
            while text.count("[") > text.count("]"):
                text += " " + next(lines).strip()
            attributes += text
        elif match := re.match(r"(?:pub )?(?:impl|struct) (\w+)", text):
            of = match[1]
            if "#[pymethods]" in attributes or "#[pyclass" in attributes:
                found.append((of, "class", "", "", ""))
            attributes, documentation = "", ""
        elif match := re.match(r"(?:pub )?fn (\w+)", text):
            while "{" not in text:
                text += " " + next(lines).strip()
            returned = re.search(r"-> (.*?) \{", text)
            inside = of if line.startswith(" ") else None
            found.append((inside, attributes, documentation, match[1], returned[1] if returned else ""))
            attributes, documentation = "", ""
        elif match := re.match(r"(\w+): (.*),$", text):  # a field, maybe one that Python sees
            if "#[pyo3(get)]" in attributes:
                found.append((of, "#[getter]", documentation, match[1], match[2]))
            attributes, documentation = "", ""
        elif text:
            attributes, documentation = "", ""
    return found


def split(arguments):
    """At commas outside of brackets and quotes."""
    parts, depth, quoted = [""], 0, False
    for c in arguments:
        quoted ^= c == '"'
        depth += 0 if quoted else (c in "([{") - (c in ")]}")
        if c == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += c
    return [part.strip() for part in parts if part.strip()]


def signature(attributes, name):
    """Arguments and what is returned, in Python's words."""
    match = re.search(r'signature = \((.*)\) -> "([^"]*)"\)\]', attributes)
    if not match:
        raise SystemExit(f"{name}: expected a signature with types")
    values = {"true": "True", "false": "False"}
    arguments = []
    for argument in split(match[1]):
        parts = re.fullmatch(r'(\**\w+): "([^"]*)"(?: = (.*))?', argument)
        if parts is None and argument not in ("*", "/"):
            raise SystemExit(f"{name}: expected a type for `{argument}`")
        if parts is None:
            arguments.append(argument)
        else:
            default = "" if parts[3] is None else f" = {values.get(parts[3], parts[3])}"
            arguments.append(f"{parts[1]}: {parts[2]}{default}")
    return arguments, match[2]


def function(name, arguments, returned, indent):
    line = f"{indent}def {name}({', '.join(arguments)}) -> {returned}: ..."
    if len(line) <= WIDTH:
        return line
    inner = f"{indent}    {', '.join(arguments)}"
    if len(inner) <= WIDTH:
        return f"{indent}def {name}(\n{inner}\n{indent}) -> {returned}: ..."
    rows = "".join(f"{indent}    {argument},\n" for argument in arguments)
    return f"{indent}def {name}(\n{rows}{indent}) -> {returned}: ..."


def property_type(name, documentation, returned):
    if returned in TYPES:
        return TYPES[returned]
    kind = re.search(r"\b(float32|float64|uint8)\b", documentation)
    if not kind:
        raise SystemExit(f"{name}: expected a type among {list(TYPES)}, or one of an array in the documentation, found {returned}")
    return f"NDArray[np.{kind[1]}]"


def stub(file, sources=HERE / "src"):
    classes, functions = {}, []
    for source in MODULES[file]:
        for of, attributes, documentation, name, returned in items((sources / f"{source}.rs").read_text()):
            if attributes == "class":
                classes.setdefault(of, [])
            elif of is None and "#[pyfunction]" in attributes:
                functions.append(function(name, *signature(attributes, name), ""))
            elif of in classes and name not in HIDDEN:
                full, rows = f"{of}.{name}", classes[of]
                if "#[getter]" in attributes:
                    kind = property_type(full, documentation, returned)
                    rows += ["    @property", f"    def {name}(self) -> {kind}: ..."]
                elif name in SLOTS:
                    rows.append(f"    def {name}{SLOTS[name]}: ...")
                elif "signature" in attributes:
                    arguments, returned = signature(attributes, full)
                    if "#[staticmethod]" in attributes:
                        rows.append("    @staticmethod")
                    elif "#[new]" in attributes:
                        name, arguments = "__new__", ["cls", *arguments]
                    else:
                        arguments = ["self", *arguments]
                    rows.append(function(name, arguments, returned, "    "))
    text = NOTE + (HERE / "stubs" / file).read_text() + "\n"
    text += "".join(f"class {name}:\n" + "\n".join(rows) + "\n\n" for name, rows in sorted(classes.items()) if rows)
    return text + "\n".join(functions) + "\n"


if __name__ == "__main__":
    for file in MODULES:
        (HERE / "srflow" / file).write_text(stub(file))
