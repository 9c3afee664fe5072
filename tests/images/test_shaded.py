"""A shaded surface: which triangle is in front, Lambert's law, backs, and colours from a texture."""

import numpy as np

from jaxscan.images.shaded import TextureMap, draw_surface

SIZE = (80, 60)
# A square from (10, 10) to (70, 50) px, anticlockwise as it is seen: rows run down.
CORNERS = np.array([[10.0, 10.0], [10.0, 50.0], [70.0, 50.0], [70.0, 10.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
TOWARD = np.array([0.0, 0.0, 1.0])
NORMALS = np.tile(TOWARD, (4, 1))
RED = np.tile([200.0, 0.0, 0.0], (4, 1))


def drawn(triangles=TRIANGLES, colours=RED, light=TOWARD, normals=NORMALS, **rest):
    return draw_surface(CORNERS, np.zeros(4), normals, triangles, colours, light, SIZE, **rest).astype(float)


def test_it_stands_where_its_corners_are() -> None:
    red = drawn(background=255)[..., 1] < 128
    v, u = np.nonzero(red)
    assert (u.min(), u.max(), v.min(), v.max()) == (10, 70, 10, 50)
    assert red[11:50, 11:70].all()


def test_brightness_follows_the_angle_to_the_lamp() -> None:
    levels = []
    for degrees in (0.0, 30.0, 60.0, 90.0, 120.0):
        angle = np.radians(degrees)
        levels.append(drawn(light=np.array([np.sin(angle), 0.0, np.cos(angle)]))[30, 40, 0])
    ambient = levels[-1]
    assert levels[3] == ambient > 0
    np.testing.assert_allclose(
        np.array(levels[1:3]) - ambient, (levels[0] - ambient) * np.array([3**0.5 / 2, 0.5]), atol=3
    )


def test_the_back_is_dark_whatever_the_lamp() -> None:
    front, back = drawn()[30, 40, 0], drawn(TRIANGLES[:, ::-1])[30, 40, 0]
    assert 0 < back < 0.3 * front


def test_what_is_nearer_is_in_front_in_any_order() -> None:
    corners = np.concatenate([CORNERS, CORNERS / 2 + [20.0, 15.0]])
    depth = np.repeat([5.0, 3.0], 4)
    colours = np.concatenate([RED, RED[:, ::-1]])
    triangles = np.concatenate([TRIANGLES, TRIANGLES + 4])
    for order in (np.arange(4), np.arange(4)[::-1], np.array([2, 0, 3, 1])):
        picture = draw_surface(corners, depth, np.tile(TOWARD, (8, 1)), triangles[order], colours, TOWARD, SIZE)
        assert picture[30, 40, 2] > 100 > picture[30, 40, 0]
        assert picture[12, 12, 0] > 100 > picture[12, 12, 2]


def test_colours_run_between_the_vertices() -> None:
    ramp = np.array([[0.0, 0, 0], [0, 0, 0], [180, 0, 0], [180, 0, 0]])
    light = np.array([1.0, 0.0, 0.0])
    row = drawn(colours=ramp, light=light)[30, 12:69, 0]
    np.testing.assert_allclose(row, np.linspace(row[0], row[-1], len(row)), atol=1.5)
    assert row[-1] > row[0] + 50


def test_a_texture_lies_on_it_as_the_vertices_say() -> None:
    """Two large triangles show a chequered picture, which no colours of vertices could."""
    v, u = np.mgrid[:41, :61]
    squares = ((u // 10 + v // 10) % 2 * 180).astype(np.uint8)
    picture = np.stack([squares, np.zeros_like(squares), 180 - squares], axis=2)
    texture = TextureMap(CORNERS - 10.0, picture)
    side = np.array([1.0, 0.0, 0.0])
    seen = drawn(colours=texture, light=side)[10:51, 10:71]
    ambient = seen[2:-2, 2:-2].max() / 180
    inner = ((u % 10 > 1) & (u % 10 < 8) & (v % 10 > 1) & (v % 10 < 8))[..., None]
    assert (np.abs(seen - ambient * picture) * inner).max() < 4
    # The same the other way round.
    turned = TextureMap((CORNERS - 10.0)[[2, 3, 0, 1]], picture)
    again = drawn(colours=turned, light=side)[10:51, 10:71][::-1, ::-1]
    assert (np.abs(again - ambient * picture) * inner).max() < 4


def test_a_triangle_edge_on_is_no_trouble() -> None:
    flat = np.array([[10.0, 10.0], [20.0, 10.0], [30.0, 10.0]])
    with np.errstate(all="raise"):
        picture = draw_surface(flat, np.zeros(3), NORMALS[:3], TRIANGLES[:1], RED[:3], TOWARD, SIZE, background=0)
    assert np.isfinite(picture).all()
    assert picture[10, 20, 0] > 0
