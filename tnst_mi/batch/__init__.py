"""Several recipes on several inputs: `jobs` says which runs these are and where, `page` shows them side by side."""
