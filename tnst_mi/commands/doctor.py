"""`tnst-mi doctor`: does this machine have what the main job needs?"""

from __future__ import annotations

from dataclasses import dataclass

from tnst_mi.commands.base import Command


@dataclass(kw_only=True)
class Doctor(Command):
    """Check Python, Mitsuba, Dr.Jit, LLVM, GPU, torch, weights and memory; say how to get what is missing."""

    def run(self) -> int:
        """Print the checks; 0 if the main job can run, else 1."""
        from tnst_mi.commands.examination import examine

        checks = examine()
        for check in checks:
            print(check)
        if all(check.ok for check in checks if check.required):
            print("The main job can run: tnst-mi demo")
            return 0
        print("The main job lacks what is marked as missing above.")
        return 1
