"""`scanner user`: who may use the lab."""

import argparse
import getpass
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_data_argument

if TYPE_CHECKING:
    from hardware.lab.accounts import Accounts

HELP: Final = "add, list and remove those who may use the lab server; set a password; make a token"
EXAMPLE: Final = (
    "scanner user add maria --admin        # asks for a password\n"
    "  scanner user password maria           # another one; sessions and tokens that there are end\n"
    "  scanner user token maria              # for a program: Authorization: Bearer …\n"
    "  scanner user list\n"
    "  scanner user remove maria"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("action", choices=("add", "password", "token", "remove", "list"), help="what to do")
    parser.add_argument("name", nargs="?", metavar="NAME", help="whom it is about; not for list")
    parser.add_argument("--admin", action="store_true", help="add: an administrator, who may take the scanner over")
    parser.add_argument(
        "--password-stdin", action="store_true", help="read the password from standard input, and do not ask"
    )
    add_data_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Do it."""
    from jaxscan.errors import InputError
    from jaxscan.extras import extra

    extra("lab")
    from hardware.lab.accounts import NAME, Accounts
    from hardware.lab.database import DATABASE, Database, make_folder

    data: Path = args.data
    if args.action != "list" and args.name is None:
        raise InputError(f"scanner user {args.action}: give a NAME")
    if args.action == "add":
        if not re.fullmatch(NAME, args.name):
            raise InputError(f"{args.name!r}: a name is up to 32 letters, digits, . _ and -, a letter or digit first")
        make_folder(data)
    elif not (data / DATABASE).is_file():
        raise InputError(f"{data}: there is no lab: scanner user add NAME --admin makes one")
    database = Database(data / DATABASE)
    try:
        return _do(args, Accounts(database))
    finally:
        database.close()


def _do(args: argparse.Namespace, accounts: "Accounts") -> dict[str, Any]:
    if args.action == "list":
        return {"users": [{"name": one.name, "administrator": one.administrator} for one in accounts.everybody()]}
    result = {"name": args.name, "action": args.action}
    # Whoever has typed a password twice should not learn only then that the name is wrong.
    if args.action == "add":
        accounts.check_free(args.name)
        accounts.add(args.name, _password(args), args.admin)
    elif args.action == "password":
        accounts.check_known(args.name)
        accounts.set_password(args.name, _password(args))
    elif args.action == "remove":
        accounts.remove(args.name)
    else:
        result["token"] = accounts.make_token_for(args.name)
    return result


def _password(args: argparse.Namespace) -> str:
    """The password from standard input, or entered twice at the terminal.

    Raises:
        InputError: the two differ, or there is no terminal to ask at.
    """
    from jaxscan.errors import InputError

    if args.password_stdin:
        return sys.stdin.readline().rstrip("\r\n")
    try:
        password, again = getpass.getpass(f"password for {args.name}: "), getpass.getpass("once more: ")
    except EOFError as error:
        raise InputError("no password was typed: type it at a terminal, or pipe it to --password-stdin") from error
    if again != password:
        raise InputError("the two passwords differ: try again")
    return password


def describe(result: dict[str, Any]) -> str:
    """What was done."""
    if "users" in result:
        lines = [f"{user['name']}{'  (administrator)' * user['administrator']}" for user in result["users"]]
        return "\n".join(lines or ["nobody is registered yet"])
    if "token" in result:
        return result["token"]
    return {
        "add": f"{result['name']} may sign in",
        "password": f"{result['name']} has another password; sessions and tokens have ended",
        "remove": f"{result['name']} is removed",
    }[result["action"]]
