"""The recipe of a stylization: its keys by section (`sections`), the kinds of their values (`keys`), named sets of
defaults (`presets`), values that change over the frames (`keyframes`), and the recipe itself (`recipe`)."""
