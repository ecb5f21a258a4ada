"""GoogLeNet: the network itself (`googlenet`), and where its weights come from (`weights`, `readers`, `download`)."""
