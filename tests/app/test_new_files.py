"""Schemas, templates and comparisons of the command line: against what the package itself reads and writes."""

import json
import re
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest
from json_schema import fits

import memsgyro_jax as mg
from memsgyro_jax.app import cli
from memsgyro_jax.app.commands.schema import schema_of


pytestmark = pytest.mark.smoke

README = (Path(__file__).parents[2] / "README.md").read_text()
STUDIES = [text for text in re.findall(r"```toml\n(.*?)```", README, re.DOTALL) if "memsgyro-case/1" not in text]


@pytest.fixture(scope="module")
def schemas():
    return {kind: schema_of(kind) for kind in ("study", "case", "diagnosis")}


def test_every_study_of_ours_fits_the_schema(schemas):
    texts = [*STUDIES, mg.default_study().to_toml()]
    assert len(texts) > 2
    for text in texts:
        assert fits(tomllib.loads(text), schemas["study"], schemas["study"]), text


@pytest.mark.parametrize(
    "wrong",
    [
        '[sweep]\ndies = "many"',
        "[device]\nkind = 'triple'",
        "[sweep]\ndice = 3",
        "[device]\nkind = 'single_mass'\nmass = true",
    ],
)
def test_a_wrong_study_does_not(schemas, wrong):
    assert not fits(tomllib.loads(wrong), schemas["study"], schemas["study"])


def test_cases_fit_theirs(schemas):
    text = (files("memsgyro_jax") / "demo" / "case.toml").read_text()
    assert fits(tomllib.loads(text), schemas["case"], schemas["case"])
    assert not fits(tomllib.loads(text.replace("ring_down", "ring_up")), schemas["case"], schemas["case"])


@pytest.fixture
def memsgyro(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def run(*tokens):
        with pytest.raises(SystemExit) as end:
            cli.main(list(tokens))
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


def test_templates_run_as_they_are(memsgyro, schemas, tmp_path):
    for kind in ("study", "case", "effect"):
        status, out, said = memsgyro("new", kind)
        assert (status, said) == (0, ""), said
        assert "memsgyro" in out
    study = mg.load_study("study.toml")
    assert study.settings.dies == 64
    for path, kind in ((tmp_path / "study.toml", "study"), (tmp_path / "case" / "case.toml", "case")):
        assert path.read_text().startswith(f"#:schema {kind}.schema.json\n")
        assert json.loads((path.parent / f"{kind}.schema.json").read_text()) == json.loads(json.dumps(schemas[kind]))
        assert fits(tomllib.loads(path.read_text()), schemas[kind], schemas[kind])
    for purpose in ("datasheet", "tune", "layout"):
        assert (
            f"memsgyro {purpose.replace('layout', 'sweep')} {purpose}.toml"
            in memsgyro("new", "study", f"{purpose}.toml", "--for", purpose)[1]
        )
        assert fits(tomllib.loads((tmp_path / f"{purpose}.toml").read_text()), schemas["study"], schemas["study"])
        assert mg.load_study(f"{purpose}.toml").settings.dies == 32
    assert memsgyro("new", "case", "other", "--for", "tune")[0] == 2
    assert len(mg.load_case("case").records) == 3
    assert "low" in str(mg.assess(mg.load_case("case")))
    assert "soft_stop" in memsgyro("effects", "my_effect.py")[1]
    assert memsgyro("new", "study")[::2] == (2, "study.toml exists already; choose another name, or remove it.\n")


def test_where_a_new_file_goes_is_told_as_to_every_command(memsgyro, tmp_path):
    assert memsgyro("new", "case", "--out", "bench")[0] == 0
    assert (tmp_path / "bench" / "case.toml").is_file()
    assert memsgyro("new", "study", "--out", "mine.toml")[0] == 0
    assert (tmp_path / "mine.toml").is_file()
    refused = "Option `--out` must not be given beside a path, but is `b` beside `a`.\n"
    assert memsgyro("new", "case", "a", "--out", "b")[::2] == (2, refused)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(("option", "text"), [("--drive", "-10 mV"), ("--drive", "-.5V"), ("--reference", "-3 kHz")])
def test_a_level_below_zero_is_refused_and_no_unknown_option(memsgyro, tmp_path, option, text):
    assert memsgyro("new", "case")[0] == 0
    status, _, said = memsgyro("import", "case/low.csv", "--out", "imported", option, text)
    assert status == 2
    assert said.splitlines()[-1].startswith(f"Option `{option}` must be a positive number with its unit, like ")
    assert said.endswith(f'but is "{text}".\n')


def test_every_error_has_its_line_and_remedy(memsgyro, tmp_path):
    (tmp_path / "wrong.toml").write_text("[device]\nkind = 'single_mass'\nmass = '1e-7 kg'\n[sweep]\ndice = 3\n")
    status, _, said = memsgyro("sweep", "wrong.toml")
    assert status == 2
    lines = said.splitlines()
    assert len(lines) == 7
    assert lines[0].startswith("wrong.toml: line 1, `device.kxx`: is missing: give it in N/m, or frequency = [x, y]")
    assert lines[-1] == "wrong.toml: line 5, `sweep.dice`: is not known (did you mean `dies`?)."


def test_diff_tells_what_sets_two_apart(memsgyro, tmp_path):
    (tmp_path / "a.toml").write_text("[sweep]\ndies = 8\n")
    (tmp_path / "b.toml").write_text("[sweep]\ndies = 16\n")
    assert re.search(r"sweep\.dies +8 +16", memsgyro("diff", "a.toml", "b.toml")[1])
    assert "no difference" in memsgyro("diff", "a.toml", "a.toml")[1]
    (tmp_path / "a.toml").write_text('[loop]\ndisplacement = "1.23456789123 um"\n')
    (tmp_path / "b.toml").write_text('[loop]\ndisplacement = "1.23456781111 um"\n')
    assert re.search(r"1\.23456789123e-06 m +1\.23456781111e-06 m", memsgyro("diff", "a.toml", "b.toml")[1])
    (tmp_path / "b.toml").write_text('[loop]\ndisplacement = "0.87654321 um"\n')
    assert re.search(r"1\.235e-06 m +8\.765e-07 m", memsgyro("diff", "a.toml", "b.toml")[1])
    leak = '[[effects]]\nname = "electrical_feedthrough"\naxis = "x_to_y"\nstrength = "5e2 V/N"\n'
    spring = '[[effects]]\nname = "cubic_stiffness"\naxis = "x"\nstrength = "1e12 N/m^3"\n'
    (tmp_path / "a.toml").write_text(spring)
    (tmp_path / "b.toml").write_text(leak + spring.replace("1e12", "2e12"))
    out = memsgyro("diff", "a.toml", "b.toml")[1]
    assert re.search(r"effects\.cubic_stiffness x\.strength +1e\+?12 \S+ +2e\+?12 ", out)
    assert re.search(r"effects\.electrical_feedthrough x_to_y\.strength +– +5e2 V/N", out)
    many = lambda dies, letter: {"diverged": {"dies": dies}, "why": 99 * letter}  # noqa: E731
    run = {"dies": 8, "yield": {"value": 0.9, "low": 0.8, "high": 0.95}, "bias_dps": {"value": 1.0, "std": 0.1}}
    run["offset"] = {"value": 1e-5, "std": 0.01}
    (tmp_path / "a.json").write_text(json.dumps(run | many([0, 3], "x") | {"study": {"observer": {"kind": "ekf"}}}))
    other = {"dies": 8, "yield": {"value": 0.91, "low": 0.8, "high": 0.96}, "bias_dps": {"value": 2.0, "std": 0.1}}
    other["offset"] = {"value": 3e-3, "std": 0.01}
    (tmp_path / "b.json").write_text(json.dumps(other | many([1], "y") | {"study": {"sweep": {"dies": 9}}}))
    out = memsgyro("diff", "a.json", "b.json")[1]
    assert out.startswith("A is a.json (observer ekf)\nB is b.json\n")
    assert re.search(r"yield +0.9 \(0.8 to 0.95\) +0.91 \(0.8 to 0.96\) +\+1.11 %, within the intervals", out)
    assert re.search(r"bias_dps +1 \(0.804 to 1.196\) +2 \(1.804 to 2.196\) +\+100 %, intervals apart", out)
    assert re.search(r"offset .* within the intervals", out)
    assert not re.search(r"offset .* %", out), "a share of what may be zero"
    assert re.search(r"diverged.dies +2 +1 ", out)
    assert max(map(len, out.splitlines())) < 180
    assert "\ndies " not in out.split("figure")[1]
    assert memsgyro("diff", "a.json", "nowhere.json")[::2] == (2, "nowhere.json: No such file or directory.\n")
    assert "must hold a summary.json" in memsgyro("diff", ".", "a.json")[2]


def test_verbose_says_what_is_done_and_changes_nothing_else(fresh_python, tmp_path):
    (tmp_path / "broken.toml").write_text("[device\n")
    quiet, loud = (
        fresh_python("-m", "memsgyro_jax.app.cli", *more, "sweep", "broken.toml") for more in ((), ("--verbose",))
    )
    assert quiet.returncode == loud.returncode == 2
    assert quiet.stderr in loud.stderr
    assert "reads broken.toml" in loud.stderr


@pytest.mark.parametrize(
    "tokens", [["sweep", "none.toml"], ["sweep", "--resume", "--overwrite"], ["simulate", "--die", "-1"]]
)
def test_what_needs_no_jax_is_checked_before_it(fresh_python, tokens):
    code = f"""
import sys
from memsgyro_jax import cli
try:
    cli.main({tokens})
except SystemExit as end:
    print(end.code, "jax" in sys.modules)
"""
    assert fresh_python("-c", code).stdout == "2 False\n"
