"""A phase of +90° at resonance: a displacement with an inverted sign, or an acceleration."""

import numpy as np
import pytest

import memsgyro_jax as mg


def wrote(folder, half_band, *, acceleration, direct=0.0, noise=1e-5):
    """A sweep over a resonance of 250 Hz and a quality factor of 290, of 1 V at its peak."""
    rng, f = np.random.default_rng(2), np.linspace(1 - half_band, 1 + half_band, 121)
    z = -(f**2 if acceleration else 1.0) / 290.0 / (1.0 - f**2 + 1j * f / 290.0) + direct
    z = z + noise * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size))
    lines = [f"{250 * w:.9g},{v.real:.9g},{v.imag:.9g}" for w, v in zip(f, z, strict=True)]
    (folder / "s_1V.csv").write_text("\n".join(["f [Hz],X [V],Y [V]", *lines]) + "\n")
    return mg.import_case([folder / "s_1V.csv"], folder / "case", overwrite=True)


def test_where_the_rows_do_not_tell_both_are_said(tmp_path):
    found = wrote(tmp_path, 0.002, acceleration=True, noise=1e-2)
    assert "shows displacement with an inverted sign, or acceleration: at resonance its phase is about 90°" in str(
        found
    )
    assert found.case.readout.order == 0
    (said,) = [one for one in mg.assess(found.case).warnings if "inverted sign" in one]
    assert '`quantity = "acceleration"` in `[readout]`, or `inverted = true`' in said
    for old, new in (("displacement", "acceleration"), ("settled = true", "settled = true\ninverted = true")):
        toml = (found.case.folder / "case.toml").read_text()
        (tmp_path / "other").mkdir(exist_ok=True)
        (tmp_path / "other" / "s_1V.csv").write_text((found.case.folder / "s_1V.csv").read_text())
        (tmp_path / "other" / "case.toml").write_text(
            toml.replace(f'"{old}"' if new == "acceleration" else old, f'"{new}"' if new == "acceleration" else new)
        )
        assert not any("inverted" in one for one in mg.assess(mg.load_case(tmp_path / "other")).warnings)


@pytest.mark.parametrize("acceleration", [True, False])
def test_rows_far_from_resonance_tell(acceleration, tmp_path):
    found = wrote(tmp_path, 0.1, acceleration=acceleration)
    shown = "acceleration" if acceleration else "displacement with an inverted sign"
    assert f"the read-out shows {shown}: its rows lie far nearer" in str(found)
    assert found.case.readout.order == (2 if acceleration else 0)
    assert not any("inverted" in one for one in mg.assess(found.case).warnings)


def test_beside_a_feedthrough_rows_do_not_tell(tmp_path):
    """-ω² X is -K X and a constant: an acceleration beside one is an inverted displacement."""
    found = wrote(tmp_path, 0.1, acceleration=True, direct=0.02)
    assert "inverted sign, or acceleration" in str(found)
    assert found.case.readout.order == 0


def test_check_says_what_rows_tell_of_a_case_that_says_another(tmp_path):
    found = wrote(tmp_path, 0.1, acceleration=True)
    toml = found.case.folder / "case.toml"
    toml.write_text(toml.read_text().replace('quantity = "acceleration"', 'quantity = "displacement"'))
    (said,) = [one for one in mg.assess(mg.load_case(found.case.folder)).warnings if "far nearer" in one]
    assert said.startswith("experiment `s_1V` reads acceleration, as its rows lie far nearer")
