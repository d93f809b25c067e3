import pytest

from fracflow.errors import InputError
from fracflow.remarks import note
from fracflow.scene.scene import RENAMED, Scene, load
from fracflow.scene.schema import rows

pytestmark = pytest.mark.serial

NOTICE = "method.film: this key is now called method.flow_integrator; its old name is still read"


def test_old_key_is_read_and_the_new_one_written(make, tmp_path):
    old, new = make("method.film=bdf2"), make("method.flow_integrator=bdf2")
    assert old == new and old.method.flow_integrator == "bdf2"
    assert old.notes == (note(NOTICE),) and new.notes == ()
    path = tmp_path / "scene.toml"
    path.write_text(old.dump_toml())
    assert 'flow_integrator = "bdf2"' in path.read_text() and "film" not in path.read_text()
    path.write_text(path.read_text().replace("flow_integrator", "film"))
    again = load(path)
    assert again == old and again.notes == (note(NOTICE),)
    assert load(path, ["method.film=trapezoid"]).notes == (note(NOTICE),)
    for name in ("film", "flow_integrator"):  # a setting goes before the file, whatever names the two have
        assert load(path, [f"method.{name}=trapezoid"]).method.flow_integrator == "trapezoid"


def test_a_key_under_both_names_is_refused(make):
    both = {**make().model_dump(exclude_none=True)}
    both["method"]["film"] = "bdf2"
    with pytest.raises(InputError, match=r"method\.film: method\.flow_integrator is its new name and stands there too"):
        Scene.from_data(both)


def test_renamed_keys_are_keys_of_the_schema():
    keys = {row[0] for row in rows(Scene.json_schema())}
    for (table, old), new in RENAMED.items():
        assert f"{table}.{new}" in keys and f"{table}.{old}" not in keys
