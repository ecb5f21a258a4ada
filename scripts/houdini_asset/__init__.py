"""The Houdini asset as text: what `scripts/build_houdini_asset.py` is made of.

dialog      the syntax of a DialogScript: parameters, folders, menus
controls    the parameters of a recipe's key
interface   all parameters of the asset, in their folders
files       the files of the asset, expanded as Houdini's `hotl -t` leaves it
"""
