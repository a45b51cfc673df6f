"""The table of contracts: what is missing, invented, or not shown to be tested is told."""

import pytest
from helpers import course_assignment

from tofrender.course.author import contracts


@pytest.fixture
def tiny(tmp_path):
    return course_assignment.write(tmp_path)


def told(tiny) -> str:
    return "\n".join(contracts.check(tiny))


def change(tiny, old: str, new: str, name: str = contracts.FILE_NAME) -> None:
    path = tiny.folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('says = ["A pulse."]', "says = []", "a0.pulse: no test and no remark for 'A pulse.'"),
        ('says = "In metres."', 'says = "In feet."', "no text of a0.range says 'In feet.'"),
        ('"test_range.py::test_range"', '"test_range.py::test_x"', "a0.range has no test"),
        ('mutants = ["quarter"]', "mutants = []", "must name a test and a mutant"),
        ('mutants = ["quarter"]', 'mutants = ["third"]', "there is no mutant third"),
        ('mutants = ["quarter"]', 'mutants = ["no_half"]', "no_half fails none of its tests"),
        ('problem = "a0.range"', 'problem = "a0.ring"', "the rubric has no problem a0.ring"),
        ("[[remark]]", "[[word]]", "[[word]]: must be [[contract]] or [[remark]]"),
        ("[[contract]]", "[[remark]]", "must have exactly problem, says"),
        ("[[contract]]", "[[contract", "contracts.toml: is not TOML"),
    ],
)
def test_what_does_not_hold_is_told_in_a_line(tiny, old, new, text):
    change(tiny, old, new)
    assert text in told(tiny)


def test_a_new_sentence_of_a_stub_or_the_handout_needs_an_entry(tiny):
    change(tiny, '"""In metres."""', '"""In metres. Never negative."""', "starter/wrapping.py")
    assert told(tiny) == ("contracts.toml: a0.range: no test and no remark for 'Never negative.'")
    change(tiny, "\nText.\n", "\n*Contract.* One; two.\n*Common mistakes.* Three.\n", "README.md")
    assert "no test and no remark for '*Contract.* One; two.'" in told(tiny)
    assert "Three" not in told(tiny)


def test_without_a_table_that_is_what_is_told(tiny):
    assert told(tiny) == ""
    (tiny.folder / contracts.FILE_NAME).unlink()
    assert told(tiny) == "contracts.toml: is missing"
