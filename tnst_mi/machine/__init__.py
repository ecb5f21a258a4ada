"""The machine that the computation runs on: Mitsuba variant and LLVM, memory, disk, Ctrl-C.

Read `backend` first: everything that depends on the machine is decided there.
"""
