"""LLVM IR of functions that run a job on several threads. Workers wait for a job without holding the interpreter's lock.

A job has a number of parts, and any free thread takes the next part. The word `left` changes atomically. Its low half is the
number of parts that are left; its high half is the index of the first of them. The caller takes the first part, a worker the
last one. So each thread mostly processes the same agents in consecutive jobs, and has their data in its cache.

The description of a job is written before `left` is set. No other job starts before `done` has counted all parts of this job.
So a thread that has taken a part can safely read the description.

A worker polls `left` for a number of iterations, then blocks on its own lock. It is a CPython lock, usable without the
interpreter's lock. A thread that wakes a worker lowers that worker's flag first, so that each lock is released once per wait.
A wake-up is the slowest operation here. So the caller wakes only the first worker, and each woken worker wakes two more."""

from __future__ import annotations

from functools import cache

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels.direct.argument_text import MAX_JOB_PARTS, MAX_TABLE_WORDS, PART_RESULTS_WORD, RESULT_WORDS
from antdsl.machine_code.library import make_library_text, read_llvm_file

CACHE_LINE_WORDS = 8  # words of a cache line: values that several threads write to have separate lines
# Indices of a pool's words: `left` and `done` of a job; `waits`: whether the caller sleeps.
PARTS_LEFT_WORD, DONE_COUNT_WORD, IS_CALLER_WAITING_WORD = 0, CACHE_LINE_WORDS, 2 * CACHE_LINE_WORDS
# The job: its code, its table or list, the length of a table, the number of parts, and the number of rows.
JOB_CODE_WORD, JOB_TABLE_WORD, TABLE_LENGTH_WORD, PART_COUNT_WORD, ROW_COUNT_WORD = range(
    3 * CACHE_LINE_WORDS, 3 * CACHE_LINE_WORDS + 5
)
# Constants of the pool: number of workers, polls before a worker sleeps, the caller's lock, functions that acquire and release a
# lock; and `END`: whether workers return.
WORKER_COUNT_WORD, SPIN_TURNS_WORD, CALLER_LOCK_WORD, ACQUIRE_FUNCTION_WORD, RELEASE_FUNCTION_WORD, SHOULD_END_WORD = range(
    4 * CACHE_LINE_WORDS, 4 * CACHE_LINE_WORDS + 6
)
FIRST_SLEEP_WORD = PART_RESULTS_WORD + MAX_JOB_PARTS * RESULT_WORDS  # for each worker: whether it sleeps, and its lock
PART_ALIGNMENT = 16  # parts of a kernel begin at multiples of it: at whole registers, and lines of what they write


@cache
def load_code() -> llvm_compiler.LoadedCode:
    """Return the code of the workers' functions.

    - `run(pool, code, table, words, parts)` runs a kernel's code in parts, on this thread and the workers. The last two words
      of the table hold the begin and end of a part; initially the last word is the end of the complete range, which starts at
      0.
    - Other jobs are prepared in advance. Their table has three words for each part, which are the arguments of that part's
      call.
    - `all(pool, 0, 0)` runs a prepared job.
    - `start(pool, 0, 0)` starts a prepared job on the workers and returns.
    - `finish(pool, 0, 0)` ends a started job: it withdraws the parts that no thread has taken, and waits for the others.
    - `worker(pool, number, 0)` runs worker `number`, and returns after `end(pool, 0, 0)` has been called.
    - `turns(pool, count, 0)` spins for `count` iterations."""
    return build_llvm_text.code()


@make_library_text
def build_llvm_text(target: llvm_compiler.Target) -> str:
    """Return the LLVM IR to compile for `target`."""
    pause = (
        "  call void @llvm.x86.sse2.pause()\n"
        if target.is_x86
        else "  call void @llvm.aarch64.hint(i32 1)\n"
        if target.is_arm
        else ""
    )
    output = read_llvm_file("workers.ll").replace("$PAUSE$", pause)
    if pause:
        output += "declare void @llvm.x86.sse2.pause()\n" if target.is_x86 else "declare void @llvm.aarch64.hint(i32)\n"
    for name, place in _WORD_OFFSETS.items():
        output = output.replace(f"${name}$", str(place))
    return output


_WORD_OFFSETS = {
    "LEFT": PARTS_LEFT_WORD, "DONE": DONE_COUNT_WORD, "WAITS": IS_CALLER_WAITING_WORD, "CODE": JOB_CODE_WORD,
    "TABLE": JOB_TABLE_WORD, "LENGTH": TABLE_LENGTH_WORD, "OF": PART_COUNT_WORD, "COUNT": ROW_COUNT_WORD,
    "WORKERS": WORKER_COUNT_WORD, "TURNS": SPIN_TURNS_WORD, "LOCK": CALLER_LOCK_WORD, "ACQUIRE": ACQUIRE_FUNCTION_WORD,
    "RELEASE": RELEASE_FUNCTION_WORD, "END": SHOULD_END_WORD, "GIVEN": PART_RESULTS_WORD,
    "SLEEPS": FIRST_SLEEP_WORD, "LINE": CACHE_LINE_WORDS, "RESULTS": RESULT_WORDS, "WORDS": MAX_TABLE_WORDS,
    "EVEN": -PART_ALIGNMENT,
}  # fmt: skip
