"""Every seed of the fuzz targets, and whatever once broke one, is replayed without the fuzzer."""

import importlib
from pathlib import Path

import pytest

from tests.fuzz import streams
from tests.fuzz.framer import frame
from tests.fuzz.seeds import CONVERSATIONS, conversation, gateway_seeds, receiver_seeds
from tests.fuzz.targets import SEEDS, TARGETS, seeds


@pytest.mark.parametrize(
    ("target", "seed"), [(target, seed) for target in TARGETS for seed in seeds(target)]
)
def test_a_seed_has_the_property_of_its_target(target: str, seed: Path) -> None:
    """The claim is the first paragraph of the target's module."""
    importlib.import_module(f"tests.fuzz.{target}").check(seed.read_bytes())


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_lists_its_needs_and_has_seeds_that_fit(target: str) -> None:
    """The fuzzer cuts longer seeds off, which would make something else of them."""
    module = importlib.import_module(f"tests.fuzz.{target}")
    assert all(len(seed.read_bytes()) <= module.MAX_BYTES for seed in seeds(target))
    assert callable(module.check)


def test_the_written_seeds_are_those_of_the_table() -> None:
    """`python -m tests.fuzz.seeds` has been run since tests/fuzz/seeds.py was changed."""
    for target, table in (("receiver", receiver_seeds()), ("gateway", gateway_seeds())):
        for name, data in table.items():
            assert (SEEDS / target / name).read_bytes() == data


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_the_reference_takes_the_packets_before_the_first_wrong_character(name: str) -> None:
    """Whatever one character is spoiled, packets before it count, and none from it on."""
    stream = conversation(CONVERSATIONS[name])
    whole = frame(stream)
    for at in range(0, len(stream), 11):
        spoiled = frame(stream[:at] + b"x" + stream[at + 1 :])
        before = max(0, at // 63 - 1)
        assert spoiled.packets == whole.packets[:before]
        assert spoiled.closed


def test_mutations_are_streams_that_mostly_go_deep() -> None:
    """The fuzzer's changes keep enough valid packets to reach the code behind the framing."""
    data = receiver_seeds()["feedback"]
    valid = [
        len(frame(streams.mutate(data, 2000, seed, lambda given, _: given)[1:]).packets)
        for seed in range(200)
    ]
    assert sum(count >= 2 for count in valid) > 100
    assert any(count < len(CONVERSATIONS["feedback"]) for count in valid)
