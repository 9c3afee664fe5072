"""What `inspect` found, as text: one line for each, name and value."""

from collections.abc import Callable, Iterator
from typing import Any

Summary = dict[str, Any]
Line = tuple[str, str]

# Of more numbers than these their range is shown.
_MOST_NUMBERS = 16
# What is said of a camera in addition to its lens's terms.
_PINHOLE = ("image_size", "lens", "focal", "principal", "tilt", "reach_deg", "image_without_rays")


def format_summary(summary: Summary) -> str:
    """The summary of any kind of file, as text."""
    lines = [*_WORDS[summary["kind"]](summary), *_picture(summary)]
    width = max((len(name) for name, _ in lines), default=0)
    return "\n".join([f"{summary['kind']} {summary['path']}", *(f"  {name:{width}}  {value}" for name, value in lines)])


def _session(summary: Summary) -> Iterator[Line]:
    board = summary["board"]
    points = "centres of circles" if board["kind"] == "circles" else "inner corners"
    columns, rows = board["points"]
    shape = "" if board["shape"] == "flat" else f", whose shape is found too ({board['shape']})"
    yield "board", f"{board['kind']}, {columns} × {rows} {points}, {board['pitch_mm']:g} mm apart{shape}"
    yield "views", f"{summary['views']} photographs of {_size(summary['image_size'])}"
    for laser in summary["lasers"]:
        where = "in the photographs of the board"
        if sweep := laser["sweep"]:
            where = f"in {sweep['photographs']} photographs"
        elif summary["stripes"]:
            where = f"in {summary['stripes'][laser['name']]} photographs of its own"
        sheet = "" if laser["sheet"] == "plane" else f", sheet {laser['sheet']}"
        yield _called("laser", laser), f"{_stripe(laser)}, {where}{sheet}"
        if sweep := laser["sweep"]:
            at = sweep["positions"]
            steps = ", ".join(map(str, at)) if len(at) <= _MOST_NUMBERS else f"{at[0]} … {at[-1]}"
            yield (
                _called("sweep", laser),
                f'{sweep["boards"]} boards × {len(at)} positions of axis "{sweep["axis"]}": {steps}',
            )
    if not summary["lasers"]:
        yield "laser", "none: the rig will have none"
    stage = summary["stage"]
    if posed := summary["poses"]:
        yield "poses", f"{posed['count']} of the views, the {posed['moves']} moves; {_way(posed)}"
    else:
        yield "stage", _stage(stage) if stage else "none: the rig will have none"
    if turntable := summary["turntable"]:
        yield "turntable", f"{turntable['count']} photographs, {_travel(turntable)}, at step {turntable['stage_step']}"
    held = "found" if summary["principal_point"] == "free" else "held at the centre of the image"
    also = f", {', '.join(summary['hold'])} held" if summary["hold"] else ""
    tilt = ", tilt of the sensor found" if summary["tilt"] else ""
    yield "camera", f"lens {summary['lens']}, principal point {held}{also}{tilt}"


def _stage(summary: Summary) -> str:
    motion = "" if summary["motion"] == "linear" else f", its motion a {summary['motion'].replace('_', ' ')}"
    turn = f", {summary['screw_steps']:g} steps to a turn of its screw" if summary["screw_steps"] else ""
    return f"{summary['count']} photographs, {_travel(summary)}{motion}{turn}"


def _way(posed: Summary) -> str:
    """How far a hand goes by its given poses, and how far it turns."""
    ways = zip("xyz", posed["from_mm"], posed["to_mm"], strict=True)
    extent = ", ".join(f"{axis} {low:.1f} … {high:.1f}" for axis, low, high in ways)
    by = f", by {posed['file']}" if "file" in posed else ""
    return f"the hand goes over {extent} mm and turns by up to {posed['turn_deg']:.1f}°{by}"


def _scan(summary: Summary) -> Iterator[Line]:
    if summary["name"]:
        yield "name", summary["name"]
    if summary["video"]:
        yield "video", summary["video"]
    if summary["frames"]:
        yield "frames", str(summary["frames"])
    elif summary["frames"] == 0:
        yield "frames", "none: the scan was cut off before its first"
    for name, steps in summary["axes"].items():
        if steps["count"] != 0:
            yield name, _positions(steps)
    if summary["poses"]:
        yield "poses", _way(summary["poses"])
    if summary["image_size"]:
        yield "photographs", _size(summary["image_size"])
    yield _called("laser", summary["laser"]), _stripe(summary["laser"])
    count = summary["backgrounds"]
    yield "background", {0: "none", 1: "one photograph for all frames"}.get(count, "one photograph for each frame")
    if summary["checks"]:
        wrong = [check for check in summary["checks"] if "off" in check]
        sound = [check for check in summary["checks"] if not {"off", "unverified"} & set(check)]
        right = sum(check["last"] - check["first"] + 1 for check in sound)
        yield (
            "places",
            f"{right} frames verified"
            + "".join(
                f"; frames {check['first']} to {check['last']} off by up to "
                + " and ".join(f"{abs(steps)} steps of the {axis}" for axis, steps in check["off"].items())
                for check in wrong
            ),
        )
    if summary["exposures_s"]:
        low, high = summary["exposures_s"]
        yield "exposure", f"{low:g} s" if low == high else f"{low:g} to {high:g} s"


def _profiles(summary: Summary) -> Iterator[Line]:
    if summary["name"]:
        yield "name", summary["name"]
    n = summary["profiles"] * summary["points_of_a_profile"]
    yield "profiles", f"{summary['profiles']} of {summary['points_of_a_profile']} points"
    yield "valid", f"{summary['points']} of {n} points"
    for name in ("x", "z"):
        low, high = summary[f"{name}_mm"]
        yield name, f"{low:.4g} to {high:.4g} mm"
    if summary["sigma_mm"] is not None:
        yield "σ", f"{summary['sigma_mm']:g} mm"
    for name, steps in summary["axes"].items():
        kind = summary["motion"].get(name)
        yield name, _positions(steps) + (f", {kind.replace('_', ' ')}" if kind else ", not of the motion")


def _rig(summary: Summary) -> Iterator[Line]:
    yield from _intrinsics(summary["camera"])
    for light in summary["lights"]:
        yield (
            _called("light plane" if light["kind"] == "plane" else f"light, {light['kind']}", light),
            f"ω = {_values(light['plane'], '1/mm')}" if "plane" in light else "",
        )
        yield "", f"{light['distance_mm']:.1f} mm from the camera, {light['angle_to_axis_deg']:.1f}° to its axis"
        if "degrees_per_1000_steps" in light:
            about = ", ".join(f"{x:.3f}" for x in light["about"])
            yield (
                "",
                f"there at step {light['middle_steps']:g} of the {light['axis']}, which turns it by "
                f"{light['degrees_per_1000_steps']:.4g}° in 1000 steps about ({about})",
            )
        if "curved_mm" in light:
            error = "" if light["curved_mm_sigma"] is None else f" ± {light['curved_mm_sigma']:.2g}"
            yield "", f"curved by {light['curved_mm']:.3f}{error} mm over 200 mm in the middle of the image"
        if light["triangulation_angle_deg"] is not None:
            yield "", f"in the middle of the image {light['depth_in_the_middle_mm']:.1f} mm away"
        if light["triangulation_angles_deg"]:
            low, high = light["triangulation_angles_deg"]
            yield "triangulation", f"rays meet the sheet at {low:.1f}° to {high:.1f}°"
    if not summary["lights"]:
        yield "light plane", "none"
    for axis in summary["motion"]:
        yield from _axis(axis)
    if not summary["motion"]:
        yield "motion", "none"
    from jaxscan.rig.board_shape import shape_in_words

    if shape := shape_in_words(summary["fit"]):
        yield "board", shape
    for name, value in summary["fit"].items():
        # Said in words above, or of no use to a reader.
        if name.startswith("board_") or name in ("pose_range", "pose_offset_unknown"):
            continue
        if name == "sigma_over_noise_alone":
            yield "σ", f"{min(value.values()):.2g} to {max(value.values()):.2g} times as large as from noise alone"
        elif name == "sheet_sigma_mm":
            yield "sheet's thickness", ", ".join(f"σ {each:.2g} mm" if each else "not known" for each in value)
        else:
            yield name, f"{value:.4g}" if isinstance(value, float) else str(value)
    for warning in summary["warnings"]:
        yield "warning", f"{warning}."


def _camera(summary: Summary) -> Iterator[Line]:
    yield "format", summary["format"]
    if summary["camera"]:
        yield from _intrinsics(summary["camera"])
    else:
        yield "camera", f"none, photographs of {_size(summary['image_size'])}"
    if summary["views"]:
        yield "views", f"{summary['views']} photographs of the board, {summary['poses']} of them with their pose"
        yield "corners", str(summary["corners"])


def _intrinsics(camera: Summary) -> Iterator[Line]:
    yield "camera", f"{_size(camera['image_size'])}, lens {camera['lens']}"
    yield "focal length", _values(camera["focal"], "px")
    yield "principal point", _values(camera["principal"], "px")
    if "tilt" in camera:
        yield "tilt of the sensor", _values(camera["tilt"], "rad")
    for name, terms in camera.items():
        if name not in _PINHOLE and terms["value"]:
            yield f"{name} terms", _values(terms)
    if "reach_deg" in camera:
        dark = f", and {100 * camera['image_without_rays']:.0f} % of the image is beyond it: no point is seen there"
        also = dark if camera["image_without_rays"] else ""
        yield "lens", f"sees up to {camera['reach_deg']:.0f}° off its axis{also}"


def _cloud(summary: Summary) -> Iterator[Line]:
    yield "points", f"{summary['points']}{', coloured' if summary['colours'] else ''}"
    yield from _extent(summary)


def _mesh(summary: Summary) -> Iterator[Line]:
    yield "triangles", f"{summary['triangles']} between {summary['vertices']} vertices"
    yield from _extent(summary)
    yield (
        "surface",
        f"{summary['area_mm2']:.6g} mm²" + ("" if summary["consistent"] else ", not all turned the same way"),
    )
    yield "volume", f"{summary['volume_mm3']:.6g} mm³" if summary["closed"] else "none: it is open"


def _ply(summary: Summary) -> Iterator[Line]:
    yield "format", summary["format"]
    for name, (count, properties) in summary["elements"].items():
        yield f"element {name}", f"{count}: {', '.join(properties)}"


def _range_image(summary: Summary) -> Iterator[Line]:
    cells = summary["frames"] * summary["columns"]
    yield "frames", str(summary["frames"])
    for axis, steps in summary["axes"].items():
        yield axis, _positions(steps)
    if summary["poses"]:
        yield "poses", _way(summary["poses"])
    if summary["sweeps"] > 1:
        yield "sweeps", f"{summary['sweeps']}: in each the same axes move from frame to frame"
    if summary["full_turn"]:
        yield "turn", "once all around, or more: the last frame is beside the first"
    yield "lines", f"{summary['columns']}: columns of the photographs, or rows"
    yield "points", f"{summary['points']}, {100 * summary['points'] / max(cells, 1):.1f} % of frames × lines"
    yield from _extent(summary)
    if summary["strength"] is not None:
        full = ", of the fitted stripe: more than a full pixel's where its core is burnt out"
        yield (
            "strength",
            f"{summary['strength']:.1f} grey levels in the median{full if summary['strength'] > 255 else ''}",
        )
    if summary["light"] is not None:
        from jaxscan.images.light import Light

        yield "light", Light(**summary["light"]).in_words()
    if (limit := summary.get("speckle_limit")) is not None:
        from jaxscan.rig.speckle_limit import SpeckleLimit

        known = SpeckleLimit(limit["contrast"], limit["limit_mm"], limit["sigma_pixel_mm"])
        yield "limit of speckle", known.in_words()
    for note in summary["notes"]:
        yield "note", note


_WORDS: dict[str, Callable[[Summary], Iterator[Line]]] = {
    "session": _session,
    "scan": _scan,
    "profiles": _profiles,
    "rig": _rig,
    "camera": _camera,
    "cloud": _cloud,
    "mesh": _mesh,
    "PLY": _ply,
    "range image": _range_image,
}


def _picture(summary: Summary) -> Iterator[Line]:
    picture = summary.get("picture")
    if picture is None:
        return
    found = []
    if "removed" in picture:
        taken = ", ".join(f"{count} {rule}" for rule, count in picture["removed"].items())
        yield "picture", f"{picture['path']}: cleaning would take {taken} points"
        return
    if "corners" in picture:
        found.append(f"{picture['corners']} of {picture['of_corners']} points of the board")
    for stripe in picture.get("lasers", [picture]):
        lines = "columns" if "of_columns" in stripe else "rows"
        found.append(f"a stripe in {stripe['stripe_points']} of {stripe[f'of_{lines}']} {lines}")
    yield "picture", f"{picture['path']}: {', '.join(found)}"
    for note in picture.get("notes", ()):
        yield "note", f"{note}."


def _extent(summary: Summary) -> Iterator[Line]:
    if summary["box_mm"]:
        import numpy as np

        from jaxscan.files.units import too_small

        ranges = (f"{axis} {low:.1f} … {high:.1f}" for axis, low, high in zip("xyz", *summary["box_mm"], strict=True))
        yield "extent", f"{', '.join(ranges)} mm"
        across = too_small(np.array(summary["box_mm"]))
        if across is not None:
            yield "", f"{across:.3g} mm across: if its numbers are metres, other commands take --units m"
    if summary["sigma_mm"] is not None:
        yield "sigma", f"{summary['sigma_mm']:.4f} mm in the median"
    if summary.get("sigma_pixel_mm") is not None:
        known = "" if summary["sigma_mm"] is None else "of which "
        yield "" if known else "sigma", f"{known}the pixel's part is {summary['sigma_pixel_mm']:.4f} mm"


def _size(size: list[int]) -> str:
    return f"{size[0]} × {size[1]} pixels"


def _called(what: str, laser: Summary) -> str:
    return f'{what} "{laser["name"]}"' if laser["name"] else what


def _stripe(laser: Summary) -> str:
    return f"{laser['color']}, one point for each image {'column' if laser['columns'] else 'row'}"


def _travel(steps: Summary) -> str:
    if steps["count"] == 0:
        return "no steps"
    spacing = f", {steps['spacing']} apart" if steps["spacing"] is not None else ""
    if not spacing and steps["first_step"] == steps["last_step"]:
        return f"from step {steps['first_step']} and back to it"
    return f"steps {steps['first_step']} to {steps['last_step']}{spacing}"


def _positions(steps: Summary) -> str:
    """Where an axis stood for the frames of a scan; how many these are need not be known."""
    if steps["count"] is None and steps["spacing"]:
        return f"from step {steps['first_step']}, {steps['spacing']} motor steps from one frame to the next"
    if steps["spacing"] == 0 or steps["count"] == 1:
        return f"step {steps['first_step']}"
    return _travel(steps)


def _axis(summary: Summary) -> Iterator[Line]:
    """The motion of an axis."""
    if "degrees_per_step" in summary:
        yield from zip((summary["axis"], ""), format_turn(summary), strict=True)
        yield from _path(summary)
    elif "direction" in summary:
        direction = ", ".join(f"{x:.4f}" for x in summary["direction"])
        yield (
            summary["axis"],
            f"{summary['mm_per_1000_steps']:.5g} mm for 1000 steps, {summary['way']}, along ({direction})",
        )
        yield from _path(summary)
    elif "hand_mm" in summary:
        what = "hand" if summary["moves"] == "head" else "robot's base"
        yield summary["axis"], f"the {summary['moves']} moves {summary['way']}"
        # Where nothing turned its place is not found.
        found = summary["hand_sigma_mm"] is not None or summary["turned_sigma_deg"] is None
        place = f"at {_triple(summary['hand_mm'])}" if found else "at a place that is not found"
        yield "", f"the {what} {place} in the camera's frame, turned by {_turn(summary)}"
        if ways := summary["hand_open_along"]:
            axes = " and ".join("(" + ", ".join(f"{x:.2f}" for x in way) + ")" for way in ways)
            yield "", f"along {axes} of its own axes this place is not found, because nothing turned there"
    else:
        yield summary["axis"], f"{summary['kind']}, {summary['way']}"


def _triple(values: list[float]) -> str:
    return f"({', '.join(f'{x:.3f}' for x in values)}) mm"


def _turn(summary: Summary) -> str:
    """The turn of hand or base, and how well it and its place are known."""
    degrees, error = summary["turned_deg"], summary["turned_sigma_deg"]
    axis = ", ".join(f"{x:.4f}" for x in summary["turned_about"])
    if error is None:
        return f"{degrees:.3f}° about ({axis})"
    place = "" if summary["hand_sigma_mm"] is None else f" and {max(summary['hand_sigma_mm']):.2g} mm"
    return f"{degrees:.3f}° about ({axis}), known to {error:.2g}°{place}"


def _path(summary: Summary) -> Iterator[Line]:
    from jaxscan.rig.summary import format_path

    return (("", line) for line in format_path(summary))


def format_turn(summary: Summary) -> tuple[str, str]:
    """Angle and axis of a turntable: `TurnSummary` as a dictionary."""

    def sigma(key: str, unit: str) -> str:
        return f" ± {summary[key]:.2g}{unit}" if summary[key] is not None else ""

    axis, through = (
        ", ".join(f"{x:.{n}f}" for x in summary[key]) for key, n in (("axis_direction", 5), ("through_mm", 3))
    )
    return (
        f"{summary['degrees_per_step']:.7g}°{sigma('degrees_per_step_sigma', '°')} a step, "
        f"{summary['steps_per_turn']:.6g} steps a turn, {summary['way']} as the camera sees it",
        f"axis ({axis}){sigma('axis_sigma_deg', '°')} through ({through}) mm{sigma('through_sigma_mm', ' mm')}",
    )


def _values(part: Summary, unit: str = "") -> str:
    """Numbers with their standard deviations, to the digits that these leave."""
    sigmas = part["sigma"] or [None] * len(part["value"])
    if len(sigmas) > _MOST_NUMBERS:
        known = [sigma for sigma in sigmas if sigma]
        spread = f", σ {max(known):.2g} at most" if known else ""
        ends = f"{min(part['value']):.3g} to {max(part['value']):.3g} {unit}".rstrip()
        return f"{len(sigmas)} numbers, {ends}{spread}; all of them with --json"
    shown = []
    for value, sigma in zip(part["value"], sigmas, strict=True):
        shown.append(f"{value:.7g} ± {sigma:.2g}" if sigma else f"{value:.7g}")
    return f"{', '.join(shown)} {unit}".rstrip()
