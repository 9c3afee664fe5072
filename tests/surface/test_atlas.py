"""The atlas of a mesh: each triangle on the picture, none over another, none beyond the border."""

import numpy as np
import pytest
import trimesh

from jaxscan.surface.atlas import GUTTER, make_atlas, texels_of


def spiral() -> trimesh.Trimesh:
    """A spiral staircase without steps: seen from above, three turns cover each other."""
    turn, r = np.linspace(0, 6 * np.pi, 300)[:, None], np.linspace(3, 20, 20)[None]
    parts = (r * np.cos(turn), r * np.sin(turn), 0.3 * turn + 0 * r)
    i = np.arange(299)[:, None] * 20 + np.arange(19)
    faces = np.concatenate([np.stack([i, i + 20, i + 21], -1), np.stack([i, i + 21, i + 1], -1)]).reshape(-1, 3)
    return trimesh.Trimesh(np.stack(parts, axis=-1).reshape(-1, 3), faces, process=False)


def noisy(sigma: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(4, 10)
    mesh.vertices += sigma * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    return mesh


def two_pieces() -> trimesh.Trimesh:
    """A cube, and a triangle far from it that is smaller than a texel."""
    lonely = trimesh.Trimesh([[50, 0, 0], [50.001, 0, 0], [50, 0.001, 0.0]], [[0, 1, 2]], process=False)
    return trimesh.util.concatenate([trimesh.creation.box([4, 5, 6]), lonely])


MESHES = {
    "ball": lambda: trimesh.creation.icosphere(4, 10),
    "noisy": lambda: noisy(0.1),
    "ring": lambda: trimesh.creation.torus(20, 5, 64, 32),
    "spiral": spiral,
    "two": two_pieces,
    "one": lambda: trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]], process=False),
}


@pytest.mark.parametrize("name", MESHES)
def test_every_triangle_has_its_own_place(name: str) -> None:
    mesh = MESHES[name]()
    atlas = make_atlas(mesh, 0.1, 4096)
    assert atlas is not None
    np.testing.assert_array_equal(atlas.place[atlas.triangles], mesh.faces)
    columns, rows = atlas.size
    assert atlas.texel_mm == 0.1
    assert (atlas.pixels >= GUTTER - 1e-6).all()
    assert (atlas.pixels <= np.array([columns, rows]) - 1 - GUTTER + 1e-6).all()

    # Random points well within triangles: no two of two triangles are in one place.
    corners = atlas.pixels[atlas.triangles]
    random = np.random.default_rng(0)
    some = random.integers(len(corners), size=2000)
    inner = (corners[some] * random.dirichlet(np.full(3, 2.0), len(some))[..., None]).sum(axis=1)
    found = np.zeros(len(inner), int)
    edge = np.roll(corners, -1, axis=1) - corners
    turn = np.sign(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    assert (turn[mesh.area_faces > 1e-9] == turn[0]).all()
    for some in np.array_split(np.arange(len(inner)), 40):
        to = inner[some, None, None] - corners[None]
        side = (edge[None, ..., 0] * to[..., 1] - edge[None, ..., 1] * to[..., 0]) * turn[0]
        length = np.maximum(np.linalg.norm(edge, axis=2), 1e-12)
        # Deeper than a texel within: a fold that no texel's centre sees may overlap by less.
        found[some] = (side / length > 0.8).all(axis=2).sum(axis=1)
    assert found.max() <= 1

    # Lengths on it are those on the mesh, or at most four times shorter.
    long = np.linalg.norm(np.roll(mesh.triangles, -1, axis=1) - mesh.triangles, axis=2)
    ratio = np.linalg.norm(edge, axis=2) * atlas.texel_mm / np.maximum(long, 1e-12)
    assert ratio.max() < 1 + 1e-6
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]) * atlas.texel_mm**2
    assert (area >= 0.29 * mesh.area_faces).all()


@pytest.mark.parametrize("name", MESHES)
def test_texels_lie_where_they_say(name: str) -> None:
    mesh = MESHES[name]()
    atlas = make_atlas(mesh, 0.1, 4096)
    assert atlas is not None
    texels = texels_of(atlas)
    assert len(np.unique(texels.at, axis=0)) == len(texels.at)
    at = (atlas.pixels[atlas.triangles[texels.triangle]] * texels.weights[..., None]).sum(axis=1)
    # Those that show a corner between centres are up to half a texel away.
    off = np.abs(at - texels.at).max(axis=1)
    assert off.max() <= 0.5 + 1e-9
    assert (off < 1e-6).mean() > 0.6 or len(off) < 100
    # There is one for each chart, and near each corner.
    taken = np.zeros(atlas.size[::-1], bool)
    taken[texels.at[:, 1], texels.at[:, 0]] = True
    corner = np.rint(atlas.pixels).astype(int)
    assert taken[corner[:, 1], corner[:, 0]].all()


def test_few_charts_in_spite_of_noise() -> None:
    for sigma, most in ((0.0, 6), (0.1, 60)):
        atlas = make_atlas(noisy(sigma), 0.1, 4096)
        assert atlas is not None
        assert atlas.charts <= most


def test_a_surface_that_is_too_rough_has_none() -> None:
    """Triangles that lie apart are a chart each, and their gutters fill the picture."""
    corners = np.random.default_rng(0).normal(size=(3000, 3, 3)) + 50 * np.random.default_rng(1).normal(
        size=(3000, 1, 3)
    )
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3), process=False)
    assert make_atlas(mesh, 0.5, 512) is None
    atlas = make_atlas(mesh, 0.5, 1024)
    assert atlas is not None
    assert atlas.charts == 3000
    assert max(atlas.size) <= 1024


def test_a_picture_that_is_too_large_has_larger_texels() -> None:
    mesh = trimesh.creation.icosphere(4, 10)
    atlas = make_atlas(mesh, 0.001, 256)
    assert atlas is not None
    assert max(atlas.size) <= 256
    assert 0.1 < atlas.texel_mm < 0.5
