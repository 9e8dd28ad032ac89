"""Words that must not come back: private terms, metaphors, inverted phrases and British spelling in prose.

The prose of a file is its comments and docstrings, or the text of a page or template. Names in code and in backticks do not count.
Run this file to list all lines: ``python tests/python/test_words.py [FOLDER...]``.
"""

from __future__ import annotations

import ast
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

#: Patterns of words, each with the words to use instead.
WORDS = {
    r"mass[- ]cent(re|er)s?": "center of mass",
    r"in doubt|doubt(s|ed|ful)": "a state whose error estimate exceeds the tolerance",
    r"twice the digits": "double-double arithmetic",
    r"(lost?|loses?|losing|keeps?|kept) (its |their |all |no |any |few |too many )?digits": "loss of precision, full precision",
    r"(done|made|computed|written) anew|done once more": "recomputed, rewritten",
    r"whoever|nobody|somebody|who(ever)? looks": "name the subject",
    r"what (is|was|are|were) left out|(is|are|was|were) left out": "omitted, skipped, simplification",
    r"(is|are|was|were) told|tells? (of|that|which|what|whether|how|its|the)": "reported, documented",
    r"side by side": "vectorized, concatenated, compared",
    r"hangs? (on|from)|hung on": "is attached to",
    r"feels?|felt": "is affected by, the force on",
    r"friction as it is": "exact Coulomb friction",
    r"turns? (about|with its|round)": "rotates about, is expressed in its body frame",
    r"slides? along": "translates along",
    r"by (itself|themselves)": "alone, independently",
    r"promises? (nothing|that)|promised": "documents, is undefined",
    r"limp": "passive",
    r"the (watch|judge|probe)|judges|watched": "error estimate, test vector",
    r"(ns|us|ms|µs|bytes|operations) a (state|body|call|step|row)": "per state, per call",
    r"(samples|states|calls|steps|frames|pictures) a second": "per second",
    r"however (many|far|long|wide|deep|often)|whatever (it|the|they|a|was|is)": "independent of",
    r"of (its|their|one's) own (accuracy|making)|in its own words": "name the quantity",
    r"what it (is|was|does|takes|gives)|what they (are|were|do|give)": "name the quantity",
    r"goes (on|round|along|through)|comes? out|comes? (of|back)": "continues, results, returns",
    r"where there (is|are) (one|none|any|no|some)": "if there is one",
    r"(ours|theirs) (go|goes|come|comes)": "name the subject",
    r"(is|are) (that|those) of the \w+ (that|which)": "name the quantity",
    r"is one (process|number|row) instead of": "say what follows for the user",
    r"leaves a ball": "exceeds the threshold",
    r"(holds?|valid)( on average)? over robots": "say what the data determine",
    r"works without any feature": "list what the features add",
    r"(a|the) search first ignores": "say the reason first",
    r"those (that|which) (\w+ ){1,6}causes?": "name the quantity, subject first",
    r"modules above the": "list what the features add",
    r"says so": "raises, warns, reports",
}

#: Beginnings of comments and docstrings without a subject.
BEGINNINGS = re.compile(r"(What|Whoever|Whatever|As many|So many|Those (that|of(?! \[)|who|which)|How (many|much|far|long|often))\b")

#: British spellings.
BRITISH = (
    r"centres?|centred|centring|coloured|colours?|grey|neighbour(s|ing|hood)?|(milli|centi|kilo)?metres?|behaviours?|favour(s|ed|able)?"
    r"|labell(ed|ing)|modell(ed|ing)|travell(ed|ing)|cancell(ed|ing)|towards|analys(ed|ing)|catalogues?|artefacts?|whilst|learnt"
    r"|(normal|factor|optim|general|regular|vector|recogn|organ|initial|summar|minim|maxim|linear|serial|synchron|util|symmetr|parametr|quant"
    r"|stabil|standard|visual|character|random|discret|parallel|orthonormal|orthogonal|diagonal)is(e|es|ed|ing|ation|ations)"
)

PATTERN = re.compile(rf"\b({'|'.join([*WORDS, BRITISH])})\b", re.IGNORECASE)


def code_removed(text: str) -> str:
    """The text without code in backticks, targets of links and HTML tags."""
    return re.sub(r"``[^`]*``|`[^`]*`|\]\([^)]*\)|<[^>]*>", " ", text)


def of_page(text: str) -> Iterator[tuple[int, str]]:
    """Lines of a page in Markdown outside of code blocks."""
    is_code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code and not line.startswith("    "):
            yield number, line


def of_notebook(text: str) -> Iterator[tuple[int, str]]:
    """Lines of the cells with text; numbers count within the notebook's cells."""
    lines = (line for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown" for line in "".join(cell["source"]).splitlines())
    yield from enumerate(lines, 1)


def of_python(text: str) -> Iterator[tuple[int, str]]:
    """Comments, messages (strings of four or more words), and lines of docstrings without examples."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    nodes = list(ast.walk(ast.parse(text)))
    docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and (node in docstrings or node.value.count(" ") > 2):
            for number, line in enumerate(node.value.splitlines(), node.lineno):
                if not line.lstrip().startswith((">>>", "...")):
                    yield number, line


def of_rust(text: str) -> Iterator[tuple[int, str]]:
    """Comments, without code blocks of documentation."""
    is_code = False
    for number, line in enumerate(text.splitlines(), 1):
        comment = re.search(r"(?:^|\s)//[/!]?(\s.*|$)", line)
        if comment is None:
            continue
        if comment[1].strip().startswith("```"):
            is_code = not is_code
        elif not is_code:
            yield number, comment[1]


def of_template(text: str) -> Iterator[tuple[int, str]]:
    """Lines of a template of HTML without its expressions; tags are removed like code."""
    for number, line in enumerate(text.splitlines(), 1):
        yield number, re.sub(r"{{.*?}}|{%.*?%}", " ", line)


READERS = {".html": of_template, ".md": of_page, ".ipynb": of_notebook, ".py": of_python, ".pyi": of_python, ".rs": of_rust}
PLACES = ("README.md", "PACKAGE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "docs", "python/phipsi", "benches", "tests", "examples", ".ci", "src")


def files(place: str) -> list[Path]:
    """Files of a place that have prose; a source distribution lacks some places."""
    path = ROOT / place
    found = [path] if path.is_file() else sorted(path.rglob("*"))
    return [file for file in found if file.suffix in READERS and file != Path(__file__) and "__pycache__" not in file.parts]


def matches(file: Path) -> Iterator[tuple[int, str]]:
    """Lines of a file with a pattern."""
    end, before = 0, ""
    for number, line in READERS[file.suffix](file.read_text(encoding="utf-8")):
        text = code_removed(line).strip().lstrip("#:!/ ")
        begins = BEGINNINGS.match(text) if file.suffix in (".py", ".rs") else None
        # A phrase may continue in the next line.
        joined = f"{before} {text}" if number == end + 1 else text
        if begins or any(one.end() > len(joined) - len(text) for one in PATTERN.finditer(joined)):
            yield number, line.strip()
        end, before = number, text


#: Words of the theory, which the first sentence of a function does not need: it says what a user gets.
THEORY = re.compile(
    r"covariance of the (joint torques|co-states|measurements?)|(measurement|process) noise|whose innovations|white innovations|co-states?|\bH phi\b|\bphi\*|"
    r"by (a|the) filter( and| or|\b)|\bKalman gain|conditional means?|spatially random|Painlev",
    re.IGNORECASE,
)
#: Classes whose members are the matrices of the paper.
OF_THE_PAPER = ("Factor", "Operator")


def summaries() -> Iterator[tuple[str, str]]:
    """First paragraphs of the public functions, methods, properties and classes, by name."""
    for file in (ROOT / "python" / "phipsi").rglob("*.py*"):
        is_private = "estimation" in file.parts and file.name.startswith("_") and file.name != "__init__.py"
        if file.suffix not in (".py", ".pyi") or "examples" in file.parts or file.name == "operators.py" or is_private:
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        yield f"{file.name}", (ast.get_docstring(tree) or "").partition("\n\n")[0]
        for owner in [tree, *(node for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))]:
            for node in owner.body:
                if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                    name = node.name if owner is tree else f"{owner.name}.{node.name}"
                    yield f"{file.name}: {name}", (ast.get_docstring(node) or "").partition("\n\n")[0]


def test_first_sentences_need_no_theory() -> None:
    found = [f"{name}: {text}" for name, text in summaries() if THEORY.search(text) and not name.endswith(OF_THE_PAPER)]
    assert not found, "\n".join(found)
    assert THEORY.search("read-only: the variance of the measurement noise") and not THEORY.search("Covariance of the parameters, estimated")


def test_pages_of_tasks_begin_with_the_task() -> None:
    for page in sorted((ROOT / "docs" / "how-to").glob("*.md")):
        first = page.read_text(encoding="utf-8").partition("\n## ")[0]
        assert not THEORY.search(first), page.name


@pytest.mark.parametrize("place", PLACES)
def test_words_do_not_come_back(place: str) -> None:
    found = [f"{file.relative_to(ROOT)}:{number}: {line[:140]}" for file in files(place) for number, line in matches(file)]
    assert not found, "\n".join(found)


def test_phrases_across_lines_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("The torque is one\nprocess instead of `nv`.\n\nis one\n\nprocess instead of it\n", encoding="utf-8")
    assert list(matches(page)) == [(2, "process instead of `nv`.")]


def test_every_pattern_matches_its_own_words() -> None:
    samples = ("the mass centre", "a state in doubt", "is told of it", "turns about z", "ns a state", "behaviour", "normalised", "the watch")
    assert all(PATTERN.search(sample) for sample in samples)
    correct = ("center of mass", "the error estimate", "is reported", "rotates about z", "ns per state", "behavior", "normalized", "metrics, doubles")
    assert not any(PATTERN.search(sample) for sample in correct)
    quoted = (
        "weight and inertia of the load cause is one process instead of `nv`", "such a process first leaves a ball", "it holds over robots", "is that of the step that led to it",
        "along those that weight and inertia of the load cause", "The crate works without any feature", "are the modules above the dynamics", "a search first ignores the limits",
    )  # fmt: skip
    assert all(PATTERN.search(sample) for sample in quoted)
    assert code_removed("the argument `centre` of [a page](what-it-is.md)").split() == ["the", "argument", "of", "[a", "page"]


if __name__ == "__main__":
    for one in sys.argv[1:] or PLACES:
        for path in files(one):
            for at, shown in matches(path):
                print(f"{path.relative_to(ROOT)}:{at}: {shown[:160]}")
