"""What the name of a layer says of it."""

import pytest
from pathfold.channels import words


@pytest.mark.parametrize(
    ("name", "guide"),
    [
        ("my_albedo", "albedo"),
        ("diffuse_albedo", "albedo"),
        ("shading.normal", "normal"),
        ("N", "normal"),
        ("Zdepth", "depth"),
        ("beauty_mse", "variance"),
        ("albedo_variance", None),  # that of a guide is none of the picture
        ("normal_variance", None),
        ("specular_albedo", None),  # nor is a guide of a part of the light
        ("reflection_albedo", None),
        ("lighting_normal", None),
        ("key_light_depth", None),
        ("beauty", None),
    ],
)
def test_a_guide_by_its_name(name: str, guide: str | None) -> None:
    assert words.guide(name) == guide
    assert words.data(name) == words.unlit(name) == (name != "beauty")


@pytest.mark.parametrize("name", ["light_id", "lightIds", "lightMask", "shadow_matte", "worldPos", "P", "heatmap"])
def test_ids_masks_and_places_are_data_whatever_else_the_name_says(name: str) -> None:
    assert words.unlit(name)


@pytest.mark.parametrize("name", ["pointLight1", "light_rim", "object_light", "specular_direct", "C_key"])
def test_parts_of_the_light_are_light(name: str) -> None:
    assert not words.unlit(name)
