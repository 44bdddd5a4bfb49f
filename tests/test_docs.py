"""The documentation: its blocks are run in order, what fails names page and line, and no public name is left out."""

import json
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.commands.schema import schema_of


ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs/hooks"))

import blocks  # noqa: E402
import file_keys  # noqa: E402
import generated  # noqa: E402
import links  # noqa: E402
import notebook  # noqa: E402
import versions  # noqa: E402


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Runs the text of a page."""
    monkeypatch.setattr(blocks, "KEPT", tmp_path / "kept")
    return lambda text: blocks.execute("page.md", text)


def test_blocks_share_names_and_files_and_show_what_they_print(page):
    text = (
        "# A\n\n```python\nfrom pathlib import Path\na = 6 * 7\n```\n\n"
        '```toml title="a.toml"\nb = 1\n```\n\n'
        '```python\nprint(a, Path("a.toml").read_text())\n```\n<!-- shows: 42 b = 1 -->\n\n'
        "```sh\nls -A\n```\n<!-- shows: a.toml -->\n"
    )
    done = page(text).text
    assert "\n42 b = 1\n" in done
    assert "shows" not in done
    assert page(text).text == done  # kept


def test_figures_are_described_and_placed(page):
    text = "```python\nimport matplotlib.pyplot as plt\nplt.figure()\n```\n<!-- figure: Nothing at all -->\n"
    done = page(text)
    assert done.figures == [("figures/page-1.svg", "Nothing at all")]
    assert "![Nothing at all](figures/page-1.svg)" in done.text
    assert "<svg" in done.files["figures/page-1.svg"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a\n\n```python\nb = 1\nb / 0\n```\n", r"docs/page\.md:5: .*ZeroDivisionError"),
        ("```python\nb = 1\n```\n\n```python\nprint(b\n```\n", r"docs/page\.md:6: .*SyntaxError"),
        ("a\n```sh\ntrue\nls nowhere\n```\n", r"docs/page\.md:4: .*status 2: .*nowhere"),
        ("a\n```sh\nmemsgyro check nowhere\n```\n", r"docs/page\.md:3: .*nowhere.*status 2"),
        ("```python\nprint(1)\n```\n<!-- shows: 2 -->\n", r"docs/page\.md:2: must print '2', but prints\n1"),
        ("```toml\na = 1\n```\n", r"docs/page\.md:1: .*title"),
        ("```console\nmemsgyro nothing\n```\n", r"docs/page\.md:2: .*README.*memsgyro nothing"),
        ("```python\n```\n<!-- figure: a -->\n", r"docs/page\.md:2: leaves 0 figures, but 1"),
    ],
)
def test_what_fails_names_page_and_line(page, text, why):
    with pytest.raises(blocks.BlockError, match=re.compile(why, re.DOTALL)):
        page(text)


def test_api_pages_show_the_public_names():
    shown = re.findall(r"^::: memsgyro_jax\.(\w+)$", "\n".join(generated.api_pages().values()), re.MULTILINE)
    assert len(shown) == len({*shown})
    assert {*shown, "__version__"} == {*mg.__all__}
    assert {name for name in dir(mg) if not name.startswith("__")} == {*shown}, "what an editor offers"
    helped = {*re.findall(r"\w+", pydoc.render_doc(mg, renderer=pydoc.plaintext))}
    assert {*shown} <= helped, "what `help(mg)` shows"
    nav = (ROOT / "mkdocs.yml").read_text()
    assert all(f" {path}\n" in nav for path in generated.api_pages())


def test_the_catalogue_holds_every_effect_and_every_public_member():
    page = generated.catalogue_page()
    assert all(f"`{kind.name}`" in page for kind in mg.effects.CATALOGUE)
    finals = ("ExtendedKalmanFilter", "LyapunovObserver", "EnergyControl", "LayoutGyro", "FreeDecayRecord", "Tdms")
    assert all(name in page for name in (*finals, "Chirp", "WorstDies", "ForceRebalance", "CarrierReadout"))
    assert not re.search(r"^\| [^|]*Abstract", page, re.MULTILINE)


@pytest.mark.parametrize("kind", ["study", "case"])
def test_the_pages_of_keys_hold_every_key_and_lead_to_every_part(kind):
    schema, page = schema_of(kind), file_keys.pages()[f"{kind}_keys.md"]
    for part in (schema, *schema["$defs"].values()):
        for key, entry in part.get("properties", {}).items():
            if key == "kind":
                assert f'`kind = "{entry["const"]}"' in page or f'{{ kind = "{entry["const"]}"' in page
            else:
                assert re.search(rf"^\| (\[?)`{key}`", page, re.MULTILINE), key
    places = re.findall(r"\{ #(\w+) \}$", page, re.MULTILINE)
    assert len(places) == len({*places})
    assert {*re.findall(r"\(#(\w+)\)", page)} <= {*places}
    assert f" {kind}_keys.md\n" in (ROOT / "mkdocs.yml").read_text()


def test_a_row_of_the_page_of_keys_tells_unit_default_and_meaning():
    page = file_keys.pages()["study_keys.md"]
    assert "| `kxx` | N/m | required | Stiffness along x. |" in page
    assert "| `settling` | 1/s | `1000 1/s` | How fast any other motion dies away" in page
    assert "| `x` | rad/s |  | Rate about the x axis. Kinds: [`constant`](#steady), " in page
    assert "| `after` | rad/s, V, 1, m/s^2, K | required | Value from then on. |" in page, "profiles of all units"
    assert page.count("### `adc = ") == 1


def test_every_row_and_study_stands_on_the_page_of_studies():
    page = generated.studies_page()
    assert re.findall(r"^\| ([TP]\d+) \|", page, re.MULTILINE) == [f"T{n}" for n in range(1, 25)] + [
        f"P{n}" for n in range(1, 7)
    ]
    assert all(f"| `{path.stem}` |" in page for path in (ROOT / "studies").glob("[!_]*.py"))


def test_every_class_of_the_api_shows_its_call():
    """Those of a module too; a method has its own."""
    heads = [
        f'<h{n} id="memsgyro_jax.{name}">-</h{n}>' for n, name in ((3, "geometry.PlateLayout"), (2, "LayoutReadout"))
    ]
    has = '<h2 id="memsgyro_jax.SingleMassGyro">-</h2>\n<div class="doc-signature">SingleMassGyro(</div>'
    page = generated.with_calls("".join([has, *heads, '<h3 id="memsgyro_jax.geometry.Beam.guided">-</h3>']))
    assert "PlateLayout(\n    side," in page
    assert "legs=4.0," in page
    assert "LayoutReadout(\n    drawn," in page
    assert page.count("doc-signature") == 3
    assert page.count("SingleMassGyro(") == 1  # which shows one already, and not another's


def test_the_picture_is_that_of_the_real_imports():
    imports = generated.room_imports()
    assert imports["app", "diagnosis"] > 0
    assert imports["diagnosis", "measurement"] > 0
    assert not any(list(generated.ROOMS).index(a) < list(generated.ROOMS).index(b) for a, b in imports)
    assert generated.rooms_picture().count("<path") == len(imports)


def test_a_page_becomes_a_notebook(page, tmp_path):
    text = (
        '# A\n\n```toml title="a.toml"\nb = 1\n```\n\nThen\n\n```sh\n# said\ncat a.toml\n```\n\n```python\n'
        "import matplotlib.pyplot as plt\nprint(2)\nplt.figure()\n```\n<!-- figure: Nothing -->\n\nEnd\n"
    )
    made = json.loads(json.dumps(notebook.notebook(page(text))))
    assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
    kinds = [cell["cell_type"] for cell in made["cells"]]
    assert kinds == ["markdown", "code", "markdown", "code", "code", "markdown"]
    file, shell, python = (cell for cell in made["cells"] if cell["cell_type"] == "code")
    assert file["source"] == "%%writefile a.toml\nb = 1"
    assert shell["source"] == "# said\n!cat a.toml"
    assert shell["outputs"] == [{"output_type": "stream", "name": "stdout", "text": "b = 1\n"}]
    printed, drawn = python["outputs"]
    assert printed["text"] == "2\n"
    assert "<svg" in drawn["data"]["image/svg+xml"]
    assert made["cells"][-1]["source"] == "End"
    assert len({cell["id"] for cell in made["cells"]}) == len(kinds)


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "index.html").write_text(
        '<link rel="canonical" href="https://a.org/"><a href="deep/a.html#there">a</a><a href="deep/a.html#gone">b</a>'
        '<a href="deep/b.html">c</a><a href="https://a.org">d</a><a href="#top">e</a><a href="http://a.org">f</a>'
    )
    (tmp_path / "deep/a.html").write_text('<h1 id="there">a</h1><img src="https://a.org/a.png"><a href="../">g</a>')
    assert [told.split(" leads")[0] for told in links.broken(tmp_path)] == [
        "deep/a.html: ../", "index.html: deep/a.html#gone", "index.html: deep/b.html", "index.html: #top",
        "index.html: http://a.org is neither a file of the site nor an https address",
    ]  # fmt: skip
    assert links.requests(tmp_path) == ["deep/a.html: https://a.org/a.png"]


def test_versions_stand_side_by_side(tmp_path, monkeypatch):
    project = tmp_path / "project"
    git = ("git", "-C", str(project), "-c", "user.name=a", "-c", "user.email=a@b.c")
    subprocess.run(["git", "init", "--quiet", str(project)], check=True)
    for version in ("v1", "v2"):
        (project / "said").write_text(version)
        subprocess.run([*git, "add", "said"], check=True)
        subprocess.run([*git, "commit", "--quiet", "-m", version], check=True)
        subprocess.run([*git, "tag", version], check=True)
    monkeypatch.setattr(versions, "ROOT", project)
    write = ("sh", "-c", 'mkdir -p "$0" && cp said "$0/index.html"')
    versions.build(tmp_path / "all", ["v1"], write)
    versions.build(tmp_path / "all", ["v2"], write)
    assert [(tmp_path / "all" / name / "index.html").read_text() for name in ("v1", "v2")] == ["v1", "v2"]
    front = (tmp_path / "all/index.html").read_text()
    assert re.findall(r'href="([^"]+)"', front) == ["v2/index.html", "v1/index.html"]
    assert not links.broken(tmp_path / "all")
