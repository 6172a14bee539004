import ast
import importlib.util
import inspect
import pathlib

import pytest

import srflow
from srflow import _srflow


def parameters(arguments, without):
    """Names and defaults, in order, as of a function in the stubs; the first `without` are left out."""
    named = arguments.posonlyargs + arguments.args
    defaults = [None] * (len(named) - len(arguments.defaults)) + arguments.defaults
    found = [(x.arg, default) for x, default in zip(named, defaults, strict=True)][without:]
    found += [(x.arg, default) for x, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)]
    found = [(name, None if default is None else ast.literal_eval(default)) for name, default in found]
    return found + ([("**", arguments.kwarg.arg)] if arguments.kwarg else [])


def of_signature(function, without):
    found = []
    for name, parameter in list(inspect.signature(function).parameters.items())[without:]:
        if parameter.kind is parameter.VAR_KEYWORD:
            found.append(("**", name))
        else:
            found.append((name, None if parameter.default is parameter.empty else parameter.default))
    return found


ONLY_TYPES = {
    "CameraGradient",
    "Estimate",
    "Face",
    "Frame",
    "Gradients",
    "Metrics",
    "Pair",
    "Results",
    "Scores",
    "Spotted",
}


@pytest.mark.parametrize("file, module", [("_srflow.pyi", _srflow), ("mer.pyi", srflow.mer)])
def test_the_stubs_have_every_function_with_its_parameters(file, module):
    stubs = ast.parse((pathlib.Path(srflow.__file__).parent / file).read_text())
    found = {node.name: node for node in stubs.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    public = {name for name in dir(module) if not name.startswith("_")} - {"mer"}
    assert set(found) - ONLY_TYPES == public
    for name in public:
        item = getattr(module, name)
        assert item.__doc__, f"{name} has no documentation"
        if isinstance(found[name], ast.FunctionDef):
            assert parameters(found[name].args, 0) == of_signature(item, 0), name
            continue
        methods = {node.name: node for node in found[name].body if isinstance(node, ast.FunctionDef)}
        hidden = {"__repr__", "__reduce__"}
        own = {attribute for attribute in vars(item) if attribute not in ("__doc__", "__module__")}
        assert set(methods) == own - hidden, name
        for method, node in methods.items():
            decorators = [decorator.id for decorator in node.decorator_list]
            if decorators == ["property"]:
                continue
            if method == "__new__":
                assert parameters(node.args, 1) == of_signature(item, 0), name
            elif not method.startswith("__"):  # those have no signature
                itself = 0 if decorators == ["staticmethod"] else 1
                expected = of_signature(getattr(item, method), itself)
                assert parameters(node.args, itself) == expected, f"{name}.{method}"


@pytest.mark.parametrize("file", ["_srflow.pyi", "mer.pyi"])
def test_the_stubs_are_fresh(file):
    script = pathlib.Path(__file__).parents[1] / "stubs.py"
    spec = importlib.util.spec_from_file_location("stubs", script)
    stubs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stubs)
    stored = (pathlib.Path(srflow.__file__).parent / file).read_text()
    assert stored == stubs.stub(file), "run python crates/python/stubs.py"


def test_everything_public_is_exported():
    built = {name for name in dir(_srflow) if not name.startswith("_")} - {"run", "run_job"}
    assert set(srflow.__all__) == built | {"Report", "jobs", "render", "train"}
    assert all(callable(getattr(srflow.jobs, name)) for name in srflow.jobs.__all__)
    built = {name for name in dir(_srflow.mer) if not name.startswith("_")}
    assert set(srflow.mer.__all__) == built | {"predict", "spot"}
