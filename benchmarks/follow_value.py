"""Follow one value through the calls of a checkout, and count its climbs.

Run with ``python benchmarks/follow_value.py [CHECKOUT]``; `measure_structure.py` prints
the same table. The walk is static, over syntax trees. It starts in one function with
one argument, a survey or a cube, and enters the functions that receive the value. The
value is that argument, its other names, what is read from it (a part of a survey; a
selection of a cube), and the same out of an object that holds it, by the annotated type
of the field. Arrays of a cube are no longer the cube. An object that holds the value is
entered too, but is no station: handing it down is the point. Each function that
receives the value is a station, and so are the methods of the value. A function is
searched once for each set of arguments.

A climb is a step from one station to the next that leads from a lower floor to a higher
one: the value was down in a lower floor already, and is handed over above it again.
"""

from __future__ import annotations

import ast
import itertools
import sys
import tomllib
from pathlib import Path

#: Entry of each walk: title, module and function by preference, argument, its types.
WALKS = (
    ("survey in simulation", ("simulation.measurement.simulate",), "survey", "Survey"),
    ("cube in open water", ("rejection.open_water.open_water",), "cube", "Dataset"),
    ("cube in joint estimation", ("rejection.joint.estimate.joint",), "cube",
     "Dataset"),
    ("cube in the range image", ("imaging.range_image.range_image",), "cube",
     "Dataset"),
    ("survey in acquisition", ("acquisition.run.acquire",), "survey", "Survey"),
)  # fmt: skip
#: Types that are the value itself, by the type of the argument.
SAME = {"Survey": {"Survey"}, "Dataset": {"Dataset", "Source", "InMemory"}}
#: Attributes at which a cube becomes numbers.
NUMBERS = {"values", "shape", "sizes", "size", "dims", "ndim", "dtype"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


class Code:
    """Definitions of all modules of a checkout, by name."""

    def __init__(self, root):
        source = root / "src"
        contract = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
        layers = contract["tool"]["importlinter"]["contracts"][0]["layers"]
        self.level = {
            name.strip(): len(layers) - number
            for number, line in enumerate(layers)
            for name in line.replace("|", ":").replace("amulor.", "").split(":")
        }
        self.tables = {}
        for path in (source / "amulor").rglob("*.py"):
            parts = path.relative_to(source).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            self.tables[name] = self._table(name, ast.parse(path.read_text("utf-8")))
        #: Class of `cube.amulor`.
        self.accessor = next(
            table["CubeAccessor"]
            for table in self.tables.values()
            if table.get("CubeAccessor", ("",))[0] == "class"
        )

    @staticmethod
    def _table(module, tree):
        """Names of a module: imports, functions, classes."""
        table = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    entry = ("import", node.module, alias.name)
                    table.setdefault(alias.asname or alias.name, entry)
        for node in tree.body:
            if isinstance(node, DEFINITIONS):
                table[node.name] = ("function", module, node, None)
            elif isinstance(node, ast.ClassDef):
                table[node.name] = ("class", module, node)
        return table

    def floor(self, module):
        """Level of the floor of a module; None for modules of no floor."""
        parts = module.split(".")
        return self.level.get(parts[1]) if len(parts) > 1 else None

    def resolve(self, module, name, depth=0):
        """Definition of a name in a module; None outside the package."""
        entry = self.tables.get(module, {}).get(name)
        if entry is None:
            full = f"{module}.{name}"
            return ("module", full) if full in self.tables else None
        if entry[0] != "import":
            return entry
        _, origin, original = entry
        if depth > 8 or origin not in self.tables:
            return None
        itself = ("import", origin, original)
        if f"{origin}.{original}" in self.tables and (
            self.tables[origin].get(original, itself) == itself
        ):
            return ("module", f"{origin}.{original}")
        return self.resolve(origin, original, depth + 1)

    def member(self, owner, name):
        """Method or property of a class or of its bases."""
        if owner is None:
            return None
        for node in owner[2].body:
            if isinstance(node, DEFINITIONS) and node.name == name:
                return ("function", owner[1], node, owner)
        for base in owner[2].bases:
            entry = self.resolve(owner[1], getattr(base, "id", ""))
            if entry and entry[0] == "class" and (method := self.member(entry, name)):
                return method
        return None

    def named_type(self, module, annotation):
        """Name or class of an annotation, the part that is not None."""
        if annotation is None:
            return None
        if isinstance(annotation, ast.BinOp):
            left = self.named_type(module, annotation.left)
            return left or self.named_type(module, annotation.right)
        if isinstance(annotation, ast.Subscript):
            return self.named_type(module, annotation.slice)
        if isinstance(annotation, ast.Tuple):
            return None
        name = getattr(annotation, "attr", getattr(annotation, "id", None))
        if name is None or name == "None":
            return None
        if isinstance(annotation, ast.Attribute):
            return name
        entry = self.resolve(module, name)
        return entry if entry and entry[0] == "class" else name

    def field_type(self, owner, name):
        """Type of a field, a property, or an attribute that __init__ sets."""
        for node in owner[2].body:
            if (
                isinstance(node, ast.AnnAssign)
                and getattr(node.target, "id", 0) == name
            ):
                return self.named_type(owner[1], node.annotation)
            if isinstance(node, DEFINITIONS) and node.name == name:
                return self.named_type(owner[1], node.returns)
        start = self.member(owner, "__init__")
        for node in ast.walk(start[2]) if start else ():
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
                for target in node.targets:
                    if getattr(target, "attr", None) == name:
                        for argument in arguments(start[2]):
                            if argument.arg == node.value.id:
                                return self.named_type(start[1], argument.annotation)
        return None


def arguments(function):
    """Arguments of a function."""
    listed = function.args
    return [*listed.posonlyargs, *listed.args, *listed.kwonlyargs]


def type_name(kind):
    """Name of a type."""
    return kind[2].name if isinstance(kind, tuple) else kind


class Walk:
    """Stations of one value."""

    def __init__(self, code, value):
        self.code, self.value, self.same = code, value, SAME[value]
        self.stations, self.results = [], {}

    def station(self, entry):
        """Record that a function receives the value."""
        if self.code.floor(entry[1]) is not None:
            self.stations.append((entry[1], entry[2].name))

    def holds(self, kind, depth=0):
        """Whether objects of a type hold the value."""
        if type_name(kind) in self.same:
            return True
        if not isinstance(kind, tuple) or depth > 3:
            return False
        fields = [n.target.id for n in kind[2].body if isinstance(n, ast.AnnAssign)]
        start = self.code.member(kind, "__init__")
        for node in ast.walk(start[2]) if start else ():
            if isinstance(node, ast.Assign):
                fields += [getattr(t, "attr", "") for t in node.targets]
        return any(
            self.holds(self.code.field_type(kind, name), depth + 1) for name in fields
        )

    def enter(self, entry, received):
        """Search one function that receives the value, or an object that holds it."""
        key = entry[1], entry[2].name, entry[3] and entry[3][2].name, received
        if key not in self.results:
            self.results[key] = None
            self.results[key] = Function(self, entry, dict(received)).search()
        return self.results[key]

    def climbs(self):
        """Number of steps to a higher floor."""
        floors = [self.code.floor(module) for module, _ in self.stations]
        return sum(low < high for low, high in itertools.pairwise(floors))


class Function:
    """One function of a walk: what its names hold."""

    def __init__(self, walk, entry, received):
        self.walk, self.code = walk, walk.code
        _, self.module, self.node, self.owner = entry
        #: "value" or "holder" of the names that count, and types of names.
        self.held, self.types = received, {}
        for argument in arguments(self.node):
            kind = self.code.named_type(self.module, argument.annotation)
            self.types[argument.arg] = kind
        if self.owner:
            self.types["self"] = self.types["cls"] = self.owner
            if self.walk.holds(self.owner):
                self.held.setdefault("self", "holder")
        self.inner = {
            n.name: ("function", self.module, n, None)
            for n in ast.walk(self.node)
            if isinstance(n, DEFINITIONS) and n is not self.node
        }
        self.returned = None
        self.seen = {}

    def search(self):
        """Go through the statements; return what the function returns."""
        self.block(self.node.body)
        return self.returned

    def block(self, body):
        for statement in body:
            if isinstance(statement, DEFINITIONS):
                self.block(statement.body)
                continue
            if isinstance(statement, ast.ClassDef):
                continue
            for child in ast.iter_child_nodes(statement):
                if isinstance(child, ast.expr):
                    self.look(child)
                elif isinstance(child, ast.withitem):
                    self.look(child.context_expr)
            if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value:
                targets = getattr(statement, "targets", None) or [statement.target]
                for target in targets:
                    self.assign(target, statement.value)
            elif isinstance(statement, ast.For) and isinstance(
                statement.target, ast.Name
            ):
                self.hold(statement.target.id, self.kind(statement.iter), None)
            elif isinstance(statement, ast.Return) and statement.value is not None:
                self.returned = self.kind(statement.value) or self.returned
            for name in ("body", "orelse", "finalbody"):
                self.block(getattr(statement, name, []))
            for name in ("handlers", "cases"):
                for part in getattr(statement, name, []):
                    self.block(part.body)

    def assign(self, target, value):
        if isinstance(target, ast.Name):
            self.hold(target.id, self.kind(value), self.type_of(value))
        elif isinstance(target, ast.Tuple):
            parts = (
                value.elts
                if isinstance(value, ast.Tuple) and len(value.elts) == len(target.elts)
                else [value] * len(target.elts)
            )
            for name, part in zip(target.elts, parts, strict=True):
                if isinstance(value, ast.Tuple):
                    self.assign(name, part)

    def hold(self, name, kind, type_):
        if kind:
            self.held[name] = kind
        else:
            self.held.pop(name, None)
        if type_ is not None or kind:
            self.types[name] = type_

    def type_of(self, node):
        """Type of an expression, where it is annotated."""
        if isinstance(node, ast.Name):
            return self.types.get(node.id)
        if isinstance(node, ast.Attribute):
            owner = self.type_of(node.value)
            if isinstance(owner, tuple):
                return self.code.field_type(owner, node.attr)
        if isinstance(node, ast.IfExp):
            return self.type_of(node.body) or self.type_of(node.orelse)
        if isinstance(node, ast.Call):
            entry, _ = self.target(node)
            if entry and entry[0] == "class":
                return entry
            if entry and entry[0] == "function":
                result = self.code.named_type(entry[1], entry[2].returns)
                return entry[3] if type_name(result) == "Self" else result
        return None

    def kind(self, node):
        """Content of an expression: "value", "holder" or nothing."""
        if isinstance(node, ast.Name):
            return self.held.get(node.id)
        if isinstance(node, ast.Attribute | ast.Subscript):
            base = self.kind(node.value)
            attribute = getattr(node, "attr", "")
            if base == "holder":
                type_ = self.type_of(node)
                if type_name(type_) in self.walk.same:
                    return "value"
                return "holder" if type_ and self.walk.holds(type_) else None
            if base == "value" and self.walk.value == "Dataset":
                if attribute in NUMBERS:
                    return None
                accessor = isinstance(node.value, ast.Attribute)
                if accessor and node.value.attr == "amulor":
                    return None
            elif base == "value" and attribute and self.is_number(node):
                return None
            return base
        if isinstance(node, ast.Call):
            return self.seen.get(id(node))
        if isinstance(node, ast.IfExp):
            return self.kind(node.body) or self.kind(node.orelse)
        if isinstance(node, ast.BoolOp):
            return next(filter(None, map(self.kind, node.values)), None)
        if isinstance(node, ast.Tuple | ast.List):
            return next(filter(None, map(self.kind, node.elts)), None)
        if isinstance(node, ast.Starred | ast.NamedExpr):
            return self.kind(node.value)
        return None

    def is_number(self, node):
        """Whether a part of a survey is a number or a text, by its annotation."""
        owner = self.type_of(node.value)
        if not isinstance(owner, tuple):
            return False
        kind = self.code.field_type(owner, node.attr)
        return kind is None or (isinstance(kind, str) and kind not in self.walk.same)

    def look(self, node):
        """Enter the calls of an expression, arguments first."""
        if isinstance(node, ast.Call):
            for child in [*node.args, *(k.value for k in node.keywords)]:
                self.look(child)
            self.look(node.func)
            self.seen[id(node)] = self.call(node)
            return
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.comprehension):
                self.look(child.iter)
                if isinstance(child.target, ast.Name):
                    self.hold(child.target.id, self.kind(child.iter), None)
                for test in child.ifs:
                    self.look(test)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                self.look(child)
        if isinstance(node, ast.Attribute):
            self.attribute(node)

    def attribute(self, node):
        """Enter a property of the value, of its accessor, or of an object."""
        base = node.value
        if isinstance(base, ast.Attribute) and base.attr == "amulor":
            entry = self.code.member(self.code.accessor, node.attr)
            if entry and self.kind(base.value) == "value":
                self.walk.station(entry)
            return
        owner = self.type_of(base)
        entry = self.code.member(owner, node.attr) if isinstance(owner, tuple) else None
        if entry and entry[2].decorator_list and self.kind(base):
            if self.kind(base) == "value":
                self.walk.station(entry)
            self.walk.enter(entry, (("self", self.kind(base)),))

    def target(self, node):
        """Definition that a call enters, and the expression it is a method of."""
        function = node.func
        if isinstance(function, ast.Name):
            if function.id == "cls" and self.owner:
                return self.owner, None
            inner = self.inner.get(function.id)
            return inner or self.code.resolve(self.module, function.id), None
        if not isinstance(function, ast.Attribute):
            return None, None
        base = function.value
        if isinstance(base, ast.Attribute) and base.attr == "amulor":
            return self.code.member(self.code.accessor, function.attr), base
        owner = self.type_of(base)
        if isinstance(owner, tuple):
            return self.code.member(owner, function.attr), base
        if isinstance(base, ast.Name):
            entry = self.code.resolve(self.module, base.id)
            if entry and entry[0] == "module":
                return self.code.resolve(entry[1], function.attr), None
            if entry and entry[0] == "class":
                return self.code.member(entry, function.attr), None
        return None, None

    def call(self, node):
        """Enter a call that hands the value over; return what its result holds."""
        given = [(n, self.kind(a)) for n, a in enumerate(node.args)]
        given += [(k.arg, self.kind(k.value)) for k in node.keywords]
        given = [(name, kind) for name, kind in given if kind]
        entry, base = self.target(node)
        own = self.kind(base) if base is not None else None
        if entry is None:
            # A method of the value that is no function of the package: a selection.
            function = node.func
            if isinstance(function, ast.Attribute):
                kind = self.kind(function.value)
                return kind if kind == "value" else None
            return None
        if entry[0] == "class":
            start = self.code.member(entry, "__init__")
            if start and given:
                self.receive(start, given, None)
            if given and type_name(entry) in self.walk.same:
                return "value"
            return "holder" if given and self.walk.holds(entry) else None
        if entry[0] != "function" or not (given or own):
            return None
        result = self.receive(entry, given, own)
        type_ = self.code.named_type(entry[1], entry[2].returns)
        if type_name(type_) == "Self":
            type_ = entry[3]
        if type_name(type_) in self.walk.same and result:
            return "value"
        if isinstance(type_, tuple):
            return "holder" if self.walk.holds(type_) else None
        return result if type_ is None else None

    def receive(self, entry, given, own):
        """Record a station where the value is handed over, and search the function."""
        names = [a.arg for a in arguments(entry[2])]
        if entry[3] and names and names[0] in ("self", "cls"):
            names = names[1:]
        received = {}
        for name, kind in given:
            if isinstance(name, int):
                name = names[name] if name < len(names) else None
            if name in names:
                received[name] = kind
        if own:
            received["self"] = own
        if not received:
            return None
        if "value" in received.values():
            self.walk.station(entry)
        return self.walk.enter(entry, tuple(sorted(received.items())))


def climbs(root):
    """Yield title, stations, modules and climbs of each walk."""
    code = Code(root)
    for title, entries, argument, type_ in WALKS:
        for entry in entries:
            module, _, name = f"amulor.{entry}".rpartition(".")
            start = code.resolve(module, name)
            if start:
                break
        walk = Walk(code, type_)
        walk.station(start)
        walk.enter(start, ((argument, "value"),))
        modules = {module for module, _ in walk.stations}
        yield title, len(walk.stations), len(modules), walk.climbs(), walk


def main():
    """Print the climbs, and with a title the stations of that walk."""
    words = sys.argv[1:]
    root = Path(words[0] if words else Path(__file__).parents[1])
    for title, stations, modules, count, walk in climbs(root):
        print(f"{title:26}{stations:6}{modules:6}{count:6}")
        if title in words[1:]:
            for before, (module, name) in itertools.pairwise([None, *walk.stations]):
                up = before and walk.code.floor(before[0]) < walk.code.floor(module)
                print("   ", "^" if up else " ", walk.code.floor(module), module, name)


if __name__ == "__main__":
    main()
