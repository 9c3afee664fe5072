"""`scanner serve`: the lab server."""

import argparse
import ipaddress
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_data_argument, add_scanner_arguments, say

if TYPE_CHECKING:
    from hardware.scan import Devices

HELP: Final = "serve the scanner to browsers and programs: one operates, the others watch"
EXAMPLE: Final = (
    "scanner user add maria --admin\n"
    "  scanner serve                                            # then open http://127.0.0.1:8003/ and sign in\n"
    "  scanner serve --rig rig.json                             # with points in millimetres, and PLY files\n"
    "  scanner serve --host 0.0.0.0 --cert lab.pem --key lab.key   # for the whole network\n"
    "  scanner serve --behind-proxy 127.0.0.1 --name lab.example.org   # behind a proxy with TLS on this machine"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_data_argument(parser)
    parser.add_argument("--rig", type=Path, metavar="FILE", help="the scanner's rig, as jaxscan calibrate writes it")
    parser.add_argument("--host", default="127.0.0.1", help="where to listen (default: 127.0.0.1, this machine alone)")
    parser.add_argument("--port", type=int, default=8003, help="(default: 8003; 0 for any that is free)")
    parser.add_argument("--cert", type=Path, metavar="PEM", help="certificate for TLS, with its chain")
    parser.add_argument("--key", type=Path, metavar="PEM", help="its private key")
    parser.add_argument(
        "--insecure", action="store_true", help="listen beyond this machine without TLS: passwords can be read"
    )
    parser.add_argument(
        "--behind-proxy",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="a proxy with TLS that sets X-Forwarded-For and X-Forwarded-Proto, which are trusted; may be repeated",
    )
    parser.add_argument(
        "--name",
        action="append",
        default=[],
        metavar="HOST",
        help="a name by which browsers know this server, beside its addresses and this machine's; may be repeated",
    )
    parser.add_argument(
        "--lease", type=float, default=15.0, metavar="S", help="how long a silent operator keeps the scanner (15 s)"
    )
    parser.add_argument("--live", type=float, default=1.0, metavar="S", help="between two live pictures (1 s)")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Serve until interrupted."""
    from hardware.devices import open_scanner, read_scanner
    from jaxscan.cli.compiled import keep_compiled
    from jaxscan.cli.process import INTERRUPTED
    from jaxscan.errors import InputError
    from jaxscan.extras import extra

    settings = read_scanner(args.scanner)
    if not 1 <= args.lease <= 3600 or not 0.05 <= args.live <= 3600:
        raise InputError(f"--lease {args.lease:g} --live {args.live:g}: give 1 to 3600 s, and 0.05 to 3600 s")
    if not 0 <= args.port < 1 << 16:
        raise InputError(f"--port {args.port}: give 0 to 65535")
    for proxy in args.behind_proxy:
        try:
            ipaddress.ip_address(proxy)
        except ValueError as error:
            raise InputError(f"--behind-proxy {proxy}: is no IP address: give the proxy's, as 127.0.0.1") from error
    extra("lab")
    from hardware.lab.gate import raise_limit
    from hardware.lab.lab import Lab
    from hardware.lab.server import Server, bind, check_tls
    from hardware.lab.worker import Habits

    tls = check_tls(args.cert, args.key)
    rig = None
    if args.rig is not None:
        from jaxscan import read_rig

        rig = read_rig(args.rig)
        for warning in rig.warnings:
            say(f"warning: {args.rig}: {warning}.")
    habits = Habits(settings.travels, settings.stripe, settings.exposure_s, settings.gain, settings.simulated)
    listening = bind(args.host, args.port, tls, args.insecure)

    def connect() -> "Devices":
        if settings.camera.values["kind"] == "simulated":
            keep_compiled()
        return open_scanner(settings, args.seed, args.homed)

    # What a scan writes is for the eyes of the lab's user alone, as its folder is.
    os.umask(0o077)
    raise_limit()
    lab = Lab(args.data, connect, habits, rig, args.lease, args.live)
    try:
        if not lab.accounts.everybody():
            raise InputError(f"{args.data}: nobody is registered yet: scanner user add NAME --admin")
        say(f"scanner: {settings.path or 'simulated, there is no scanner.toml'}; data: {args.data}")
        server = Server(
            lab,
            listening,
            args.cert,
            args.key,
            lambda url: say(f"serving at {url}"),
            tuple(args.behind_proxy),
            (args.host, *args.name),
        )
        server.serve_here()
    except KeyboardInterrupt:
        lab.close()
        if lab.alive:
            # Nobody sees it any more; an interpreter that ends under JAX's compiler would be aborted.
            print("scanner: interrupted", file=sys.stderr, flush=True)
            os._exit(INTERRUPTED)
        raise
    finally:
        lab.close()
        listening.close()


def describe(result: dict[str, Any]) -> str:
    """Everything has been said."""
    return ""
