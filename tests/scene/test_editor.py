"""The schema for editors takes every scene that runs, and refuses what a file alone shows to be wrong."""

from pathlib import Path

import pytest
import tomllib
from jsonschema import Draft7Validator
from pages import PAGES, SCENES, blocks

from fracflow.errors import InputError
from fracflow.scene.editor import editor_schema
from fracflow.scene.scene import RENAMED, Scene, load
from fracflow.scene.toml import override

pytestmark = pytest.mark.serial
SCHEMA = editor_schema(Scene.json_schema())
VALIDATOR = Draft7Validator(SCHEMA)

BAD = (
    "fracture.fault.normal_stifness=1e8", "zzz=1", "well.node2.flowrate=3", "support.0.gradient=3", "method=3", "rock=3",
    "rock.granite.youngs_modulus=true", "rock.granite.youngs_modulus='30'", "rock.granite.youngs_modulus=-1", "title=3",
    "rock.granite.poissons_ratio=0.5", "rock.granite.poissons_ratio=0.5 m", "rock.granite.rigid=1", "model=reprot", "stage=3",
    "method.quadrature=gauss", "accuracy.max_iterations=1.5", "accuracy.max_iterations=0", "petsc.ksp_type=[1]",
    "fracture.fault.law=coulomb", "fracture.fault.aperture={along=[0],values=[1]}", "well.node2.at={fracture='fault'}",
    "well.node2.at=[1]", "well.node2.at={fracture='fault',end='middle'}", "load.0.force=[1]", "load.0.traction=[1]",
    "support.0.on=[]", "support.0.components=['z']", "well.node2.flow_rate=[0,1]", "well.node2.flow_rate=[[0,1],[2]]",
    "well.node2.flow_rate={time=[0,1],values=[1,2]}", "support.0.displacement={z=1}", "probe.0.quantities=['sleep']",
    "stage.slow.kind=slow", "stage.slow.tolerance=1", "initial.velocity=[1]", "version=1",
)  # fmt: skip


def faults(data: object) -> list[str]:
    return [f"{'.'.join(map(str, each.absolute_path))}: {each.message[:200]}" for each in VALIDATOR.iter_errors(data)]


def test_it_is_a_schema_of_draft_7():
    assert SCHEMA["$schema"] == Draft7Validator.META_SCHEMA["$id"]
    Draft7Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", SCENES, ids=[path.parent.name for path in SCENES])
def test_scenes_pass_as_they_are_and_as_a_run_folder_has_them(path: Path):
    assert faults(tomllib.loads(path.read_text(encoding="utf-8"))) == []
    assert faults(tomllib.loads(load(path).dump_toml())) == []


def test_blocks_of_the_pages_pass():
    """Whole scenes and fragments, in which some required keys are left out."""
    texts = [
        block.text for page in PAGES for block in blocks(page) if block.language == "toml" and "file" not in block.words
    ]
    found = [fault for text in texts for fault in faults(tomllib.loads(text)) if "required" not in fault]
    assert len(texts) >= 3 and found == []


@pytest.mark.parametrize("setting", BAD)
def test_what_is_wrong_is_refused(setting, make):
    data = tomllib.loads(make.text)
    assert faults(data) == []
    override(data, setting)
    assert faults(data) != []
    with pytest.raises(InputError):
        make(setting)


def test_nothing_is_refused_that_a_scene_may_say(make):
    good = ["units=none", "title=a", "method.film=bdf2", "support.0.on=['west','east']"]
    good += ["well.node2.flow_rate={time=['0 h','1 h'],value=[0,'1 l/s'],interpolation='step'}"]
    good += ["fracture.fault.aperture={along=[0,'1 m'],value=['1 mm',1]}", "fracture.fault.cohesion='1e5 N/m²'"]
    good += ["fracture.fault.pressure=[[0,1],['1 h',2]]", "support.0.displacement={y=[[0,0],[1,'1 mm']]}"]
    for setting in good:
        data = tomllib.loads(make.text)
        override(data, setting)
        assert (setting, faults(data)) == (setting, [])


def test_keys_have_titles_meanings_units_defaults_and_old_names():
    rock = SCHEMA["definitions"]["Rock"]["properties"]["youngs_modulus"]
    number, text = rock["anyOf"]
    assert rock["title"] and "[force/length**2]" in rock["description"] and "SI: N/m^2" in number["description"]
    assert number["exclusiveMinimum"] == 0.0 and text["examples"] == ["30 GPa"]
    method = SCHEMA["definitions"]["Method"]["properties"]
    assert method["stepper"]["default"] == "newmark" and "explicit" in method["stepper"]["enum"]
    for (table, old), new in RENAMED.items():
        keys = SCHEMA["definitions"][table.title()]["properties"]
        assert keys[old]["deprecated"] and keys[old]["enum"] == keys[new]["enum"] and "deprecated" not in keys[new]
    untold = [
        f"{name}.{key}"
        for name, table in {"": SCHEMA, **SCHEMA["definitions"]}.items()
        for key, field in table["properties"].items()
        if not field.get("description")
    ]
    assert untold == []
    open_ones = [
        name for name, table in SCHEMA["definitions"].items() if table.get("additionalProperties") is not False
    ]
    assert open_ones == [] and SCHEMA["additionalProperties"] is False
