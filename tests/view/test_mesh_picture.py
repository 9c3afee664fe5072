"""Pictures of meshes: shaded, with colours of vertices, and with the texture of a .glb."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from jaxscan.cli.main import main
from jaxscan.files.glb import write_textured_glb
from jaxscan.files.mesh import write_trimesh
from jaxscan.images.shaded import TextureMap
from jaxscan.view.mesh_picture import brightened, vertex_normals
from jaxscan.view.view_data import PHOTOGRAPH, view_data

SQUARE = np.array([[0.0, 0.0, 300.0], [40.0, 0.0, 300.0], [40.0, 40.0, 300.0], [0.0, 40.0, 300.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 3, 2]])


def picture_of(folder: Path, *words: str) -> np.ndarray:
    assert main(["view", *words, "--png", str(folder / "seen.png")]) == 0
    return np.asarray(Image.open(folder / "seen.png").convert("RGB")).astype(int)


@pytest.fixture
def glb(tmp_path: Path) -> str:
    """Two triangles with a picture of 8 × 8 squares in red and blue."""
    v, u = np.mgrid[:64, :64]
    red = ((u // 8 + v // 8) % 2).astype(np.uint8) * 200
    picture = np.stack([red, np.zeros_like(red), 200 - red], axis=2)
    pixels = SQUARE[:, :2] / 40 * 63
    normals = np.tile([0.0, 0.0, -1.0], (4, 1))
    write_textured_glb(tmp_path / "square.glb", SQUARE, TRIANGLES, normals, pixels, picture)
    return str(tmp_path / "square.glb")


def test_the_texture_is_read_as_it_was_written(glb: str) -> None:
    shown = view_data(Path(glb))
    assert shown.texture is not None
    assert shown.colours is not None
    assert shown.looks == ("height", PHOTOGRAPH)
    assert shown.colour(None) == PHOTOGRAPH
    order = [int(np.abs(SQUARE - point).sum(axis=1).argmin()) for point in shown.points]
    np.testing.assert_allclose(shown.texture.pixels, SQUARE[order, :2] / 40 * 63, atol=1e-4)
    # Corners of the picture: (0, 0) and (63, 63) are blue, the others red too, for 8 is even.
    assert (shown.colours[:, 1] == 0).all()


def test_a_textured_glb_is_drawn_with_its_texture(glb: str, tmp_path: Path) -> None:
    seen = picture_of(tmp_path, glb)
    red, blue = seen[..., 0] - seen[..., 2] > 60, seen[..., 2] - seen[..., 0] > 60
    # Both panels are full of squares, half red and half blue: nothing but a texture has them on two triangles.
    half = seen.shape[1] // 2
    for panel in (np.s_[:, :half], np.s_[:, half:]):
        assert 0.4 < red[panel].sum() / blue[panel].sum() < 2.5
        assert (red | blue)[panel].mean() > 0.15
    row = red[:, :half][red[:, :half].any(axis=1)]
    assert np.median(np.diff(row.astype(int), axis=1).clip(min=0).sum(axis=1)) >= 3
    # By height there is no red.
    by_height = picture_of(tmp_path, glb, "--colour", "height")
    assert not ((by_height[..., 0] > 100) & (by_height[..., 1:] < 60).all(axis=2)).any()


def test_a_texture_that_is_broken_is_refused(glb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = Path(glb).read_bytes()
    start = content.rindex(b"IDAT") + 8
    broken = tmp_path / "broken.glb"
    broken.write_bytes(content[:start] + bytes(40) + content[start + 40 :])
    assert main(["view", str(broken), "--png", str(tmp_path / "seen.png")]) == 2
    assert "broken.glb: cannot be read as a mesh (broken data stream" in capsys.readouterr().err
    # An .obj names its picture.
    Image.new("RGB", (64, 64), (9, 99, 9)).save(tmp_path / "paint.png")
    whole = (tmp_path / "paint.png").read_bytes()
    (tmp_path / "paint.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "paint.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    (tmp_path / "broken.obj").write_text(
        "mtllib paint.mtl\nv 0 0 0\nv 9 0 0\nv 0 9 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl paint\nf 1/1 2/2 3/3\n"
    )
    assert main(["view", str(tmp_path / "broken.obj"), "--png", str(tmp_path / "seen.png")]) == 2
    assert "broken.obj: cannot be read as a mesh (image file is truncated)" in capsys.readouterr().err
    assert not (tmp_path / "seen.png").exists()
    (tmp_path / "paint.png").write_bytes(whole)
    seen = picture_of(tmp_path, str(tmp_path / "broken.obj"))
    assert ((seen[..., 1] > 100) & (seen[..., 0] < 60)).mean() > 0.05


def test_colours_of_vertices_are_drawn_and_nothing_is_left_open(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=10)
    paint = np.where(mesh.vertices[:, :1] > 0, [220, 20, 20], [20, 20, 220]).astype(np.uint8)
    write_trimesh(tmp_path / "ball.glb", mesh, paint)
    seen = picture_of(tmp_path, str(tmp_path / "ball.glb"))
    red, blue = seen[..., 0] - seen[..., 2] > 30, seen[..., 2] - seen[..., 0] > 30
    assert min(red.mean(), blue.mean()) > 0.05
    # A disc without holes, where points alone left the background between them.
    rows, columns = np.nonzero((red | blue)[:, : seen.shape[1] // 2])
    assert len(rows) > 0.97 * np.pi / 4 * np.ptp(rows) * np.ptp(columns)


def test_a_mesh_by_height_is_shaded(tmp_path: Path) -> None:
    trimesh.creation.box((20, 20, 20)).export(tmp_path / "box.stl")
    seen = picture_of(tmp_path, str(tmp_path / "box.stl"))
    # Three faces in three brightnesses.
    brightness = seen.max(axis=2)[(np.ptp(seen, axis=2) > 20)]
    assert np.percentile(brightness, 95) > 1.5 * np.percentile(brightness, 5)


def test_photographs_are_brightened_never_darkened() -> None:
    dim, bright = np.full((100, 3), 50.0), np.full((100, 3), 250.0)
    dim[:2] = 60.0
    np.testing.assert_allclose(brightened(dim).max(), 255.0)
    np.testing.assert_allclose(brightened(dim)[50] / 255, 50 / 60, rtol=1e-6)
    assert brightened(bright).min() >= 250.0
    texture = brightened(TextureMap(np.zeros((1, 2)), np.full((4, 4, 3), 51, np.uint8)))
    assert isinstance(texture, TextureMap)
    assert (texture.picture == 255).all()


def test_normals_of_a_ball_point_outwards() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=7)
    normals = vertex_normals(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    np.testing.assert_allclose(normals, np.asarray(mesh.vertices) / 7, atol=0.02)
    with_loose = vertex_normals(np.concatenate([mesh.vertices, [[0.0, 0, 0]]]), np.asarray(mesh.faces))
    assert (with_loose[-1] == 0).all()
