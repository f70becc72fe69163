"""The URScript grammar: what is accepted, what its canonical text is, and that both hold for the real upload."""

import hashlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.rtde.script.script_text import render
from pep.rtde.script.urscript import LEVELS, ProgramStream, ScriptError, ScriptFault, parse
from tests.ursim.cell import upload

from pep.rtde.script import syntax_tree as t

PATH = ["movej([0.1,-1.5,1.5,-1.5,-1.5,0],a=1,v=1,r=0)", "movel(p[0.3,1e-05,-0,0,3.14,0],a=1.2,v=0.25,r=0.01)"]


def fixed_point(text):
    tree = parse(text)
    canonical = render(tree)
    assert parse(canonical) == tree
    assert render(parse(canonical)) == canonical
    return tree


# Lengths and digests of the complete upload as ur_rtde 1.6.5 was seen to send it.
@pytest.mark.parametrize(
    ("minor", "offset", "size", "digest"),
    [
        (11, 0, 42163, "596761a93dfb175355b26524"),
        (22, 24, 42165, "a09be6d4241a8fe761b2e0c5"),
        (25, 0, 50298, "5462851f747f0a22a3748c6e"),
        (26, 0, 50757, "b2e1dd66fc5f0ba0b9211ab8"),
    ],
)
def test_the_real_upload_is_a_fixed_point(minor, offset, size, digest):
    text = upload(5, minor, offset)
    assert (len(text), hashlib.sha256(text.encode()).hexdigest()[:24]) == (size, digest)
    tree = fixed_point(text)
    (program,) = tree.statements
    assert isinstance(program, t.Definition)
    assert program.name == "rtde_control"
    first, second = program.body[:2]  # the offset stands at the start of the next line
    assert (first.target.name, first.value) == ("reg_offset_float", t.Integer(offset))
    assert (second.target.name, second.value) == ("reg_offset_int", t.Integer(offset))


def test_a_path_block_is_read_as_written():
    tree = fixed_point(upload(path=PATH))
    (program,) = tree.statements
    moves = next(s for s in program.body if isinstance(s, t.Definition) and s.name == "exec_move_path").body
    assert [m.expression.function for m in moves[1:]] == ["signal_async_progress", "movej"] + [
        "signal_async_progress",
        "movel",
    ]
    pose = moves[4].expression.arguments[0].value
    assert isinstance(pose, t.PoseLiteral)
    assert pose.items[1:3] == (t.Real(1e-05), t.Unary("-", t.Integer(0)))


@pytest.mark.parametrize("word", ["nan", "inf", "-inf"])
def test_what_is_no_number_in_a_path_is_a_name_and_never_a_value(word):
    (statement,) = parse(f"movej([{word},0,0,0,0,0],a=1,v=1,r=0)\n").statements
    first = statement.expression.arguments[0].value.items[0]
    assert first in (t.Name(word), t.Unary("-", t.Name("inf")))


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("x=1+2*3", "x = 1 + 2 * 3"),
        ("x=(1+2)*3", "x = (1 + 2) * 3"),
        ("x=1-(2-3)", "x = 1 - (2 - 3)"),
        ("x=-2^2", "x = -2 ^ 2"),
        ("x=(-2)^2^-1", "x = (-2) ^ 2 ^ -1"),
        ("x=not a and b or c", "x = not a and b or c"),
        ("x=not (a and b)", "x = not (a and b)"),
        ("x=a==(not b)", "x = a == (not b)"),
        ("x=p [1,2,3,4,5,6]", "x = p[1, 2, 3, 4, 5, 6]"),
        ("x=p[2]", "x = p[2]"),
        ("x=m[1,2][3]", "x = m[1, 2][3]"),
        ("f('say \"no\"')", "f('say \"no\"')"),
        ("x=1.50e2", "x = 150.0"),
        ("x=0x1F", "x = 31"),
        ("global x", "global x"),
    ],
)
def test_canonical_text(text, canonical):
    assert render(fixed_point(text)) == canonical + "\n"


def test_a_value_on_the_next_line_is_not_returned():
    (program,) = fixed_point("def f():\nreturn\ng()\nend").statements
    assert program.body[0] == t.Return(None)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("x = 1 $ 2", ScriptFault.CHARACTER),
        ('x = "open', ScriptFault.CHARACTER),
        ("x = é", ScriptFault.CHARACTER),
        ("x = 1e999", ScriptFault.NUMBER),
        ("x = " + "1" * 65, ScriptFault.NUMBER),
        ("x = ", ScriptFault.SYNTAX),
        ("1 + 2", ScriptFault.SYNTAX),
        ("end", ScriptFault.SYNTAX),
        ("if x:\n", ScriptFault.SYNTAX),
        ("f(a=1, 2)", ScriptFault.SYNTAX),
        ("f(a=1, a=2)", ScriptFault.SYNTAX),
        ("def f(a, a):\nend", ScriptFault.SYNTAX),
        ("f() = 1", ScriptFault.SYNTAX),
        ("x[] = 1", ScriptFault.SYNTAX),
        ("x = while", ScriptFault.SYNTAX),
        ("x = f\n(1)", ScriptFault.SYNTAX),
        ("x = a == not b", ScriptFault.SYNTAX),
        ("x = " + "(" * 61 + "1" + ")" * 61, ScriptFault.DEPTH),
        ("if a:\n" * 61 + "end\n" * 61, ScriptFault.DEPTH),
        ("x = " + "-" * 70 + "1", ScriptFault.DEPTH),
        ("x = " + " + ".join(["1"] * 202), ScriptFault.DEPTH),
    ],
)
def test_what_is_refused(text, code):
    with pytest.raises(ScriptError) as caught:
        parse(text)
    assert caught.value.code is code


names = st.sampled_from(["a", "b", "q", "p", "x_1", "async", "class", "__init__"])


def as_list(values):
    return t.ListLiteral(tuple(values))


def as_pose(values):
    return t.PoseLiteral(tuple(values))


def positional(values):
    return tuple(t.Argument(None, value) for value in values)


def alone(value):
    return positional([value])


def keyword(values):
    return (t.Argument("k", values[0]),) if values else ()


def larger_expressions(inner):
    return st.one_of(
        st.lists(inner, max_size=3).map(as_list),
        st.lists(inner, min_size=6, max_size=6).map(as_pose),
        st.builds(t.Unary, st.sampled_from(["-", "+", "not"]), inner),
        st.builds(t.Binary, st.sampled_from(sorted(LEVELS)), inner, inner),
        st.builds(t.Index, st.one_of(names.map(t.Name), inner), st.lists(inner, min_size=1, max_size=2).map(tuple)),
        st.builds(t.FunctionCall, names, st.lists(inner, max_size=2).map(positional)),
        st.builds(t.RunThread, names, st.lists(inner, max_size=2).map(keyword)),
    )


def larger_statements(inner):
    return st.one_of(
        st.builds(t.While, expressions, st.lists(inner, max_size=3).map(tuple)),
        st.builds(
            t.If,
            st.lists(
                st.builds(t.Branch, expressions, st.lists(inner, max_size=2).map(tuple)), min_size=1, max_size=2
            ).map(tuple),
            st.none() | st.lists(inner, max_size=2).map(tuple),
        ),
        st.builds(
            t.Definition, st.sampled_from(["def", "thread"]), names, st.just(()), st.lists(inner, max_size=2).map(tuple)
        ),
    )


expressions = st.recursive(
    st.one_of(
        st.integers(0, 2**40).map(t.Integer),
        st.floats(min_value=0, allow_nan=False, allow_infinity=False).map(t.Real),
        st.booleans().map(t.Boolean),
        st.text(st.characters(codec="ascii", exclude_characters="\"'\n"), max_size=8).map(t.Text),
        names.map(t.Name),
    ),
    larger_expressions,
    max_leaves=12,
)
statements = st.recursive(
    st.one_of(
        st.builds(t.Assign, st.sampled_from([None, "global", "local"]), names.map(t.Name), expressions),
        st.builds(t.Evaluate, st.builds(t.FunctionCall, names, expressions.map(alone))),
        st.builds(t.Return, st.none() | expressions),
        st.builds(t.EndThread, st.sampled_from(["kill", "join"]), expressions),
        st.builds(t.KeywordStatement, st.sampled_from(["pass", "halt", "enter_critical", "exit_critical"])),
        st.builds(t.Declare, st.sampled_from(["global", "local"]), names),
    ),
    larger_statements,
    max_leaves=8,
)


@pytest.mark.long
@given(st.lists(statements, max_size=4))
def test_every_tree_survives_its_text(body):
    tree = t.Program(tuple(body))
    assert parse(render(tree)) == tree


@given(st.text(st.sampled_from("abp x1.5e-+*^()[]=<>:,'\"#\n") | st.characters(), max_size=60))
def test_any_text_parses_to_a_fixed_point_or_is_refused(text):
    try:
        fixed_point(text)
    except ScriptError:
        pass


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(1, 4000), max_size=40))
def test_programs_are_found_however_the_bytes_were_torn(cuts):
    text = "stop program\n\n# nothing\n" + upload() + 'sec a(): # end\n textmsg("end")\nend\nmovej([0,0,0,0,0,0])\n'
    stream, found, at = ProgramStream(100_000), [], 0
    for cut in [*cuts, len(text)]:
        found += stream.feed(text[at : at + cut])
        at += cut
    assert [program.split("\n")[0].strip() for program in found] == [
        "stop program",
        "def rtde_control():",
        "sec a(): # end",
        "movej([0,0,0,0,0,0])",
    ]
    assert upload() in found


def test_a_program_without_end_is_refused_at_the_limit():
    stream = ProgramStream(1000)
    with pytest.raises(ScriptError) as caught:
        for _ in range(2000):
            stream.feed("def f():\n")
    assert caught.value.code is ScriptFault.SIZE
    with pytest.raises(ScriptError) as caught:
        ProgramStream(1000).feed("x" * 1001)
    assert caught.value.code is ScriptFault.SIZE
