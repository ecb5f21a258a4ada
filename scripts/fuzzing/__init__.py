"""Feeding damaged files to every reader: what `scripts/fuzz.py` is made of.

readers     the files that can be read, and how commands read them
corpus, weights_corpus, own_corpus   undamaged files of every format, to start from
mutations   damaging them, also inside of archives, whose checksums are mended
trials      one read: what it raises, how long it takes, how much memory
workers     reads in a process of its own, which may crash or hang
guided      the same with atheris, which keeps the inputs that reach new lines
"""
