"""The machine that the computation runs on: Mitsuba variant, LLVM and OptiX, memory, disk, Ctrl-C.

Read `backend` first: where the computation runs is decided there. `llvm` comes before it, and is all that may run
before Dr.Jit is imported.
"""
