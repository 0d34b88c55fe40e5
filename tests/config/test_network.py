"""Which hosts are well formed, and which of them are this computer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.network import is_loopback, is_this_computer, parse_authority

WELL_FORMED = {
    "localhost": ("localhost", None),
    "LocalHost:8000": ("localhost", 8000),
    "127.0.0.1:65535": ("127.0.0.1", 65_535),
    "[::1]:8000": ("[::1]", 8000),
    "[FE80::1]": ("[fe80::1]", None),
    "grasp-1.ward_3.example": ("grasp-1.ward_3.example", None),
    "xn--bcher-kva.example:1": ("xn--bcher-kva.example", 1),
    "a" * 63: ("a" * 63, None),
}
NOT_WELL_FORMED = [
    "",
    " ",
    ":",
    ":8000",
    "localhost:",
    "localhost: 8000",
    "localhost:0",
    "localhost:08000",
    "localhost:65536",
    "localhost:+80",
    "localhost:8000:8000",
    "localhost:８０",
    " localhost",
    "localhost ",
    "localhost\t",
    "localhost\n",
    "local host",
    "localhost.",
    "localhost..",
    ".localhost",
    "a..b",
    "-a.example",
    "a-.example",
    "a{b.example",
    "a}b.example",
    "a`b.example",
    'a"b.example',
    "a/b",
    "a\\b",
    "a?b",
    "a#b",
    "a%62",
    "a,b",
    "a;b",
    "user@localhost",
    "user:word@localhost:8000",
    "localhost@evil.example",
    "bücher.example",
    "localhoſt",
    "ⓛocalhost",
    "::1",
    "::1:8000",
    "[::1",
    "::1]",
    "[]",
    "[:]",
    "[::1]8000",
    "[::1]:",
    "[::1%lo]",
    "[::g]",
    "[127.0.0.1]",
    "[[::1]]",
    "[::1].example",
    "http://localhost",
    "//localhost",
    "*",
    "localhost\x00",
    "localhost\x7f",
    "a" * 64,
    ".".join(["a" * 60] * 5),
    "a." * 40_000,
]


@pytest.mark.parametrize("text", WELL_FORMED)
def test_a_well_formed_host_is_read(text: str) -> None:
    assert parse_authority(text) == WELL_FORMED[text]


@pytest.mark.parametrize("text", NOT_WELL_FORMED)
def test_anything_else_is_none(text: str) -> None:
    assert parse_authority(text) is None


@given(st.text(alphabet=st.sampled_from('a1.-:[]@%/ \\{"\tſK０\x00'), max_size=30))
def test_nothing_is_left_out_of_any_text(text: str) -> None:
    found = parse_authority(text)
    if found is not None:
        again = found.host if found.port is None else f"{found.host}:{found.port}"
        assert again == text.lower()


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.8.9.1", "::1", "[::1]"])
def test_what_listens_on_loopback_is_reached_from_here_alone(host: str) -> None:
    assert is_loopback(host)
    assert is_this_computer(host)


@pytest.mark.parametrize(
    "host",
    [
        "LOCALHOST",
        "localhost.",
        "tool.localhost",
        "127.1",
        "0x7f.1",
        "2130706433",
        "0.0.0.0",
        "::",
        "[::]",
        "::ffff:127.0.0.1",
        "0:0:0:0:0:0:0:1",
        "::1%lo",
    ],
)
def test_other_spellings_lead_here_too(host: str) -> None:
    assert is_this_computer(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "[::]", "tool.localhost", "127.1", "localhost."])
def test_what_listens_elsewhere_or_may_do_so_needs_tokens(host: str) -> None:
    assert not is_loopback(host)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "example",
        "localhost.example",
        "notlocalhost",
        "128.0.0.1",
        "10.0.0.5",
        "192.168.1.1",
        "fe80::1",
        "::2",
        "::ffff:10.0.0.5",
        "126.255.255.255",
        "1",
    ],
)
def test_other_computers_are_not_this_one(host: str) -> None:
    assert not is_loopback(host)
    assert not is_this_computer(host)
