"""The machine that the computation runs on: Mitsuba variant, LLVM and OptiX, memory, disk, Ctrl-C.

Read `backend` first: it decides where the computation runs. `llvm` runs earlier, and is the only module that may run
before Dr.Jit is imported.
"""
