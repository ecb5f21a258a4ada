"""In notebooks: `cards` of frames, recipes and results, which show themselves, and the `viewer` of `tnst_mi.view`.

All of it is HTML that needs nothing else: pictures are embedded, every text is escaped, and sizes are bounded.
"""
