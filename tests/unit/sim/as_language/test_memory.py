"""Variables of AS: sparse arrays, types, globals and locals, parameters by reference."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language import expressions, syntax
from sim.as_language.errors import AsError
from sim.as_language.memory import Array, Namespace, VariableCell, bind, following
from sim.as_language.parser import parse
from sim.as_language.values import Joints, Transformation
from tests.fakes.as_language import AsLanguage, program, statement


def call(bench: AsLanguage, header: str, arguments: str) -> AsLanguage:
    """Bind the arguments of a CALL to the parameters of a header; return the callee's view."""
    called = parse(f".PROGRAM {header}\n.END").programs["q"]
    step = statement(f"CALL q({arguments})")
    assert isinstance(step, syntax.CallStatement)
    given_ = [expressions.refer(argument)(bench) for argument in step.arguments]
    callee = AsLanguage()
    callee.memory = bench.memory
    callee.locals = bind(called.parameters, given_, "q")
    return callee


@given(st.dictionaries(st.integers(0, 9999), st.integers(-99, 99), max_size=8))
def test_arrays_are_sparse(values: dict[int, int]) -> None:
    """Every index from 0 to 9999 can be used without a declaration; the others stay undefined."""
    bench = AsLanguage(*(f"a[{index}] = {value}" for index, value in values.items()))
    for index in {0, 1, 9999, *values}:
        expected = float(values[index]) if index in values else "E0102"
        assert bench.outcome(f"a[{index}]") == expected


@pytest.mark.parametrize("index", ["-1", "10000", "1E9"])
def test_an_index_outside_of_0_to_9999_is_refused(index: str) -> None:
    """P0119, for reading and for writing."""
    assert AsLanguage("a[1] = 1").code(f"a[{index}]") == "P0119"
    with pytest.raises(AsError, match="P0119"):
        AsLanguage(f"a[{index}] = 1")


def test_elements_of_three_dimensions_are_different_variables() -> None:
    """a[1,2,3] is neither a[3,2,1] nor a[1,2]."""
    bench = AsLanguage("a[1,2,3] = 7", "a[3,2,1] = 8", "i = 1")
    assert bench("a[i,i+1,3]") == 7.0
    assert bench.code("a[1,2]") == "E0102"


@pytest.mark.parametrize(
    ("first", "second", "code"),
    [
        ("x = 1", "x[1] = 1", "P0132"),
        ("x[1] = 1", "x = 1", "P0133"),
        ("x = 1", 'x = "a"', "P0150"),
        ("x = 1", "x = NULL", "P0150"),
        ("POINT x = NULL", "x = 1", "P0150"),
        ("$s = 1", "x = 1", "P0150"),
        ("x = 1", "POINT #j = NULL", "P0150"),
        ("x = 1", "@n = 3E9", "E0106"),
        ("x = 1", '@n = "1"', "P0150"),
    ],
)
def test_a_name_keeps_its_type(first: str, second: str, code: str) -> None:
    """A scalar never becomes an array, a real never a pose."""
    with pytest.raises(AsError) as caught:
        AsLanguage(first, second)
    assert caught.value.code == code


def test_a_scalar_and_an_array_cannot_be_read_as_each_other() -> None:
    """P0132 and P0133 instead of a value that was never stored."""
    bench = AsLanguage("x = 1", "a[1] = 1")
    assert bench.code("x[1]") == "P0132"
    assert bench.code("a") == "P0133"
    assert bench.code("a[]") == "P0133"


def test_prefixes_make_different_variables() -> None:
    """x, $x, #x, @x and .x are five."""
    bench = AsLanguage("x = 1", '$x = "a"', "POINT #x = #PPOINT(2)", "@x = 3.9", ".x = 4")
    assert [bench(name) for name in ("x", "$x", "@x", ".x")] == [1.0, "a", 3, 4.0]
    assert bench("#x") == Joints((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def test_names_are_one_without_regard_to_case_and_beyond_15_characters() -> None:
    """Two long names with the same beginning are the same variable."""
    bench = AsLanguage("a_very_long_name_1 = 1", "A_VERY_LONG_NAME_2 = 2")
    assert bench("A_Very_Long_Name_1") == 2.0
    assert bench.memory.read("a_very_long_nam") == 2.0


def test_integers_stay_whole_and_exact() -> None:
    """@n holds 32 bits, a real loses the last ones."""
    bench = AsLanguage("@n = 16777217", "x = @n", "@m = 7", "@q = @m/2")
    assert bench("@n + 0") != 16777218.0
    assert bench("@n") == 16777216  # the literal itself is a real
    assert bench("x") == 16777216.0
    assert bench("@m + @m") == 14
    assert bench("@q") == 3


def test_parameters_are_passed_by_reference() -> None:
    """The callee stores for the caller: a global, a local, an element, a new variable."""
    bench = AsLanguage("g = 1", ".l = 2", "a[3] = 3")
    callee = call(bench, "q(.a,.b,.c,.d)", "g,.l,a[3],fresh")
    callee.run(".a = 10", ".b = 20", ".c = 30", ".d = 40")
    assert [bench(name) for name in ("g", ".l", "a[3]", "fresh")] == [10.0, 20.0, 30.0, 40.0]


def test_an_expression_is_passed_as_a_value() -> None:
    """The callee may store into it; no other program reads it."""
    bench = AsLanguage("g = 1")
    callee = call(bench, "q(.a,.$s)", 'g+0,"x"').run(".a = 5")
    assert callee(".$s") == "x"
    assert bench("g") == 1.0


def test_transformations_and_whole_arrays_are_passed_too() -> None:
    """`&p`, `.&p[,]` and `a[]` as manual and public backups write them."""
    bench = AsLanguage("POINT p = TRANS(1)", "a[2] = 5")
    callee = call(bench, "q(.&t,.b[])", "&p,a[]").run("POINT .t = TRANS(2)", ".b[3] = 6")
    assert callee(".b[2]") == 5.0
    assert bench("p") == Transformation(2.0)
    assert bench("a[3]") == 6.0


def test_an_argument_left_out_is_undefined() -> None:
    """Reading it is E0102, not zero."""
    callee = call(AsLanguage(), "q(.a,.b)", ",1")
    assert callee.code(".a") == "E0102"
    assert callee(".b") == 1.0


@pytest.mark.parametrize(
    ("header", "arguments", "code"),
    [("q(.a)", "1,2", "P0137"), ("q(.a,.b)", "1", "P0137"), ("q(.$s)", "1", "P0138"),
     ("q(.a)", '"x"', "P0138"), ("q(.a[])", "1", "P0138"), ("q(.a)", "a[]", "P0138"),
     ("q(.#j)", "NULL", "P0138")],
)  # fmt: skip
def test_arguments_must_fit_the_parameters(header: str, arguments: str, code: str) -> None:
    """Number and types (P0137, P0138)."""
    with pytest.raises(AsError) as caught:
        call(AsLanguage("a[1] = 1"), header, arguments)
    assert caught.value.code == code


def test_the_memory_starts_with_the_data_sections() -> None:
    """Reals, strings, integers, poses and elements, by the names programs use."""
    source = parse('.REALS\nx = 1.5\na[1,2] = 3\n.END\n.STRINGS\n$s = "hi"\n.END\n'
                   ".INTEGER\n@n = 4\n.END\n.TRANS\np 1 2 3 4 5 6\n.END\n"
                   ".JOINTS\n#j 1 2 3 4 5 6\n.END\n")  # fmt: skip
    memory = Namespace()
    memory.fill(source.data)
    assert memory.read("x") == 1.5
    assert memory.read("a[1,2]") == 3.0
    assert memory.read("$s") == "hi"
    assert memory.read("@n") == 4
    assert memory.read("p") == Transformation(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert memory.read("#j") == Joints((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert memory.read("missing") is None


def test_a_test_can_read_and_write_variables_by_their_spelling() -> None:
    """The access past the language, for the program that drives the emulator."""
    memory = Namespace()
    memory.write("a[1,2]", 5.0)
    memory.write("$s", "t")
    assert memory.read("A[1,2]") == 5.0
    assert memory.read("a[2]") is None
    assert memory.read("$s[1]") is None
    assert isinstance(memory["a"], Array)
    assert isinstance(memory["$s"], VariableCell)


@given(st.integers(0, 9990), st.integers(0, 9))
def test_elements_that_follow_count_in_the_last_dimension(index: int, count: int) -> None:
    """DECOMPOSE and TCP_RECV fill a[k], a[k+1], ..."""
    assert following(index, count) == index + count
    assert following((3, index), count) == (3, index + count)


def test_a_program_that_is_only_parsed_leaves_the_memory_alone() -> None:
    """Compiling defines nothing."""
    bench = AsLanguage()
    for step in program("x = y+1", "a[1] = 2").steps:
        assert isinstance(step.statement, syntax.Assign)
        expressions.value_of(step.statement.value)
        expressions.store(step.statement.target)
    assert bench.memory == {}
