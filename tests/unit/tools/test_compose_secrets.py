"""docker-compose.yml has the secrets of the table of roles."""

from tools.compose_secrets import FILE, TEXT, WITHOUT, secrets, with_secrets


def test_the_secrets_are_generated_from_the_table_of_roles() -> None:
    """`make readme` writes them, and the file that stands for each until `make pki`."""
    text = FILE.read_text(encoding="utf-8")
    assert text == with_secrets(text)
    found = {path.name: path.read_text(encoding="utf-8") for path in WITHOUT.iterdir()}
    assert found == dict.fromkeys(secrets(), TEXT)
