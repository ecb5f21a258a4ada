"""Fields on cell-centred grids, and what the paper does with them, each operator with its adjoint.

Read in this order: `grid`, `stencil`, `potentials` (Eq. 3), `advection` (MacCormack), `pyramid` (the normalised
gradient), `resampling` (between octaves). `arrays` lets the public functions take numpy, torch and Dr.Jit arrays.
"""
