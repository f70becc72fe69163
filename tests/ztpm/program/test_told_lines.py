"""Refusals on standard error: told at once, not twice in a second, none lost, and nobody waits."""

import threading

from hypothesis import given
from hypothesis import strategies as st
from ztpm.program.refusal_lines import DIFFERENT, NAME, SECOND_S, WAITING, RefusalLines, Repeats

BUSY, DENIED = "BUSY: one", "NOT_GRANTED: two"


def test_the_first_is_said_at_once_and_its_like_once_a_second():
    repeats = Repeats()
    assert repeats.told(BUSY, at_s=10.0) == [f"{NAME}: {BUSY}"]
    assert repeats.next_s is None
    for n in range(12):
        assert repeats.told(BUSY, at_s=10.05 + n / 20) == []
    assert repeats.told(DENIED, at_s=10.9) == [f"{NAME}: {DENIED}"]
    assert repeats.next_s == 10.0 + SECOND_S
    assert repeats.due(at_s=10.99) == []
    assert repeats.due(at_s=11.0) == [f"{NAME}: {BUSY} (12 more)"]
    assert repeats.told(BUSY, at_s=11.5) == []
    assert repeats.rest() == [f"{NAME}: {BUSY} (1 more)"]


def test_after_a_quiet_second_it_is_new_again():
    repeats = Repeats()
    repeats.told(BUSY, at_s=10.0)
    assert repeats.due(at_s=11.0) == []
    assert repeats.told(BUSY, at_s=11.1) == [f"{NAME}: {BUSY}"]


def test_nothing_that_does_not_print_reaches_a_terminal():
    (line,) = Repeats().told("BUSY: a\x1b[2Jb\nc\r\x07\x9b\u202e\x00d", at_s=0.0)
    assert line == (f"{NAME}: BUSY: a⟨U+001B⟩[2Jb⟨U+000A⟩c⟨U+000D⟩⟨U+0007⟩⟨U+009B⟩⟨U+202E⟩⟨U+0000⟩d")


def test_texts_that_all_differ_are_counted_together():
    repeats = Repeats()
    said = [line for n in range(500) for line in repeats.told(f"BUSY: {n}", at_s=10.0)]
    assert len(said) == DIFFERENT
    (rest,) = repeats.rest()
    assert rest.endswith(f"({500 - DIFFERENT} more)")


@given(st.lists(st.tuples(st.sampled_from([BUSY, DENIED, "OTHER: x"]), st.floats(0.0, 0.7)), max_size=60))
def test_no_line_comes_twice_in_a_second_and_every_text_counts(told):
    repeats, at_s, lines = Repeats(), 0.0, []
    for text, after_s in told:
        at_s += after_s
        lines += [(at_s, line) for line in repeats.told(text, at_s=at_s)]
    counted = sum(1 if "more" not in line else int(line.split("(")[1].split()[0]) for _, line in lines)
    for text in {text for text, _ in told}:
        times = [at for at, line in lines if line.startswith(f"{NAME}: {text}")]
        assert all(b - a >= SECOND_S for a, b in zip(times, times[1:], strict=False))
    counted += sum(int(line.split("(")[1].split()[0]) for line in repeats.rest())
    assert counted == len(told)


def test_what_was_told_is_written_before_it_is_left():
    lines = []
    with RefusalLines(lines.append) as told:
        for _ in range(3):
            told.tell(BUSY)
    assert lines == [f"{NAME}: {BUSY}", f"{NAME}: {BUSY} (2 more)"]


def test_who_tells_does_not_wait_for_who_reads():
    """Nobody reads; all of this returns, and the end comes too."""
    nobody, begun = threading.Event(), threading.Event()

    def stuck(line):
        begun.set()
        nobody.wait(30)

    def tells():
        with RefusalLines(stuck) as told:
            told.tell(BUSY)
            begun.wait(10)
            for n in range(2 * WAITING):
                told.tell(f"{BUSY} {n}")

    telling = threading.Thread(target=tells, daemon=True)
    telling.start()
    telling.join(10)
    assert begun.is_set()
    assert not telling.is_alive()
    nobody.set()


def test_a_count_is_said_when_its_second_is_over():
    lines, seen = [], threading.Event()

    def write(line):
        lines.append(line)
        if "more" in line:
            seen.set()

    with RefusalLines(write) as told:
        told.tell(BUSY)
        told.tell(BUSY)
        assert seen.wait(10), "though nothing else comes"
    assert lines == [f"{NAME}: {BUSY}", f"{NAME}: {BUSY} (1 more)"]
