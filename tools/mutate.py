"""Plant small defects in the shaders, one at a time, and list those that the tests miss.

    .venv/bin/python tools/mutate.py [--shader NAME] [--limit N --seed S] [--jobs N] [--list]

A mutant is one change in the body of a function, in a constant or in an override's default: a sign,
+ - * / % exchanged, a comparison moved by one, a constant changed (x -> 1.01 x, n -> n + 1), an
index moved by one, min and max or .x and .y exchanged, a statement dropped, and their like. It is
planted in a copy of the shaders; then the tests that name the shader run until one fails:
tests/**/test_NAME.py and the tests that contain the stage's path; for an include also the tests of
every stage that includes it. Verdicts: killed (a test failed), timeout (as good as killed), invalid
(it does not compile), survived. Mutants that change nothing that can be observed are listed, each
with its reason, in tools/mutate_equivalent.toml; an entry that matches no mutant is an error.
Exit code 1 when a mutant survived.

The tests run in a forked child: everything is imported once, before the first GPU device is made,
which saves the two seconds that a start of pytest costs.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import wgpu
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from gpusim.gpu import ShaderError, default_device, device
from gpusim.gpu.wgsl import load, shaders_root

PROJECT = Path(__file__).resolve().parents[1]
TESTS = PROJECT / "tests"
EQUIVALENT = PROJECT / "tools" / "mutate_equivalent.toml"
SURVIVED, KILLED, INVALID, BROKEN = 0, 1, 90, 91  # exit codes of a child; 0 and 1 as pytest's
VERDICTS = {SURVIVED: "survived", KILLED: "killed", INVALID: "invalid"}
OPTIONS = ("-x", "-q", "--no-header", "-p", "no:cacheprovider")
# A mutant may make a loop long; what takes this much longer than the sound shader hangs.
TIMEOUT_FACTOR, TIMEOUT_LEAST_S = 5.0, 20.0

EXCHANGED = {
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "%": "/",
    "+=": "-=",
    "-=": "+=",
    "*=": "/=",
    "/=": "*=",
    "%=": "/=",
    "++": "--",
    "--": "++",
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
    "<<": ">>",
    ">>": "<<",
    "&": "|",
    "|": "&",
    "^": "&",
    "&=": "|=",
    "|=": "&=",
    "^=": "&=",
    "<<=": ">>=",
    ">>=": "<<=",
}
WORDS = {
    "min": "max",
    "max": "min",
    "floor": "ceil",
    "ceil": "floor",
    "round": "floor",
    "sin": "cos",
    "cos": "sin",
    "abs": "",
    "true": "false",
    "false": "true",
}
COMPONENTS = {"x": "y", "y": "x", "z": "x", "w": "x", "r": "g", "g": "r", "b": "r", "a": "r"}

_OPERATOR = re.compile(r"<<=|>>=|&&|\|\||<<|>>|\+\+|--|[-+*/%&|^<>=!]=|[-+*/%&|^<>!]")
_NUMBER = re.compile(
    r"(?<![\w.])(?:0[xX][0-9a-fA-F]+|(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?|\d+(?:[eE][+-]?\d+)?)"
    r"[uifh]?\b"
)
_TEMPLATE = re.compile(
    r"\b(?:array|vec[234]|mat[234]x[234]|ptr|bitcast|atomic|var)\s*<[^<>;(){}]*>"
)
_DECLARED = re.compile(r"\b(?:const|override)\s+\w+\s*(?::[^=;]*)?=([^;]*);")


@dataclass(frozen=True)
class Mutant:
    """One change: ``text[start:end]`` of a shader becomes ``new``."""

    shader: str
    line: int
    start: int
    end: int
    new: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.shader}.wgsl:{self.line}\n    - {self.before}\n    + {self.after}"


def blanked(text: str) -> str:
    """Return the text with comments and directives as spaces, so that every position stays.

    What ``#repeat`` fills in stands there as a name.
    """
    spaces = lambda found: re.sub(r"[^\n]", " ", found[0])  # noqa: E731
    code = re.sub(r"//[^\n]*|/\*.*?\*/|^ *#[^\n]*", spaces, text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"\$\{[^}]*\}", lambda found: "k" * len(found[0]), code)


def bodies(code: str) -> Iterator[tuple[int, int]]:
    """Yield start and end of each function body, braces excluded."""
    for found in re.finditer(r"\bfn\s+\w+", code):
        start = end = code.index("{", found.end()) + 1
        depth = 1
        while depth:
            depth += (code[end] == "{") - (code[end] == "}")
            end += 1
        yield start, end - 1


def statements(code: str, start: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield each statement that can be left out: no declaration, no value returned."""
    first, depth = start, 0
    for position in range(start, end):
        sign = code[position]
        depth += (sign == "(") - (sign == ")")
        if depth == 0 and sign in "{};":
            text = code[first:position].strip()
            if sign == ";" and text and not re.match(r"(?:let|var|const)\b|return\s", text):
                yield (
                    first + len(code[first:position]) - len(code[first:position].lstrip()),
                    (position + 1),
                )
            first = position + 1


def changed_number(text: str) -> str:
    """Return a constant a little off: an integer or 0.0 by one, a float by one percent."""
    suffix = text[-1] if text[-1] in "uifh" and not text.startswith(("0x", "0X")) else ""
    if text.startswith(("0x", "0X")):
        suffix = text[-1] if text[-1] in "ui" else ""
    digits = text.removesuffix(suffix)
    if suffix in ("f", "h") or not re.fullmatch(r"\d+|0[xX][0-9a-fA-F]+", digits):
        return f"{(float(digits) * 1.01) or 1.0!r}{suffix}"
    number = int(digits, 0)
    number += -1 if number == 0xFFFFFFFF else 1
    return (hex(number) if digits[:2] in ("0x", "0X") else str(number)) + suffix


def changes(code: str, start: int, end: int) -> Iterator[tuple[int, int, str]]:
    """Yield (start, end, replacement) for each change inside an expression region."""
    for found in _OPERATOR.finditer(code, start, end):
        sign = found[0]
        left = code[start : found.start()].rstrip()
        operand = bool(re.search(r"[\w)\]]$", left)) and not re.search(r"\breturn$", left)
        if sign in ("-", "!") and not operand:
            yield found.start(), found.end(), ""
        elif sign in EXCHANGED and (operand or sign not in "*&"):
            yield found.start(), found.end(), EXCHANGED[sign]
    for found in _NUMBER.finditer(code, start, end):
        yield found.start(), found.end(), changed_number(found[0])
    for found in re.finditer(r"(?<![.\w])[a-z]\w*\b", code[start:end]):
        if found[0] in WORDS:
            yield start + found.start(), start + found.end(), WORDS[found[0]]
    for found in re.finditer(r"(?<=[\w)\]])\.([xyzw]{1,4}|[rgba]{1,4})\b", code[start:end]):
        members = found[1]
        other = COMPONENTS[members] if len(members) == 1 else members[1] + members[0] + members[2:]
        if other != members:
            yield start + found.start(1), start + found.end(1), other
    for found in re.finditer(r"(?<=[\w)\]])\[", code[start:end]):
        first = last = start + found.end()
        depth = 1
        while depth:
            depth += (code[last] == "[") - (code[last] == "]")
            last += 1
        index = code[first : last - 1]
        if not _NUMBER.fullmatch(index.strip()):
            yield first, last - 1, f"({index}) + 1"


def mutants(shader: str, text: str) -> list[Mutant]:
    """Return every mutant of one shader, in the order of the text."""
    code = blanked(text)
    plain = code
    while (shorter := _TEMPLATE.sub(lambda found: " " * len(found[0]), plain)) != plain:
        plain = shorter
    found = set()
    for start, end in bodies(code):
        found.update(changes(plain, start, end))
        found.update((first, last, "") for first, last in statements(code, start, end))
    inside = list(bodies(code))
    for declared in _DECLARED.finditer(plain):
        if not any(start <= declared.start() < end for start, end in inside):
            found.update(changes(plain, declared.start(1), declared.end(1)))
    made = []
    for start, end, new in sorted(found):
        mutated = text[:start] + new + text[end:]
        first = text.rfind("\n", 0, start) + 1
        stop = text.find("\n", end)
        before = " ".join(text[first : len(text) if stop < 0 else stop].split())
        rest = mutated.find("\n", start + len(new))
        after = " ".join(mutated[first : len(mutated) if rest < 0 else rest].split())
        made.append(Mutant(shader, text.count("\n", 0, start) + 1, start, end, new, before, after))
    return made


def stages() -> list[str]:
    """Return every stage: the shaders that are no includes."""
    root = shaders_root()
    names = (file.relative_to(root).with_suffix("").as_posix() for file in root.rglob("*.wgsl"))
    return sorted(name for name in names if not name.startswith("common/"))


def users(shader: str) -> list[str]:
    """Return the stages whose composed text holds the shader."""
    return [
        stage for stage in stages() if f"{shader}.wgsl" in {name for name, _ in load(stage).origins}
    ]


def tests_of(shader: str) -> list[Path]:
    """Return the test files that name the shader, its own first."""
    own = sorted(TESTS.rglob(f"test_{Path(shader).name}.py"))
    texts = {file: file.read_text() for file in sorted(TESTS.rglob("test_*.py"))}
    for stage in users(shader):
        own += sorted(TESTS.rglob(f"test_{Path(stage).name}.py"))
        own += [file for file, text in texts.items() if f'"{stage}"' in text]
    return list(dict.fromkeys(own))


class Watcher:
    """A pytest plugin: notes whether a failure was a shader that does not compile, and which."""

    def __init__(self) -> None:
        self.invalid = False
        self.failed = ""

    def pytest_exception_interact(self, node: pytest.Item, call: pytest.CallInfo) -> None:
        """Note the error of a failed test."""
        self.failed = node.nodeid
        error = call.excinfo.value
        self.invalid = isinstance(error, ShaderError) and "does not compile" in str(error)


def run_tests(tests: list[Path], shader: str) -> tuple[int, str]:
    """Run in a child: return the exit code and the test that failed."""
    gpu = default_device().gpu
    for stage in users(shader):
        try:
            gpu.create_shader_module(label=stage, code=load(stage).text)
        except (wgpu.GPUError, ShaderError):
            return INVALID, ""
    watcher = Watcher()
    quiet = io.StringIO()
    with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
        code = int(pytest.main([*OPTIONS, *map(str, tests)], plugins=[watcher]))
    if watcher.invalid:
        return INVALID, watcher.failed
    return (code, watcher.failed) if code in (SURVIVED, KILLED) else (BROKEN, quiet.getvalue())


class Child:
    """A forked run of the tests over one copy of the shaders."""

    def __init__(self, root: Path, tests: list[Path], shader: str) -> None:
        self.note = root.with_suffix(".note")
        self.note.unlink(missing_ok=True)
        self.started = time.monotonic()
        self.pid = os.fork()
        if self.pid == 0:
            os.environ["GPUSIM_SHADERS_DIR"] = str(root)
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            code = BROKEN
            try:
                code, note = run_tests(tests, shader)
                self.note.write_text(note)
            finally:
                os._exit(code)

    def verdict(self, timeout_s: float) -> str | None:
        """Return the verdict, or None while the tests run."""
        done, status = os.waitpid(self.pid, os.WNOHANG)
        if done == 0:
            if time.monotonic() - self.started < timeout_s:
                return None
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            return "timeout"
        if os.WIFSIGNALED(status):
            return "killed"  # the driver crashed: seen, if not gently
        return VERDICTS.get(os.WEXITSTATUS(status), "broken")

    def said(self) -> str:
        """Return what the child noted: the failed test, or what pytest printed."""
        return self.note.read_text() if self.note.exists() else ""


def import_tests(tests: set[Path]) -> None:
    """Import the tests and what they import.

    Raises
    ------
    SystemExit
        One cannot be imported, or makes a GPU device then: devices do not survive a fork.
    """
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = pytest.main([*OPTIONS, "--collect-only", *map(str, sorted(tests))])
    if code != pytest.ExitCode.OK:
        raise SystemExit(f"the tests cannot be collected\n{said.getvalue()}")
    if device._default is not None:
        raise SystemExit("a test makes a GPU device while it is imported")


def equivalents(found: list[Mutant], everything: bool) -> dict[Mutant, str]:
    """Return the mutants that the list declares equivalent, with the reasons.

    Raises
    ------
    SystemExit
        An entry without reason, or one that matches no mutant.
    """
    entries = tomllib.loads(EQUIVALENT.read_text()).get("equivalent", [])
    known: dict[Mutant, str] = {}
    for entry in entries:
        if not entry["reason"].strip():
            raise SystemExit(f"{EQUIVALENT}: an entry of {entry['shader']} has no reason")
        same = [
            one
            for one in found
            if (one.shader, one.before, one.after)
            == (entry["shader"], entry["before"], entry["after"])
        ]
        if not same and (everything or any(one.shader == entry["shader"] for one in found)):
            raise SystemExit(f"{EQUIVALENT}: no mutant matches {entry}")
        known |= {one: entry["reason"] for one in same}
    return known


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--shader", action="append", help="only this one, as folder/name or name")
    parser.add_argument("--limit", type=int, help="a random sample of this many mutants")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=1, help="children at a time")
    parser.add_argument("--list", action="store_true", help="list the mutants, run nothing")
    parser.add_argument(
        "--planted",
        nargs="?",
        const="",
        metavar="WORDS",
        help="instead, the defects of tools/planted.toml, those whose description has the words",
    )
    return parser.parse_args()


def chosen(names: list[str] | None) -> dict[str, str]:
    """Return the text of each shader asked for."""
    root = shaders_root()
    files = {
        file.relative_to(root).with_suffix("").as_posix(): file for file in root.rglob("*.wgsl")
    }
    unknown = [one for one in names or [] if not any(one in (f, Path(f).name) for f in files)]
    if unknown:
        raise SystemExit(f"no shader {', '.join(unknown)}; there are {', '.join(sorted(files))}")
    return {
        name: file.read_text()
        for name, file in sorted(files.items())
        if names is None or name in names or Path(name).name in names
    }


def main() -> int:
    """Run the mutants; return 1 when one survived."""
    options = arguments()
    if options.planted is not None:
        sys.path.insert(0, str(Path(__file__).parent))
        from planted import survivors

        return int(bool(survivors(options.planted)))
    console = Console()
    texts = chosen(options.shader)
    found = [one for name, text in texts.items() for one in mutants(name, text)]
    known = equivalents(found, everything=options.shader is None)
    todo = [one for one in found if one not in known]
    if options.limit is not None and options.limit < len(todo):
        todo = random.Random(options.seed).sample(todo, options.limit)
    if options.list:
        for one in todo:
            print(one)
        print(f"{len(todo)} mutants of {len(texts)} shaders, {len(known)} equivalent")
        return 0
    tests = {name: tests_of(name) for name in texts}
    for name, files in tests.items():
        if not files:
            raise SystemExit(f"no test names the shader {name}")
    import_tests({file for files in tests.values() for file in files})
    with tempfile.TemporaryDirectory(prefix="gpusim-mutate-") as scratch:
        # Mesa keeps compiled shaders on disk: a cache of our own is shared by the children,
        # and the mutants do not push anything out of the user's.
        os.environ["MESA_SHADER_CACHE_DIR"] = str(Path(scratch) / "cache")
        results = _run(todo, texts, tests, Path(scratch), options.jobs, console)
    _summary(console, results, known)
    return int(any(verdict == "survived" for _, verdict in results))


def _run(
    todo: list[Mutant],
    texts: dict[str, str],
    tests: dict[str, list[Path]],
    scratch: Path,
    jobs: int,
    console: Console,
) -> list[tuple[Mutant, str]]:
    roots = [scratch / f"shaders-{job}" for job in range(jobs)]
    for root in roots:
        shutil.copytree(shaders_root(), root)
    timeouts = {
        name: _sound(roots[0], tests[name], name, console)
        for name in dict.fromkeys(one.shader for one in todo)
    }
    free, running, results = list(roots), {}, []
    waiting = iter(todo)
    with Progress(console=console) as progress:
        bar = progress.add_task("mutants", total=len(todo))
        while len(results) < len(todo):
            while free and (one := next(waiting, None)) is not None:
                root = free.pop()
                text = texts[one.shader]
                mutated = text[: one.start] + one.new + text[one.end :]
                (root / f"{one.shader}.wgsl").write_text(mutated)
                running[root] = (one, Child(root, tests[one.shader], one.shader))
            for root, (one, child) in list(running.items()):
                verdict = child.verdict(timeouts[one.shader])
                if verdict is None:
                    continue
                if verdict == "broken":
                    raise SystemExit(f"the tests did not run for {one}\n{child.said()}")
                (root / f"{one.shader}.wgsl").write_text(texts[one.shader])
                del running[root]
                free.append(root)
                results.append((one, verdict))
                progress.advance(bar)
                if verdict == "survived":
                    progress.console.print(f"survived  {one}", markup=False, soft_wrap=True)
            time.sleep(0.01)
    return results


def _sound(root: Path, tests: list[Path], shader: str, console: Console) -> float:
    """Run the tests over the sound shader, twice so that caches are warm; return the timeout."""
    for _ in range(2):
        child = Child(root, tests, shader)
        while (verdict := child.verdict(600.0)) is None:
            time.sleep(0.01)
        if verdict != "survived":
            raise SystemExit(f"{shader}: its tests are {verdict} without a mutant: {child.said()}")
    took = time.monotonic() - child.started
    names = ", ".join(str(file.relative_to(PROJECT)) for file in tests)
    console.print(f"{shader}: {took:.1f} s for {names}", markup=False, soft_wrap=True)
    return max(TIMEOUT_LEAST_S, TIMEOUT_FACTOR * took)


def _summary(console: Console, results: list[tuple[Mutant, str]], known: dict[Mutant, str]) -> None:
    verdicts = ("killed", "timeout", "invalid", "survived")
    table = Table(Column("shader", no_wrap=True), "mutants", *verdicts, "equivalent")
    counts = Counter((one.shader, verdict) for one, verdict in results)
    declared = Counter(one.shader for one in known)
    shaders = sorted({one.shader for one, _ in results})
    for shader in shaders:
        row = [counts[shader, verdict] for verdict in verdicts]
        table.add_row(shader, *map(str, [sum(row), *row, declared[shader]]))
    row = [sum(counts[shader, verdict] for shader in shaders) for verdict in verdicts]
    table.add_section()
    table.add_row("all", *map(str, [sum(row), *row, sum(declared[one] for one in shaders)]))
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
