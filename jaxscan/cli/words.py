"""The facts that `inspect` found, in words: one line for each, name and value."""

from collections.abc import Callable, Iterator
from typing import Any

Facts = dict[str, Any]
Line = tuple[str, str]

# What is said of a camera besides its lens's terms.
_PINHOLE = ("image_size", "lens", "focal", "principal", "tilt")


def in_words(facts: Facts) -> str:
    """The facts of any kind of file."""
    lines = [*_WORDS[facts["kind"]](facts), *_picture(facts)]
    width = max((len(name) for name, _ in lines), default=0)
    return "\n".join([f"{facts['kind']} {facts['path']}", *(f"  {name:{width}}  {value}" for name, value in lines)])


def _session(facts: Facts) -> Iterator[Line]:
    board = facts["board"]
    points = "centres of circles" if board["kind"] == "circles" else "inner corners"
    columns, rows = board["points"]
    shape = "" if board["shape"] == "flat" else f", whose shape is found too ({board['shape']})"
    yield "board", f"{board['kind']}, {columns} × {rows} {points}, {board['pitch_mm']:g} mm apart{shape}"
    yield "views", f"{facts['views']} photographs of {_size(facts['image_size'])}"
    for laser in facts["lasers"]:
        where = "in the photographs of the board"
        if facts["stripes"]:
            where = f"in {facts['stripes'][laser['name']]} photographs of its own"
        sheet = "" if laser["sheet"] == "plane" else f", sheet {laser['sheet']}"
        yield _called("laser", laser), f"{_stripe(laser)}, {where}{sheet}"
    if not facts["lasers"]:
        yield "laser", "none: the rig will have none"
    stage = facts["stage"]
    yield "stage", _stage(stage) if stage else "none: the rig will have none"
    if turntable := facts["turntable"]:
        yield "turntable", f"{turntable['count']} photographs, {_travel(turntable)}, at step {turntable['stage_step']}"
    held = "found" if facts["principal_point"] == "free" else "held at the centre of the image"
    also = f", {', '.join(facts['hold'])} held" if facts["hold"] else ""
    tilt = ", tilt of the sensor found" if facts["tilt"] else ""
    yield "camera", f"lens {facts['lens']}, principal point {held}{also}{tilt}"


def _stage(facts: Facts) -> str:
    motion = "" if facts["motion"] == "linear" else f", its motion a {facts['motion'].replace('_', ' ')}"
    turn = f", {facts['screw_steps']:g} steps to a turn of its screw" if facts["screw_steps"] else ""
    return f"{facts['count']} photographs, {_travel(facts)}{motion}{turn}"


def _scan(facts: Facts) -> Iterator[Line]:
    if facts["name"]:
        yield "name", facts["name"]
    if facts["video"]:
        yield "video", facts["video"]
    if facts["frames"]:
        yield "frames", str(facts["frames"])
    elif facts["frames"] == 0:
        yield "frames", "none: the scan was cut off before its first"
    for name, steps in facts["axes"].items():
        if steps["count"] != 0:
            yield name, _positions(steps)
    if facts["image_size"]:
        yield "photographs", _size(facts["image_size"])
    yield _called("laser", facts["laser"]), _stripe(facts["laser"])
    count = facts["backgrounds"]
    yield "background", {0: "none", 1: "one photograph for all frames"}.get(count, "one photograph for each frame")
    if facts["checks"]:
        wrong = [check for check in facts["checks"] if "off" in check]
        sound = [check for check in facts["checks"] if not {"off", "unverified"} & set(check)]
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
    if facts["exposures_s"]:
        low, high = facts["exposures_s"]
        yield "exposure", f"{low:g} s" if low == high else f"{low:g} to {high:g} s"


def _rig(facts: Facts) -> Iterator[Line]:
    yield from _intrinsics(facts["camera"])
    for light in facts["lights"]:
        yield (
            _called("light plane" if light["kind"] == "plane" else f"light, {light['kind']}", light),
            f"ω = {_values(light['plane'], '1/mm')}" if "plane" in light else "",
        )
        yield "", f"{light['distance_mm']:.1f} mm from the camera, {light['angle_to_axis_deg']:.1f}° to its axis"
        if "curved_mm" in light:
            error = "" if light["curved_mm_sigma"] is None else f" ± {light['curved_mm_sigma']:.2g}"
            yield "", f"curved by {light['curved_mm']:.3f}{error} mm over 200 mm in the middle of the image"
        if light["triangulation_angle_deg"] is not None:
            yield "", f"in the middle of the image {light['depth_in_the_middle_mm']:.1f} mm away"
        if light["triangulation_angles_deg"]:
            low, high = light["triangulation_angles_deg"]
            yield "triangulation", f"rays meet the sheet at {low:.1f}° to {high:.1f}°"
    if not facts["lights"]:
        yield "light plane", "none"
    for axis in facts["motion"]:
        yield from _axis(axis)
    if not facts["motion"]:
        yield "motion", "none"
    from jaxscan.rig.board_shape import shape_in_words

    if shape := shape_in_words(facts["fit"]):
        yield "board", shape
    for name, value in facts["fit"].items():
        if name.startswith("board_"):
            continue
        if name == "sigma_over_noise_alone":
            yield "σ", f"{min(value.values()):.2g} to {max(value.values()):.2g} times as wide as noise alone has it"
        else:
            yield name, f"{value:.4g}" if isinstance(value, float) else str(value)
    for warning in facts["warnings"]:
        yield "warning", f"{warning}."


def _camera(facts: Facts) -> Iterator[Line]:
    yield "format", facts["format"]
    if facts["camera"]:
        yield from _intrinsics(facts["camera"])
    else:
        yield "camera", f"none, photographs of {_size(facts['image_size'])}"
    if facts["views"]:
        yield "views", f"{facts['views']} photographs of the board, {facts['poses']} of them with their pose"
        yield "corners", str(facts["corners"])


def _intrinsics(camera: Facts) -> Iterator[Line]:
    yield "camera", f"{_size(camera['image_size'])}, lens {camera['lens']}"
    yield "focal length", _values(camera["focal"], "px")
    yield "principal point", _values(camera["principal"], "px")
    if "tilt" in camera:
        yield "tilt of the sensor", _values(camera["tilt"], "rad")
    for name, terms in camera.items():
        if name not in _PINHOLE and terms["value"]:
            yield f"{name} terms", _values(terms)


def _cloud(facts: Facts) -> Iterator[Line]:
    yield "points", f"{facts['points']}{', coloured' if facts['colours'] else ''}"
    yield from _extent(facts)


def _mesh(facts: Facts) -> Iterator[Line]:
    yield "triangles", f"{facts['triangles']} between {facts['vertices']} vertices"
    yield from _extent(facts)
    yield "surface", f"{facts['area_mm2']:.6g} mm²" + ("" if facts["consistent"] else ", not all turned the same way")
    yield "volume", f"{facts['volume_mm3']:.6g} mm³" if facts["closed"] else "none: it is open"


def _ply(facts: Facts) -> Iterator[Line]:
    yield "format", facts["format"]
    for name, (count, properties) in facts["elements"].items():
        yield f"element {name}", f"{count}: {', '.join(properties)}"


def _range_image(facts: Facts) -> Iterator[Line]:
    cells = facts["frames"] * facts["columns"]
    yield "frames", str(facts["frames"])
    for axis, steps in facts["axes"].items():
        yield axis, _positions(steps)
    if facts["sweeps"] > 1:
        yield "sweeps", f"{facts['sweeps']}: in each the same axes move from frame to frame"
    if facts["full_turn"]:
        yield "turn", "once all around, or more: the last frame is beside the first"
    yield "lines", f"{facts['columns']}: columns of the photographs, or rows"
    yield "points", f"{facts['points']}, {100 * facts['points'] / max(cells, 1):.1f} % of frames × lines"
    yield from _extent(facts)
    if facts["strength"] is not None:
        yield "strength", f"{facts['strength']:.1f} grey levels in the median"
    if facts["light"] is not None:
        from jaxscan.images.light import Light

        yield "light", Light(**facts["light"]).in_words()
    if (limit := facts.get("speckle_limit")) is not None:
        from jaxscan.rig.speckle_limit import SpeckleLimit

        known = SpeckleLimit(limit["contrast"], limit["limit_mm"], limit["sigma_pixel_mm"])
        yield "limit of speckle", known.in_words()


_WORDS: dict[str, Callable[[Facts], Iterator[Line]]] = {
    "session": _session,
    "scan": _scan,
    "rig": _rig,
    "camera": _camera,
    "cloud": _cloud,
    "mesh": _mesh,
    "PLY": _ply,
    "range image": _range_image,
}


def _picture(facts: Facts) -> Iterator[Line]:
    picture = facts.get("picture")
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


def _extent(facts: Facts) -> Iterator[Line]:
    if facts["box_mm"]:
        import numpy as np

        from jaxscan.files.units import too_small

        ranges = (f"{axis} {low:.1f} … {high:.1f}" for axis, low, high in zip("xyz", *facts["box_mm"], strict=True))
        yield "extent", f"{', '.join(ranges)} mm"
        across = too_small(np.array(facts["box_mm"]))
        if across is not None:
            yield "", f"{across:.3g} mm across: if its numbers are metres, other commands take --units m"
    if facts["sigma_mm"] is not None:
        yield "sigma", f"{facts['sigma_mm']:.4f} mm in the median"
    if facts.get("sigma_pixel_mm") is not None:
        known = "" if facts["sigma_mm"] is None else "of which "
        yield "" if known else "sigma", f"{known}the pixel's part is {facts['sigma_pixel_mm']:.4f} mm"


def _size(size: list[int]) -> str:
    return f"{size[0]} × {size[1]} pixels"


def _called(what: str, laser: Facts) -> str:
    return f'{what} "{laser["name"]}"' if laser["name"] else what


def _stripe(laser: Facts) -> str:
    return f"{laser['color']}, one point for each image {'column' if laser['columns'] else 'row'}"


def _travel(steps: Facts) -> str:
    if steps["count"] == 0:
        return "no steps"
    spacing = f", {steps['spacing']} apart" if steps["spacing"] is not None else ""
    if not spacing and steps["first_step"] == steps["last_step"]:
        return f"from step {steps['first_step']} and back to it"
    return f"steps {steps['first_step']} to {steps['last_step']}{spacing}"


def _positions(steps: Facts) -> str:
    """Where an axis stood for the frames of a scan; how many these are need not be known."""
    if steps["count"] is None and steps["spacing"]:
        return f"from step {steps['first_step']}, {steps['spacing']} motor steps from one frame to the next"
    if steps["spacing"] == 0 or steps["count"] == 1:
        return f"step {steps['first_step']}"
    return _travel(steps)


def _axis(facts: Facts) -> Iterator[Line]:
    """The motion of an axis."""
    if "degrees_per_step" in facts:
        yield from zip((facts["axis"], ""), turn_in_words(facts), strict=True)
        yield from _path(facts)
    elif "direction" in facts:
        direction = ", ".join(f"{x:.4f}" for x in facts["direction"])
        yield facts["axis"], f"{facts['mm_per_1000_steps']:.5g} mm for 1000 steps, {facts['way']}, along ({direction})"
        yield from _path(facts)
    else:
        yield facts["axis"], f"{facts['kind']}, {facts['way']}"


def _path(facts: Facts) -> Iterator[Line]:
    from jaxscan.rig.facts import path_in_words

    return (("", line) for line in path_in_words(facts))


def turn_in_words(facts: Facts) -> tuple[str, str]:
    """Angle and axis of a turntable: `TurnFacts` as a dictionary."""

    def sigma(key: str, unit: str) -> str:
        return f" ± {facts[key]:.2g}{unit}" if facts[key] is not None else ""

    axis, through = (
        ", ".join(f"{x:.{n}f}" for x in facts[key]) for key, n in (("axis_direction", 5), ("through_mm", 3))
    )
    return (
        f"{facts['degrees_per_step']:.7g}°{sigma('degrees_per_step_sigma', '°')} a step, {facts['steps_per_turn']:.6g} "
        f"steps a turn, {facts['way']} as the camera sees it",
        f"axis ({axis}){sigma('axis_sigma_deg', '°')} through ({through}) mm{sigma('through_sigma_mm', ' mm')}",
    )


def _values(part: Facts, unit: str = "") -> str:
    """Numbers with their standard deviations, to the digits that these leave."""
    sigmas = part["sigma"] or [None] * len(part["value"])
    shown = []
    for value, sigma in zip(part["value"], sigmas, strict=True):
        shown.append(f"{value:.7g} ± {sigma:.2g}" if sigma else f"{value:.7g}")
    return f"{', '.join(shown)} {unit}".rstrip()
