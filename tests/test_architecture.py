"""The architecture, checked on the syntax trees: who imports whom, what kernels may be, what is public."""

from __future__ import annotations

import ast
import inspect
import statistics
import subprocess
import sys
from functools import reduce
from pathlib import Path

import numpydoc.validate
import pytest

import fdem

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "fdem"
MODULES = sorted(PACKAGE.rglob("*.py"))
MAX_FILE, MAX_FUNCTION = 450, 70
# a kernel and all it calls stand in one file (numba's cache does not see other files): the clip needs more room
MAX_KERNEL_FILE = 550
KERNELS = sorted((PACKAGE / "kernels").glob("[!_]*.py"))

BASE = {"errors", "log", "_jit"}
NUMERIC = {"blocks", "contact", "model", "state", "constraints", "loads"}
FRONT = {"readout", "stopping", "description", "views", "checkpoint", "guard"}
# part of the package -> parts it may import, besides itself; the arrows of the architecture
ARROWS = {
    "errors": set(),
    "log": set(),
    "_jit": set(),
    "kernels": {"_jit"},
    "scene": {"errors", "log"},
    "blocks": BASE | {"kernels"},
    "contact": BASE | {"kernels"},
    "model": BASE | {"blocks", "contact", "state"},
    "state": BASE | {"blocks", "contact", "model"},
    "constraints": BASE | {"model", "state"},
    "loads": BASE | {"model", "state"},
    "compile": BASE | NUMERIC | {"scene"},
    "integrate": BASE | {"kernels"},  # linear algebra; nothing of blocks and contacts
    "integrate.system": BASE | NUMERIC,  # and what belongs to it: what integrators see
    "results": BASE | {"model", "state"},
    "readout": BASE | {"model", "state", "contact", "integrate", "results", "description"},
    "stopping": BASE | {"model", "state"},
    "guard": BASE | {"contact"},
    "description": BASE | {"model", "state", "contact"},
    "views": BASE | {"model", "state", "results"},
    "checkpoint": BASE | {"model", "state", "contact", "scene"},
    "strength": BASE | {"scene", "integrate", "simulation"},
    "simulation": BASE | NUMERIC | {"scene", "compile", "integrate", "results"} | FRONT,
}
# third-party packages a part may import inside functions; numpy may be imported at the top anywhere
LAZY = {
    "_jit": {"numba"},
    "scene": {"scipy", "gmsh", "meshio", "skfem", "pyvista", "vtkmodules", "manifold3d"},
    "blocks": {"scipy", "skfem"},
    "contact": {"scipy"},
    "integrate": {"scipy", "pyamg", "sksparse", "pypardiso"},
    "results": {"scipy", "pyvista", "vtkmodules", "h5py", "matplotlib"},
    "compile": {"scipy"},
    "simulation": {"scipy", "pyvista", "numpy"},
}
FORBIDDEN = ("print", "exit", "quit", "sys.exit", "os._exit", "np.random.seed", "breakpoint")
SYSTEM = {"system", "pace", "trial", "impulses", "matrices", "mobility"}
HEAVY = ("numba", "scipy", "skfem", "gmsh", "meshio", "pyvista", "vtkmodules", "matplotlib", "h5py", "pyamg")


def part(path):
    """First component of a module below fdem: a folder or a file."""
    relative = path.relative_to(PACKAGE).with_suffix("")
    system = relative.parts[0] == "integrate" and relative.parts[-1] in SYSTEM
    return "integrate.system" if system else relative.parts[0]


def imports(path):
    """(imported module, line, whether it is at module level); imports for typing alone do not count."""
    found = []

    def visit(node, top):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Import):
            found.extend((alias.name, node.lineno, top) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            found.append((node.module, node.lineno, top))
            if node.module == "fdem":
                found.pop()
                found.extend((f"fdem.{alias.name}", node.lineno, top) for alias in node.names)
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            visit(child, top and not inside)

    visit(ast.parse(path.read_text()), True)
    return found


def where(path, line):
    """Clickable place in a message."""
    return f"{path.relative_to(ROOT)}:{line}"


def test_every_arrow_between_parts_is_allowed():
    wrong = []
    for path in MODULES:
        own = part(path)
        if own == "__init__":
            continue
        assert own in ARROWS, f"fdem/{own} is not in the table of arrows"
        allowed = ARROWS[own] | {own.split(".")[0]}
        for name, line, _ in imports(path):
            if name.split(".")[0] == "fdem" and name.split(".")[1] not in allowed:
                wrong.append(f"{where(path, line)} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_heavy_packages_are_imported_where_first_needed():
    wrong = []
    for path in MODULES:
        own = part(path).split(".")[0]
        for name, line, top in imports(path):
            package = name.split(".")[0]
            if package in sys.stdlib_module_names or package in ("fdem", "numpy"):
                continue
            if top or package not in LAZY.get(own, set()):
                wrong.append(f"{where(path, line)} imports {name}" + (" at module level" if top else ""))
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("path", KERNELS, ids=lambda p: p.stem)
def test_kernel_files_are_self_contained(path):
    """Numba keys its disk cache on the file of the kernel: what it calls must be in there."""
    assert {name for name, _, _ in imports(path)} <= {"__future__", "math", "numpy", "fdem._jit"}
    tree = ast.parse(path.read_text())
    for node in tree.body:
        assert not isinstance(node, ast.ClassDef), f"{where(path, node.lineno)}: a class among kernels"
        if isinstance(node, ast.FunctionDef):
            names = [ast.unparse(d).split("(")[0] for d in node.decorator_list]
            assert names == ["kernel"], f"{where(path, node.lineno)}: {node.name} is not a kernel"
            nested = [n for n in ast.walk(node) if isinstance(n, ast.FunctionDef | ast.Lambda) and n is not node]
            assert not nested, f"{where(path, node.lineno)}: {node.name} holds a closure"


def test_nothing_is_printed_and_nobody_exits():
    wrong = []
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in (
                "print",
                "exit",
                "quit",
                "sys.exit",
                "os._exit",
            ):
                wrong.append(where(path, node.lineno))
    assert not wrong, "\n".join(wrong)


def test_files_and_functions_stay_readable():
    wrong = []
    for path in MODULES:
        text = path.read_text()
        most = MAX_KERNEL_FILE if path.parent.name == "kernels" else MAX_FILE
        if (lines := text.count("\n")) > most:
            wrong.append(f"{path.relative_to(ROOT)} has {lines} lines")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                first = node.body[0]
                described = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
                start = first.end_lineno if described else node.lineno
                if (length := node.end_lineno - start) > MAX_FUNCTION:
                    wrong.append(f"{where(path, node.lineno)}: {node.name} has {length} lines of code")
    assert not wrong, "\n".join(wrong)


def test_no_machine_paths():
    names = [*ROOT.glob("*.toml"), *ROOT.glob("*.md"), ROOT / "Makefile"]
    for folder in ("fdem", "tests", "examples", "benchmarks", "meshes", "tools", "docs"):
        names += [p for p in (ROOT / folder).rglob("*") if p.suffix in (".py", ".md", ".sh")]
    marks = ["/" + "work/", "/" + "home/", "/" + "tmp/"]
    wrong = [str(p.relative_to(ROOT)) for p in names if p.is_file() and any(m in p.read_text() for m in marks)]
    assert not wrong, "\n".join(wrong)


def test_every_public_name_exists():
    assert len(set(fdem.__all__)) == len(fdem.__all__)
    for name in fdem.__all__:
        assert hasattr(fdem, name), name
    assert set(fdem.__all__) <= set(dir(fdem))


def described():
    """Public functions and classes with the public methods of those classes."""
    for name in sorted(fdem.__all__):
        thing = getattr(fdem, name)
        if inspect.isclass(thing):
            yield name
            if not issubclass(thing, BaseException):
                members = [m for m in vars(thing) if not m.startswith("_") and inspect.isfunction(vars(thing)[m])]
                yield from (f"{name}.{member}" for member in sorted(members))
        elif callable(thing):
            yield name


def test_docstrings_of_public_names():
    """Numpydoc: every parameter described, none that does not exist; one-line methods and results are spared."""
    wrong = []
    for name in described():
        errors = dict(numpydoc.validate.validate(f"fdem.{name}")["errors"])
        codes = {"GL08", "PR01", "PR02", "PR03", "SS06"}
        doc = inspect.getdoc(reduce(getattr, name.split("."), fdem)) or ""
        if "." in name and "\n" not in doc:
            codes = {"GL08"}
        elif "\nAttributes\n" in doc:
            codes -= {"PR01"}  # results are made by the library: their fields matter, not how to make them
        wrong += [f"fdem.{name}: {errors[code]}" for code in sorted(codes & set(errors))]
    assert not wrong, "\n".join(wrong)


def run(code):
    """Output of a fresh interpreter."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_loads_no_heavy_package():
    loaded = run("import sys, fdem; fdem.__all__; print(*{m.split('.')[0] for m in sys.modules})").split()
    assert not set(HEAVY) & set(loaded)


def test_scenes_are_written_without_compiling_kernels():
    code = """import sys, fdem
scene = fdem.Scene()
scene.add(fdem.brick((0, 0, 0), (1, 1, 1)), fdem.Rigid(), fdem.Elastic(density=2500.0))
print(*{m.split(".")[0] for m in sys.modules})"""
    loaded = run(code).split()
    assert not {"numba", "gmsh", "skfem", "pyvista"} & set(loaded)


def test_import_is_fast():
    """CPU time, which other processes on the machine do not change much, over bare numpy."""
    code = "import numpy, time; t = time.process_time(); import fdem; print(time.process_time() - t)"
    assert statistics.median(float(run(code)) for _ in range(5)) < 0.15
