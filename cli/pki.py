"""Verbs for certificates: create all, issue one, check them."""

from __future__ import annotations

import datetime as dt
import os
import secrets
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option, Typer, echo

from cli.context import (
    NOT_WELL,
    CellOption,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from common.security.pki import Pair

app = Typer(no_args_is_help=True, help="Certificates for a bus that other machines use.")

IMAGE_USER = 10001  # as in the Dockerfile
DAYS = 365
WRITTEN = ("calibration", "recordings")  # as in docker-compose.yml

FolderOption = Annotated[
    Path | None,
    Option(
        "--folder",
        envvar="FORCEMESH_PKI",
        metavar="DIR",
        help="Folder; default: ~/.config/forcemesh/pki/<cell>.",
    ),
]
HostOption = Annotated[
    list[str] | None,
    Option(
        "--host",
        metavar="NAME",
        help="Name or address of this machine for others; repeatable.",
    ),
]
DaysOption = Annotated[int, Option(min=1, max=3650, help="Validity [days].")]
AgainOption = Annotated[bool, Option("--again", help="Replace existing files.")]


@app.command()
def init(
    *,
    host: HostOption = None,
    days: DaysOption = DAYS,
    again: AgainOption = False,
    authority: Annotated[
        Path | None,
        Option(metavar="DIR", help="Use the authority of this folder: shared by cells."),
    ] = None,
    env: Annotated[
        Path | None,
        Option(metavar="FILE", help="Write the settings for docker compose to FILE (.env)."),
    ] = None,
    folder: FolderOption = None,
    cell: CellOption = None,
) -> None:
    """Create the authority and a certificate for every role and person of a cell."""
    from common.security.pki import make_authority, read_authority, write_pair
    from forcemesh.identity import AUTHORITY, NAMES, PAGE
    from services.panel.access import TOKEN_VARIABLE

    with one_line_errors():
        loaded, pki_folder = _cell_and_folder(cell, folder)
        if (pki_folder / f"{AUTHORITY}.pem").exists() and not again:
            exit_with_error(
                f"{pki_folder} already has an authority: `forcemesh pki issue NAME` adds a "
                "certificate, --again creates a new authority, after which all old certificates "
                "are refused"
            )
        if authority is None:
            pair = make_authority(loaded.cell, _now())
            write_pair(pki_folder, AUTHORITY, pair, owner=None)
            _copy_authority(pki_folder, pki_folder)
        else:
            pair = read_authority(authority.expanduser())
            _copy_authority(authority.expanduser(), pki_folder)
        of_page = _page_authority(loaded, pki_folder, again=again)
        for name in (*NAMES, PAGE):
            signer = of_page if name == PAGE else pair
            _issue_certificate(signer, name, loaded, pki_folder, hosts=host or [], days=days)
        echo(f"{pki_folder}: an authority and {len(NAMES)} certificates, {days} days")
        user = ":".join(map(str, _owner() or (os.getuid(), os.getgid())))
        lines = [f"FORCEMESH_PKI={pki_folder}", f"FORCEMESH_USER={user}"]
        if env is not None:
            lines.append("FORCEMESH_BUS=tls")
            token = f"{TOKEN_VARIABLE}={secrets.token_hex(16)}"
            folders = [f"FORCEMESH_{name.upper()}=./{name}" for name in WRITTEN]
            _write_env(env, [*lines, *folders, token])
            for name in WRITTEN:  # by containers, as the image's user
                written = env.resolve().parent / name
                written.mkdir(exist_ok=True)
                if (owner := _owner()) is not None and written.stat().st_uid == 0:
                    os.chown(written, *owner)
        echo("for docker compose, in the file .env: " + " ".join(lines))


@app.command()
def issue(
    name: Annotated[
        str,
        Argument(help="A role, operator, monitor, panel; panel-page for browsers (HTTPS)."),
    ],
    *,
    host: HostOption = None,
    days: DaysOption = DAYS,
    again: AgainOption = False,
    to: Annotated[
        Path | None,
        Option(metavar="DIR", help="Write to DIR, with the authority's certificate."),
    ] = None,
    folder: FolderOption = None,
    cell: CellOption = None,
) -> None:
    """Issue one certificate: before the old one expires, or for another machine."""
    from common.security.pki import read_authority
    from forcemesh.identity import HUB, NAMES, PAGE

    with one_line_errors():
        loaded, pki_folder = _cell_and_folder(cell, folder)
        if name not in (*NAMES, PAGE):
            exit_with_error(f"unknown name {name!r}: choose from {', '.join((*NAMES, PAGE))}")
        if host and name not in (HUB, PAGE):
            exit_with_error(f"--host is for hub and {PAGE} only: {name} accepts no connections")
        target = pki_folder if to is None else to.expanduser()
        if (target / f"{name}.pem").exists() and not again:
            exit_with_error(f"{target / name}.pem exists already: --again replaces it")
        of_page = name == PAGE
        signer = _page_authority(loaded, pki_folder) if of_page else read_authority(pki_folder)
        _issue_certificate(signer, name, loaded, target, hosts=host or [], days=days)
        if to is not None and not of_page:
            _copy_authority(pki_folder, target)
        echo(f"{target}/{name}.pem, {name}.key: {days} days")


@app.command()
def check(folder: FolderOption = None, cell: CellOption = None) -> None:
    """Check every certificate; print a remedy for each that is not valid."""
    from common.security.pki_check import check_folder

    with one_line_errors():
        loaded, pki_folder = _cell_and_folder(cell, folder)
        found = check_folder(pki_folder, loaded.cell, _now())
    same = (f" --cell {cell}" if cell else "") + (f" --folder {folder}" if folder else "")
    for finding in found:
        more_options = same if "forcemesh pki" in finding.remedy else ""
        remedy = f"  -> {finding.remedy}{more_options}" if finding.remedy else ""
        echo(f"{finding.verdict:5} {finding.name}: {finding.text}{remedy}")
    if any(finding.verdict == "wrong" for finding in found):
        raise Exit(NOT_WELL)


def _cell_and_folder(cell: Path | None, folder: Path | None) -> tuple[CellConfig, Path]:
    from common.config.load import load_cell
    from forcemesh.identity import folder_of

    loaded = load_cell(find_cell_file(cell))
    return loaded, folder_of(loaded) if folder is None else folder.expanduser().resolve()


def _issue_certificate(
    authority: Pair, name: str, cell: CellConfig, folder: Path, *, hosts: list[str], days: int
) -> None:
    from common.security.pki import make_certificate, write_pair
    from forcemesh.identity import HUB, PAGE

    own = [] if name == PAGE else [HUB]
    names = dict.fromkeys([*own, "localhost", "127.0.0.1", "::1", socket.gethostname(), *hosts])
    pair = make_certificate(authority, name, cell.cell, hosts=[*names], days=days, now=_now())
    write_pair(folder, name, pair, owner=_owner())


def _page_authority(cell: CellConfig, folder: Path, *, again: bool = False) -> Pair:
    """Return the authority of the panel's page; create it if there is none."""
    from common.security.pki import make_authority, read_authority, write_pair
    from forcemesh.identity import PAGE_AUTHORITY

    if again or not (folder / f"{PAGE_AUTHORITY}.pem").exists():
        pair = make_authority(cell.cell, _now(), of_page=True)
        write_pair(folder, PAGE_AUTHORITY, pair, owner=None)
    return read_authority(folder, PAGE_AUTHORITY)


def _copy_authority(source: Path, target: Path) -> None:
    """Copy the authority's certificate, never its key, to another folder."""
    from common.security.pki import copy_certificate
    from forcemesh.identity import AUTHORITY

    copy_certificate(source, target, AUTHORITY, owner=_owner())


def _owner() -> tuple[int, int] | None:
    """Return the owner of the files: root creates them for the user of the image."""
    return (IMAGE_USER, IMAGE_USER) if os.geteuid() == 0 else None


def _write_env(path: Path, lines: list[str]) -> None:
    """Write lines into a settings file, replacing older ones of the same names.

    It holds the panel's token: only the owner of the folder can read it, also during the write.
    """
    from common.config.state_file import replace_file

    names = tuple(line.partition("=")[0] + "=" for line in lines)
    old = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    other_lines = [line for line in old if not line.startswith(names)]
    folder = path.resolve().parent.stat()
    owner = (folder.st_uid, folder.st_gid) if os.geteuid() == 0 else None
    replace_file(path, "\n".join([*other_lines, *lines]) + "\n", mode=0o600, owner=owner)


def _now() -> dt.datetime:
    return dt.datetime.now(dt.UTC)
