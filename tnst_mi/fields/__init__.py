"""Fields on cell-centred grids, and what the paper does with them, each operator with its adjoint.

Read in this order: `grid` (octaves and cells), `stencil` (interpolation), `potentials` (Eq. 3), `advection`
(MacCormack), `pyramid` (the normalised gradient), `resampling` (between octaves). `kernels` and `sums` are what their
Dr.Jit code is made of, `bounds` finds the smoke. `arrays` lets the public functions take arrays of numpy, torch and
Dr.Jit.
"""
