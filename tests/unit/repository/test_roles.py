"""Every other list of roles agrees with the table of roles, or names the one that it lacks."""

import pytest

from common.bus.profile_label import IMPLEMENTATIONS
from forcemesh.topics import HELPERS, ROLE_TABLE, ROLES, Role
from tests.fakes.compose_file import ROOT, SERVICES, roles_of
from tests.hostile import client

each_row = pytest.mark.parametrize("row", ROLE_TABLE, ids=lambda row: row.name)


@each_row
def test_each_implementation_has_a_container(row: Role) -> None:
    """docker-compose.yml starts every module of the table under a name of its own."""
    started = {SERVICES[name]["command"][2] for name in SERVICES if row.name in roles_of(name)}
    assert started == {module for module in row.modules.values() if module}


@each_row
@pytest.mark.parametrize(
    ("page", "words"),
    [
        ("docs/bus.md", "| `{name}/health` | {name} |"),  # written by tools/pages.py
        ("docs/install.md", "`{name}`"),  # the table of certificates
    ],
)
def test_each_page_has_the_role(row: Role, page: str, words: str) -> None:
    """A user finds the role where keys and rights are listed."""
    assert words.format(name=row.name) in (ROOT / page).read_text(encoding="utf-8")


def test_the_lists_of_roles_agree() -> None:
    """Needed roles and helpers are the table; the hostile client has a list of its own."""
    assert sorted((*ROLES, *HELPERS)) == sorted(row.name for row in ROLE_TABLE)
    assert client.ROLES == ROLES


@pytest.mark.parametrize("role", ["robot", "sensor"])
def test_each_implementation_fits_a_profile_of_containers(role: str) -> None:
    """A cell file with any implementation can run in containers, and no profile names another."""
    (row,) = (row for row in ROLE_TABLE if row.name == role)
    named = {word for plays in IMPLEMENTATIONS.values() for word in plays[role]}
    assert named == set(row.modules)
