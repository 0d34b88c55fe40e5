"""`graspwatch token`: adding, listing and revoking tokens."""

import json
from typing import Annotated

import typer
from rich.table import Table

from app.cli.console import create_console, error_console
from app.cli.options import ConfigOption, DataOption, JsonOption, find_data_folder, prepare_known_data_folder
from app.messages.people import Role
from app.people import tokens
from config.load import load_settings

app = typer.Typer(
    help="Who may use the service: tokens of people and programs, kept as hashes in the data folder. As soon as there "
    "is one, everybody needs one.",
    no_args_is_help=True,
)
NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Whose: it stands beside all that is done with it.")]


@app.command()
def add(
    name: NameArgument,
    role: Annotated[
        Role,
        typer.Option(help="viewer: watches, and presses STOP; operator: also runs protocols; admin: also deletes."),
    ],
    expires: Annotated[
        float | None, typer.Option(min=0.01, max=36_500, metavar="DAYS", help="For so long; default: until revoked.")
    ] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Make a token and print it, once: it is kept nowhere.

    Example: graspwatch token add Ada --role operator --expires 30
    """
    token = tokens.add_token(prepare_known_data_folder(data, load_settings(config)), name, role, expires)
    error_console.print(f"The token of {name}, {role.value}. It is shown this once:", soft_wrap=True)
    print(token)


@app.command("list")
def list_(config: ConfigOption = None, data: DataOption = None, as_json: JsonOption = False) -> None:
    """Who has or had a token.

    Example: graspwatch token list
    """
    people = tokens.read_tokens(find_data_folder(data, load_settings(config)))
    if as_json:
        print(json.dumps([entry.model_dump(mode="json", exclude={"sha256"}) for entry in people], indent=2))
        return
    table = Table(title="Tokens")
    for heading in ("Name", "Role", "Made", "State"):
        table.add_column(heading)
    for entry in people:
        table.add_row(entry.name, entry.role.value, f"{entry.created_at.astimezone():%Y-%m-%d}", entry.state_text)
    create_console().print(table)


@app.command()
def revoke(name: NameArgument, config: ConfigOption = None, data: DataOption = None) -> None:
    """Revoke a person's token: their open pages and streams end within a second.

    Example: graspwatch token revoke Ada
    """
    tokens.revoke_token(find_data_folder(data, load_settings(config)), name)
    error_console.print(f"The token of {name} is good for nothing any more.", soft_wrap=True)
