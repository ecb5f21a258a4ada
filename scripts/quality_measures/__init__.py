"""How good stylizations are, by measures that no optimisation has seen: what `scripts/quality.py` is made of.

crops     pieces of a picture inside the smoke
judge     the network that took no part, and its features of such pieces
texture   how far the features are distributed from those of the style
spectrum  contrast of a change, and how its energy is spread over frequencies
flicker   how far pictures fail to follow the smoke from frame to frame
seen      what of a stylization is measured: pictures, opacity, motion
measured  all measures of one stylization
compared  variants, smoke, and the trials that they make together
speed     how many iterations take equally long
trials    the stylizations, made and kept on the disk
results   their records and pictures
table     what came of it, in Markdown
sheet     all pictures in one
"""
