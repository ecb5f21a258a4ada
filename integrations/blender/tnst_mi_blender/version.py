"""The version of the add-on, which is that of the tnst_mi that it was made with and works with."""

VERSION = "0.1.0"
