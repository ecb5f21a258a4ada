"""Fields on cell-centred grids, and the paper's operators on them, each with its adjoint.

Read in this order: `grid` (octaves and cells), `stencil` (interpolation), `potentials` (Eq. 3), `advection`
(MacCormack), `pyramid` (the normalised gradient), `resampling` (between octaves). `kernels` and `sums` are the building
blocks of their Dr.Jit code, `bounds` finds the smoke. `arrays` lets the public functions take numpy, torch and Dr.Jit
arrays.
"""
