"""The mutation tool: which defects it plants, which equivalent ones it takes, and that it kills."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

PROJECT = Path(__file__).resolve().parents[1]


def tool(name: str) -> ModuleType:
    """Import a file of tools/, which is no module of the package."""
    spec = importlib.util.spec_from_file_location(name, PROJECT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def mutate():
    return tool("mutate")


PLANTED = tool("planted").LIST


def after(mutate, statement: str) -> set[str]:
    """Return what becomes of one statement."""
    return {one.after for one in mutate.mutants("t", f"fn f() {{\n{statement}\n}}\n")}


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("let a = b + c;", {"let a = b - c;"}),
        ("let a = b * -c;", {"let a = b / -c;", "let a = b * c;"}),
        ("return -x;", {"return x;"}),
        ("let a = b - 2u;", {"let a = b + 2u;", "let a = b - 3u;"}),
        ("let a = 0xFFu ^ b;", {"let a = 0x100u ^ b;", "let a = 0xFFu & b;"}),
        ("let a = 0xFFFFFFFFu;", {"let a = 0xfffffffeu;"}),
        ("let a = 2.0;", {"let a = 2.02;"}),
        ("let a = 0.0;", {"let a = 1.0;"}),
        ("let a = 1e2f;", {"let a = 101.0f;"}),
        ("let a = b << 3u;", {"let a = b >> 3u;", "let a = b << 4u;"}),
        ("let a = b < c && d;", {"let a = b <= c && d;", "let a = b < c || d;"}),
        ("let a = !b;", {"let a = b;"}),
        ("let a = min(b, abs(c));", {"let a = max(b, abs(c));", "let a = min(b, (c));"}),
        ("let a = b.x;", {"let a = b.y;"}),
        ("let a = b.zyx;", {"let a = b.yzx;"}),
        ("let a = b[i];", {"let a = b[(i) + 1];"}),
        ("let a = b[3];", {"let a = b[4];"}),
        ("let a: array<vec2<f32>, 3> = b; // + 1", set()),
        ("let a = bitcast<u32>(b);", set()),
        ("a += b;", {"a -= b;", ""}),
        ("workgroupBarrier();", {""}),
        ("if (a) { return; }", {"if (a) { }"}),
        ("let a = *p;", set()),
        ("let a = &p;", set()),
    ],
)
def test_a_statement_becomes(mutate, statement: str, expected: set[str]):
    assert after(mutate, statement) == expected


def test_loops_lose_no_part_of_their_head(mutate):
    found = after(mutate, "for (var k = 0u; k < n; k++) { s += a[k]; }")
    assert found == {
        "for (var k = 1u; k < n; k++) { s += a[k]; }",
        "for (var k = 0u; k <= n; k++) { s += a[k]; }",
        "for (var k = 0u; k < n; k--) { s += a[k]; }",
        "for (var k = 0u; k < n; k++) { s -= a[k]; }",
        "for (var k = 0u; k < n; k++) { s += a[(k) + 1]; }",
        "for (var k = 0u; k < n; k++) { }",
    }


def test_declarations_are_changed_only_in_their_values(mutate):
    text = """
        const N = 4u;  // 5 + 6
        override R: u32 = 2u * N;
        struct Params { a: array<vec4f, 3>, b: f32 }
        @group(0) @binding(1) var<storage, read> image: array<f32>;
        @compute @workgroup_size(16, 16) fn main() { /* x + y */ }
    """
    found = [(one.line, one.after) for one in mutate.mutants("t", text)]
    assert found == [
        (2, "const N = 5u; // 5 + 6"),
        (3, "override R: u32 = 3u * N;"),
        (3, "override R: u32 = 2u / N;"),
    ]


def test_a_statement_over_several_lines_is_dropped_whole(mutate):
    found = mutate.mutants("t", "fn f() {\n    a = vec2f(\n        b,\n        c);\n}\n")
    assert [(one.line, one.before, one.after) for one in found] == [(2, "a = vec2f( b, c);", "")]


def test_equivalents_need_a_reason_and_a_mutant(mutate, tmp_path: Path, monkeypatch):
    found = mutate.mutants("t", "fn f() {\n    let a = b + c;\n}\n")
    listed = tmp_path / "list.toml"
    monkeypatch.setattr(mutate, "EQUIVALENT", listed)
    entry = '[[equivalent]]\nshader = "t"\nbefore = "let a = b + c;"\nafter = "{}"\nreason = "{}"\n'
    listed.write_text(entry.format("let a = b - c;", "c is zero"))
    assert mutate.equivalents(found, everything=True) == {found[0]: "c is zero"}
    listed.write_text(entry.format("let a = b - c;", " "))
    with pytest.raises(SystemExit, match="no reason"):
        mutate.equivalents(found, everything=True)
    listed.write_text(entry.format("let a = b * c;", "c is zero"))
    with pytest.raises(SystemExit, match="no mutant matches"):
        mutate.equivalents(found, everything=True)


def test_the_projects_own_list_fits_the_shaders(mutate):
    texts = mutate.chosen(None)
    found = [one for name, text in texts.items() for one in mutate.mutants(name, text)]
    assert all(reason for reason in mutate.equivalents(found, everything=True).values())


@pytest.mark.parametrize("one", PLANTED, ids=lambda one: one.what)
def test_a_planted_defect_has_its_place_and_its_test(one):
    sound = (PROJECT / one.file).read_text(encoding="utf-8")
    assert sound.count(one.old) == 1 and one.old != one.new
    named = PROJECT / one.test
    files = sorted(named.glob("test_*.py")) if named.is_dir() else [named]
    tests = [
        name for file in files for name in re.findall(r"^def (test_\w+)", file.read_text(), re.M)
    ]
    assert any(one.words in name for name in tests)


def test_no_planted_defect_is_listed_twice():
    assert len({one.what for one in PLANTED}) == len(PLANTED)


def test_every_shader_is_named_by_a_test(mutate):
    assert {name for name in mutate.chosen(None) if not mutate.tests_of(name)} == set()


def test_a_mutant_of_the_adc_is_killed():
    tool = PROJECT / "tools" / "mutate.py"
    done = subprocess.run(
        [sys.executable, tool, "--shader", "adc", "--limit", "1", "--seed", "1"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert [cell.strip() for cell in done.stdout.strip().split("\n")[-2].split("│")[1:-1]][:3] == [
        "all",
        "1",
        "1",
    ]
