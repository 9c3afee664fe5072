"""Profiles of other devices: what is read of each kind of file, and what is said of those that are wrong."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.listing import gap_in_numbers
from jaxscan.files.profiles import read_profiles
from jaxscan.images import write_image
from jaxscan.reconstruction.profiles import range_image_of_profiles

MOTION = '[[motion]]\naxis = "stage"\nkind = "linear"\nper_step = [0.0, 0.5, 0.0]\n'
N, M = 12, 30
X = -7.25 + 0.5 * np.arange(M)
Z = 200 + 0.25 * np.arange(N)[:, None] - 0.0625 * X**2
HOLE = np.zeros((N, M), bool)
HOLE[3, 4] = HOLE[7] = True


def listed(folder: Path, words: str, motion: str = MOTION) -> Path:
    (folder / "profiles.toml").write_text(f"[profiles]\n{words}\n\n{motion}")
    return folder


def lines(profile: int, z: str = "nan", sep: str = ",") -> list[str]:
    """The points of a profile, those in the hole as the device writes them."""
    return [
        sep.join((str(profile), f"{float(X[i])!r}", z if HOLE[profile, i] else f"{float(Z[profile, i])!r}", f"{i}.5"))
        for i in range(M)
    ]


def check(folder: Path, tolerance: float = 0.0, intensity: bool = False) -> None:
    found = read_profiles(folder)
    np.testing.assert_array_equal(np.isfinite(found.z), ~HOLE)
    np.testing.assert_allclose(found.z[~HOLE], Z[~HOLE], atol=tolerance + 1e-9)
    np.testing.assert_allclose(found.x[~HOLE], np.broadcast_to(X, Z.shape)[~HOLE], atol=tolerance + 1e-9)
    assert found.positions == {"stage": tuple(range(N))}
    if intensity:
        np.testing.assert_allclose(found.intensity[0], np.arange(M) + 0.5)
    # The object has moved by 0.5 mm along y from one profile to the next: what is seen in the nth was n steps before.
    image = range_image_of_profiles(found)
    np.testing.assert_array_equal(image.valid, ~HOLE)
    y = np.broadcast_to(-0.5 * np.arange(N)[:, None], Z.shape)
    expected = np.stack([np.broadcast_to(X, Z.shape), y, Z], axis=-1)
    np.testing.assert_allclose(image.points[~HOLE], expected[~HOLE], atol=tolerance + 1e-5)


@pytest.mark.parametrize("sep", [",", ";", "\t"])
@pytest.mark.parametrize("none", ["nan", "", "-9999"])
def test_one_csv_with_all_profiles(tmp_path: Path, sep: str, none: str) -> None:
    header = sep.join(("Profile", "X", "Z", "Intensity"))
    text = "\n".join(["# by a profiler", header, *(line for n in range(N) for line in lines(n, none, sep)), ""])
    (tmp_path / "all.csv").write_text(text)
    invalid = "invalid = -9999" if none == "-9999" else ""
    check(listed(tmp_path, f'files = "all.csv"\nunits = "mm"\nsteps_per_frame = 1\n{invalid}'), intensity=True)


def test_a_csv_for_each_profile_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for n in range(N):
        (tmp_path / f"p{n}.csv").write_text("\n".join(["N,Along,Range,I", *lines(n)]))
    named = '[profiles.columns]\nx = "Along"'
    check(listed(tmp_path, f'files = "p*.csv"\nunits = "mm"\nsteps_per_frame = 1\n{named}'), intensity=True)


def test_a_csv_without_a_header_has_a_line_for_each_profile(tmp_path: Path) -> None:
    rows = [";".join("" if HOLE[n, i] else repr(float(Z[n, i])) for i in range(M)) + ";" for n in range(N)]
    (tmp_path / "z.csv").write_text("\n".join(rows))
    a = "[profiles.a]\nscale = 0.5\noffset = -7.25"
    check(listed(tmp_path, f'files = "z.csv"\nunits = "mm"\nsteps_per_frame = 1\n{a}'))


STEP, FIRST = 0.001, 150.0
COUNTS = np.where(HOLE, 0, np.round((Z - FIRST) / STEP)).astype(np.uint16)
A = "[profiles.a]\nscale = 0.5\noffset = -7.25\n"
C = f"[profiles.c]\nscale = {STEP}\noffset = {FIRST}\n"
COMMON = 'units = "mm"\nsteps_per_frame = 1\n'


@pytest.mark.parametrize("ending", [".png", ".tif", ".npy", ".raw"])
def test_a_range_map_of_16_bits(tmp_path: Path, ending: str) -> None:
    """Coord3D_C16: x is the number of the column."""
    file = tmp_path / f"map{ending}"
    more = ""
    if ending == ".npy":
        np.save(file, COUNTS)
    elif ending == ".raw":
        file.write_bytes(COUNTS.astype("<u2").tobytes())
        more = f'pixel_format = "Coord3D_C16"\nwidth = {M}\n'
    else:
        write_image(file, COUNTS)
    check(listed(tmp_path, f'files = "{file.name}"\n{COMMON}{more}{A}{C}'), STEP / 2)


def test_x_and_z_of_16_bits(tmp_path: Path) -> None:
    """Coord3D_AC16: each pixel has its x too."""
    a = np.round((X + 10) / 0.01).astype(np.uint16)
    both = np.stack([np.broadcast_to(a, COUNTS.shape), COUNTS], axis=-1)
    scales = f"[profiles.a]\nscale = 0.01\noffset = -10.0\n{C}"
    (tmp_path / "m.raw").write_bytes(both.astype("<u2").tobytes())
    raw = f'pixel_format = "Coord3D_AC16"\nwidth = {M}\n'
    check(listed(tmp_path, f'files = "m.raw"\n{COMMON}{raw}{scales}'), 0.005)
    np.save(tmp_path / "m.npy", both)
    check(listed(tmp_path, f'files = "m.npy"\n{COMMON}{scales}'), 0.005)


def test_floats_need_no_scale(tmp_path: Path) -> None:
    both = np.stack([np.broadcast_to(X, Z.shape), np.where(HOLE, np.nan, Z)], axis=-1).astype("<f4")
    (tmp_path / "m.bin").write_bytes(both.tobytes())
    check(listed(tmp_path, f'files = "m.bin"\n{COMMON}pixel_format = "Coord3D_AC32f"\nwidth = {M}\n'), 1e-4)


def test_signed_numbers_have_their_least_for_none(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", np.where(HOLE, -32768, np.round((Z - 200) / STEP)).astype(np.int16))
    check(listed(tmp_path, f'files = "m.npy"\n{COMMON}{A}[profiles.c]\nscale = {STEP}\noffset = 200.0\n'), STEP / 2)


def test_heights_and_other_units(tmp_path: Path) -> None:
    """In micrometres, of a profiler whose z grows towards it; its 0 is 250 mm away."""
    np.save(tmp_path / "m.npy", np.where(HOLE, np.nan, 1000 * (250 - Z)))
    a = "[profiles.a]\nscale = 500\noffset = -7250\n"
    words = f'files = "m.npy"\nunits = "um"\nsteps_per_frame = 1\nz = "height"\nstandoff_mm = 250\nsigma_mm = 0.02\n{a}'
    check(listed(tmp_path, words))
    image = range_image_of_profiles(read_profiles(tmp_path))
    np.testing.assert_allclose(image.cloud().sigma, 0.02)
    assert image.cloud().strength is None


def test_profiles_that_are_missing_have_their_steps_listed(tmp_path: Path) -> None:
    kept = [n for n in range(N) if n not in (4, 5)]
    (tmp_path / "a.csv").write_text("\n".join(["profile,x,z,i", *(line for n in kept for line in lines(n))]))
    listed(tmp_path, f'files = "a.csv"\nunits = "mm"\nsteps = {kept}')
    assert read_profiles(tmp_path).positions["stage"] == tuple(kept)
    listed(tmp_path, 'files = "a.csv"\nunits = "mm"\nsteps_per_frame = 1')
    with pytest.raises(InputError, match=r"a.csv: profile 6 follows 3: list where the axis stood .* under steps"):
        read_profiles(tmp_path)


CSV = "profile,x,z\n0,1,200\n0,2,201\n1,1,200\n1,2,202\n"
WRONG = {
    "unit": (CSV, COMMON.replace("mm", "parsec"), MOTION, r'units = "parsec": must be one of um, mm, cm, m, inch'),
    "no unit": (CSV, "steps_per_frame = 1\n", MOTION, r"units: is missing: add one of um, mm"),
    "column": ("profile,x,y\n0,1,2\n", COMMON, MOTION, r'has no column "z"; its columns are profile, x, y: name'),
    "column given": (
        "profile,x,y\n0,1,2\n",
        COMMON + '[profiles.columns]\nz = "Z"\n',
        MOTION,
        r'has no column "Z", which \[profiles.columns\] z names; its columns are profile, x, y: name',
    ),
    "lengths": (CSV + "2,1,200\n", COMMON, MOTION, r"profile 2 has 1 points, the first 2: export all points"),
    "short line": (CSV + "2,1\n", COMMON, MOTION, r"line 6 has 2 numbers, the first has 3"),
    "words": (CSV + "2,1,far\n", COMMON, MOTION, r'line 6: "far" is no number: export it without text'),
    "comma": ("profile;x;z\n0;1,5;2\n", COMMON, MOTION, r'line 2: "1,5" is no number: .* points for decimals'),
    "all invalid": ("profile,x,z\n0,1,nan\n1,1,nan\n", COMMON, MOTION, r"none of 2 points is valid: check invalid"),
    "fraction": ("profile,x,z\n0,1,9\n0.5,1,9\n", COMMON, MOTION, r'"profile" has a number that is not whole'),
    "apart": (CSV + "0,3,200\n", COMMON, MOTION, r"the points of a profile are not together: sort"),
    "no profile": ("x,z\n1,2\n", COMMON, MOTION, r'one file without a column "profile": add one'),
    "only header": ("profile,x,z\n", COMMON, MOTION, r"has a header and no points"),
    "empty": ("# nothing\n", COMMON, MOTION, r"is empty"),
    "behind": (
        "profile,x,z\n0,1,-3\n1,1,9\n",
        COMMON,
        MOTION,
        r"a point lies -3 mm before the profiler: z is the dist",
    ),
    "still": (CSV, 'units = "mm"\nsteps = [5, 5]\n', MOTION, r"no axis moves from one profile to the next"),
    "steps": (CSV, 'units = "mm"\nsteps = [5, 6, 7]\n', MOTION, r"3 step counts for 2 frames"),
    "no motion": (CSV, COMMON, "", r"motion: is missing: add \[\[motion\]\]"),
    "other axis": (CSV, COMMON, MOTION.replace("stage", "belt"), r"motion.*: has no axis stage, which moves.* belt"),
    "standoff": (CSV, COMMON + "standoff_mm = 3\n", MOTION, r'standoff_mm = 3: is for z = "height"'),
    "height": (CSV, COMMON + 'z = "height"\n', MOTION, r"standoff_mm: is missing: add the distance"),
    "key": (CSV, COMMON + "unit = 3\n", MOTION, r'unit = 3: unknown key; did you mean "units"'),
    "sigma": (CSV, COMMON + "sigma_mm = 0\n", MOTION, r"sigma_mm = 0: must be more than 0"),
    "scale": (CSV, COMMON + A, MOTION, r"a = .*: is for files without a header"),
    "format": (CSV, COMMON + 'pixel_format = "Coord3D_C16"\n', MOTION, r"pixel_format = .*: is for range maps"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(tmp_path: Path, name: str) -> None:
    text, words, motion, said = WRONG[name]
    (tmp_path / "a.csv").write_text(text)
    listed(tmp_path, f'files = "a.csv"\n{words}', motion)
    with pytest.raises(InputError, match=said):
        read_profiles(tmp_path)


WRONG_MAPS = {
    "no scale": (f'files = "m.npy"\n{COMMON}{C}', r"\[profiles\] a: is missing: add \[profiles.a\].*Scan3dCoordinateS"),
    "no z scale": (f'files = "m.npy"\n{COMMON}{A}', r"\[profiles\] c: is missing"),
    "scale 0": (f'files = "m.npy"\n{COMMON}{A}[profiles.c]\nscale = 0\n', r"scale = 0: must not be 0"),
    "width": (f'files = "m.raw"\n{COMMON}pixel_format = "Coord3D_C16"\nwidth = 31\n{A}{C}', r"no whole number of prof"),
    "no width": (f'files = "m.raw"\n{COMMON}pixel_format = "Coord3D_C16"\n{A}{C}', r"width: is missing"),
    "unknown": (f'files = "m.raw"\n{COMMON}pixel_format = "Coord3D_ABC16"\nwidth = 3\n', r"must be one of Coord3D_C16"),
    "other": (f'files = "m.npy"\n{COMMON}pixel_format = "Coord3D_AC16"\n{A}{C}', r"holds 1 x uint16 for each point"),
    "8 bits": (f'files = "b.png"\n{COMMON}{A}{C}', r"b.png: has 8 bits, which is a picture of a range map"),
    "three": (f'files = "t.npy"\n{COMMON}{A}{C}', r"t.npy: has the shape \(2, 3, 3\) of float64"),
    "columns": (f'files = "m.npy"\n{COMMON}{A}{C}[profiles.columns]\nx = "u"\n', r"columns = .*: is for CSV"),
    "two": (f'files = ["m.npy", "t.npy"]\n{COMMON}{A}{C}', r"2 files: give one range map"),
    "ending": (f'files = "m.obj"\n{COMMON}{A}{C}', r"cannot read .obj: give .csv"),
}


@pytest.mark.parametrize("name", WRONG_MAPS)
def test_what_is_wrong_with_a_range_map_is_said(tmp_path: Path, name: str) -> None:
    np.save(tmp_path / "m.npy", COUNTS)
    np.save(tmp_path / "t.npy", np.ones((2, 3, 3)))
    (tmp_path / "m.raw").write_bytes(COUNTS.tobytes())
    (tmp_path / "m.obj").write_text("x")
    write_image(tmp_path / "b.png", np.full((4, 5), 7, np.uint8))
    words, said = WRONG_MAPS[name]
    listed(tmp_path, words)
    with pytest.raises(InputError, match=said):
        read_profiles(tmp_path)


def test_other_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no profiles.toml: write one there"):
        read_profiles(tmp_path)
    with pytest.raises(InputError, match=r"there is no such file or folder"):
        read_profiles(tmp_path / "none")


@pytest.mark.parametrize(
    ("names", "gap"),
    [
        ("p0 p1 p2 p3 p5 p6", "p3 p5"),
        ("p000 p010 p020 p040 p050 p060", "p020 p040"),
        ("p0 p1 p2 p3 p4 p5", ""),
        ("p0 p2 p4 p6 p8", ""),
        # Times, names that differ in two numbers, and too few to say.
        ("t1701 t1709 t1733 t1741 t1760 t1777", ""),
        ("a1b1 a2b1 a3b2 a5b2 a6b3 a7b3", ""),
        ("p0 p1 p3", ""),
        ("cup plate saucer spoon fork", ""),
    ],
)
def test_gaps_in_the_numbers_of_files(names: str, gap: str) -> None:
    found = gap_in_numbers([Path(f"{name}.csv") for name in names.split()])
    assert " ".join(path.stem for path in found or ()) == gap
