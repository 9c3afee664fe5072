"""A .glb with a texture or with colours of its vertices: valid glTF 2.0, and what another program reads of it."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.files.glb import write_coloured_glb, write_textured_glb
from jaxscan.files.mesh import colours_of, read_mesh
from jaxscan.files.srgb import light_of, srgb_of

VERTICES = np.array([[0, 0, 0], [4, 0, 0], [4, 3, 1], [0, 3, 1.5]], np.float64)
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
NORMALS = np.array([[0, 0, 2.0], [0, 0, 0], [0, -0.3, 1], [0, -0.3, 1]])
# Corners of a picture of 7 × 5, at the centres of its pixels.
PIXELS = np.array([[0, 4], [6, 4], [6, 0], [0, 0]], np.float64)
PICTURE = np.random.default_rng(0).integers(1, 255, (5, 7, 3), np.uint8)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_textured_glb(tmp_path / "a.glb", VERTICES, TRIANGLES, NORMALS, PIXELS, PICTURE)
    return tmp_path / "a.glb"


def chunks(data: bytes) -> tuple[dict, bytes]:
    magic, version, length = struct.unpack_from("<III", data)
    assert (magic, version, length) == (0x46546C67, 2, len(data))
    n, kind = struct.unpack_from("<II", data, 12)
    assert (kind, n % 4) == (0x4E4F534A, 0)
    content = json.loads(data[20 : 20 + n])
    m, kind = struct.unpack_from("<II", data, 20 + n)
    assert (kind, m % 4) == (0x004E4942, 0)
    assert 28 + n + m == len(data)
    return content, data[28 + n :]


def test_what_the_specification_asks_for(path: Path) -> None:
    content, binary = chunks(path.read_bytes())
    assert content["asset"]["version"] == "2.0"
    assert content["buffers"] == [{"byteLength": len(binary)}]
    size = {5126: 4, 5125: 4}
    parts = {"VEC3": 3, "VEC2": 2, "SCALAR": 1}
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        wanted = accessor["count"] * parts[accessor["type"]] * size[accessor["componentType"]]
        assert view["byteLength"] == wanted
        assert view["byteOffset"] + wanted <= len(binary)
    (primitive,) = content["meshes"][0]["primitives"]
    counts = {content["accessors"][i]["count"] for i in primitive["attributes"].values()}
    assert counts == {len(VERTICES)}
    at = content["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose([at["min"], at["max"]], [VERTICES.min(axis=0), VERTICES.max(axis=0)])
    view = content["bufferViews"][content["accessors"][primitive["attributes"]["NORMAL"]]["bufferView"]]
    normals = np.frombuffer(binary, "<f4", 12, view["byteOffset"]).reshape(4, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    material = content["materials"][0]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert set(material["extensions"]) == set(content["extensionsUsed"]) == {"KHR_materials_unlit"}
    view = content["bufferViews"][content["images"][0]["bufferView"]]
    assert binary[view["byteOffset"] :].startswith(b"\x89PNG")
    assert "target" not in view


def test_another_program_reads_the_same(path: Path) -> None:
    mesh = trimesh.load_mesh(path, process=False)
    np.testing.assert_allclose(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, TRIANGLES)
    picture = mesh.visual.material.baseColorTexture
    np.testing.assert_array_equal(np.asarray(picture.convert("RGB")), PICTURE)
    # The first row of the file's picture is the top one; trimesh's v goes up from the bottom.
    u, v = mesh.visual.uv.T
    np.testing.assert_allclose(np.stack([u * 7 - 0.5, (1 - v) * 5 - 0.5], axis=1), PIXELS, atol=1e-6)


def test_colours_of_vertices_are_amounts_of_light(tmp_path: Path) -> None:
    """Half grey on a screen is a fifth of the light: so the specification has it, and so programs show it."""
    colours = np.array([[255, 0, 128], [30, 220, 188], [128, 128, 128], [1, 2, 3]], np.uint8)
    write_coloured_glb(tmp_path / "a.glb", VERTICES, TRIANGLES, NORMALS, colours)
    content, binary = chunks((tmp_path / "a.glb").read_bytes())
    (primitive,) = content["meshes"][0]["primitives"]
    accessor = content["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["type"], accessor["componentType"], accessor["count"]) == ("VEC3", 5126, 4)
    start = content["bufferViews"][accessor["bufferView"]]["byteOffset"]
    light = np.frombuffer(binary, "<f4", 12, start).reshape(4, 3)
    np.testing.assert_allclose(light[2], 0.2158605, atol=1e-6)
    np.testing.assert_allclose(light[0], [1, 0, 0.2158605], atol=1e-6)
    np.testing.assert_array_equal(srgb_of(light), colours)
    assert "textures" not in content
    assert "baseColorTexture" not in content["materials"][0]["pbrMetallicRoughness"]
    back, _ = colours_of(read_mesh(tmp_path / "a.glb"))
    np.testing.assert_array_equal(back, colours)


def test_light_and_colours_are_there_and_back() -> None:
    grey = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    light = light_of(grey)
    np.testing.assert_array_equal(srgb_of(light), grey)
    assert (np.diff(light[:, 0]) > 0).all()
