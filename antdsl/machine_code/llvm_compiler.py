"""Compiles LLVM IR to machine code with llvmlite. No other module uses llvmlite.

LLVM may not change the result of a float operation: there are no fast-math flags, and operations are not fused."""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Any

_LLVM_LOCK = Lock()  # LLVM has one context per process
if hasattr(os, "register_at_fork"):  # a child process forked while LLVM works would inherit locked locks
    os.register_at_fork(before=_LLVM_LOCK.acquire, after_in_parent=_LLVM_LOCK.release, after_in_child=_LLVM_LOCK.release)
_NUMBER_PATTERN = re.compile("[0-9]+")
_OLDEST_LLVMLITE_VERSION = (0, 45)  # the oldest llvmlite that can parse these texts
ALL_PASSES_MARKER = "whole"  # a text that begins with this comment gets all passes of LLVM
_DISABLED_FUSED_FEATURES = ("fma", "fma4", "avx512f")  # features with fused instructions
# A feature of processors with 512-bit registers since 2019, on which their use does not reduce the clock rate. It implies `fma`,
# but no text of antdsl requests fused operations.
_DISABLED_WIDE_FEATURE = "avx512vbmi2"
# A module with one writable number. llvmlite reserves a page for writable numbers if an object file has any. LLVM also stores
# addresses of C functions there, for which llvmlite reserves no space.
_PROBE_MODULE_TEXT = '\n@"a number" = global i64 1\n'


@dataclass(frozen=True, slots=True)
class Target:
    """The target of compiled code: target triple, processor and processor features, with LLVM's names."""

    triple: str
    cpu: str
    features: str

    @property
    def has_avx2(self) -> bool:
        """Return whether the processor has AVX2."""
        return "+avx2" in self.features.split(",")

    @property
    def is_x86(self) -> bool:
        """Return whether the processor is a 64-bit x86."""
        return self.triple.partition("-")[0] in ("x86_64", "amd64")

    @property
    def is_arm(self) -> bool:
        """Return whether the processor is a 64-bit ARM."""
        return self.triple.partition("-")[0] in ("aarch64", "arm64")


# a target for results that must be equal on every machine
PORTABLE_TARGET = Target("x86_64-unknown-linux-gnu", "x86-64-v3", "+avx2,-fma")


class MachineCodeUnavailableError(RuntimeError):
    """Error raised if machine code is needed but cannot be compiled on this machine. The message has the reason and the
    remedy."""


@cache
def _import_llvm() -> Any:
    """Import llvmlite's LLVM binding, initialise it for this machine and return it."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def find_unavailability_reason() -> str:
    """Return the reason why no code can be compiled on this machine, and the remedy. Return an empty string if code can be
    compiled."""
    try:
        import llvmlite

        find_host_target()
    except ImportError:
        return 'llvmlite is not installed: pip install "llvmlite>=0.45"'
    # the library cannot be loaded, or was built without this processor
    except (OSError, RuntimeError, AttributeError) as problem:
        return f"llvmlite cannot be used ({problem}): pip install --force-reinstall llvmlite"
    if tuple(int(part) for part in _NUMBER_PATTERN.findall(llvmlite.__version__)[:2]) < _OLDEST_LLVMLITE_VERSION:
        return f'llvmlite {llvmlite.__version__} is too old: pip install "llvmlite>=0.45"'
    return ""


def is_available() -> bool:
    """Return whether code can be compiled on this machine."""
    return not find_unavailability_reason()


def require_llvm() -> None:
    """Raise MachineCodeUnavailableError if no code can be compiled on this machine."""
    if why := find_unavailability_reason():
        raise MachineCodeUnavailableError(why)


@cache
def find_host_target() -> Target:
    """Return the target of this machine."""
    llvm = _import_llvm()
    features: Mapping[str, bool] = llvm.get_host_cpu_features()
    return Target(llvm.get_default_triple(), llvm.get_host_cpu_name(), format_features(features))


def format_features(features: Mapping[str, bool]) -> str:
    """Return a processor's features as a text in LLVM's format. Features with fused operations are disabled, except on
    processors with 512-bit registers.

    Disabled features come last: one feature may imply another (`xop` implies `fma4`), and later entries override earlier ones."""
    missing = ("fma4",) if features.get(_DISABLED_WIDE_FEATURE) else _DISABLED_FUSED_FEATURES
    words = [f"{'+' if on else '-'}{name}" for name, on in sorted(features.items()) if name not in missing]
    return ",".join(words + [f"-{name}" for name in missing if name in features])


def compile_object(text: str, target: Target) -> bytes:
    """Compile LLVM IR to an object file. Raises RuntimeError if `text` is invalid, which is a mistake in antdsl."""
    with _LLVM_LOCK:
        machine, module = _optimise_text(text + _PROBE_MODULE_TEXT, target)
        code: bytes = machine.emit_object(module)
        return code


def compile_assembly(text: str, target: Target) -> str:
    """Compile LLVM IR to assembly code."""
    with _LLVM_LOCK:
        machine, module = _optimise_text(text, target)
        assembly_text: str = machine.emit_assembly(module)
        return assembly_text


def _optimise_text(text: str, target: Target) -> tuple[Any, Any]:
    """Return LLVM's code generator for a target, and the module of `text` after LLVM's optimisation passes."""
    llvm = _import_llvm()
    machine = _make_target_machine(target)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = target.triple, str(machine.target_data)
    module.verify()
    runs_all_passes = text.startswith(f"; {ALL_PASSES_MARKER}")
    options = llvm.create_pipeline_tuning_options(speed_level=2 if runs_all_passes else 0)
    if runs_all_passes:
        options.loop_vectorization = options.slp_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    if runs_all_passes:
        builder.getModulePassManager().run(module, builder)
        return machine, module
    passes = builder.getFunctionPassManager()
    passes.add_sroa_pass()
    passes.add_simplify_cfg_pass()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)
    return machine, module


def _make_target_machine(target: Target) -> Any:
    """Return LLVM's code generator for a target."""
    llvm = _import_llvm()
    if target.triple != llvm.get_default_triple():
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=2, reloc="pic", codemodel="default"
    )


@dataclass(slots=True)
class LoadedCode:
    """Loaded machine code. The object keeps the memory of its functions alive."""

    _engine: Any
    _functions: dict[str, Any] = field(default_factory=dict)

    def function(self, name: str) -> Any:
        """Return the function `name`. It takes the address of a table, the first row, and the row after the last one."""
        if name not in self._functions:
            made = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(self.get_function_address(name))
            made.code = self._engine  # type: ignore[attr-defined] # the function holds its code
            self._functions[name] = made
        return self._functions[name]

    def get_function_address(self, name: str) -> int:
        """Return the address of a function."""
        location: int = self._engine.get_function_address(name)
        return location

    def read_constant_text(self, name: str) -> str:
        """Return the value of a text constant in the code."""
        return ctypes.string_at(self.get_constant_address(name)).decode("utf-8", "surrogateescape")

    def get_constant_address(self, name: str) -> int:
        """Return the address of a constant, or of another symbol that is not a function."""
        location: int = self._engine.get_global_value_address(name)
        return location


def load_object(code: bytes) -> LoadedCode:
    """Load an object file into memory, ready to run.

    Code and constants are in one block (`use_lmm`), because code refers to its constants by 32-bit offsets. In a process with
    gigabytes of arrays, separate blocks may be too far from each other; LLVM would then abort the process. LLVM receives the
    object file as the cached compilation of an empty module. Otherwise it would compile that module, which takes three times
    as long as everything else."""
    llvm = _import_llvm()
    with _LLVM_LOCK:
        loader = llvm.Target.from_triple(find_host_target().triple).create_target_machine(opt=0, reloc="pic", codemodel="default")
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), loader, use_lmm=True)
        engine.set_object_cache(getbuffer_func=lambda _: code)
        engine.finalize_object()
        return LoadedCode(engine)
