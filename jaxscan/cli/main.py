"""A program of commands: finds the one that was asked for, runs it, and turns its errors into words and statuses.

Each command is a module of its own with

    HELP                        one line
    EXAMPLE                     one command line that works
    add_arguments(parser)       its arguments
    run(args) -> dict | None    its work; the result as plain numbers, texts, lists and dicts, for `--json`
    describe(result) -> str     the result in words

and imports whatever is slow to import inside `run`, so that `--help` answers at once.
"""

import argparse
import importlib
import json
import os
import re
import sys
import traceback
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import takewhile
from typing import Any, Final, NoReturn, Protocol

from jaxscan.cli.compiled import cache_warning
from jaxscan.cli.process import INTERRUPTED, run_as_process
from jaxscan.cli.progress import say, working
from jaxscan.errors import InputError, JaxscanError

COMMANDS: Final = {
    "board": "jaxscan.cli.board",
    "calibrate": "jaxscan.cli.calibrate",
    "reconstruct": "jaxscan.cli.reconstruct",
    "profiles": "jaxscan.cli.profiles",
    "batch": "jaxscan.cli.batch",
    "mesh": "jaxscan.cli.mesh",
    "merge": "jaxscan.cli.merge",
    "compare": "jaxscan.cli.compare",
    "measure": "jaxscan.cli.measure",
    "accept": "jaxscan.cli.accept",
    "view": "jaxscan.cli.view",
    "gauge": "jaxscan.cli.gauge",
    "inspect": "jaxscan.cli.inspect",
    "convert": "jaxscan.cli.convert",
    "simulate": "jaxscan.cli.simulate",
    "demo": "jaxscan.cli.demo",
}

DONE, FAILED, BAD_INPUT = 0, 1, 2


class Command(Protocol):
    """What the module of a command offers."""

    HELP: str
    EXAMPLE: str

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments."""
        ...

    @staticmethod
    def run(args: argparse.Namespace) -> dict[str, Any] | None:
        """Do the work; progress goes to standard error."""
        ...

    @staticmethod
    def describe(result: dict[str, Any]) -> str:
        """The result in words."""
        ...


@dataclass(frozen=True)
class Program:
    """A program.

    Attributes:
        name: as it is typed.
        description: one sentence.
        commands: the module of each.
        errors: what its commands raise on purpose, beside `JaxscanError`.
        shows_work: the commands of which it is shown what they are doing while they say nothing else.
    """

    name: str
    description: str
    commands: Mapping[str, str]
    errors: tuple[type[Exception], ...] = ()
    shows_work: Collection[str] = ()


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line of `jaxscan` and return its exit status, as `run_program`."""
    description = "Calibrate a laser line scanner, and turn its photographs into points."
    return run_program(Program("jaxscan", description, COMMANDS, shows_work=COMMANDS), argv)


def entry() -> NoReturn:
    """The process `jaxscan`."""
    # Its matrices are small: in a scan, threads of OpenBLAS wait for each other for a second of processor time. NumPy
    # asks for it when it is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    run_as_process(main)


def run_program(program: Program, argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status: 0 done, 1 failed, 2 bad input or usage, 130 interrupted."""
    try:
        args = parser_of(program).parse_args(argv)
    except SystemExit as ended:  # argparse has said what was wrong, or has printed the help
        return ended.code if isinstance(ended.code, int) else DONE
    try:
        with _warnings_in_words(program):
            return _run(args, program.shows_work)
    except KeyboardInterrupt:
        return _complain(program, "interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone, `| head` for one; Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:  # noqa: BLE001 (the outermost boundary: nothing may reach the user as a traceback)
        if args.debug or os.environ.get("JAXSCAN_DEBUG"):
            traceback.print_exc()
        return _complain(program, _in_words(program, error), BAD_INPUT if isinstance(error, InputError) else FAILED)


def _run(args: argparse.Namespace, shows_work: Collection[str]) -> int:
    command: Command = args.command
    with working(args.command_name) if args.command_name in shows_work else nullcontext():
        result = command.run(args)
    if args.json:
        print(json.dumps(result, ensure_ascii=False, allow_nan=False, indent=2))
    elif result is not None:
        print(command.describe(result))
    sys.stdout.flush()
    # Of many things that were asked for, some were not done.
    return FAILED if result and result.get("failed") else DONE


def _complain(program: Program, text: str, status: int) -> int:
    print(f"{program.name}: {text}", file=sys.stderr)
    return status


def _in_words(program: Program, error: Exception) -> str:
    if isinstance(error, (JaxscanError, *program.errors)):
        return f"error: {error}"
    if isinstance(error, OSError):
        return f"error: {error.filename or ''}{': ' if error.filename else ''}{error.strerror or error}"
    return (
        f"unexpected error: {type(error).__name__}: {error}\n"
        f"This is a fault of {program.name}. Run the command again with --debug and report what it prints."
    )


@contextmanager
def _warnings_in_words(program: Program) -> Iterator[None]:
    """Warnings as one line each, without the place in the source that only a programmer needs."""

    def shown(message: Warning | str, *_: object) -> None:
        if (text := cache_warning(str(message))) is not None:
            say(f"{program.name}: warning: {text}")

    with warnings.catch_warnings():
        warnings.showwarning = shown
        yield


def parser_of(program: Program) -> argparse.ArgumentParser:
    """The program's command line."""
    parser = _Parser(
        prog=program.name,
        description=program.description,
        epilog="exit status: 0 done, 1 failed, 2 bad input or usage, 130 interrupted",
    )
    parser.add_argument("--version", action=_Version)
    common = _Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="print the result as JSON on standard output")
    common.add_argument("--debug", action="store_true", help="show where an error arose (as does JAXSCAN_DEBUG=1)")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, module in program.commands.items():
        command: Any = importlib.import_module(module)
        sub = commands.add_parser(
            name,
            help=command.HELP.replace("%", "%%"),
            description=command.HELP[0].upper() + command.HELP[1:] + ".",
            epilog=f"example:\n  {command.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            parents=[common],
        )
        command.add_arguments(sub)
        sub.set_defaults(command=command, command_name=name)
    return parser


class _Parser(argparse.ArgumentParser):
    """Takes what starts with a minus and a digit for a value, as Python does from 3.14 on; -1,2,3 and -1e-3 too.

    An option that is none is refused by the command that it was given to, before what is missing (which may be that
    option, misspelt) and with the nearest there is.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Iterable[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As argparse has it, but nothing is left over."""
        given = sys.argv[1:] if args is None else list(args)
        for text in takewhile(self._is_own, given):
            option = text.partition("=")[0]
            # argparse takes the beginning of an option for the whole, and what has a space in it for a value.
            known = any(own.startswith(option) for own in self._option_string_actions)
            if option.startswith("--") and not known and " " not in text:
                self._refuse([option])
        namespace, extras = super().parse_known_args(given, namespace)
        several = next((each for each in self._get_positional_actions() if each.nargs in ("+", "*")), None)
        if extras and several and not any(text.startswith("-") for text in extras):
            # argparse fills a list of files from those before the first option alone.
            listed = [*getattr(namespace, several.dest), *self._get_values(several, extras)]
            setattr(namespace, several.dest, listed)
            extras = []
        if extras:
            self._refuse(extras)
        return namespace, extras

    def error(self, message: str) -> NoReturn:
        """Without the usage, which is longer than a screen for some commands and hides the sentence."""
        self.exit(BAD_INPUT, f"{self.prog}: error: {message}\n{self.prog} --help lists what it takes\n")

    def _is_own(self, text: str) -> bool:
        """Whether options are to come still: none after --, and after a command its own."""
        return text != "--" and (self._subparsers is None or text.startswith("-"))

    def _refuse(self, extras: Sequence[str]) -> NoReturn:
        self.error(f"unrecognized arguments: {' '.join(extras)}{_meant(extras[0], self._option_string_actions)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += _meant(str(value), map(str, action.choices or ()))
            raise


def _meant(typed: str, known: Iterable[str]) -> str:
    """A question after what is like it, where something is."""
    nearest = get_close_matches(typed, known, n=1)
    return f"; did you mean {nearest[0]}?" if nearest else ""


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: importlib.metadata is slow to import."""

    def __init__(self, option_strings: Sequence[str], dest: str):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the version and exit."""
        from importlib.metadata import version

        print(f"{parser.prog} {version('jaxscan')}")
        parser.exit()
