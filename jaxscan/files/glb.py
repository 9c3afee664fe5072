"""A mesh with colours as binary glTF (.glb): of a texture, or of its vertices.

The format is that of the Khronos Group's glTF 2.0 specification: a header, a JSON chunk that says what is where, and a
binary chunk with positions, normals, colours, indices and the picture as PNG. A picture is sRGB; colours of vertices
are amounts of light (there 3.9.2). The material is *unlit* (KHR_materials_unlit): a photograph has its light in it. A
viewer that does not know this extension shows it as a rough surface that is no metal.
"""

import json
import os
import struct
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from jaxscan.atomic import replacing
from jaxscan.files.srgb import light_of
from jaxscan.images.decode import encoded

_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_CLAMP, _LINEAR, _MIPMAPS = 33071, 9729, 9987
_UNLIT: Final = "KHR_materials_unlit"


def write_textured_glb(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    normals: Float[np.ndarray, "vertices 3"],
    pixels: Float[np.ndarray, "vertices 2"],
    picture: UInt8[np.ndarray, "rows columns 3"],
) -> None:
    """Write a mesh and its texture, whole or not at all.

    Args:
        path: the file.
        vertices: mm, as in every file of jaxscan.
        triangles: three vertices each.
        normals: of the vertices; any length.
        pixels: of each vertex (u, v) on the picture; (0, 0) is the centre of its top left pixel.
        picture: RGB, sRGB.

    Raises:
        InputError: the file cannot be written.
    """
    rows, columns = picture.shape[:2]
    places = np.ascontiguousarray((pixels + 0.5) / [columns, rows], "<f4")
    _write(path, vertices, triangles, normals, ("TEXCOORD_0", places), encoded(".png", picture))


def write_coloured_glb(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    normals: Float[np.ndarray, "vertices 3"],
    colours: UInt8[np.ndarray, "vertices 3"],
) -> None:
    """Write a mesh and the colours of its vertices (sRGB), whole or not at all; the rest is as with a texture.

    Raises:
        InputError: the file cannot be written.
    """
    _write(path, vertices, triangles, normals, ("COLOR_0", np.ascontiguousarray(light_of(colours), "<f4")), None)


def _write(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    normals: Float[np.ndarray, "vertices 3"],
    paint: tuple[str, Float32[np.ndarray, "vertices some"]],
    picture: bytes | None,
) -> None:
    """Write a mesh with one more attribute of its vertices, and the picture in which that gives places."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    positions, (attribute, values) = np.ascontiguousarray(vertices, "<f4"), paint
    arrays: list[tuple[np.ndarray, int]] = [
        (positions, _VERTICES),
        (np.ascontiguousarray(unit, "<f4"), _VERTICES),
        (values, _VERTICES),
        (np.ascontiguousarray(triangles.ravel(), "<u4"), _INDICES),
    ]
    blocks = [array.tobytes() for array, _ in arrays] + ([] if picture is None else [picture])
    starts = np.cumsum([0, *(_padded(len(block)) for block in blocks)]).tolist()
    views: list[dict[str, Any]] = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(block)}
        for start, block in zip(starts, blocks, strict=False)
    ]
    for view, (_, target) in zip(views, arrays, strict=False):
        view["target"] = target
    kinds = ("VEC3", "VEC3", f"VEC{values.shape[1]}", "SCALAR")
    accessors: list[dict[str, Any]] = [
        {"bufferView": i, "componentType": _UINT if target == _INDICES else _FLOAT, "count": len(array), "type": kind}
        for i, ((array, target), kind) in enumerate(zip(arrays, kinds, strict=True))
    ]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    surface = {"attributes": {"POSITION": 0, "NORMAL": 1, attribute: 2}, "indices": 3, "material": 0}
    looks: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    content = {
        "asset": {"version": "2.0", "generator": "jaxscan"},
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [surface]}],
        "materials": [{"pbrMetallicRoughness": looks, "doubleSided": True, "extensions": {_UNLIT: {}}}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": starts[-1]}],
    }
    if picture is not None:
        looks["baseColorTexture"] = {"index": 0}
        content |= {
            "textures": [{"sampler": 0, "source": 0}],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
            "images": [{"bufferView": len(arrays), "mimeType": "image/png"}],
        }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (_padded(len(text)) - len(text))
    binary = b"".join(block + bytes(_padded(len(block)) - len(block)) for block in blocks)
    whole = 12 + 8 + len(text) + 8 + len(binary)
    with replacing(path) as file:
        file.write(struct.pack("<3I", _MAGIC, _VERSION, whole))
        file.write(struct.pack("<2I", len(text), _JSON) + text)
        file.write(struct.pack("<2I", len(binary), _BIN) + binary)


def _padded(length: int) -> int:
    return -(-length // 4) * 4
