"""The studio in the browser: a `session`, what its tabs see (`view`), choose and do, and the `page` that they ask."""
