"""Writes the LLVM IR of the loops of `hash_rows`. Rows are processed in blocks that fit into a core's own cache. The lane sums
of a block's rows stay in this cache while words are added, one word after another. So only one column is read at a time, as a
stream that the processor can prefetch. Reading all columns at once would be too many streams."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.entry_functions import write_inner_function
from antdsl.machine_code.library import make_library_text
from antdsl.machine_code.llvm_module import LlvmModule

CONTIGUOUS_WORD_KIND, STRIDED_WORD_KIND, ROW_NUMBER_WORD_KIND, HALF_WORDS_KIND = range(4)  # kinds of words
# Words of a table for each of the row's words: kind, two addresses each before the bytes of a step, four keys
TABLE_WORDS_PER_WORD = 9
TABLE_HEADER_WORDS = 4  # words of a call's table: both sums, number of words per row, address of the table of words
ROWS_PER_STEP = 8  # rows processed together
_BLOCK_ROWS = 1_024  # rows per block
_MIX_MULTIPLIERS = (0xFF51AFD7ED558CCD - 2**64, 0xC4CEB9FE1A85EC53 - 2**64)
_LONG_LANES_TYPE, _HALF_LANES_TYPE = f"<{ROWS_PER_STEP} x i64>", f"<{ROWS_PER_STEP} x i32>"
_LANE_NUMBERS = "<" + ", ".join(f"i64 {k}" for k in range(ROWS_PER_STEP)) + ">"


class _TextBuilder:
    """Builder of a function's LLVM IR, with unique names for its values."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0

    def append(self, line: str) -> None:
        """Append an instruction."""
        self.lines.append("  " + line)

    def begin_block(self, label: str) -> None:
        """Begin a basic block with a label."""
        self.lines.append(f"{label}:")

    def add_value(self, value: str) -> str:
        """Append an instruction that has a result, and return the result's name."""
        self._count += 1
        self.append(f"%v{self._count} = {value}")
        return f"%v{self._count}"

    def add_pointer(self, begin: str, kind: str, number: str) -> str:
        """Append the computation of a pointer to element `number` of type `kind` after `begin`. Return the pointer's name."""
        return self.add_value(f"getelementptr {kind}, ptr {begin}, i64 {number}")

    def add_broadcast(self, value: str, kind: str = "i64") -> str:
        """Append instructions that copy a number to all lanes of a vector. Return the vector's name."""
        one = self.add_value(f"insertelement <{ROWS_PER_STEP} x {kind}> poison, {kind} {value}, i64 0")
        return self.add_value(
            f"shufflevector <{ROWS_PER_STEP} x {kind}> {one}, <{ROWS_PER_STEP} x {kind}> poison, <{ROWS_PER_STEP} x i32> "
            f"zeroinitializer"
        )


def _format_vector_constant(value: int) -> str:
    """Return the text of a vector constant with the same number in all lanes."""
    return "<" + ", ".join([f"i64 {value}"] * ROWS_PER_STEP) + ">"


@make_library_text
def build_llvm_text(target: llvm_compiler.Target) -> str:
    """Return the LLVM IR of the function to compile. It takes the address of a table, and adds up the hashes of a range of
    rows."""
    module = LlvmModule(target)
    module.declare("llvm.memset.p0.i64", "void", ["ptr", "i8", "i64", "i1"])
    w = _TextBuilder()
    w.append("%words.at = getelementptr i64, ptr %t, i64 2\n  %words = load i64, ptr %words.at")
    w.append("%table.at = getelementptr i64, ptr %t, i64 3\n  %table = load ptr, ptr %table.at")
    for name in ("lane0", "lane1", "values"):
        w.append(f"%{name} = alloca [{_BLOCK_ROWS} x i64], align 64")
    w.append("call void @llvm.memset.p0.i64(ptr align 64 %values, i8 0, i64 64, i1 false)")  # for lanes without a row
    w.append("br label %blocks")
    w.begin_block("blocks")
    w.append("%first = phi i64 [ %begin, %entry ], [ %next, %mixed ]")
    for lane in (0, 1):
        w.append(f"%sum{lane} = phi i64 [ 0, %entry ], [ %mix.sum{lane}, %mixed ]")
    w.append("%left = sub i64 %end, %first\n  %more = icmp sgt i64 %left, 0\n  br i1 %more, label %block, label %over")
    # The remaining rows, fewer than lanes, form a separate block; all its words are gathered.
    w.begin_block("block")
    w.append(f"%long = icmp slt i64 %left, {_BLOCK_ROWS}\n  %most = select i1 %long, i64 %left, i64 {_BLOCK_ROWS}")
    w.append(f"%few = icmp slt i64 %most, {ROWS_PER_STEP}\n  %even = and i64 %most, {-ROWS_PER_STEP}")
    w.append("%count = select i1 %few, i64 %most, i64 %even\n  %next = add i64 %first, %count")
    w.append(f"%up = add i64 %count, {ROWS_PER_STEP - 1}\n  %room = and i64 %up, {-ROWS_PER_STEP}\n  %bytes = shl i64 %room, 3")
    for lane in (0, 1):
        w.append(f"call void @llvm.memset.p0.i64(ptr align 64 %lane{lane}, i8 0, i64 %bytes, i1 false)")
    w.append("br label %words.loop")
    _write_word_sums(w)
    _write_row_mixing(w)
    w.begin_block("over")
    for lane in (0, 1):
        place = w.add_pointer("%t", "i64", str(lane))
        old_sum = w.add_value(f"load i64, ptr {place}")
        w.append(f"store i64 {w.add_value(f'add i64 {old_sum}, %sum{lane}')}, ptr {place}")
    return f"{module.text()}\n{write_inner_function(module, 'rows', chr(10).join(w.lines))}\n"


def _write_word_sums(w: _TextBuilder) -> None:
    """Emit code that adds all words of a block's rows to both lanes, one word after another."""
    w.begin_block("words.loop")
    w.append("%w = phi i64 [ 0, %block ], [ %w.next, %added ]")
    w.append("%w.more = icmp slt i64 %w, %words\n  br i1 %w.more, label %word, label %mix")
    w.begin_block("word")
    word = w.add_pointer("%table", "i64", w.add_value(f"mul i64 %w, {TABLE_WORDS_PER_WORD}"))
    addresses = [w.add_pointer(word, "i64", str(k)) for k in range(TABLE_WORDS_PER_WORD)]
    kind, *steps = (w.add_value(f"load i64, ptr {addresses[k]}") for k in (0, 2, 4))
    columns = [w.add_value(f"load ptr, ptr {addresses[k]}") for k in (1, 3)]
    keys = [w.add_broadcast(w.add_value(f"load i64, ptr {place}")) for place in addresses[5:]]
    begins = [
        w.add_pointer(column, "i8", w.add_value(f"mul i64 %first, {step}")) for column, step in zip(columns, steps, strict=True)
    ]
    kind_tests = [w.add_value(f"icmp eq i64 {kind}, {each}") for each in (CONTIGUOUS_WORD_KIND, HALF_WORDS_KIND)]
    in_place = w.add_value("xor i1 %few, true")
    pairs = kind_tests[1]
    for step in steps:
        pairs = w.add_value(f"and i1 {pairs}, {w.add_value(f'icmp eq i64 {step}, 4')}")
    w.append(f"%as.it.is = and i1 {kind_tests[0]}, {in_place}\n  %as.pairs = and i1 {pairs}, {in_place}")
    w.append("br i1 %as.it.is, label %add, label %other\nother:\n  br i1 %as.pairs, label %pairs, label %gather")
    w.begin_block("gather")
    w.append(
        f"switch i64 {kind}, label %halves [ i64 {CONTIGUOUS_WORD_KIND}, label %strided  i64 {STRIDED_WORD_KIND}, label %strided"
        f"  i64 {ROW_NUMBER_WORD_KIND}, label %numbers ]"
    )
    w.begin_block("strided")
    _gather_values(w, "strided.loop", "strided", begins[0], steps[0], "i64", None)
    w.append("br label %add")
    w.begin_block("numbers")
    _write_row_numbers(w)
    w.begin_block("halves")
    _write_halves(w, "low", begins[0], steps[0])
    w.begin_block("low.done")
    _write_halves(w, "high", begins[1], steps[1])
    w.begin_block("high.done")
    w.append("br label %add")
    sources = [(begins[0], "word"), *(("%values", label) for label in ("strided.loop.end", "numbers.of.end", "high.done"))]
    w.begin_block("add")
    w.append("%of = phi ptr " + ", ".join(f"[ {value}, %{label} ]" for value, label in sources))
    _add_products(w, "adding", "add", ["%of"], keys)
    w.begin_block("pairs")
    _add_products(w, "pairing", "pairs", begins, keys)
    w.begin_block("added")
    w.append("%w.next = add i64 %w, 1\n  br label %words.loop")


def _add_products(w: _TextBuilder, label: str, predecessor: str, columns: Sequence[str], keys: Sequence[str]) -> None:
    """Emit the loop that adds the products of one word to both lanes of a block.

    `columns`: one column if it has complete words, or two columns with the halves of words. `keys`: the four keys of the word.
    `predecessor`: the label of the preceding basic block."""
    _begin_loop(w, label, predecessor, ROWS_PER_STEP, "%room")
    if len(columns) == 1:
        place = w.add_pointer(columns[0], "i64", f"%{label}.i")
        low = w.add_value(f"load {_LONG_LANES_TYPE}, ptr {place}, align 1")
        halves = [low, w.add_value(f"lshr {_LONG_LANES_TYPE} {low}, {_format_vector_constant(32)}")]
    else:
        addresses = [w.add_pointer(column, "i32", f"%{label}.i") for column in columns]
        loaded_halves = [w.add_value(f"load {_HALF_LANES_TYPE}, ptr {place}, align 1") for place in addresses]
        halves = [w.add_value(f"zext {_HALF_LANES_TYPE} {half} to {_LONG_LANES_TYPE}") for half in loaded_halves]
    for lane in (0, 1):
        sums = [w.add_value(f"add {_LONG_LANES_TYPE} {half}, {keys[2 * lane + k]}") for k, half in enumerate(halves)]
        cut = [w.add_value(f"and {_LONG_LANES_TYPE} {value}, {_format_vector_constant(0xFFFFFFFF)}") for value in sums]
        place = w.add_pointer(f"%lane{lane}", "i64", f"%{label}.i")
        previous = w.add_value(f"load {_LONG_LANES_TYPE}, ptr {place}, align 64")
        product = w.add_value(f"mul {_LONG_LANES_TYPE} {cut[0]}, {cut[1]}")
        w.append(
            f"store {_LONG_LANES_TYPE} {w.add_value(f'add {_LONG_LANES_TYPE} {previous}, {product}')}, ptr {place}, align 64"
        )
    _end_loop(w, label)
    w.append("br label %added")


def _write_halves(w: _TextBuilder, name: str, begin: str, step: str) -> None:
    """Emit code that reads values of at most 4 bytes from a column, and stores each as a 32-bit half of a 64-bit word.

    `name`: `low` or `high`, the half that is stored, and the prefix of labels. `begin`, `step`: the registers with the
    column's address and with the distance of its values in bytes. The code ends with a jump to the label `name`.done."""
    shift = 32 if name == "high" else 0
    w.append(f"br i1 %few, label %{name}.few, label %{name}.many")
    for is_full in (True, False):
        mode = "many" if is_full else "few"
        w.begin_block(f"{name}.{mode}")
        sizes = (1, 2, 4) if is_full else (1, 2)
        w.append(
            f"switch i64 {step}, label %{name}.{mode}.0 [ "
            + "  ".join(f"i64 {size}, label %{name}.{mode}.{size}" for size in sizes)
            + " ]"
        )
        for size in (0, *sizes):
            label, kind = f"{name}.{mode}.{size}", f"i{8 * size}" if size else "i32"
            w.begin_block(label)
            if size and is_full:
                _read_halves(w, f"{label}.loop", label, begin, kind, shift)
            else:
                _gather_values(w, f"{label}.loop", label, begin, step, kind, shift)
            w.append(f"br label %{name}.done")


def _begin_loop(w: _TextBuilder, label: str, predecessor: str, step: int, count: str) -> None:
    """Begin a loop over the rows of a block. `predecessor`: the label of the preceding basic block. `step`: the rows per
    iteration. `count`: the register with the number of rows."""
    w.append(f"br label %{label}")
    w.begin_block(label)
    w.append(f"%{label}.i = phi i64 [ 0, %{predecessor} ], [ %{label}.next, %{label}.turn ]")
    w.append(f"%{label}.more = icmp slt i64 %{label}.i, {count}\n  br i1 %{label}.more, label %{label}.turn, label %{label}.end")
    w.begin_block(f"{label}.turn")
    w.append(f"%{label}.next = add i64 %{label}.i, {step}")


def _end_loop(w: _TextBuilder, label: str) -> None:
    """Emit the jump back to the start of a loop, and begin the basic block after the loop."""
    w.append(f"br label %{label}")
    w.begin_block(f"{label}.end")


def _read_halves(w: _TextBuilder, label: str, predecessor: str, begin: str, kind: str, shift: int) -> None:
    """Emit a loop that reads contiguous values, several at once, and stores each as a half of a 64-bit word. `shift`: 0 for
    the low half, 32 for the high half."""
    _begin_loop(w, label, predecessor, ROWS_PER_STEP, "%room")
    address = w.add_pointer(begin, kind, f"%{label}.i")
    half = w.add_value(f"load <{ROWS_PER_STEP} x {kind}>, ptr {address}, align 1")
    if kind != "i32":
        half = w.add_value(f"sext <{ROWS_PER_STEP} x {kind}> {half} to {_HALF_LANES_TYPE}")
    half = w.add_value(f"zext {_HALF_LANES_TYPE} {half} to {_LONG_LANES_TYPE}")
    place = w.add_pointer("%values", "i64", f"%{label}.i")
    if shift:
        low = w.add_value(f"load {_LONG_LANES_TYPE}, ptr {place}, align 64")
        shifted = w.add_value(f"shl {_LONG_LANES_TYPE} {half}, {_format_vector_constant(shift)}")
        half = w.add_value(f"or {_LONG_LANES_TYPE} {low}, {shifted}")
    w.append(f"store {_LONG_LANES_TYPE} {half}, ptr {place}, align 64")
    _end_loop(w, label)


def _gather_values(w: _TextBuilder, label: str, predecessor: str, begin: str, step: str, kind: str, shift: int | None) -> None:
    """Emit a loop that reads values at a distance of `step` bytes, and stores each as a 64-bit word or as a half of one.

    `shift`: 0 for the low half, 32 for the high half, None for complete words."""
    _begin_loop(w, label, predecessor, 1, "%count")
    address = w.add_pointer(begin, "i8", w.add_value(f"mul i64 %{label}.i, {step}"))
    word = w.add_value(f"load {kind}, ptr {address}, align 1")
    place = w.add_pointer("%values", "i64", f"%{label}.i")
    if shift is not None:
        if kind != "i32":
            word = w.add_value(f"sext {kind} {word} to i32")
        word = w.add_value(f"zext i32 {word} to i64")
        if shift:
            low = w.add_value(f"load i64, ptr {place}, align 8")
            shifted = w.add_value(f"shl i64 {word}, {shift}")
            word = w.add_value(f"or i64 {low}, {shifted}")
    w.append(f"store i64 {word}, ptr {place}, align 8")
    _end_loop(w, label)


def _write_row_numbers(w: _TextBuilder) -> None:
    """Emit the loop that stores the row numbers of a block as 64-bit words."""
    _begin_loop(w, "numbers.of", "numbers", ROWS_PER_STEP, "%room")
    number = w.add_value(
        f"add {_LONG_LANES_TYPE} {w.add_broadcast(w.add_value('add i64 %first, %numbers.of.i'))}, {_LANE_NUMBERS}"
    )
    place = w.add_pointer("%values", "i64", "%numbers.of.i")
    w.append(f"store {_LONG_LANES_TYPE} {number}, ptr {place}, align 64")
    _end_loop(w, "numbers.of")
    w.append("br label %add")


def _write_row_mixing(w: _TextBuilder) -> None:
    """Emit the loop that mixes both lanes of each row in a block, and adds them to the sums.

    It works row by row, because few processors multiply 64-bit numbers in SIMD lanes."""
    w.begin_block("mix")
    w.append("br label %mixing")
    w.begin_block("mixing")
    w.append("%m = phi i64 [ 0, %mix ], [ %m.next, %mixing.turn ]")
    for lane in (0, 1):
        w.append(f"%mix.sum{lane} = phi i64 [ %sum{lane}, %mix ], [ %mix.then{lane}, %mixing.turn ]")
    w.append("%m.more = icmp slt i64 %m, %count\n  br i1 %m.more, label %mixing.turn, label %mixed")
    w.begin_block("mixing.turn")
    for lane in (0, 1):
        place = w.add_pointer(f"%lane{lane}", "i64", "%m")
        h = w.add_value(f"load i64, ptr {place}, align 8")
        for factor in (*_MIX_MULTIPLIERS, None):
            shifted = w.add_value(f"lshr i64 {h}, 33")
            h = w.add_value(f"xor i64 {h}, {shifted}")
            h = h if factor is None else w.add_value(f"mul i64 {h}, {factor}")
        w.append(f"%mix.then{lane} = add i64 %mix.sum{lane}, {h}")
    w.append("%m.next = add i64 %m, 1\n  br label %mixing")
    w.begin_block("mixed")
    w.append("br label %blocks")
