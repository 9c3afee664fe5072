"""What `jaxscan calibrate` is to find of camera, light and board, and how it weighs what was seen."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.calibration import Observations
    from jaxscan.files.session import CameraSettings, Session
    from jaxscan.rig import Camera


# `rig.LightPlane.kind`, which to import takes as long as JAX.
PLANE: Final = "plane"


@dataclass(frozen=True)
class Estimate:
    """What the command line asks for beyond the session's [camera].

    Attributes:
        lens: in place of the session's.
        hold: parameters that are held in addition.
        free: lens terms that are sought although the start camera has them as 0, and the session may hold them.
        plain: plain least squares, every corner with the same weight.
        sheet: the kind of all lasers' sheets, in place of the session's.
        board_shape: in place of the session's.
        since: the first photograph that takes part.
        split: the first photograph of the second part, where the session is solved in two.
        tilt: the tilt of the sensor is sought, whatever the session says.
        stage_motion: the kind of the stage's motion, in place of the session's.
        model: "auto" or "given", whether terms may be added that the photographs ask for.
    """

    lens: str | None = None
    hold: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    plain: bool = False
    sheet: str | None = None
    board_shape: str | None = None
    since: str | None = None
    split: str | None = None
    tilt: bool = False
    stage_motion: str | None = None
    model: str = "auto"

    @property
    def chooses(self) -> bool:
        """Whether the photographs choose the model; plain least squares weigh nothing, so nothing is chosen by them.

        Nor is it chosen for a session in two parts: what was changed looks like a lens, a board or a sheet that is not
        followed.
        """
        return self.model == "auto" and not self.plain and self.split is None

    def fixed(self) -> set[str]:
        """The parts of the model, of `calibration.choose.PARTS`, that the command line gives."""
        given = {"lens": self.lens, "board_shape": self.board_shape, "lights": self.sheet, "motion": self.stage_motion}
        return {part for part, value in given.items() if value is not None}

    def of(self, settings: "CameraSettings") -> "CameraSettings":
        """A session's settings with what was asked for."""
        hold = tuple(sorted({*settings.hold, *self.hold} - set(self.free)))
        return replace(settings, lens=self.lens or settings.lens, hold=hold, tilt=self.tilt or settings.tilt)

    def sheets(self, session: "Session") -> tuple[str, ...]:
        """The kind of each laser's sheet."""
        own = session.sheets or (PLANE,) * len(session.lasers)
        if not self.sheet:
            return own
        from jaxscan.rig import LIGHTS
        from jaxscan.rig.light import moves

        for laser in session.lasers:
            if moves(LIGHTS[self.sheet]) != (laser.name in session.light_axes):
                what = "moves" if laser.name in session.light_axes else "stands still"
                raise InputError(
                    f"--sheet {self.sheet}: the light of {session.path} {what}: change sheet under [laser] there, "
                    "with stripe_steps where it moves"
                )
        return (self.sheet,) * len(own)

    def check_named(self, names: list[str]) -> None:
        """Whether --since and --split name photographs, before any is looked at.

        Raises:
            InputError: one of them does not.
        """
        from jaxscan.calibration.observations import no_such_photograph

        for option, name in (("--since", self.since), ("--split", self.split)):
            if name is not None and name not in names:
                raise InputError(f"{option}: {no_such_photograph(name, names, 'those of the board are')}")

    def taken(self, observations: "Observations") -> "Observations":
        """What takes part of what was seen.

        Raises:
            InputError: there is no such photograph.
        """
        if self.since is not None:
            try:
                return observations.since(self.since)
            except InputError as error:
                raise InputError(f"--since: {error}") from None
        return observations

    def zeros(self, path: Path, start: "Camera") -> tuple[str, ...]:
        """The lens terms of a file's camera that are 0 and not to be sought.

        Raises:
            InputError: a term is to be free that the file does not have as 0.
        """
        zeros = start.zero_terms()
        if others := [name for name in self.free if name not in zeros]:
            terms = f"the terms {', '.join(zeros)}" if zeros else "no term"
            raise InputError(
                f"--free {', '.join(others)}: frees a lens term that --camera has as 0; {path}, whose lens is "
                f'"{start.lens.kind}", has {terms} as 0'
            )
        return tuple(name for name in zeros if name not in self.free)


AS_THE_SESSION: Final = Estimate()


def add_estimate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --model, and what names parts of the model, parameters to hold, and photographs to leave out."""
    parser.add_argument(
        "--model",
        choices=("auto", "given"),
        default="auto",
        help="auto (the default): begin with what the session says of lens, board, sheet and stage, and add what the "
        "photographs ask for: more terms of the lens, a board that bends, a sheet that is bowed, a stage that is not "
        "straight. Each is added where photographs that were held out are predicted better with it, and the result "
        "says what "
        "and why; what an option names stays as it is. given: only what session and options say",
    )
    parser.add_argument(
        "--lens",
        metavar="LENS",
        help="none, radial1, radial2, radial3, brown, rational, fisheye or splined, in place of the session's "
        "(default: radial1); splined has a smooth field of shifts on top of brown's terms, for a lens that no formula "
        "describes; --camera brings its own",
    )
    parser.add_argument(
        "--hold",
        action="append",
        type=_names,
        default=[],
        metavar="NAME[,NAME]",
        help="do not estimate this parameter, named as in rig.json: camera.focal.0 and .1, "
        "camera.principal.0 and .1; camera.radial.0 to .5 are k1 to k6, camera.tangential.0 and .1 are p1 and p2. It "
        "keeps the value of --camera; without one a lens term is held at 0. Those of light and stage, as "
        "motion.stage.per_step.0, need a rig.json there. `--lens brown` is OpenCV's default, "
        "k1 k2 p1 p2 k3; with `--hold camera.radial.2` it is that of Bouguet's "
        "toolbox, k1 k2 p1 p2",
    )
    parser.add_argument(
        "--free",
        action="append",
        type=_names,
        default=[],
        metavar="NAME[,NAME]",
        help="estimate a lens term although it is 0 in the file of --camera, where it was mostly held, or the session "
        "holds it; without this it stays 0",
    )
    parser.add_argument(
        "--tilt",
        action="store_true",
        help="find the tilt of the sensor against the lens too, of a Scheimpflug camera: two angles more, which only "
        "the lens's distortion distinguishes from the principal point",
    )
    parser.add_argument(
        "--sheet",
        metavar="KIND",
        help="what the laser makes, in place of the session's: plane, or bowed, a sheet that is curved across its fan "
        "by one more number, as a line lens makes it that is not quite square to its beam (default: plane)",
    )
    parser.add_argument(
        "--board-shape",
        metavar="SHAPE",
        help="what of the board's shape is found too, in place of the session's: flat, nothing (the default); bulge, "
        "along columns and rows; warp, also twist and edges; bend, also its bulges in each photograph",
    )
    parser.add_argument(
        "--motion",
        dest="stage_motion",
        metavar="KIND",
        help="how the stage moves, in place of the session's: linear, a line in equal steps (the default); guide, a "
        "bowed path on which the load turns; screw, to and fro about equal steps with the turns of its screw; "
        "screw_on_guide, both; each of these with _with_play behind its name, as linear_with_play: with play it stops "
        "elsewhere when it comes back, which photographs in both directions show",
    )
    parser.add_argument(
        "--since",
        metavar="PHOTOGRAPH",
        help="leave out the photographs before this one, named as the results name it, where something was moved or "
        "refocused before it",
    )
    parser.add_argument(
        "--split",
        metavar="PHOTOGRAPH",
        help="solve the photographs before this one and those from it on as two parts, where something was moved or "
        "refocused between them: which of focus, principal point, distortion, sheets of light and axes differ is found "
        "from the photographs, all else from both parts together. RIG is the rig from this photograph on; "
        "RIG with .before in its name is the rig before. The model is what session and options say",
    )
    parser.add_argument(
        "--plain",
        action="store_true",
        help="plain least squares over all corners, the estimate that OpenCV and Bouguet's toolbox make, to compare "
        "with them. What it gives up: no outlier is left out, a blurred photograph counts like a sharp one, and what "
        "the detector knows of each corner is not used",
    )


def estimate_asked(args: argparse.Namespace) -> Estimate:
    """What the arguments of `add_estimate_arguments` say.

    Raises:
        InputError: they contradict each other, or --camera.
    """
    hold, free = (tuple(name for names in given for name in names) for given in (args.hold, args.free))
    if both := sorted(set(hold) & set(free)):
        raise InputError(f"--hold and --free both name {', '.join(both)}: keep one of them")
    if args.split is not None and args.since is not None:
        raise InputError(
            f"--split {args.split} and --since {args.since}: one solves the photographs before as a separate part, "
            "the other leaves them out: keep one of them"
        )
    if args.lens is not None:
        from jaxscan.rig.kinds import lens_of_kind

        lens_of_kind(args.lens)
        if args.camera is not None:
            raise InputError("--lens and --camera: the camera of a file brings its own lens, so leave out one of them")
    if args.sheet is not None:
        from jaxscan.rig.kinds import LIGHTS

        if args.sheet not in LIGHTS:
            raise InputError(f"--sheet {args.sheet}: this version knows {', '.join(LIGHTS)}")
    if args.board_shape is not None:
        from jaxscan.rig.board_shape import BOARD_SHAPES

        if args.board_shape not in BOARD_SHAPES:
            raise InputError(f"--board-shape {args.board_shape}: there are {', '.join(BOARD_SHAPES)}")
    if args.stage_motion is not None:
        from jaxscan.files.session_axes import stage_motions

        if args.stage_motion not in stage_motions():
            raise InputError(f"--motion {args.stage_motion}: a stage's is one of {', '.join(stage_motions())}")
    return Estimate(
        args.lens,
        hold,
        free,
        args.plain,
        args.sheet,
        args.board_shape,
        args.since,
        args.split,
        args.tilt,
        args.stage_motion,
        args.model,
    )


def _names(text: str) -> Sequence[str]:
    """The names of a comma list."""
    return [name for name in (part.strip() for part in text.split(",")) if name]
